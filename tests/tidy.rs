//! The rules of the house that a program can check: which crate may use which, no cycle between a
//! crate's modules, `impl`s that stay together, no tuples as parameters, and a first line that says
//! what a file is. The rules and their reasons: docs/design/architecture.md.

mod modules;
mod words;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use modules::Sources;

/// Every package and the packages of ours that it may use. Tests may use more.
const ARROWS: [(&str, &[&str]); 13] = [
    ("cairn-durable", &[]),
    ("cairn-nn", &["cairn-durable"]),
    ("cairn-api", &[]),
    ("cairn-scene", &["cairn-durable"]),
    ("cairn-landmark", &["cairn-durable", "cairn-scene"]),
    ("cairn-field", &["cairn-durable", "cairn-scene"]),
    ("cairn-register", &["cairn-field", "cairn-scene"]),
    ("cairn-share", &["cairn-field", "cairn-scene"]),
    ("cairn-mark", &["cairn-durable", "cairn-field", "cairn-nn", "cairn-register", "cairn-scene", "cairn-share"]),
    ("cairn-log", &["cairn-durable"]),
    ("cairn-verify", &["cairn-log"]),
    (
        "cairn-service",
        &[
            "cairn-api",
            "cairn-durable",
            "cairn-field",
            "cairn-log",
            "cairn-mark",
            "cairn-nn",
            "cairn-register",
            "cairn-scene",
            "cairn-share",
        ],
    ),
    (
        "cairn",
        &["cairn-api", "cairn-durable", "cairn-landmark", "cairn-log", "cairn-scene", "cairn-service", "cairn-verify"],
    ),
];

/// Packages that are not shipped: they may use every other, and only tests use them.
const NOT_SHIPPED: [&str; 2] = ["cairn-eval", "cairn-testkit"];

/// Libraries that one package alone may use, so that their types stay behind it.
const ALONE: [(&str, &[&str]); 3] = [
    ("tonic", &["cairn-api", "cairn-service", "cairn"]),
    ("sled", &["cairn-log"]),
    ("candle-core", &["cairn-nn", "cairn-mark", "cairn-eval"]),
];

/// In how many files a type's inherent `impl`s may stand.
const MAX_IMPL_FILES: usize = 2;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Every package's name and folder.
fn packages() -> Vec<(String, PathBuf)> {
    let mut packages = vec![("cairn".to_owned(), root().to_path_buf())];
    for entry in std::fs::read_dir(root().join("crates")).unwrap() {
        let folder = entry.unwrap().path();
        if folder.join("Cargo.toml").exists() {
            packages.push((folder.file_name().unwrap().to_string_lossy().into_owned(), folder));
        }
    }
    packages.sort();
    packages
}

/// What every package's sources say, read once for all tests.
fn read_packages() -> &'static [(String, Sources)] {
    static READ: OnceLock<Vec<(String, Sources)>> = OnceLock::new();
    READ.get_or_init(|| {
        packages().into_iter().map(|(name, folder)| (name, Sources::read(&folder.join("src")))).collect()
    })
}

/// The faults of each package, with its name before them.
fn faults_of(check: impl Fn(&Sources) -> Vec<String>) -> Vec<String> {
    let of = |(name, sources): &(String, Sources)| -> Vec<String> {
        check(sources).into_iter().map(|fault| format!("{name}: {fault}")).collect()
    };
    read_packages().iter().flat_map(of).collect()
}

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

/// The packages that a manifest's `[dependencies]` name.
fn dependencies(folder: &Path) -> BTreeSet<String> {
    let manifest: toml::Table = std::fs::read_to_string(folder.join("Cargo.toml")).unwrap().parse().unwrap();
    let table = manifest.get("dependencies").and_then(|table| table.as_table());
    table.into_iter().flatten().map(|(name, _)| name.clone()).collect()
}

#[test]
fn packages_use_each_other_as_declared() {
    let mut faults = Vec::new();
    for (name, folder) in packages() {
        if NOT_SHIPPED.contains(&name.as_str()) {
            continue;
        }
        let Some((_, allowed)) = ARROWS.iter().find(|(package, _)| *package == name) else {
            faults.push(format!("{name} has no row in ARROWS"));
            continue;
        };
        for used in dependencies(&folder).iter().filter(|used| used.starts_with("cairn")) {
            if !allowed.contains(&used.as_str()) {
                faults.push(format!("{name} uses {used}; allowed are {allowed:?}"));
            }
        }
    }
    assert!(faults.is_empty(), "\n{}", faults.join("\n"));
}

#[test]
fn some_libraries_stay_behind_one_package() {
    for (name, folder) in packages() {
        let used = dependencies(&folder);
        for (library, allowed) in ALONE {
            let is_allowed = allowed.contains(&name.as_str()) || name == "cairn-testkit";
            assert!(is_allowed || !used.contains(library), "{name} uses {library}; only {allowed:?} may");
        }
    }
}

#[test]
fn the_auditor_reads_formats_and_nothing_that_writes_them() {
    let manifest: toml::Table =
        std::fs::read_to_string(root().join("crates/cairn-verify/Cargo.toml")).unwrap().parse().unwrap();
    let features = manifest["dependencies"]["cairn-log"].get("features");
    assert_eq!(features, None, "cairn-verify takes features of cairn-log: it has to do with the formats");
    let mut files = Vec::new();
    sources(&root().join("crates/cairn-verify/src"), &mut files);
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        for part in ["cairn_log::log", "cairn_log::witness", "cairn_log::log::store"] {
            assert!(!text.contains(part), "{} uses {part}", file.display());
        }
    }
}

#[test]
fn only_the_edge_of_the_service_knows_the_wire() {
    let folder = root().join("crates/cairn-service/src");
    let mut files = Vec::new();
    sources(&folder, &mut files);
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        let knows = text.contains("tonic::") || text.contains("cairn_api::");
        assert!(!knows || file.starts_with(folder.join("grpc")), "{} knows the wire", file.display());
    }
}

#[test]
fn modules_of_a_package_form_no_cycle() {
    let modules: usize = read_packages().iter().map(|(_, sources)| sources.len()).sum();
    assert!(modules > 100, "only {modules} modules found");
    let faults = faults_of(Sources::cycles);
    assert!(faults.is_empty(), "\n{}", faults.join("\n"));
}

#[test]
fn the_impls_of_a_type_stay_together() {
    let faults = faults_of(|sources| sources.scattered_impls(MAX_IMPL_FILES));
    assert!(faults.is_empty(), "inherent impls in more than {MAX_IMPL_FILES} files:\n{}", faults.join("\n"));
}

#[test]
fn no_function_takes_a_tuple() {
    let mut faults = faults_of(Sources::tuple_parameters);
    for (name, package) in packages() {
        let tests = package.join("tests");
        if tests.is_dir() {
            faults
                .extend(Sources::read(&tests).tuple_parameters().iter().map(|fault| format!("{name}/tests: {fault}")));
        }
    }
    assert!(faults.is_empty(), "name the group, or split the function:\n{}", faults.join("\n"));
}

#[test]
fn every_source_file_says_what_it_is() {
    let mut files = Vec::new();
    for folder in ["src", "crates", "tests", "fuzz"] {
        sources(&root().join(folder), &mut files);
    }
    assert!(files.len() > 30, "only {} sources found below {}", files.len(), root().display());
    let mut faults = Vec::new();
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        let first = text.lines().next().unwrap_or_default();
        if !first.starts_with("//! ") || first.len() < 12 {
            let name = file.strip_prefix(root()).unwrap().display();
            faults.push(format!("{name}: its first line is {first:?}, and should say what the file is: `//! ...`"));
        }
    }
    assert!(faults.is_empty(), "\n{}", faults.join("\n"));
}

#[test]
fn every_file_of_tests_is_run() {
    let mut faults = Vec::new();
    for (_, package) in packages() {
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

/// Made-up sources, to see that the checks above can fail.
fn made_up(files: &[(&str, &str)]) -> Sources {
    let mut sources = Sources::default();
    for (name, text) in files {
        sources.add(Path::new(name), text);
    }
    sources
}

#[test]
fn a_cycle_is_found_through_a_re_export_a_macro_and_a_parent() {
    let through_reexport = made_up(&[
        ("lib.rs", "mod a; mod b; pub use b::Thing;"),
        ("a.rs", "use crate::Thing; pub struct Other;"),
        ("b.rs", "use crate::a::Other; pub struct Thing;"),
    ]);
    assert_eq!(through_reexport.cycles().len(), 1);
    let in_macro = made_up(&[
        ("lib.rs", "mod a; mod b;"),
        ("a.rs", "fn f() { println!(\"{}\", crate::b::N) }"),
        ("b.rs", "use super::a; pub const N: u8 = 1;"),
    ]);
    assert_eq!(in_macro.cycles().len(), 1);
    let parent = made_up(&[("lib.rs", "mod a; fn f() { a::g() }"), ("a.rs", "use super::f; pub fn g() {}")]);
    assert_eq!(parent.cycles().len(), 1);
}

#[test]
fn what_only_points_down_or_stands_in_tests_is_no_cycle() {
    let sources = made_up(&[
        ("lib.rs", "mod a; mod b; pub use a::A; pub use b::B;"),
        ("a.rs", "pub struct A; #[cfg(test)] mod tests { use crate::b::B; } #[cfg(test)] use crate::b;"),
        ("b.rs", "use crate::A; pub struct B;"),
    ]);
    assert_eq!(sources.cycles(), Vec::<String>::new());
}

#[test]
fn scattered_impls_and_tuples_are_found() {
    let sources = made_up(&[
        ("lib.rs", "mod a; mod b; mod c; mod d;"),
        ("a.rs", "pub struct T; impl T { fn x(at: &(u8, u8)) {} fn y(&self, unit: ()) {} }"),
        ("b.rs", "use crate::a::T; impl T { fn z((a, b): (u8, u8)) {} }"),
        ("c.rs", "impl crate::a::T { fn w(each: &[(u8, u8)]) {} }"),
        ("d.rs", "struct T; impl T { fn v() {} } impl Clone for T { fn clone(&self) -> T { T } }"),
    ]);
    assert_eq!(sources.scattered_impls(2).len(), 1);
    assert_eq!(sources.scattered_impls(3), Vec::<String>::new());
    assert_eq!(sources.tuple_parameters(), ["a.rs: x", "b.rs: z"]);
}
