//! The daemon: gRPC services over one engine. Only this folder and `cairn-api`
//! know the wire.
//!
//! Before every handler stands the gate, which knows each method's row in
//! cairn-service's table and lets nobody in whom it does not allow; a handler's own
//! `authorise` then holds the caller to what the call is about.
//!
//! Every handler has one rhythm: validate, authorise,
//! convert, do, answer. What it does blocks, so it is done on a thread made for
//! that; renders and the like queue for a limited number of places.

mod access;
#[cfg(test)]
mod contract_tests;
pub mod error;
pub mod from_proto;
mod gate;
pub mod http;
#[cfg(unix)]
pub mod local;
mod owners;
mod queries;
mod renders;
mod scenes;
pub mod serve;
mod status;
pub mod tls;
pub mod to_proto;
mod training;
mod waiting;

use std::sync::{Arc, OnceLock};

use crate::auth::{AccessError, Daemon, Nonces, Verifier};
use tokio::io::DuplexStream;
use tokio::sync::Semaphore;
use tonic::Status;

use crate::config::{Access, Config, Mode, Token};
use crate::engine::Engine;
use crate::error::EngineError;

/// Bytes of pipe between a client and the services in one process.
const PIPE_BYTES: usize = 1 << 20;

/// What a handler answers with.
type Answer<T> = Result<tonic::Response<T>, Status>;

/// What all services share. Cheap to clone.
#[derive(Clone)]
pub struct Shared {
    /// Empty until everything is loaded.
    loaded: Arc<OnceLock<Loaded>>,
    token: Option<Arc<Token>>,
    access: Arc<Access>,
    /// Whether only those can call who have the data folder in hand.
    in_process: bool,
    renders: Arc<Semaphore>,
    /// Held while a picture's camera is searched for.
    searches: Arc<Semaphore>,
    /// Largest message that goes out.
    most_bytes: usize,
}

/// What is there once the data folder was read.
struct Loaded {
    engine: Arc<Engine>,
    verifier: Verifier,
    nonces: Nonces,
}

impl Shared {
    /// Services without an engine yet; they answer UNAVAILABLE until [`Shared::loaded`].
    pub fn new(config: &Config) -> Self {
        Self {
            loaded: Arc::default(),
            token: config.token.clone().map(Arc::new),
            access: Arc::new(config.access.clone()),
            in_process: false,
            most_bytes: config.limits.max_message_bytes,
            renders: Arc::new(Semaphore::new(config.limits.concurrent_renders)),
            searches: Arc::new(Semaphore::new(1)),
        }
    }

    /// The same, for those who have the data folder in hand: they are its operators, and bring no token.
    pub fn in_process(&self) -> Self {
        let access = Access { mode: Mode::Open, read_closed: false, ..Access::clone(&self.access) };
        Self { token: None, access: Arc::new(access), in_process: true, ..self.clone() }
    }

    /// Puts the services to work.
    ///
    /// # Errors
    /// Where the system has no random bytes to tell this run from others.
    pub fn loaded(&self, engine: Arc<Engine>) -> Result<(), AccessError> {
        let registry = engine.registry();
        let daemon = Daemon::starting(registry.origin(), &registry.public_key())?;
        let verifier = Verifier::new(daemon, self.access.token_lifetime_s);
        let nonces = Nonces::new(registry.origin())?;
        // A second engine has no place; there is one caller, and it has one.
        let _ = self.loaded.set(Loaded { engine, verifier, nonces });
        Ok(())
    }

    fn at_work(&self) -> Result<&Loaded, Status> {
        self.loaded.get().ok_or_else(|| Status::unavailable("the daemon is still loading; try again soon"))
    }

    fn engine(&self) -> Result<Arc<Engine>, Status> {
        Ok(self.at_work()?.engine.clone())
    }

    /// Does something that blocks, off the async runtime.
    async fn run<T: Send + 'static>(
        &self,
        what: impl FnOnce(&Engine) -> Result<T, EngineError> + Send + 'static,
    ) -> Result<T, Status> {
        let engine = self.engine()?;
        let done = tokio::task::spawn_blocking(move || what(&engine)).await;
        done.unwrap_or_else(|e| Err(EngineError::Internal(format!("a request's thread ended early: {e}"))))
            .map_err(Status::from)
    }

    /// As [`Shared::run`], for what keeps all processors busy: waits for a place.
    async fn compute<T: Send + 'static>(
        &self,
        what: impl FnOnce(&Engine) -> Result<T, EngineError> + Send + 'static,
    ) -> Result<T, Status> {
        // Never closed; were it, going on without a place would be the lesser harm.
        let place = self.renders.clone().acquire_owned().await.ok();
        // The place goes with the work: a caller that hangs up does not free it early.
        self.run(move |engine| {
            let _place = place;
            what(engine)
        })
        .await
    }
}

/// Both ends of a connection within this process: the client's and the services'.
#[must_use]
pub fn pipe() -> (DuplexStream, DuplexStream) {
    tokio::io::duplex(PIPE_BYTES)
}
