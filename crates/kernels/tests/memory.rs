//! Attention never holds n x n scores: peak memory of long sequences is linear in their length.
#![allow(clippy::unwrap_used, missing_docs, unsafe_code)]

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::time::Duration;

use common::{Noise, Owned, computes, rotations};
use lumi_kernels::{
    Anchors, Compute, Cpu, Pattern, Precision, Save, Sight, Wanted, block_backward,
    block_forward_saved,
};

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

/// Peak of forward and backward of `n` tokens, above what was there before. In a pool of its own,
/// because threads keep buffers for reuse until they end. With anchors there are four query groups.
fn peak(compute: Compute, n: usize, anchored: bool) -> usize {
    let dim = 32;
    let owned = Owned::new(dim, 8, 2 * dim, 1);
    let x = Noise(2).vec(n * dim, 1.0);
    let groups = [n / 4; 4];
    let (queries, keys) = (rotations(n * 2, 3), rotations(groups.len() * n * 2, 4));
    let anchors = Anchors {
        depths: 1,
        queries: &queries,
        keys: &keys,
    };
    let sight = if anchored {
        let groups = &groups;
        Sight::Anchored { groups, anchors }
    } else {
        Pattern::full(n).into()
    };
    let before = NOW.load(Relaxed);
    PEAK.store(before, Relaxed);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2);
    pool.build().unwrap().install(|| {
        let mut out = vec![0.0; x.len()];
        let saved = block_forward_saved(
            owned.shape,
            &owned.weights(),
            compute,
            Save::Activations,
            &x,
            1,
            n,
            sight,
            &mut out,
        );
        let weights = owned.weights();
        block_backward(owned.shape, &weights, &saved, &x, sight, &x, Wanted::All);
    });
    let peak = PEAK.load(Relaxed) - before;
    // The pool's threads end, and give back their memory, a little later.
    for _ in 0..1000 {
        if NOW.load(Relaxed) < before + (1 << 20) {
            break;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    peak
}

#[test]
fn peak_memory_is_linear_in_tokens() {
    for (compute, _) in computes() {
        // In f32 the other paths are `Avx512F32`, and the emulation is too slow for long sequences.
        match (compute.cpu(), compute.precision()) {
            (Cpu::Portable | Cpu::Avx2 | Cpu::Avx512F32, Precision::F32)
            | (Cpu::Avx512 | Cpu::Amx, Precision::Bf16) => {}
            _ => continue,
        }
        check(compute, &[1024, 4096, 8192, 16384], false);
        check(compute, &[1024, 4096, 8192], true);
    }
}

fn check(compute: Compute, ns: &[usize], anchored: bool) {
    let peaks: Vec<usize> = ns.iter().map(|&n| peak(compute, n, anchored)).collect();
    println!("{compute:?} anchors {anchored}: {peaks:?} bytes for {ns:?} tokens");
    // Scores of one head alone would take 4 n² bytes: 1 GiB for the longest.
    let per_token = peaks[peaks.len() - 1] / ns[ns.len() - 1];
    assert!(
        per_token < 24 << 10,
        "{compute:?}: {per_token} bytes a token"
    );
    for i in 1..ns.len() {
        // Quadratic would be the square of that. Longer sequences are summed in more parts, up to
        // a limit: a little more than linear before it.
        let (tokens, bytes) = (ns[i] / ns[i - 1], peaks[i] as f64 / peaks[i - 1] as f64);
        assert!(
            bytes < 1.3 * tokens as f64,
            "{compute:?}: {tokens} times the tokens take {bytes:.2} times the memory"
        );
    }
}
