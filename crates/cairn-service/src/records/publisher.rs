//! The threads that publish: what is durable goes into the files that monitors read, soon after, and out of
//! the submitters' way; another then asks the witnesses for their cosignatures, however slow they are, and a third puts the
//! log's store in order.
//!
//! One publication covers all that came in since the last. A failure is logged and tried again: nothing
//! is lost by it, since what was acknowledged is durable already. But a witness that saw more of this log than there
//! is, or another tree, says that the folder was restored from an old backup or forked: then the log does not start,
//! or, where the witness shows the log's own signature on it, stops writing.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use cairn_log::witness::{WitnessClient, WitnessError, client::collect};
use cairn_log::{Note, Registry};

use crate::error::EngineError;

/// Between two publications at least this long: under load each then covers many records.
const PAUSE: Duration = Duration::from_millis(400);
/// Between two times of putting the store in order: nothing waits for it.
const TIDY_PAUSE: Duration = Duration::from_secs(2);
/// After a failure, until the next attempt.
const RETRY: Duration = Duration::from_secs(2);
/// Longest that a proof waits for cosignatures.
const PATIENCE: Duration = Duration::from_secs(3);
/// After a witness that did not answer, or a store that could not be put in order, until the next attempt.
const ASK_AGAIN: Duration = Duration::from_secs(30);

#[derive(Default)]
struct Asked {
    work: bool,
    stop: bool,
}

/// What a thread waits for.
type Bell = (Mutex<Asked>, Condvar);

/// The threads' handle. Dropping it publishes a last time.
pub struct Publisher {
    bells: [Arc<Bell>; 3],
    threads: Mutex<Vec<JoinHandle<()>>>,
    /// Whether there are witnesses, and they answered the last time.
    witnessed: Arc<AtomicBool>,
}

/// What a publication needs.
struct Publication {
    registry: Arc<Registry>,
    witnesses: Vec<WitnessClient>,
    witnessed: Arc<AtomicBool>,
}

impl Publisher {
    /// Holds the log to its witnesses, publishes, and starts the threads.
    ///
    /// # Errors
    /// [`EngineError::Witness`] for a log that does not go on from what was cosigned; where the system has no thread to
    /// give. A witness that cannot be reached is logged.
    pub fn start(registry: Arc<Registry>, witnesses: Vec<WitnessClient>) -> Result<Self, EngineError> {
        let witnessed = Arc::new(AtomicBool::new(false));
        let publication = Arc::new(Publication { registry, witnesses, witnessed: witnessed.clone() });
        publication.publish()?;
        // At a start a witness is taken at its word: whoever knows better names it no more.
        publication.ask_witnesses()?;
        let bells: [Arc<Bell>; 3] = Default::default();
        let [publish, cosign, tidy] = bells.clone();
        let mut threads = Vec::new();
        let (of_publisher, next) = (publication.clone(), [cosign.clone(), tidy.clone()]);
        threads.push(spawn("publisher", move || of_publisher.publish_again(&publish, &next))?);
        let of_tidier = publication.clone();
        threads.push(spawn("tidier", move || of_tidier.tidy_again(&tidy))?);
        if !publication.witnesses.is_empty() {
            threads.push(spawn("witnesses", move || publication.ask_again(&cosign))?);
        }
        Ok(Self { bells, threads: Mutex::new(threads), witnessed })
    }

    /// Something became durable.
    pub fn wake(&self) {
        ring(&self.bells[0]);
    }

    /// Waits, but not for long, until witnesses cosigned a checkpoint that covers entry `index`. Returns at once where
    /// there are none, or none that answer.
    pub fn await_cosigned(&self, registry: &Registry, index: u64) {
        let begun = Instant::now();
        let waiting = || self.witnessed.load(Ordering::Relaxed) && begun.elapsed() < PATIENCE;
        while registry.cosigned_size() <= index && waiting() {
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Publishes what is left and ends the threads. Once is enough.
    pub fn stop(&self) {
        for bell in &self.bells {
            lock(&bell.0).stop = true;
            bell.1.notify_one();
        }
        for thread in self.threads.lock().unwrap_or_else(PoisonError::into_inner).drain(..) {
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
    /// The publisher's thread: a round for all that came in since the last, and one at the end.
    fn publish_again(&self, bell: &Bell, next: &[Arc<Bell>]) {
        let mut pause = Duration::ZERO;
        loop {
            let stop = wait(bell, pause, None);
            pause = PAUSE;
            match self.publish() {
                Ok(()) => next.iter().for_each(|bell| ring(bell)),
                Err(error) => {
                    tracing::error!(%error, "publishing failed; what was acknowledged is durable, and is published later");
                    ring(bell);
                    pause = RETRY;
                }
            }
            if stop {
                return;
            }
        }
    }

    /// The witnesses' thread: asks for what is published, and again later where one did not answer.
    fn ask_again(&self, bell: &Bell) {
        let mut later = (!self.witnessed.load(Ordering::Relaxed)).then_some(ASK_AGAIN);
        while !wait(bell, PAUSE, later) {
            later = match self.ask_witnesses() {
                Ok(true) => None,
                Ok(false) => Some(ASK_AGAIN),
                Err(error) => {
                    tracing::error!(%error, "no cosignatures; asked again later");
                    if self.is_proven() {
                        tracing::error!("the log stops writing: it does not go on from what was cosigned");
                        self.registry.stop_writing(&error.to_string());
                    }
                    Some(ASK_AGAIN)
                }
            };
        }
    }

    /// The tidier's thread.
    fn tidy_again(&self, bell: &Bell) {
        let mut later = None;
        while !wait(bell, TIDY_PAUSE, later) {
            let tidied = self.registry.tidy(&|| lock(&bell.0).stop);
            later = tidied.is_err().then_some(ASK_AGAIN);
            if let Err(error) = tidied {
                let halted = self.registry.halted();
                tracing::error!(%error, ?halted, "the registry's store cannot be put in order; nothing is lost");
            }
        }
    }

    fn publish(&self) -> Result<(), EngineError> {
        self.registry.publish()?;
        Ok(())
    }

    /// Has what is published cosigned; whether every witness did. One that saw more of the log, or another log, is an error.
    fn ask_witnesses(&self) -> Result<bool, EngineError> {
        let Some(published) = self.registry.published().filter(|_| !self.witnesses.is_empty()) else {
            return Ok(true);
        };
        let prove = |from, to| self.registry.prove_consistency(from, to).map_err(|e| e.to_string());
        let log = Note::parse(&published.checkpoint).map_err(cairn_log::CheckpointError::from);
        let mut note = log.map_err(|e| EngineError::Internal(format!("the log's own checkpoint: {e}")))?;
        // The log's own signature stands first; cosignatures of an earlier round are replaced.
        note.signatures.truncate(1);
        let mut contradiction = None;
        for answer in collect(&self.witnesses, &note.to_string(), &prove) {
            match answer {
                Ok(cosignature) => note.signatures.push(cosignature.line),
                Err(error @ (WitnessError::Ahead { .. } | WitnessError::Inconsistent { .. })) => {
                    contradiction = Some(error);
                }
                Err(error) => tracing::warn!(%error, "no cosignature"),
            }
        }
        let all = note.signatures.len() == self.witnesses.len() + 1;
        self.witnessed.store(note.signatures.len() > 1, Ordering::Relaxed);
        if note.signatures.len() > 1 {
            self.registry.cosign(&note.to_string())?;
        }
        contradiction.map_or(Ok(all), |error| Err(error.into()))
    }

    /// Whether a witness can show the log's own signature on what contradicts it: a refusal alone is nobody's word.
    fn is_proven(&self) -> bool {
        let Ok(verifier) = self.registry.verifier() else { return false };
        self.witnesses.iter().any(|witness| match witness.latest(&verifier) {
            Ok(Some(witnessed)) => self.registry.must_extend(&witnessed.checkpoint).is_err(),
            Ok(None) | Err(_) => false,
        })
    }
}

fn spawn(name: &str, work: impl FnOnce() + Send + 'static) -> Result<JoinHandle<()>, EngineError> {
    let thread = std::thread::Builder::new().name(name.into()).spawn(work);
    thread.map_err(|e| EngineError::Internal(format!("the {name} thread cannot start: {e}")))
}

fn ring(bell: &Bell) {
    // Once is enough until it is heard: a submitter a record would wake a thread that is in its pause.
    if !std::mem::replace(&mut lock(&bell.0).work, true) {
        bell.1.notify_one();
    }
}

/// Waits out a pause, which only the end cuts short, and then for work, or for `later`; whether it is the end.
fn wait(bell: &Bell, pause: Duration, later: Option<Duration>) -> bool {
    let guard = lock(&bell.0);
    let paused = bell.1.wait_timeout_while(guard, pause, |asked| !asked.stop);
    let (guard, _) = paused.unwrap_or_else(PoisonError::into_inner);
    let idle = |asked: &mut Asked| !asked.work && !asked.stop;
    let mut guard = match later {
        None => bell.1.wait_while(guard, idle).unwrap_or_else(PoisonError::into_inner),
        Some(later) => bell.1.wait_timeout_while(guard, later, idle).unwrap_or_else(PoisonError::into_inner).0,
    };
    guard.work = false;
    guard.stop
}

fn lock(asked: &Mutex<Asked>) -> MutexGuard<'_, Asked> {
    asked.lock().unwrap_or_else(PoisonError::into_inner)
}
