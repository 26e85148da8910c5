//! That the lists are the whole ones and the right ones, and that the records are
//! exactly those which they name.

use std::collections::{BTreeMap, BTreeSet};

use cairn_log::format::{
    Answer, Checkpoint, Digest, Leaf, MapEntry, MapKey, PublicKey, RecordKind, SignedRecord,
    answer::{List, ListedRecord, keys_after},
    map::{keys_of, list_root},
    merkle::{self, verify_inclusion},
};

use crate::{code::Code, report::Findings};

/// A record whose leaf is in the log.
pub(super) struct Opened {
    pub(super) leaf: Leaf,
    /// None where it was erased.
    pub(super) body: Option<SignedRecord>,
}

impl Opened {
    /// The key that it says a contributor's name stands for, where it is a binding that was not erased.
    pub(super) fn bound(&self) -> Option<PublicKey> {
        self.body.as_ref().and_then(|body| body.record().identity.key)
    }
}

/// What the answer holds, proven.
pub(super) struct Proven<'a> {
    pub(super) lists: BTreeMap<MapKey, &'a [MapEntry]>,
    pub(super) records: BTreeMap<u64, Opened>,
    /// Owners' keys by id, of records that are not erased.
    pub(super) keys: BTreeMap<Digest, PublicKey>,
}

impl Proven<'_> {
    /// The records listed under a key, by index.
    pub(super) fn listed(&self, key: &MapKey) -> impl Iterator<Item = (u64, &Opened)> {
        let entries = self.lists.get(key).copied().unwrap_or_default();
        entries.iter().filter_map(|entry| Some((entry.index, self.records.get(&entry.index)?)))
    }
}

/// Checks lists and records; `None` where the asked list is not there, without which nothing is answered.
pub(super) fn check<'a>(
    answer: &'a Answer,
    checkpoint: &Checkpoint,
    root: &Digest,
    findings: &mut Findings,
) -> Option<Proven<'a>> {
    let lists: BTreeMap<MapKey, &List> = answer.lists.iter().map(|list| (list.key, list)).collect();
    let asked = answer.asked();
    if !lists.contains_key(&asked) {
        findings.add(Code::AnswerIncomplete, "lists", format!("the list of what was asked, key {asked}"), "none");
        return None;
    }
    check_proofs(answer, &asked, root, findings);
    let mut records = BTreeMap::new();
    for record in &answer.records {
        if let Some(opened) = open(record, checkpoint, findings) {
            records.insert(record.index, opened);
        }
    }
    check_entries(answer, &records, findings);
    let owners = owners(records.values());
    let needed = needed(asked, &lists, &records);
    for key in needed.iter().filter(|key| !lists.contains_key(key)) {
        findings.add(Code::AnswerIncomplete, "lists", format!("the list of key {key}"), "none");
    }
    for key in lists.keys().filter(|key| !needed.contains(key)) {
        findings.add(
            Code::AnswerListForeign,
            format!("list of key {key}"),
            "no such list",
            "one that was not asked for",
        );
    }
    check_concern(answer, &records, &owners, findings);
    if !findings.failed() && !records.is_empty() {
        let got = format!("{} records in the log of size {}", records.len(), checkpoint.size);
        findings.add(Code::AnswerRecordsProven, "records", "", got);
    }
    let lists = lists.into_iter().map(|(key, list)| (key, list.entries.as_slice())).collect();
    let named =
        records.values().filter_map(|opened| Some((opened.leaf.owner, opened.body.as_ref()?.record().owner_key)));
    let bound = records.values().filter_map(Opened::bound);
    let keys = named.chain(bound.map(|key| (key.id(), key))).collect();
    Some(Proven { lists, records, keys })
}

/// The keys of the lists that an answer must hold: what is about the asked list's records, what ended their owners' keys,
/// which keys curators bound to their contributors' names, and from rotation to rotation what ended the keys that followed.
fn needed(asked: MapKey, lists: &BTreeMap<MapKey, &List>, records: &BTreeMap<u64, Opened>) -> BTreeSet<MapKey> {
    let (mut open, mut needed) = (vec![asked], BTreeSet::new());
    while let Some(key) = open.pop() {
        let entries = lists.get(&key).map_or(&[][..], |list| &list.entries);
        if needed.insert(key) {
            let listed = entries.iter().filter_map(|entry| records.get(&entry.index));
            let said = |opened: &Opened| {
                keys_after(&opened.leaf, opened.body.as_ref().map(SignedRecord::record), key == asked)
            };
            open.extend(listed.flat_map(said));
        }
    }
    needed
}

/// Every list under the map's root. The asked one is reported by itself, the others together.
fn check_proofs(answer: &Answer, asked: &MapKey, root: &Digest, findings: &mut Findings) {
    let (mut whole, mut empty) = (0, 0);
    for list in &answer.lists {
        let count = list.entries.len();
        let place = format!("list of key {}", list.key);
        let value = (count > 0).then(|| list_root(&list.entries));
        if let Err(e) = list.proof.verify(&list.key, value, root) {
            let got = format!("{count} entries: {e} ({})", e.code());
            findings.add(Code::MapProofFailed, place, format!("exactly what the map of root {root} lists"), got);
        } else if list.key == *asked && count > 0 {
            findings.add(
                Code::MapMembershipProven,
                place,
                "",
                format!("what was asked: {count} records, and no others"),
            );
        } else if list.key == *asked {
            findings.add(Code::MapAbsenceProven, place, "", "what was asked: no record at all");
        } else if count > 0 {
            whole += 1;
        } else {
            empty += 1;
        }
    }
    let place = "lists about the records and their owners' keys";
    if whole > 0 {
        findings.add(Code::MapMembershipProven, place, "", format!("{whole} lists, each the whole one"));
    }
    if empty > 0 {
        findings.add(Code::MapAbsenceProven, place, "", format!("{empty} lists with nothing in them"));
    }
}

/// The record at its place in the log, with the envelope that belongs to its leaf.
fn open(record: &ListedRecord, checkpoint: &Checkpoint, findings: &mut Findings) -> Option<Opened> {
    let place = format!("record at index {}", record.index);
    let leaf = match Leaf::decode(&record.leaf) {
        Ok(leaf) => leaf,
        Err(e) => {
            findings.add(Code::AnswerRecordMismatch, place, "an owner record's leaf", e);
            return None;
        }
    };
    let hash = leaf.hash();
    if let Err(e) = verify_inclusion(&hash, record.index, checkpoint.size, &record.inclusion, &checkpoint.root) {
        findings.add(Code::InclusionFailed, place, format!("root {}", checkpoint.root), e);
        return None;
    }
    let Some(envelope) = &record.envelope else {
        findings.add(Code::AnswerRecordErased, place, "", "its leaf only");
        return Some(Opened { leaf, body: None });
    };
    match SignedRecord::open(envelope.clone()) {
        Ok(signed) if *signed.leaf() == leaf => {
            let body = signed.record();
            if body.origin != checkpoint.origin {
                findings.add(Code::RecordOriginMismatch, place.as_str(), &checkpoint.origin, &body.origin);
            }
            if body.seen.size > record.index {
                let expected = format!("at most {}, the record's own index", record.index);
                findings.add(Code::RecordSeenContradiction, place, expected, body.seen.size);
            }
            Some(Opened { leaf, body: Some(signed) })
        }
        Ok(signed) => {
            let expected = format!("the envelope of leaf {hash}");
            findings.add(Code::AnswerRecordMismatch, place, expected, format!("one of leaf {}", signed.leaf().hash()));
            None
        }
        Err(e) => {
            findings.add(Code::AnswerRecordMismatch, place, "an envelope that its owner signed", e);
            None
        }
    }
}

/// That the records are those which the lists name, all of them and no others.
fn check_entries(answer: &Answer, records: &BTreeMap<u64, Opened>, findings: &mut Findings) {
    let hashes: BTreeMap<u64, Digest> =
        answer.records.iter().map(|record| (record.index, merkle::leaf_hash(&record.leaf))).collect();
    let mut named = BTreeSet::new();
    for list in &answer.lists {
        for entry in &list.entries {
            let place = format!("list of key {}, index {}", list.key, entry.index);
            named.insert(entry.index);
            match hashes.get(&entry.index) {
                Some(hash) if *hash == entry.leaf_hash => {}
                Some(hash) => {
                    let expected = format!("the record with leaf hash {}", entry.leaf_hash);
                    findings.add(Code::AnswerRecordMismatch, place, expected, format!("one with {hash}"));
                }
                None => findings.add(Code::AnswerRecordMissing, place, "the record", "none in the answer"),
            }
        }
    }
    for index in records.keys().filter(|index| !named.contains(index)) {
        let place = format!("record at index {index}");
        findings.add(Code::AnswerRecordForeign, place, "a record that a list names", "one that none names");
    }
}

/// The lists of ended keys, by map key: the id, and the key itself where a record that is not erased names it.
type Owners = BTreeMap<MapKey, (Digest, Option<PublicKey>)>;

fn owners<'a>(listed: impl Iterator<Item = &'a Opened>) -> Owners {
    let mut owners = Owners::new();
    for opened in listed {
        let id = opened.leaf.owner;
        let known = owners.entry(MapKey::ended(&id)).or_insert((id, None));
        known.1 = known.1.or(opened.body.as_ref().map(|body| body.record().owner_key));
        if let Some(key) = opened.bound() {
            owners.entry(MapKey::ended(&key.id())).or_insert((key.id(), None)).1 = Some(key);
        }
    }
    owners
}

/// That each record concerns what it is listed under. Of erased records only leaf and map say so.
fn check_concern(answer: &Answer, records: &BTreeMap<u64, Opened>, owners: &Owners, findings: &mut Findings) {
    for list in &answer.lists {
        for entry in &list.entries {
            let Some(opened) = records.get(&entry.index) else { continue };
            if !concerns(opened, &list.key, owners.get(&list.key)) {
                let place = format!("list of key {}, record at index {}", list.key, entry.index);
                let scene = opened.body.as_ref().map_or("(erased)", |body| body.record().scene.as_str());
                let got = format!("a {:?} about scene {scene:?}", opened.leaf.kind);
                findings.add(Code::AnswerRecordForeign, place, "a record that concerns this key", got);
            }
        }
    }
}

/// Whether a record concerns a key; `owner` is given where the key stands for the end of that owner's.
fn concerns(opened: &Opened, key: &MapKey, owner: Option<&(Digest, Option<PublicKey>)>) -> bool {
    let kind = opened.leaf.kind;
    match (&opened.body, owner) {
        (Some(body), owner) => {
            // A rotation ends the old key by that key's own signature; where the key is not known, by the map's word.
            let replaced = owner.filter(|_| kind == RecordKind::Rotation);
            let replaced =
                replaced.filter(|(_, key)| key.is_none_or(|key| body.envelope().signature_by(&key).is_some()));
            keys_of(body.record(), replaced.map(|(id, _)| *id)).contains(key)
        }
        (None, Some((id, _))) => {
            kind == RecordKind::Rotation || (kind == RecordKind::Revocation && opened.leaf.owner == *id)
        }
        (None, None) => true,
    }
}
