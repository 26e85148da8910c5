//! Reading a policy, line by line (C2SP tlog-policy, "Policy file syntax and structure").
//!
//! Names are octets, not characters: two spellings that look alike are two names.

use std::collections::{BTreeMap, HashSet};

use super::{Group, MAX_POLICY_BYTES, Member, Policy, PolicyError, PolicyLog, PolicyWitness};
use crate::format::{
    cosignature::WitnessVerifier,
    key::PublicKey,
    note::{NoteError, NoteVerifier},
};

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

pub(super) fn parse(text: &[u8]) -> Result<Policy, PolicyError> {
    if text.len() > MAX_POLICY_BYTES {
        return Err(PolicyError::TooLarge { got: text.len() });
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
            [b"log", vkey] => self.log(vkey, None),
            [b"log", vkey, url] => self.log(vkey, Some(url)),
            [b"witness", name, vkey] => self.witness(name, vkey, None),
            [b"witness", name, vkey, url] => self.witness(name, vkey, Some(url)),
            [b"group", name, threshold, members @ ..] if !members.is_empty() => self.group(name, threshold, members),
            [b"quorum", name] => self.quorum(name),
            [b"log", ..] => Err("expected `log <vkey> [<url>]`".into()),
            [b"witness", ..] => Err("expected `witness <name> <vkey> [<url>]`".into()),
            [b"group", ..] => Err("expected `group <name> any|all|<k> <member>...` with at least one member".into()),
            [b"quorum", ..] => Err("expected `quorum <name>` or `quorum none`".into()),
            [other, ..] => Err(format!(
                "unknown keyword {:?}; allowed are log, witness, group, quorum and # comments",
                shown(other)
            )),
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
    let text = std::str::from_utf8(vkey).map_err(|_| format!("vkey {:?} is not UTF-8", shown(vkey)))?;
    text.parse().map_err(|e: NoteError| e.to_string())
}

fn undefined(name: &[u8]) -> String {
    format!("no witness or group {:?} is defined on a line before this one", shown(name))
}

fn shown(octets: &[u8]) -> String {
    String::from_utf8_lossy(octets).into_owned()
}
