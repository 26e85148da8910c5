//! Starting and stopping: listening, health, reflection, limits, signals.
//!
//! Contract. The health service answers from the first moment, NOT_SERVING until
//! the data folder is loaded and again from the first signal on. On SIGINT or SIGTERM
//! the running training MUST reach its checkpoint before the process ends; requests
//! under way get the configured grace.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use cairn_api::v1;
use cairn_api::v1::access_service_server::AccessServiceServer;
use cairn_api::v1::owner_service_server::OwnerServiceServer;
use cairn_api::v1::query_service_server::QueryServiceServer;
use cairn_api::v1::render_service_server::RenderServiceServer;
use cairn_api::v1::scene_service_server::SceneServiceServer;
use cairn_api::v1::training_service_server::TrainingServiceServer;
use tokio::io::DuplexStream;
use tokio::sync::mpsc::UnboundedSender;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tokio_stream::wrappers::{TcpListenerStream, UnboundedReceiverStream};
use tonic::service::Routes;
use tonic::transport::Server;
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;

use super::error::ServeError;
use super::gate::GateLayer;
#[cfg(unix)]
use super::local;
use super::{Shared, http, tls};
use crate::config::{Config, Limits};
use crate::engine::{Engine, Opening};
use crate::store::folder;

/// Requests answered at the same time on one connection.
const CONCURRENT_REQUESTS: usize = 64;

/// The services with the configured message limits.
fn routes(shared: &Shared, limits: &Limits) -> Routes {
    let most = limits.max_message_bytes;
    let mut routes = Routes::default();
    macro_rules! add {
        ($($server:ident),*) => {
            $(routes = routes.add_service(
                $server::new(shared.clone()).max_decoding_message_size(most).max_encoding_message_size(most),
            );)*
        };
    }
    add!(
        SceneServiceServer,
        TrainingServiceServer,
        RenderServiceServer,
        QueryServiceServer,
        OwnerServiceServer,
        AccessServiceServer
    );
    routes
}

/// Tells health's askers about the daemon as a whole (the empty name) and about every service.
async fn tell(health: &HealthReporter, status: ServingStatus) {
    let services = v1::METHODS.iter().filter_map(|path| path.strip_prefix('/')?.split_once('/'));
    let services: BTreeSet<&str> = services.map(|(service, _)| service).chain([""]).collect();
    for service in services {
        health.set_service_status(service, status).await;
    }
}

/// The log's public files on an address of their own.
struct PublicFiles {
    url: String,
    stop: oneshot::Sender<()>,
    server: JoinHandle<std::io::Result<()>>,
}

impl PublicFiles {
    /// Starts serving them where the settings say so.
    async fn start(config: &Config, data: &Path) -> Result<Option<Self>, ServeError> {
        let Some(public) = &config.public_http else { return Ok(None) };
        let listener = tokio::net::TcpListener::bind(public.bind).await.map_err(|source| ServeError::Listen {
            address: public.bind,
            setting: "registry.http_bind",
            source,
        })?;
        let url = format!("http://{}{}", listener.local_addr()?, public.prefix);
        let (folder, prefix) = (data.join("registry").join("public"), public.prefix.clone());
        let (stop, stopped) = oneshot::channel::<()>();
        let server = tokio::spawn(async move {
            // An error means that the sender is gone: stop as well.
            http::serve(listener, folder, &prefix, async { drop(stopped.await) }).await
        });
        Ok(Some(Self { url, stop, server }))
    }

    async fn end(self) {
        let _ = self.stop.send(());
        // Every connection has its grace there; a panic was reported on its own thread.
        let _ = self.server.await;
    }
}

/// Runs the daemon until a signal. Prints `cairn listens at http://ADDRESS` (or https) on standard output once it
/// serves, and a second line with the address of the log's public files where these are served.
///
/// # Errors
/// When the address or the data folder is taken, or what lies in the folder cannot be read.
pub async fn serve(config: Config, data: &Path) -> Result<(), ServeError> {
    let listener = match tokio::net::TcpListener::bind(config.bind).await {
        Ok(listener) => listener,
        Err(source) => {
            // A second daemon with the same settings finds both taken; the folder alone says by whom.
            folder::must_be_free(data)?;
            return Err(ServeError::Listen { address: config.bind, setting: "server.bind", source });
        }
    };
    let address = listener.local_addr()?;
    let shared = Shared::new(&config);
    let (reporter, health) = tonic_health::server::health_reporter();
    tell(&reporter, ServingStatus::NotServing).await;
    let reflection = tonic_reflection::server::Builder::configure()
        .register_encoded_file_descriptor_set(v1::FILE_DESCRIPTOR_SET)
        .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        .build_v1()?;
    let (stop, stopped) = oneshot::channel::<()>();
    let server = tls::secured(Server::builder(), config.tls.as_ref())?
        .concurrency_limit_per_connection(CONCURRENT_REQUESTS)
        .layer(GateLayer(shared.clone()))
        .add_routes(routes(&shared, &config.limits))
        .add_service(health)
        .add_service(reflection)
        .serve_with_incoming_shutdown(TcpListenerStream::new(listener), async {
            // An error means that the sender is gone: stop as well.
            let _ = stopped.await;
        });
    let mut server = tokio::spawn(server);

    let engine = load(&config, data, Opening::Serve).await?;
    let public = PublicFiles::start(&config, data).await?;
    for witness in &config.witnesses {
        tracing::info!(witness = %witness.verifier, url = witness.url, "configured witness");
    }
    shared.loaded(engine.clone())?;
    let local = InProcess::over(engine.clone(), &shared, &config.limits, Some(data), true);
    tell(&reporter, ServingStatus::Serving).await;
    // Before anybody is told where it is, who may then stop it at once.
    let signal = signal()?;
    let scheme = if config.tls.is_some() { "https" } else { "http" };
    announce(&format!("{scheme}://{address}"), public.as_ref().map(|public| public.url.as_str()));
    tokio::select! {
        ended = &mut server => return Ok(ended??),
        signal = signal => tracing::info!(signal = signal?, "shutting down"),
    }
    tell(&reporter, ServingStatus::NotServing).await;
    local.hide();
    let of_jobs = engine.clone();
    tokio::task::spawn_blocking(move || of_jobs.shut_down()).await?;
    // Watchers of a training that was put down would wait for ever: hence the grace.
    let _ = stop.send(());
    let grace = Duration::from_secs(config.shutdown_grace_s);
    let (ended, ()) = tokio::join!(tokio::time::timeout(grace, &mut server), local.end_within(grace));
    match ended {
        Ok(ended) => ended??,
        Err(_) => server.abort(),
    }
    if let Some(public) = public {
        public.end().await;
    }
    tokio::task::spawn_blocking(move || engine.close()).await?;
    tracing::info!("stopped");
    Ok(())
}

async fn load(config: &Config, data: &Path, opening: Opening) -> Result<Arc<Engine>, ServeError> {
    let (config, data) = (config.clone(), data.to_path_buf());
    Ok(Arc::new(tokio::task::spawn_blocking(move || Engine::open(&data, &config, opening)).await??))
}

fn announce(url: &str, public: Option<&str>) {
    use std::io::Write;
    // For people and for programs that started us on port 0. A closed output is no reason to stop.
    let mut out = std::io::stdout().lock();
    let public_line = public.map_or(String::new(), |url| format!("public log at {url}\n"));
    let _ = write!(out, "cairn listens at {url}\n{public_line}").and_then(|()| out.flush());
    tracing::info!(url, public, "serving");
}

/// Listens for SIGINT and SIGTERM from now on; the future waits for one and gives its name.
///
/// # Errors
/// Where the system refuses to tell of signals.
pub fn signal() -> std::io::Result<impl Future<Output = std::io::Result<&'static str>>> {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        let (mut interrupt, mut terminate) = (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
        Ok(async move {
            tokio::select! {
                _ = interrupt.recv() => Ok("SIGINT"),
                _ = terminate.recv() => Ok("SIGTERM"),
            }
        })
    }
    #[cfg(not(unix))]
    Ok(async { tokio::signal::ctrl_c().await.map(|()| "interrupt") })
}

/// The same services in this process, for clients without a daemon, and for commands that reach it through the data
/// folder. Dropping the engine's last holder lets the data folder go.
pub struct InProcess {
    engine: Arc<Engine>,
    /// Where a client puts its ends of new connections ([`super::pipe`]).
    pub connections: UnboundedSender<std::io::Result<DuplexStream>>,
    #[cfg(unix)]
    socket: Option<local::Socket>,
}

impl InProcess {
    /// Opens `data` and serves it to this process, and to others that find it taken.
    ///
    /// # Errors
    /// As [`serve`], but for the address.
    pub async fn start(config: &Config, data: &Path, opening: Opening) -> Result<Self, ServeError> {
        let engine = load(config, data, opening).await?;
        // What is read through a shadow is nobody's: the next command reads it as well.
        let held = engine.holds_the_folder();
        let shared = Shared::new(config);
        shared.loaded(engine.clone())?;
        Ok(Self::over(engine, &shared, &config.limits, held.then_some(data), false))
    }

    /// Serves an engine that is `shared` already, and in `data` the others, as one who `stays`: a daemon.
    fn over(engine: Arc<Engine>, shared: &Shared, limits: &Limits, data: Option<&Path>, stays: bool) -> Self {
        // A token would only lock the owner out.
        let shared = shared.in_process();
        let (connections, incoming) = tokio::sync::mpsc::unbounded_channel();
        let server = Server::builder()
            .layer(GateLayer(shared.clone()))
            .add_routes(routes(&shared, limits))
            .serve_with_incoming(UnboundedReceiverStream::new(incoming));
        tokio::spawn(server);
        #[cfg(unix)]
        let socket = data.and_then(|data| {
            let holder = if stays { local::Holder::Daemon } else { local::Holder::Command };
            let listening = local::Socket::listen(data, holder, connections.clone());
            // Without it the folder is in use, as it ever was.
            listening.inspect_err(|error| tracing::info!(%error, "no socket in the data folder")).ok()
        });
        #[cfg(not(unix))]
        let _ = (data, stays);
        Self {
            engine,
            connections,
            #[cfg(unix)]
            socket,
        }
    }

    /// The engine that answers.
    pub fn engine(&self) -> &Engine {
        &self.engine
    }

    /// Waits for the commands that came through the data folder, then stops a running training after its checkpoint. Call
    /// before the process ends.
    pub async fn shut_down(self) {
        #[cfg(unix)]
        if let Some(socket) = self.socket {
            socket.close().await;
        }
        let engine = self.engine;
        // A panic in there was reported on its own thread.
        let _ = tokio::task::spawn_blocking(move || {
            engine.shut_down();
            engine.close();
        })
        .await;
    }

    /// Lets no further command find the way through the data folder.
    fn hide(&self) {
        #[cfg(unix)]
        self.socket.iter().for_each(local::Socket::hide);
    }

    /// Lets commands that came through the data folder end for `grace`, where the engine is another's to stop.
    async fn end_within(self, grace: Duration) {
        #[cfg(unix)]
        if let Some(socket) = self.socket {
            socket.close_within(grace).await;
        }
        #[cfg(not(unix))]
        let _ = grace;
    }
}
