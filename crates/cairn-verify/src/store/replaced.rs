//! Whether a record may do what it does to another: stand in its place, take it back, or
//! go on under another key. Who speaks for the other's owner follows rotations from key to key ([`cairn_log::format::heir::heir()`]).

use std::{
    collections::{HashMap, HashSet, hash_map::Entry},
    convert::Infallible,
};

use cairn_log::format::{
    Digest, Leaf, MapKey, RecordKind,
    heir::{Ending, Heir, heir},
    packs::{self, Slot},
    tile::TileKind,
};

use rayon::prelude::*;

use super::{
    chunk::Context,
    files::{CHUNK, ENTRY},
    record::{self, Replacing},
    tiles,
};
use crate::{code::Code, report::Findings};

/// How keys ended, by the map keys under which their ends are listed ([`ended`]).
pub(super) type Endings = HashMap<MapKey, Ending>;

/// Takes down what the record at `index`, by a key that is good, ends. Of an erased record only its map keys are known;
/// then all of them are taken down, since none but a key's end is ever looked up.
pub(super) fn note(endings: &mut Endings, kind: RecordKind, keys: &[MapKey], index: u64, owner: Digest) {
    let to = match kind {
        RecordKind::Revocation => None,
        RecordKind::Rotation => Some(owner),
        RecordKind::Claim
        | RecordKind::Contribution
        | RecordKind::Training
        | RecordKind::Dispute
        | RecordKind::Binding => return,
    };
    for key in keys {
        if let Entry::Vacant(first) = endings.entry(*key) {
            first.insert(Ending { index, to });
        }
    }
}

/// Holds every record that replaces another to the log's rules.
pub(super) fn check(context: &Context<'_>, found: &[(u64, Replacing)], endings: &Endings, findings: &mut Findings) {
    let owners = owners_of(context, &found.iter().map(|(_, one)| one.replaces).collect());
    for (index, one) in found {
        let place = format!("{}, record {index}", context.files.name_envelopes(index / CHUNK));
        let Some((replaced, owner)) = owners.get(&one.replaces).filter(|(replaced, _)| replaced < index) else {
            let expected = "a record that replaces one of this log before it";
            findings.add(Code::StoreRecordRule, place, expected, one.replaces);
            continue;
        };
        let known = |key: &Digest| endings.get(&MapKey::ended(key)).copied();
        // Whose word there must be: the owner's of this record.
        let by = if one.kind == RecordKind::Rotation {
            if let Some(end) = known(owner).filter(|end| end.index < *index) {
                let got = format!("one of key {owner}, which record {} ended", end.index);
                findings.add(Code::StoreRecordRule, place, "a rotation of a key that is good", got);
                continue;
            }
            *replaced
        } else {
            let Ok(speaks) = heir(owner, *index, |key| Ok::<_, Infallible>(known(key)));
            match speaks {
                Heir::Key { id, .. } if id == one.owner && !one.agreed => continue,
                Heir::Key { id, since } if id != one.owner && one.agreed => since.unwrap_or(*replaced),
                Heir::Key { id, .. } => {
                    let expected =
                        format!("a record by key {id}, which speaks for record {replaced}, or with its signature");
                    let got = format!(
                        "one by key {}, {}",
                        one.owner,
                        if one.agreed { "and a signature more" } else { "alone" }
                    );
                    findings.add(Code::StoreRecordRule, place, expected, got);
                    continue;
                }
                Heir::Nobody { id, ended_by } => {
                    let expected =
                        format!("a record before index {ended_by}, which ended key {id} with none in its place");
                    findings.add(Code::StoreRecordRule, place, expected, format!("one about record {replaced}"));
                    continue;
                }
            }
        };
        agreement(context, *index, by, place, findings);
    }
}

/// That the middle signature of record `index` is by the owner of record `by`.
fn agreement(context: &Context<'_>, index: u64, by: u64, place: String, findings: &mut Findings) {
    match (record_at(context, index), record_at(context, by)) {
        (Some(json), Some(other)) if record::agreed_by(&json, &other) => {}
        (_, None) => {
            let got = format!("record {by} was erased, and its owner's key with it");
            findings.add(Code::StorePredecessorUnknown, place, "", got);
        }
        _ => {
            let expected = format!("signatures[1] by the owner of record {by}, under its key id");
            findings.add(Code::StoreRecordSignature, place, expected, "one that does not verify");
        }
    }
}

fn record_at(context: &Context<'_>, index: u64) -> Option<Vec<u8>> {
    let bytes = context.files.envelopes(index / CHUNK).ok().flatten()?;
    match packs::parse_whole(&bytes).0.into_iter().nth((index % CHUNK) as usize)? {
        Slot::Record(json) => Some(json),
        Slot::Erased(_) | Slot::MapLeaf => None,
    }
}

/// Index and owner's key id of each record looked for that is in the log.
pub(super) fn owners_of(context: &Context<'_>, wanted: &HashSet<Digest>) -> HashMap<Digest, (u64, Digest)> {
    if wanted.is_empty() {
        return HashMap::new();
    }
    let of_chunk = |index: u64| -> Vec<(Digest, (u64, Digest))> {
        let bundle = tiles::widest(context.files, TileKind::Entries, index, ENTRY);
        let bytes = bundle.map(|(_, bytes)| bytes).unwrap_or_default();
        let leaf = |(at, entry): (u64, &[u8; ENTRY])| {
            let leaf = Leaf::decode(&entry[2..]).ok().filter(|leaf| wanted.contains(&leaf.record))?;
            Some((leaf.record, (index * CHUNK + at, leaf.owner)))
        };
        (0..).zip(bytes.as_chunks::<ENTRY>().0).filter_map(leaf).collect()
    };
    (0..context.extent.div_ceil(CHUNK)).into_par_iter().flat_map_iter(of_chunk).collect()
}
