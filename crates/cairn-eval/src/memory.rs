//! The most memory that this process has held, and the processor time it took.

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

/// Processor seconds that this process has used, of all its threads; `None` where the
/// system does not tell. On a shared machine they say more than the clock.
pub fn processor_s() -> Option<f64> {
    // Behind the command's name, which may hold spaces: fields 14 and 15 of proc_pid_stat(5), in ticks.
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    let mut fields = stat.rsplit(')').next()?.split_whitespace().skip(11);
    let ticks = fields.next()?.parse::<f64>().ok()? + fields.next()?.parse::<f64>().ok()?;
    // USER_HZ is 100 on every Linux there is.
    Some(ticks / 100.0)
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
