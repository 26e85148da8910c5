//! The house's own rules, where no compiler holds them: every source file says
//! what it is, and none grows beyond what a reader takes in.

use std::path::{Path, PathBuf};

/// Longest source file, lines.
const MAX_LINES: usize = 500;

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            if !name.starts_with('.') && !name.starts_with("target") {
                sources(&path, found);
            }
        } else if name.ends_with(".rs") {
            found.push(path);
        }
    }
}

#[test]
fn every_source_file_says_what_it_is_and_is_not_too_long() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = Vec::new();
    for folder in ["src", "crates", "tests"] {
        sources(&root.join(folder), &mut files);
    }
    assert!(files.len() > 30, "only {} sources found below {}", files.len(), root.display());
    let mut faults = Vec::new();
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        let name = file.strip_prefix(root).unwrap().display().to_string();
        let first = text.lines().next().unwrap_or_default();
        if !first.starts_with("//! ") || first.len() < 12 {
            faults.push(format!("{name}: its first line is {first:?}, and should say what the file is: `//! ...`"));
        }
        let lines = text.lines().count();
        if lines > MAX_LINES {
            faults.push(format!("{name}: {lines} lines; at most {MAX_LINES}, so divide it"));
        }
    }
    assert!(faults.is_empty(), "\n{}", faults.join("\n"));
}

#[test]
fn every_file_of_tests_is_run() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut packages = vec![root.to_path_buf()];
    packages.extend(std::fs::read_dir(root.join("crates")).unwrap().map(|entry| entry.unwrap().path()));
    let mut faults = Vec::new();
    for package in packages {
        let Ok(listed) = std::fs::read_to_string(package.join("tests/all.rs")) else { continue };
        let manifest = std::fs::read_to_string(package.join("Cargo.toml")).unwrap();
        for entry in std::fs::read_dir(package.join("tests")).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_stem().unwrap().to_string_lossy().into_owned();
            let known = listed.lines().any(|line| line == format!("mod {name};"))
                || manifest.contains(&format!("[[test]]\nname = \"{name}\"\n"));
            if path.extension().is_some_and(|extension| extension == "rs") && !known {
                faults.push(format!("{}: no program runs it; add `mod {name};` to all.rs beside it", path.display()));
            }
        }
    }
    assert!(faults.is_empty(), "\n{}", faults.join("\n"));
}

#[test]
fn only_the_edge_knows_the_wire_and_only_the_registry_knows_sled() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("crates");
    for entry in std::fs::read_dir(root).unwrap() {
        let folder = entry.unwrap().path();
        let manifest = folder.join("Cargo.toml");
        if !manifest.exists() {
            continue;
        }
        let name = folder.file_name().unwrap().to_string_lossy().into_owned();
        let text = std::fs::read_to_string(manifest).unwrap();
        for (dependency, allowed) in [("tonic", "cairn-api"), ("prost", "cairn-api"), ("sled", "cairn-log")] {
            let uses = text
                .lines()
                .any(|l| l.starts_with(&format!("{dependency} ")) || l.starts_with(&format!("{dependency}.")));
            assert!(!uses || name == allowed || name == "cairn-service", "{name} depends on {dependency}; only {allowed} may");
        }
    }
}

#[test]
fn the_engine_knows_no_grpc() {
    let mut files = Vec::new();
    sources(&Path::new(env!("CARGO_MANIFEST_DIR")).join("crates/cairn-service/src/engine"), &mut files);
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        assert!(!text.contains("tonic") && !text.contains("cairn_api"), "{} knows the wire", file.display());
    }
}
