//! A thread that waits for another one sleeps, so that it takes no time from it or from anyone else.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::time::{Duration, Instant};

use common::{Noise, Owned};
use lumi_kernels::{PackedBlock, Pattern, Precision};

/// Nanoseconds that the threads of this process have run.
fn processor_time() -> Duration {
    let threads = std::fs::read_dir("/proc/self/task").unwrap().flatten();
    let times = threads.map(|thread| {
        let line = std::fs::read_to_string(thread.path().join("schedstat")).unwrap_or_default();
        line.split(' ')
            .next()
            .and_then(|n| n.parse().ok())
            .unwrap_or(0)
    });
    Duration::from_nanos(times.sum())
}

/// One worker of two is held up for a while, as if the system ran something else in its place.
#[test]
fn waiting_for_a_worker_takes_no_processor_time() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2);
    let pool = pool.build().unwrap();
    let owned = Owned::new(64, 32, 256, 1);
    let block = PackedBlock::new(owned.shape, &owned.weights(), Precision::Bf16);
    let x = Noise(3).vec(100 * 64, 1.0);
    let run = || {
        let mut out = vec![0.0; x.len()];
        block.forward(&x, 1, 100, Pattern::full(100), &mut out);
        out
    };
    let want = pool.install(run);
    let pause = Duration::from_millis(400);
    let (start, before) = (Instant::now(), processor_time());
    let (got, ()) = pool.install(|| rayon::join(run, || std::thread::sleep(pause)));
    assert_eq!(want, got);
    assert!(start.elapsed() >= pause);
    let used = processor_time() - before;
    assert!(used < pause / 4, "{used:?} of processor time");
}
