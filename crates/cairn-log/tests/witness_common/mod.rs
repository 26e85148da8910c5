//! A small log to be witnessed, and a witness whose clock stands where it is put.

use std::{
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use cairn_durable::Disk;
use cairn_log::witness::{AddCheckpoint, Clock, OpenError, Response, Witness};
use cairn_log::{
    Checkpoint, Cosignature, Digest, Note, NoteVerifier, OwnerKey,
    format::{merkle::leaf_hash, testing::Tree},
};

pub const ORIGIN: &str = "log.example/owners";
pub const NAME: &str = "witness.example/w1";
pub const NOW: u64 = 1_800_000_000;

pub fn key(number: u8) -> OwnerKey {
    OwnerKey::from_seed(&[number; 32])
}

pub fn log_verifier() -> NoteVerifier {
    NoteVerifier::new(ORIGIN, key(1).public()).unwrap()
}

/// A history of one log.
#[derive(Clone)]
pub struct Log {
    pub tree: Tree,
}

impl Log {
    /// `shared` leaves that all histories have, then some of this one's own, 40 in all.
    pub fn new(shared: u32, branch: u8) -> Self {
        let mut tree = Tree::new();
        for i in 0..40_u32 {
            let own = if i < shared { 0 } else { branch };
            tree.push(leaf_hash(&[&i.to_be_bytes()[..], &[own]].concat()));
        }
        Self { tree }
    }

    pub fn root(&self, size: u64) -> Digest {
        self.tree.root_at(size).unwrap()
    }

    pub fn note(&self, size: u64) -> Note {
        Checkpoint::new(ORIGIN, size, self.root(size)).sign(&key(1)).unwrap()
    }

    pub fn proof(&self, from: u64, to: u64) -> Vec<Digest> {
        if from == 0 || from >= to { Vec::new() } else { self.tree.prove_consistency(from, to).unwrap() }
    }

    /// A well-formed request.
    pub fn request(&self, old: u64, size: u64) -> AddCheckpoint {
        AddCheckpoint { old, proof: self.proof(old, size), note: self.note(size).to_string() }
    }
}

/// A clock that the test sets.
#[derive(Clone)]
pub struct Hands(pub Arc<AtomicU64>);

impl Hands {
    pub fn new() -> Self {
        Self(Arc::new(AtomicU64::new(NOW)))
    }

    pub fn set(&self, time: u64) {
        self.0.store(time, Ordering::SeqCst);
    }
}

fn clock(hands: &Hands) -> Clock {
    let hands = hands.clone();
    Box::new(move || hands.0.load(Ordering::SeqCst))
}

pub fn over(disk: Box<dyn Disk>, hands: &Hands) -> Result<Witness, OpenError> {
    Witness::open_on(disk, clock(hands), NAME, key(2), vec![log_verifier()])
}

pub fn open(path: &Path, hands: &Hands) -> Result<Witness, OpenError> {
    Witness::open_timed(path, clock(hands), NAME, key(2), vec![log_verifier()])
}

pub fn ask(witness: &Witness, request: &AddCheckpoint) -> Response {
    witness.add_checkpoint(request.to_body().as_bytes())
}

/// The cosignature in an answer that must be one, verified over the request's checkpoint.
pub fn cosignature(witness: &Witness, request: &AddCheckpoint, answer: &Response) -> Cosignature {
    assert_eq!(answer.status, 200, "{answer:?}");
    assert!(answer.body.ends_with('\n'));
    let mut note = Note::parse(&request.note).unwrap();
    note.signatures = answer.body.lines().map(|line| line.parse().unwrap()).collect();
    witness.verifier().find(&note).unwrap().unwrap()
}

/// The names in a folder, sorted.
pub fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<_> = entries.map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}
