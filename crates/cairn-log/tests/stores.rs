//! The contract of a store, over sled and over the failing double alike, so that what the double shows is true of the disk.
#![cfg(feature = "store")]

use cairn_durable::{Disk, Fault, Files, RealDisk};
use cairn_log::log::store::{Change, DiskStore, FaultyStore, Store};

fn entry(key: &str, value: &str) -> Change {
    (key.into(), Some(value.into()))
}

fn keys(store: &dyn Store, prefix: &str, from: &str, limit: usize) -> Vec<String> {
    let found = store.scan(prefix.as_bytes(), from.as_bytes(), limit).unwrap();
    found.into_iter().map(|(key, _)| String::from_utf8(key).unwrap()).collect()
}

fn contract(store: &dyn Store) {
    assert_eq!(store.get(b"a").unwrap(), None);
    assert_eq!(keys(store, "", "", 9), [""; 0]);
    store.put(vec![entry("b/2", "two"), entry("b/1", "one"), entry("a", ""), entry("c", "three")]).unwrap();
    store.flush().unwrap();
    assert_eq!(store.get(b"a").unwrap(), Some(vec![]));
    assert_eq!(store.get(b"b/2").unwrap(), Some(b"two".to_vec()));
    store.put(vec![entry("b/2", "new"), entry("b/10", "ten"), entry("gone", "")]).unwrap();
    store.put(vec![(b"gone".to_vec(), None), (b"never there".to_vec(), None)]).unwrap();
    store.flush().unwrap();
    assert_eq!(store.get(b"b/2").unwrap(), Some(b"new".to_vec()));
    assert_eq!(keys(store, "", "", 9), ["a", "b/1", "b/10", "b/2", "c"]);
    assert_eq!(keys(store, "b/", "", 9), ["b/1", "b/10", "b/2"]);
    assert_eq!(keys(store, "b/", "10", 9), ["b/10", "b/2"]);
    assert_eq!(keys(store, "b/", "", 2), ["b/1", "b/10"]);
    assert_eq!(keys(store, "b/", "", 0), [""; 0]);
    assert_eq!(keys(store, "d", "", 9), [""; 0]);
    let range = |from: &str, to: Option<&str>| {
        let found = store.range(from.as_bytes(), to.map(str::as_bytes), 9).unwrap();
        found.into_iter().map(|(key, _)| String::from_utf8(key).unwrap()).collect::<Vec<_>>()
    };
    assert_eq!(range("b/1", Some("b/2")), ["b/1", "b/10"]);
    assert_eq!(range("b/11", None), ["b/2", "c"]);
    assert_eq!(range("b/2", Some("b/2")), [""; 0]);
}

#[test]
fn both_stores_keep_the_contract() {
    contract(&FaultyStore::new());
    let folder = tempfile::tempdir().unwrap();
    contract(&DiskStore::open(folder.path()).unwrap());
    let again = DiskStore::open(folder.path()).unwrap();
    assert_eq!(keys(&again, "b/", "", 9), ["b/1", "b/10", "b/2"]);
}

#[test]
fn large_values_which_sled_keeps_in_files_of_their_own_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let values: Vec<Vec<u8>> = (0..3).map(|i| vec![i; 1 << 20]).collect();
    {
        let store = DiskStore::open(folder.path()).unwrap();
        for (i, value) in (0_u8..).zip(&values) {
            store.put(vec![(vec![i], Some(value.clone()))]).unwrap();
            store.flush().unwrap();
        }
        assert_ne!(std::fs::read_dir(folder.path().join("blobs")).unwrap().count(), 0, "sled made blobs of them");
    }
    let store = DiskStore::open(folder.path()).unwrap();
    for (i, value) in (0_u8..).zip(values) {
        assert_eq!(store.get(&[i]).unwrap(), Some(value));
    }
}

#[test]
fn the_double_tells_written_from_durable_and_fails_where_it_is_told() {
    let store = FaultyStore::new();
    store.put(vec![entry("a", "1")]).unwrap();
    assert_eq!(store.crash().get(b"a").unwrap(), None);
    store.flush().unwrap();
    assert_eq!(store.crash().get(b"a").unwrap(), Some(b"1".to_vec()));
    for (fault, there) in [(Fault::Before, false), (Fault::After, true)] {
        let store = FaultyStore::new();
        store.fail_at(1, fault);
        store.get(b"x").unwrap();
        let failed = store.put(vec![entry("a", "1")]).unwrap_err();
        assert_eq!((failed.operation, failed.cause.as_str()), ("put", "injected"));
        assert_eq!(store.get(b"a").unwrap().is_some(), there, "{fault:?}");
    }
}

fn contract_of_files(disk: impl Disk + Clone + 'static) {
    let files = Files::new(Box::new(disk.clone()));
    assert_eq!(files.read("a/b/c", 9).unwrap(), None);
    let all = [("a/b/c".to_owned(), b"one".to_vec()), ("d".to_owned(), vec![])];
    files.replace(&all).unwrap();
    assert_eq!(files.read("a/b/c", 3).unwrap(), Some(b"one".to_vec()));
    assert!(files.read("a/b/c", 2).is_err(), "over the limit");
    files.replace(&[("a/b/c".to_owned(), b"other".to_vec())]).unwrap();
    assert_eq!(files.read("a/b/c", 9).unwrap(), Some(b"other".to_vec()));
    assert_eq!(disk.read("a/b/c.new", 9).unwrap(), None, "no temporary file stays");
    files.append("a/log", 0, b"one").unwrap();
    files.append("a/log", 3, b"three").unwrap();
    files.append("a/log", 3, b"two").unwrap();
    assert_eq!(files.read("a/log", 9).unwrap(), Some(b"onetwo".to_vec()), "what was behind the offset is gone");
    assert!(files.append("a/log", 7, b"x").is_err(), "a hole");
    files.remove("a/b").unwrap();
    files.remove("a/b").unwrap();
    assert_eq!((files.read("a/b/c", 9).unwrap(), files.read("d", 9).unwrap()), (None, Some(vec![])));
}

#[test]
fn both_disks_keep_the_contract_of_files() {
    contract_of_files(FaultyStore::new());
    let folder = tempfile::tempdir().unwrap();
    contract_of_files(RealDisk::new(folder.path()));
}

#[test]
fn a_file_is_the_old_one_or_the_new_one_whatever_fails_and_whenever_power_goes() {
    for fault in [Fault::Before, Fault::After] {
        for nth in 0.. {
            let disk = FaultyStore::new();
            let files = Files::new(Box::new(disk.clone()));
            let file = |text: &str| [("a/f".to_owned(), text.as_bytes().to_vec())];
            files.replace(&file("old")).unwrap();
            disk.fail_at(nth, fault);
            let replaced = files.replace(&file("new"));
            disk.heal();
            for found in [&disk, &disk.crash()] {
                let text = String::from_utf8(found.read("a/f", 9).unwrap().unwrap()).unwrap();
                assert!(text == "new" || (text == "old" && replaced.is_err()), "{nth} {fault:?}: {text:?}");
            }
            if replaced.is_ok() {
                assert_eq!(nth, 4, "write, flush, rename, flush of the folder");
                break;
            }
        }
    }
}

#[test]
fn what_cannot_be_opened_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file");
    std::fs::write(&path, "in the way").unwrap();
    let refused = DiskStore::open(&path).unwrap_err();
    assert!(refused.to_string().contains(&path.display().to_string()), "{refused}");
    let refused = cairn_log::Registry::open(&path, cairn_log::OwnerKey::from_seed(&[1; 32]), "log");
    assert!(refused.is_err());
}

/// Found by injecting faults into a start: sled takes what it had half written for its own, and opens no more.
#[test]
fn a_start_that_was_cut_short_leaves_a_store_that_opens() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("store");
    // A new database that never was one.
    std::fs::create_dir(folder.path().join("store.new")).unwrap();
    std::fs::write(folder.path().join("store.new/conf"), "half").unwrap();
    let store = DiskStore::open(&path).unwrap();
    store.put(vec![entry("key", "value")]).unwrap();
    store.flush().unwrap();
    drop(store);
    assert!(!folder.path().join("store.new").exists());
    let half = path.join("snap.00000000FFFFFFFF.generating");
    std::fs::write(&half, "a\0\0").unwrap();
    let store = DiskStore::open(&path).unwrap();
    assert_eq!(store.get(b"key").unwrap().as_deref(), Some(&b"value"[..]));
    assert!(!half.exists());
}
