//! Files with a secret in them: readable by their owner alone, there whole or not at all.

use std::{
    fs,
    io::{self, Read as _},
    path::Path,
};

use zeroize::Zeroizing;

use super::KeyError;

/// A file with a key is some lines of text; more than this is something else.
pub(super) const LIMIT: u64 = 4096;

/// First line of a sealed key's file.
pub(super) const SEALED: &str = "-----BEGIN CAIRN SEALED KEY-----\n";

/// Reads a secret's file as text, refusing one that others may read.
///
/// `what` is what a wrong file is not, for the error.
pub(super) fn read(path: &Path, what: &'static str) -> Result<Zeroizing<String>, KeyError> {
    let failed = |source| KeyError::Io { path: path.into(), what: "read", source };
    let file = fs::File::open(path).map_err(failed)?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        let mode = file.metadata().map_err(failed)?.permissions().mode() & 0o777;
        if mode & 0o077 != 0 {
            return Err(KeyError::TooOpen { path: path.into(), mode });
        }
    }
    let not = |cause: String| KeyError::NotAKey { path: path.into(), what, cause };
    // As large as it can get: a vector that grows leaves copies behind. What the file says of its size is not asked, since
    // a pipe says nothing.
    let mut bytes = Zeroizing::new(Vec::with_capacity(LIMIT as usize + 1));
    file.take(LIMIT + 1).read_to_end(&mut bytes).map_err(failed)?;
    if bytes.len() as u64 > LIMIT {
        return Err(not(format!("more than {LIMIT} bytes")));
    }
    match String::from_utf8(std::mem::take(&mut *bytes)) {
        Ok(text) => Ok(Zeroizing::new(text)),
        Err(e) => {
            drop(Zeroizing::new(e.into_bytes()));
            Err(not("it is no text".into()))
        }
    }
}

/// What becomes of a file that is there already.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum There {
    /// It stays, and the write fails.
    Stays,
    /// It is replaced at one stroke.
    #[cfg(feature = "sealed-keys")]
    Goes,
}

/// Writes a secret's file, mode 600: written beside its place, flushed, then given its name, and the folder flushed.
pub(super) fn write(path: &Path, text: &str, there: There) -> Result<(), KeyError> {
    let written = match there {
        There::Stays => cairn_durable::create_secret(path, text.as_bytes()),
        #[cfg(feature = "sealed-keys")]
        There::Goes => cairn_durable::write_secret(path, text.as_bytes()),
    };
    written.map_err(|error| match error.into_cause() {
        e if e.kind() == io::ErrorKind::AlreadyExists => KeyError::Exists { path: path.into() },
        source => KeyError::Io { path: path.into(), what: "write", source },
    })
}
