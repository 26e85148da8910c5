//! The ledger's file and page: round trips, refusals, and that the page in the
//! repository is the one its ledger gives.

use std::path::{Path, PathBuf};

use cairn_eval::{Ledger, Notes, Row, Target};

fn row(suite: &str, case: &str, metric: &str, seed: u64, value: f64, target: Option<Target>) -> Row {
    Row {
        suite: suite.into(),
        case: case.into(),
        metric: metric.into(),
        value,
        unit: "dB".into(),
        target,
        command: "cairn bench a | b".into(),
        seed,
        commit: "0123456789ab".into(),
        machine: "Some CPU, 2 cores, 8 GiB".into(),
        date: "2026-01-31".into(),
    }
}

fn sample() -> Ledger {
    let mut ledger = Ledger::default();
    ledger.record(row("b", "two", "PSNR", 1, 27.5, Some(Target::at_least(27.5)))).unwrap();
    ledger.record(row("a", "one", "time", u64::MAX, 61.0, Some(Target::at_most(60.0)))).unwrap();
    ledger.record(row("b", "one", "PSNR", 2, 0.1, None)).unwrap();
    ledger
}

#[test]
fn what_is_saved_is_loaded_in_a_stable_order() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("benchmarks.json");
    assert_eq!(Ledger::load(&path).unwrap(), Ledger::default());
    sample().save(&path).unwrap();
    let loaded = Ledger::load(&path).unwrap();
    assert_eq!(loaded, sample());
    let order: Vec<_> = loaded.rows().iter().map(|r| (r.suite.as_str(), r.case.as_str())).collect();
    assert_eq!(order, [("a", "one"), ("b", "one"), ("b", "two")]);
    let first = std::fs::read(&path).unwrap();
    loaded.save(&path).unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), first);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no half-written file is left");
}

#[test]
fn the_same_measurement_is_replaced_and_another_seed_is_not() {
    let mut ledger = sample();
    ledger.record(row("b", "two", "PSNR", 1, 30.0, None)).unwrap();
    assert_eq!(ledger.rows().len(), 3);
    assert_eq!(ledger.rows()[2].value, 30.0);
    ledger.record(row("b", "two", "PSNR", 7, 31.0, None)).unwrap();
    assert_eq!(ledger.rows().len(), 4);
}

#[test]
fn what_cannot_be_reported_is_refused() {
    let mut ledger = sample();
    let infinite = ledger.record(row("a", "x", "PSNR", 0, f64::INFINITY, None)).unwrap_err().to_string();
    assert!(infinite.contains("a / x / PSNR (seed 0)") && infinite.contains("inf"), "{infinite}");
    assert!(ledger.record(row("a", " ", "PSNR", 0, 1.0, None)).unwrap_err().to_string().contains("case is empty"));
    assert!(ledger.record(row("a", "x", "m", 0, 1.0, Some(Target::at_least(f64::NAN)))).is_err());
    assert_eq!(ledger, sample());
}

#[test]
fn a_file_that_was_meddled_with_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("benchmarks.json");
    sample().save(&path).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    let refused = |from: &str, to: &str| {
        assert!(text.contains(from), "{from} is not in {text}");
        std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
        Ledger::load(&path).unwrap_err().to_string()
    };
    assert!(refused("\"met\": false", "\"met\": true").contains("a / one / time"));
    assert!(refused("\"unit\"", "\"units\"").contains("units"));
    // The two rows of suite b become one key.
    let twice = text.replace("\"two\"", "\"one\"").replace("\"seed\": 2", "\"seed\": 1");
    std::fs::write(&path, twice).unwrap();
    assert!(Ledger::load(&path).unwrap_err().to_string().contains("b / one / PSNR (seed 1)"));
}

#[test]
fn the_page_tells_what_was_missed() {
    let page = sample().to_markdown(&Notes::default());
    assert!(page.contains("1 of 2 targets are met."));
    assert!(page.contains("- a, one, time (seed 18446744073709551615): 61 dB, wanted ≤ 60 dB"), "{page}");
    assert!(page.contains("| **NO** |") && page.contains("| yes |"));
    assert!(page.contains("`cairn bench a \\| b`"), "a bar does not end the cell");
    assert_eq!(page.matches("\n## ").count(), 2);
    assert!(Ledger::default().to_markdown(&Notes::default()).contains("No row has a target."));
}

#[test]
fn a_suites_note_stands_above_its_table_as_it_was_written() {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(Notes::read(&folder.path().join("absent")).unwrap(), Notes::default());
    let note = "Limited by *memory*:\n\n- | not a table\n";
    std::fs::write(folder.path().join("b.md"), note).unwrap();
    std::fs::write(folder.path().join("other.txt"), "not a note").unwrap();
    let notes = Notes::read(folder.path()).unwrap();
    assert_eq!((notes.of("a"), notes.of("other")), (None, None));
    let page = sample().to_markdown(&notes);
    assert!(page.contains("\n## b\n\nLimited by *memory*:\n\n- | not a table\n\n| case |"), "{page}");
    assert!(page.contains("\n## a\n\n| case |"), "{page}");
}

#[test]
fn the_page_in_the_repository_is_the_ledgers() {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs");
    let (json, page): (PathBuf, PathBuf) = (docs.join("benchmarks.json"), docs.join("benchmarks.md"));
    match (json.is_file(), page.is_file()) {
        (true, true) => {
            let generated = Ledger::load(&json).unwrap().to_markdown(&Notes::read(&docs.join("limits")).unwrap());
            let written = std::fs::read_to_string(&page).unwrap();
            assert!(
                generated == written,
                "docs/benchmarks.md is not what docs/benchmarks.json and docs/limits give: run `cairn bench page`"
            );
        }
        (false, false) => eprintln!("SKIPPED the_page_in_the_repository_is_the_ledgers: no ledger yet"),
        (json, page) => panic!("docs has one of benchmarks.json ({json}) and benchmarks.md ({page}) without the other"),
    }
}
