//! What a training job is, as it is kept in `job.json`.

use cairn_cluster::Grouping;
use cairn_registry::Digest;
use serde::{Deserialize, Serialize};

use super::hidden::Kinds;
use crate::config::TrainingSettings;

/// Format version of `job.json`: 2 since signals are sounds and texts as well.
pub const VERSION: u32 = 2;
/// Those that are read.
pub const VERSIONS: [u32; 2] = [1, VERSION];

/// What to train. Never changes after the job was accepted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JobSpec {
    /// The scene's name.
    pub scene: String,
    /// How views become identities.
    pub grouping: Grouping,
    /// Every random number comes from it. Text in JSON: it uses all 64 bits.
    #[serde(with = "as_text")]
    pub seed: u64,
    /// Settings of both stages, all of them.
    pub settings: TrainingSettings,
    /// What the hidden signals in the job's folder are, identity 1's first, as
    /// `signal-<n>.png`, `.wav` and `.txt`; empty where they are drawn from the seed.
    #[serde(deserialize_with = "super::hidden::kinds")]
    pub signals: Vec<Kinds>,
    /// Whether to stop after stage 1: no marks, no detector.
    pub base_only: bool,
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
    #[serde(default)]
    pub notes: Vec<String>,
    /// Who pays for it: the id of the account's key; absent where nobody does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub owner: Option<Digest>,
}

impl Job {
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
}

impl JobState {
    /// Whether nothing more happens by itself.
    pub fn has_ended(self) -> bool {
        matches!(self, Self::Done | Self::Failed | Self::Cancelled)
    }

    /// Its word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Accepted => "accepted",
            Self::Running => "running",
            Self::Done => "done",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
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
    /// `waiting`, `photographs`, `base field`, `ray weights`, `marked field`, `finished`.
    pub stage: String,
    /// Steps of this stage done; photographs decoded, views worked out.
    pub step: u64,
    /// Steps of this stage in all; 0 while not known.
    pub total: u64,
    /// The newest step's loss.
    pub loss: f64,
    /// The newest step's PSNR, dB; 0 where there is none.
    pub psnr_db: f64,
    /// Seconds left in this stage; negative while not known.
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
