//! A complete answer: who contributed to a scene, or to one view of it, with
//! proofs that each record named is in the log and that none is left out.
//!
//! JSON, so that it can be kept, mailed and read with any tool. The rule of what it holds is public, so that
//! a verifier can tell what is missing:
//!
//! 1. the list of the asked key: the view's ([`MapKey::view`]) or the scene's ([`MapKey::scene`]); for a view
//!    these are the records whose `views` list it;
//! 2. for each record of that list, the lists of [`keys_about`] its leaf: who replaced, disputed or took
//!    back the record, and what ended its owner's key; and for a claim or contribution that is not erased the bindings
//!    of its contributor's name ([`key_said`]);
//! 3. for each binding that any list names, the lists of [`keys_about`] its leaf, and where it is not erased the list of
//!    what ended the key that it names ([`key_said`]);
//! 4. for each rotation that a list of steps 2 to 4 names, the list of what ended the key that it leads to
//!    ([`key_after`]): so it is known who spoke for an owner at any time ([`crate::format::heir`]);
//! 5. each record of any of these lists, once. Those that only lists of the later steps name have no further lists
//!    of their own here: this much tells what the records of the answer are worth, and whom a curator confirmed.
//!
//! Every list comes with the proof that it is the whole list, or that there is none, under the map
//! root in the last leaf of the checkpoint's log. An erased record
//! keeps its leaf, and has no envelope.
//!
//! An answer as of an older checkpoint C carries C and the proof that the log of the newer
//! checkpoint begins with C's: then the records below C's size are the answer, and what came behind is
//! told besides.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::format::{
    digest::{Digest, clip},
    dsse::Envelope,
    leaf::{LEAF_LEN, Leaf, LeafError},
    map::{MapEntry, MapKey, MapProof},
    proof::MAX_HASHES,
    record::{OwnerRecord, RecordError, RecordKind, check_text},
    serial,
};

/// Largest answer that is read, in bytes.
pub const MAX_ANSWER_BYTES: usize = 64 << 20;

/// Most records in an answer, and most entries in one of its lists.
pub const MAX_RECORDS: usize = 65_536;

/// Most lists: the asked one, and three for each record (a rotation of step 4 has one).
pub const MAX_LISTS: usize = 1 + 3 * MAX_RECORDS;

/// An answer as it came or goes out; nothing verified.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Answer {
    /// Format and version.
    pub format: Format,
    /// The log that answers.
    pub origin: String,
    /// The scene asked about.
    pub scene: String,
    /// The photograph asked about, by its SHA-256 (hex); none: the whole scene.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub view: Option<Digest>,
    /// The signed checkpoint under which everything is proven.
    pub checkpoint: String,
    /// The older checkpoint that was asked for, if one was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub as_of: Option<AsOf>,
    /// The last leaf of the checkpoint's log, with the map's root; null only where the log is empty.
    #[serde(deserialize_with = "serial::nullable")]
    pub map: Option<MapPart>,
    /// Lists of records, by ascending key.
    #[serde(deserialize_with = "serial::up_to::<MAX_LISTS, _, _>")]
    pub lists: Vec<List>,
    /// The records that the lists name, by ascending index.
    #[serde(deserialize_with = "serial::up_to::<MAX_RECORDS, _, _>")]
    pub records: Vec<ListedRecord>,
    /// The registry's signed statement of whose photographs show the view ([`crate::format::shares`]); none for a whole
    /// scene, and where nothing was trained. No list proves it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shares: Option<Envelope>,
}

/// The format's name and version.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Format {
    /// The third; the second had no bindings and no shares.
    #[default]
    #[serde(rename = "cairn-answer/3")]
    V3,
}

impl Format {
    /// What the field `format` holds.
    pub const NAME: &str = "cairn-answer/3";
}

/// An older checkpoint, and that the answer's log begins with its log.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AsOf {
    /// The signed checkpoint that the question named.
    pub checkpoint: String,
    /// Consistency proof from its size to the answer's.
    #[serde(serialize_with = "serial::hashes", deserialize_with = "serial::hashes_up_to::<{ 2 * MAX_HASHES }, _>")]
    pub consistency: Vec<Digest>,
}

/// The map leaf that the answer rests on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapPart {
    /// Its index: one below the checkpoint's size.
    pub index: u64,
    /// Its 162 bytes, base64 in JSON: see [`crate::format::map_leaf::MapLeaf`].
    #[serde(with = "serial::leaf")]
    pub leaf: [u8; LEAF_LEN],
    /// Proof that it is in the checkpoint's log.
    #[serde(serialize_with = "serial::hashes", deserialize_with = "serial::hashes_up_to::<MAX_HASHES, _>")]
    pub inclusion: Vec<Digest>,
}

/// Everything that is listed under one key, or that nothing is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct List {
    /// The key.
    pub key: MapKey,
    /// The entries by ascending index; empty where the key is not in the map.
    #[serde(deserialize_with = "serial::up_to::<MAX_RECORDS, _, _>")]
    pub entries: Vec<MapEntry>,
    /// Proof of exactly these entries.
    pub proof: MapProof,
}

/// A record of the log.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ListedRecord {
    /// Its index.
    pub index: u64,
    /// Its 162 bytes, base64 in JSON: see [`Leaf`].
    #[serde(with = "serial::leaf")]
    pub leaf: [u8; LEAF_LEN],
    /// Proof that it is in the checkpoint's log.
    #[serde(serialize_with = "serial::hashes", deserialize_with = "serial::hashes_up_to::<MAX_HASHES, _>")]
    pub inclusion: Vec<Digest>,
    /// The envelope; null where the record was erased.
    #[serde(deserialize_with = "serial::nullable")]
    pub envelope: Option<Envelope>,
}

/// Why bytes are no answer.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AnswerError {
    /// Larger than [`MAX_ANSWER_BYTES`].
    #[error("answer of {got} bytes, at most {limit} are read; ask about a view instead of the scene", limit = MAX_ANSWER_BYTES)]
    TooLarge {
        /// Its size.
        got: usize,
    },
    /// Not the JSON of an answer.
    #[error("answer: {cause}")]
    Json {
        /// What the JSON reader said, with line and column.
        cause: String,
    },
    /// A format that this release does not know.
    #[error("answer of format {got:?}, this release reads {expected:?}", expected = Format::NAME)]
    Format {
        /// The format that it states.
        got: String,
    },
    /// The scene's name is none.
    #[error("answer: {0}")]
    Scene(RecordError),
    /// Lists, entries or records out of order, or twice.
    #[error("answer, {place}: not in ascending order, or there twice")]
    Order {
        /// Where.
        place: String,
    },
}

impl Answer {
    /// The key of the question: the view's, or the scene's.
    pub fn asked(&self) -> MapKey {
        asked_key(&self.scene, self.view.as_ref())
    }

    /// Reads an answer. Verifies nothing but its form.
    ///
    /// # Errors
    /// [`AnswerError`].
    pub fn parse(json: &[u8]) -> Result<Self, AnswerError> {
        #[derive(Deserialize)]
        struct Stated {
            format: String,
        }
        if json.len() > MAX_ANSWER_BYTES {
            return Err(AnswerError::TooLarge { got: json.len() });
        }
        let refuse = |e: serde_json::Error| AnswerError::Json { cause: e.to_string() };
        // The format first, so that a newer answer is refused by name and not for its fields.
        let stated: Stated = serde_json::from_slice(json).map_err(refuse)?;
        if stated.format != Format::NAME {
            return Err(AnswerError::Format { got: clip(&stated.format) });
        }
        let answer: Self = serde_json::from_slice(json).map_err(refuse)?;
        check_text("answer", "scene", &answer.scene).map_err(AnswerError::Scene)?;
        answer.check_order()?;
        Ok(answer)
    }

    /// The answer as compact JSON. Beyond [`MAX_ANSWER_BYTES`] nobody reads it: then a view is to be asked about.
    pub fn to_json(&self) -> String {
        // Strings, numbers and lists only: there is nothing that could fail to serialise.
        serde_json::to_string(self).unwrap_or_default()
    }

    fn check_order(&self) -> Result<(), AnswerError> {
        let refuse = |place: String| Err(AnswerError::Order { place });
        if let Some(at) = self.lists.windows(2).position(|pair| pair[0].key >= pair[1].key) {
            return refuse(format!("lists[{}]", at + 1));
        }
        for (i, list) in self.lists.iter().enumerate() {
            if let Some(at) = list.entries.windows(2).position(|pair| pair[0].index >= pair[1].index) {
                return refuse(format!("lists[{i}].entries[{}]", at + 1));
            }
        }
        match self.records.windows(2).position(|pair| pair[0].index >= pair[1].index) {
            Some(at) => refuse(format!("records[{}]", at + 1)),
            None => Ok(()),
        }
    }
}

/// The key of a question: the view's, or without one the scene's.
pub fn asked_key(scene: &str, view: Option<&Digest>) -> MapKey {
    view.map_or_else(|| MapKey::scene(scene), |photograph| MapKey::view(scene, photograph))
}

/// The keys under which is listed what a record of the asked list is worth: what is about it, and what ended its
/// owner's key. They follow from its leaf, so an erased record has them too.
pub fn keys_about(leaf: &Leaf) -> [MapKey; 2] {
    [MapKey::about(&leaf.record), MapKey::ended(&leaf.owner)]
}

/// The key under which is listed what ended the key that a rotation leads to; none for records of other kinds.
pub fn key_after(leaf: &Leaf) -> Option<MapKey> {
    (leaf.kind == RecordKind::Rotation).then(|| MapKey::ended(&leaf.owner))
}

/// The key of the list that what a record says asks for: of a claim or contribution the bindings of its contributor's
/// name, of a binding what ended the key that it names. An erased record says nothing.
pub fn key_said(record: &OwnerRecord) -> Option<MapKey> {
    match record.kind {
        RecordKind::Claim | RecordKind::Contribution => {
            Some(MapKey::binding(&record.scene, &record.identity.contributor))
        }
        RecordKind::Binding => record.identity.key.map(|key| MapKey::ended(&key.id())),
        RecordKind::Training | RecordKind::Revocation | RecordKind::Rotation | RecordKind::Dispute => None,
    }
}

/// The keys of the lists that a record with this leaf asks for, where the asked list names it (`is_asked`) or another;
/// `said` is what it says, none where it is erased.
pub fn keys_after(leaf: &Leaf, said: Option<&OwnerRecord>, is_asked: bool) -> Vec<MapKey> {
    let mut keys: Vec<MapKey> = key_after(leaf).into_iter().collect();
    if is_asked || leaf.kind == RecordKind::Binding {
        keys.extend(keys_about(leaf));
        keys.extend(said.and_then(key_said));
    }
    keys
}

/// What answers are put together from: a log and its map, at one size.
pub trait Source {
    /// What can go wrong there.
    type Error: From<AnswerGap>;

    /// A key's entries in log order, with the proof that these are all.
    ///
    /// # Errors
    /// What went wrong.
    fn list(&self, key: &MapKey) -> Result<List, Self::Error>;

    /// The record at an index.
    ///
    /// # Errors
    /// What went wrong.
    fn record(&self, index: u64) -> Result<ListedRecord, Self::Error>;

    /// What the record at an index says, none where it was erased; no signature needs to be verified.
    ///
    /// # Errors
    /// What went wrong.
    fn said(&self, index: u64) -> Result<Option<OwnerRecord>, Self::Error>;
}

/// Why no answer can be put together.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AnswerGap {
    /// More than an answer may hold.
    #[error("more than {limit} records would be in the answer; ask about a view instead of the scene", limit = MAX_RECORDS)]
    TooMany,
    /// More bytes than the asker takes.
    #[error("the answer is larger than {limit} bytes; ask about a view instead of the scene")]
    TooLarge {
        /// The limit.
        limit: usize,
    },
    /// A list names what is no owner record.
    #[error("the map lists index {index}, which holds no owner record: {source}")]
    NoRecord {
        /// The index.
        index: u64,
        /// What stands there.
        source: LeafError,
    },
}

/// Collects the lists and records that an answer about `asked` must hold, in the order in which it holds them.
///
/// # Errors
/// The source's, or [`AnswerGap`].
pub fn collect<S: Source>(asked: &MapKey, source: &S) -> Result<(Vec<List>, Vec<ListedRecord>), S::Error> {
    let (mut records, mut lists) = (BTreeMap::new(), BTreeMap::new());
    let mut open = BTreeSet::from([*asked]);
    // The asked list first: what it names asks for more.
    let mut next = Some(*asked);
    while let Some(key) = next.or_else(|| open.first().copied()) {
        next = None;
        open.remove(&key);
        if lists.contains_key(&key) {
            continue;
        }
        let (list, is_asked) = (source.list(&key)?, key == *asked);
        gather(&list, source, &mut records)?;
        for entry in &list.entries {
            let Some(record) = records.get(&entry.index) else { continue };
            let leaf = leaf_of(entry.index, record)?;
            let speaks = leaf.kind == RecordKind::Binding || (is_asked && leaf.kind.credits());
            let said = if speaks { source.said(entry.index)? } else { None };
            open.extend(keys_after(&leaf, said.as_ref(), is_asked));
        }
        lists.insert(key, list);
    }
    Ok((lists.into_values().collect(), records.into_values().collect()))
}

fn leaf_of(index: u64, record: &ListedRecord) -> Result<Leaf, AnswerGap> {
    Leaf::decode(&record.leaf).map_err(|source| AnswerGap::NoRecord { index, source })
}

fn gather<S: Source>(list: &List, source: &S, records: &mut BTreeMap<u64, ListedRecord>) -> Result<(), S::Error> {
    for entry in &list.entries {
        if records.contains_key(&entry.index) {
            continue;
        }
        if records.len() == MAX_RECORDS {
            return Err(AnswerGap::TooMany.into());
        }
        records.insert(entry.index, source.record(entry.index)?);
    }
    Ok(())
}
