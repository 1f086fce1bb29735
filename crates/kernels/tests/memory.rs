//! Attention never holds n x n scores: peak memory of long sequences is linear in their length.
#![allow(clippy::unwrap_used, missing_docs, unsafe_code)]

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use common::{Noise, Owned, computes};
use lumi_kernels::{Pattern, Save, Wanted, block_backward, block_forward_saved};

struct Counting;

static NOW: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

// SAFETY: forwards to the system allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        PEAK.fetch_max(
            NOW.fetch_add(layout.size(), Relaxed) + layout.size(),
            Relaxed,
        );
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, ptr: *mut u8, layout: Layout) {
        NOW.fetch_sub(layout.size(), Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(ptr, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn peak_memory_is_linear_in_tokens() {
    let (n, dim) = (8192, 32);
    let owned = Owned::new(dim, 16, 4 * dim, 1);
    let x = Noise(2).vec(n * dim, 1.0);
    let mut out = vec![0.0; x.len()];
    for (compute, _) in computes() {
        PEAK.store(NOW.load(Relaxed), Relaxed);
        let before = NOW.load(Relaxed);
        let saved = block_forward_saved(
            owned.shape,
            &owned.weights(),
            compute,
            Save::Activations,
            &x,
            1,
            n,
            Pattern::full(n),
            &mut out,
        );
        drop(block_backward(
            owned.shape,
            &owned.weights(),
            &saved,
            &x,
            Wanted::All,
        ));
        let peak = PEAK.load(Relaxed) - before;
        // Scores of one head alone would take n * n * 4 bytes = 256 MiB; what is linear takes
        // some forty vectors of `dim` floats a token, and tiles.
        assert!(peak < 64 << 20, "{compute:?}: {} MiB", peak >> 20);
    }
}
