//! One training job from its photographs to its published models (most often one): the caller that
//! the trainers are promised, which owns the clock, the files and the progress.
//!
//! What is done is on the disk, so that a job can be taken up anywhere: the last
//! checkpoint within a stage, the base field between the stages. The same job
//! ends in the same bytes however often it was cut off.

use std::io::Cursor;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use cairn_durable::{read_limited, remove, write_atomic};
use cairn_field::Field;
use cairn_scene::{UnusedPhotographs, no_share};
use cairn_share::ShareTable;

use crate::error::EngineError;
use crate::store::exclusions::Exclusions;
use crate::store::hidden;
use crate::store::model::{BaseFiles, MarkFiles};
use crate::train::drive::{MAX_CHECKPOINT_BYTES, Run, drive, preparing, read_checkpoint, stopped};
use crate::train::job::{Job, Progress};
use crate::train::jobs::{Control, Outcome, Work};
use crate::train::joint::{self, Part, shares, signals};
use crate::train::marks::{Marked, Marking, ToMark};
use crate::train::screen::Screen;
use crate::train::stages::{self, Preparing};
use crate::train::{coverage, places};

/// Runs training jobs.
pub struct Training {
    /// Where captures lie.
    pub scenes: PathBuf,
    /// Where models go.
    pub models: PathBuf,
    /// Where jobs keep their checkpoints.
    pub jobs: PathBuf,
    /// Which views are excluded.
    pub exclusions: Arc<Exclusions>,
    /// Time between checkpoints.
    pub checkpoint_every: Duration,
}

impl Work for Training {
    fn run(&mut self, job: &Job, control: &Control<'_>) -> Result<Outcome, EngineError> {
        let folder = self.jobs.join(&job.id);
        let screen = Screen { exclusions: &self.exclusions, checkpoint_every: self.checkpoint_every };
        let Some(parts) = joint::parts(&self.scenes, &self.models, &screen, job, &folder, control)? else {
            return Ok(Outcome::Stopped);
        };
        // Cut off between publishing and its end: the models are there, whole.
        if joint::are_published(&self.models, &parts)? {
            return finished(&parts, control);
        }
        let mut bases = Vec::with_capacity(parts.len());
        for part in &parts {
            let base = match &part.earlier {
                Some(info) => {
                    say_no_share(part, &info.without_share, control);
                    Some(BaseFiles {
                        field: info.base_field_bytes(&self.models)?,
                        share_table: info.share_table_bytes(&self.models)?,
                        without_share: info.without_share.clone(),
                        places: info.places_bytes(&self.models)?,
                    })
                }
                None => self.base(part, control)?,
            };
            let Some(base) = base else { return Ok(Outcome::Stopped) };
            if job.spec.base_only {
                part.photographs.forget();
            }
            bases.push(base);
        }
        let marks = match job.spec.base_only {
            true => None,
            false => match self.mark(job, &parts, &bases, control)? {
                Some(files) => Some(files),
                None => return Ok(Outcome::Stopped),
            },
        };
        for (at, (part, base)) in parts.iter().zip(&bases).enumerate() {
            joint::publish(&self.models, part, base, marks.as_ref().map(|files| &files[at]), &shares(&parts))?;
        }
        finished(&parts, control)
    }
}

/// Removes what is of no more use once the models are published, and says so.
fn finished(parts: &[Part], control: &Control<'_>) -> Result<Outcome, EngineError> {
    for part in parts {
        for left in ["base.checkpoint", "base.field", "base.shares", "base.places", "mark.checkpoint"] {
            remove(&part.folder.join(left))?;
        }
    }
    control.progress(Progress { stage: "finished".into(), seconds_left: 0.0, ..Progress::default() });
    Ok(Outcome::Finished)
}

/// A file's bytes, or `None` when it was asked to stop.
type FileOrStop = Result<Option<Vec<u8>>, EngineError>;

/// A file that is made of a base field, and the stage that makes it.
struct Made {
    file: &'static str,
    stage: &'static str,
}

const SHARES: Made = Made { file: "base.shares", stage: stages::SHARE_TABLE };
const PLACES: Made = Made { file: "base.places", stage: stages::PLACES };

/// A file of the part's folder: as it is there, else as it is made; `None` when that was asked to stop.
fn kept(
    part: &Part,
    made: &Made,
    control: &Control<'_>,
    make: &mut dyn FnMut(Preparing<'_>) -> FileOrStop,
) -> FileOrStop {
    let done = part.folder.join(made.file);
    if done.exists() {
        return Ok(Some(read_limited(&done, MAX_CHECKPOINT_BYTES)?));
    }
    let clock = Instant::now();
    let Some(bytes) = make(&mut preparing(control))? else { return stopped(made.stage, clock, control) };
    write_atomic(&done, &bytes)?;
    control.spent(made.stage, clock.elapsed().as_secs_f64())?;
    Ok(Some(bytes))
}

/// Names the contributors of a scene who get no share, with the reason, in the log and in the job's notes.
fn say_no_share(part: &Part, without_share: &[UnusedPhotographs], control: &Control<'_>) {
    let (job, scene) = (&part.job.id, &part.job.spec.scene);
    if let Some(sentence) = no_share(without_share) {
        tracing::warn!(job, scene, note = sentence, "contributors without a share");
        control.note(format!("{scene}: {sentence}"));
    }
}

impl Training {
    fn stage(&self, name: &'static str, since: Instant) -> Run {
        Run { name, counted: name, since, checkpoint_every: self.checkpoint_every }
    }

    /// Stage 1's files, or `None` when it was asked to stop.
    fn base(&self, part: &Part, control: &Control<'_>) -> Result<Option<BaseFiles>, EngineError> {
        let Some(bytes) = self.base_field(part, control)? else { return Ok(None) };
        let field = Field::from_bytes(&bytes)?;
        let shares = kept(part, &SHARES, control, &mut |preparing| {
            let Some(table) = coverage::share_table(part, &field, preparing)? else { return Ok(None) };
            Ok(Some(table.to_bytes()?))
        })?;
        let Some(share_table) = shares else { return Ok(None) };
        let table = ShareTable::read_from(&mut Cursor::new(&share_table))?;
        let without_share = coverage::without_share(part.scene.capture(), &table);
        // Written down with what comes next, and said again where it does not come.
        say_no_share(part, &without_share, control);
        let places = kept(part, &PLACES, control, &mut |preparing| {
            let Some(index) = places::index(part, &field, preparing)? else { return Ok(None) };
            Ok(Some(index.to_bytes()?))
        })?;
        Ok(places.map(|places| BaseFiles { field: bytes, share_table, without_share, places }))
    }

    /// The base field's bytes, or `None` when it was asked to stop.
    fn base_field(&self, part: &Part, control: &Control<'_>) -> Result<Option<Vec<u8>>, EngineError> {
        let Part { job, folder, scene, photographs, .. } = part;
        let done = folder.join("base.field");
        if done.exists() {
            return Ok(Some(read_limited(&done, MAX_CHECKPOINT_BYTES)?));
        }
        let clock = Instant::now();
        let file = folder.join("base.checkpoint");
        let checkpoint = read_checkpoint(&file)?;
        let (settings, seed) = (&job.spec.settings, job.spec.seed);
        let saved = checkpoint.as_deref();
        let made = stages::base_trainer(scene, photographs, settings, seed, saved, &mut preparing(control))?;
        drop(checkpoint);
        let Some(mut trainer) = made else { return stopped(stages::BASE, clock, control) };
        if !drive(&self.stage(stages::BASE, clock), &mut trainer, &file, control)? {
            return Ok(None);
        }
        let finishing = Instant::now();
        let bytes = Field::to_bytes(&trainer.finish())?;
        write_atomic(&done, &bytes)?;
        control.spent(stages::BASE, finishing.elapsed().as_secs_f64())?;
        remove(&file)?;
        Ok(Some(bytes))
    }

    /// Stage 2's files of each part, or `None` when it was asked to stop.
    fn mark(
        &self,
        job: &Job,
        parts: &[Part],
        bases: &[BaseFiles],
        control: &Control<'_>,
    ) -> Result<Option<Vec<MarkFiles>>, EngineError> {
        let clock = Instant::now();
        let folder = self.jobs.join(&job.id);
        let grown = joint::grown(&self.models, parts)?;
        let signals = signals(job, &folder, parts, grown.as_ref())?;
        let file = folder.join("mark.checkpoint");
        let checkpoint = read_checkpoint(&file)?;
        let mut scenes = Vec::with_capacity(parts.len());
        for ((part, base), signals) in parts.iter().zip(bases).zip(&signals) {
            let (base, signals) = (Field::from_bytes(&base.field)?, signals.clone());
            scenes.push(ToMark {
                name: &part.job.spec.scene,
                scene: &part.scene,
                photographs: &part.photographs,
                base,
                clusters: &part.clusters,
                signals,
                settings: &part.job.spec.settings.mark,
            });
        }
        let made = Marking::start(
            scenes,
            grown.as_ref(),
            &job.spec.settings.mark,
            job.spec.seed,
            checkpoint.as_deref(),
            &mut preparing(control),
        )?;
        drop((checkpoint, grown));
        let Some(mut trainer) = made else { return stopped(stages::MARK, clock, control) };
        if !drive(&self.stage(stages::MARK, clock), &mut trainer, &file, control)? {
            return Ok(None);
        }
        let finishing = Instant::now();
        let finished = trainer.finish(&mut preparing(control))?;
        control.spent(stages::MARK, finishing.elapsed().as_secs_f64())?;
        // The checkpoint of the last step is there, and finishes another time.
        let Some(Marked { fields, detector }) = finished else { return Ok(None) };
        let files = fields.into_iter().zip(&signals).map(|(field, signals)| {
            let signals = signals.iter().map(hidden::encoded).collect();
            MarkFiles { field, detector: detector.clone(), signals }
        });
        Ok(Some(files.collect()))
    }
}

#[cfg(test)]
#[path = "training_tests.rs"]
mod tests;
