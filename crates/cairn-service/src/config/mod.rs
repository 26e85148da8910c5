//! Settings in two steps: raw (what a file says, typed by serde) and checked
//! (what the program may rely on). Nothing else reads a settings file.
//!
//! The commented default file is compiled in and is the list of all keys: a file
//! is laid over it, so a key that it does not have is unknown, and is refused
//! with its name, its value and what is allowed there.

mod access;
mod error;
mod overlay;
pub mod preset;
mod raw;
mod registry;
#[cfg(test)]
mod tests;
mod training;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use cairn_scene::SceneKind;

pub use access::{Access, Mode, TlsFiles};
pub use error::ConfigError;
use error::{out_of_range, within};
pub use overlay::{overridden, training_settings};
use raw::Raw;
pub use raw::{Limits, LogFormat};
pub use registry::{PublicHttp, WitnessSetting};
pub use training::{Chosen, Preset, Quality, TrainingSettings};

/// The commented default file.
pub const DEFAULT_TOML: &str = include_str!("../../../../configs/default.toml");
/// What `--quick` lays over the training settings.
pub const QUICK_TOML: &str = include_str!("../../../../configs/quick.toml");

/// The training settings that are meant for a kind of scene: the file's name and its text.
pub fn overlay_for(kind: SceneKind) -> (&'static str, &'static str) {
    match kind {
        SceneKind::ForwardFacing => ("configs/llff.toml", include_str!("../../../../configs/llff.toml")),
        SceneKind::Bounded => ("configs/synthetic.toml", include_str!("../../../../configs/synthetic.toml")),
        SceneKind::Unbounded => ("configs/wild.toml", include_str!("../../../../configs/wild.toml")),
    }
}

/// The version of settings files that this release reads.
const FORMAT_VERSION: u32 = 1;
/// Largest settings or token file, bytes.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// Settings that were checked.
#[derive(Clone, Debug)]
pub struct Config {
    /// Where to listen.
    pub bind: SocketAddr,
    /// Seconds for requests under way at the end.
    pub shutdown_grace_s: u64,
    /// TLS; `None` serves without.
    pub tls: Option<TlsFiles>,
    /// What callers that change something must bring; `None` asks for no bearer token.
    pub token: Option<Token>,
    /// Who may do what.
    pub access: Access,
    /// What is accepted at most.
    pub limits: Limits,
    /// Seconds between a training's checkpoints.
    pub checkpoint_every_s: u64,
    /// The log's origin line.
    pub origin: String,
    /// What the registry's signing key is sealed with; `None` where it lies in plain PEM. Read when the log is opened.
    pub registry_key_file: Option<PathBuf>,
    /// Where the log's anchor lies; `None` without one. Whether that is outside the data folder is seen when the log is opened.
    pub anchor_file: Option<PathBuf>,
    /// Where the log's public files are served, and what stands in front of their paths.
    pub public_http: Option<PublicHttp>,
    /// Who cosigns the log's checkpoints.
    pub witnesses: Vec<WitnessSetting>,
    /// `tracing` filter.
    pub log_filter: String,
    /// How log lines look.
    pub log_format: LogFormat,
    /// The settings of training, before a request's own go over them, where no kind of scene chooses.
    pub training: TrainingSettings,
    /// What the settings file says of training, TOML: it goes over what the kind of a scene chooses.
    pub training_configured: String,
}

/// A bearer token; never printed.
#[derive(Clone)]
pub struct Token(String);

impl Token {
    /// The secret itself, to be compared or sent and not to be shown.
    pub fn secret(&self) -> &str {
        &self.0
    }

    /// Reads the token in `path`: one line of 16 to 512 printable ASCII characters.
    ///
    /// # Errors
    /// [`ConfigError`] when it cannot be read or is no such line.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let text = read(path)?;
        let token = text.trim();
        if !(16..=512).contains(&token.len()) || !token.bytes().all(|b| b.is_ascii_graphic()) {
            // The value is a secret: its length must do.
            let value = format!("a token of {} bytes in {}", token.len(), path.display());
            return Err(out_of_range("access.token_file", value, "16 to 512 printable ASCII characters on one line"));
        }
        Ok(Self(token.to_owned()))
    }
}

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token(secret)")
    }
}

impl Config {
    /// The defaults with the file at `path` over them, checked.
    ///
    /// # Errors
    /// [`ConfigError`] for an unreadable file, and an unknown or out-of-range key.
    pub fn load(path: Option<&Path>) -> Result<Self, ConfigError> {
        match path {
            None => Self::from_toml("", "the defaults"),
            Some(path) => Self::from_toml(&read(path)?, &path.display().to_string()),
        }
    }

    /// The defaults with `text` over them, checked; `place` names it in errors.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn from_toml(text: &str, place: &str) -> Result<Self, ConfigError> {
        let defaults = overlay::parse(DEFAULT_TOML, "configs/default.toml")?;
        let table = overlay::laid_over(defaults.clone(), text, place)?;
        let raw: Raw = table.try_into().map_err(|e| overlay::toml_error(place, &e))?;
        let training_configured = overlay::configured(&overlay::parse(text, place)?, &defaults, place)?;
        Ok(Self { training_configured, ..checked(raw)? })
    }
}

fn read(path: &Path) -> Result<String, ConfigError> {
    let io = |source| ConfigError::Io { path: path.to_path_buf(), source };
    let length = std::fs::metadata(path).map_err(io)?.len();
    if length > MAX_FILE_BYTES {
        let cause = format!("{length} bytes; a settings or token file has at most {MAX_FILE_BYTES}");
        return Err(ConfigError::Toml { place: path.display().to_string(), cause });
    }
    std::fs::read_to_string(path).map_err(io)
}

/// Second step: every range, and every file that a setting names.
fn checked(raw: Raw) -> Result<Config, ConfigError> {
    within("format_version", raw.format_version.into(), FORMAT_VERSION.into()..=FORMAT_VERSION.into())?;
    let bind: SocketAddr = (raw.server.bind.parse())
        .map_err(|_| out_of_range("server.bind", &raw.server.bind, "an IP address and a port, as 127.0.0.1:7341"))?;
    within("server.shutdown_grace_s", raw.server.shutdown_grace_s, 0..=600)?;
    check_limits(&raw.limits)?;
    within("training.checkpoint_every_s", raw.training.checkpoint_every_s, 0..=86_400)?;
    registry::check_origin(&raw.registry.origin)?;
    if let Err(e) = tracing_subscriber::EnvFilter::try_new(&raw.log.filter) {
        return Err(out_of_range("log.filter", &raw.log.filter, format!("a tracing filter ({e})")));
    }
    let (access, token) = access::checked(&raw.access)?;
    let tls = access::tls(&raw.server.tls)?;
    access::check_bind(bind, access.mode, tls.is_some() || raw.server.plaintext)?;
    let training = TrainingSettings { field: raw.field, mark: raw.mark, quarantine: raw.quarantine };
    training.check()?;
    Ok(Config {
        bind,
        shutdown_grace_s: raw.server.shutdown_grace_s,
        tls,
        token,
        access,
        limits: raw.limits,
        checkpoint_every_s: raw.training.checkpoint_every_s,
        public_http: registry::public_http(&raw.registry)?,
        witnesses: registry::witnesses(&raw.registry.witnesses)?,
        anchor_file: registry::anchor_file(&raw.registry.anchor_file)?,
        origin: raw.registry.origin,
        registry_key_file: Some(raw.registry.key_file).filter(|path| !path.is_empty()).map(PathBuf::from),
        log_filter: raw.log.filter,
        log_format: raw.log.format,
        training,
        training_configured: String::new(),
    })
}

fn check_limits(limits: &Limits) -> Result<(), ConfigError> {
    within("limits.max_message_bytes", limits.max_message_bytes as u64, 1 << 16..=1 << 30)?;
    within("limits.concurrent_requests", limits.concurrent_requests as u64, 1..=10_000)?;
    within("limits.concurrent_renders", limits.concurrent_renders as u64, 1..=256)?;
    within("limits.queue_length", limits.queue_length as u64, 1..=10_000)?;
    within("limits.max_photograph_bytes", limits.max_photograph_bytes, 1024..=1 << 30)?;
    within("limits.max_side_px", limits.max_side_px as u64, 16..=65_536)?;
    within("limits.max_pixels", limits.max_pixels, 256..=1_000_000_000)?;
    within("limits.max_path_frames", limits.max_path_frames as u64, 2..=100_000)?;
    within("limits.max_views", limits.max_views as u64, 2..=1_000_000)?;
    within("limits.max_scene_bytes", limits.max_scene_bytes, 1024..=1 << 40)
}
