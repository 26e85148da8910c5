//! What monitors read, over a log's growth, faults and restarts: files that follow from the leaves, and a checkpoint that
//! never runs ahead of them.
#![cfg(feature = "store")]

use crate::common::*;
use cairn_durable::{Disk as _, Fault};
use cairn_log::{
    Checkpoint, LogEntry, Registry, RegistryError,
    format::{
        map::MapKey,
        map_leaf::Entry,
        merkle,
        packs::{self, Slot},
        tile::{TilePath, decode_entries},
    },
    log::store::FaultyStore,
};

fn open(store: &FaultyStore) -> Result<Registry, RegistryError> {
    Registry::open_store(Box::new(store.clone()), Box::new(store.clone()), registry_key(), ORIGIN)
}

fn file(store: &FaultyStore, path: &str) -> Option<Vec<u8>> {
    store.read(path, u64::MAX).unwrap()
}

/// Reads the log as a stranger does: checkpoint, tiles and bundles, from the files alone.
fn read_by_a_monitor(store: &FaultyStore, registry: &Registry) -> (u64, Vec<Vec<u8>>) {
    let note = String::from_utf8(file(store, "public/checkpoint").unwrap()).unwrap();
    let checkpoint = Checkpoint::verify(&note, &registry.verifier().unwrap()).unwrap();
    let mut leaves = Vec::new();
    for index in 0.. {
        let Some(path) = TilePath::in_tree(cairn_log::format::tile::TileKind::Entries, index, checkpoint.size) else {
            break;
        };
        let bundle = file(store, &format!("public/{path}")).unwrap_or_else(|| panic!("{path} is missing"));
        leaves.extend(decode_entries(&bundle).unwrap().into_iter().map(<[u8]>::to_vec));
    }
    let mut tree = cairn_log::format::testing::Tree::new();
    for leaf in &leaves {
        tree.push(merkle::leaf_hash(leaf));
    }
    assert_eq!((tree.size(), tree.root()), (checkpoint.size, checkpoint.root));
    for path in TilePath::all(checkpoint.size) {
        assert_eq!(file(store, &format!("public/{path}")), path.cut(&tree, checkpoint.size), "{path}");
    }
    (checkpoint.size, leaves)
}

#[test]
fn a_monitor_rebuilds_the_log_from_the_files_as_it_grows() {
    let store = FaultyStore::new();
    let registry = open(&store).unwrap();
    assert_eq!(registry.publish().unwrap().size, 0);
    let mut of_records = 0;
    for round in 0..3 {
        for i in 0..100 {
            submit(&registry, &owner(1), "fern", &format!("{round}/{i}")).unwrap();
            of_records += 1;
        }
        let published = registry.publish().unwrap();
        assert_eq!((published.size, Some(&published)), (registry.size(), registry.published().as_ref()));
        let (size, leaves) = read_by_a_monitor(&store, &registry);
        assert_eq!(size, registry.size());
        let records = leaves.iter().filter(|leaf| matches!(Entry::decode(leaf), Ok(Entry::Record(_))));
        assert_eq!(records.count(), of_records);
    }
    // Full bundles have taken their partial forms' place, and their leaves are out of the store.
    assert!(store.paths().iter().all(|path| !path.starts_with("public/tile/0/000.p")));
    assert!(!store.keys().iter().any(|key| key.as_slice() == [b"leaf/", &[0; 8][..]].concat()));
    assert!(registry.check().unwrap().is_empty());
    drop(registry);
    let registry = open(&store.crash()).unwrap();
    assert_eq!(registry.size(), 600);
    assert!(registry.check().unwrap().is_empty());
    assert_eq!(registry.tile(&"tile/0/001.p/7".parse().unwrap()).unwrap().unwrap().len(), 7 * 32);
}

#[test]
fn every_operation_of_a_publication_may_fail_and_the_next_makes_it_good() {
    let grown = FaultyStore::new();
    let registry = open(&grown).unwrap();
    for i in 0..127 {
        submit(&registry, &owner(1), "fern", &i.to_string()).unwrap();
    }
    registry.publish().unwrap();
    for i in 127..131 {
        submit(&registry, &owner(1), "fern", &i.to_string()).unwrap();
    }
    drop(registry);
    let begun = || {
        let store = grown.crash();
        let registry = open(&store).unwrap();
        (store, registry)
    };
    let (store, registry) = begun();
    let before = store.operations();
    registry.publish().unwrap();
    let operations = store.operations() - before;
    assert!(operations > 30, "{operations}");
    for fault in [Fault::Before, Fault::After] {
        for nth in 0..operations {
            let (store, registry) = begun();
            store.fail_at(nth, fault);
            assert!(registry.publish().is_err(), "operation {nth} failed and nobody was told");
            // What monitors see meanwhile holds together, whichever checkpoint it is, also after a loss of power.
            let lost = store.crash();
            for found in [&store, &lost] {
                let note = String::from_utf8(file(found, "public/checkpoint").unwrap()).unwrap();
                let seen = Checkpoint::verify(&note, &registry.verifier().unwrap()).unwrap();
                if seen.size == registry.size() {
                    read_by_a_monitor(found, &registry);
                }
            }
            registry.publish().unwrap();
            read_by_a_monitor(&store, &registry);
            drop(registry);
            let registry = open(&lost).unwrap();
            registry.publish().unwrap();
            assert_eq!(read_by_a_monitor(&lost, &registry).0, 262);
            assert!(registry.check().unwrap().is_empty(), "operation {nth}, {fault:?}");
        }
    }
}

#[test]
fn a_store_older_than_what_monitors_saw_is_refused() {
    let store = FaultyStore::new();
    let registry = open(&store).unwrap();
    submit(&registry, &owner(1), "fern", "a").unwrap();
    registry.publish().unwrap();
    let backup = store.crash();
    submit(&registry, &owner(1), "fern", "b").unwrap();
    registry.publish().unwrap();
    let newer = file(&store, "public/checkpoint").unwrap();
    assert!(backup.tamper_file("public/checkpoint", |bytes| *bytes = newer));
    let refused = open(&backup).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(refused.contains("2 leaves, known is a checkpoint over 4"), "{refused}");
    assert!(backup.tamper_file("public/checkpoint", |bytes| bytes[30] ^= 1));
    let refused = open(&backup).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(refused.contains("public/checkpoint"), "{refused}");
}

#[test]
fn an_erased_record_leaves_its_leaf_its_proofs_and_its_place_in_the_map() {
    let store = FaultyStore::new();
    let registry = open(&store).unwrap();
    let receipts: Vec<_> = (0..3).map(|i| submit(&registry, &owner(1), "fern", &i.to_string()).unwrap()).collect();
    let head = registry.head().unwrap();
    registry.erase_index(2).unwrap();
    registry.erase_index(2).unwrap();
    assert!(matches!(registry.record(2), Err(RegistryError::Erased { index: 2 })));
    assert!(matches!(registry.erase_index(3), Err(RegistryError::NotARecord { index: 3 })));
    verify_receipt(&registry, &receipts[1]);
    assert_eq!(registry.head().unwrap(), head, "nothing of the log moved");
    let pack = file(&store, "envelopes/000").unwrap();
    let (slots, _) = packs::parse(&pack, 256).unwrap();
    assert!(matches!(&slots[2], Slot::Erased(keys) if keys.contains(&MapKey::scene("fern"))));
    assert!(!String::from_utf8_lossy(&pack).contains(&receipts[1].envelope.to_json()));
    // The log goes on behind it, and is found whole by the next start.
    submit(&registry, &owner(1), "fern", "more").unwrap();
    registry.erase_index(6).unwrap();
    let registry = open(&store.crash()).unwrap();
    assert!(registry.check().unwrap().is_empty());
    submit(&registry, &owner(2), "fern", "still more").unwrap();
    let kinds: Vec<_> = registry.page(Some("fern"), 0, 99).unwrap();
    let erased = kinds.iter().map(|entry| matches!(entry, LogEntry::Erased { .. })).collect::<Vec<_>>();
    assert_eq!(erased, [false, true, false, true, false]);
    assert_eq!(records(&registry, Some("fern")).len(), 3);
    // The same record again is known, and not taken in anew.
    assert!(matches!(take(&registry, &receipts[1].envelope), Err(RegistryError::Erased { index: 2 })));
}

#[test]
fn every_operation_of_an_erasure_may_fail() {
    for fault in [Fault::Before, Fault::After] {
        for nth in 0.. {
            let store = FaultyStore::new();
            let registry = open(&store).unwrap();
            let receipt = submit(&registry, &owner(1), "fern", "a").unwrap();
            store.fail_at(nth, fault);
            let failed = registry.erase_index(0).is_err();
            store.heal();
            for found in [store.crash(), store.clone()] {
                let registry = open(&found).unwrap();
                assert!(registry.check().unwrap().is_empty(), "operation {nth}, {fault:?}");
                if !failed {
                    assert!(matches!(registry.record(0), Err(RegistryError::Erased { .. })));
                }
                registry.erase_index(0).unwrap();
                assert!(matches!(take(&registry, &receipt.envelope), Err(RegistryError::Erased { .. })));
                submit(&registry, &owner(1), "fern", "b").unwrap();
            }
            if !failed {
                assert!(nth > 5, "it reads, writes, flushes and renames");
                break;
            }
        }
    }
}
