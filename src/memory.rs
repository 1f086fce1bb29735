//! Resident memory, where the system says it (Linux).

/// Largest resident memory since the start of the program, or since [`reset_peak`], in MiB.
pub fn peak_mib() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    let kib: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some((kib / 1024.0).round())
}

/// Lets the peak begin again at what is resident now; where that is not possible the peak stays that of the program.
pub fn reset_peak() {
    // See proc(5): 5 resets the peak of the resident set size. Failure leaves a larger, still true, peak.
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}
