//! A record that was read once: its envelope, what that says, and the leaf that stands for it in the log.
//!
//! Bytes become a [`SignedRecord`] at the edge, where the owner's signature is verified. Code behind the edge takes the
//! type and parses nothing again.

use crate::format::{
    digest::Digest,
    dsse::Envelope,
    leaf::Leaf,
    record::{OwnerRecord, RecordError},
};

/// An envelope that was parsed, with its record; the owner's signature holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SignedRecord {
    envelope: Envelope,
    record: OwnerRecord,
    leaf: Leaf,
}

impl SignedRecord {
    /// Reads an envelope's JSON, its record, and verifies the owner's signature.
    ///
    /// # Errors
    /// [`RecordError`], also for an envelope that is none.
    pub fn parse(json: &[u8]) -> Result<Self, RecordError> {
        Self::open(Envelope::parse(json)?)
    }

    /// As [`SignedRecord::parse`], of an envelope that was parsed before.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn open(envelope: Envelope) -> Result<Self, RecordError> {
        let (leaf, record) = Leaf::open(&envelope)?;
        Ok(Self { envelope, record, leaf })
    }

    /// The envelope with all its signatures; only the owner's is verified.
    pub const fn envelope(&self) -> &Envelope {
        &self.envelope
    }

    /// What the envelope says.
    pub const fn record(&self) -> &OwnerRecord {
        &self.record
    }

    /// The leaf that stands for it in a log, with the owner's signature.
    pub const fn leaf(&self) -> &Leaf {
        &self.leaf
    }

    /// SHA-256 of the envelope's PAE: what names the record.
    pub const fn digest(&self) -> Digest {
        self.leaf.record
    }

    /// Envelope, record and leaf, taken apart.
    pub fn into_parts(self) -> (Envelope, OwnerRecord, Leaf) {
        (self.envelope, self.record, self.leaf)
    }
}
