//! TLS by rustls: the files of `[server.tls]`, read once, each named where it is no good.

use std::path::Path;

use anyhow::Context as _;
use tonic::transport::{Certificate, Identity, Server, ServerTlsConfig};

use crate::config::TlsFiles;

/// Largest PEM file that is read, bytes.
const MAX_PEM_BYTES: u64 = 1 << 20;

/// Reads a PEM file that must hold a section of this kind (`CERTIFICATE`, `PRIVATE KEY`).
///
/// # Errors
/// With the file's name, and what should be in it.
pub fn pem(path: &Path, kind: &str) -> anyhow::Result<Vec<u8>> {
    let name = path.display();
    let length =
        std::fs::metadata(path).with_context(|| format!("cannot read the TLS file {name}; check its path"))?.len();
    anyhow::ensure!(
        length <= MAX_PEM_BYTES,
        "the TLS file {name} has {length} bytes; at most {MAX_PEM_BYTES} are read"
    );
    let bytes =
        std::fs::read(path).with_context(|| format!("cannot read the TLS file {name}; check its permissions"))?;
    // `RSA PRIVATE KEY` and `EC PRIVATE KEY` end the same way.
    let there = String::from_utf8_lossy(&bytes)
        .lines()
        .any(|l| l.starts_with("-----BEGIN ") && l.trim_end().ends_with(&format!("{kind}-----")));
    anyhow::ensure!(
        there,
        "the TLS file {name} holds no PEM section {kind}; give a file with `-----BEGIN {kind}-----`"
    );
    Ok(bytes)
}

/// `server` behind TLS where there are files for it.
///
/// # Errors
/// For a file that cannot be read or is no such thing, and a key that is not the certificate's.
pub fn secured(server: Server, files: Option<&TlsFiles>) -> anyhow::Result<Server> {
    let Some(TlsFiles { certificate, key, client_ca }) = files else { return Ok(server) };
    let identity = Identity::from_pem(pem(certificate, "CERTIFICATE")?, pem(key, "PRIVATE KEY")?);
    let mut config = ServerTlsConfig::new().identity(identity);
    if let Some(path) = client_ca {
        config = config.client_ca_root(Certificate::from_pem(pem(path, "CERTIFICATE")?));
    }
    let server = server.tls_config(config).map_err(|e| {
        let why = std::error::Error::source(&e).map_or_else(|| e.to_string(), ToString::to_string);
        anyhow::anyhow!(
            "TLS does not start with server.tls.certificate {} and server.tls.key {}{}: {why}; they must be a \
             certificate and its own private key, in PEM",
            certificate.display(),
            key.display(),
            client_ca.as_ref().map_or(String::new(), |c| format!(" and server.tls.client_ca {}", c.display())),
        )
    })?;
    Ok(server)
}
