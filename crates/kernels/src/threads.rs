//! Parallel loops over tiles, and the one way tiles may write to a shared buffer.

use rayon::prelude::*;

/// Runs `f` on a thread of the pool: between its parallel loops the pool's threads go on at once, where a caller from
/// outside would be put to sleep and woken for each of them. For short work that allocates little: each thread has its
/// own free memory, so large buffers would be claimed once per thread.
pub(crate) fn pooled<R: Send>(f: impl FnOnce() -> R + Send) -> R {
    rayon::scope(|_| f())
}

/// Runs `f(start, len)` for consecutive tiles of `0..total`, in parallel.
/// Tiles depend on the sizes alone, never on the number of threads.
pub(crate) fn par_tiles(total: usize, tile: usize, f: impl Fn(usize, usize) + Sync) {
    (0..total.div_ceil(tile))
        .into_par_iter()
        .with_max_len(1)
        .for_each(|i| f(i * tile, tile.min(total - i * tile)));
}

/// A mutable slice that parallel tasks cut into pieces by index.
#[derive(Clone, Copy)]
pub(crate) struct Shared<T> {
    ptr: *mut T,
    len: usize,
}

// SAFETY: access goes through the unsafe methods, whose callers promise disjoint pieces.
unsafe impl<T: Send> Send for Shared<T> {}
// SAFETY: as above.
unsafe impl<T: Send> Sync for Shared<T> {}

impl<T> Shared<T> {
    pub fn new(slice: &mut [T]) -> Self {
        Self {
            ptr: slice.as_mut_ptr(),
            len: slice.len(),
        }
    }

    /// The piece `start..start + len`.
    ///
    /// # Safety
    /// The slice outlives the result, and nothing else touches these elements meanwhile.
    #[allow(clippy::mut_from_ref)]
    pub unsafe fn slice<'a>(&self, start: usize, len: usize) -> &'a mut [T] {
        assert!(start + len <= self.len, "piece outside the slice");
        // SAFETY: in bounds by the assertion; exclusive by the caller's promise.
        unsafe { std::slice::from_raw_parts_mut(self.ptr.add(start), len) }
    }

    /// Pointer to element `start`, for strided pieces.
    pub fn at(&self, start: usize) -> *mut T {
        assert!(start <= self.len, "piece outside the slice");
        // SAFETY: in bounds by the assertion.
        unsafe { self.ptr.add(start) }
    }
}
