//! The results' files and page: round trips, refusals, and that the page in the repository is the one its rows give.

use std::path::Path;

use cairn_eval::page::page;
use cairn_eval::results::{Results, Row, Target};

fn row(suite: &str, case: &str, metric: &str, value: f64, target: Option<Target>) -> Row {
    Row {
        suite: suite.into(),
        case: case.into(),
        metric: metric.into(),
        value,
        unit: "dB".into(),
        target,
        met: target.map(|target| target.is_met_by(value)),
        command: "cairn-eval a | b".into(),
        seed: 1,
        commit: "0123456789ab".into(),
        machine: "Some CPU, 2 cores, 8 GiB".into(),
        date: "2026-01-31".into(),
    }
}

fn sample() -> Results {
    let mut results = Results::default();
    results.record(row("b", "two", "PSNR", 27.5, Some(Target::at_least(27.5)))).unwrap();
    results.record(row("a", "one", "time", 61.0, Some(Target::at_most(60.0)))).unwrap();
    results.record(row("b", "one", "PSNR", 0.1, None)).unwrap();
    results
}

fn save(results: &Results, folder: &Path) {
    ["a", "b"].iter().for_each(|suite| results.save(folder, suite).unwrap());
}

#[test]
fn what_is_saved_is_loaded_in_a_stable_order() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path().join("results");
    assert_eq!(Results::load(&folder).unwrap(), Results::default());
    save(&sample(), &folder);
    let loaded = Results::load(&folder).unwrap();
    assert_eq!(loaded, sample());
    let order: Vec<_> = loaded.rows().iter().map(|r| (r.suite.as_str(), r.case.as_str())).collect();
    assert_eq!(order, [("a", "one"), ("b", "one"), ("b", "two")]);
    let first = std::fs::read(folder.join("b.jsonl")).unwrap();
    save(&loaded, &folder);
    assert_eq!(std::fs::read(folder.join("b.jsonl")).unwrap(), first);
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 2, "a half-written file is left");
}

#[test]
fn a_newer_measurement_replaces_the_older_one() {
    let mut results = sample();
    results.record(Row { seed: 7, ..row("b", "two", "PSNR", 30.0, None) }).unwrap();
    assert_eq!(results.rows().len(), 3);
    assert_eq!((results.rows()[2].value, results.rows()[2].seed), (30.0, 7));
}

#[test]
fn what_cannot_be_reported_is_refused() {
    let mut results = sample();
    let infinite = results.record(row("a", "x", "PSNR", f64::INFINITY, None)).unwrap_err().to_string();
    assert!(infinite.contains("a / x / PSNR") && infinite.contains("inf"), "{infinite}");
    assert!(results.record(row("a", " ", "PSNR", 1.0, None)).unwrap_err().to_string().contains("case is empty"));
    assert!(results.record(row("a", "x", "m", 1.0, Some(Target::at_least(f64::NAN)))).is_err());
    assert_eq!(results, sample());
}

#[test]
fn a_file_that_contradicts_itself_is_refused() {
    let place = tempfile::tempdir().unwrap();
    save(&sample(), place.path());
    let refused = |suite: &str, from: &str, to: &str| {
        let path = place.path().join(format!("{suite}.jsonl"));
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{from} is not in {text}");
        std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
        let error = Results::load(place.path()).unwrap_err().to_string();
        std::fs::write(&path, text).unwrap();
        error
    };
    assert!(refused("a", "\"met\":false", "\"met\":true").contains("a / one / time"));
    assert!(refused("a", "\"unit\"", "\"units\"").contains("units"));
    assert!(refused("b", "\"two\"", "\"one\"").contains("b / one / PSNR"));
}

#[test]
fn the_page_shows_targets_and_what_was_missed() {
    let page = page(&sample());
    assert!(page.contains("1 of 2 targets are met."), "{page}");
    assert!(page.contains("| one | time | 61 dB | ≤ 60 dB | **no** | 1 |"), "{page}");
    assert!(page.contains("| two | PSNR | 27.5 dB | ≥ 27.5 dB | yes | 1 |"), "{page}");
    assert!(!page.contains("| one | PSNR |"), "a row without a target: {page}");
    assert!(page.contains("1. `cairn-eval a | b`: 0123456789ab, Some CPU, 2 cores, 8 GiB, 2026-01-31"), "{page}");
    assert_eq!(page.matches("\n## ").count(), 2);
}

#[test]
fn the_page_in_the_repository_is_that_of_its_rows() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let results = Results::load(&root.join("bench/results")).unwrap();
    assert!(!results.rows().is_empty(), "bench/results is empty");
    let written = std::fs::read_to_string(root.join("docs/results.md")).unwrap();
    assert!(page(&results) == written, "docs/results.md is not what bench/results gives: run `cairn-eval page`");
}
