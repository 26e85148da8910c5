//! `docs/security/threats.md` names, for each threat, the tests that show its answer: a test that does not exist shows
//! nothing.

use std::collections::HashSet;
use std::path::Path;

/// `file::function` of every citation: `` `path/to/file.rs::function` `` anywhere in the text.
fn citations(text: &str) -> Vec<(&str, &str)> {
    let spans = text.split('`').skip(1).step_by(2);
    spans.filter_map(|span| span.split_once(".rs::")).collect()
}

/// Names of the functions of a source that are tests. A macro's tests are named in its call as `name: "...",`.
fn tests(source: &str) -> HashSet<&str> {
    let mut found = HashSet::new();
    let mut marked = false;
    for line in source.lines().map(str::trim) {
        let function = line.strip_prefix("fn ").or_else(|| line.strip_prefix("async fn "));
        match function {
            Some(rest) if std::mem::take(&mut marked) => drop(found.insert(rest.split('(').next().unwrap_or(rest))),
            _ => marked |= line.starts_with("#[test]") || line.starts_with("#[tokio::test"),
        }
    }
    if let Some((_, call)) = source.split_once("attacked! {") {
        let call = call.split("\n}").next().unwrap_or(call);
        found.extend(call.lines().filter_map(|line| line.trim().split_once(": \"")).map(|(name, _)| name));
    }
    found
}

#[test]
fn every_cited_test_exists() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(root.join("docs/security/threats.md")).unwrap();
    let cited = citations(&text);
    assert!(cited.len() > 40, "only {} citations found", cited.len());
    let mut faults = Vec::new();
    for (file, function) in cited {
        let path = root.join(format!("{file}.rs"));
        match std::fs::read_to_string(&path) {
            Err(_) => faults.push(format!("{file}.rs::{function}: there is no such file")),
            Ok(source) if !tests(&source).contains(function) => {
                faults.push(format!("{file}.rs::{function}: the file has no such test"));
            }
            Ok(_) => {}
        }
    }
    assert!(faults.is_empty(), "docs/security/threats.md cites what is not there:\n{}", faults.join("\n"));
}

#[test]
fn every_threat_has_a_test() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(root.join("docs/security/threats.md")).unwrap();
    let sections: Vec<&str> = text.split("\n## ").skip(1).collect();
    assert!(sections.len() >= 12, "{} threats", sections.len());
    for section in sections {
        let name = section.lines().next().unwrap_or_default();
        assert!(name == "What is not answered" || !citations(section).is_empty(), "{name}: no test is cited");
    }
}

#[test]
fn citations_and_tests_are_found() {
    let text = "a `tests/a.rs::one`, `no citation`, and `crates/b/tests/b.rs::two`.";
    assert_eq!(citations(text), [("tests/a", "one"), ("crates/b/tests/b", "two")]);
    let source = "#[test]\nfn one() {}\nfn helper() {}\n#[tokio::test(flavor = \"x\")]\nasync fn two() {}\n\
        attacked! {\n    three: \"note\",\n}\n";
    assert_eq!(tests(source), ["one", "two", "three"].into());
}
