//! Settings: declared once in `settings`, read and checked before anything starts. Nothing else reads a settings file.
//! How a training goes is a choice of named presets ([`preset`]) with few options over it.

mod access;
mod daemon;
pub mod declare;
#[cfg(test)]
#[path = "document_tests.rs"]
mod document;
mod error;
mod options;
pub mod preset;
mod read;
mod registry;
mod settings;
#[cfg(test)]
mod tests;
mod token;
mod training;

pub use access::{Access, Mode, TlsFiles};
pub use daemon::Config;
pub use error::ConfigError;
pub use options::TrainingOptions;
pub use registry::{PublicHttp, WitnessSetting};
pub use settings::{Limits, LogFormat, TABLES, Training};
pub use token::Token;
pub use training::{Chosen, Preset, PresetChoice, Quality, TrainingSettings};
