//! One training job from its photographs to its published models (most often one): the caller that
//! the trainers are promised, which owns the clock, the files and the progress.
//!
//! What is done is on the disk, so that a job can be taken up anywhere: the last
//! checkpoint within a stage, the base field between the stages. The same job
//! ends in the same bytes however often it was cut off.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use cairn_log::Digest;
use cairn_scene::SceneFolder;
use cairn_scene::cluster::{ClusterConfig, ClusterError, Clusters, Grouping};

use crate::error::EngineError;
use crate::store::hidden;
use crate::store::model::{IdentityInfo, MarkFiles, ModelInfo};
use crate::store::quarantine::Quarantine;
use crate::train::job::{Job, Progress};
use crate::train::jobs::{Control, Outcome, Work};
use crate::train::joint::{Part, shares, signals};
use crate::train::marks::{Marked, Marking, ToMark};
use crate::train::stages::{self, Field, Stage};
use cairn_durable::{read_limited, remove, write_atomic};

/// Largest checkpoint that is read, bytes.
const MAX_CHECKPOINT_BYTES: u64 = 64 << 30;
/// Progress goes out at most this often.
const PROGRESS_EVERY: Duration = Duration::from_millis(100);

/// Runs training jobs.
pub struct Training {
    /// Where captures lie.
    pub scenes: PathBuf,
    /// Where models go.
    pub models: PathBuf,
    /// Where jobs keep their checkpoints.
    pub jobs: PathBuf,
    /// Which views are left out.
    pub quarantine: Arc<Quarantine>,
    /// Time between checkpoints.
    pub checkpoint_every: Duration,
}

impl Work for Training {
    fn run(&mut self, job: &Job, control: &Control<'_>) -> Result<Outcome, EngineError> {
        let folder = self.jobs.join(&job.id);
        let Some(parts) = self.parts(job, &folder, control)? else { return Ok(Outcome::Stopped) };
        // Cut off between publishing and its end: the models are there, whole.
        if self.are_published(&parts)? {
            return finished(&parts, control);
        }
        let mut bases = Vec::with_capacity(parts.len());
        for part in &parts {
            let base = match &part.earlier {
                Some(info) => Some(info.base_field_bytes(&self.models)?),
                None => self.base_field(&part.job, &part.scene, &part.folder, control)?,
            };
            let Some(base) = base else { return Ok(Outcome::Stopped) };
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
            self.publish(part, base, marks.as_ref().map(|files| &files[at]), &shares(&parts))?;
        }
        finished(&parts, control)
    }
}

/// Removes what is of no more use once the models are published, and says so.
fn finished(parts: &[Part], control: &Control<'_>) -> Result<Outcome, EngineError> {
    for part in parts {
        for left in ["base.checkpoint", "base.field", "mark.checkpoint"] {
            remove(&part.folder.join(left))?;
        }
    }
    control.progress(Progress { stage: "finished".into(), seconds_left: 0.0, ..Progress::default() });
    Ok(Outcome::Finished)
}

impl Training {
    /// Stage 1: the base field's bytes, or `None` when it was asked to stop.
    fn base_field(
        &self,
        job: &Job,
        scene: &SceneFolder,
        folder: &Path,
        control: &Control<'_>,
    ) -> Result<Option<Vec<u8>>, EngineError> {
        let done = folder.join("base.field");
        if done.exists() {
            return Ok(Some(read_limited(&done, MAX_CHECKPOINT_BYTES)?));
        }
        let clock = Instant::now();
        let file = folder.join("base.checkpoint");
        let checkpoint = read_checkpoint(&file)?;
        let (settings, seed) = (&job.spec.settings, job.spec.seed);
        let made = stages::base_trainer(scene, settings, seed, checkpoint.as_deref(), &mut preparing(control))?;
        drop(checkpoint);
        let Some(mut trainer) = made else { return stopped(stages::BASE, clock, control) };
        if !self.drive((stages::BASE, stages::BASE, clock), &mut trainer, &file, control)? {
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
        bases: &[Vec<u8>],
        control: &Control<'_>,
    ) -> Result<Option<Vec<MarkFiles>>, EngineError> {
        let clock = Instant::now();
        let folder = self.jobs.join(&job.id);
        let grown = self.grown(parts)?;
        let signals = signals(job, &folder, parts, grown.as_ref())?;
        let file = folder.join("mark.checkpoint");
        let checkpoint = read_checkpoint(&file)?;
        let mut scenes = Vec::with_capacity(parts.len());
        for ((part, base), signals) in parts.iter().zip(bases).zip(&signals) {
            let (base, signals) = (Field::from_bytes(base)?, signals.clone());
            scenes.push(ToMark {
                name: &part.job.spec.scene,
                scene: &part.scene,
                base,
                clusters: &part.clusters,
                signals,
                settings: &part.job.spec.settings.mark,
            });
        }
        let how = (&job.spec.settings.mark, job.spec.seed);
        let made = Marking::start(scenes, grown.as_ref(), how, checkpoint.as_deref(), &mut preparing(control))?;
        drop((checkpoint, grown));
        let Some(mut trainer) = made else { return stopped(stages::MARK, clock, control) };
        if !self.drive((stages::MARK, stages::MARK, clock), &mut trainer, &file, control)? {
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

    /// Steps a stage (its name, and that under which its seconds are counted), whose `clock` runs since before its
    /// trainer was made, to its end; false when it was asked to stop. Either way its state is on the disk on return, and
    /// so it is after a step that was refused.
    pub(crate) fn drive(
        &self,
        (name, counted, clock): (&str, &str, Instant),
        stage: &mut impl Stage,
        file: &Path,
        control: &Control<'_>,
    ) -> Result<bool, EngineError> {
        let (begun, first) = (Instant::now(), stage.steps().0);
        let (mut saved, mut told): (Instant, Option<Instant>) = (clock, None);
        loop {
            let (step, total) = stage.steps();
            let finished = step >= total;
            stage.notes().into_iter().for_each(|note| control.note(note));
            let stop = control.stop_requested();
            // At the end too: the stage's result comes next, and may fail to be written.
            if finished || stop || saved.elapsed() >= self.checkpoint_every {
                write_atomic(file, &stage.checkpoint()?)?;
                control.spent(counted, saved.elapsed().as_secs_f64())?;
                saved = Instant::now();
            }
            if finished || stop {
                return Ok(finished);
            }
            let stats = match stage.step() {
                Ok(stats) => stats,
                Err(error) => {
                    keep_last_good(stage, step, file, (counted, saved), control);
                    return Err(error);
                }
            };
            let step = step + 1;
            if step == total || told.is_none_or(|t| t.elapsed() >= PROGRESS_EVERY) {
                told = Some(Instant::now());
                let a_step = begun.elapsed().as_secs_f64() / (step - first).max(1) as f64;
                control.progress(Progress {
                    stage: name.to_owned(),
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
}

/// Writes down what a failed step has left of `stage`, which had done `step` steps: trainers refuse a step before anything
/// moves. What goes wrong here is only logged: the step's own error is the one to tell.
fn keep_last_good(
    stage: &impl Stage,
    step: u64,
    file: &Path,
    (counted, saved): (&str, Instant),
    control: &Control<'_>,
) {
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

/// Clusters over the scene's training views, in their order. Around anchors with a K of 0: of as many
/// views as there are for each ([`cairn_scene::cluster::ClusterConfig::within`]).
pub fn clusters(scene: &SceneFolder, grouping: &Grouping, seed: u64) -> Result<Clusters, EngineError> {
    let capture = scene.capture();
    let (mut poses, mut contributors) = (Vec::new(), Vec::new());
    for index in scene.training() {
        poses.push(capture.views[index].camera.pose);
        contributors.push(capture.views[index].contributor.clone());
    }
    let grouping = match *grouping {
        Grouping::Anchors(config) if config.neighbours == 0 => Grouping::Anchors(config.within(poses.len())),
        given => given,
    };
    Ok(Clusters::build(&poses, &grouping, &contributors, seed)?)
}

/// As [`clusters`], for a training that may mark nothing. That needs no clusters: where the scene has not the views for those
/// asked for, all views are one, and what to say of it comes with them. A later training with marks makes its own.
pub fn clusters_if_any(
    scene: &SceneFolder,
    grouping: &Grouping,
    (seed, base_only): (u64, bool),
) -> Result<(Clusters, Option<String>), EngineError> {
    let why = match clusters(scene, grouping, seed) {
        Err(EngineError::Cluster(
            why @ (ClusterError::TooFewViews { .. }
            | ClusterError::TooFewPoses { .. }
            | ClusterError::NoContributor { .. }),
        )) if base_only => why,
        made => return made.map(|clusters| (clusters, None)),
    };
    let views = scene.training().count();
    let all = ClusterConfig { anchors: 1, neighbours: views.max(1), ..ClusterConfig::default() };
    let note = format!("all {views} training views are one cluster, which a base field needs no more of ({why})");
    Ok((clusters(scene, &Grouping::Anchors(all), seed)?, Some(note)))
}

/// What the clusters' identities are called, and whose photographs they are.
pub fn identities(scene: &SceneFolder, clusters: &Clusters) -> Vec<IdentityInfo> {
    let capture = scene.capture();
    let training: Vec<usize> = scene.training().collect();
    let describe = |cluster: &cairn_scene::cluster::Cluster| {
        let anchor = &capture.views[training[cluster.anchor]];
        let members: Vec<usize> = cluster.members.iter().map(|m| training[*m]).collect();
        IdentityInfo {
            number: cluster.identity,
            label: match clusters.grouping() {
                Grouping::Anchors(_) => format!("anchor-{}", anchor.name),
                Grouping::ByContributor { .. } => anchor.contributor.clone(),
            },
            views: members.iter().map(|m| capture.views[*m].name.clone()).collect(),
            photographs: members.iter().map(|m| Digest::from_bytes(scene.photograph_digest(*m))).collect(),
            contributors: contributors(members.iter().map(|m| capture.views[*m].contributor.as_str())),
        }
    };
    clusters.clusters.iter().map(describe).collect()
}

/// Refuses to go on from `earlier` where one of its identities is not among `now`: nothing would read its mark any more.
///
/// # Errors
/// [`EngineError::Invalid`] naming those that are missing.
pub fn all_are_kept(earlier: &ModelInfo, now: &[IdentityInfo]) -> Result<(), EngineError> {
    let is_kept = |label: &str| now.iter().any(|identity| identity.label == label);
    let lost = earlier.identities.iter().map(|i| i.label.as_str()).filter(|label| !is_kept(label));
    let lost: Vec<&str> = lost.collect();
    if lost.is_empty() {
        return Ok(());
    }
    let got = format!("without {}, marked by {}, whose marks nobody would read any more", lost.join(", "), earlier.job);
    let (scene, seed) = (&earlier.scene, &earlier.seed);
    let grouping = match earlier.clusters.grouping() {
        Grouping::Anchors(c) => format!("{} anchors or more of {} views, seed {seed}", c.anchors, c.neighbours),
        Grouping::ByContributor { .. } => "clusters by contributor, as small as then or smaller".to_owned(),
    };
    let expected = format!(
        "all {} identities that {scene:?} has, and more: {grouping}, over the views of then (`cairn quarantine list {scene}` shows \
         which went or came back since); or train it anew, without growing",
        earlier.identities.len()
    );
    Err(EngineError::invalid(format!("the clusters of {scene:?}"), got, expected))
}

/// Contributors of the photographs with how many each took, most first, then by name.
fn contributors<'a>(of_photographs: impl Iterator<Item = &'a str>) -> Vec<(String, usize)> {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for name in of_photographs {
        *counts.entry(name).or_default() += 1;
    }
    let mut counted: Vec<(String, usize)> = counts.into_iter().map(|(name, count)| (name.to_owned(), count)).collect();
    // The sort is stable: equal counts stay in the order of names.
    counted.sort_by_key(|(_, count)| Reverse(*count));
    counted
}

#[cfg(test)]
#[path = "training_tests.rs"]
mod tests;
