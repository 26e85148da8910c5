//! Checkpoints (C2SP tlog-checkpoint): a log's size and root, as a signed note.
//!
//! ```text
//! <origin>
//! <size>
//! <base64 root>
//! [further lines, kept as they are]
//! ```

use crate::format::{
    digest::{Digest, clip, decimal},
    key::OwnerKey,
    note::{Note, NoteError, NoteVerifier},
};

/// A log's state at one size.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Checkpoint {
    /// The log's name.
    pub origin: String,
    /// How many leaves.
    pub size: u64,
    /// Root over them.
    pub root: Digest,
    /// Extension lines behind the root, without newlines.
    pub extensions: Vec<String>,
}

/// Why a checkpoint is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CheckpointError {
    /// The note around it.
    #[error(transparent)]
    Note(#[from] NoteError),
    /// A line of the text.
    #[error("checkpoint, line {line}: {what}, got {got:?}")]
    Line {
        /// Which line, from 1.
        line: usize,
        /// What is expected.
        what: &'static str,
        /// The start of the line.
        got: String,
    },
    /// Another log's checkpoint.
    #[error("checkpoint of log {got:?}, expected {expected:?}")]
    Origin {
        /// The log that the verifier follows.
        expected: String,
        /// The log that the checkpoint names.
        got: String,
    },
}

impl Checkpoint {
    /// A checkpoint without extension lines.
    pub fn new(origin: impl Into<String>, size: u64, root: Digest) -> Self {
        Self { origin: origin.into(), size, root, extensions: Vec::new() }
    }

    /// The text that is signed, with its final newline.
    pub fn to_text(&self) -> String {
        let mut text = format!("{}\n{}\n{}\n", self.origin, self.size, self.root.to_base64());
        for line in &self.extensions {
            text.push_str(line);
            text.push('\n');
        }
        text
    }

    /// Reads the text of a note.
    ///
    /// # Errors
    /// [`CheckpointError::Line`] names the line: an empty origin, a size that is not plain decimal without leading
    /// zeros, a root that is not base64 of 32 bytes, an empty extension line, no final newline.
    pub fn parse_text(text: &str) -> Result<Self, CheckpointError> {
        let refuse =
            |line, what, got: Option<&str>| CheckpointError::Line { line, what, got: clip(got.unwrap_or_default()) };
        let body = text.strip_suffix('\n').ok_or_else(|| refuse(1, "a final newline", Some(text)))?;
        let mut lines = body.split('\n');
        let origin = lines.next().filter(|l| !l.is_empty()).ok_or_else(|| refuse(1, "the log's origin", None))?;
        let size_line = lines.next();
        let size = (size_line.and_then(decimal))
            .ok_or_else(|| refuse(2, "a size in decimal without leading zeros", size_line))?;
        let root_line = lines.next();
        let root = (root_line.and_then(|l| Digest::from_base64(l).ok()))
            .ok_or_else(|| refuse(3, "a root of 32 bytes in base64", root_line))?;
        // Refused where it stands: a text of nothing but newlines would fill a list before anybody looked at it.
        let extensions = (4..).zip(lines).map(|(at, line)| {
            let what = "an extension line that is not empty";
            if line.is_empty() { Err(refuse(at, what, None)) } else { Ok(line.to_owned()) }
        });
        let extensions = extensions.collect::<Result<_, _>>()?;
        Ok(Self { origin: origin.to_owned(), size, root, extensions })
    }

    /// Reads a note and the checkpoint in it. Verifies nothing.
    ///
    /// # Errors
    /// [`CheckpointError::Note`], [`CheckpointError::Line`].
    pub fn read(note: &str) -> Result<(Note, Self), CheckpointError> {
        let note = Note::parse(note)?;
        let checkpoint = Self::parse_text(&note.text)?;
        Ok((note, checkpoint))
    }

    /// Signs the checkpoint under the origin's name.
    ///
    /// # Errors
    /// [`NoteError`] where the origin is no key name.
    pub fn sign(&self, key: &OwnerKey) -> Result<Note, NoteError> {
        let mut note = Note::new(self.to_text())?;
        note.sign(&self.origin, key)?;
        Ok(note)
    }

    /// Verifies a signed checkpoint of the log that `log` names, under its key.
    ///
    /// # Errors
    /// [`CheckpointError`]; the origin inside the text must be the name that the key belongs to.
    pub fn verify(note: &str, log: &NoteVerifier) -> Result<Self, CheckpointError> {
        let (note, checkpoint) = Self::read(note)?;
        if checkpoint.origin != log.name() {
            return Err(CheckpointError::Origin { expected: log.name().to_owned(), got: clip(&checkpoint.origin) });
        }
        note.verify(std::slice::from_ref(log))?;
        Ok(checkpoint)
    }
}
