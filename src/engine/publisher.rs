//! The thread that publishes: what is durable goes into the files that monitors read, soon after, and out of
//! the submitters' way; then the witnesses are asked.
//!
//! One publication covers all that came in since the last. A failure is logged and tried again: nothing
//! is lost by it, since what was acknowledged is durable already.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use cairn_registry::{Checkpoint, Registry};

use super::error::EngineError;
use super::folder::{read_limited, write_atomic};

/// Between two publications at least this long: under load each then covers many records.
const PAUSE: Duration = Duration::from_millis(200);
/// Largest checkpoint that is read, bytes.
const MAX_CHECKPOINT: u64 = 1 << 16;
/// After a failure, until the next attempt.
const RETRY: Duration = Duration::from_secs(2);

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

impl Publisher {
    /// Starts the thread. After each publication `last` holds the published checkpoint: outside the log's own folder, so
    /// that a folder restored from a backup is found out.
    ///
    /// # Errors
    /// Where the system has no thread to give.
    pub fn start(registry: Arc<Registry>, last: PathBuf) -> Result<Self, EngineError> {
        let asked = Arc::new((Mutex::new(Asked { publish: true, stop: false }), Condvar::new()));
        let of_thread = asked.clone();
        let thread = std::thread::Builder::new()
            .name("publisher".into())
            .spawn(move || run(&registry, &last, &of_thread))
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

fn lock(asked: &Mutex<Asked>) -> MutexGuard<'_, Asked> {
    asked.lock().unwrap_or_else(PoisonError::into_inner)
}

fn run(registry: &Registry, last: &Path, asked: &(Mutex<Asked>, Condvar)) {
    let mut pause = Duration::ZERO;
    loop {
        let guard = lock(&asked.0);
        // A pause is cut short by the end, and by nothing else.
        let (guard, _) =
            (asked.1.wait_timeout_while(guard, pause, |asked| !asked.stop)).unwrap_or_else(PoisonError::into_inner);
        let mut guard =
            asked.1.wait_while(guard, |asked| !asked.publish && !asked.stop).unwrap_or_else(PoisonError::into_inner);
        let stop = guard.stop;
        guard.publish = false;
        drop(guard);
        pause = match publish(registry, last) {
            Ok(()) => PAUSE,
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

/// Holds the log to the checkpoint that it published last, where there is one.
///
/// # Errors
/// [`cairn_registry::RegistryError::Inconsistent`] for a log that does not go on from it: it is older, or another.
pub fn hold_to_last(registry: &Registry, last: &Path) -> Result<(), EngineError> {
    if !last.exists() {
        return Ok(());
    }
    let stored = |problem: String| EngineError::Stored { path: last.to_path_buf(), problem };
    let note = String::from_utf8(read_limited(last, MAX_CHECKPOINT)?).map_err(|e| stored(e.to_string()))?;
    let known = Checkpoint::verify(&note, &registry.verifier()?).map_err(|e| stored(e.to_string()))?;
    Ok(registry.must_extend(&known)?)
}

fn publish(registry: &Registry, last: &Path) -> Result<(), EngineError> {
    let published = registry.publish()?;
    write_atomic(last, published.checkpoint.as_bytes())
}
