//! Resident memory of the process, where the system says it (Linux).

/// Largest resident memory in bytes since the start of the program, or since [`reset_peak`].
#[must_use]
pub fn peak() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    let kib: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(1024 * kib)
}

/// [`peak`] in whole MiB.
#[must_use]
pub fn peak_mib() -> Option<f64> {
    peak().map(|bytes| (bytes as f64 / f64::from(1 << 20)).round())
}

/// Lets the peak begin again at what is resident now; false where that is not possible and it stays that of the program.
pub fn reset_peak() -> bool {
    // See proc(5): 5 resets the peak of the resident set size.
    std::fs::write("/proc/self/clear_refs", "5").is_ok()
}
