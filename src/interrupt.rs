//! Requests to end: Ctrl-C, and the signal by which systems ask (SIGTERM).

use crate::output::say_aside;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Exit status of a command that was asked to end before it was done.
pub const STATUS: u8 = 130;

/// Resolves when the person or the system asks the program to end.
pub async fn asked() {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        if let Ok(mut terminate) = signal(SignalKind::terminate()) {
            tokio::select! {
                _ = tokio::signal::ctrl_c() => {}
                _ = terminate.recv() => {}
            }
            return;
        }
    }
    let _ = tokio::signal::ctrl_c().await;
}

/// A flag that the first request sets, saying `word` on standard error; the second ends the program at once.
///
/// # Errors
/// If no thread can be had to wait for them.
pub fn flag(word: &'static str) -> std::io::Result<Arc<AtomicBool>> {
    let flag = Arc::new(AtomicBool::new(false));
    let set = flag.clone();
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    std::thread::Builder::new().spawn(move || {
        runtime.block_on(async {
            asked().await;
            say_aside!("{word}");
            set.store(true, Ordering::Relaxed);
            asked().await;
            std::process::exit(STATUS.into());
        });
    })?;
    Ok(flag)
}
