//! What the audit of a store says of records that stand in the place of another owner's.

use crate::handmade::Log;
use cairn_log::format::{Digest, OwnerRecord, RecordKind};
use cairn_verify::{Code, StoreOptions, StoreReport, audit_store};

/// A log of three records by key 1 (0, 1, 2) and a map leaf, what `more` adds, and the audit's findings: codes and places.
fn after(more: impl FnOnce(&mut Log, [Digest; 3])) -> (Vec<String>, StoreReport) {
    let mut log = Log::default();
    let first = [0, 1, 2].map(|_| log.add(&log.record(RecordKind::Contribution, 1, "town"), &[]));
    log.end_batch();
    more(&mut log, first);
    log.end_batch();
    let dir = tempfile::tempdir().unwrap();
    log.write(dir.path());
    let pinned = log.verifier();
    let report = audit_store(dir.path(), &StoreOptions { pinned: Some(&pinned), ..StoreOptions::default() }).unwrap();
    let faults = report.findings.iter().filter(|f| f.severity == cairn_verify::Severity::Error);
    (faults.map(|f| format!("{} {}", f.code.as_str(), f.place.rsplit(' ').next().unwrap())).collect(), report)
}

fn about(log: &Log, kind: RecordKind, by: u8, earlier: Digest) -> OwnerRecord {
    OwnerRecord { replaces: Some(earlier), ..log.record(kind, by, "town") }
}

#[test]
fn heirs_replace_what_the_keys_before_them_signed() {
    let (faults, report) = after(|log, [first, second, third]| {
        let rotation = log.add(&about(log, RecordKind::Rotation, 2, first), &[1]);
        log.add(&about(log, RecordKind::Contribution, 2, second), &[]);
        log.add(&about(log, RecordKind::Rotation, 3, rotation), &[2]);
        log.add(&about(log, RecordKind::Contribution, 3, third), &[]);
        // Somebody else, with the heir's word.
        log.add(&about(log, RecordKind::Contribution, 9, third), &[3]);
        // Its contents gone, the rotation still ends key 1.
        log.erase(4);
    });
    assert_eq!((faults, report.exit_code()), (vec![], 0), "{report}");
    // The heir's own word is in its rotation; once that is erased, nobody can check it any more.
    let (faults, report) = after(|log, [first, second, _]| {
        log.add(&about(log, RecordKind::Rotation, 2, first), &[1]);
        log.add(&about(log, RecordKind::Contribution, 9, second), &[2]);
        log.erase(4);
    });
    assert!(faults.is_empty() && report.has(Code::StorePredecessorUnknown), "{report}");
}

#[test]
fn whoever_does_not_speak_for_the_owner_is_named() {
    let rule = |index: u64| vec![format!("store.record.rule {index}")];
    // A stranger alone.
    let (faults, _) = after(|log, [first, ..]| _ = log.add(&about(log, RecordKind::Contribution, 9, first), &[]));
    assert_eq!(faults, rule(4));
    // Before the rotation, and with the ended key's word behind it.
    let (faults, _) = after(|log, [first, second, _]| {
        log.add(&about(log, RecordKind::Contribution, 2, second), &[]);
        log.add(&about(log, RecordKind::Rotation, 2, first), &[1]);
    });
    assert_eq!(faults, rule(4));
    let (faults, _) = after(|log, [first, second, _]| {
        log.add(&about(log, RecordKind::Rotation, 2, first), &[1]);
        log.add(&about(log, RecordKind::Contribution, 9, second), &[1]);
    });
    assert_eq!(faults, ["store.record.signature 5"]);
    // A thief who rotates after the revocation, and what follows from it.
    let (faults, _) = after(|log, [first, second, _]| {
        log.add(&log.record(RecordKind::Revocation, 1, "town"), &[]);
        log.add(&about(log, RecordKind::Rotation, 7, first), &[1]);
        log.add(&about(log, RecordKind::Contribution, 7, second), &[]);
    });
    assert_eq!(faults, ["store.record.rule 5", "store.record.rule 6"]);
    // Two rotations of one key: the second ends nothing, whoever agreed.
    let (faults, _) = after(|log, [first, second, third]| {
        log.add(&about(log, RecordKind::Rotation, 2, first), &[1]);
        log.add(&about(log, RecordKind::Rotation, 3, second), &[1]);
        log.add(&about(log, RecordKind::Contribution, 3, third), &[]);
    });
    assert_eq!(faults, ["store.record.rule 5", "store.record.rule 6"]);
    // A signature more than anybody asks for.
    let (faults, _) = after(|log, [first, ..]| _ = log.add(&about(log, RecordKind::Contribution, 1, first), &[9]));
    assert_eq!(faults, rule(4));
}
