//! What an audit is given: an envelope, and whatever else is in hand.

use std::{fs::File, io, path::Path};

use cairn_log::format::{
    Digest, NoteVerifier, Policy,
    record::{SignalFiles, hidden_signal_commitment, photographs_root},
};

use crate::bounded::read;

/// A file that cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{path}: cannot be read: {source}")]
pub struct EvidenceError {
    /// The file.
    pub path: String,
    /// The operating system's answer.
    pub source: io::Error,
}

/// Largest envelope or proof file that is read, in bytes; both are a few kilobytes.
const MAX_BUNDLE_FILE: usize = 1 << 20;

/// An offline bundle: two files side by side, `<name>.dsse.json` and `<name>.tlog-proof`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Bundle {
    /// The envelope's JSON.
    pub envelope: Vec<u8>,
    /// The proof's text; not UTF-8 becomes U+FFFD, which no check lets pass.
    pub proof: String,
}

impl Bundle {
    /// Ending of the envelope's file.
    pub const ENVELOPE: &str = "dsse.json";
    /// Ending of the proof's file.
    pub const PROOF: &str = "tlog-proof";

    /// Reads the two files; `path` may name either, or both by what comes before the ending.
    ///
    /// # Errors
    /// [`EvidenceError`] names the file that is missing or too large.
    pub fn read(path: &Path) -> Result<Self, EvidenceError> {
        let text = path.to_string_lossy();
        let stem = [Self::ENVELOPE, Self::PROOF]
            .iter()
            .find_map(|ending| text.strip_suffix(ending)?.strip_suffix('.'))
            .unwrap_or(&text);
        let envelope = read_small(&format!("{stem}.{}", Self::ENVELOPE))?;
        let proof = String::from_utf8_lossy(&read_small(&format!("{stem}.{}", Self::PROOF))?).into_owned();
        Ok(Self { envelope, proof })
    }

    /// The evidence that the bundle is, to which files and a pinned key may be added.
    pub fn evidence(&self) -> Evidence<'_> {
        Evidence { envelope: &self.envelope, proof: Some(&self.proof), ..Evidence::default() }
    }
}

fn read_small(path: &str) -> Result<Vec<u8>, EvidenceError> {
    let failed = |kind, cause: String| EvidenceError { path: path.to_owned(), source: io::Error::new(kind, cause) };
    match read(Path::new(path), MAX_BUNDLE_FILE) {
        Ok(Some(bytes)) => Ok(bytes),
        Ok(None) => Err(failed(io::ErrorKind::NotFound, "no such file".into())),
        Err(cause) => Err(failed(io::ErrorKind::Other, cause)),
    }
}

/// A file to compare with the record, by its digest.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FileInHand {
    /// Its name in the report.
    pub place: String,
    /// SHA-256 of its bytes.
    pub digest: Digest,
}

/// A later record of the log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordInHand {
    /// Its index in the log.
    pub index: u64,
    /// Its envelope's JSON.
    pub envelope: Vec<u8>,
}

/// What is known of the log: all its revocations, rotations and disputes below a size, and what replaces others. That
/// these are all is the word of whoever made the view.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct LogView {
    /// Records below this size were looked at.
    pub size: u64,
    /// Those that may concern others; further kinds do no harm.
    pub records: Vec<RecordInHand>,
}

/// Everything in hand. Only the envelope is needed; what is absent is reported as unchecked, never as passed.
#[derive(Debug, Clone, Default)]
pub struct Evidence<'a> {
    /// The envelope's JSON.
    pub envelope: &'a [u8],
    /// The log's verifier key (vkey), obtained from elsewhere. Without it nothing is trusted.
    pub pinned: Option<&'a NoteVerifier>,
    /// Whose cosignatures the checkpoint must carry. A policy is a demand: what does not meet it is invalid.
    pub policy: Option<&'a Policy>,
    /// The text of the record's `.tlog-proof`: index, inclusion proof and checkpoint.
    pub proof: Option<&'a str>,
    /// The marked field's file.
    pub marked_field: Option<FileInHand>,
    /// The base field's file.
    pub base_field: Option<FileInHand>,
    /// The base field's share table.
    pub share_table: Option<FileInHand>,
    /// The detector's file.
    pub detector: Option<FileInHand>,
    /// The hidden signal and its salt.
    pub hidden_signal: Option<FileInHand>,
    /// The record's photographs.
    pub photographs: Option<FileInHand>,
    /// The training configuration's file.
    pub training_configuration: Option<FileInHand>,
    /// What came later.
    pub log: Option<&'a LogView>,
}

impl FileInHand {
    /// A file whose bytes are in memory.
    pub fn of(place: impl Into<String>, bytes: &[u8]) -> Self {
        Self { place: place.into(), digest: Digest::of(bytes) }
    }

    /// A file on disk, read in pieces.
    ///
    /// # Errors
    /// [`EvidenceError`] names the file.
    pub fn read(path: &Path) -> Result<Self, EvidenceError> {
        let place = path.display().to_string();
        let failed = |source| EvidenceError { path: place.clone(), source };
        let (digest, _) = File::open(path).and_then(|mut file| Digest::of_all(&mut file)).map_err(failed)?;
        Ok(Self { digest, place })
    }

    /// A hidden signal, by the commitment to its files under the salt that the owner gave out.
    pub fn hidden_signal(place: impl Into<String>, salt: &Digest, files: &SignalFiles<'_>) -> Self {
        Self { place: place.into(), digest: hidden_signal_commitment(salt, files) }
    }

    /// Photographs, in any order, by the root over their digests.
    pub fn photographs(place: &str, digests: &[Digest]) -> Self {
        let place = format!("{place} ({} photographs)", digests.len());
        Self { place, digest: photographs_root(digests) }
    }
}
