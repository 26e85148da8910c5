//! How a command reaches the services: over the network with `--connect`, in this process on `--data`, or in the
//! process that holds that folder. Each way it is the same services behind the same generated clients, so there is one
//! code path to get right.

use std::error::Error as _;
use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context as _;
use cairn_api::v1::AboutRequest;
use cairn_api::v1::access_service_client::AccessServiceClient;
use cairn_api::v1::owner_service_client::OwnerServiceClient;
use cairn_api::v1::query_service_client::QueryServiceClient;
use cairn_api::v1::render_service_client::RenderServiceClient;
use cairn_api::v1::scene_service_client::SceneServiceClient;
use cairn_api::v1::training_service_client::TrainingServiceClient;
use cairn_log::{NoteVerifier, OwnerKey};
use clap::ArgMatches;
use clap::parser::ValueSource;
use hyper_util::rt::TokioIo;
use tokio::time::{Instant, timeout_at};
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint, Identity, Uri};
use tonic::{Code, Status};

use super::credential::{Credential, Speaking};
use super::exit::last;
use super::files::read;
use super::unlock::UnlockArgs;
use cairn_service::config::{Config, Token};
use cairn_service::engine::Opening;
use cairn_service::error::EngineError;
use cairn_service::grpc::error::ServeError;
#[cfg(unix)]
use cairn_service::grpc::local;
use cairn_service::grpc::serve::InProcess;
use cairn_service::grpc::tls::pem;
use cairn_service::train::job::JobState;

/// How long a daemon may take to answer for the first time. What does not by then is no daemon, or out of reach.
const PATIENCE: Duration = Duration::from_secs(2);
/// How long a data folder is waited for whose holder does not answer.
const UNTIL_HELD: Duration = Duration::from_secs(5);
/// Between two attempts to have it.
const BETWEEN_TRIES: Duration = Duration::from_millis(100);

/// Where the services are.
#[derive(clap::Args, Clone, Debug)]
#[command(next_help_heading = "Connection")]
pub struct Where {
    /// A daemon to talk to, as 127.0.0.1:7341 or cairn.example:7341; without it the command works on --data
    #[arg(long, global = true, value_name = "URL", env = "CAIRN_CONNECT", hide_env_values = true)]
    pub connect: Option<String>,
    /// The data folder to work on where there is no --connect
    #[arg(
        long,
        global = true,
        value_name = "DIR",
        default_value = "cairn-data",
        env = "CAIRN_DATA_DIR",
        hide_env_values = true
    )]
    pub data: PathBuf,
    /// Settings that change the defaults (see configs/daemon.toml)
    #[arg(long, global = true, value_name = "FILE", env = "CAIRN_CONFIG", hide_env_values = true)]
    pub config: Option<PathBuf>,
    /// The file with the daemon's token, where it asks for one
    #[arg(long, global = true, value_name = "FILE", env = "CAIRN_TOKEN_FILE", hide_env_values = true)]
    pub token_file: Option<PathBuf>,
    /// The key file of your account with the daemon; every call is signed with it (see `cairn access`)
    #[arg(
        long,
        global = true,
        value_name = "FILE",
        conflicts_with = "token_file",
        env = "CAIRN_ACCOUNT",
        hide_env_values = true
    )]
    pub account: Option<PathBuf>,
    /// The key file that --account is sealed with
    #[arg(
        long,
        global = true,
        value_name = "FILE",
        hide_short_help = true,
        requires = "account",
        conflicts_with = "account_passphrase_file"
    )]
    pub account_key_file: Option<PathBuf>,
    /// The file with that key's passphrase; without it a sealed key's is asked for
    #[arg(long, global = true, value_name = "FILE", hide_short_help = true, requires = "account")]
    pub account_passphrase_file: Option<PathBuf>,
    /// The daemon's public key (vkey), pinned: calls are signed for no other daemon (see `cairn owners vkey`)
    #[arg(long, global = true, value_name = "FILE", hide_short_help = true)]
    pub daemon_vkey: Option<PathBuf>,
    /// Certificates that vouch for the daemon, PEM: needed for an https URL
    #[arg(long, global = true, value_name = "FILE", hide_short_help = true)]
    pub tls_ca: Option<PathBuf>,
    /// Your own certificate, PEM, where the daemon asks clients for one
    #[arg(long, global = true, value_name = "FILE", hide_short_help = true, requires = "tls_key")]
    pub tls_cert: Option<PathBuf>,
    /// The private key of --tls-cert, PEM
    #[arg(long, global = true, value_name = "FILE", hide_short_help = true, requires = "tls_cert")]
    pub tls_key: Option<PathBuf>,
}

impl Where {
    /// What holds where the command line and the environment say different things: what was typed goes first. An empty
    /// address is none.
    ///
    /// # Errors
    /// For a token and an account that are both typed.
    pub fn settle(&mut self, typed: &ArgMatches) -> anyhow::Result<()> {
        let typed = |id: &str| typed.value_source(id) == Some(ValueSource::CommandLine);
        if self.connect.as_deref() == Some("") || (typed("data") && !typed("connect")) {
            self.connect = None;
        }
        if self.token_file.is_some() && self.account.is_some() {
            anyhow::ensure!(
                !(typed("token_file") && typed("account")),
                "--token-file and --account: a daemon asks for one of them"
            );
            // Of two variables the one that says who it is.
            if typed("token_file") { self.account = None } else { self.token_file = None }
        }
        Ok(())
    }
}

/// A line to the services.
pub struct Connection {
    channel: Channel,
    credential: Credential,
    /// The key of --account.
    pub account: Option<OwnerKey>,
    /// Largest message that is sent or taken, bytes.
    pub max_message_bytes: usize,
    services: Services,
}

/// Whose the services are.
enum Services {
    /// A daemon's.
    Stay,
    /// Those of another command, which ends when it has done its work.
    OfCommand,
    /// Of this process.
    Here(InProcess),
}

/// A line whose calls are about one scene: what a signed call has to name.
pub struct Line<'a> {
    connection: &'a Connection,
    scene: &'a str,
}

macro_rules! clients {
    ($($(#[$doc:meta])* $name:ident: $client:ident,)*) => {
        impl Line<'_> {
            $($(#[$doc])*
            pub fn $name(&self) -> $client<Speaking> {
                let Connection { channel, credential, max_message_bytes: most, .. } = self.connection;
                $client::new(Speaking::new(channel.clone(), credential.clone(), self.scene))
                    .max_decoding_message_size(*most)
                    .max_encoding_message_size(*most)
            })*
        }

        #[allow(dead_code)] // All services are there, whether or not a command only reads from each.
        impl Connection {
            $($(#[$doc])*
            ///
            /// For calls about no scene, and for those that only read; others go through [`Connection::about`].
            pub fn $name(&self) -> $client<Speaking> {
                self.about("").$name()
            })*
        }
    };
}

clients! {
    /// Scenes.
    scenes: SceneServiceClient,
    /// Training.
    training: TrainingServiceClient,
    /// Renders.
    render: RenderServiceClient,
    /// Queries.
    query: QueryServiceClient,
    /// Owner records.
    owners: OwnerServiceClient,
    /// Accounts.
    access: AccessServiceClient,
}

impl Connection {
    /// Connects; or opens the data folder in this process; or, where another holds it, connects to that one.
    ///
    /// # Errors
    /// When there is no daemon at the address, the data folder cannot be had, or a file of the credentials is no good.
    pub async fn open(place: &Where, config: &Config, opening: Opening) -> anyhow::Result<Self> {
        let (passphrase_file, key_file) = (place.account_passphrase_file.clone(), place.account_key_file.clone());
        let unlock = UnlockArgs { passphrase_file, key_file };
        // In the data folder nobody is asked who they are.
        let account = place.account.as_deref().filter(|_| place.connect.is_some());
        let account = account.map(|path| unlock.load(path)).transpose()?;
        let max_message_bytes = config.limits.max_message_bytes;
        let (channel, services) = match &place.connect {
            Some(url) => (remote(url, place).await?, Services::Stay),
            None => here(place, config, opening).await?,
        };
        let credential = match (&place.token_file, &account) {
            // Whoever has the data folder in hand needs none.
            _ if place.connect.is_none() => Credential::Nothing,
            (Some(path), _) => Credential::bearer(Token::load(path)?.secret())?,
            (None, Some(key)) => Credential::account(key.clone(), &channel, pinned(place)?.as_ref()).await?,
            (None, None) => Credential::Nothing,
        };
        Ok(Self { channel, credential, account, max_message_bytes, services })
    }

    /// Whether the services go on when no command runs any more.
    pub const fn is_a_daemons(&self) -> bool {
        matches!(self.services, Services::Stay)
    }

    /// Names the trainings whose process ended before they did, but for `asked`, which the command is about. None goes on
    /// unasked.
    pub fn say_what_was_interrupted(&self, asked: Option<&str>) {
        let Services::Here(services) = &self.services else { return };
        for job in services
            .engine()
            .jobs()
            .list()
            .into_iter()
            .filter(|job| job.state == JobState::Interrupted && Some(job.id.as_str()) != asked)
        {
            let (id, scene) = (&job.id, &job.spec.scene);
            eprintln!(
                "{id} ({scene}) was cut off with its process; `cairn train {scene} --resume {id}` goes on with it, \
                 `cairn jobs cancel {id}` ends it"
            );
        }
    }

    /// The same line for calls about `scene`.
    pub fn about<'a>(&'a self, scene: &'a str) -> Line<'a> {
        Line { connection: self, scene }
    }

    /// Ends cleanly: a training in this process reaches its checkpoint.
    pub async fn close(self) {
        if let Services::Here(services) = self.services {
            services.shut_down().await;
        }
    }
}

/// The vkey that --daemon-vkey pins.
fn pinned(place: &Where) -> anyhow::Result<Option<NoteVerifier>> {
    let Some(path) = &place.daemon_vkey else { return Ok(None) };
    let text = String::from_utf8(read(path)?).with_context(|| format!("{} is no text", path.display()))?;
    Ok(Some(text.trim().parse().with_context(|| format!("{} is no vkey", path.display()))?))
}

/// Connects to a daemon, which must answer at once.
async fn remote(url: &str, place: &Where) -> anyhow::Result<Channel> {
    let url = with_scheme(url, place);
    let deadline = Instant::now() + PATIENCE;
    let endpoint = endpoint(&url, place)?;
    let channel = match timeout_at(deadline, endpoint.connect()).await {
        Ok(Ok(channel)) => channel,
        Ok(Err(error)) if last(&error).starts_with(CERTIFICATE) => {
            let said = last(&error);
            anyhow::bail!("the certificate of {url} is refused: {} ({said})", certificate_remedy(&said))
        }
        Ok(Err(error)) => anyhow::bail!(
            "no daemon is reached at {url} ({}); check the address, and --tls-ca for https; `cairn serve` starts a daemon, \
             and without --connect a command works on --data",
            last(&error)
        ),
        Err(_) => anyhow::bail!("{url} does not answer within {} s; is the address right?", PATIENCE.as_secs()),
    };
    match answers(&channel, deadline).await {
        Ok(()) => Ok(channel),
        // A daemon that still reads its data folder says so itself.
        Err(Silence::Refused(status)) if status.code() == Code::Unavailable && status.source().is_none() => {
            Err(status.into())
        }
        Err(silence) => anyhow::bail!(
            "{url} does not answer as a Cairn daemon does ({silence}); a daemon says where it listens when it starts, one with \
             TLS wants https://, and some ask for --tls-cert"
        ),
    }
}

/// What the line's TLS begins with where it refuses the other end's certificate.
const CERTIFICATE: &str = "invalid peer certificate";

/// What helps where a daemon's certificate is refused.
fn certificate_remedy(said: &str) -> &'static str {
    if said.contains("CaUsedAsEndEntity") {
        "it is an authority's, which can be no daemon's: make it again with `-addext basicConstraints=critical,CA:FALSE`"
    } else if said.contains("UnknownIssuer") || said.contains("BadSignature") {
        "nothing in the file of --tls-ca vouches for it: give the daemon's own certificate, or the one that signed it"
    } else if said.contains("for name") {
        "it is for another name: write the address with one of its names (subjectAltName), or make it again with this one"
    } else if said.contains("xpired") {
        "its time is over: make a new one, or set this machine's clock right"
    } else if ["NotValidYet", "not valid yet"].iter().any(|early| said.contains(early)) {
        "its time is still to come: set this machine's clock right, or make a new one"
    } else {
        "check server.tls.certificate of the daemon and --tls-ca"
    }
}

/// Why something is no daemon.
enum Silence {
    Refused(Status),
    Late,
}

impl fmt::Display for Silence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Refused(status) if status.source().is_some() => f.write_str(&last(status)),
            Self::Refused(status) if status.code() == Code::Unimplemented => f.write_str("it knows no call of Cairn's"),
            Self::Refused(status) => f.write_str(status.message()),
            Self::Late => write!(f, "no answer within {} s", PATIENCE.as_secs()),
        }
    }
}

/// Whether a daemon's services are at the end of `channel`, and say so before `deadline`.
async fn answers(channel: &Channel, deadline: Instant) -> Result<(), Silence> {
    let mut access = AccessServiceClient::new(channel.clone());
    match timeout_at(deadline, access.about(AboutRequest {})).await {
        Ok(Ok(_)) => Ok(()),
        Ok(Err(status)) => Err(Silence::Refused(status)),
        Err(_) => Err(Silence::Late),
    }
}

/// The address with the scheme that the other options mean.
fn with_scheme(url: &str, place: &Where) -> String {
    match (url.contains("://"), &place.tls_ca) {
        (true, _) => url.to_owned(),
        (false, Some(_)) => format!("https://{url}"),
        (false, None) => format!("http://{url}"),
    }
}

/// Opens the data folder in this process, or connects to the one that holds it. That one may be about to end, or have begun
/// just now: both are tried for a while.
async fn here(place: &Where, config: &Config, opening: Opening) -> anyhow::Result<(Channel, Services)> {
    let deadline = Instant::now() + UNTIL_HELD;
    loop {
        let taken = match InProcess::start(config, &place.data, opening).await {
            Ok(services) => return Ok((in_process(&services).await?, Services::Here(services))),
            Err(ServeError::Engine(taken @ EngineError::Locked { .. })) => taken,
            Err(refused) => return Err(refused.into()),
        };
        if let Some((channel, services)) = of_holder(place).await {
            if place.config.is_some() {
                eprintln!(
                    "the process that holds the data folder answers, with its own settings: --config is not read"
                );
            }
            return Ok((channel, services));
        }
        if Instant::now() > deadline {
            return Err(taken.into());
        }
        tokio::time::sleep(BETWEEN_TRIES).await;
    }
}

/// Connects to the process that holds the data folder; `None` where it does not answer.
#[cfg(unix)]
async fn of_holder(place: &Where) -> Option<(Channel, Services)> {
    let (stream, holder) = local::connect(&place.data).await.ok()?;
    let mut first = Some(TokioIo::new(stream));
    let data = place.data.clone();
    let connector = tower::service_fn(move |_: Uri| {
        let (first, data) = (first.take(), data.clone());
        async move {
            match first {
                Some(stream) => Ok(stream),
                None => local::connect(&data).await.map(|(stream, _)| TokioIo::new(stream)),
            }
        }
    });
    let endpoint = Endpoint::from_static("http://data-folder.invalid");
    let deadline = Instant::now() + PATIENCE;
    let channel = timeout_at(deadline, endpoint.connect_with_connector(connector)).await.ok()?.ok()?;
    answers(&channel, deadline).await.ok()?;
    let services = if holder == local::Holder::Daemon { Services::Stay } else { Services::OfCommand };
    Some((channel, services))
}

/// Connects to the process that holds the data folder; `None` where it does not answer.
#[cfg(not(unix))]
async fn of_holder(_: &Where) -> Option<(Channel, Services)> {
    None
}

/// Where the daemon is, and how the line to it is secured.
fn endpoint(url: &str, place: &Where) -> anyhow::Result<Endpoint> {
    let endpoint = Endpoint::from_shared(url.to_owned())
        .with_context(|| format!("--connect {url} is no URL; write HOST:PORT, http://HOST:PORT or https://HOST"))?;
    let secured = endpoint.uri().scheme_str() == Some("https");
    let Some(ca) = &place.tls_ca else {
        anyhow::ensure!(!secured, "--connect {url} needs --tls-ca FILE: the certificates that vouch for the daemon");
        anyhow::ensure!(place.tls_cert.is_none(), "--tls-cert is for an https URL with --tls-ca; {url} is not secured");
        return Ok(endpoint);
    };
    anyhow::ensure!(secured, "--tls-ca is for an https URL; --connect {url} is not secured");
    let mut tls = ClientTlsConfig::new().ca_certificate(Certificate::from_pem(pem(ca, "CERTIFICATE")?));
    if let (Some(certificate), Some(key)) = (&place.tls_cert, &place.tls_key) {
        tls = tls.identity(Identity::from_pem(pem(certificate, "CERTIFICATE")?, pem(key, "PRIVATE KEY")?));
    }
    endpoint.tls_config(tls).context("TLS does not start with the files of --tls-ca, --tls-cert and --tls-key")
}

async fn in_process(services: &InProcess) -> anyhow::Result<Channel> {
    let connections = services.connections.clone();
    let connector = tower::service_fn(move |_: Uri| {
        let (ours, theirs) = cairn_service::grpc::pipe();
        let sent = connections.send(Ok(theirs)).map_err(std::io::Error::other);
        async move { sent.map(|()| TokioIo::new(ours)) }
    });
    // The address is never looked up; HTTP wants one.
    Ok(Endpoint::from_static("http://in-process.invalid").connect_with_connector(connector).await?)
}
