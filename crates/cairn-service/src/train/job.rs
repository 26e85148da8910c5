//! What a training job is, as it is kept in `job.json`.

use std::fmt;

use cairn_field::FieldConfig;
use cairn_log::Digest;
use cairn_mark::Recipe;
use cairn_scene::cluster::Grouping;
use serde::{Deserialize, Serialize};

use crate::config::TrainingSettings;
use crate::store::hidden::Kinds;

/// Format version of `job.json`.
pub const VERSION: u32 = 2;

/// What to train. Never changes after the job was accepted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JobSpec {
    /// The scene's name.
    pub scene: String,
    /// How views become identities; a K of 0 is as many views a cluster as the scene has for it
    /// ([`crate::train::clusters::clusters`]).
    pub grouping: Grouping,
    /// Every random number comes from it. Text in JSON: it uses all 64 bits.
    #[serde(with = "as_text")]
    pub seed: u64,
    /// Settings of both stages, all of them; of several scenes, stage 1's of the first, and stage 2's that all share.
    pub settings: TrainingSettings,
    /// What the hidden signals in the job's folder are, identity 1's first, as
    /// `signal-<n>.png`, `.wav` and `.txt`; empty where they are drawn from the seed.
    pub signals: Vec<Kinds>,
    /// Whether to stop after stage 1: no marks, no detector.
    pub base_only: bool,
    /// Other scenes that are marked together with it, with one detector for all.
    pub also: Vec<Beside>,
    /// Of each of several scenes what its marks are made by: what all share, and what it has to itself
    /// ([`Recipe::for_scene`]). Empty for one scene.
    pub marks: Vec<Recipe>,
    /// Of each scene the job whose model is gone on from, `None` for one that begins; empty
    /// where all begin.
    pub grow_from: Vec<Option<String>>,
}

/// Another scene of a training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Beside {
    /// Its name.
    pub scene: String,
    /// Its stage 1's settings: they follow from the kind of scene.
    pub field: FieldConfig,
}

impl JobSpec {
    /// The names of all its scenes.
    pub fn scenes(&self) -> impl Iterator<Item = &str> {
        std::iter::once(self.scene.as_str()).chain(self.also.iter().map(|beside| beside.scene.as_str()))
    }

    /// Whether it trains on `scene`.
    pub fn is_of(&self, scene: &str) -> bool {
        self.scenes().any(|name| name == scene)
    }
}

/// A training job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Job {
    /// [`VERSION`].
    pub format_version: u32,
    /// `job-` and six digits, rising.
    pub id: String,
    /// What to train.
    pub spec: JobSpec,
    /// Where it stands.
    pub state: JobState,
    /// How far it was when this was written.
    pub progress: Progress,
    /// Why it failed; empty unless it did.
    pub error: String,
    /// When it was accepted, seconds since 1970.
    pub accepted_unix_s: u64,
    /// When it ended, likewise; 0 while it has not.
    pub ended_unix_s: u64,
    /// Seconds of computing a stage, its preparation included, over all runs.
    pub stages: Vec<StageSeconds>,
    /// What training found out about the scene, a sentence each.
    pub notes: Vec<String>,
    /// Who pays for it: the id of the account's key; absent where nobody does.
    pub owner: Option<Digest>,
}

impl Job {
    /// The job as if it were of its scene number `at` alone, which there is: the first, or
    /// one beside it.
    pub fn of_scene(&self, at: usize) -> Self {
        let mut own = self.clone();
        let grown = self.spec.grow_from.get(at).is_some_and(Option::is_some);
        if let Some(beside) = at.checked_sub(1).and_then(|at| self.spec.also.get(at)) {
            own.spec.scene.clone_from(&beside.scene);
            own.spec.settings.field = beside.field.clone();
        }
        if let Some(mark) = self.spec.marks.get(at) {
            own.spec.settings.mark = mark.clone();
        }
        own.spec.also.clear();
        own.spec.marks.clear();
        own.spec.grow_from = self.spec.grow_from.get(at).cloned().into_iter().collect();
        // Its field is there: nothing is trained on its photographs any more.
        own.spec.settings.screened &= !grown;
        own
    }

    /// A new job.
    pub fn accepted(id: String, spec: JobSpec, accepted_unix_s: u64) -> Self {
        Self {
            format_version: VERSION,
            id,
            spec,
            state: JobState::Accepted,
            progress: Progress::default(),
            error: String::new(),
            accepted_unix_s,
            ended_unix_s: 0,
            stages: Vec::new(),
            notes: Vec::new(),
            owner: None,
        }
    }
}

/// Where a job stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    /// Durable, waiting for the worker.
    Accepted,
    /// Training.
    Running,
    /// The model is there.
    Done,
    /// It stopped with an error.
    Failed,
    /// Somebody cancelled it.
    Cancelled,
    /// Its process ended before it did, and nobody resumed it. Never written down: a file says what it was then.
    Interrupted,
}

impl JobState {
    /// Whether nothing more happens by itself.
    pub fn has_ended(self) -> bool {
        self.is_over() || self == Self::Interrupted
    }

    /// Whether nothing more happens to it unless somebody resumes it: a daemon takes up what was interrupted.
    pub fn is_over(self) -> bool {
        matches!(self, Self::Done | Self::Failed | Self::Cancelled)
    }
}

impl fmt::Display for JobState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// Seconds of computing in one stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StageSeconds {
    /// The stage.
    pub stage: String,
    /// Seconds.
    pub seconds: f64,
}

/// How far a job is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Progress {
    /// `waiting`, `photographs`, `screening`, `base field`, `share table`, `ray weights`, `marked field`,
    /// `marked renders`, `finished`.
    pub stage: String,
    /// Steps of this stage done; photographs decoded, views worked out, pictures rendered.
    pub step: u64,
    /// Steps of this stage in all; 0 while not known.
    pub total: u64,
    /// The newest step's loss.
    pub loss: f64,
    /// The newest step's PSNR, dB; 0 where there is none.
    pub psnr_db: f64,
    /// Seconds left of the job, phases that have not begun included (roughly: `train/ahead.rs`); negative while not
    /// known.
    pub seconds_left: f64,
}

impl Default for Progress {
    fn default() -> Self {
        Self { stage: "waiting".into(), step: 0, total: 0, loss: 0.0, psnr_db: 0.0, seconds_left: -1.0 }
    }
}

mod as_text {
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    pub fn serialize<S: Serializer>(seed: &u64, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(seed)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u64, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(D::Error::custom)
    }
}
