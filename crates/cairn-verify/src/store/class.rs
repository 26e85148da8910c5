//! Classes of faults, and the exit code that each has.

use serde::Serialize;

use crate::code::Code;

/// What is at fault. The smallest number is the exit code of an audit that finds several: a signature or a root that
/// does not hold makes everything behind it doubtful, so the class to look at first comes first. (A mask would not
/// fit: exit codes have eight bits, and 1 and 2 are taken.) The report names all classes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum Class {
    /// The published checkpoint, its signature or its witnesses.
    Checkpoint = 10,
    /// The log's entries and tiles, or the root that they lead to.
    Log = 11,
    /// Envelopes and the records in them.
    Records = 12,
    /// The verifiable map and its signed roots.
    Map = 13,
    /// The registry's private working state, and the daemon's.
    Working = 14,
    /// Scenes, photographs, models and what is rendered from them.
    Models = 15,
}

impl Class {
    /// All classes, by exit code.
    pub const ALL: [Self; 6] = [Self::Checkpoint, Self::Log, Self::Records, Self::Map, Self::Working, Self::Models];

    /// The exit code.
    pub const fn exit_code(self) -> u8 {
        self as u8
    }

    /// The class of a failed check in a store; none for checks that belong to no store.
    pub fn of(code: Code) -> Option<Self> {
        Some(match code {
            Code::StoreCheckpointMissing
            | Code::StoreCheckpointMalformed
            | Code::StoreCheckpointSignature
            | Code::PolicyQuorumMissing
            | Code::PolicySignatureInvalid => Self::Checkpoint,
            Code::StoreEntry
            | Code::StoreTileMissing
            | Code::StoreTileMismatch
            | Code::StoreRoot
            | Code::StoreFileUnknown => Self::Log,
            Code::StoreEnvelopeFile
            | Code::StoreEnvelope
            | Code::StoreRecordSignature
            | Code::StoreRecordRule
            | Code::StoreRecordSeen => Self::Records,
            Code::StoreMapLeaf | Code::StoreMapRoot => Self::Map,
            Code::WorkingSeal | Code::WorkingMismatch | Code::StateSeal | Code::StateMismatch => Self::Working,
            Code::ManifestMalformed | Code::FileMismatch | Code::FileUnknown | Code::RenderFailed => Self::Models,
            _ => return None,
        })
    }
}
