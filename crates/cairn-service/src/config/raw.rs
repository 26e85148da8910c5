//! What a settings file says, before anybody believed it. Defaults stand here a
//! second time, in code; a test holds them and the default file to each other.

use super::training::QuarantineConfig;
use crate::auth::Policy;
use cairn_field::FieldConfig;
use cairn_mark::Recipe;
use serde::{Deserialize, Serialize};

/// A whole settings file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Raw {
    pub format_version: u32,
    pub server: Server,
    pub access: Access,
    pub limits: Limits,
    pub training: Training,
    pub registry: Registry,
    pub log: Log,
    pub quarantine: QuarantineConfig,
    pub field: FieldConfig,
    pub mark: Recipe,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Server {
    pub bind: String,
    pub plaintext: bool,
    pub shutdown_grace_s: u64,
    pub tls: Tls,
}

/// Files of TLS, empty where there are none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tls {
    pub certificate: String,
    pub key: String,
    pub client_ca: String,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Access {
    pub mode: AccessMode,
    pub read: Reading,
    pub token_file: String,
    pub registration: Policy,
    pub token_lifetime_s: u64,
    pub quota: crate::auth::Limits,
}

/// How callers are let in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AccessMode {
    /// `token` where there is a token file, else `open`.
    Auto,
    /// Everybody.
    Open,
    /// Who brings the daemon's one token.
    Token,
    /// Who has an account.
    Accounts,
}

/// Whether reading needs a token.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reading {
    /// It needs none.
    Open,
    /// It needs one, anybody's.
    Closed,
}

/// What is accepted at most.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// Largest gRPC message, bytes.
    pub max_message_bytes: usize,
    /// Requests at the same time on one connection.
    pub concurrent_requests: usize,
    /// Renders, detections and evaluations at the same time.
    pub concurrent_renders: usize,
    /// Trainings accepted and not yet begun.
    pub queue_length: usize,
    /// Largest photograph, bytes.
    pub max_photograph_bytes: u64,
    /// Longest side of a photograph or a render, px.
    pub max_side_px: usize,
    /// Most pixels in a photograph or a render.
    pub max_pixels: u64,
    /// Most frames of a camera path.
    pub max_path_frames: usize,
    /// Most views in a scene.
    pub max_views: usize,
    /// Largest scene, bytes of all its photographs.
    pub max_scene_bytes: u64,
}

impl Limits {
    /// Those of a picture.
    pub fn of_pictures(&self) -> cairn_scene::Limits {
        cairn_scene::Limits {
            max_file_bytes: self.max_photograph_bytes,
            max_side_px: self.max_side_px,
            max_pixels: self.max_pixels,
            max_views: self.max_views,
        }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Training {
    pub checkpoint_every_s: u64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Registry {
    pub origin: String,
    pub key_file: String,
    pub anchor_file: String,
    pub http_bind: String,
    pub http_prefix: String,
    pub witnesses: Vec<String>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Log {
    pub filter: String,
    pub format: LogFormat,
}

/// How log lines look.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LogFormat {
    /// For people.
    Text,
    /// For collectors: one JSON object a line.
    Json,
}

impl Default for Raw {
    fn default() -> Self {
        Self {
            format_version: 1,
            server: Server {
                bind: "127.0.0.1:7341".into(),
                plaintext: false,
                shutdown_grace_s: 10,
                tls: Tls::default(),
            },
            access: Access {
                mode: AccessMode::Auto,
                read: Reading::Open,
                token_file: String::new(),
                registration: Policy::Approval,
                token_lifetime_s: crate::auth::token::MAX_LIFETIME_S,
                quota: crate::auth::Limits {
                    bytes: 16 << 30,
                    views: 10_000,
                    training_seconds: 28_800,
                    queued_jobs: 4,
                    records: 0,
                    records_per_day: 10_000,
                },
            },
            limits: Limits::default(),
            training: Training { checkpoint_every_s: 30 },
            registry: Registry::default(),
            log: Log { filter: "info".into(), format: LogFormat::Text },
            quarantine: QuarantineConfig::default(),
            field: FieldConfig::default(),
            mark: Recipe::default(),
        }
    }
}

impl Default for Registry {
    fn default() -> Self {
        Self {
            origin: "cairn.localhost/owners".into(),
            key_file: String::new(),
            anchor_file: String::new(),
            http_bind: String::new(),
            http_prefix: String::new(),
            witnesses: Vec::new(),
        }
    }
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            max_message_bytes: 32 << 20,
            concurrent_requests: 64,
            concurrent_renders: 2,
            queue_length: 16,
            max_photograph_bytes: 64 << 20,
            max_side_px: 16_384,
            max_pixels: 100_000_000,
            max_path_frames: 2_000,
            max_views: 10_000,
            max_scene_bytes: 16 << 30,
        }
    }
}
