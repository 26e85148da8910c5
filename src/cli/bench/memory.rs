//! The most memory that this process has held.

/// Peak resident memory of this process since its start, MiB; `None` where the
/// system does not tell (it is Linux's `/proc/self/status` that does).
pub fn peak_mib() -> Option<f64> {
    high_water(&std::fs::read_to_string("/proc/self/status").ok()?)
}

/// `VmHWM` of a process's status, MiB.
fn high_water(status: &str) -> Option<f64> {
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib / 1024.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_high_water_mark_is_read_and_its_absence_is_none() {
        assert_eq!(high_water("Name:\tcairn\nVmHWM:\t  524288 kB\nVmRSS:\t 1 kB\n"), Some(512.0));
        assert_eq!(high_water("Name:\tcairn\n"), None);
        assert_eq!(high_water("VmHWM:\t12 pages\n"), None);
        if cfg!(target_os = "linux") {
            assert!(peak_mib().is_some_and(|mib| mib > 1.0));
        }
    }
}
