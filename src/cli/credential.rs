//! How a command's calls say who calls: the daemon's bearer token, or a token of
//! its own for every call, signed with the account's key.
//!
//! A signed token names the call's method, which stands in its address, and the
//! scene that the call is about, which only the command knows: it asks the line for a
//! client that speaks about that scene (`line.about("town").scenes()`).

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use anyhow::Context as _;
use cairn_api::v1;
use cairn_api::v1::access_service_client::AccessServiceClient;
use cairn_log::{Digest, NoteVerifier, OwnerKey, PublicKey};
use cairn_service::auth::{Daemon, sign};
use tonic::Status;
use tonic::body::Body;
use tonic::codegen::http::{HeaderValue, Request, Response};
use tonic::transport::Channel;

use cairn_service::store::access::unix_s;

/// Life of a signed token, seconds, where the daemon allows as much: it is used at once.
const LIFETIME_S: u64 = 120;

/// What calls bring along.
#[derive(Clone)]
pub enum Credential {
    /// Nothing.
    Nothing,
    /// The daemon's one token.
    Bearer(HeaderValue),
    /// A token of its own for every call.
    Account(Arc<Signer>),
}

/// Signs calls to one daemon.
pub struct Signer {
    key: OwnerKey,
    daemon: Daemon,
    lifetime_s: u64,
}

impl Credential {
    /// The daemon's one token.
    ///
    /// # Errors
    /// For a token that HTTP cannot carry.
    pub fn bearer(secret: &str) -> anyhow::Result<Self> {
        let mut value: HeaderValue = format!("Bearer {secret}").parse()?;
        value.set_sensitive(true);
        Ok(Self::Bearer(value))
    }

    /// Asks the daemon at the end of `channel` who it is, and signs for that one with `key`. Where its vkey is
    /// `pinned`, the daemon must be the one.
    ///
    /// # Errors
    /// For a daemon that is another than the pinned one, or asks for another credential.
    pub async fn account(key: OwnerKey, channel: &Channel, pinned: Option<&NoteVerifier>) -> anyhow::Result<Self> {
        let request = v1::AboutRequest {};
        let about = AccessServiceClient::new(channel.clone()).about(request).await?.into_inner();
        match about.mode() {
            v1::AccessMode::Accounts => {}
            v1::AccessMode::Token => {
                anyhow::bail!("the daemon knows no accounts (access.mode = \"token\"); bring its token: --token-file")
            }
            v1::AccessMode::Open | v1::AccessMode::Unspecified => return Ok(Self::Nothing),
        }
        let registry: [u8; 32] =
            about.registry_key.as_ref().try_into().context("the daemon's registry key is not 32 bytes")?;
        let registry = PublicKey::from_bytes(&registry)?;
        if let Some(pinned) = pinned {
            anyhow::ensure!(
                pinned.name() == about.origin && *pinned.key() == registry,
                "this daemon is {} with registry key {registry}, and the pinned one (--daemon-vkey) is {} with {}",
                about.origin,
                pinned.name(),
                pinned.key()
            );
        }
        let run = about.run.as_ref().try_into().context("the daemon's run is not 16 bytes")?;
        let registry: Digest = registry.id();
        let daemon = Daemon { origin: about.origin, registry, run };
        Ok(Self::Account(Arc::new(Signer { key, daemon, lifetime_s: LIFETIME_S.min(about.token_lifetime_s) })))
    }

    /// What a call of `method` about `scene` brings as its `authorization`.
    fn value(&self, method: &str, scene: &str) -> Result<Option<HeaderValue>, Status> {
        match self {
            Self::Nothing => Ok(None),
            Self::Bearer(value) => Ok(Some(value.clone())),
            Self::Account(signer) => {
                let token = sign(&signer.key, &signer.daemon, method, scene, unix_s(), signer.lifetime_s)
                    .map_err(|e| Status::invalid_argument(e.to_string()))?;
                let mut value = HeaderValue::try_from(format!("Cairn {token}"))
                    .map_err(|e| Status::internal(format!("the token is no header: {e}")))?;
                value.set_sensitive(true);
                Ok(Some(value))
            }
        }
    }
}

/// A channel whose calls say who calls.
#[derive(Clone)]
pub struct Speaking {
    channel: Channel,
    credential: Credential,
    scene: Arc<str>,
}

impl Speaking {
    /// Calls over `channel` about `scene` (empty: about none).
    pub fn new(channel: Channel, credential: Credential, scene: &str) -> Self {
        Self { channel, credential, scene: scene.into() }
    }
}

type BoxError = Box<dyn std::error::Error + Send + Sync>;

impl tower::Service<Request<Body>> for Speaking {
    type Response = Response<Body>;
    type Error = BoxError;
    type Future = Pin<Box<dyn Future<Output = Result<Self::Response, BoxError>> + Send>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), BoxError>> {
        tower::Service::poll_ready(&mut self.channel, context).map_err(Into::into)
    }

    fn call(&mut self, mut request: Request<Body>) -> Self::Future {
        match self.credential.value(request.uri().path(), &self.scene) {
            Ok(Some(value)) => drop(request.headers_mut().insert("authorization", value)),
            Ok(None) => {}
            Err(status) => return Box::pin(std::future::ready(Err(status.into()))),
        }
        let answer = tower::Service::call(&mut self.channel, request);
        Box::pin(async move { answer.await.map_err(Into::into) })
    }
}
