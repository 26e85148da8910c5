//! What a witness remembers of a log: the newest checkpoint that it cosigned, as one JSON file.
//!
//! The file holds the whole note, with the log's signatures and the cosignature: it is at once the memory, what
//! monitors are given, and one side of the evidence if the log contradicts it. Size and root stand beside it for
//! people; they must agree with it.

use crate::format::{checkpoint::Checkpoint, cosignature::WitnessVerifier, digest::Digest};
use serde::{Deserialize, Serialize};

/// The version of the file that this release writes and reads.
const FORMAT_VERSION: u32 = 1;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Stored {
    format_version: u32,
    origin: String,
    size: u64,
    root: Digest,
    checkpoint: String,
}

/// Only the version, whatever else is there.
#[derive(Deserialize)]
struct Version {
    format_version: u32,
}

/// The newest checkpoint of a log that was cosigned, or was about to be.
#[derive(Debug, Clone)]
pub(crate) struct Remembered {
    pub(crate) checkpoint: Checkpoint,
    /// When, Unix seconds.
    pub(crate) time: u64,
    /// The log's verified signatures and the cosignature on it.
    pub(crate) note: String,
}

/// Folder of the files that say what was cosigned last, one a log.
pub(crate) const LOGS: &str = "logs";

/// The file of a log.
pub(crate) fn path_of(origin: &str) -> String {
    format!("{LOGS}/{}.json", Digest::of(origin))
}

impl Remembered {
    pub(crate) fn to_json(&self) -> Vec<u8> {
        let stored = Stored {
            format_version: FORMAT_VERSION,
            origin: self.checkpoint.origin.clone(),
            size: self.checkpoint.size,
            root: self.checkpoint.root,
            checkpoint: self.note.clone(),
        };
        // A struct of strings and numbers always serialises.
        let mut json = serde_json::to_vec_pretty(&stored).unwrap_or_default();
        json.push(b'\n');
        json
    }

    /// Reads the file about `origin`, as it was written under `witness`'s key. Says what is wrong with it.
    pub(crate) fn from_json(json: &[u8], origin: &str, witness: &WitnessVerifier) -> Result<Self, String> {
        let version: Version = serde_json::from_slice(json).map_err(|e| e.to_string())?;
        if version.format_version != FORMAT_VERSION {
            return Err(format!("format version {}, this release reads {FORMAT_VERSION}", version.format_version));
        }
        let stored: Stored = serde_json::from_slice(json).map_err(|e| e.to_string())?;
        let (note, checkpoint) = Checkpoint::read(&stored.checkpoint).map_err(|e| e.to_string())?;
        let beside = (stored.origin.as_str(), stored.size, stored.root);
        let inside = (checkpoint.origin.as_str(), checkpoint.size, checkpoint.root);
        if beside != inside || stored.origin != origin {
            return Err(format!("it says {beside:?}, its checkpoint {inside:?}, expected is log {origin:?}"));
        }
        let cosignature = witness.find(&note).map_err(|e| e.to_string())?.ok_or_else(|| {
            format!("its checkpoint is not cosigned by {witness}; give a witness of another name or key its own folder")
        })?;
        Ok(Self { checkpoint, time: cosignature.time, note: stored.checkpoint })
    }
}
