//! The daemon's settings, checked: what the program may rely on.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use cairn_scene::SceneKind;

use super::access::{self, Access, TlsFiles};
use super::error::{ConfigError, out_of_range};
use super::options::TrainingOptions;
use super::read;
use super::registry::{self, PublicHttp, WitnessSetting};
use super::settings::{Limits, LogFormat, Settings, Training};
use super::token::{self, Token};

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
    /// The log's origin line.
    pub origin: String,
    /// What the registry's signing key is sealed with; `None` where it lies in plain PEM. Read when the log is opened.
    pub registry_key_file: Option<PathBuf>,
    /// Where the log's anchor lies; `None`: beside the data folder. Whether that is outside the data folder is seen when the log is opened.
    pub anchor_file: Option<PathBuf>,
    /// Where the log's public files are served, and what stands in front of their paths.
    pub public_http: Option<PublicHttp>,
    /// Who cosigns the log's checkpoints.
    pub witnesses: Vec<WitnessSetting>,
    /// `tracing` filter.
    pub log_filter: String,
    /// How log lines look.
    pub log_format: LogFormat,
    /// How trainings are made where a request does not say.
    pub training: Training,
}

impl Config {
    /// The defaults with the file at `path` over them, checked.
    ///
    /// # Errors
    /// [`ConfigError`] for an unreadable file, and an unknown or out-of-range key.
    pub fn load(path: Option<&Path>) -> Result<Self, ConfigError> {
        match path {
            None => Self::from_toml("", "the defaults"),
            Some(path) => Self::from_toml(&token::read(path)?, &path.display().to_string()),
        }
    }

    /// The defaults with `text` over them, checked; `place` names it in errors.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn from_toml(text: &str, place: &str) -> Result<Self, ConfigError> {
        checked(read::settings(text, place)?)
    }
}

/// What the declared ranges do not say: texts that have to read, and settings that rest on each other.
fn checked(settings: Settings) -> Result<Config, ConfigError> {
    let server = &settings.server;
    let bind: SocketAddr = (server.bind.parse())
        .map_err(|_| out_of_range("server.bind", &server.bind, "an IP address and a port, as 127.0.0.1:7341"))?;
    registry::check_origin(&settings.registry.origin)?;
    if let Err(e) = tracing_subscriber::EnvFilter::try_new(&settings.log.filter) {
        return Err(out_of_range("log.filter", &settings.log.filter, format!("a tracing filter ({e})")));
    }
    let (access, token) = access::checked(&settings.access, &settings.quota)?;
    let tls = access::tls(&settings.tls)?;
    access::check_bind(bind, access.mode, tls.is_some() || server.plaintext)?;
    // Whatever the kind of a scene, the file's choice has to hold together.
    for kind in [SceneKind::ForwardFacing, SceneKind::Bounded, SceneKind::Unbounded] {
        TrainingOptions::default().settings(&settings.training, kind)?;
    }
    Ok(Config {
        bind,
        shutdown_grace_s: server.shutdown_grace_s,
        tls,
        token,
        access,
        limits: settings.limits,
        public_http: registry::public_http(&settings.registry)?,
        witnesses: registry::witnesses(&settings.registry.witnesses)?,
        anchor_file: registry::anchor_file(&settings.registry.anchor_file)?,
        origin: settings.registry.origin,
        registry_key_file: Some(settings.registry.key_file).filter(|path| !path.is_empty()).map(PathBuf::from),
        log_filter: settings.log.filter,
        log_format: settings.log.format,
        training: settings.training,
    })
}
