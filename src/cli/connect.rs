//! How a command reaches the services: over the network with `--connect`, or in
//! this process on `--data`. Either way it is the same services behind the same
//! generated clients, so there is one code path to get right.

use std::path::PathBuf;

use anyhow::Context as _;
use cairn_proto::v1::detection_service_client::DetectionServiceClient;
use cairn_proto::v1::owner_service_client::OwnerServiceClient;
use cairn_proto::v1::query_service_client::QueryServiceClient;
use cairn_proto::v1::render_service_client::RenderServiceClient;
use cairn_proto::v1::scene_service_client::SceneServiceClient;
use cairn_proto::v1::training_service_client::TrainingServiceClient;
use hyper_util::rt::TokioIo;
use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Channel, Endpoint, Uri};
use tonic::{Request, Status};

use crate::config::{Config, Token};
use crate::daemon::serve::InProcess;

/// Bytes of pipe between client and services in this process.
const PIPE_BYTES: usize = 1 << 20;

/// Where the services are.
#[derive(clap::Args, Clone, Debug)]
pub struct Where {
    /// A daemon to talk to, as http://127.0.0.1:7341; without it the command works on --data itself
    #[arg(long, global = true, value_name = "URL")]
    pub connect: Option<String>,
    /// The data folder to work on where there is no --connect
    #[arg(long, global = true, value_name = "DIR", default_value = "cairn-data")]
    pub data: PathBuf,
    /// Settings that go over the defaults (see configs/default.toml)
    #[arg(long, global = true, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// The file with the daemon's token, where it asks for one
    #[arg(long, global = true, value_name = "FILE")]
    pub token_file: Option<PathBuf>,
}

/// Adds the token to every call.
#[derive(Clone)]
pub struct AddToken(Option<MetadataValue<Ascii>>);

impl Interceptor for AddToken {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(token) = &self.0 {
            request.metadata_mut().insert("authorization", token.clone());
        }
        Ok(request)
    }
}

type Service = InterceptedService<Channel, AddToken>;

/// A line to the services.
pub struct Connection {
    channel: Channel,
    token: AddToken,
    most: usize,
    in_process: Option<InProcess>,
}

macro_rules! clients {
    ($($(#[$doc:meta])* $name:ident: $client:ident,)*) => {
        impl Connection {
            $($(#[$doc])*
            pub fn $name(&self) -> $client<Service> {
                $client::with_interceptor(self.channel.clone(), self.token.clone())
                    .max_decoding_message_size(self.most)
                    .max_encoding_message_size(self.most)
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
    /// Detection.
    detection: DetectionServiceClient,
    /// Owner records.
    owners: OwnerServiceClient,
}

impl Connection {
    /// Connects, or opens the data folder in this process.
    ///
    /// # Errors
    /// When there is no daemon at the address, or the data folder is taken.
    pub async fn open(place: &Where) -> anyhow::Result<Self> {
        let config = Config::load(place.config.as_deref())?;
        let token = match &place.token_file {
            None => None,
            Some(path) => {
                let mut value: MetadataValue<Ascii> = format!("Bearer {}", Token::load(path)?.secret()).parse()?;
                value.set_sensitive(true);
                Some(value)
            }
        };
        let most = config.limits.max_message_bytes;
        let (channel, in_process) = match &place.connect {
            Some(url) => {
                let endpoint =
                    Endpoint::from_shared(url.clone()).with_context(|| format!("--connect {url} is no URL"))?;
                let channel = endpoint.connect().await;
                (channel.with_context(|| format!("no daemon answers at {url}; start one with `cairn serve`"))?, None)
            }
            None => {
                let services = InProcess::start(&config, &place.data).await?;
                (in_process(&services).await?, Some(services))
            }
        };
        Ok(Self { channel, token: AddToken(token), most, in_process })
    }

    /// Ends cleanly: a training in this process reaches its checkpoint.
    pub async fn close(self) {
        if let Some(services) = self.in_process {
            services.shut_down().await;
        }
    }
}

async fn in_process(services: &InProcess) -> anyhow::Result<Channel> {
    let connections = services.connections.clone();
    let connector = tower::service_fn(move |_: Uri| {
        let (ours, theirs) = tokio::io::duplex(PIPE_BYTES);
        let sent = connections.send(Ok(theirs)).map_err(std::io::Error::other);
        async move { sent.map(|()| TokioIo::new(ours)) }
    });
    // The address is never looked up; HTTP wants one.
    Ok(Endpoint::from_static("http://in-process.invalid").connect_with_connector(connector).await?)
}

/// A refusal as people should read it.
pub fn refused(status: Status) -> anyhow::Error {
    anyhow::anyhow!("{} ({:?})", status.message(), status.code())
}
