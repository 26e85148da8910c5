//! Stepping a stage to its end: checkpoints, progress, and stopping when that is asked for.

use std::path::Path;
use std::time::{Duration, Instant};

use cairn_durable::{read_limited, write_atomic};

use crate::error::EngineError;
use crate::train::job::Progress;
use crate::train::jobs::Control;
use crate::train::stages::Stage;

/// Largest checkpoint that is read, bytes.
pub(crate) const MAX_CHECKPOINT_BYTES: u64 = 64 << 30;
/// Progress goes out at most this often.
const PROGRESS_EVERY: Duration = Duration::from_millis(100);

/// A run of a stage.
pub(crate) struct Run {
    /// The stage's name, in progress.
    pub(crate) name: &'static str,
    /// The name under which its seconds are counted.
    pub(crate) counted: &'static str,
    /// When it began: before its trainer was made.
    pub(crate) since: Instant,
    /// Time between checkpoints.
    pub(crate) checkpoint_every: Duration,
}

/// Steps a stage to its end; false when it was asked to stop. Either way its state is on the disk on return, and so it
/// is after a step that was refused.
///
/// # Errors
/// The stage's, and the file system's.
pub(crate) fn drive(
    run: &Run,
    stage: &mut impl Stage,
    file: &Path,
    control: &Control<'_>,
) -> Result<bool, EngineError> {
    let (begun, first) = (Instant::now(), stage.steps().0);
    let (mut saved, mut told): (Instant, Option<Instant>) = (run.since, None);
    loop {
        let (step, total) = stage.steps();
        let finished = step >= total;
        stage.notes().into_iter().for_each(|note| control.note(note));
        let stop = control.stop_requested();
        // At the end too: the stage's result comes next, and may fail to be written.
        if finished || stop || saved.elapsed() >= run.checkpoint_every {
            write_atomic(file, &stage.checkpoint()?)?;
            control.spent(run.counted, saved.elapsed().as_secs_f64())?;
            saved = Instant::now();
        }
        if finished || stop {
            return Ok(finished);
        }
        let stats = match stage.step() {
            Ok(stats) => stats,
            Err(error) => {
                keep_last_good(stage, step, file, run.counted, saved, control);
                return Err(error);
            }
        };
        let step = step + 1;
        if step == total || told.is_none_or(|t| t.elapsed() >= PROGRESS_EVERY) {
            told = Some(Instant::now());
            let a_step = begun.elapsed().as_secs_f64() / (step - first).max(1) as f64;
            control.progress(Progress {
                stage: run.name.to_owned(),
                step,
                total,
                // Perfect agreement is infinite, which JSON cannot say.
                loss: if stats.loss.is_finite() { stats.loss } else { 0.0 },
                psnr_db: if stats.psnr_db.is_finite() { stats.psnr_db } else { 0.0 },
                seconds_left: a_step * total.saturating_sub(step) as f64,
            });
        }
    }
}

/// Writes down what a failed step has left of `stage`, which had done `step` steps: trainers refuse a step before anything
/// moves. What goes wrong here is only logged: the step's own error is the one to tell.
fn keep_last_good(stage: &impl Stage, step: u64, file: &Path, counted: &str, saved: Instant, control: &Control<'_>) {
    // It was taken, and what follows it failed: whoever resumes has to come to that again.
    if stage.steps().0 != step {
        return;
    }
    let write = || {
        write_atomic(file, &stage.checkpoint()?)?;
        control.spent(counted, saved.elapsed().as_secs_f64())
    };
    if let Err(error) = write() {
        tracing::error!(step, %error, "the state before a failed step could not be kept; what was saved last is");
    }
}

/// Tells the job's watchers of a preparation, and that it has to stop.
pub(crate) fn preparing(control: &Control<'_>) -> impl FnMut(&'static str, usize, usize) -> bool {
    let (mut begun, mut told): (Instant, Option<Instant>) = (Instant::now(), None);
    move |stage, done, total| {
        if done == 0 {
            (begun, told) = (Instant::now(), None);
        }
        if told.is_none_or(|t| t.elapsed() >= PROGRESS_EVERY) {
            told = Some(Instant::now());
            let seconds_left = match done {
                0 => Progress::default().seconds_left,
                done => begun.elapsed().as_secs_f64() / done as f64 * (total - done) as f64,
            };
            let (step, total) = (done as u64, total as u64);
            control.progress(Progress { stage: stage.to_owned(), step, total, seconds_left, ..Progress::default() });
        }
        !control.stop_requested()
    }
}

/// The end of a stage that was stopped before its trainer was made: there is nothing
/// to keep but the time it took.
pub(crate) fn stopped<T>(name: &str, clock: Instant, control: &Control<'_>) -> Result<Option<T>, EngineError> {
    control.spent(name, clock.elapsed().as_secs_f64())?;
    Ok(None)
}

pub(crate) fn read_checkpoint(path: &Path) -> Result<Option<Vec<u8>>, EngineError> {
    if !path.exists() {
        return Ok(None);
    }
    Ok(Some(read_limited(path, MAX_CHECKPOINT_BYTES)?))
}
