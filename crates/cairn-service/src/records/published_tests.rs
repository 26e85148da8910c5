//! What is kept beside a data folder: who is refused by it, what damage does, and where it cannot be kept.

use std::fs;

use cairn_log::format::record::{self, Digests, Identity, Seen, photographs_root};
use cairn_log::{Digest, OwnerKey, OwnerRecord, RecordKind};
use tempfile::TempDir;

use super::*;

/// A data folder that goes with its test, and what is kept beside it as well.
pub struct TestFolder {
    data: PathBuf,
    _around: TempDir,
}

impl TestFolder {
    /// An empty one.
    pub fn new() -> Self {
        let around = tempfile::tempdir().unwrap();
        let data = around.path().join("data");
        fs::create_dir(&data).unwrap();
        Self { data, _around: around }
    }

    /// Where it lies.
    pub fn path(&self) -> &Path {
        &self.data
    }
}

const ORIGIN: &str = "registry.example/owners";

fn key() -> OwnerKey {
    OwnerKey::from_seed(&[1; 32])
}

fn record(registry: &Registry) -> OwnerRecord {
    let owner = OwnerKey::from_seed(&[3; 32]);
    let view = Digest::of("a photograph");
    OwnerRecord {
        version: record::VERSION,
        kind: RecordKind::Contribution,
        origin: ORIGIN.into(),
        scene: "town".into(),
        scene_salt: view,
        identity: Identity { number: 1, contributor: "ada".into() },
        owner_key: owner.public(),
        digests: Digests { photographs: Some(photographs_root(&[view])), ..Digests::default() },
        seed: None,
        purpose: "credit".into(),
        nonce: registry.nonce("town", &owner.public()).unwrap(),
        seen: Seen { size: 0, root: registry.head().unwrap().root },
        replaces: None,
        views: Some(vec![view]),
    }
}

/// A log with a record in it, and what it published.
fn log(folder: &TestFolder) -> (Registry, LastPublished, String) {
    let registry = Registry::open(&folder.path().join("registry"), key(), ORIGIN).unwrap();
    registry.submit(&record(&registry).seal(&OwnerKey::from_seed(&[3; 32])).unwrap()).unwrap();
    let last = LastPublished::of(folder.path().join("registry.checkpoint"), folder.path(), &registry.public_key());
    let checkpoint = registry.publish().unwrap().checkpoint;
    (registry, last, checkpoint)
}

fn beside(last: &LastPublished) -> &Path {
    last.beside.as_deref().unwrap()
}

#[test]
fn a_log_is_held_to_both_and_no_byte_of_either_may_change() {
    let folder = TestFolder::new();
    let (registry, last, checkpoint) = log(&folder);
    last.hold(&registry).unwrap();
    last.keep(&checkpoint).unwrap();
    last.hold(&registry).unwrap();
    for file in [beside(&last), &last.inside] {
        let whole = fs::read(file).unwrap();
        for at in 0..whole.len() {
            let mut bent = whole.clone();
            bent[at] ^= 1;
            fs::write(file, bent).unwrap();
            let refused = last.hold(&registry).unwrap_err().to_string();
            assert!(refused.contains(&file.display().to_string()), "byte {at}: {refused}");
        }
        fs::write(file, whole).unwrap();
        last.hold(&registry).unwrap();
    }
}

#[test]
fn what_is_no_checkpoint_is_refused_and_left_alone() {
    let folder = TestFolder::new();
    let (registry, last, checkpoint) = log(&folder);
    last.keep(&checkpoint).unwrap();
    let file = beside(&last);
    let refused = || {
        let refused = last.hold(&registry).unwrap_err().to_string();
        assert!(refused.contains("move that file away") && refused.contains(".checkpoint"), "{refused}");
    };
    for bytes in [&b""[..], b"\xff\xfe", &vec![b'a'; MAX_CHECKPOINT as usize + 1]] {
        fs::write(file, bytes).unwrap();
        refused();
        assert_eq!(fs::read(file).unwrap(), bytes);
    }
    fs::remove_file(file).unwrap();
    fs::create_dir(file).unwrap();
    refused();
    // Nothing can be kept there then, and inside it is.
    fs::remove_file(&last.inside).unwrap();
    last.keep(&checkpoint).unwrap();
    assert!(last.inside.is_file() && file.is_dir());
    fs::remove_dir(file).unwrap();
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(folder.path().join("nowhere"), file).unwrap();
        refused();
    }
}

#[test]
fn another_log_in_the_same_place_takes_nobodys_word_away() {
    let folder = TestFolder::new();
    let (registry, last, checkpoint) = log(&folder);
    last.keep(&checkpoint).unwrap();
    let other = OwnerKey::from_seed(&[2; 32]).public();
    let others = LastPublished::of(last.inside.clone(), folder.path(), &other);
    assert_ne!(beside(&others), beside(&last));
    drop(registry);
    // The older self of the first log is told all the same.
    let older = TestFolder::new();
    let registry = Registry::open(&older.path().join("registry"), key(), ORIGIN).unwrap();
    let refused = hold_to_beside(beside(&last), &registry).unwrap_err().to_string();
    assert!(refused.contains("restored from an older backup"), "{refused}");
}
