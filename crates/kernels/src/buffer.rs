//! Aligned buffers that a thread keeps and reuses: fresh pages would cost more than the small
//! kernels that fill them.

use std::alloc::{Layout, alloc_zeroed, dealloc, handle_alloc_error};
use std::cell::RefCell;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};
use std::ptr::NonNull;

/// A cache line, and the width of an AVX-512 register.
const ALIGN: usize = 64;
/// Bytes a thread keeps for reuse; more goes back to the allocator.
const KEEP: usize = 192 << 20;

/// Types whose every bit pattern is a value.
pub(crate) trait Plain: Copy + Send + Sync + 'static {}
impl Plain for f32 {}
impl Plain for u16 {}

struct Block {
    ptr: NonNull<u8>,
    bytes: usize,
}

impl Block {
    fn new(bytes: usize) -> Self {
        let layout = Self::layout(bytes);
        // SAFETY: the size is at least `ALIGN`.
        let ptr = unsafe { alloc_zeroed(layout) };
        let ptr = NonNull::new(ptr).unwrap_or_else(|| handle_alloc_error(layout));
        Self { ptr, bytes }
    }

    fn layout(bytes: usize) -> Layout {
        Layout::from_size_align(bytes, ALIGN).expect("buffer size fits the address space")
    }
}

impl Drop for Block {
    fn drop(&mut self) {
        // SAFETY: allocated in `new` with this layout.
        unsafe { dealloc(self.ptr.as_ptr(), Self::layout(self.bytes)) }
    }
}

#[derive(Default)]
struct Free {
    blocks: Vec<Block>,
    bytes: usize,
}

thread_local! {
    static FREE: RefCell<Free> = RefCell::default();
}

/// `len` values, 64-byte aligned, with unspecified (but initialised) contents.
pub(crate) struct Buf<T: Plain> {
    block: Option<Block>,
    len: usize,
    kind: PhantomData<T>,
}

// SAFETY: a `Buf` owns its memory, and `T` is plain data.
unsafe impl<T: Plain> Send for Buf<T> {}
// SAFETY: shared access is read-only.
unsafe impl<T: Plain> Sync for Buf<T> {}

impl<T: Plain> Buf<T> {
    /// A buffer with unspecified contents.
    pub fn new(len: usize) -> Self {
        let bytes = (len * size_of::<T>()).next_multiple_of(ALIGN).max(ALIGN);
        let reused = FREE.with_borrow_mut(|free| {
            // The smallest block that fits and is not wasted on a much smaller need.
            let best = (0..free.blocks.len())
                .filter(|&i| (bytes..=2 * bytes + 4096).contains(&free.blocks[i].bytes))
                .min_by_key(|&i| free.blocks[i].bytes)?;
            let block = free.blocks.swap_remove(best);
            free.bytes -= block.bytes;
            Some(block)
        });
        Self {
            block: Some(reused.unwrap_or_else(|| Block::new(bytes))),
            len,
            kind: PhantomData,
        }
    }

    /// Memory held, which may be more than asked for.
    pub fn bytes(&self) -> usize {
        self.block.as_ref().map_or(0, |block| block.bytes)
    }

    fn ptr(&self) -> *mut T {
        match &self.block {
            Some(block) => block.ptr.as_ptr().cast(),
            None => unreachable!("the block leaves only in drop"),
        }
    }
}

impl Buf<f32> {
    pub fn zeroed(len: usize) -> Self {
        let mut buf = Self::new(len);
        buf.fill(0.0);
        buf
    }
}

impl<T: Plain> Drop for Buf<T> {
    fn drop(&mut self) {
        let block = self.block.take();
        // A thread that is ending has no list any more; then the block is simply freed.
        let _ = FREE.try_with(|free| {
            let mut free = free.borrow_mut();
            if let Some(block) = block
                && free.bytes + block.bytes <= KEEP
            {
                free.bytes += block.bytes;
                free.blocks.push(block);
            }
        });
    }
}

impl<T: Plain> Deref for Buf<T> {
    type Target = [T];
    fn deref(&self) -> &[T] {
        // SAFETY: the block holds `len` initialised values: zeroed once, then written as plain data.
        unsafe { std::slice::from_raw_parts(self.ptr(), self.len) }
    }
}

impl<T: Plain> DerefMut for Buf<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        // SAFETY: as in `deref`, and `self` is borrowed uniquely.
        unsafe { std::slice::from_raw_parts_mut(self.ptr(), self.len) }
    }
}
