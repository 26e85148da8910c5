//! Every store operation of a submission and of a start is made to fail in turn, before and after taking
//! effect; then the machine "loses power" or only the process dies. What was acknowledged must be there,
//! what was signed must be honoured, and the submitter's retry must end with one record.
#![cfg(feature = "store")]

use crate::common::*;
use cairn_durable::Fault;
use cairn_log::{Checkpoint, OwnerKey, Registry, RegistryError, log::store::FaultyStore};

const FAULTS: [Fault; 2] = [Fault::Before, Fault::After];

fn open(store: &FaultyStore) -> Result<Registry, RegistryError> {
    Registry::open_store(Box::new(store.clone()), Box::new(store.clone()), registry_key(), ORIGIN)
}

fn open_as(store: &FaultyStore, key: OwnerKey, origin: &str) -> Result<Registry, RegistryError> {
    Registry::open_store(Box::new(store.clone()), Box::new(store.clone()), key, origin)
}

/// A log of three records.
fn begun() -> (FaultyStore, Registry) {
    let store = FaultyStore::new();
    let registry = open(&store).unwrap();
    for what in ["a", "b", "c"] {
        submit(&registry, &owner(1), "fern", what).unwrap();
    }
    (store, registry)
}

fn try_one(nth: u64, fault: Fault, power_lost: bool) -> bool {
    let (store, registry) = begun();
    let envelope = sealed(&registry, &owner(2), "trex", "the one");
    let mut signed = vec![registry.checkpoint()];
    let mut acknowledged = Vec::new();
    store.fail_at(nth, fault);
    let outcome = take(&registry, &envelope);
    store.heal();
    if let Ok(receipt) = &outcome {
        verify_receipt(&registry, receipt);
        signed.push(receipt.checkpoint.clone());
        acknowledged.push(envelope.clone());
    }
    // Whatever happened, what is published goes on being provable.
    must_honour(&registry, &signed, &acknowledged);
    match submit(&registry, &owner(3), "fern", "next") {
        Ok(receipt) => {
            signed.push(receipt.checkpoint.clone());
            acknowledged.push(receipt.envelope.clone());
        }
        Err(RegistryError::Halted { cause }) => {
            assert!(outcome.is_err());
            assert!(cause.contains("injected"), "{cause}");
        }
        Err(other) => panic!("operation {nth}, {fault:?}: {other}"),
    }
    signed.push(registry.checkpoint());
    drop(registry);
    let found = if power_lost { store.crash() } else { store };
    let registry = open(&found).unwrap();
    must_honour(&registry, &signed, &acknowledged);
    let receipt = take(&registry, &envelope).unwrap();
    verify_receipt(&registry, &receipt);
    let copies = records(&registry, Some("trex")).len();
    assert_eq!(copies, 1, "operation {nth}, {fault:?}: the retry must not make a second record");
    outcome.is_err()
}

#[test]
fn every_operation_of_a_submission_may_fail() {
    let (store, registry) = begun();
    let envelope = sealed(&registry, &owner(2), "trex", "the one");
    let before = store.operations();
    take(&registry, &envelope).unwrap();
    let operations = store.operations() - before;
    assert!(
        operations >= 5,
        "at least a pack written and flushed, a put, a flush and a reading back, counted {operations}"
    );
    for power_lost in [false, true] {
        for fault in FAULTS {
            for nth in 0..operations {
                assert!(try_one(nth, fault, power_lost), "operation {nth} failed and nobody was told");
            }
            assert!(!try_one(operations, fault, power_lost), "the one behind the last is none of the submission's");
        }
    }
}

#[test]
fn every_operation_of_a_start_may_fail() {
    for records in [0, 3] {
        for fault in FAULTS {
            let mut nth = 0;
            loop {
                let (store, signed) = if records == 0 {
                    (FaultyStore::new(), vec![])
                } else {
                    let (store, registry) = begun();
                    (store, vec![registry.checkpoint()])
                };
                store.fail_at(nth, fault);
                let opened = open(&store).is_ok();
                store.heal();
                for found in [store.crash(), store.clone()] {
                    let registry = open(&found).unwrap_or_else(|e| panic!("operation {nth}, {fault:?}: {e}"));
                    assert_eq!(registry.size(), 2 * records);
                    must_honour(&registry, &signed, &[]);
                }
                if opened {
                    break;
                }
                nth += 1;
            }
            assert!(nth > 3, "a start reads format, leaves and the signed checkpoint");
        }
    }
}

#[test]
fn a_store_that_contradicts_what_was_signed_is_refused() {
    let leaf = |index: u64| [b"leaf/", &index.to_be_bytes()[..]].concat();
    let inconsistent = |store: &FaultyStore, part: &str| match open(&store.crash()) {
        Err(e @ RegistryError::Inconsistent { .. }) => assert!(e.to_string().contains(part), "{e}"),
        Err(other) => panic!("{other}"),
        Ok(_) => panic!("opened; expected a word about {part}"),
    };
    let (store, _) = begun();
    assert!(store.remove_entry(&leaf(5)));
    inconsistent(&store, "5 leaves, a checkpoint over 6 was signed");
    let (store, _) = begun();
    assert!(store.remove_entry(&leaf(1)));
    inconsistent(&store, "leaf 1: missing");
    for byte in [0, 1, 50, 161] {
        let (store, _) = begun();
        assert!(store.tamper(&leaf(0), |value| value[byte] ^= 1));
        inconsistent(&store, "was signed");
    }
    let (store, _) = begun();
    assert!(store.tamper(&leaf(0), |value| value.truncate(161)));
    inconsistent(&store, "161 bytes, expected 162");
    let (store, _) = begun();
    assert!(store.remove_entry(b"meta/signed"));
    inconsistent(&store, "last signed checkpoint");
    let (store, _) = begun();
    assert!(store.remove_entry(b"meta/format"));
    inconsistent(&store, "no format version");
}

#[test]
fn a_store_of_another_log_key_or_format_is_refused_by_name() {
    let (store, _) = begun();
    let wrong = |result: Result<Registry, RegistryError>, part: &str| match result {
        Err(RegistryError::WrongStore { what, .. }) => assert_eq!(what, part),
        Err(other) => panic!("{other}"),
        Ok(_) => panic!("opened with the wrong {part}"),
    };
    wrong(open_as(&store, registry_key(), "other.example/log"), "origin");
    wrong(open_as(&store, owner(5), ORIGIN), "registry key");
    store.tamper(b"meta/format", |value| value.push(b'0'));
    wrong(open(&store), "format");
}

#[test]
fn a_rotten_envelope_is_named_and_the_rest_stays_readable() {
    let (store, registry) = begun();
    // Somewhere inside the second record's envelope: frames 0 and 1 come before it.
    let first = registry.record(0).unwrap().envelope.to_json().len() + 5;
    assert!(store.tamper_file("envelopes/000", |pack| pack[first + 4 + 5 + 60] ^= 1));
    let faults = registry.check().unwrap();
    assert_eq!(faults.len(), 1);
    assert!(faults[0].to_string().contains("record 2"), "{}", faults[0]);
    assert!(registry.record(2).is_err());
    assert!(registry.record(4).is_ok());
}

#[test]
fn a_store_restored_from_an_old_backup_is_noticed_and_writes_no_second_history() {
    let (store, registry) = begun();
    let backup = store.crash();
    let log = registry.verifier().unwrap();
    let receipt = submit(&registry, &owner(2), "trex", "behind the backup").unwrap();
    let known = Checkpoint::verify(&receipt.checkpoint, &log).unwrap();
    registry.must_extend(&known).unwrap();
    let restored = open(&backup).unwrap();
    let refused = restored.must_extend(&known).unwrap_err();
    assert!(refused.to_string().contains("6 leaves, known is a checkpoint over 8"), "{refused}");
    let refused = submit(&restored, &owner(3), "fern", "a fork").unwrap_err();
    assert!(matches!(refused, RegistryError::Halted { .. }), "{refused}");
    // A log that has gone on differently.
    let forked = open(&backup).unwrap();
    submit(&forked, &owner(3), "fern", "a fork").unwrap();
    let refused = forked.must_extend(&known).unwrap_err();
    assert!(refused.to_string().contains("root at size 8"), "{refused}");
    let foreign = Checkpoint { origin: "other.example/log".into(), ..known };
    assert!(matches!(registry.must_extend(&foreign), Err(RegistryError::WrongOrigin { .. })));
}
