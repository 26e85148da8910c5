//! The registry over one store: its doors, each of which leads to the part that does the work.

use std::{
    path::Path,
    sync::{Arc, Condvar, Mutex, OnceLock, RwLock},
    time::Duration,
};

use cairn_durable::{Disk, Files, LockFile, RealDisk, make_folders};

use super::{
    anchor::{Anchor, Standing},
    answer,
    commit::{self, Receipt},
    erase,
    error::{RegistryError, inconsistent},
    fill, layout,
    nonce::Nonces,
    publish,
    read::{self, LogEntry, StoredRecord},
    rebuild::{self, Rebuilt},
    reload,
    seal::Seal,
    shared::{Published, Shared, lock},
    store::{DiskStore, Store, TieredStore},
};
use crate::format::{
    answer::Answer,
    checkpoint::Checkpoint,
    digest::Digest,
    dsse::Envelope,
    erasure::Erasure,
    key::{OwnerKey, PublicKey},
    leaf::Leaf,
    map::MapKey,
    note::NoteVerifier,
    shares::Shares,
    signed::SignedRecord,
    tile::TilePath,
};

/// The registry over one store, `Send` and `Sync`: shared between threads by reference.
///
/// Its calls block on the disk; an asynchronous caller gives them a thread. Whoever owns it calls
/// [`Registry::publish`] now and then: submitting alone writes nothing that monitors read.
pub struct Registry {
    pub(super) shared: Shared,
    // After the store, which must be closed to be sealed, and before the lock, under which that has to happen.
    seal: Option<Seal>,
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
        make_folders(path)?;
        let lock = LockFile::take(&path.join(layout::LOCK))?;
        if path.join(layout::CHECKPOINT).exists() && !path.join(layout::WORKING).exists() {
            let what = "it is missing, and a checkpoint was published".into();
            return Err(inconsistent(layout::WORKING, what));
        }
        let seal = Seal::break_open(path)?;
        let store = DiskStore::open(&path.join(layout::WORKING))?;
        let disk = Box::new(RealDisk::new(path));
        let mut registry = Self::open_tiered(Box::new(store), disk, key, origin, layout::ENOUGH, anchor)?;
        // Only now: a start that is refused must not seal what it was refused for.
        (registry.seal, registry._lock) = (Some(seal), Some(lock));
        Ok(registry)
    }

    /// Opens the log in the folder `path` to read it, and writes no file of it but its store: that is a copy, and the rest
    /// may be another's. The caller must not submit.
    ///
    /// # Errors
    /// As [`Registry::open`], without [`RegistryError::Locked`]; [`RegistryError::Store`] for a log that was not closed
    /// cleanly and has to be mended first.
    pub fn open_reading(path: &Path, key: OwnerKey, origin: &str) -> Result<Self, RegistryError> {
        let store = DiskStore::open(&path.join(layout::WORKING))?;
        let disk = Box::new(RealDisk::only_reading(path));
        Self::open_tiered(Box::new(store), disk, key, origin, layout::ENOUGH, None)
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
        let shared = Shared {
            nonces: Nonces::new(&key, origin, loaded.nonces_from),
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
        };
        match loaded.standing {
            Standing::Ahead(round) => commit::take_up(&shared, round)?,
            Standing::Behind => {
                if let Some(anchor) = &shared.anchor {
                    anchor.write(&shared.head()?)?;
                }
            }
        }
        let pack_length = lock(&shared.writer).pack_length;
        reload::cut_packs(&shared.files, shared.size(), pack_length)?;
        Ok(Self { shared, seal: None, _lock: None })
    }

    /// The log's name.
    pub fn origin(&self) -> &str {
        &self.shared.origin
    }

    /// The registry's public key.
    pub fn public_key(&self) -> PublicKey {
        self.shared.key.public()
    }

    /// The verifier key (vkey) that others pin.
    ///
    /// # Errors
    /// None once the registry is open: the origin was checked then.
    pub fn verifier(&self) -> Result<NoteVerifier, RegistryError> {
        self.shared.verifier()
    }

    /// A nonce for a record of `owner` about `scene`: good for one record, for [`NONCE_LIFETIME`](crate::log::NONCE_LIFETIME) log entries of growth,
    /// also after a restart.
    ///
    /// # Errors
    /// [`RegistryError::Key`] where the system gives no random numbers.
    pub fn nonce(&self, scene: &str, owner: &PublicKey) -> Result<Digest, RegistryError> {
        Ok(self.shared.nonces.issue(self.size(), scene, owner)?)
    }

    /// How many entries are durable and signed for: records and map leaves.
    pub fn size(&self) -> u64 {
        self.shared.size()
    }

    /// The newest signed checkpoint (a signed note).
    pub fn checkpoint(&self) -> String {
        self.shared.read().checkpoint.clone()
    }

    /// The newest checkpoint that carries witnesses' cosignatures, where there is one.
    pub fn cosigned(&self) -> Option<String> {
        self.shared.read().cosigned.as_ref().map(|(_, note)| note.clone())
    }

    /// How many entries the newest cosigned checkpoint covers; 0 where there is none.
    pub fn cosigned_size(&self) -> u64 {
        self.shared.read().cosigned.as_ref().map_or(0, |(size, _)| *size)
    }

    /// Size and root of the newest checkpoint, unsigned: what a signer puts into `seen`.
    ///
    /// # Errors
    /// [`RegistryError::Inconsistent`] for a damaged tile.
    pub fn head(&self) -> Result<Checkpoint, RegistryError> {
        self.shared.head()
    }

    /// Why the registry writes no more, if it halted.
    pub fn halted(&self) -> Option<String> {
        self.shared.halted()
    }

    /// Checks that this log goes on from a checkpoint of it that is known from elsewhere: published, cosigned, written
    /// down. To be asked before serving, since a store restored from an old backup agrees with itself and would sign a
    /// second history. Where it does not go on from it, the registry halts.
    ///
    /// # Errors
    /// [`RegistryError::Inconsistent`], [`RegistryError::WrongOrigin`].
    pub fn must_extend(&self, known: &Checkpoint) -> Result<(), RegistryError> {
        if known.origin != self.shared.origin {
            return Err(RegistryError::WrongOrigin { expected: self.shared.origin.clone(), got: known.origin.clone() });
        }
        // Nobody signs meanwhile.
        let state = self.shared.write();
        reload::extends(&state.tree, state.size, known).inspect_err(|e| drop(self.shared.halt(&e.to_string())))
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
        let tidied = self.shared.store.tidy(stop);
        // A file that cannot be written does no harm. After a write of the store that failed it takes no more.
        if let (Err(e), Err(_)) = (&tidied, self.shared.store.flush()) {
            self.shared.halt(&e.to_string());
        }
        Ok(tidied?)
    }

    /// What monitors see now; none before the first publication.
    pub fn published(&self) -> Option<Published> {
        self.shared.published()
    }

    /// How long the round that is being written has been; `None` where none is. A disk that does not answer, or a store
    /// that waits for itself, keeps its writer for ever: whoever finds that stops the writing ([`Registry::stop_writing`]).
    pub fn writing_for(&self) -> Option<Duration> {
        lock(&self.shared.queue).busy.map(|since| since.elapsed())
    }

    /// Stops all writing for good: somebody outside knows better what this log is. It goes on reading and proving.
    /// Whoever waits for the round to come is refused at once; whose round is being written waits for that.
    pub fn stop_writing(&self, cause: &str) {
        self.shared.halt(cause);
        // Under its lock: a call between a look and a wait would not be heard.
        let _queue = lock(&self.shared.queue);
        self.shared.wake.notify_all();
    }

    /// Writes the tiles and the checkpoint of everything that is durable, for monitors to read. Nothing where nothing came
    /// in since the last time. Blocks on the disk.
    ///
    /// # Errors
    /// [`RegistryError::Store`]: nothing is lost, and the next call tries again; [`RegistryError::Inconsistent`].
    pub fn publish(&self) -> Result<Published, RegistryError> {
        publish::publish(&self.shared)
    }

    /// Takes in the cosignatures of a published checkpoint: `note` is its text with more signature lines. They are
    /// shown to monitors from now on, and go into proofs. Lines that are not about this checkpoint are the caller's to refuse.
    ///
    /// # Errors
    /// [`RegistryError::Inconsistent`] where the note is none of this log's, or is about another tree than the log's;
    /// [`RegistryError::Store`].
    pub fn cosign(&self, note: &str) -> Result<(), RegistryError> {
        publish::cosign(&self.shared, note)
    }

    /// Takes a record into the log. Blocks until it is durable.
    ///
    /// The same record again gives its old index, so a submitter whose connection broke asks again. A record that was refused
    /// or failed left no trace, except after [`RegistryError::Store`] and [`RegistryError::Halted`]: then it may be in the log
    /// after the next start; submit it again.
    ///
    /// # Errors
    /// [`RegistryError`]; nothing is acknowledged that is not flushed.
    pub fn submit(&self, record: SignedRecord) -> Result<Receipt, RegistryError> {
        commit::submit(&self.shared, record)
    }

    /// Proof that entry `index` lies in the tree of `size` entries.
    ///
    /// # Errors
    /// [`RegistryError::Proof`] for an index or size that is not there; [`RegistryError::Inconsistent`] for a damaged tile.
    pub fn prove_inclusion(&self, index: u64, size: u64) -> Result<Vec<Digest>, RegistryError> {
        read::prove_inclusion(&self.shared, index, size)
    }

    /// Record `index`, its envelope re-verified.
    ///
    /// # Errors
    /// [`RegistryError::NoSuchRecord`], [`RegistryError::NotARecord`], [`RegistryError::Erased`];
    /// [`RegistryError::Inconsistent`] where leaf and envelope do not belong together.
    pub fn record(&self, index: u64) -> Result<StoredRecord, RegistryError> {
        read::record(&self.shared, index)
    }

    /// Entry `index`, whatever it is, a record's envelope re-verified.
    ///
    /// # Errors
    /// [`RegistryError::NoSuchRecord`]; [`RegistryError::Inconsistent`] where what is kept of it does not belong together.
    pub fn entry(&self, index: u64) -> Result<LogEntry, RegistryError> {
        read::entry(&self.shared, index)
    }

    /// The bytes of a tile or of a bundle of entries (leaves), as monitors fetch them; none where the log does not
    /// hold all of it.
    ///
    /// # Errors
    /// [`RegistryError::Store`]; [`RegistryError::Inconsistent`] where a leaf is missing.
    pub fn tile(&self, path: &TilePath) -> Result<Option<Vec<u8>>, RegistryError> {
        read::tile(&self.shared, path)
    }

    /// Index of the record with this digest (SHA-256 of its PAE), if the log holds it.
    ///
    /// # Errors
    /// [`RegistryError::Store`], [`RegistryError::Inconsistent`].
    pub fn find(&self, record: &Digest) -> Result<Option<u64>, RegistryError> {
        read::find(&self.shared, record)
    }

    /// Erases the record that a signed request names; gives its index. That the request is for this log, names the record
    /// that stands there, and carries a fresh nonce is checked here; whether its key may speak for the record is the
    /// caller's to say, who knows what has become of the record since.
    ///
    /// # Errors
    /// [`RegistryError::WrongOrigin`], [`RegistryError::NonceForeign`], [`RegistryError::NonceExpired`],
    /// [`RegistryError::NoSuchRecord`], and as [`Registry::erase_index`].
    pub fn erase(&self, erasure: &Erasure) -> Result<u64, RegistryError> {
        erase::erase(&self.shared, erasure)
    }

    /// Erases record `index`, durably on return; a record that is erased already stays so. Who may ask for it is the
    /// caller's to decide ([`Registry::erase`] does for owners).
    ///
    /// # Errors
    /// [`RegistryError::NoSuchRecord`], [`RegistryError::NotARecord`]; [`RegistryError::Halted`];
    /// [`RegistryError::Store`]: then it is erased or not, and asking again is safe.
    pub fn erase_index(&self, index: u64) -> Result<(), RegistryError> {
        erase::erase_index(&self.shared, index)
    }

    /// Who contributed to a scene, or to one photograph of it (by its SHA-256), with the proofs that each record is in the
    /// log and none is left out. Under the newest checkpoint; where `as_of` names an older one of this log (a signed
    /// note), with the proof that the one goes on from the other.
    ///
    /// Nothing is written while the lists are put together: log and map have to be of one moment. Proofs and the
    /// envelopes to hand out are fetched afterwards, since what stands in the log stays there.
    ///
    /// # Errors
    /// [`RegistryError::Inconsistent`] for an `as_of` that is none of this log's; [`RegistryError::Answer`] for more
    /// records than an answer holds, or more than about `most` bytes of them.
    pub fn answer(
        &self,
        scene: &str,
        view: Option<&Digest>,
        as_of: Option<&str>,
        most: usize,
    ) -> Result<Answer, RegistryError> {
        answer::answer(&self.shared, scene, view, as_of, most)
    }

    /// Signs a statement of shares in the registry's name. It is in no log.
    ///
    /// # Errors
    /// [`RegistryError::Record`] for one that is not as it must be, or names another key.
    pub fn sign_shares(&self, shares: &Shares) -> Result<Envelope, RegistryError> {
        Ok(shares.seal(&self.shared.key)?)
    }

    /// Appends erased records in one batch, durable on return: for each its leaf and its map keys.
    ///
    /// # Errors
    /// [`RegistryError::WrongOrigin`] for a log that is not a benchmark's, [`RegistryError::Halted`], [`RegistryError::Store`].
    pub fn fill(&self, records: impl Iterator<Item = (Leaf, Vec<MapKey>)>) -> Result<(), RegistryError> {
        fill::fill(&self.shared, records)
    }

    /// Makes the working state of the log in the folder `path` again. What is there of it must have been moved away.
    /// Single leaves' files are believed only as far as the published root goes.
    ///
    /// `progress` is told entries done and entries that are published. Ended early, it begins anew the next time.
    ///
    /// # Errors
    /// [`RegistryError::Rebuild`] names what is there already, missing or contradicts what was signed;
    /// [`RegistryError::Locked`], [`RegistryError::Store`].
    pub fn rebuild(
        path: &Path,
        key: &OwnerKey,
        origin: &str,
        progress: &mut dyn FnMut(u64, u64),
    ) -> Result<Rebuilt, RegistryError> {
        rebuild::rebuild(path, key, origin, progress)
    }

    /// As [`Registry::rebuild`], into a store of the caller's, which is empty; its sorted runs go into the folder of `runs`,
    /// each begun with so many rows.
    ///
    /// # Errors
    /// As [`Registry::rebuild`].
    pub fn rebuild_store(
        store: Box<dyn Store>,
        disk: Box<dyn Disk>,
        runs: &'static str,
        enough: usize,
        key: &OwnerKey,
        origin: &str,
        progress: &mut dyn FnMut(u64, u64),
    ) -> Result<Rebuilt, RegistryError> {
        rebuild::rebuild_store(store, disk, runs, enough, key, origin, progress)
    }
}

impl Drop for Registry {
    fn drop(&mut self) {
        // What a halted registry's store holds is unknown: nobody is to vouch for it.
        if self.halted().is_none()
            && let Some(seal) = &mut self.seal
        {
            seal.arm(self.shared.store.known_files());
        }
    }
}
