//! TLS by rustls: the files of `[server.tls]`, read once, each named where it is no good.

use std::path::Path;

use cairn_durable::read_limited;
use tonic::transport::{Certificate, Identity, Server, ServerTlsConfig};

use super::error::TlsError;
use crate::config::TlsFiles;

/// Largest PEM file that is read, bytes.
const MAX_PEM_BYTES: u64 = 1 << 20;

/// Reads a PEM file that must hold a section of this kind (`CERTIFICATE`, `PRIVATE KEY`).
///
/// # Errors
/// With the file's name, and what should be in it.
pub fn pem(path: &Path, kind: &str) -> Result<Vec<u8>, TlsError> {
    let bytes = read_limited(path, MAX_PEM_BYTES)?;
    // `RSA PRIVATE KEY` and `EC PRIVATE KEY` end the same way.
    let there = String::from_utf8_lossy(&bytes)
        .lines()
        .any(|l| l.starts_with("-----BEGIN ") && l.trim_end().ends_with(&format!("{kind}-----")));
    if !there {
        return Err(TlsError::NoSection { path: path.to_path_buf(), kind: kind.to_owned() });
    }
    Ok(bytes)
}

/// `server` behind TLS where there are files for it.
///
/// # Errors
/// For a file that cannot be read or is no such thing, and a key that is not the certificate's.
pub fn secured(server: Server, files: Option<&TlsFiles>) -> Result<Server, TlsError> {
    let Some(TlsFiles { certificate, key, client_ca }) = files else { return Ok(server) };
    let identity = Identity::from_pem(pem(certificate, "CERTIFICATE")?, pem(key, "PRIVATE KEY")?);
    let mut config = ServerTlsConfig::new().identity(identity);
    if let Some(path) = client_ca {
        config = config.client_ca_root(Certificate::from_pem(pem(path, "CERTIFICATE")?));
    }
    server.tls_config(config).map_err(|e| TlsError::Refused {
        certificate: certificate.clone(),
        key: key.clone(),
        client_ca: client_ca.clone(),
        why: std::error::Error::source(&e).map_or_else(|| e.to_string(), ToString::to_string),
    })
}
