//! A log and its map made by hand, with the answers that an honest registry would give.

use std::{cell::RefCell, collections::BTreeMap};

use cairn_log::format::{
    Answer, Checkpoint, Digest, Entry, Envelope, Leaf, MapEntry, MapKey, MapLeaf, MapTree, NoteVerifier, OwnerKey,
    OwnerRecord, RecordKind,
    answer::{AnswerGap, Format, List, ListedRecord, MapPart, Source, asked_key, collect},
    map::keys_of,
    merkle::empty_root,
    record::{self, Digests, Identity, Seen, photographs_root},
    testing::Tree,
};
use cairn_verify::{AnswerReport, Outcome, Severity, audit_answer};

pub const ORIGIN: &str = "cairn.example/log";
pub const SCENE: &str = "liberty";

pub fn key(number: u8) -> OwnerKey {
    OwnerKey::from_seed(&[number; 32])
}

pub fn registry() -> OwnerKey {
    key(200)
}

pub fn pinned() -> NoteVerifier {
    NoteVerifier::new(ORIGIN, registry().public()).unwrap()
}

pub fn view(name: &str) -> Digest {
    Digest::of(name)
}

pub fn record(kind: RecordKind, by: u8, views: &[&str], replaces: Option<Digest>) -> OwnerRecord {
    let mut views: Vec<_> = views.iter().map(|name| view(name)).collect();
    views.sort_unstable();
    OwnerRecord {
        version: record::VERSION,
        kind,
        origin: ORIGIN.into(),
        scene: SCENE.into(),
        scene_salt: Digest::of([by]),
        identity: Identity::numbered(u32::from(by), &format!("contributor {by}")),
        owner_key: key(by).public(),
        digests: Digests { photographs: Some(photographs_root(&views)), ..Digests::default() },
        seed: None,
        purpose: "credit".into(),
        nonce: Digest::of("nonce"),
        seen: Seen { size: 0, root: empty_root() },
        replaces,
        views: (!views.is_empty()).then_some(views),
    }
}

pub fn sealed(kind: RecordKind, by: u8, views: &[&str], replaces: Option<Digest>) -> Envelope {
    record(kind, by, views, replaces).seal(&key(by)).unwrap()
}

/// A binding of a contributor's name to the key `to`, by the curator `by`.
pub fn binding(by: u8, contributor: &str, to: u8) -> Envelope {
    let identity = Identity { key: Some(key(to).public()), ..Identity::named(contributor) };
    let record = OwnerRecord { identity, digests: Digests::default(), ..record(RecordKind::Binding, by, &[], None) };
    record.seal(&key(by)).unwrap()
}

/// A log and its map, as a registry would keep them.
#[derive(Default)]
pub struct Log {
    pub tree: Tree,
    pub entries: Vec<(Entry, Option<Envelope>)>,
    pub map: RefCell<MapTree>,
    pub lists: BTreeMap<MapKey, Vec<MapEntry>>,
}

impl Log {
    pub fn add(&mut self, envelope: Envelope) -> Digest {
        let (leaf, record) = Leaf::open(&envelope).unwrap();
        let owner = record.replaces.and_then(|digest| {
            self.entries.iter().find_map(|(entry, _)| match entry {
                Entry::Record(leaf) if leaf.record == digest => Some(leaf.owner),
                _ => None,
            })
        });
        self.add_under(envelope, leaf, &keys_of(&record, owner))
    }

    pub fn add_under(&mut self, envelope: Envelope, leaf: Leaf, keys: &[MapKey]) -> Digest {
        let entry = MapEntry { index: self.tree.push(leaf.hash()), leaf_hash: leaf.hash() };
        for key in keys {
            self.map.borrow_mut().append(*key, &entry);
            self.lists.entry(*key).or_default().push(entry);
        }
        let digest = leaf.record;
        self.entries.push((Entry::Record(leaf), Some(envelope)));
        digest
    }

    /// Ends a batch with its map leaf; gives the checkpoint.
    pub fn close(&mut self) -> String {
        let leaf = MapLeaf::sign(ORIGIN, self.tree.size(), self.map.borrow_mut().root(), &registry());
        self.tree.push(leaf.hash());
        self.entries.push((Entry::Map(leaf), None));
        self.checkpoint(&registry())
    }

    pub fn checkpoint(&self, key: &OwnerKey) -> String {
        Checkpoint::new(ORIGIN, self.tree.size(), self.tree.root()).sign(key).unwrap().to_string()
    }

    pub fn inclusion(&self, index: u64) -> Vec<Digest> {
        self.tree.prove_inclusion(index, self.tree.size()).unwrap()
    }

    pub fn map_part(&self, index: u64) -> MapPart {
        let leaf = self.entries[index as usize].0.encode();
        MapPart { index, leaf, inclusion: self.inclusion(index) }
    }

    pub fn answer(&self, asked: Option<&str>) -> Answer {
        let view = asked.map(view);
        let (lists, records) = collect(&asked_key(SCENE, view.as_ref()), self).unwrap();
        Answer {
            format: Format::V3,
            origin: ORIGIN.into(),
            scene: SCENE.into(),
            view,
            checkpoint: self.checkpoint(&registry()),
            as_of: None,
            map: self.tree.size().checked_sub(1).map(|last| self.map_part(last)),
            lists,
            records,
            shares: None,
        }
    }
}

impl Source for Log {
    type Error = AnswerGap;

    fn list(&self, key: &MapKey) -> Result<List, AnswerGap> {
        let entries = self.lists.get(key).cloned().unwrap_or_default();
        Ok(List { key: *key, entries, proof: self.map.borrow_mut().prove(key) })
    }

    fn record(&self, index: u64) -> Result<ListedRecord, AnswerGap> {
        let (entry, envelope) = &self.entries[index as usize];
        let (leaf, inclusion) = (entry.encode(), self.inclusion(index));
        Ok(ListedRecord { index, leaf, inclusion, envelope: envelope.clone() })
    }

    fn said(&self, index: u64) -> Result<Option<OwnerRecord>, AnswerGap> {
        let envelope = self.entries[index as usize].1.as_ref();
        Ok(envelope.map(|envelope| OwnerRecord::parse(&envelope.payload).unwrap()))
    }
}

/// The log of most tests, and its checkpoint C of size 3.
///
/// 0 and 1 contributions, 2 map | 3 contribution without views, 4 dispute of 1, 5 contribution, 6 map | 7 revocation that
/// takes 5 back, 8 rotation of 0's owner, 9 a contribution to another scene, 10 replacement of 3 by its owner, 11 map.
pub fn log() -> (Log, String) {
    use RecordKind::{Contribution, Dispute, Revocation, Rotation};
    let mut log = Log::default();
    let first = log.add(sealed(Contribution, 1, &["one", "two"], None));
    let second = log.add(sealed(Contribution, 2, &["two", "three"], None));
    let older = log.close();
    let third = log.add(sealed(Contribution, 3, &[], None));
    log.add(sealed(Dispute, 5, &[], Some(second)));
    let fifth = log.add(sealed(Contribution, 4, &["two"], None));
    log.close();
    log.add(sealed(Revocation, 4, &[], Some(fifth)));
    let mut rotation = sealed(Rotation, 6, &[], Some(first));
    rotation.sign(&key(1));
    log.add(rotation);
    let mut elsewhere = record(Contribution, 2, &["two"], None);
    elsewhere.scene = "fern".into();
    log.add(elsewhere.seal(&key(2)).unwrap());
    log.add(sealed(Contribution, 3, &[], Some(third)));
    log.close();
    (log, older)
}

pub fn audited(answer: &Answer) -> AnswerReport {
    audit_answer(answer.to_json().as_bytes(), Some(&pinned()))
}

/// The codes of the errors, each once.
pub fn errors(report: &AnswerReport) -> Vec<&'static str> {
    let failed = report.findings.iter().filter(|f| f.severity == Severity::Error);
    let mut codes: Vec<_> = failed.map(|f| f.code.as_str()).collect();
    codes.sort_unstable();
    codes.dedup();
    assert_eq!(report.outcome == Outcome::Invalid, !codes.is_empty(), "{report}");
    assert!(codes.is_empty() || report.records.is_empty(), "an invalid answer credits nobody");
    codes
}
