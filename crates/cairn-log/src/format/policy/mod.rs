//! Trust policies (C2SP tlog-policy): which logs are known, which witnesses, and how many of them must have cosigned.
//!
//! ```text
//! log <vkey> [<url>]
//! witness <name> <vkey> [<url>]
//! group <name> any|all|<k> <member>...
//! quorum <name>|none
//! # a comment
//! ```
//!
//! A quorum also tells a time: a checkpoint, and all that is in its tree, existed when the quorum was complete. That is
//! the k-th smallest of its members' times for k of n, from the witnesses up through the groups. With fewer than k members
//! that lie about the time, it is not later than the truth allows.

mod parse;

use crate::format::{
    checkpoint::{Checkpoint, CheckpointError},
    cosignature::{CosignatureError, WitnessVerifier},
    digest::clip,
    note::{Note, NoteVerifier},
};

/// Largest policy that is read, in bytes: thousands of witnesses.
pub const MAX_POLICY_BYTES: usize = 256 << 10;

/// A log that a policy knows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PolicyLog {
    /// Its key; the name is its origin.
    pub verifier: NoteVerifier,
    /// Where it is reached.
    pub url: Option<String>,
}

/// A witness that a policy knows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PolicyWitness {
    /// What this policy calls it; octets that are not UTF-8 are replaced for display.
    pub name: String,
    /// Its key and its own name.
    pub verifier: WitnessVerifier,
    /// Where it is reached (tlog-witness: its submission prefix).
    pub url: Option<String>,
}

/// A checked policy.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Policy {
    logs: Vec<PolicyLog>,
    witnesses: Vec<PolicyWitness>,
    /// Each names only groups in front of it: no cycles.
    groups: Vec<Group>,
    quorum: Option<Member>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Group {
    threshold: usize,
    members: Vec<Member>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Member {
    Witness(usize),
    Group(usize),
}

/// Why a text is no policy.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PolicyError {
    /// Larger than [`MAX_POLICY_BYTES`].
    #[error("policy of {got} bytes, at most {MAX_POLICY_BYTES} are read")]
    TooLarge {
        /// Its size.
        got: usize,
    },
    /// A line that is wrong.
    #[error("policy, line {line}: {what}")]
    Line {
        /// Which line, from 1.
        line: usize,
        /// What is wrong, and what is allowed.
        what: String,
    },
    /// Nothing says what is enough.
    #[error("policy without a quorum line; end it with `quorum <name>`, or `quorum none` to ask for no witnesses")]
    NoQuorum,
}

/// Why a policy cannot judge a checkpoint.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PolicyCheckError {
    /// The policy does not list the log.
    #[error("the policy knows no log {origin:?} (it knows {known})")]
    UnknownLog {
        /// The checkpoint's origin.
        origin: String,
        /// The origins of the policy.
        known: String,
    },
    /// The note, the text in it, or the log's signature.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// A known witness's cosignature that does not hold: it condemns the note (signed-note, "Signatures").
    #[error(transparent)]
    Cosignature(#[from] CosignatureError),
}

/// What a policy says of a checkpoint that its log signed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PolicyVerdict {
    /// The checkpoint, its log's signature verified.
    pub checkpoint: Checkpoint,
    /// Who cosigned (the policy's names) and when (Unix seconds), in the policy's order.
    pub cosigned: Vec<(String, u64)>,
    /// The policy's witnesses that did not.
    pub missing: Vec<String>,
    /// Whether those who did are enough.
    pub quorum: Quorum,
}

/// Whether enough witnesses cosigned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quorum {
    /// `quorum none`: the policy asks for no witness.
    NotRequired,
    /// Enough did.
    Complete {
        /// When the quorum was complete, Unix seconds: nothing in the tree is later.
        not_later_than: u64,
    },
    /// Not enough did.
    Incomplete,
}

impl Quorum {
    /// Whether the policy is content: nothing asked for, or complete.
    pub fn holds(&self) -> bool {
        !matches!(self, Self::Incomplete)
    }

    /// Time bound, Unix seconds, where there is one.
    pub fn not_later_than(&self) -> Option<u64> {
        match self {
            Self::Complete { not_later_than } => Some(*not_later_than),
            Self::NotRequired | Self::Incomplete => None,
        }
    }
}

impl Policy {
    /// Reads a policy. A missing newline at the end is forgiven, as other readers do.
    ///
    /// # Errors
    /// [`PolicyError`] names the line: an unknown keyword, a vkey of the wrong type, a name that is not defined on a line before,
    /// or defined twice, or `none`, a member of two groups, two lines with one key, a threshold beyond the members, octets
    /// that the format excludes.
    pub fn parse(text: impl AsRef<[u8]>) -> Result<Self, PolicyError> {
        parse::parse(text.as_ref())
    }

    /// The logs, in the file's order.
    pub fn logs(&self) -> &[PolicyLog] {
        &self.logs
    }

    /// The witnesses, in the file's order.
    pub fn witnesses(&self) -> &[PolicyWitness] {
        &self.witnesses
    }

    /// Judges a signed checkpoint of one of the policy's logs.
    ///
    /// # Errors
    /// [`PolicyCheckError`]; too few cosignatures are no error but [`Quorum::Incomplete`].
    pub fn check(&self, note: &str) -> Result<PolicyVerdict, PolicyCheckError> {
        let logs: Vec<NoteVerifier> = self.logs.iter().map(|log| log.verifier.clone()).collect();
        self.check_under(note, &logs)
    }

    /// Judges a signed checkpoint of one of these logs, whatever logs the policy lists: for a caller that pins its log.
    ///
    /// # Errors
    /// As [`Policy::check`].
    pub fn check_under(&self, note: &str, logs: &[NoteVerifier]) -> Result<PolicyVerdict, PolicyCheckError> {
        let note = Note::parse(note).map_err(CheckpointError::from)?;
        let checkpoint = Checkpoint::parse_text(&note.text)?;
        let keys: Vec<NoteVerifier> = logs.iter().filter(|log| log.name() == checkpoint.origin).cloned().collect();
        if keys.is_empty() {
            let known = logs.iter().map(NoteVerifier::name).collect::<Vec<_>>();
            let known = if known.is_empty() { "none".into() } else { known.join(", ") };
            return Err(PolicyCheckError::UnknownLog { origin: clip(&checkpoint.origin), known });
        }
        note.verify(&keys).map_err(CheckpointError::from)?;
        let mut times = Vec::with_capacity(self.witnesses.len());
        for witness in &self.witnesses {
            times.push(witness.verifier.find(&note)?.map(|cosignature| cosignature.time));
        }
        let named = || self.witnesses.iter().map(|witness| witness.name.clone()).zip(&times);
        Ok(PolicyVerdict {
            checkpoint,
            cosigned: named().filter_map(|(name, time)| Some((name, (*time)?))).collect(),
            missing: named().filter(|(_, time)| time.is_none()).map(|(name, _)| name).collect(),
            quorum: self.quorum(&times),
        })
    }

    /// `times[i]`: when witness i cosigned, if it did.
    fn quorum(&self, times: &[Option<u64>]) -> Quorum {
        let Some(quorum) = self.quorum else { return Quorum::NotRequired };
        let mut of_groups: Vec<Option<u64>> = Vec::with_capacity(self.groups.len());
        let at = |member: Member, of_groups: &[Option<u64>]| match member {
            Member::Witness(i) => times[i],
            Member::Group(i) => of_groups[i],
        };
        for group in &self.groups {
            let mut reached: Vec<u64> = group.members.iter().filter_map(|m| at(*m, &of_groups)).collect();
            reached.sort_unstable();
            of_groups.push(reached.get(group.threshold - 1).copied());
        }
        at(quorum, &of_groups).map_or(Quorum::Incomplete, |not_later_than| Quorum::Complete { not_later_than })
    }
}

#[cfg(test)]
mod tests;
