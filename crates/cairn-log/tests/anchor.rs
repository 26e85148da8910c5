//! The anchor: a store that is restored whole from an older backup is refused, with nobody else to ask. Each operation on the
//! anchor's file is made to fail in turn, with and without a power cut, and none may cost the log a start.
#![cfg(feature = "store")]

use crate::common::*;
use cairn_durable::Fault;
use cairn_log::{Anchor, Registry, RegistryError, log::store::FaultyStore};

const FILE: &str = "log.anchor";

/// A log and its anchor, each on a disk of its own.
#[derive(Clone, Default)]
struct Disks {
    log: FaultyStore,
    anchor: FaultyStore,
}

impl Disks {
    fn open(&self) -> Result<Registry, RegistryError> {
        self.open_with(Some(Anchor::on(Box::new(self.anchor.clone()), FILE)))
    }

    fn open_with(&self, anchor: Option<Anchor>) -> Result<Registry, RegistryError> {
        let (store, disk) = (Box::new(self.log.clone()), Box::new(self.log.clone()));
        Registry::open_tiered(store, disk, registry_key(), ORIGIN, 1 << 17, anchor)
    }

    fn accept(&self) -> Result<Registry, RegistryError> {
        self.open_with(Some(Anchor::on(Box::new(self.anchor.clone()), FILE).made_where_missing()))
    }

    fn crash(&self) -> Self {
        Self { log: self.log.crash(), anchor: self.anchor.crash() }
    }

    fn text(&self) -> String {
        let mut text = Vec::new();
        assert!(self.anchor.tamper_file(FILE, |bytes| text.clone_from(bytes)));
        String::from_utf8(text).unwrap()
    }

    fn refused(&self) -> RegistryError {
        self.open().err().expect("it is refused")
    }
}

/// An anchored log of three records.
fn begun() -> (Disks, Registry) {
    let disks = Disks::default();
    let registry = disks.open().unwrap();
    for what in ["a", "b", "c"] {
        submit(&registry, &owner(1), "fern", what).unwrap();
    }
    (disks, registry)
}

#[test]
fn it_is_durable_before_a_signature_leaves() {
    let (disks, registry) = begun();
    let head = registry.head().unwrap();
    let found = disks.anchor.crash();
    let text = Disks { anchor: found, ..disks }.text();
    let body = format!("cairn-anchor/1\n{}", head.to_text());
    assert_eq!(text, format!("{body}sha256 {}\n", cairn_log::Digest::of(&body)));
}

#[test]
fn an_older_log_is_refused_and_so_is_another() {
    let (disks, registry) = begun();
    let backup = disks.log.crash();
    submit(&registry, &owner(2), "trex", "behind the backup").unwrap();
    drop(registry);
    let restored = Disks { log: backup.clone(), ..disks.clone() };
    let refused = restored.refused();
    assert!(matches!(refused, RegistryError::RolledBack { anchored: 8, size: 6, .. }), "{refused}");
    let said = refused.to_string();
    for part in [FILE, "over 8", "holds 6", "restore the newest"] {
        assert!(said.contains(part), "{said}");
    }
    // Looking at it changed nothing.
    assert!(matches!(restored.refused(), RegistryError::RolledBack { anchored: 8, size: 6, .. }));
    assert!(matches!(restored.accept().err(), Some(RegistryError::RolledBack { .. })), "nobody accepts an older log");
    // One that has gone on differently, with nobody to hold it: to the same size, and further.
    let forked = Disks { log: backup, ..Disks::default() };
    for what in ["a fork", "and on"] {
        submit(&forked.open_with(None).unwrap(), &owner(3), "fern", what).unwrap();
        let refused = Disks { anchor: disks.anchor.clone(), ..forked.clone() }.refused();
        assert!(matches!(refused, RegistryError::RolledBack { anchored: 8, .. }), "{refused}");
        assert!(refused.to_string().contains("its root at that size"), "{refused}");
    }
    // An emptied folder is an older one.
    let emptied = Disks { log: FaultyStore::new(), ..disks.clone() };
    assert!(matches!(emptied.refused(), RegistryError::RolledBack { anchored: 8, size: 0, .. }));
    // And the newest goes on.
    submit(&disks.open().unwrap(), &owner(2), "trex", "next").unwrap();
}

#[test]
fn a_missing_anchor_is_made_for_an_empty_log_and_else_only_where_it_is_accepted() {
    let (disks, registry) = begun();
    drop(registry);
    let lost = Disks { anchor: FaultyStore::new(), ..disks.clone() };
    let refused = lost.refused();
    assert!(matches!(refused, RegistryError::AnchorMissing { size: 6, .. }), "{refused}");
    assert!(refused.to_string().contains("cairn registry anchor --accept"), "{refused}");
    assert!(lost.anchor.paths().is_empty(), "a start made it anew all the same");
    drop(lost.accept().unwrap());
    submit(&lost.open().unwrap(), &owner(2), "trex", "goes on").unwrap();
    // A log that went on without it is behind nobody.
    submit(&lost.open_with(None).unwrap(), &owner(2), "trex", "unanchored").unwrap();
    let registry = lost.open().unwrap();
    assert_eq!(registry.size(), 10);
    assert!(lost.text().contains("\n10\n"));
}

#[test]
fn a_damaged_or_foreign_anchor_is_refused_by_name() {
    let (disks, registry) = begun();
    drop(registry);
    let bad = |change: &dyn Fn(&mut Vec<u8>), part: &str| {
        let bent = disks.crash();
        assert!(bent.anchor.tamper_file(FILE, |bytes| change(bytes)));
        for refused in [bent.refused(), bent.accept().err().expect("accepting is for missing ones")] {
            assert!(matches!(refused, RegistryError::BadAnchor { .. }), "{refused}");
            assert!(refused.to_string().contains(part), "{refused}");
        }
    };
    let text = disks.text();
    for at in 0..text.len() {
        bad(&|bytes| bytes[at] ^= 1, FILE);
        bad(&|bytes| bytes.truncate(at), FILE);
    }
    bad(&|bytes| bytes.extend(*b"\n"), "damaged");
    let other = |from: &str, to: &str| {
        let body = text.rsplit_once("sha256 ").unwrap().0.replace(from, to);
        format!("{body}sha256 {}\n", cairn_log::Digest::of(&body)).into_bytes()
    };
    bad(&|bytes| *bytes = other("cairn-anchor/1", "cairn-anchor/2"), "this release reads \"cairn-anchor/1\"");
    bad(&|bytes| *bytes = other(ORIGIN, "other.example/log"), "give each log its own");
    bad(&|bytes| *bytes = other("\n6\n", "\nsix\n"), "a size in decimal");
}

/// A submission during which the `nth` operation on the log's disk or on the anchor's fails; whether it was told.
fn try_one(nth: u64, of_anchor: bool, fault: Fault, power_lost: bool) -> bool {
    let (disks, registry) = begun();
    let envelope = sealed(&registry, &owner(2), "trex", "the one");
    let mut signed = vec![registry.checkpoint()];
    let faulty = if of_anchor { &disks.anchor } else { &disks.log };
    faulty.fail_at(nth, fault);
    let outcome = take(&registry, &envelope);
    faulty.heal();
    signed.push(registry.checkpoint());
    let acknowledged: Vec<_> = outcome.iter().map(|receipt| receipt.envelope.clone()).collect();
    drop(registry);
    let found = if power_lost { disks.crash() } else { disks };
    let what = format!("operation {nth} of the {}, {fault:?}", if of_anchor { "anchor" } else { "log" });
    // Opened twice: what the first start does must not be in the second one's way.
    drop(found.open().unwrap_or_else(|e| panic!("{what}: {e}")));
    let registry = found.open().unwrap_or_else(|e| panic!("{what}, once more: {e}"));
    must_honour(&registry, &signed, &acknowledged);
    verify_receipt(&registry, &take(&registry, &envelope).unwrap());
    assert_eq!(records(&registry, Some("trex")).len(), 1, "{what}: the retry made a second record");
    outcome.is_err()
}

#[test]
fn whatever_fails_in_a_round_the_log_opens_and_honours_what_it_signed() {
    let (disks, registry) = begun();
    let envelope = sealed(&registry, &owner(2), "trex", "the one");
    let before = (disks.log.operations(), disks.anchor.operations());
    take(&registry, &envelope).unwrap();
    let made = (disks.log.operations() - before.0, disks.anchor.operations() - before.1);
    assert_eq!(made.1, 4, "written, flushed, renamed, and its folder flushed");
    for power_lost in [false, true] {
        for fault in [Fault::Before, Fault::After] {
            for (of_anchor, operations) in [(false, made.0), (true, made.1)] {
                for nth in 0..operations {
                    assert!(try_one(nth, of_anchor, fault, power_lost), "operation {nth} failed and nobody was told");
                }
                assert!(!try_one(operations, of_anchor, fault, power_lost));
            }
        }
    }
}

#[test]
fn a_round_that_only_the_anchor_and_the_packs_know_of_is_taken_in_by_the_start() {
    let (disks, registry) = begun();
    let before = disks.log.crash();
    let envelopes: Vec<_> = (0..3).map(|n| sealed(&registry, &owner(2), "trex", &n.to_string())).collect();
    for envelope in &envelopes {
        take(&registry, envelope).unwrap();
    }
    drop(registry);
    // The rows of the last round are lost, its envelopes are not: each lies in the pack behind the others.
    let whole = disks.log.crash();
    let mut pack = Vec::new();
    assert!(whole.tamper_file("envelopes/000", |bytes| pack.clone_from(bytes)));
    let behind = |rounds: u64, pack: &[u8]| {
        let log = before.crash();
        let anchored = Disks { log, ..Disks::default() };
        let registry = anchored.open_with(None).unwrap();
        for envelope in &envelopes[..rounds as usize] {
            take(&registry, envelope).unwrap();
        }
        drop(registry);
        assert!(anchored.log.tamper_file("envelopes/000", |bytes| *bytes = pack.to_vec()));
        Disks { anchor: disks.anchor.crash(), ..anchored }
    };
    let found = behind(2, &pack);
    let registry = found.open().unwrap();
    assert_eq!(registry.size(), 12);
    assert!(registry.find(&envelopes[2].digest()).unwrap().is_some());
    must_honour(&registry, &[], &envelopes);
    submit(&registry, &owner(3), "fern", "goes on").unwrap();
    assert!(registry.check().unwrap().is_empty());
    // Two rounds behind is no crash; nor are envelopes that were cut short, or others.
    for (rounds, pack) in
        [(1, pack.clone()), (2, pack[..pack.len() - 1].to_vec()), (2, pack[..pack.len() - 5].to_vec())]
    {
        let refused = behind(rounds, &pack).refused();
        assert!(matches!(refused, RegistryError::RolledBack { anchored: 12, .. }), "{refused}");
    }
    let other = {
        let forked = Disks { log: before.crash(), ..Disks::default() };
        let registry = forked.open_with(None).unwrap();
        for envelope in &envelopes[..2] {
            take(&registry, envelope).unwrap();
        }
        submit(&registry, &owner(3), "fern", "another").unwrap();
        let mut bytes = Vec::new();
        assert!(forked.log.tamper_file("envelopes/000", |pack| bytes.clone_from(pack)));
        bytes
    };
    let refused = behind(2, &other).refused();
    assert!(refused.to_string().contains("one more round are there and give root"), "{refused}");
}

#[test]
fn every_operation_of_a_start_may_fail() {
    for records in [0, 3] {
        for fault in [Fault::Before, Fault::After] {
            let mut nth = 0;
            loop {
                let (disks, signed) = if records == 0 {
                    (Disks::default(), vec![])
                } else {
                    let (disks, registry) = begun();
                    (disks, vec![registry.checkpoint()])
                };
                disks.anchor.fail_at(nth, fault);
                let opened = disks.open().is_ok();
                disks.anchor.heal();
                for found in [disks.crash(), disks.clone()] {
                    let registry = found.open().unwrap_or_else(|e| panic!("operation {nth}, {fault:?}: {e}"));
                    assert_eq!(registry.size(), 2 * records);
                    must_honour(&registry, &signed, &[]);
                }
                if opened {
                    break;
                }
                nth += 1;
            }
            assert!(nth >= 5, "a start reads the anchor and writes it");
        }
    }
}
