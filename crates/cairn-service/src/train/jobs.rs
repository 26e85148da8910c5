//! Training jobs: a bounded queue, one worker thread, states on the disk.
//!
//! Contract. `submit` returns only after the job is durable. One job runs at a
//! time, off the async runtime. `cancel` and `shut_down` MUST return only after
//! the worker has let go of the job. A job that was accepted or running when the
//! process died is found by `open`, which queues it again for a daemon, oldest first, and for nobody else. A panic in a job fails
//! that job and nothing else.

use std::collections::{BTreeMap, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use cairn_log::Digest;
use tokio::sync::watch;

use crate::error::EngineError;
use crate::store::access::{Access, unix_s};
use crate::store::folder::{read_json, write_json};
use crate::train::ahead::Ahead;
use crate::train::job::{self, Job, JobSpec, JobState, Progress, StageSeconds};
use cairn_durable::remove;

/// What runs a job. Called on the worker thread, one job at a time.
pub trait Work: Send + 'static {
    /// Runs `job` to its end, or until `control` asks to stop; then everything
    /// needed to go on MUST be on the disk when this returns.
    ///
    /// # Errors
    /// What stopped the job, for its list.
    fn run(&mut self, job: &Job, control: &Control<'_>) -> Result<Outcome, EngineError>;
}

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The job's result is in its place.
    Finished,
    /// It stopped because it was asked to.
    Stopped,
}

const GO_ON: u8 = 0;
const CANCEL: u8 = 1;
const SHUT_DOWN: u8 = 2;
/// Its owner's seconds of training are used up.
const USED_UP: u8 = 3;

/// The line between a running job and those who watch or stop it.
pub struct Control<'a> {
    stop: &'a AtomicU8,
    sender: &'a watch::Sender<Job>,
    path: PathBuf,
    /// Who pays, and where that is kept.
    owner: Option<(&'a Access, Digest)>,
    meter: Mutex<Meter>,
    ahead: Mutex<Ahead>,
}

/// The clock of a job that somebody pays for.
struct Meter {
    /// Charged until then.
    since: Instant,
    /// When the owner's seconds are used up.
    until: Option<Instant>,
}

impl Meter {
    fn new() -> Mutex<Self> {
        Mutex::new(Self { since: Instant::now(), until: None })
    }
}

impl<'a> Control<'a> {
    /// A line of its own, for tests of what runs a job.
    #[cfg(test)]
    pub(crate) fn stopping(stop: &'a AtomicU8, sender: &'a watch::Sender<Job>, path: PathBuf) -> Self {
        stop.store(CANCEL, Ordering::Release);
        Self::going_on(stop, sender, path)
    }

    /// The same, of a job that nobody stops unless `stop` says so.
    #[cfg(test)]
    pub(crate) fn going_on(stop: &'a AtomicU8, sender: &'a watch::Sender<Job>, path: PathBuf) -> Self {
        let ahead = Mutex::new(Ahead::of(&sender.borrow()));
        Self { stop, sender, path, owner: None, meter: Meter::new(), ahead }
    }

    /// Whether the job has to stop at its next step.
    pub fn stop_requested(&self) -> bool {
        let until = self.meter.lock().unwrap_or_else(PoisonError::into_inner).until;
        if until.is_some_and(|until| Instant::now() >= until) {
            // Whoever cancelled it, or shuts down, was first.
            let _ = self.stop.compare_exchange(GO_ON, USED_UP, Ordering::AcqRel, Ordering::Acquire);
        }
        self.stop.load(Ordering::Acquire) != GO_ON
    }

    /// Why a job was put down.
    fn used_up(&self) -> String {
        let why = self.owner.as_ref().and_then(|(access, owner)| access.check_training(owner, 0).err());
        let why = why.map_or("they are free again by now".to_owned(), |why| why.to_string());
        format!("its owner's seconds of training ran out, and it was put down at a checkpoint: {why}; then resume it")
    }

    /// Charges the owner with all the time since the last charge, whatever it went into, and works out anew when
    /// their seconds are used up.
    fn charge(&self) -> Result<(), EngineError> {
        let Some((access, owner)) = &self.owner else { return Ok(()) };
        let mut meter = self.meter.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Instant::now();
        access.spend(owner, now.duration_since(meter.since).as_secs_f64())?;
        meter.since = now;
        let left = access.seconds_left(owner).and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
        // More than a clock can say is no limit.
        meter.until = left.and_then(|left| now.checked_add(left));
        Ok(())
    }

    /// Tells the watchers how far the phase is that runs; its seconds left become the job's.
    pub fn progress(&self, progress: Progress) {
        let progress = self.ahead.lock().unwrap_or_else(PoisonError::into_inner).with_later(progress);
        self.sender.send_modify(|job| job.progress = progress);
    }

    /// Tells the watchers, once, what was found out; written down with what is spent next.
    pub fn note(&self, note: String) {
        self.sender.send_if_modified(|job| {
            let new = !job.notes.contains(&note);
            if new {
                job.notes.push(note);
            }
            new
        });
    }

    /// Adds seconds of computing to a stage, charges the owner and writes the job
    /// down: called with every checkpoint.
    ///
    /// # Errors
    /// The file system's.
    pub fn spent(&self, stage: &str, seconds: f64) -> Result<(), EngineError> {
        self.charge()?;
        self.sender.send_modify(|job| match job.stages.iter_mut().find(|s| s.stage == stage) {
            Some(known) => known.seconds += seconds,
            None => job.stages.push(StageSeconds { stage: stage.to_owned(), seconds }),
        });
        let job = self.sender.borrow().clone();
        write_json(&self.path, &job)
    }
}

struct Entry {
    sender: watch::Sender<Job>,
    stop: Arc<AtomicU8>,
}

#[derive(Default)]
struct Inner {
    jobs: BTreeMap<String, Entry>,
    queue: VecDeque<String>,
    running: Option<String>,
    closed: bool,
}

struct Shared {
    folder: PathBuf,
    inner: Mutex<Inner>,
    wake: Condvar,
    access: Option<Arc<Access>>,
}

/// The queue and its worker.
pub struct Jobs {
    shared: Arc<Shared>,
    capacity: usize,
    worker: Mutex<Option<JoinHandle<()>>>,
}

impl Jobs {
    /// Reads the jobs in `folder` and starts the worker. Those that were cut off are queued where they `go_on`; elsewhere
    /// they are [`JobState::Interrupted`]. Jobs with an owner are held to the quotas in `access`.
    ///
    /// # Errors
    /// [`EngineError::Stored`] for a job file that is damaged, and the file system's.
    pub fn open(
        folder: PathBuf,
        capacity: usize,
        access: Option<Arc<Access>>,
        go_on: bool,
        work: impl Work,
    ) -> Result<Self, EngineError> {
        let mut inner = Inner::default();
        let io = |e| EngineError::io("list", &folder)(e);
        for entry in std::fs::read_dir(&folder).map_err(io)? {
            let path = entry.map_err(io)?.path();
            let file = path.join("job.json");
            if !file.exists() {
                // Cut off before it was durable: nobody was told of it.
                remove(&path)?;
                continue;
            }
            let mut job: Job = read_json(&file, job::VERSION)?;
            if !job.state.has_ended() {
                job.state = if go_on { JobState::Accepted } else { JobState::Interrupted };
            }
            let entry = Entry { sender: watch::Sender::new(job.clone()), stop: Arc::default() };
            inner.jobs.insert(job.id, entry);
        }
        let waiting = |(id, e): (&String, &Entry)| (!e.sender.borrow().state.has_ended()).then(|| id.clone());
        inner.queue = inner.jobs.iter().filter_map(waiting).collect();
        let shared = Arc::new(Shared { folder, inner: Mutex::new(inner), wake: Condvar::new(), access });
        let of_worker = shared.clone();
        let worker = std::thread::Builder::new()
            .name("cairn-training".into())
            .spawn(move || of_worker.work(work))
            .map_err(|e| EngineError::Internal(format!("no thread for training: {e}")))?;
        Ok(Self { shared, capacity, worker: Mutex::new(Some(worker)) })
    }

    /// Queues a job that `owner` pays for, of which `notes` is known already. `prepare` puts what the job needs into its
    /// folder before the job counts.
    ///
    /// # Errors
    /// [`EngineError::QueueFull`], [`EngineError::ShuttingDown`], the owner's quotas', and the file system's.
    pub fn submit(
        &self,
        owner: Option<Digest>,
        spec: JobSpec,
        notes: Vec<String>,
        prepare: impl FnOnce(&std::path::Path) -> Result<(), EngineError>,
    ) -> Result<Job, EngineError> {
        let mut inner = self.shared.lock();
        self.check_room(&inner)?;
        self.check_owner(&inner, owner)?;
        let last = inner.jobs.keys().next_back().and_then(|id| id.strip_prefix("job-")?.parse::<u64>().ok());
        let id = format!("job-{:06}", last.unwrap_or(0) + 1);
        let folder = self.shared.folder.join(&id);
        let job = Job { owner, notes, ..Job::accepted(id.clone(), spec, unix_s()) };
        let write = || {
            std::fs::create_dir_all(&folder).map_err(EngineError::io("create", &folder))?;
            prepare(&folder)?;
            write_json(&folder.join("job.json"), &job)?;
            Ok(cairn_durable::sync_folder(&self.shared.folder)?)
        };
        if let Err(error) = write() {
            // What is left would only be in the way; the first error is the one to tell.
            let _ = remove(&folder);
            return Err(error);
        }
        inner.jobs.insert(id.clone(), Entry { sender: watch::Sender::new(job.clone()), stop: Arc::default() });
        inner.queue.push_back(id);
        self.shared.wake.notify_all();
        Ok(job)
    }

    /// Queues a job again that was cancelled or interrupted, or failed.
    ///
    /// # Errors
    /// As [`Jobs::submit`]; [`EngineError::WrongState`] for a job in another state.
    pub fn resume(&self, id: &str) -> Result<Job, EngineError> {
        let mut inner = self.shared.lock();
        self.check_room(&inner)?;
        let entry = inner.jobs.get(id).ok_or_else(|| self.unknown(&inner, id))?;
        let mut job = entry.sender.borrow().clone();
        if !matches!(job.state, JobState::Cancelled | JobState::Failed | JobState::Interrupted) {
            let why = format!("it is {}; only one that was cancelled or interrupted, or failed, can", job.state);
            return Err(EngineError::wrong_state(format!("job {id}"), "resumed", why));
        }
        self.check_owner(&inner, job.owner)?;
        job.state = JobState::Accepted;
        job.error.clear();
        job.ended_unix_s = 0;
        remove(&self.shared.folder.join(id).join(cairn_scene::MANIFEST))?;
        write_json(&self.shared.file(id), &job)?;
        entry.stop.store(GO_ON, Ordering::Release);
        entry.sender.send_replace(job.clone());
        inner.queue.push_back(id.to_owned());
        self.shared.wake.notify_all();
        Ok(job)
    }

    /// Asks a job to stop. Where it waits it is cancelled at once; where it runs,
    /// [`Jobs::watch`] tells when it has.
    ///
    /// # Errors
    /// [`EngineError::NotFound`], and the file system's.
    pub fn cancel(&self, id: &str) -> Result<(), EngineError> {
        let mut inner = self.shared.lock();
        let entry = inner.jobs.get(id).ok_or_else(|| self.unknown(&inner, id))?;
        if entry.sender.borrow().state.is_over() {
            return Ok(());
        }
        entry.stop.store(CANCEL, Ordering::Release);
        if inner.running.as_deref() != Some(id) {
            self.shared.end(entry, id, JobState::Cancelled, String::new())?;
            inner.queue.retain(|waiting| waiting != id);
        }
        Ok(())
    }

    /// A job as it is now and as it changes.
    ///
    /// # Errors
    /// [`EngineError::NotFound`].
    pub fn watch(&self, id: &str) -> Result<watch::Receiver<Job>, EngineError> {
        let inner = self.shared.lock();
        let entry = inner.jobs.get(id).ok_or_else(|| self.unknown(&inner, id))?;
        Ok(entry.sender.subscribe())
    }

    /// One job.
    ///
    /// # Errors
    /// [`EngineError::NotFound`].
    pub fn get(&self, id: &str) -> Result<Job, EngineError> {
        Ok(self.watch(id)?.borrow().clone())
    }

    /// All jobs, newest first.
    pub fn list(&self) -> Vec<Job> {
        self.shared.lock().jobs.values().rev().map(|e| e.sender.borrow().clone()).collect()
    }

    /// Stops the running job after its checkpoint, keeps it and the waiting ones
    /// for the next start, and ends the worker. Blocks.
    pub fn shut_down(&self) {
        {
            let mut inner = self.shared.lock();
            inner.closed = true;
            for entry in inner.jobs.values() {
                // A cancellation under way stays one.
                let _ = entry.stop.compare_exchange(GO_ON, SHUT_DOWN, Ordering::AcqRel, Ordering::Acquire);
            }
            self.shared.wake.notify_all();
        }
        let worker = self.worker.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(worker) = worker {
            // A panic of the worker itself was already reported on its own thread.
            let _ = worker.join();
        }
    }

    fn check_room(&self, inner: &Inner) -> Result<(), EngineError> {
        if inner.closed {
            return Err(EngineError::ShuttingDown);
        }
        if inner.queue.len() >= self.capacity {
            return Err(EngineError::QueueFull { limit: self.capacity });
        }
        Ok(())
    }

    /// How many of an owner's jobs have not ended.
    pub fn open_of(&self, owner: &Digest) -> u64 {
        open_of(&self.shared.lock(), owner)
    }

    /// Counted where they are: there is nothing to free when one ends.
    fn check_owner(&self, inner: &Inner, owner: Option<Digest>) -> Result<(), EngineError> {
        let (Some(access), Some(owner)) = (&self.shared.access, owner) else { return Ok(()) };
        access.check_training(&owner, open_of(inner, &owner))
    }

    fn unknown(&self, inner: &Inner, id: &str) -> EngineError {
        EngineError::not_found("job", id, inner.jobs.keys().rev().map(String::as_str))
    }
}

fn open_of(inner: &Inner, owner: &Digest) -> u64 {
    let open = |e: &&Entry| {
        let job = e.sender.borrow();
        job.owner == Some(*owner) && !job.state.has_ended()
    };
    inner.jobs.values().filter(open).count() as u64
}

impl Drop for Jobs {
    fn drop(&mut self) {
        self.shut_down();
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn file(&self, id: &str) -> PathBuf {
        self.folder.join(id).join("job.json")
    }

    /// Writes an end state down and tells the watchers, in this order.
    fn end(&self, entry: &Entry, id: &str, state: JobState, error: String) -> Result<(), EngineError> {
        let mut job = entry.sender.borrow().clone();
        (job.state, job.error, job.ended_unix_s) = (state, error, unix_s());
        let file = self.file(id);
        // The manifest comes last: a crash in between leaves a job without one, which only cannot be told from rot.
        let written = write_json(&file, &job)
            .and_then(|()| cairn_scene::write_manifest(&self.folder.join(id)).map(drop).map_err(EngineError::from));
        entry.sender.send_replace(job);
        written
    }

    fn work(&self, mut work: impl Work) {
        while let Some((id, sender, stop)) = self.next() {
            let job = sender.borrow().clone();
            let path = self.file(&id);
            let owner = self.access.as_deref().zip(job.owner);
            let ahead = Mutex::new(Ahead::of(&job));
            let control = Control { stop: &stop, sender: &sender, path, owner, meter: Meter::new(), ahead };
            let run = || {
                control.charge()?;
                write_json(&control.path, &job)?;
                work.run(&job, &control)
            };
            let outcome = catch_unwind(AssertUnwindSafe(run)).unwrap_or_else(|panic| {
                let said = panic.downcast_ref::<String>().map(String::as_str);
                let said = said.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no message");
                Err(EngineError::Internal(format!("the training panicked: {said}")))
            });
            // Also where it failed: whoever brings what fails pays for the time it took.
            if let Err(error) = control.charge() {
                tracing::error!(job = id, %error, "what the job took last is not charged");
            }
            let mut inner = self.lock();
            inner.running = None;
            let Some(entry) = inner.jobs.get(&id) else { continue };
            let (state, error) = match outcome {
                Ok(Outcome::Finished) => (JobState::Done, String::new()),
                // Left as it is on the disk: the next start finds it and goes on.
                Ok(Outcome::Stopped) if stop.load(Ordering::Acquire) == SHUT_DOWN => continue,
                Ok(Outcome::Stopped) if stop.load(Ordering::Acquire) == USED_UP => {
                    (JobState::Failed, control.used_up())
                }
                Ok(Outcome::Stopped) => (JobState::Cancelled, String::new()),
                Err(error) => (JobState::Failed, error.to_string()),
            };
            tracing::info!(job = id, %state, error, "training ended");
            if let Err(error) = self.end(entry, &id, state, error) {
                tracing::error!(job = id, %error, "the job's end could not be written; the next start runs it again");
            }
        }
    }

    /// Waits for a job and marks it running.
    fn next(&self) -> Option<(String, watch::Sender<Job>, Arc<AtomicU8>)> {
        let mut inner = self.lock();
        loop {
            if inner.closed {
                return None;
            }
            if let Some(id) = inner.queue.pop_front() {
                inner.running = Some(id.clone());
                let Some(entry) = inner.jobs.get(&id) else { continue };
                entry.sender.send_modify(|job| job.state = JobState::Running);
                let taken = (id, entry.sender.clone(), entry.stop.clone());
                return Some(taken);
            }
            inner = self.wake.wait(inner).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

#[cfg(test)]
#[path = "jobs_tests.rs"]
mod tests;
