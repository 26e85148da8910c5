//! Audits of data folders made by hand: each class of fault, and every byte of every
//! file changed in turn.

use std::path::{Path, PathBuf};

use crate::handmade::{Log, frame, key, put};
use cairn_log::format::{Digest, Note, OwnerKey, RecordKind, record::Seen};
use cairn_verify::{Class, Code, Outcome, Severity, StoreOptions, StoreReport, audit_store};
use rayon::prelude::*;

fn audit(dir: &Path, log: &Log) -> StoreReport {
    audit_store(dir, &StoreOptions { pinned: Some(&log.verifier()), ..StoreOptions::default() }).unwrap()
}

fn written(log: &Log) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    log.write(dir.path());
    dir
}

/// Places of the failed checks, one line.
fn faults(report: &StoreReport) -> String {
    let errors = report.findings.iter().filter(|f| f.severity == Severity::Error);
    errors.map(|f| format!("{} at {}\n", f.code.as_str(), f.place)).collect()
}

#[test]
fn a_sound_store_is_trusted_under_a_pinned_key_and_valid_under_its_own() {
    let log = Log::small();
    let dir = written(&log);
    let report = audit(dir.path(), &log);
    assert_eq!((report.outcome, report.exit_code()), (Outcome::Trusted, 0), "{report}");
    assert_eq!((report.size, report.records, report.erased, report.map_leaves), (8, 5, 1, 3), "{report}");
    assert!(report.findings.iter().all(|f| f.severity == Severity::Passed), "{report}");
    for code in [Code::StoreRootVerified, Code::StoreMapVerified, Code::StoreRecordsVerified, Code::WorkingVerified] {
        assert!(report.has(code), "{report}");
    }
    let key = log.verifier();
    let found = audit_store(dir.path(), &StoreOptions { found: Some(&key), ..StoreOptions::default() }).unwrap();
    assert!(found.outcome == Outcome::Valid && found.has(Code::StoreKeyUnpinned), "{found}");
    let none = audit_store(dir.path(), &StoreOptions::default()).unwrap();
    assert!(none.outcome == Outcome::Valid && none.has(Code::StoreKeyMissing), "{none}");
    // No registry at all is no verdict.
    assert!(audit_store(&dir.path().join("registry"), &StoreOptions::default()).is_err());
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() { found.extend(files(&path)) } else { found.push(path) }
    }
    found.sort();
    found
}

#[test]
fn a_byte_changed_anywhere_is_found_and_its_file_named() {
    let log = Log::tiny();
    let dir = written(&log);
    let paths = files(dir.path());
    assert!(paths.len() == 9, "{paths:?}");
    paths.par_iter().for_each(|path| {
        // Each worker its own copy.
        let copy = written(&log);
        let name = path.strip_prefix(dir.path()).unwrap();
        let (path, good) = (copy.path().join(name), std::fs::read(path).unwrap());
        for at in 0..good.len() {
            let mut bytes = good.clone();
            bytes[at] ^= [0x01, 0x20, 0x80, 0x04][at % 4];
            std::fs::write(&path, &bytes).unwrap();
            let report = audit(copy.path(), &log);
            let named = faults(&report);
            assert_eq!(report.outcome, Outcome::Invalid, "{name:?} byte {at}: {report}");
            // The working state is named from its seal, of which every byte counts as well.
            let right = named.contains(name.to_str().unwrap())
                || name.ends_with("working.seal") && named.contains("registry/working");
            assert!(right, "{name:?} byte {at}: {report}");
        }
    });
}

/// What to do to a store, the class that must follow, and the place that must be named.
type Spoil = (fn(&Path), Class, &'static str);

#[test]
fn each_class_of_fault_has_its_exit_code_and_names_the_file() {
    fn remove(path: PathBuf) {
        std::fs::remove_file(path).unwrap();
    }
    let spoils: &[Spoil] = &[
        (|d| remove(d.join("registry/public/checkpoint")), Class::Checkpoint, "public/checkpoint"),
        (|d| put(&d.join("registry/public/checkpoint"), b"x"), Class::Checkpoint, "public/checkpoint"),
        (|d| remove(d.join("registry/public/tile/0/000.p/8")), Class::Log, "tile/0/000.p/8"),
        (|d| remove(d.join("registry/public/tile/entries/000.p/8")), Class::Log, "tile/entries/000.p/8"),
        (|d| put(&d.join("registry/public/tile/0/001"), &[0; 32]), Class::Log, "tile/0/001"),
        (|d| put(&d.join("registry/public/note.txt"), b"hello"), Class::Log, "public/note.txt"),
        (|d| put(&d.join("registry/public/tile/0/000.p/3"), &[7; 64]), Class::Log, "tile/0/000.p/3"),
        (|d| remove(d.join("registry/envelopes/000")), Class::Records, "envelopes/000"),
        (|d| put(&d.join("registry/envelopes/000"), b""), Class::Records, "envelopes/000"),
        (|d| put(&d.join("registry/envelopes/0001"), b"x"), Class::Records, "envelopes/0001"),
        (|d| remove(d.join("registry/working/db")), Class::Working, "working/db"),
        (|d| put(&d.join("registry/working/more"), b"x"), Class::Working, "working/more"),
        (
            |d| put(&d.join("registry/working.seal"), br#"{"format_version":2,"files":[]}"#),
            Class::Working,
            "working.seal",
        ),
    ];
    let log = Log::small();
    for (at, (spoil, class, place)) in spoils.iter().enumerate() {
        let dir = written(&log);
        spoil(dir.path());
        let report = audit(dir.path(), &log);
        assert_eq!(report.exit_code(), class.exit_code(), "{at}: {report}");
        assert!(faults(&report).contains(place), "{at}: {report}");
    }
    // Several at once: the smallest code, and all classes in the report.
    let dir = written(&log);
    remove(dir.path().join("registry/working/db"));
    remove(dir.path().join("registry/public/tile/0/000.p/8"));
    let report = audit(dir.path(), &log);
    assert_eq!((report.exit_code(), report.classes), (11, vec![Class::Log, Class::Working]));
    // No seal is no fault: it cannot be told.
    let dir = written(&log);
    remove(dir.path().join("registry/working.seal"));
    let report = audit(dir.path(), &log);
    assert!(report.exit_code() == 0 && report.has(Code::WorkingUnsealed), "{report}");
}

/// A log after what a registry must not do, and the finding.
fn after(what: impl FnOnce(&mut Log)) -> StoreReport {
    let mut log = Log::small();
    what(&mut log);
    audit(written(&log).path(), &log)
}

#[test]
fn what_the_registry_itself_did_wrong_is_found() {
    let report = after(|log| log.push_map_leaf(Digest::of("any")));
    assert_eq!(
        faults(&report),
        "store.map.root at registry/envelopes/000, map leaf 8\n".replace("registry/envelopes/000, ", "")
    );
    assert_eq!(report.exit_code(), 13);
    // An erased record since the newest good root: its keys may be what changed.
    let mut log = Log::small();
    log.erase(6);
    log.slots[6][40] ^= 1;
    let report = audit(written(&log).path(), &log);
    assert!(faults(&report).contains("store.map.root at registry/envelopes/000, map leaf 7"), "{report}");

    // A record by an ended key, one that saw what never was, one for another log, one signed by nobody else.
    let report = after(|log| {
        log.add(&log.record(RecordKind::Claim, 2, "town"), &[]);
        log.end_batch();
    });
    assert_eq!(faults(&report), "store.record.rule at registry/envelopes/000, record 8\n");
    for seen in [Seen { size: 7, root: Digest::of("x") }, Seen { size: 3, root: Digest::of("x") }] {
        let report = after(|log| {
            log.add(&cairn_log::format::OwnerRecord { seen, ..log.record(RecordKind::Claim, 5, "town") }, &[]);
            log.end_batch();
        });
        assert_eq!(faults(&report), "store.record.seen at registry/envelopes/000, record 8\n");
    }
    let report = after(|log| {
        let mut record = log.record(RecordKind::Claim, 5, "town");
        record.origin = "elsewhere".into();
        log.add(&record, &[]);
        log.end_batch();
    });
    assert!(faults(&report).starts_with("store.record.rule at registry/envelopes/000, record 8\n"), "{report}");
    let report = after(|log| {
        let record = log.record(RecordKind::Claim, 5, "town");
        let mut envelope = record.seal(&key(5)).unwrap();
        envelope.sign(&key(6));
        log.add_sealed(&record, &envelope);
        log.end_batch();
    });
    assert!(faults(&report).starts_with("store.record.signature at registry/envelopes/000, record 8\n"), "{report}");
    // A rotation without the old owner's word.
    let report = after(|log| {
        let mut record = log.record(RecordKind::Rotation, 5, "town");
        record.replaces = Some(Digest::try_from(&log.entries[4][2..34]).unwrap());
        log.add(&record, &[9]);
        log.end_batch();
    });
    assert_eq!(faults(&report), "store.record.signature at registry/envelopes/000, record 8\n");
    // A log that does not end in a map leaf.
    let report = after(|log| {
        log.add(&log.record(RecordKind::Claim, 5, "town"), &[]);
        log.sizes.push(log.size());
    });
    assert_eq!(faults(&report), "store.map.leaf at entry 8\n");
    // A map leaf signed by somebody else.
    let report = after(|log| {
        let signer = std::mem::replace(&mut log.signer, OwnerKey::from_seed(&[77; 32]));
        log.end_batch();
        log.signer = signer;
    });
    assert!(faults(&report).starts_with("store.map.leaf at registry/public/tile/entries/000, entry 8"), "{report}");
}

#[test]
fn another_key_and_a_rewritten_history_are_seen_through() {
    let log = Log::small();
    let dir = written(&log);
    let mut other = log.clone();
    other.signer = key(201);
    let report = audit(dir.path(), &other);
    assert_eq!(report.exit_code(), 10, "{report}");
    // Every file is of one piece, and the checkpoint is of another log under the same name.
    let mut forked = Log::default();
    forked.add(&forked.record(RecordKind::Claim, 9, "town"), &[]);
    forked.end_batch();
    put(&dir.path().join("registry/public/checkpoint"), forked.checkpoint(2).as_bytes());
    let report = audit(dir.path(), &log);
    assert_eq!(report.exit_code(), 11, "{report}");
    assert!(faults(&report).contains("store.root"), "{report}");
    // A size that nothing is there for does not make the audit endless.
    let huge = cairn_log::format::Checkpoint::new(crate::handmade::ORIGIN, 1 << 60, Digest::of("x"))
        .sign(&log.signer)
        .unwrap();
    put(&dir.path().join("registry/public/checkpoint"), huge.to_string().as_bytes());
    assert_eq!(audit(dir.path(), &log).exit_code(), 11);
}

#[test]
fn lines_of_unknown_witnesses_are_named_and_prove_nothing() {
    let log = Log::small();
    let dir = written(&log);
    let mut note = Note::parse(&log.checkpoint(8)).unwrap();
    note.sign("witness.example", &key(90)).unwrap();
    put(&dir.path().join("registry/public/checkpoint"), note.to_string().as_bytes());
    let report = audit(dir.path(), &log);
    assert!(report.exit_code() == 0 && report.has(Code::StoreCosignatureUnknown), "{report}");
}

#[test]
fn what_was_on_its_way_when_the_registry_was_killed_is_no_fault() {
    let mut log = Log::small();
    log.add(&log.record(RecordKind::Claim, 5, "town"), &[]);
    log.add(&log.record(RecordKind::Claim, 6, "town"), &[]);
    let dir = tempfile::tempdir().unwrap();
    log.write(dir.path());
    let report = audit(dir.path(), &log);
    assert!(report.exit_code() == 0 && report.has(Code::StoreTail), "{report}");
    put(&dir.path().join("registry/public/checkpoint.new"), b"half a check");
    let report = audit(dir.path(), &log);
    assert!(report.exit_code() == 0 && report.has(Code::FileUncovered), "{report}");
    // Entries and tiles are written before the checkpoint; the newest envelope may be torn.
    log.end_batch();
    log.write(dir.path());
    put(&dir.path().join("registry/public/checkpoint"), log.checkpoint(8).as_bytes());
    let path = dir.path().join("registry/envelopes/000");
    let mut bytes = std::fs::read(&path).unwrap();
    bytes.extend_from_slice(&frame(&[1; 100])[..50]);
    std::fs::write(&path, &bytes).unwrap();
    let report = audit(dir.path(), &log);
    assert!(report.exit_code() == 0 && report.has(Code::StoreTail), "{report}");
    // What is there must hold all the same.
    let at = bytes.len() - 500;
    bytes[at] ^= 1;
    std::fs::write(&path, &bytes).unwrap();
    let report = audit(dir.path(), &log);
    assert!(report.exit_code() == 12 && faults(&report).contains("registry/envelopes/000"), "{report}");
}

#[test]
fn a_log_of_more_than_one_tile_holds_and_names_the_tile_above() {
    let mut log = Log::default();
    for i in 0..260_u32 {
        log.add(&log.record(RecordKind::Claim, 1 + (i % 3) as u8, "town"), &[]);
        if i % 130 == 99 {
            log.end_batch();
        }
    }
    log.end_batch();
    log.erase(5);
    log.erase(261);
    let dir = written(&log);
    let report = audit(dir.path(), &log);
    assert_eq!((report.exit_code(), report.size, report.erased), (0, 263, 2), "{report}");
    let files = ["tile/1/000.p/1", "tile/0/000", "tile/0/001.p/7", "tile/entries/000", "tile/entries/001.p/7"];
    for name in files {
        let path = dir.path().join("registry/public").join(name);
        let good = std::fs::read(&path).unwrap();
        // Leaf 5 is erased: what its file says stands against the other alone.
        for at in
            [5, good.len() / 2, good.len() - 1, 5 * 32 + 3, 5 * 164 + 77].into_iter().filter(|at| *at < good.len())
        {
            let mut bytes = good.clone();
            bytes[at] ^= 8;
            std::fs::write(&path, &bytes).unwrap();
            let report = audit(dir.path(), &log);
            assert!(report.exit_code() == 11 && faults(&report).contains(name), "{name} byte {at}: {report}");
        }
        std::fs::write(&path, &good).unwrap();
    }
    assert_eq!(audit(dir.path(), &log).exit_code(), 0);
}

#[test]
fn reports_are_readable_by_people_and_by_programs() {
    let log = Log::small();
    let dir = written(&log);
    std::fs::remove_file(dir.path().join("registry/working/db")).unwrap();
    let report = audit(dir.path(), &log);
    let text = report.to_string();
    for part in ["invalid\n", "log of size 8, root ", "5 records (1 erased), 3 map leaves", "remedy"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let json: serde_json::Value = serde_json::from_str(&report.to_json()).unwrap();
    assert_eq!((json["version"].as_u64(), json["classes"][0].as_str()), (Some(1), Some("working")));
    let codes: Vec<u8> = Class::ALL.iter().map(|class| class.exit_code()).collect();
    assert_eq!(codes, [10, 11, 12, 13, 14, 15]);
}
