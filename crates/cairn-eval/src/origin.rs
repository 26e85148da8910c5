//! Where a measurement comes from: commit, machine and day. Nothing here names
//! a host or a user, since results are published.

use std::path::Path;
use std::process::Command;
use std::time::{SystemTime, UNIX_EPOCH};

/// The commit checked out in `folder`, 12 hexadecimal digits, followed by
/// `-dirty` when tracked files differ from it (results and their page aside,
/// which measuring itself changes). `unknown` where there is no git to ask.
pub fn commit(folder: &Path) -> String {
    let Some(head) = git(folder, &["rev-parse", "--short=12", "HEAD"]) else { return "unknown".to_owned() };
    let ours = [":/", ":(top,exclude)bench/results", ":(top,exclude)docs/results.md"];
    let status = [&["status", "--porcelain", "--untracked-files=no", "--"][..], &ours].concat();
    match git(folder, &status) {
        Some(changes) if changes.is_empty() => head,
        // Unable to tell is not clean.
        _ => format!("{head}-dirty"),
    }
}

/// The contents of some `parts` of the repository in `folder`, as git names them; `-dirty` follows where tracked files
/// among them differ from what is checked out. `unknown` where there is no git to ask.
pub fn trees(folder: &Path, parts: &[&str]) -> String {
    let named: Option<Vec<String>> =
        parts.iter().map(|part| git(folder, &["rev-parse", "--short=12", &format!("HEAD:{part}")])).collect();
    let Some(named) = named else { return "unknown".to_owned() };
    let of_top: Vec<String> = parts.iter().map(|part| format!(":/{part}")).collect();
    let mut status = vec!["status", "--porcelain", "--untracked-files=no", "--"];
    status.extend(of_top.iter().map(String::as_str));
    match git(folder, &status) {
        Some(changes) if changes.is_empty() => named.join("-"),
        // Unable to tell is not clean.
        _ => format!("{}-dirty", named.join("-")),
    }
}

fn git(folder: &Path, arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").arg("-C").arg(folder).args(arguments).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// Processor, cores and memory, such as `Intel Xeon, 2 cores, 8 GiB`; what the
/// system does not tell is left out.
pub fn machine() -> String {
    let read = |path| std::fs::read_to_string(path).unwrap_or_default();
    let cores = std::thread::available_parallelism().map_or(0, usize::from);
    describe(&read("/proc/cpuinfo"), &read("/proc/meminfo"), cores)
}

fn describe(cpuinfo: &str, meminfo: &str, cores: usize) -> String {
    let field = |text: &str, name: &str| {
        let line = text.lines().find(|l| l.starts_with(name))?;
        Some(line.split_once(':')?.1.split_whitespace().collect::<Vec<_>>().join(" "))
    };
    let model = field(cpuinfo, "model name").unwrap_or_else(|| std::env::consts::ARCH.to_owned());
    let mut parts = vec![model.replace("(R)", "").replace("(TM)", "")];
    if cores > 0 {
        parts.push(format!("{cores} core{}", if cores == 1 { "" } else { "s" }));
    }
    let kib = field(meminfo, "MemTotal").and_then(|v| v.split(' ').next()?.parse::<f64>().ok());
    parts.extend(kib.map(|kib| format!("{:.0} GiB", kib / (1024.0 * 1024.0))));
    parts.join(", ")
}

/// The day in UTC, `YYYY-MM-DD`.
pub fn today() -> String {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    day((seconds / 86_400) as i64)
}

/// Days since 1970-01-01 as a date (H. Hinnant, "chrono-compatible low-level
/// date algorithms", `civil_from_days`).
fn day(days: i64) -> String {
    let z = days + 719_468;
    let era = z.div_euclid(146_097);
    let of_era = z.rem_euclid(146_097);
    let year_of_era = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted = (5 * of_year + 2) / 153;
    let date = of_year - (153 * shifted + 2) / 5 + 1;
    let month = if shifted < 10 { shifted + 3 } else { shifted - 9 };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{date:02}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_become_dates() {
        // From `date -u -d @<days * 86400> +%F`.
        for (days, date) in [(0, "1970-01-01"), (11_016, "2000-02-29"), (19_723, "2024-01-01"), (20_513, "2026-03-01")]
        {
            assert_eq!(day(days), date);
        }
        assert_eq!(today().len(), 10);
    }

    #[test]
    fn a_machine_is_described_without_its_name() {
        let cpu = "processor\t: 0\nmodel name\t: Some(R)  CPU @ 2 GHz\nprocessor\t: 1\n";
        assert_eq!(describe(cpu, "MemTotal:  8388608 kB\n", 2), "Some CPU @ 2 GHz, 2 cores, 8 GiB");
        assert_eq!(describe("", "", 1), format!("{}, 1 core", std::env::consts::ARCH));
    }

    #[test]
    fn a_commit_is_read_and_changes_are_told() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(commit(folder.path()), "unknown");
        let run = |arguments: &[&str]| git(folder.path(), arguments).is_some();
        if !run(&["init", "-q"]) {
            eprintln!("SKIPPED a_commit_is_read_and_changes_are_told: no git");
            return;
        }
        let write = |name: &str, text| {
            std::fs::create_dir_all(folder.path().join("docs")).unwrap();
            std::fs::write(folder.path().join(name), text).unwrap();
        };
        write("a", "1");
        write("docs/results.md", "1");
        assert!(run(&["add", "."]));
        assert!(run(&["-c", "user.name=a", "-c", "user.email=a@b", "commit", "-qm", "first"]));
        let clean = commit(folder.path());
        assert!(clean.len() == 12 && clean.bytes().all(|b| b.is_ascii_hexdigit()), "{clean}");
        write("docs/results.md", "2");
        assert_eq!(commit(folder.path()), clean);
        let parts = trees(folder.path(), &["docs"]);
        assert!(parts.len() == 12 + "-dirty".len() && parts.ends_with("-dirty"), "{parts}");
        write("docs/results.md", "1");
        let docs = trees(folder.path(), &["docs"]);
        write("a", "2");
        assert_eq!(commit(folder.path()), format!("{clean}-dirty"));
        assert_eq!(trees(folder.path(), &["docs"]), docs, "other parts do not count");
        assert_eq!(trees(folder.path(), &["none"]), "unknown");
    }
}
