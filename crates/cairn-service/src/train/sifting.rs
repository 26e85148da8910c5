//! Which views a training trains on: those that are not in quarantine when it begins, less those
//! that its screening then finds. Written down in the job's folder (`views.json`), so that a job that
//! was cut off goes on with the same views whatever was decided about them meanwhile.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::{Duration, Instant};

use cairn_durable::remove;
use cairn_field::screening::MIN_VIEWS;
use cairn_field::{Doubt, Screened, Screening, ViewScore};
use cairn_log::Digest;
use cairn_scene::SceneFolder;
use serde::{Deserialize, Serialize};

use crate::error::EngineError;
use crate::store::access::unix_s;
use crate::store::folder::{read_json, write_json};
use crate::store::quarantine::{Entry, Found, Quarantine, Standing, leaving_out};
use crate::train::drive::{Run, drive, preparing, read_checkpoint, stopped};
use crate::train::job::Job;
use crate::train::jobs::Control;
use crate::train::stages::{self, Photographs};

/// Views named in a note.
const NAMED: usize = 12;

/// `views.json` of a job.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Views {
    format_version: u32,
    /// Names of views that the training leaves out.
    left_out: BTreeSet<String>,
    /// Names of views that a person called good: screening does not judge them.
    trusted: BTreeSet<String>,
    /// Whether screening is over, or was not to be.
    screened: bool,
}

/// What screening needs beside the scene.
pub(crate) struct Sift<'a> {
    /// Which views are left out.
    pub(crate) quarantine: &'a Quarantine,
    /// Time between checkpoints.
    pub(crate) checkpoint_every: Duration,
}

impl Sift<'_> {
    /// The scene with the views that the job trains on, screened; `None` when it was asked to stop.
    pub(crate) fn sifted(
        &self,
        job: &Job,
        scene: SceneFolder,
        photographs: &Photographs,
        folder: &Path,
        control: &Control<'_>,
    ) -> Result<Option<SceneFolder>, EngineError> {
        let file = folder.join("views.json");
        let mut views: Views = if file.exists() {
            read_json(&file)?
        } else {
            let (left_out, trusted) = self.quarantine.of(&job.spec.scene)?.names(&scene);
            // A job from before views were screened goes on as it began.
            let begun = ["base.checkpoint", "base.field"].iter().any(|name| folder.join(name).exists());
            let screened = begun || !job.spec.settings.screened;
            let views = Views { format_version: 1, left_out, trusted, screened };
            write_json(&file, &views)?;
            views
        };
        if !views.left_out.is_empty() && !views.screened {
            let (count, name) = (views.left_out.len(), &job.spec.scene);
            let views = if count == 1 { "view" } else { "views" };
            control.note(format!(
                "left out: {count} {views} that were in quarantine before (cairn quarantine list {name})"
            ));
        }
        let scene = leaving_out(scene, &views.left_out);
        let checkpoint = folder.join("screening.checkpoint");
        if views.screened || scene.training().count() < MIN_VIEWS {
            remove(&checkpoint)?;
            return Ok(Some(scene));
        }
        let clock = Instant::now();
        let saved = read_checkpoint(&checkpoint)?;
        let made =
            stages::screening(&scene, photographs, job, &views.trusted, saved.as_deref(), &mut preparing(control))?;
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
        let outliers = self.verdict(job, &scene, &found, control)?;
        views.left_out.extend(outliers);
        views.screened = true;
        // Before the views are settled: were it cut off in between, the same is found and said again.
        control.spent(stages::BASE, 0.0)?;
        write_json(&file, &views)?;
        remove(&checkpoint)?;
        Ok(Some(leaving_out(scene, &views.left_out)))
    }

    /// Quarantines the outliers and says so, in the log and in the job's notes; their names.
    fn verdict(
        &self,
        job: &Job,
        scene: &SceneFolder,
        found: &Screened,
        control: &Control<'_>,
    ) -> Result<Vec<String>, EngineError> {
        let name = &job.spec.scene;
        if let Some(doubt) = found.doubt {
            let note = unjudged(doubt, found);
            tracing::warn!(job = job.id, scene = name, note, "views not judged");
            control.note(note);
            return Ok(Vec::new());
        }
        let entries = entries(job, scene, found);
        for entry in &entries {
            let (view, contributor) = (&entry.view, &entry.contributor);
            let fit_db = entry.found.as_ref().map(|f| f.fit_db);
            let (median_db, limit_db) = (found.median_db, found.limit_db);
            tracing::warn!(
                job = job.id,
                scene = name,
                view,
                contributor,
                fit_db,
                median_db,
                limit_db,
                "view quarantined"
            );
        }
        by_contributor(&entries).into_iter().for_each(|(who, of)| control.note(quarantined(name, who, &of, found)));
        let names = entries.iter().map(|e| e.view.clone()).collect();
        if !entries.is_empty() {
            self.quarantine.put(name, entries)?;
        }
        Ok(names)
    }
}

fn entries(job: &Job, scene: &SceneFolder, found: &Screened) -> Vec<Entry> {
    // Scores count the views that were trained on.
    let training: Vec<usize> = scene.training().collect();
    let entry = |(score, index): (&ViewScore, &usize)| Entry {
        view: score.view.clone(),
        contributor: scene.capture().views[*index].contributor.clone(),
        photograph: Digest::from_bytes(scene.photograph_digest(*index)),
        standing: Standing::Quarantined,
        found: Some(Found {
            job: job.id.clone(),
            fit_db: score.fit_db,
            deviations: -score.score,
            median_db: found.median_db,
            limit_db: found.limit_db,
            unix_s: unix_s(),
        }),
        decided: None,
    };
    found.scores.iter().zip(&training).filter(|(score, _)| score.is_outlier).map(entry).collect()
}

fn by_contributor(entries: &[Entry]) -> BTreeMap<&str, Vec<&Entry>> {
    let mut groups: BTreeMap<&str, Vec<&Entry>> = BTreeMap::new();
    for entry in entries {
        groups.entry(&entry.contributor).or_default().push(entry);
    }
    groups
}

fn quarantined(scene: &str, contributor: &str, entries: &[&Entry], found: &Screened) -> String {
    let figure = |e: &&Entry| format!("{} ({:.2} dB)", e.view, e.found.as_ref().map_or(0.0, |f| f.fit_db));
    let mut names: Vec<String> = entries.iter().take(NAMED).map(figure).collect();
    if entries.len() > NAMED {
        names.push(format!("{} more", entries.len() - NAMED));
    }
    format!(
        "in quarantine, and left out of this training: {} by {contributor}; the others explain the median view {:.2} dB \
         better from its own pose than from others, and these by less than {:.2} dB; look at them (cairn quarantine list \
         {scene}), then release or remove them",
        names.join(", "),
        found.median_db,
        found.limit_db
    )
}

/// What there is to say where no view was judged.
fn unjudged(doubt: Doubt, found: &Screened) -> String {
    match doubt {
        Doubt::TooMany(outliers) => format!(
            "{outliers} of {} views are explained by the others from their own poses no better than from any, more than \
             a fifth: the poses or photographs of the whole capture may be wrong; nobody was quarantined",
            found.scores.len(),
        ),
        Doubt::Untold => format!(
            "the views were not screened: learnt coarsely, the others explain the median view only {:.2} dB better from \
             its own pose than from others, too little to tell; nobody was quarantined",
            found.median_db
        ),
    }
}
