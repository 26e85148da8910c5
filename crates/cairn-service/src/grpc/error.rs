//! Why the services do not start, or stop early.

use std::net::SocketAddr;
use std::path::PathBuf;

use cairn_durable::DurableError;
use thiserror::Error;

use crate::auth::AccessError;
use crate::error::EngineError;

/// Why the services do not start, or stop early.
#[derive(Debug, Error)]
pub enum ServeError {
    /// An address cannot be listened at.
    #[error(
        "cannot listen at {address}: {source}; set {setting} in the file of --config to another address (port 0 takes a \
         free one)"
    )]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The setting that names it.
        setting: &'static str,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file of TLS, or all of them together.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// The data folder, or what lies in it.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// The system has no random bytes to tell this run from others.
    #[error(transparent)]
    Access(#[from] AccessError),
    /// The connection.
    #[error(transparent)]
    Transport(#[from] tonic::transport::Error),
    /// The description of the services, for reflection.
    #[error(transparent)]
    Reflection(#[from] tonic_reflection::server::Error),
    /// The operating system.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// A thread of the daemon ended early.
    #[error(transparent)]
    Thread(#[from] tokio::task::JoinError),
}

/// Why TLS does not start.
#[derive(Debug, Error)]
pub enum TlsError {
    /// A file cannot be read, or is too large.
    #[error("a file of TLS is not read: {0}; check its path, its permissions and that it is a PEM file")]
    Read(#[from] DurableError),
    /// A file holds something else.
    #[error("the TLS file {} holds no PEM section {kind}; give a file with `-----BEGIN {kind}-----`", path.display())]
    NoSection {
        /// The file.
        path: PathBuf,
        /// What should be in it.
        kind: String,
    },
    /// The files do not fit together.
    #[error(
        "TLS does not start with server.tls.certificate {} and server.tls.key {}{}: {why}; they must be a certificate and its own private \
         key, in PEM",
        certificate.display(), key.display(),
        client_ca.as_ref().map_or(String::new(), |c| format!(" and server.tls.client_ca {}", c.display())),
    )]
    Refused {
        /// The certificate's file.
        certificate: PathBuf,
        /// The key's file.
        key: PathBuf,
        /// The file of those who vouch for clients.
        client_ca: Option<PathBuf>,
        /// What the library said.
        why: String,
    },
}
