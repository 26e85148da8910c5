//! Which views a training trains on: those that are not excluded when it begins, less those that its screening then
//! excludes. Written down in the job's folder (`views.json`), so that a job that was cut off goes on with the same
//! views whatever was decided about them meanwhile.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::{Duration, Instant};

use cairn_durable::remove;
use cairn_field::screening::MIN_VIEWS;
use cairn_field::{Doubt, Screened, Screening, ViewScore};
use cairn_scene::SceneFolder;
use serde::{Deserialize, Serialize};

use crate::config::TrainingSettings;
use crate::error::EngineError;
use crate::store::exclusions::{Against, Exclusions, Measured, Score, leaving_out};
use crate::store::folder::{read_json, write_json};
use crate::store::support::against;
use crate::train::drive::{Run, drive, preparing, read_checkpoint, stopped};
use crate::train::job::Job;
use crate::train::jobs::Control;
use crate::train::stages::{self, Photographs};

/// Format version of `views.json`.
const VIEWS_VERSION: u32 = 1;

/// Views named in a note.
const NAMED: usize = 12;

/// `views.json` of a job.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Views {
    format_version: u32,
    /// Names of views that the training leaves out.
    left_out: BTreeSet<String>,
    /// Names of views that a person included: screening does not judge them.
    trusted: BTreeSet<String>,
    /// Whether screening is over, or was not to be.
    screened: bool,
}

/// What screening needs beside the scene.
pub(crate) struct Screen<'a> {
    /// Which views are excluded.
    pub(crate) exclusions: &'a Exclusions,
    /// Time between checkpoints.
    pub(crate) checkpoint_every: Duration,
}

impl Screen<'_> {
    /// The scene with the views that the job trains on, screened; `None` when it was asked to stop.
    pub(crate) fn screened(
        &self,
        job: &Job,
        scene: SceneFolder,
        photographs: &Photographs,
        folder: &Path,
        control: &Control<'_>,
    ) -> Result<Option<SceneFolder>, EngineError> {
        let file = folder.join("views.json");
        let mut views: Views = if file.exists() {
            read_json(&file, VIEWS_VERSION)?
        } else {
            let entries = self.exclusions.of(&job.spec.scene)?;
            let screened = !job.spec.settings.screened;
            let views = Views {
                format_version: VIEWS_VERSION,
                left_out: entries.excluded(),
                trusted: entries.included(),
                screened,
            };
            write_json(&file, &views)?;
            views
        };
        if !views.left_out.is_empty() && !views.screened {
            let (count, name) = (views.left_out.len(), &job.spec.scene);
            let views = if count == 1 { "view" } else { "views" };
            control.note(format!("left out: {count} excluded {views} (cairn scene check {name})"));
        }
        let scene = leaving_out(scene, &views.left_out);
        let checkpoint = folder.join("screening.checkpoint");
        if views.screened || scene.training().count() < MIN_VIEWS {
            remove(&checkpoint)?;
            return Ok(Some(scene));
        }
        let clock = Instant::now();
        let saved = read_checkpoint(&checkpoint)?;
        let (settings, seed) = (&job.spec.settings, job.spec.seed);
        let made = stages::screening(
            &scene,
            photographs,
            settings,
            seed,
            &views.trusted,
            saved.as_deref(),
            &mut preparing(control),
        )?;
        drop(saved);
        // Charged to stage 1, which it prepares.
        let Some(mut screening) = made else { return stopped(stages::BASE, clock, control) };
        let run = Run {
            name: stages::SCREENING,
            counted: stages::BASE,
            since: clock,
            checkpoint_every: self.checkpoint_every,
        };
        if !drive(&run, &mut screening, &checkpoint, control)? {
            return Ok(None);
        }
        let found = Screening::finish(&screening);
        let found = found.ok_or_else(|| EngineError::Internal("screening ended without a verdict".into()))?;
        views.left_out.extend(self.verdict(job, &scene, &found, control)?);
        views.screened = true;
        // Before the views are settled: were it cut off in between, the same is found and said again.
        control.spent(stages::BASE, 0.0)?;
        write_json(&file, &views)?;
        remove(&checkpoint)?;
        Ok(Some(leaving_out(scene, &views.left_out)))
    }

    /// Keeps what was measured, excludes the views that it is reason enough against, and says so, in the log and in
    /// the job's notes; the names of those views.
    fn verdict(
        &self,
        job: &Job,
        scene: &SceneFolder,
        found: &Screened,
        control: &Control<'_>,
    ) -> Result<Vec<String>, EngineError> {
        let name = &job.spec.scene;
        let measured = measured(found, &job.id);
        if !measured.doubt.is_empty() {
            tracing::warn!(job = job.id, scene = name, note = measured.doubt, "views not judged");
            control.note(measured.doubt.clone());
        }
        let against = against(scene.capture(), &measured);
        let capture = scene.capture();
        for Against { view, why } in &against {
            let view = &capture.views[*view];
            let (view, contributor) = (&view.name, &view.contributor);
            tracing::warn!(job = job.id, scene = name, view, contributor, why, "view excluded");
            control
                .note(format!("excluded: {view} by {contributor}: {why} (cairn scene include {name} brings it back)"));
        }
        let excluded = |name: &str| against.iter().any(|a| capture.views[a.view].name == name);
        let doubted: Vec<&Score> = measured.scores.iter().filter(|s| s.is_outlier && !excluded(&s.view)).collect();
        if !doubted.is_empty() {
            control.note(doubted_note(name, &doubted));
        }
        self.exclusions.screened(name, scene, measured, &against)
    }
}

/// What a screening measured, as it is kept; `job` is empty where no training screened.
pub(crate) fn measured(found: &Screened, job: &str) -> Measured {
    let doubt = match found.doubt {
        None => String::new(),
        Some(Doubt::TooMany(many)) => format!(
            "{many} of {} views are explained by the others from their own poses no better than from any: the poses or \
             photographs of the whole capture may be wrong; no view was judged",
            found.scores.len()
        ),
        Some(Doubt::Untold) => format!(
            "learnt coarsely, the others explain the median view only {:.2} dB better from its own pose than from \
             others, too little to tell; no view was judged",
            found.median_db
        ),
    };
    let score =
        |s: &ViewScore| Score { view: s.view.clone(), score: s.score, fit_db: s.fit_db, is_outlier: s.is_outlier };
    let scores = found.scores.iter().map(score).collect();
    Measured { job: job.to_owned(), median_db: found.median_db, limit_db: found.limit_db, doubt, scores }
}

/// Screens a scene's views on demand, those aside that are excluded; `None` when it is no longer `wanted`, or the scene
/// has too few views.
pub(crate) fn measure(
    scene: &SceneFolder,
    settings: &TrainingSettings,
    trusted: &BTreeSet<String>,
    wanted: &dyn Fn() -> bool,
) -> Result<Option<Measured>, EngineError> {
    if scene.training().count() < MIN_VIEWS {
        return Ok(None);
    }
    let made =
        stages::screening(scene, &Photographs::default(), settings, CHECK_SEED, trusted, None, &mut |_, _, _| {
            wanted()
        })?;
    let Some(mut screening) = made else { return Ok(None) };
    while Screening::finish(&screening).is_none() {
        if !wanted() {
            return Ok(None);
        }
        screening.step()?;
    }
    Ok(Screening::finish(&screening).map(|found| measured(&found, "")))
}

/// The seed of checks on demand.
const CHECK_SEED: u64 = 1;

fn doubted_note(scene: &str, doubted: &[&Score]) -> String {
    let figure = |s: &&Score| format!("{} ({:.2} dB)", s.view, s.fit_db);
    let mut names: Vec<String> = doubted.iter().take(NAMED).map(figure).collect();
    if doubted.len() > NAMED {
        names.push(format!("{} more", doubted.len() - NAMED));
    }
    format!(
        "the other views do not explain {}: look at them (cairn scene check {scene} --picture), and exclude what is wrong \
         (cairn scene exclude)",
        names.join(", ")
    )
}
