//! The registry: takes owner records into an append-only log and vouches for it.
//!
//! Life of a record: **accepted** (its envelope and rules hold), **durable** (flushed
//! to the store, and then acknowledged under a signed checkpoint), **published** (that checkpoint, and the tiles
//! under it, are in the files that monitors read). Nothing is
//! acknowledged before it is durable, and no signature leaves before the size
//! and root it is over are flushed, so that after any crash the log can only go on from
//! what it signed. Submissions that wait at the same time share one flush.
//!
//! Every batch ends in a map leaf: the root of the verifiable map over all that stands before it, so that whoever
//! has a checkpoint can be shown that an answer leaves nothing out ([`crate::format::map`]).
//!
//! When a write fails it is unknown what the disk holds; the registry then halts: it
//! still reads and proves, and writes again only after a new start has re-read everything.

mod anchor;
mod answer;
mod commit;
mod erase;
mod error;
mod fill;
mod layout;
pub mod map;
mod nonce;
mod publish;
mod read;
mod rebuild;
mod reload;
mod seal;
pub mod store;
mod submit;
mod tiles;

use std::{
    fs,
    path::Path,
    sync::{Arc, Condvar, Mutex, OnceLock, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard},
};

use crate::{
    format::{
        checkpoint::Checkpoint,
        digest::Digest,
        dsse::Envelope,
        key::{OwnerKey, PublicKey},
        merkle,
        note::NoteVerifier,
        proof::TlogProof,
    },
    log::{
        map::BucketMap,
        store::{DiskStore, Store, StoreError, TieredStore},
    },
};
use cairn_durable::{Disk, Files, LockFile, RealDisk};

pub use anchor::Anchor;
pub use error::RegistryError;
pub use fill::ORIGIN_PREFIX as BENCH_ORIGIN_PREFIX;
pub use nonce::NONCE_LIFETIME;
pub use publish::Published;
pub use read::{LogEntry, StoredRecord};
pub use rebuild::Rebuilt;

/// What a submitter gets once the record is durable.
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

/// What the log is, as its readers see it.
struct State {
    /// May hold leaves beyond `size` while they are being written; readers never look past `size`.
    tree: tiles::TileTree,
    /// The map over the leaves before the last one.
    map: BucketMap,
    /// Leaves that are durable and signed for.
    size: u64,
    /// Root over them.
    root: Digest,
    /// Signed checkpoint over them.
    checkpoint: String,
    /// The newest checkpoint that witnesses cosigned, and its size.
    cosigned: Option<(u64, String)>,
}

/// The registry over one store, `Send` and `Sync`: shared between threads by reference.
///
/// Its calls block on the disk; an asynchronous caller gives them a thread. Whoever owns it calls
/// [`Registry::publish`] now and then: submitting alone writes nothing that monitors read.
pub struct Registry {
    origin: String,
    key: OwnerKey,
    nonces: nonce::Nonces,
    state: RwLock<State>,
    /// Why nothing is written any more. Not in the state, whose lock a disk that does not answer may keep.
    halted: OnceLock<String>,
    queue: Mutex<commit::Queue>,
    wake: Condvar,
    /// Whoever holds the turn locks it, and nobody else.
    writer: Mutex<commit::Writer>,
    publisher: Mutex<publish::Publisher>,
    files: Arc<Files>,
    anchor: Option<anchor::Anchor>,
    store: Box<dyn Store>,
    // After the store, which must be closed to be sealed, and before the lock, under which that has to happen.
    seal: Option<seal::Seal>,
    _lock: Option<LockFile>,
}

impl Registry {
    /// Opens the log in the folder `path`, made where absent, as its only writer.
    ///
    /// `key` signs checkpoints and countersigns records; `origin` names the log. Both stay the log's for good. The
    /// tiles along the tree's right edge and the leaves that are in no full tile yet are read, and their root is
    /// held to what was signed last and to the published checkpoint.
    ///
    /// # Errors
    /// [`RegistryError::Locked`] where another writer holds it, [`RegistryError::WrongStore`],
    /// [`RegistryError::Inconsistent`] where it contradicts what was signed, [`RegistryError::Origin`],
    /// [`RegistryError::Store`].
    pub fn open(path: &Path, key: OwnerKey, origin: &str) -> Result<Self, RegistryError> {
        Self::open_anchored(path, key, origin, None)
    }

    /// As [`Registry::open`], held to an anchor, which is from then on flushed before any signature leaves.
    ///
    /// # Errors
    /// As [`Registry::open`]; [`RegistryError::RolledBack`] for a log that is older than its anchor or contradicts it,
    /// [`RegistryError::AnchorMissing`], [`RegistryError::BadAnchor`].
    pub fn open_anchored(
        path: &Path,
        key: OwnerKey,
        origin: &str,
        anchor: Option<Anchor>,
    ) -> Result<Self, RegistryError> {
        fs::create_dir_all(path).map_err(|e| StoreError {
            operation: "open",
            place: path.display().to_string(),
            cause: e.to_string(),
        })?;
        let lock = LockFile::take(&path.join(layout::LOCK))?;
        if path.join(layout::FORMER_STORE).exists() {
            let got = format!("cairn-log-store/1 ({})", path.join(layout::FORMER_STORE).display());
            return Err(RegistryError::WrongStore { what: "format", expected: layout::FORMAT_VERSION.into(), got });
        }
        if path.join(layout::CHECKPOINT).exists() && !path.join(layout::WORKING).exists() {
            let what = "it is missing, and a checkpoint was published".into();
            return Err(reload::inconsistent(layout::WORKING, what));
        }
        let seal = seal::Seal::break_open(path)?;
        let store = DiskStore::open(&path.join(layout::WORKING))?;
        let disk = Box::new(RealDisk::new(path));
        let mut registry = Self::open_tiered(Box::new(store), disk, key, origin, layout::ENOUGH, anchor)?;
        // Only now: a start that is refused must not seal what it was refused for.
        (registry.seal, registry._lock) = (Some(seal), Some(lock));
        Ok(registry)
    }

    /// Opens the log in a store and on a disk of the caller's, who sees to it that there is one writer.
    ///
    /// # Errors
    /// As [`Registry::open`], without [`RegistryError::Locked`].
    pub fn open_store(
        store: Box<dyn Store>,
        disk: Box<dyn Disk>,
        key: OwnerKey,
        origin: &str,
    ) -> Result<Self, RegistryError> {
        Self::open_tiered(store, disk, key, origin, layout::ENOUGH, None)
    }

    /// As [`Registry::open_store`]; rows go out of the store once there are `enough` of those that only accumulate, and the
    /// log is held to its anchor, where it has one.
    ///
    /// # Errors
    /// As [`Registry::open_store`] and [`Registry::open_anchored`].
    pub fn open_tiered(
        store: Box<dyn Store>,
        disk: Box<dyn Disk>,
        key: OwnerKey,
        origin: &str,
        enough: usize,
        anchor: Option<Anchor>,
    ) -> Result<Self, RegistryError> {
        let files = Arc::new(Files::new(disk));
        let store = Box::new(TieredStore::open(store, files.clone(), layout::RUNS, layout::COLD, enough)?);
        let loaded = reload::reload(&*store, &files, &key, origin, anchor.as_ref())?;
        let registry = Self {
            nonces: nonce::Nonces::new(&key, origin, loaded.nonces_from),
            origin: origin.to_owned(),
            key,
            state: RwLock::new(loaded.state),
            queue: Mutex::default(),
            halted: OnceLock::new(),
            wake: Condvar::new(),
            writer: Mutex::new(loaded.writer),
            publisher: Mutex::new(loaded.publisher),
            files,
            anchor,
            store,
            seal: None,
            _lock: None,
        };
        match loaded.standing {
            anchor::Standing::Ahead(round) => registry.take_up(round)?,
            anchor::Standing::Behind => {
                if let Some(anchor) = &registry.anchor {
                    anchor.write(&registry.head()?)?;
                }
            }
        }
        let pack_length = commit::lock(&registry.writer).pack_length;
        reload::cut_packs(&registry.files, registry.size(), pack_length)?;
        Ok(registry)
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

    /// A nonce for a record of `owner` about `scene`: good for one record, for [`NONCE_LIFETIME`] log entries of growth,
    /// also after a restart.
    ///
    /// # Errors
    /// [`RegistryError::Key`] where the system gives no random numbers.
    pub fn nonce(&self, scene: &str, owner: &PublicKey) -> Result<Digest, RegistryError> {
        Ok(self.nonces.issue(self.size(), scene, owner)?)
    }

    /// How many entries are durable and signed for: records and map leaves.
    pub fn size(&self) -> u64 {
        self.read().size
    }

    /// The newest signed checkpoint (a signed note).
    pub fn checkpoint(&self) -> String {
        self.read().checkpoint.clone()
    }

    /// The newest checkpoint that carries witnesses' cosignatures, where there is one.
    pub fn cosigned(&self) -> Option<String> {
        self.read().cosigned.as_ref().map(|(_, note)| note.clone())
    }

    /// How many entries the newest cosigned checkpoint covers; 0 where there is none.
    pub fn cosigned_size(&self) -> u64 {
        self.read().cosigned.as_ref().map_or(0, |(size, _)| *size)
    }

    /// Size and root of the newest checkpoint, unsigned: what a signer puts into `seen`.
    ///
    /// # Errors
    /// [`RegistryError::Inconsistent`] for a damaged tile.
    pub fn head(&self) -> Result<Checkpoint, RegistryError> {
        let state = self.read();
        Ok(Checkpoint::new(&self.origin, state.size, merkle::root_at(&state.tree, state.size)?))
    }

    /// Why the registry writes no more, if it halted.
    pub fn halted(&self) -> Option<String> {
        self.halted.get().cloned()
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
        // Nobody signs meanwhile.
        let state = self.write();
        reload::extends(&state.tree, state.size, known).inspect_err(|e| drop(self.halt(&e.to_string())))
    }

    /// Puts in order what writing leaves behind in the store, which stays small and quick to start by it. While others read and
    /// write; to be called now and then. Takes seconds where much came in; `stop` is asked now and then and ends it early.
    ///
    /// # Errors
    /// [`RegistryError::Store`]; nothing is lost, and the next call tries again.
    pub fn tidy(&self, stop: &dyn Fn() -> bool) -> Result<(), RegistryError> {
        // What a halted registry's store holds is unknown: it is read and not touched.
        if self.halted().is_some() {
            return Ok(());
        }
        let tidied = self.store.tidy(stop);
        // A file that cannot be written does no harm. After a write of the store that failed it takes no more.
        if let (Err(e), Err(_)) = (&tidied, self.store.flush()) {
            self.halt(&e.to_string());
        }
        Ok(tidied?)
    }

    fn read(&self) -> RwLockReadGuard<'_, State> {
        self.state.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self) -> RwLockWriteGuard<'_, State> {
        self.state.write().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Registry {
    fn drop(&mut self) {
        // What a halted registry's store holds is unknown: nobody is to vouch for it.
        if self.halted().is_none()
            && let Some(seal) = &mut self.seal
        {
            seal.arm(self.store.known_files());
        }
    }
}
