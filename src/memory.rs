//! Memory of this process, where the system tells (Linux).

/// Largest resident memory so far, in MB.
pub fn peak_mb() -> Option<f64> {
    read("VmHWM:")
}

/// Resident memory at present, in MB.
pub fn resident_mb() -> Option<f64> {
    read("VmRSS:")
}

/// From now on [`peak_mb`] tells of what comes; where the system forbids that, of all.
pub fn reset_peak() {
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

fn read(name: &str) -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix(name))?;
    Some(line.trim().trim_end_matches("kB").trim().parse::<f64>().ok()? / 1024.0)
}
