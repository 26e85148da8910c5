//! The registry: takes owner records into an append-only log and vouches for it.
//!
//! Life of a record: **accepted** (its envelope and rules hold), **durable** (flushed
//! to the store), **published** (covered by a signed checkpoint). Nothing is
//! acknowledged before it is durable, and no signature leaves before the size
//! and root it is over are flushed, so that after any crash the log can only go on from
//! what it signed. Submissions that wait at the same time share one flush.
//!
//! When a write fails it is unknown what the disk holds; the registry then halts: it
//! still reads and proves, and writes again only after a new start has re-read everything.

mod commit;
mod error;
mod layout;
mod nonce;
mod reload;
mod submit;

use std::{
    fs,
    path::Path,
    sync::{Condvar, Mutex, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard},
};

use crate::{
    checkpoint::Checkpoint,
    digest::Digest,
    dsse::Envelope,
    keys::{OwnerKey, PublicKey},
    leaf::Leaf,
    merkle::Tree,
    note::NoteVerifier,
    proof::TlogProof,
    record::OwnerRecord,
    store::{DiskStore, Store, StoreError, StoreLock},
    tile::{TileKind, TilePath, encode_entries},
};

pub use error::RegistryError;
pub use nonce::NONCE_LIFETIME;

/// What a submitter gets, after the record is durable and published.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Receipt {
    /// The record's place in the log.
    pub index: u64,
    /// Hash of its leaf.
    pub leaf_hash: Digest,
    /// Always true: a receipt exists only behind a flush.
    pub durable: bool,
    /// Whether this record was in the log before this submission.
    pub resubmitted: bool,
    /// A signed checkpoint that covers the record.
    pub checkpoint: String,
    /// The checkpoint's size.
    pub size: u64,
    /// Proof that the leaf lies in the tree of that size.
    pub inclusion: Vec<Digest>,
    /// The envelope with the registry's signature.
    pub envelope: Envelope,
}

impl Receipt {
    /// The evidence that the record is in the log, to be kept beside its envelope.
    pub fn tlog_proof(&self) -> TlogProof {
        TlogProof {
            extra: None,
            index: self.index,
            hashes: self.inclusion.clone(),
            checkpoint: self.checkpoint.clone(),
        }
    }
}

/// A record as the log keeps it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredRecord {
    /// Its place in the log.
    pub index: u64,
    /// Its leaf.
    pub leaf: Leaf,
    /// Its envelope with the registry's signature.
    pub envelope: Envelope,
    /// What the envelope says, its owner's signature verified.
    pub record: OwnerRecord,
}

/// What the log is, as its readers see it.
struct State {
    /// May hold leaves beyond `size` while they are being written; readers never look past `size`.
    tree: Tree,
    /// Leaves that are durable and published.
    size: u64,
    /// Signed checkpoint over `size` leaves.
    checkpoint: String,
    /// Why nothing is written any more.
    halted: Option<String>,
}

/// The registry over one store, `Send` and `Sync`: shared between threads by reference.
///
/// Its calls block on the disk; an asynchronous caller gives them a thread.
pub struct Registry {
    origin: String,
    key: OwnerKey,
    nonces: nonce::Nonces,
    state: RwLock<State>,
    queue: Mutex<commit::Queue>,
    wake: Condvar,
    store: Box<dyn Store>,
    // After the store, so that it is let go last.
    _lock: Option<StoreLock>,
}

impl Registry {
    /// Opens the log in the folder `path`, made where absent, as its only writer.
    ///
    /// `key` signs checkpoints and countersigns records; `origin` names the log. Both stay the log's for good. Every leaf
    /// is read and the root recomputed.
    ///
    /// # Errors
    /// [`RegistryError::Locked`] where another writer holds it, [`RegistryError::WrongStore`],
    /// [`RegistryError::Inconsistent`] where it contradicts what was signed, [`RegistryError::Origin`],
    /// [`RegistryError::Store`].
    pub fn open(path: &Path, key: OwnerKey, origin: &str) -> Result<Self, RegistryError> {
        fs::create_dir_all(path).map_err(|e| StoreError {
            operation: "open",
            place: path.display().to_string(),
            cause: e.to_string(),
        })?;
        let lock = match StoreLock::take(path)? {
            Ok(lock) => lock,
            Err(holder) => return Err(RegistryError::Locked { path: holder.path, pid: holder.pid }),
        };
        let store = DiskStore::open(&path.join("log.sled"))?;
        Self::start(Box::new(store), Some(lock), key, origin)
    }

    /// Opens the log in a store of the caller's, who sees to it that there is one writer.
    ///
    /// # Errors
    /// As [`Registry::open`], without [`RegistryError::Locked`].
    pub fn open_store(store: Box<dyn Store>, key: OwnerKey, origin: &str) -> Result<Self, RegistryError> {
        Self::start(store, None, key, origin)
    }

    fn start(
        store: Box<dyn Store>,
        lock: Option<StoreLock>,
        key: OwnerKey,
        origin: &str,
    ) -> Result<Self, RegistryError> {
        let state = reload::reload(store.as_ref(), &key, origin)?;
        Ok(Self {
            nonces: nonce::Nonces::new(&key, origin),
            origin: origin.to_owned(),
            key,
            state: RwLock::new(state),
            queue: Mutex::default(),
            wake: Condvar::new(),
            store,
            _lock: lock,
        })
    }

    /// The log's name.
    pub fn origin(&self) -> &str {
        &self.origin
    }

    /// The registry's public key.
    pub fn public_key(&self) -> PublicKey {
        self.key.public()
    }

    /// The verifier key (vkey) that others pin.
    ///
    /// # Errors
    /// None once the registry is open: the origin was checked then.
    pub fn verifier(&self) -> Result<NoteVerifier, RegistryError> {
        Ok(NoteVerifier::new(&self.origin, self.key.public())?)
    }

    /// A nonce for a record of `owner` about `scene`: good for one record, for [`NONCE_LIFETIME`] records of growth,
    /// also after a restart.
    ///
    /// # Errors
    /// [`RegistryError::Key`] where the system gives no random numbers.
    pub fn nonce(&self, scene: &str, owner: &PublicKey) -> Result<Digest, RegistryError> {
        Ok(self.nonces.issue(self.size(), scene, owner)?)
    }

    /// How many records are published.
    pub fn size(&self) -> u64 {
        self.read().size
    }

    /// The newest signed checkpoint (a signed note).
    pub fn checkpoint(&self) -> String {
        self.read().checkpoint.clone()
    }

    /// Size and root of the newest checkpoint, unsigned: what a signer puts into `seen`.
    ///
    /// # Errors
    /// None once the registry is open.
    pub fn head(&self) -> Result<Checkpoint, RegistryError> {
        let state = self.read();
        Ok(Checkpoint::new(&self.origin, state.size, state.tree.root_at(state.size)?))
    }

    /// Why the registry writes no more, if it halted.
    pub fn halted(&self) -> Option<String> {
        self.read().halted.clone()
    }

    /// Checks that this log goes on from a checkpoint of it that is known from elsewhere: published, cosigned, written
    /// down. To be asked before serving, since a store restored from an old backup agrees with itself and would sign a
    /// second history. Where it does not go on from it, the registry halts.
    ///
    /// # Errors
    /// [`RegistryError::Inconsistent`], [`RegistryError::WrongOrigin`].
    pub fn must_extend(&self, known: &Checkpoint) -> Result<(), RegistryError> {
        if known.origin != self.origin {
            return Err(RegistryError::WrongOrigin { expected: self.origin.clone(), got: known.origin.clone() });
        }
        let mut state = self.write();
        let root = (known.size <= state.size).then(|| state.tree.root_at(known.size)).transpose()?;
        let what = match root {
            Some(root) if root == known.root => return Ok(()),
            Some(root) => format!("root at size {} is {root}, known is {}", known.size, known.root),
            None => format!("{} leaves, known is a checkpoint over {}", state.size, known.size),
        };
        state.halted.get_or_insert_with(|| what.clone());
        Err(reload::inconsistent("leaves", what))
    }

    /// Proof that record `index` lies in the tree of `size` records.
    ///
    /// # Errors
    /// [`RegistryError::Proof`] for an index or size that is not published.
    pub fn prove_inclusion(&self, index: u64, size: u64) -> Result<Vec<Digest>, RegistryError> {
        let state = self.read();
        published(size, state.size)?;
        Ok(state.tree.prove_inclusion(index, size)?)
    }

    /// The evidence that record `index` is in the log, under the newest checkpoint.
    ///
    /// # Errors
    /// [`RegistryError::Proof`] for an index that is not published.
    pub fn tlog_proof(&self, index: u64) -> Result<TlogProof, RegistryError> {
        let state = self.read();
        let hashes = state.tree.prove_inclusion(index, state.size)?;
        Ok(TlogProof { extra: None, index, hashes, checkpoint: state.checkpoint.clone() })
    }

    /// Proof that the tree of `to` records begins with the tree of `from` records.
    ///
    /// # Errors
    /// [`RegistryError::Proof`] for `from` 0 or beyond `to`, or a size that is not published.
    pub fn prove_consistency(&self, from: u64, to: u64) -> Result<Vec<Digest>, RegistryError> {
        let state = self.read();
        published(to, state.size)?;
        Ok(state.tree.prove_consistency(from, to)?)
    }

    /// Record `index`, its envelope re-verified.
    ///
    /// # Errors
    /// [`RegistryError::NoSuchRecord`]; [`RegistryError::Inconsistent`] where leaf and envelope do not belong together.
    pub fn record(&self, index: u64) -> Result<StoredRecord, RegistryError> {
        let size = self.size();
        if index >= size {
            return Err(RegistryError::NoSuchRecord { index, size });
        }
        reload::stored(self.store.as_ref(), index)
    }

    /// The published records, of one scene or all, in the log's order.
    ///
    /// # Errors
    /// As [`Registry::record`].
    pub fn records(&self, scene: Option<&str>) -> Result<Vec<StoredRecord>, RegistryError> {
        self.page(scene, 0, usize::MAX)
    }

    /// At most `limit` of the published records with index `from` or more, of one scene or all.
    ///
    /// # Errors
    /// As [`Registry::record`].
    pub fn page(&self, scene: Option<&str>, from: u64, limit: usize) -> Result<Vec<StoredRecord>, RegistryError> {
        let size = self.size();
        let Some(scene) = scene else {
            return (from..size).take(limit).map(|index| self.record(index)).collect();
        };
        let prefix = layout::scene(scene);
        let entries = self.store.scan(&prefix, &from.to_be_bytes(), limit)?;
        let indices = entries.iter().filter_map(|(key, _)| layout::number(key.strip_prefix(prefix.as_slice())?));
        indices.take_while(|index| *index < size).map(|index| self.record(index)).collect()
    }

    /// The bytes of a tile or of a bundle of entries (leaves), as monitors fetch them; none where the published log does not
    /// hold all of it.
    ///
    /// # Errors
    /// [`RegistryError::Store`]; [`RegistryError::Inconsistent`] where a leaf is missing.
    pub fn tile(&self, path: &TilePath) -> Result<Option<Vec<u8>>, RegistryError> {
        let (size, hashes) = {
            let state = self.read();
            (state.size, path.cut(&state.tree, state.size))
        };
        if path.kind != TileKind::Entries {
            return Ok(hashes);
        }
        let held = TilePath::in_tree(path.kind, path.index, size).filter(|held| path.width <= held.width);
        let Some(first) = held.and_then(|held| held.first()) else { return Ok(None) };
        let leaves = reload::leaves(self.store.as_ref(), first, path.width.into())?;
        let bundle = encode_entries(leaves.iter().map(Vec::as_slice));
        bundle.map(Some).map_err(|e| reload::inconsistent(&path.to_string(), e.to_string()))
    }

    /// Index of the record with this digest (SHA-256 of its PAE), if it is published.
    ///
    /// # Errors
    /// [`RegistryError::Store`], [`RegistryError::Inconsistent`].
    pub fn find(&self, record: &Digest) -> Result<Option<u64>, RegistryError> {
        let size = self.size();
        Ok(reload::index_of(self.store.as_ref(), record)?.filter(|index| *index < size))
    }

    /// Forgets the envelope of a record; its leaf, and so every proof, stays.
    ///
    /// PLACEHOLDER of the branch that brings requests: to be replaced by the one that really erases. This one finds no
    /// record to erase.
    ///
    /// # Errors
    /// [`RegistryError::NoSuchRecord`].
    pub fn erase(&self, request: &crate::erasure::Erasure) -> Result<u64, RegistryError> {
        Err(RegistryError::NoSuchRecord { index: request.request().index, size: self.size() })
    }

    /// Index of the revocation or rotation that ended the key `owner`, if one is published.
    ///
    /// # Errors
    /// [`RegistryError::Store`], [`RegistryError::Inconsistent`].
    pub fn ended(&self, owner: &PublicKey) -> Result<Option<u64>, RegistryError> {
        let size = self.size();
        let key = layout::retired(&owner.id());
        let index = reload::number_at(self.store.as_ref(), &key, || format!("end of key {owner}"))?;
        Ok(index.filter(|index| *index < size))
    }

    /// Re-reads everything: each leaf, its hash in the tree, its envelope, both signatures, its indices. Gives what is wrong,
    /// nothing where all is well.
    ///
    /// # Errors
    /// [`RegistryError::Store`] where the store cannot be read.
    pub fn check(&self) -> Result<Vec<RegistryError>, RegistryError> {
        let size = self.size();
        let mut faults = Vec::new();
        for index in 0..size {
            match self.check_record(index) {
                Ok(()) => {}
                Err(RegistryError::Store(e)) => return Err(e.into()),
                Err(fault) => faults.push(fault),
            }
        }
        Ok(faults)
    }

    fn check_record(&self, index: u64) -> Result<(), RegistryError> {
        let stored = reload::stored(self.store.as_ref(), index)?;
        let fault = |what: String| RegistryError::Inconsistent { place: format!("record {index}"), what };
        let (expected, got) = (self.read().tree.leaf(index), stored.leaf.hash());
        if expected != Some(got) {
            return Err(fault(format!("leaf hash {got}, the tree holds {expected:?}")));
        }
        if stored.envelope.signature_by(&self.key.public()).is_none() {
            return Err(fault("the registry's signature is missing or does not verify".into()));
        }
        let found = reload::index_of(self.store.as_ref(), &stored.leaf.record)?;
        if found != Some(index) {
            return Err(fault(format!("the index by digest says {found:?}")));
        }
        Ok(())
    }

    fn read(&self) -> RwLockReadGuard<'_, State> {
        self.state.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self) -> RwLockWriteGuard<'_, State> {
        self.state.write().unwrap_or_else(PoisonError::into_inner)
    }
}

fn published(size: u64, published: u64) -> Result<(), RegistryError> {
    if size > published {
        return Err(crate::merkle::ProofError::IndexBeyondSize { index: size, size: published }.into());
    }
    Ok(())
}
