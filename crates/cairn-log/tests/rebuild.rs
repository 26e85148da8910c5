//! The working state made again from leaves and envelopes is the one that was lost, or it is said what stands against it.
#![cfg(feature = "store")]

use crate::common::*;
use cairn_durable::{Disk as _, Files};
use cairn_log::{
    Digest, Receipt, RecordKind, Registry, RegistryError,
    log::{Rebuilt, store::FaultyStore},
};

const SCENES: [&str; 3] = ["fern", "trex", "liberty"];

/// Over a store and a disk of its own each: a rebuilt store stands beside the old one.
fn open(store: &FaultyStore, disk: &FaultyStore) -> Result<Registry, RegistryError> {
    Registry::open_tiered(Box::new(store.clone()), Box::new(disk.clone()), registry_key(), ORIGIN, 40, None)
}

/// Over a rebuilt store, with its runs where a log looks for them; on a disk of its own.
fn open_rebuilt(store: &FaultyStore, disk: &FaultyStore) -> Registry {
    let disk = disk.crash();
    for path in disk.paths().into_iter().filter(|path| path.starts_with("working/runs/")) {
        disk.remove(&path).unwrap();
    }
    for path in disk.paths().into_iter().filter(|path| path.starts_with("other/runs/")) {
        disk.rename(&path, &path.replace("other", "working")).unwrap();
    }
    open(store, &disk).unwrap()
}

fn rebuild(disk: &FaultyStore) -> Result<(FaultyStore, Rebuilt), RegistryError> {
    let store = FaultyStore::new();
    let (into, on) = (Box::new(store.clone()), Box::new(disk.clone()));
    let rebuilt = Registry::rebuild_store(into, on, "other/runs", 40, &registry_key(), ORIGIN, &mut |_, _| {})?;
    Ok((store, rebuilt))
}

fn correct(registry: &Registry, kind: RecordKind, by: u8, of: Option<&Receipt>, with: Option<u8>) -> Receipt {
    let mut envelope = {
        let mut record = record(registry, &owner(by), "fern", &format!("{kind:?} by {by}"));
        (record.kind, record.replaces) = (kind, of.map(|receipt| receipt.envelope.digest()));
        record.seal(&owner(by)).unwrap()
    };
    with.iter().for_each(|old| envelope.sign(&owner(*old)));
    take(registry, &envelope).unwrap()
}

/// A log of three hundred entries with everything in it that can happen to a record; the last ten are not published.
fn begun() -> (FaultyStore, FaultyStore, Registry) {
    let (store, disk) = (FaultyStore::new(), FaultyStore::new());
    let registry = open(&store, &disk).unwrap();
    let mut taken: Vec<_> = (0..130_u8)
        .map(|i| submit(&registry, &owner(i % 9 + 1), SCENES[usize::from(i % 3)], &i.to_string()).unwrap())
        .collect();
    taken.push(correct(&registry, RecordKind::Dispute, 9, Some(&taken[0]), None));
    taken.push(correct(&registry, RecordKind::Rotation, 20, Some(&taken[1]), Some(2)));
    taken.push(correct(&registry, RecordKind::Rotation, 21, Some(&taken[2]), Some(3)));
    taken.push(correct(&registry, RecordKind::Revocation, 4, None, None));
    taken.push(correct(&registry, RecordKind::Revocation, 5, None, None));
    // One of each is erased: then only the leaf and the map's keys say whom they ended.
    for erased in [7, 40, 132, 134] {
        registry.erase_index(taken[erased].index).unwrap();
    }
    registry.publish().unwrap();
    for i in 0..5 {
        submit(&registry, &owner(30 + i), "fern", &format!("late {i}")).unwrap();
    }
    (store, disk, registry)
}

fn must_be_alike(one: &Registry, other: &Registry) {
    assert_eq!((one.size(), one.checkpoint()), (other.size(), other.checkpoint()));
    for index in 0..one.size() {
        assert_eq!(one.entry(index).unwrap(), other.entry(index).unwrap());
    }
    for number in 1..40 {
        let key = owner(number).public();
        assert_eq!(one.ended(&key).unwrap(), other.ended(&key).unwrap(), "end of key {number}");
    }
    for scene in SCENES {
        let answer = |log: &Registry| log.answer(scene, None, None, usize::MAX).unwrap().to_json();
        assert_eq!(answer(one), answer(other));
    }
    assert!(other.check().unwrap().is_empty());
}

#[test]
fn what_was_lost_is_made_again_to_the_last_acknowledged_record() {
    let (_, disk, registry) = begun();
    assert_eq!(
        [2, 3, 4, 5, 6].map(|n| registry.ended(&owner(n).public()).unwrap().is_some()),
        [true, true, true, true, false]
    );
    let (store, rebuilt) = rebuild(&disk).unwrap();
    assert_eq!(rebuilt, Rebuilt { size: 280, records: 140, unpublished: 10, tiles: 0, left_out: 0 });
    assert!(disk.paths().iter().any(|path| path.starts_with("other/runs/")), "rows moved on the way");
    let again = open_rebuilt(&store, &disk);
    must_be_alike(&registry, &again);
    // A nonce that was used stays used.
    let mut second = record(&again, &owner(33), "fern", "second");
    second.nonce = registry.record(rebuilt.size - 4).unwrap().record.nonce;
    let refused = take(&again, &second.seal(&owner(33)).unwrap()).unwrap_err();
    assert!(matches!(refused, RegistryError::NonceUsed { .. }), "{refused}");
    drop(registry);
    submit(&again, &owner(6), "trex", "next").unwrap();
    again.publish().unwrap();
    assert!(again.check().unwrap().is_empty());
}

#[test]
fn an_erased_records_nonce_serves_nobody_again_though_it_is_forgotten() {
    let (store, disk) = (FaultyStore::new(), FaultyStore::new());
    let registry = open(&store, &disk).unwrap();
    submit(&registry, &owner(2), "fern", "before").unwrap();
    // Two records over one nonce, both signed; whoever has the second keeps it.
    let first = record(&registry, &owner(1), "fern", "first");
    let mut second = record(&registry, &owner(1), "fern", "second");
    second.nonce = first.nonce;
    let (first, second) = (first.seal(&owner(1)).unwrap(), second.seal(&owner(1)).unwrap());
    let old = record(&registry, &owner(1), "fern", "a nonce that was not used yet");
    let erased = take(&registry, &first).unwrap();
    let fresh = sealed(&registry, &owner(1), "fern", "a nonce from behind it");
    registry.erase_index(erased.index).unwrap();
    assert!(matches!(take(&registry, &second), Err(RegistryError::NonceUsed { .. })));
    registry.publish().unwrap();
    drop(registry);

    let (store, _) = rebuild(&disk).unwrap();
    let again = open_rebuilt(&store, &disk);
    let size = again.size();
    assert!(matches!(take(&again, &first), Err(RegistryError::Erased { index }) if index == erased.index));
    for refused in [second, old.seal(&owner(1)).unwrap()] {
        let refused = take(&again, &refused).unwrap_err();
        assert!(matches!(refused, RegistryError::NonceExpired { issued: 2, .. }), "{refused}");
    }
    assert_eq!(again.size(), size);
    // Nobody else has to ask again.
    assert_eq!(take(&again, &fresh).unwrap().index, erased.index + 2);
}

#[test]
fn a_round_that_was_cut_short_is_left_out_and_nothing_published_is() {
    let (_, disk, registry) = begun();
    let published = registry.published().unwrap().size;
    let path = "envelopes/001";
    let pack = disk.read(path, u64::MAX).unwrap().unwrap();
    let mut sizes = std::collections::BTreeSet::new();
    for cut in (0..=pack.len()).rev().step_by(389) {
        disk.tamper_file(path, |bytes| *bytes = pack[..cut].to_vec());
        match rebuild(&disk) {
            Ok((store, rebuilt)) => {
                assert_eq!(rebuilt.size % 2, 0, "cut at {cut}: only whole rounds");
                sizes.insert(rebuilt.size);
                let again = open_rebuilt(&store, &disk);
                assert!(again.check().unwrap().is_empty());
            }
            Err(RegistryError::Rebuild { place, .. }) => assert_eq!(place, path, "cut at {cut}"),
            Err(other) => panic!("cut at {cut}: {other}"),
        }
    }
    assert!(sizes.contains(&registry.size()) && sizes.iter().all(|size| *size >= published), "{sizes:?}");
}

/// Whether a byte is one of a `keyid`, which DSSE calls a hint: nothing follows from it.
fn is_hint(pack: &[u8], at: usize) -> bool {
    let before = String::from_utf8_lossy(&pack[at.saturating_sub(80)..at]).into_owned();
    before.rsplit_once("\"keyid\":\"").is_some_and(|(_, behind)| !behind.contains('"'))
}

#[test]
fn what_stands_against_it_is_named() {
    let (_, disk, _) = begun();
    let said = |disk: &FaultyStore| match rebuild(disk) {
        Err(e @ RegistryError::Rebuild { .. }) => e.to_string(),
        Err(other) => panic!("{other}"),
        Ok(_) => String::new(),
    };
    // Every byte of the published envelopes counts: they are signed, or hashed into the map. A sample of them.
    let pack = disk.read("envelopes/000", u64::MAX).unwrap().unwrap();
    for at in (0..pack.len()).step_by(7001) {
        disk.tamper_file("envelopes/000", |bytes| bytes[at] ^= 1);
        let said = said(&disk);
        assert!(said.contains("entry ") || said.contains("envelopes/000") || is_hint(&pack, at), "byte {at}: {said:?}");
        disk.tamper_file("envelopes/000", |bytes| bytes[at] ^= 1);
    }
    let bundle = disk.read("public/tile/entries/000", u64::MAX).unwrap().unwrap();
    for at in (0..bundle.len()).step_by(1801) {
        disk.tamper_file("public/tile/entries/000", |bytes| bytes[at] ^= 1);
        let said = said(&disk);
        assert!(said.contains("entry ") || said.contains("tile/entries/000"), "byte {at}: {said:?}");
        disk.tamper_file("public/tile/entries/000", |bytes| bytes[at] ^= 1);
    }
    // Tiles follow from leaves: they are put right.
    let tile = disk.read("public/tile/0/000", u64::MAX).unwrap().unwrap();
    disk.tamper_file("public/tile/0/000", |bytes| bytes[77] ^= 1);
    assert_eq!(rebuild(&disk).unwrap().1.tiles, 1);
    assert_eq!(disk.read("public/tile/0/000", u64::MAX).unwrap().unwrap(), tile);
    let files = Files::new(Box::new(disk.clone()));
    files.remove("public/tile/0/000").unwrap();
    assert_eq!(rebuild(&disk).unwrap().1.tiles, 1);
    // Leaves of records as well; those of erased ones only they have.
    disk.tamper_file("public/tile/entries/000", |bytes| bytes.truncate(250 * 164));
    let (store, rebuilt) = rebuild(&disk).unwrap();
    assert_eq!((rebuilt.tiles, disk.read("public/tile/entries/000", u64::MAX).unwrap().unwrap()), (1, bundle));
    assert!(open_rebuilt(&store, &disk).check().unwrap().is_empty());
    files.remove("public/tile/entries/000").unwrap();
    assert!(said(&disk).contains("it is erased, and its leaf is missing"));
    files.remove("public/checkpoint").unwrap();
    assert!(said(&disk).contains("public/checkpoint"));
}

#[test]
fn what_a_round_left_that_was_never_acknowledged_stays_out() {
    let (_, disk, registry) = begun();
    let (path, size) = ("envelopes/001", registry.size());
    let pack = disk.read(path, u64::MAX).unwrap().unwrap();
    let last = registry.record(size - 2).unwrap().envelope.to_json();
    // Zeros, as a power cut leaves them; the same record once more; one that is not this log's.
    let frame = |json: &str| [&(json.len() as u32 + 1).to_be_bytes()[..], &[1], json.as_bytes(), &[0; 4]].concat();
    let foreign = last.replace("payload", "payloud");
    for (behind, left_out) in [(vec![0; 400], 100), (frame(&last), 2), (frame(&foreign), 2), (vec![9; 3], 1)] {
        disk.tamper_file(path, |bytes| *bytes = [&pack[..], &behind].concat());
        let (store, rebuilt) = rebuild(&disk).unwrap();
        assert_eq!((rebuilt.size, rebuilt.left_out), (size, left_out));
        assert!(open_rebuilt(&store, &disk).check().unwrap().is_empty());
    }
}

#[test]
fn a_record_that_was_erased_before_it_was_published_is_no_obstacle() {
    let (_, disk, registry) = begun();
    let late = registry.size() - 4;
    assert!(registry.published().unwrap().size <= late);
    registry.erase_index(late).unwrap();
    let (store, _) = rebuild(&disk).unwrap();
    must_be_alike(&registry, &open_rebuilt(&store, &disk));
}

#[test]
fn a_start_takes_away_what_a_cut_round_left_in_packs() {
    let (store, disk, registry) = begun();
    let pack = disk.read("envelopes/001", u64::MAX).unwrap().unwrap();
    drop(registry);
    disk.tamper_file("envelopes/001", |bytes| bytes.extend_from_slice(b"somebody's name"));
    let files = Files::new(Box::new(disk.clone()));
    files.replace(&[("envelopes/002", b"a"), ("envelopes/003", b"b")].map(|(p, b)| (p.into(), b.to_vec()))).unwrap();
    let registry = open(&store, &disk).unwrap();
    assert_eq!(disk.read("envelopes/001", u64::MAX).unwrap(), Some(pack));
    assert!(disk.paths().iter().all(|path| !path.starts_with("envelopes/002") && !path.starts_with("envelopes/003")));
    assert!(registry.check().unwrap().is_empty());
}

#[test]
fn on_a_disk_it_stands_where_the_lost_one_stood() {
    let folder = tempfile::tempdir().unwrap();
    let registry = Registry::open(folder.path(), registry_key(), ORIGIN).unwrap();
    for i in 0..4 {
        submit(&registry, &owner(1), "fern", &i.to_string()).unwrap();
    }
    registry.publish().unwrap();
    let last = submit(&registry, &owner(1), "fern", "last").unwrap();
    drop(registry);
    let rebuild = || Registry::rebuild(folder.path(), &registry_key(), ORIGIN, &mut |_, _| {});
    assert!(rebuild().unwrap_err().to_string().contains("move it away"));
    std::fs::rename(folder.path().join("working"), folder.path().join("working.lost")).unwrap();
    let refused = Registry::open(folder.path(), registry_key(), ORIGIN).err().unwrap().to_string();
    assert!(refused.contains("rebuild"), "{refused}");
    // What an attempt left that was killed is no obstacle.
    std::fs::create_dir(folder.path().join("working.rebuilt")).unwrap();
    std::fs::write(folder.path().join("working.rebuilt/conf"), "half").unwrap();
    assert_eq!(rebuild().unwrap(), Rebuilt { size: 10, records: 5, unpublished: 2, tiles: 0, left_out: 0 });
    let registry = Registry::open(folder.path(), registry_key(), ORIGIN).unwrap();
    assert_eq!(registry.find(&last.envelope.digest()).unwrap(), Some(last.index));
    assert_eq!(registry.checkpoint(), last.checkpoint);
    assert_eq!(registry.record(0).unwrap().record.scene_salt, Digest::of("salt of 0"));
    assert!(registry.check().unwrap().is_empty());
}
