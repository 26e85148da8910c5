//! Scenes, models and jobs made by hand: every byte of every file changed in turn.

use std::path::{Path, PathBuf};

use crate::handmade::{put, seal};
use cairn_log::format::Digest;
use cairn_verify::{Code, FileInHand, Finding, Severity, audit_folders};

/// A data folder with a scene, its model and an ended job.
fn written(dir: &Path) {
    put(&dir.join("format.json"), b"{\n  \"format_version\": 1\n}");
    let scene = dir.join("scenes/town");
    put(&scene.join("points.bin"), b"points");
    put(&scene.join("photographs/000000.png"), b"a photograph");
    let table = format!(
        r#"{{"points":{{"count":0,"sha256":"{}"}},"views":[{{"photograph":"000000.png","sha256":"{}"}}]}}"#,
        Digest::of("points"),
        Digest::of("a photograph")
    );
    put(&scene.join("scene.json"), table.as_bytes());
    seal(&scene, &["photographs/000000.png", "points.bin", "scene.json"], &scene.join("manifest.json"));

    let model = dir.join("models/town/job-000001");
    for name in ["base.field", "detector", "marked.field", "settings.toml", "signal-1.png", "signal-2.wav"] {
        put(&model.join(name), name.as_bytes());
    }
    let digest = |name: &str| Digest::of(name).to_string();
    let info = serde_json::json!({
        "base_field": digest("base.field"), "settings": digest("settings.toml"),
        "identities": [{"photographs": [digest("a photograph")]}],
        "mark": {"marked_field": digest("marked.field"), "detector": digest("detector"), "signals": [{"picture": digest("signal-1.png")}, {"audio": digest("signal-2.wav")}]},
    });
    put(&model.join("model.json"), info.to_string().as_bytes());
    let files =
        ["base.field", "detector", "marked.field", "model.json", "settings.toml", "signal-1.png", "signal-2.wav"];
    seal(&model, &files, &model.join("manifest.json"));
    let manifest = Digest::of(std::fs::read(model.join("manifest.json")).unwrap());
    let current =
        format!("{{\n  \"format_version\": 1,\n  \"job\": \"job-000001\",\n  \"manifest\": \"{manifest}\"\n}}");
    put(&dir.join("models/town/current.json"), current.as_bytes());

    for name in ["access/accounts.json", "access/usage.json", "owners/town.json", "registry.key"] {
        put(&dir.join(name), name.as_bytes());
    }
    seal_state(dir);
    put(&dir.join("jobs/job-000001/job.json"), b"{}");
    seal(&dir.join("jobs/job-000001"), &["job.json"], &dir.join("jobs/job-000001/manifest.json"));
}

fn seal_state(dir: &Path) {
    let state = ["access/accounts.json", "access/usage.json", "owners/town.json", "registry.key"];
    seal(dir, &state, &dir.join("state.seal"));
}

fn errors(findings: &[Finding]) -> Vec<String> {
    let errors = findings.iter().filter(|f| f.severity == Severity::Error);
    errors.map(|f| format!("{} at {}", f.code.as_str(), f.place)).collect()
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
    entries.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
}

#[test]
fn a_byte_changed_anywhere_is_found_and_its_file_named() {
    let dir = tempfile::tempdir().unwrap();
    written(dir.path());
    let (findings, stock) = audit_folders(dir.path()).unwrap();
    assert_eq!(errors(&findings), Vec::<String>::new());
    assert!(findings.iter().all(|f| f.severity == Severity::Passed), "{findings:?}");
    let root = cairn_log::format::record::photographs_root(&[Digest::of("a photograph")]);
    assert!(stock.scenes["town"].contains(&Digest::of("marked.field")) && stock.scenes["town"].contains(&root));

    for path in files(dir.path()) {
        let name = path.strip_prefix(dir.path()).unwrap().to_str().unwrap().to_owned();
        let good = std::fs::read(&path).unwrap();
        for at in 0..good.len() {
            let mut bytes = good.clone();
            bytes[at] ^= [0x01, 0x20, 0x80, 0x04][at % 4];
            std::fs::write(&path, &bytes).unwrap();
            let named = errors(&audit_folders(dir.path()).unwrap().0);
            // A manifest is found out by what it says of its files, so it is its folder that is named.
            let folder =
                if name == "state.seal" { "state." } else { name.strip_suffix("manifest.json").unwrap_or(&name) };
            assert!(named.iter().any(|n| n.contains(folder)), "{name} byte {at}: {named:?}");
        }
        std::fs::write(&path, &good).unwrap();
    }
}

#[test]
fn what_is_missing_or_strange_is_named_and_what_cannot_be_covered_is_told() {
    let dir = tempfile::tempdir().unwrap();
    written(dir.path());
    let now = || errors(&audit_folders(dir.path()).unwrap().0);
    put(&dir.path().join("scenes/town/note.txt"), b"x");
    assert_eq!(now(), ["file.unknown at scenes/town/note.txt"]);
    std::fs::remove_file(dir.path().join("scenes/town/note.txt")).unwrap();
    std::fs::remove_file(dir.path().join("scenes/town/points.bin")).unwrap();
    assert_eq!(now(), ["file.mismatch at scenes/town/points.bin"]);
    put(&dir.path().join("scenes/town/points.bin"), b"points");

    // Without a manifest the table still covers the photographs, and nothing the table.
    std::fs::remove_file(dir.path().join("scenes/town/manifest.json")).unwrap();
    let (findings, _) = audit_folders(dir.path()).unwrap();
    assert!(findings.iter().any(|f| f.code == Code::ManifestMissing) && errors(&findings).is_empty());
    put(&dir.path().join("scenes/town/photographs/000000.png"), b"another one");
    assert_eq!(now(), ["file.mismatch at scenes/town/photographs/000000.png"]);
    put(&dir.path().join("scenes/town/photographs/000000.png"), b"a photograph");
    put(&dir.path().join("lock"), b"123");
    put(&dir.path().join("scenes/.staging-x/y"), b"z");
    let (findings, _) = audit_folders(dir.path()).unwrap();
    let uncovered: Vec<_> =
        findings.iter().filter(|f| f.code == Code::FileUncovered).map(|f| f.place.as_str()).collect();
    assert_eq!(uncovered, ["lock", "scenes/.staging-x"]);
}

#[test]
fn the_daemons_own_state_is_held_to_its_seal() {
    let dir = tempfile::tempdir().unwrap();
    written(dir.path());
    let now = || errors(&audit_folders(dir.path()).unwrap().0);
    let path = |name: &str| dir.path().join(name);
    assert!(audit_folders(dir.path()).unwrap().0.iter().any(|f| f.code == Code::StateVerified));
    put(&path("owners/other.json"), b"x");
    assert_eq!(now(), ["state.mismatch at owners/other.json"]);
    std::fs::remove_file(path("owners/other.json")).unwrap();
    for name in ["owners/town.json", "registry.key"] {
        std::fs::remove_file(path(name)).unwrap();
        assert_eq!(now(), [format!("state.mismatch at {name}")]);
        put(&path(name), name.as_bytes());
    }
    // A whole folder gone; a file that came besides.
    std::fs::remove_dir_all(path("access")).unwrap();
    assert_eq!(now(), ["state.mismatch at access/accounts.json", "state.mismatch at access/usage.json"]);
    put(&path("access/accounts.json"), b"access/accounts.json");
    put(&path("access/usage.json"), b"access/usage.json");
    seal(dir.path(), &["access/accounts.json", "access/usage.json", "owners/town.json"], &path("state.seal"));
    assert_eq!(now(), ["state.mismatch at registry.key"]);
    // A seal over what is none of its business, and one of another version.
    seal_state(dir.path());
    let sealed = std::fs::read_to_string(path("state.seal")).unwrap();
    put(&path("state.seal"), sealed.replace("registry.key", "registry.kez").as_bytes());
    assert!(now().contains(&"state.seal at state.seal".to_owned()), "{:?}", now());
    put(&path("state.seal"), sealed.replace(r#""format_version":1"#, r#""format_version":2"#).as_bytes());
    assert_eq!(now(), ["state.seal at state.seal"]);
    // While the daemon runs there is none, which is no fault.
    std::fs::remove_file(path("state.seal")).unwrap();
    let (findings, _) = audit_folders(dir.path()).unwrap();
    assert!(errors(&findings).is_empty() && findings.iter().any(|f| f.code == Code::StateUnsealed));
}

#[test]
fn files_on_disk_are_read_in_pieces() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("large.bin");
    let bytes: Vec<u8> = (0..200_000_u32).map(|i| i.to_le_bytes()[0]).collect();
    std::fs::write(&path, &bytes).unwrap();
    assert_eq!(FileInHand::read(&path).unwrap().digest, Digest::of(&bytes));
    let absent = FileInHand::read(&folder.path().join("absent.bin")).unwrap_err();
    assert!(absent.to_string().contains("absent.bin"));
}
