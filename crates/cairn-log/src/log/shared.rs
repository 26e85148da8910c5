//! What the parts of the registry share: the log's state, who waits, who writes, who publishes.

use std::{
    collections::HashMap,
    sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard},
    time::Instant,
};

use cairn_durable::Files;

use super::{anchor::Anchor, error::RegistryError, map::BucketMap, nonce::Nonces, store::Store, tiles::TileTree};
use crate::format::{
    checkpoint::Checkpoint, digest::Digest, dsse::Envelope, key::OwnerKey, merkle, note::NoteVerifier,
    signed::SignedRecord,
};

/// What the log is, as its readers see it.
pub(super) struct State {
    /// May hold leaves beyond `size` while they are being written; readers never look past `size`.
    pub(super) tree: TileTree,
    /// The map over the leaves before the last one.
    pub(super) map: BucketMap,
    /// Leaves that are durable and signed for.
    pub(super) size: u64,
    /// Root over them.
    pub(super) root: Digest,
    /// Signed checkpoint over them.
    pub(super) checkpoint: String,
    /// The newest checkpoint that witnesses cosigned, and its size.
    pub(super) cosigned: Option<(u64, String)>,
}

/// A log that is open: one writer, many readers.
pub(super) struct Shared {
    pub(super) origin: String,
    pub(super) key: OwnerKey,
    pub(super) nonces: Nonces,
    pub(super) state: RwLock<State>,
    /// Why nothing is written any more. Not in the state, whose lock a disk that does not answer may keep.
    pub(super) halted: OnceLock<String>,
    pub(super) queue: Mutex<Queue>,
    pub(super) wake: Condvar,
    /// Locked by the thread that has the turn, and by no other.
    pub(super) writer: Mutex<Writer>,
    pub(super) publisher: Mutex<Publisher>,
    pub(super) files: Arc<Files>,
    pub(super) anchor: Option<Anchor>,
    pub(super) store: Box<dyn Store>,
}

impl Shared {
    pub(super) fn read(&self) -> RwLockReadGuard<'_, State> {
        self.state.read().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn write(&self) -> RwLockWriteGuard<'_, State> {
        self.state.write().unwrap_or_else(PoisonError::into_inner)
    }

    /// The verifier key (vkey) that others pin.
    ///
    /// # Errors
    /// None once the registry is open: the origin was checked then.
    pub(super) fn verifier(&self) -> Result<NoteVerifier, RegistryError> {
        Ok(NoteVerifier::new(&self.origin, self.key.public())?)
    }

    /// How many entries are durable and signed for: records and map leaves.
    pub(super) fn size(&self) -> u64 {
        self.read().size
    }

    /// Size and root of the newest checkpoint, unsigned: what a signer puts into `seen`.
    ///
    /// # Errors
    /// [`RegistryError::Inconsistent`] for a damaged tile.
    pub(super) fn head(&self) -> Result<Checkpoint, RegistryError> {
        let state = self.read();
        Ok(Checkpoint::new(&self.origin, state.size, merkle::root_at(&state.tree, state.size)?))
    }

    /// Why the registry writes no more, if it halted.
    pub(super) fn halted(&self) -> Option<String> {
        self.halted.get().cloned()
    }

    /// What monitors see now; none before the first publication.
    pub(super) fn published(&self) -> Option<Published> {
        lock(&self.publisher).published.clone()
    }

    /// The turn to write, taken for something that no submission waits for.
    ///
    /// # Errors
    /// [`RegistryError::Halted`] where writing was stopped and the round that is being written does not end.
    pub(super) fn turn(&self) -> Result<Turn<'_>, RegistryError> {
        let mut queue = lock(&self.queue);
        while queue.busy.is_some() {
            if let Some(cause) = self.halted() {
                return Err(RegistryError::Halted { cause });
            }
            queue = self.wake.wait(queue).unwrap_or_else(PoisonError::into_inner);
        }
        queue.busy = Some(Instant::now());
        Ok(Turn { shared: self, batch: Vec::new() })
    }

    /// Stops all writing; the first cause stays.
    pub(super) fn halt(&self, cause: &str) -> String {
        self.halted.get_or_init(|| cause.to_owned()).clone()
    }
}

/// Where a submission ended up, or why nowhere. What its receipt proves is worked out by its own thread, out of the round.
pub(super) type Outcome = Result<Placed, RegistryError>;

/// Submissions that wait, and whether somebody is writing.
#[derive(Default)]
pub(super) struct Queue {
    pub(super) waiting: Vec<Waiting>,
    /// Since when somebody has been writing.
    pub(super) busy: Option<Instant>,
}

impl Queue {
    /// Takes a submission out again; false where a round has it already.
    pub(super) fn leave(&mut self, slot: &Arc<Mutex<Option<Outcome>>>) -> bool {
        let before = self.waiting.len();
        self.waiting.retain(|waiting| !Arc::ptr_eq(&waiting.slot, slot));
        self.waiting.len() < before
    }
}

/// What only the one who writes needs to know.
pub(super) struct Writer {
    /// Bytes of the pack that the next entry goes into.
    pub(super) pack_length: u64,
    /// Nonces that are used and would still be good otherwise, and the records that used them.
    pub(super) used: HashMap<Digest, u64>,
}

pub(super) struct Waiting {
    pub(super) candidate: SignedRecord,
    pub(super) slot: Arc<Mutex<Option<Outcome>>>,
}

/// Where a submission of this round ends up.
pub(super) struct Placed {
    pub(super) index: u64,
    pub(super) resubmitted: bool,
    pub(super) envelope: Envelope,
}

/// One writer's turn. However it ends, nobody is left waiting.
pub(super) struct Turn<'a> {
    pub(super) shared: &'a Shared,
    pub(super) batch: Vec<Waiting>,
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.shared.halt("the writer panicked");
        }
        for waiting in &self.batch {
            let mut slot = lock(&waiting.slot);
            if slot.is_none() {
                let cause = self.shared.halt("the writer panicked");
                *slot = Some(Err(RegistryError::Halted { cause }));
            }
        }
        lock(&self.shared.queue).busy = None;
        self.shared.wake.notify_all();
    }
}

/// What monitors see.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Published {
    /// Entries under the checkpoint.
    pub size: u64,
    /// The checkpoint, a signed note, with the cosignatures that it has so far.
    pub checkpoint: String,
}

/// Who publishes, one at a time.
pub(super) struct Publisher {
    /// Leaves that are in full tiles and bundles.
    pub(super) filed: u64,
    pub(super) published: Option<Published>,
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
