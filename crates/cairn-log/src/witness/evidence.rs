//! Evidence of a log that contradicts itself: both notes, in one file each time.
//!
//! Two kinds. `fork`: two checkpoints of one size with different roots, both signed by the log, which proves by
//! itself that it showed two histories. `unproven`: a signed checkpoint whose consistency proof failed; the log may have forked,
//! or whoever sent it made the proof up, so it is a lead and no proof. Since anybody can send a log's checkpoint with
//! a bad proof, the same checkpoint is kept once, and the number of files is limited.

use std::{
    collections::BTreeSet,
    io,
    sync::{Mutex, PoisonError},
};

use crate::format::digest::Digest;
use cairn_durable::{DurableError, Files};
use serde::Serialize;

/// Folder of the evidence of logs that contradict themselves.
pub(crate) const EVIDENCE: &str = "evidence";

const FORMAT_VERSION: u32 = 1;

/// Most files of a kind; what comes later adds nothing.
const MAX_FILES: usize = 1000;

/// How a checkpoint contradicts what was cosigned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Kind {
    Fork,
    Unproven,
}

/// One contradiction. Notes carry the log's verified signatures.
#[derive(Debug, Serialize)]
pub(crate) struct Contradiction<'a> {
    pub(crate) kind: Kind,
    pub(crate) origin: &'a str,
    /// When it was noticed, Unix seconds.
    pub(crate) time: u64,
    /// What was cosigned last.
    pub(crate) cosigned: &'a str,
    /// What came.
    pub(crate) submitted: &'a str,
    /// The old size that came with it.
    pub(crate) old: u64,
    /// The proof that came with it, base64.
    pub(crate) proof: Vec<String>,
}

#[derive(Serialize)]
struct File<'a> {
    format_version: u32,
    #[serde(flatten)]
    contradiction: &'a Contradiction<'a>,
}

/// The files that are there.
#[derive(Debug)]
pub(crate) struct Evidence {
    files: Mutex<BTreeSet<String>>,
}

impl Evidence {
    pub(crate) fn open(storage: &Files) -> Result<Self, DurableError> {
        let files = storage.list(EVIDENCE)?.into_iter().filter(|name| name.ends_with(".json")).collect();
        Ok(Self { files: Mutex::new(files) })
    }

    /// Keeps a contradiction; `text` is the submitted checkpoint's. Gives the file's name where it is new.
    pub(crate) fn keep(
        &self,
        storage: &Files,
        text: &str,
        contradiction: &Contradiction<'_>,
    ) -> io::Result<Option<String>> {
        let prefix = match contradiction.kind {
            Kind::Fork => "fork-",
            Kind::Unproven => "unproven-",
        };
        let name = format!("{prefix}{}.json", Digest::of(text));
        let mut files = self.files.lock().unwrap_or_else(PoisonError::into_inner);
        let kept = files.iter().filter(|file| file.starts_with(prefix)).count();
        if files.contains(&name) || kept >= MAX_FILES {
            return Ok(None);
        }
        let file = File { format_version: FORMAT_VERSION, contradiction };
        let mut json = serde_json::to_vec_pretty(&file).map_err(io::Error::other)?;
        json.push(b'\n');
        storage.replace(&[(format!("{EVIDENCE}/{name}"), json)])?;
        files.insert(name.clone());
        Ok(Some(name))
    }
}
