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

use std::collections::{BTreeMap, HashSet};

use crate::format::{
    checkpoint::{Checkpoint, CheckpointError},
    cosignature::{CosignatureError, WitnessVerifier},
    digest::clip,
    key::{PublicKey, is_secret},
    note::{NoteError, NoteVerifier},
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
    /// A secret, where a policy belongs.
    #[error("this is a private key, not a policy; a policy has lines `log`, `witness` and `quorum`")]
    PrivateKey,
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
        parse(text.as_ref())
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
        let (note, checkpoint) = Checkpoint::read(note)?;
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

// Reading, line by line (C2SP tlog-policy, "Policy file syntax and structure"). Names are octets, not characters: two
// spellings that look alike are two names.

/// Longest error, characters: a line may be long.
const MAX_ERROR: usize = 400;

/// What the lines so far defined.
#[derive(Default)]
struct Reader {
    logs: Vec<PolicyLog>,
    witnesses: Vec<PolicyWitness>,
    groups: Vec<Group>,
    names: BTreeMap<Vec<u8>, Named>,
    log_keys: HashSet<PublicKey>,
    witness_keys: HashSet<PublicKey>,
    quorum: Option<Option<Member>>,
}

struct Named {
    member: Member,
    /// Whether a group lists it: it may do so once, in all groups together.
    listed: bool,
}

fn parse(text: &[u8]) -> Result<Policy, PolicyError> {
    if text.len() > MAX_POLICY_BYTES {
        return Err(PolicyError::TooLarge { got: text.len() });
    }
    if std::str::from_utf8(text).is_ok_and(is_secret) {
        return Err(PolicyError::PrivateKey);
    }
    let mut reader = Reader::default();
    for (number, line) in (1..).zip(text.split(|b| *b == b'\n')) {
        let refused = |what: String| PolicyError::Line { line: number, what: what.chars().take(MAX_ERROR).collect() };
        reader.line(line).map_err(refused)?;
    }
    let quorum = reader.quorum.ok_or(PolicyError::NoQuorum)?;
    Ok(Policy { logs: reader.logs, witnesses: reader.witnesses, groups: reader.groups, quorum })
}

impl Reader {
    fn line(&mut self, line: &[u8]) -> Result<(), String> {
        if let Some(octet) = line.iter().find(|b| matches!(b, 0..=8 | 10..=31 | 127)) {
            return Err(format!("octet 0x{octet:02x}; of the control characters only tab and newline are allowed"));
        }
        let words: Vec<&[u8]> = line.split(|b| matches!(b, b' ' | b'\t')).filter(|word| !word.is_empty()).collect();
        match words.as_slice() {
            [] => Ok(()),
            [first, ..] if first.starts_with(b"#") => Ok(()),
            [b"log", vkey, url @ ..] if url.len() <= 1 => self.log(vkey, url.first().copied()),
            [b"witness", name, vkey, url @ ..] if url.len() <= 1 => self.witness(name, vkey, url.first().copied()),
            [b"group", name, threshold, members @ ..] if !members.is_empty() => self.group(name, threshold, members),
            [b"quorum", name] => self.quorum(name),
            [b"log", ..] => Err("expected `log <vkey> [<url>]`".into()),
            [b"witness", ..] => Err("expected `witness <name> <vkey> [<url>]`".into()),
            [b"group", ..] => Err("expected `group <name> any|all|<k> <member>...` with at least one member".into()),
            [b"quorum", ..] => Err("expected `quorum <name>` or `quorum none`".into()),
            // Not quoted: where the file is no policy it may be a secret.
            _ => Err("its first word is no keyword; allowed are log, witness, group, quorum and # comments".into()),
        }
    }

    fn log(&mut self, vkey: &[u8], url: Option<&[u8]>) -> Result<(), String> {
        let verifier: NoteVerifier = read_vkey(vkey)?;
        if !self.log_keys.insert(*verifier.key()) {
            return Err(format!("another log line has this public key already ({})", verifier.key()));
        }
        self.logs.push(PolicyLog { verifier, url: url.map(shown) });
        Ok(())
    }

    fn witness(&mut self, name: &[u8], vkey: &[u8], url: Option<&[u8]>) -> Result<(), String> {
        let verifier: WitnessVerifier = read_vkey(vkey)?;
        if !self.witness_keys.insert(*verifier.key()) {
            return Err(format!("another witness line has this public key already ({})", verifier.key()));
        }
        self.define(name, Member::Witness(self.witnesses.len()))?;
        self.witnesses.push(PolicyWitness { name: shown(name), verifier, url: url.map(shown) });
        Ok(())
    }

    fn group(&mut self, name: &[u8], threshold: &[u8], members: &[&[u8]]) -> Result<(), String> {
        let threshold = read_threshold(threshold, members.len())?;
        let mut found = Vec::with_capacity(members.len());
        for member in members {
            let named = self.names.get_mut(*member).ok_or_else(|| undefined(member))?;
            if std::mem::replace(&mut named.listed, true) {
                return Err(format!(
                    "{:?} is a member of a group already; each name may be listed once",
                    shown(member)
                ));
            }
            found.push(named.member);
        }
        self.define(name, Member::Group(self.groups.len()))?;
        self.groups.push(Group { threshold, members: found });
        Ok(())
    }

    fn quorum(&mut self, name: &[u8]) -> Result<(), String> {
        if self.quorum.is_some() {
            return Err("a second quorum line; exactly one is allowed".into());
        }
        let member = match name {
            b"none" => None,
            name => Some(self.names.get(name).ok_or_else(|| undefined(name))?.member),
        };
        self.quorum = Some(member);
        Ok(())
    }

    fn define(&mut self, name: &[u8], member: Member) -> Result<(), String> {
        if name == b"none" {
            return Err("the name `none` is reserved".into());
        }
        match self.names.insert(name.to_vec(), Named { member, listed: false }) {
            None => Ok(()),
            Some(_) => Err(format!("the name {:?} is defined already", shown(name))),
        }
    }
}

fn read_threshold(word: &[u8], members: usize) -> Result<usize, String> {
    match word {
        b"any" => return Ok(1),
        b"all" => return Ok(members),
        _ => {}
    }
    let digits = word.iter().all(u8::is_ascii_digit);
    let number = std::str::from_utf8(word).ok().filter(|_| digits).and_then(|word| word.parse().ok());
    let refuse = || format!("threshold {:?}; allowed are any, all and 1 to {members} (its members)", shown(word));
    number.filter(|k| (1..=members).contains(k)).ok_or_else(refuse)
}

fn read_vkey<T: std::str::FromStr<Err = NoteError>>(vkey: &[u8]) -> Result<T, String> {
    let text = std::str::from_utf8(vkey).map_err(|_| "the vkey is not UTF-8".to_owned())?;
    text.parse().map_err(|e: NoteError| e.to_string())
}

fn undefined(name: &[u8]) -> String {
    format!("no witness or group {:?} is defined on a line before this one", shown(name))
}

fn shown(octets: &[u8]) -> String {
    String::from_utf8_lossy(octets).into_owned()
}

#[cfg(test)]
mod tests;
