//! The thread that publishes: what is durable goes into the files that monitors read, soon after, and out of
//! the submitters' way; then the witnesses are asked for their cosignatures.
//!
//! One publication covers all that came in since the last. A failure is logged and tried again: nothing
//! is lost by it, since what was acknowledged is durable already. But a witness that saw more of this log than there
//! is, or another tree, says that the folder was restored from an old backup or forked: then the log does not start,
//! or stops writing.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use cairn_registry::{Checkpoint, Note, Registry};
use cairn_witness::{WitnessClient, WitnessError, client::collect};

use super::error::EngineError;
use super::folder::{read_limited, write_atomic};

/// Between two publications at least this long: under load each then covers many records.
const PAUSE: Duration = Duration::from_millis(200);
/// After a failure, until the next attempt.
const RETRY: Duration = Duration::from_secs(2);
/// Largest checkpoint that is read, bytes.
const MAX_CHECKPOINT: u64 = 1 << 16;

#[derive(Default)]
struct Asked {
    publish: bool,
    stop: bool,
}

/// The thread's handle. Dropping it publishes a last time.
pub struct Publisher {
    asked: Arc<(Mutex<Asked>, Condvar)>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

/// What a publication needs.
struct Publication {
    registry: Arc<Registry>,
    /// Where the published checkpoint is kept outside the log's own folder, so that a folder restored from a backup is
    /// found out.
    last: PathBuf,
    witnesses: Vec<WitnessClient>,
}

impl Publisher {
    /// Holds the log to the checkpoint that it published last and to its witnesses, publishes, and starts the thread.
    ///
    /// # Errors
    /// [`cairn_registry::RegistryError::Inconsistent`], [`EngineError::Witness`] for a log that does not go on from what
    /// was published or cosigned; where the system has no thread to give. A witness that cannot be reached is logged.
    pub fn start(registry: Arc<Registry>, last: PathBuf, witnesses: Vec<WitnessClient>) -> Result<Self, EngineError> {
        hold_to_last(&registry, &last)?;
        let publication = Publication { registry, last, witnesses };
        publication.publish()?;
        publication.ask_witnesses()?;
        let asked = Arc::<(Mutex<Asked>, Condvar)>::default();
        let of_thread = asked.clone();
        let thread = std::thread::Builder::new()
            .name("publisher".into())
            .spawn(move || publication.run(&of_thread))
            .map_err(|e| EngineError::Internal(format!("the publisher's thread cannot start: {e}")))?;
        Ok(Self { asked, thread: Mutex::new(Some(thread)) })
    }

    /// Something became durable.
    pub fn wake(&self) {
        lock(&self.asked.0).publish = true;
        self.asked.1.notify_one();
    }

    /// Publishes what is left and ends the thread. Once is enough.
    pub fn stop(&self) {
        lock(&self.asked.0).stop = true;
        self.asked.1.notify_one();
        if let Some(thread) = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take() {
            // A panic in there was reported on its own thread.
            let _ = thread.join();
        }
    }
}

impl Drop for Publisher {
    fn drop(&mut self) {
        self.stop();
    }
}

impl Publication {
    fn run(&self, asked: &(Mutex<Asked>, Condvar)) {
        let mut pause = Duration::ZERO;
        loop {
            let guard = lock(&asked.0);
            // A pause is cut short by the end, and by nothing else.
            let waited = asked.1.wait_timeout_while(guard, pause, |asked| !asked.stop);
            let (guard, _) = waited.unwrap_or_else(PoisonError::into_inner);
            let waited = asked.1.wait_while(guard, |asked| !asked.publish && !asked.stop);
            let mut guard = waited.unwrap_or_else(PoisonError::into_inner);
            let stop = guard.stop;
            guard.publish = false;
            drop(guard);
            pause = match self.publish().and_then(|()| self.ask_witnesses()) {
                Ok(()) => PAUSE,
                Err(EngineError::Witness(error)) => {
                    tracing::error!(%error, "the log stops writing: it does not go on from what was cosigned");
                    self.registry.stop_writing(&error.to_string());
                    RETRY
                }
                Err(error) => {
                    tracing::error!(%error, "publishing failed; what was acknowledged is durable, and is published later");
                    lock(&asked.0).publish = true;
                    RETRY
                }
            };
            if stop {
                return;
            }
        }
    }

    fn publish(&self) -> Result<(), EngineError> {
        let published = self.registry.publish()?;
        write_atomic(&self.last, published.checkpoint.as_bytes())
    }

    /// Has what is published cosigned, by whoever answers.
    fn ask_witnesses(&self) -> Result<(), EngineError> {
        let Some(published) = self.registry.published().filter(|_| !self.witnesses.is_empty()) else { return Ok(()) };
        let prove = |from, to| self.registry.prove_consistency(from, to).map_err(|e| e.to_string());
        let log = Note::parse(&published.checkpoint).map_err(cairn_registry::CheckpointError::from);
        let mut note = log.map_err(|e| EngineError::Internal(format!("the log's own checkpoint: {e}")))?;
        // The log's own signature stands first; cosignatures of an earlier round are replaced.
        note.signatures.truncate(1);
        for answer in collect(&self.witnesses, &note.to_string(), &prove) {
            match answer {
                Ok(cosignature) => note.signatures.push(cosignature.line),
                Err(error @ (WitnessError::Ahead { .. } | WitnessError::Inconsistent { .. })) => {
                    return Err(error.into());
                }
                Err(error) => tracing::warn!(%error, "no cosignature"),
            }
        }
        if note.signatures.len() > 1 {
            self.registry.cosign(&note.to_string())?;
            write_atomic(&self.last, note.to_string().as_bytes())?;
        }
        Ok(())
    }
}

fn lock(asked: &Mutex<Asked>) -> MutexGuard<'_, Asked> {
    asked.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Holds the log to the checkpoint that it published last, where there is one.
fn hold_to_last(registry: &Registry, last: &Path) -> Result<(), EngineError> {
    if !last.exists() {
        return Ok(());
    }
    let stored = |problem: String| EngineError::Stored { path: last.to_path_buf(), problem };
    let note = String::from_utf8(read_limited(last, MAX_CHECKPOINT)?).map_err(|e| stored(e.to_string()))?;
    let known = Checkpoint::verify(&note, &registry.verifier().map_err(EngineError::from)?);
    Ok(registry.must_extend(&known.map_err(|e| stored(e.to_string()))?)?)
}
