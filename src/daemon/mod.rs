//! The daemon: gRPC services over one engine. Only this folder and `cairn-proto`
//! know the wire.
//!
//! Every handler has one rhythm: validate (version and fields), authorise,
//! convert, do, answer. What it does blocks, so it is done on a thread made for
//! that; renders and the like queue for a limited number of places.

pub mod from_proto;
pub mod http;
mod owners;
mod queries;
mod renders;
mod scenes;
pub mod serve;
mod status;
pub mod to_proto;
mod training;

use std::sync::{Arc, OnceLock};

use sha2::{Digest, Sha256};
use tokio::sync::Semaphore;
use tonic::Status;
use tonic::metadata::MetadataMap;

use crate::config::{Config, Token};
use crate::engine::Engine;
use crate::engine::error::EngineError;
use status::status;

/// What all services share. Cheap to clone.
#[derive(Clone)]
pub struct Shared {
    /// Empty until everything is loaded.
    engine: Arc<OnceLock<Arc<Engine>>>,
    token: Option<Arc<Token>>,
    renders: Arc<Semaphore>,
}

impl Shared {
    /// Services without an engine yet; they answer UNAVAILABLE until [`Shared::loaded`].
    pub fn new(config: &Config) -> Self {
        Self {
            engine: Arc::default(),
            token: config.token.clone().map(Arc::new),
            renders: Arc::new(Semaphore::new(config.limits.concurrent_renders)),
        }
    }

    /// Puts the services to work.
    pub fn loaded(&self, engine: Arc<Engine>) {
        // A second engine has no place; there is one caller, and it has one.
        let _ = self.engine.set(engine);
    }

    fn engine(&self) -> Result<Arc<Engine>, Status> {
        self.engine.get().cloned().ok_or_else(|| Status::unavailable("the daemon is still loading; try again soon"))
    }

    /// Whether the caller may change or spend something.
    fn authorise(&self, metadata: &MetadataMap) -> Result<(), Status> {
        let Some(token) = &self.token else { return Ok(()) };
        let remedy = "send `authorization: Bearer <token>` (--token-file) with the daemon's token";
        let Some(given) = metadata.get("authorization").and_then(|v| v.to_str().ok()) else {
            return Err(Status::unauthenticated(format!("this call needs a token; {remedy}")));
        };
        let given = given.strip_prefix("Bearer ").unwrap_or_default();
        // Compared by digest: how long that takes says nothing of the secret.
        if Sha256::digest(given) != Sha256::digest(token.secret()) {
            return Err(Status::unauthenticated(format!("the token is not the daemon's; {remedy}")));
        }
        Ok(())
    }

    /// Does something that blocks, off the async runtime.
    async fn run<T: Send + 'static>(
        &self,
        what: impl FnOnce(&Engine) -> Result<T, EngineError> + Send + 'static,
    ) -> Result<T, Status> {
        let engine = self.engine()?;
        let done = tokio::task::spawn_blocking(move || what(&engine)).await;
        done.unwrap_or_else(|e| Err(EngineError::Internal(format!("a request's thread ended early: {e}"))))
            .map_err(status)
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
