//! The store whose rows move into sorted runs: whatever moved, failed, was stopped or lost power in between, it holds what
//! a plain map would, and a file that rots is named.
#![cfg(feature = "store")]

use std::{
    collections::BTreeMap,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use crate::common::*;
use cairn_durable::{Disk as _, Fault, Files, RealDisk};
use cairn_log::{
    Digest, MapKey, Registry,
    log::store::{Change, Cold, FaultyStore, Store, StoreError, TieredStore},
};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

const COLD: &[Cold] = &[Cold { prefix: b"a/", looked_up: true }, Cold { prefix: b"c/", looked_up: false }];
const ENOUGH: usize = 30;

type Model = BTreeMap<Vec<u8>, Vec<u8>>;

fn open(disk: &FaultyStore) -> Result<TieredStore, StoreError> {
    let files = Arc::new(Files::new(Box::new(disk.clone())));
    TieredStore::open(Box::new(disk.clone()), files, "runs", COLD, ENOUGH)
}

fn never() -> bool {
    false
}

/// A batch of rows, cold and not; some of them are written again, some that are not cold are taken away.
fn batch(random: &mut ChaCha8Rng, model: &mut Model) -> Vec<Change> {
    let changes: Vec<Change> = (0..random.random_range(1..20))
        .map(|_| {
            let number: u32 = random.random_range(0..400);
            let prefix = ["a/", "b/", "c/"][random.random_range(0..3)];
            let key = [prefix.as_bytes(), Digest::of(number.to_be_bytes()).as_bytes()].concat();
            let value = vec![random.random(); random.random_range(0..300)];
            let is_gone = prefix == "b/" && random.random_bool(0.3);
            (key, (!is_gone).then_some(value))
        })
        .collect();
    for (key, value) in &changes {
        match value {
            Some(value) => drop(model.insert(key.clone(), value.clone())),
            None => drop(model.remove(key)),
        }
    }
    changes
}

fn must_be(store: &TieredStore, model: &Model) {
    let all = store.range(&[], None, usize::MAX).unwrap();
    // Its own rows are there as well, beside those that it was given.
    let all: Vec<_> = all.into_iter().filter(|(key, _)| key[1] == b'/').collect();
    assert_eq!(all, model.clone().into_iter().collect::<Vec<_>>());
    for number in 0..400_u32 {
        for prefix in ["a/", "b/", "c/"] {
            let key = [prefix.as_bytes(), Digest::of(number.to_be_bytes()).as_bytes()].concat();
            assert_eq!(store.get(&key).unwrap().as_ref(), model.get(&key));
        }
    }
    let mut random = ChaCha8Rng::seed_from_u64(model.len() as u64);
    let mut key = || [["", "a/", "b/", "c/", "c0"][random.random_range(0..5)].as_bytes(), &[random.random()]].concat();
    for limit in [1, 9, 400, usize::MAX] {
        let (from, to) = (key(), key());
        let expected = model.iter().filter(|(key, _)| **key >= from && **key < to).take(limit);
        let expected: Vec<_> = expected.map(|(key, value)| (key.clone(), value.clone())).collect();
        let found = store.range(&from, Some(&to), usize::MAX).unwrap();
        let found: Vec<_> = found.into_iter().filter(|(key, _)| key[1] == b'/').take(limit).collect();
        assert_eq!(found, expected, "from {from:?} to {to:?}");
    }
    for (prefix, from, limit) in [("a/", 0x00, 7), ("a/", 0x80, 400), ("c/", 0xf0, 400), ("b/", 0, 3), ("d/", 0, 3)] {
        let from = [from];
        let start = [prefix.as_bytes(), &from].concat();
        let expected = model.range(start..).take_while(|(key, _)| key.starts_with(prefix.as_bytes())).take(limit);
        let expected: Vec<_> = expected.map(|(key, value)| (key.clone(), value.clone())).collect();
        assert_eq!(store.scan(prefix.as_bytes(), &from, limit).unwrap(), expected, "{prefix} from {from:?}");
    }
}

#[test]
fn it_holds_what_a_plain_map_would_and_its_store_stays_small() {
    for seed in 0..6 {
        let (mut random, mut model, disk) = (ChaCha8Rng::seed_from_u64(seed), Model::new(), FaultyStore::new());
        let mut store = open(&disk).unwrap();
        for round in 0..60 {
            store.put(batch(&mut random, &mut model)).unwrap();
            store.flush().unwrap();
            if random.random_bool(0.5) {
                store.tidy(&never).unwrap();
            }
            if round % 10 == 9 {
                must_be(&store, &model);
                store = open(&if random.random_bool(0.5) { disk.crash() } else { disk.clone() }).unwrap();
                must_be(&store, &model);
                store = open(&disk).unwrap();
            }
        }
        store.tidy(&never).unwrap();
        must_be(&store, &model);
        let hot = disk.keys().iter().filter(|key| !key.starts_with(b"b/")).count();
        assert!(hot <= ENOUGH, "{hot} cold rows in the store, {} in all", model.len());
        let runs = disk.paths();
        assert!((1..12).contains(&runs.len()), "merged, and what was merged is gone: {runs:?}");
        let known = store.known_files();
        assert_eq!(known.len(), runs.len());
        for file in known {
            let bytes = disk.read(&file.path, u64::MAX).unwrap().unwrap();
            assert_eq!((bytes.len() as u64, Digest::of(&bytes)), (file.size, file.sha256));
        }
    }
}

/// A store with two runs of its own making, and rows for more.
fn begun() -> (FaultyStore, TieredStore, Model) {
    let (mut random, mut model, disk) = (ChaCha8Rng::seed_from_u64(9), Model::new(), FaultyStore::new());
    let store = open(&disk).unwrap();
    // The last of them is the fourth of its level: it is followed by a merger.
    for run in 0..4 {
        for _ in 0..12 {
            store.put(batch(&mut random, &mut model)).unwrap();
        }
        store.flush().unwrap();
        if run < 3 {
            store.tidy(&never).unwrap();
        }
    }
    (disk, store, model)
}

#[test]
fn whatever_fails_while_rows_move_no_row_is_lost() {
    let (disk, store, _) = begun();
    let before = disk.operations();
    store.tidy(&never).unwrap();
    let operations = disk.operations() - before;
    assert!(operations > 40, "reads, a run written and named, rows taken out, a merger: {operations}");
    assert_eq!(store.known_files().len(), 1, "four became one");
    for fault in [Fault::Before, Fault::After] {
        for nth in 0..operations {
            let (disk, store, mut model) = begun();
            disk.fail_at(nth, fault);
            // Whether it says so or not: what fails behind the merger's manifest is made good by the next one.
            let _ = store.tidy(&never);
            disk.heal();
            must_be(&store, &model);
            for found in [disk.crash(), disk.clone()] {
                let again = open(&found).unwrap_or_else(|e| panic!("operation {nth}, {fault:?}: {e}"));
                must_be(&again, &model);
                again.tidy(&never).unwrap();
                must_be(&again, &model);
                let (files, runs) = (found.paths(), again.known_files());
                assert_eq!(files.len(), runs.len(), "operation {nth}, {fault:?}: {files:?} are there");
            }
            // The one that it happened to goes on, unless its store failed, and leaves no file that nobody knows.
            if store.tidy(&never).is_ok() {
                let (files, runs) = (disk.paths(), store.known_files());
                assert!(files.len() <= runs.len() + 1, "operation {nth}, {fault:?}: {files:?} are there");
            }
            drop(store);
            let store = open(&disk).unwrap();
            store.put(batch(&mut ChaCha8Rng::seed_from_u64(nth), &mut model)).unwrap();
            must_be(&store, &model);
        }
    }
}

#[test]
fn a_store_that_failed_while_rows_moved_takes_no_more() {
    let (mut nth, mut refused) = (0, 0);
    loop {
        let (disk, store, mut model) = begun();
        disk.fail_at(nth, Fault::Before);
        if store.tidy(&never).is_ok() {
            break;
        }
        let written = store.put(batch(&mut ChaCha8Rng::seed_from_u64(1), &mut model)).and_then(|()| store.flush());
        refused += u32::from(written.is_err());
        nth += 1;
    }
    assert!(refused > 2 && u64::from(refused) < nth, "{refused} of {nth} failures are of the store and not of a file");
}

#[test]
fn it_can_be_stopped_at_any_moment() {
    let mut after = 0;
    loop {
        let (disk, store, model) = begun();
        let asked = std::cell::Cell::new(0);
        store.tidy(&|| asked.replace(asked.get() + 1) == after).unwrap();
        must_be(&store, &model);
        assert!(disk.paths().iter().all(|path| !path.ends_with(".new")), "{:?}", disk.paths());
        if asked.get() <= after {
            break;
        }
        store.tidy(&never).unwrap();
        must_be(&store, &model);
        after += 1;
    }
    assert!(after >= 2, "asked {after} times");
}

#[test]
fn others_write_while_rows_move() {
    let folder = tempfile::tempdir().unwrap();
    let disk = FaultyStore::new();
    let files = Arc::new(Files::new(Box::new(RealDisk::new(folder.path()))));
    let store = TieredStore::open(Box::new(disk), files, "deep/runs", COLD, ENOUGH).unwrap();
    let (mut random, mut model, done) = (ChaCha8Rng::seed_from_u64(3), Model::new(), AtomicBool::new(false));
    std::thread::scope(|scope| {
        let tidier = scope.spawn(|| {
            while !done.load(Ordering::Relaxed) {
                store.tidy(&never).unwrap();
            }
        });
        for round in 0..3000 {
            store.put(batch(&mut random, &mut model)).unwrap();
            if round % 500 == 0 {
                // Also in between: a row is somewhere at every moment.
                must_be(&store, &model);
            }
        }
        done.store(true, Ordering::Relaxed);
        tidier.join().unwrap();
    });
    must_be(&store, &model);
    assert!(!store.known_files().is_empty());
}

#[test]
fn a_byte_that_changed_in_a_run_is_named_and_never_believed() {
    let (disk, store, model) = begun();
    store.tidy(&never).unwrap();
    drop(store);
    let path = disk.paths().into_iter().find(|path| path.starts_with("runs/")).unwrap();
    let length = disk.read(&path, u64::MAX).unwrap().unwrap().len();
    for at in 0..length {
        assert!(disk.tamper_file(&path, |bytes| bytes[at] ^= 0x10));
        let said = match open(&disk) {
            Err(e) => e,
            Ok(store) => match store.range(&[], None, usize::MAX) {
                Err(e) => e,
                // Bits of the filter are under a checksum as well, so nothing gets this far.
                Ok(_) => panic!("byte {at} of {length} went unnoticed"),
            },
        };
        assert!(said.to_string().contains(&path), "byte {at}: {said}");
        assert!(disk.tamper_file(&path, |bytes| bytes[at] ^= 0x10));
    }
    must_be(&open(&disk).unwrap(), &model);
    disk.tamper_file(&path, |bytes| bytes.truncate(length - 1));
    assert!(open(&disk).err().unwrap().to_string().contains(&path));
    Files::new(Box::new(disk.clone())).remove(&path).unwrap();
    assert!(open(&disk).err().unwrap().to_string().contains("missing"));
}

#[test]
fn rows_that_only_accumulate_are_not_taken_away() {
    let (_, store, model) = begun();
    let refused = store.put(vec![(b"b/x".to_vec(), Some(vec![1])), (b"a/x".to_vec(), None)]).unwrap_err();
    assert!(refused.to_string().contains("not taken away"), "{refused}");
    must_be(&store, &model);
}

/// A log whose rows move as soon as there are a few.
fn open_log(store: &FaultyStore) -> Registry {
    Registry::open_tiered(Box::new(store.clone()), Box::new(store.clone()), registry_key(), ORIGIN, 8, None).unwrap()
}

#[test]
fn a_log_whose_rows_moved_is_the_log_that_it_was() {
    let store = FaultyStore::new();
    let mut registry = open_log(&store);
    let mut taken = Vec::new();
    for round in 0..24_u64 {
        let scene = format!("scene {}", round % 5);
        taken.push(submit(&registry, &owner((round % 7) as u8 + 1), &scene, &round.to_string()).unwrap());
        registry.tidy(&never).unwrap();
        if round % 6 == 5 {
            registry = open_log(&store.crash());
            assert!(registry.check().unwrap().is_empty());
            registry = open_log(&store);
        }
    }
    assert!(store.paths().iter().any(|path| path.starts_with("working/runs/")), "{:?}", store.paths());
    for receipt in &taken {
        assert_eq!(registry.find(&receipt.envelope.digest()).unwrap(), Some(receipt.index));
        let again = take(&registry, &receipt.envelope).unwrap();
        assert!(again.resubmitted && again.index == receipt.index);
    }
    for scene in 0..5 {
        let scene = format!("scene {scene}");
        let answer = registry.answer(&scene, None, None, usize::MAX).unwrap();
        let listed: Vec<_> = registry.listed(&MapKey::scene(&scene), 0, usize::MAX).unwrap();
        assert_eq!(answer.records.len(), listed.len());
        assert!((4..=5).contains(&listed.len()));
    }
    assert!(registry.check().unwrap().is_empty());
}
