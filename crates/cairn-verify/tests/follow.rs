//! Logs that grow, step back, fork and lie, looked at again and again; and the evidence
//! against them checked by somebody who was not there.

use std::collections::BTreeMap;

use crate::handmade::{Log, key};
use cairn_log::format::{Digest, Policy, RecordKind, WitnessVerifier, cosign};
use cairn_verify::{CONTRADICTION, Code, Fetch, FollowError, FollowOptions, Followed, Outcome, audit_evidence, follow};

/// A log as served at one size, with files of one's own over it.
struct Served<'a> {
    log: &'a Log,
    size: u64,
    over: BTreeMap<String, Option<Vec<u8>>>,
}

impl Fetch for Served<'_> {
    fn fetch(&self, path: &str, limit: usize) -> Result<Option<Vec<u8>>, FollowError> {
        let file = self.over.get(path).cloned().unwrap_or_else(|| self.log.file(path, self.size));
        if file.as_ref().is_some_and(|bytes| bytes.len() > limit) {
            return Err(FollowError::Fetch { path: path.into(), cause: "too large".into() });
        }
        Ok(file)
    }
}

fn served(log: &Log) -> Served<'_> {
    Served { log, size: log.size(), over: BTreeMap::new() }
}

fn look(served: &Served<'_>, last: Option<&str>) -> Followed {
    follow(served, last, &FollowOptions { pinned: &served.log.verifier(), policy: None }).unwrap()
}

/// A log of `count` claims, a map leaf behind every 40th and the last.
fn grown(count: u32) -> Log {
    let mut log = Log::default();
    grow(&mut log, count);
    log
}

fn grow(log: &mut Log, count: u32) {
    for i in 1..=count {
        log.add(&log.record(RecordKind::Claim, 1, "town"), &[]);
        if i % 40 == 0 || i == count {
            log.end_batch();
        }
    }
}

#[test]
fn a_log_that_goes_on_is_followed() {
    let mut log = Log::default();
    let mut last: Option<String> = None;
    for count in [0, 1, 3, 250, 10, 80, 1] {
        grow(&mut log, count);
        let followed = look(&served(&log), last.as_deref());
        assert_eq!(followed.report.exit_code(), 0, "{}", followed.report);
        assert!(followed.contradiction.is_none());
        assert_eq!(followed.report.has(Code::FollowFirst), last.is_none());
        let report = followed.report.clone();
        assert!(report.has(Code::FollowEntries) && report.size == Some(log.size()), "{report}");
        last = Some(followed.keep.unwrap());
        // Looking again finds it unchanged, and fetches nothing more.
        let mut again = served(&log);
        again.over = ["tile/0/000", "tile/entries/000"].map(|path| (path.to_owned(), None)).into();
        assert!(look(&again, last.as_deref()).report.has(Code::FollowConsistent));
    }
    assert!(log.size() > 300);
    // A tile that is not served is no verdict.
    let mut gone = served(&log);
    gone.size = log.sizes[log.sizes.len() - 3];
    let earlier = look(&gone, None).keep.unwrap();
    let width = log.size() % 256;
    gone.size = log.size();
    gone.over = [(format!("tile/0/001.p/{width}"), None)].into();
    assert!(follow(&gone, Some(&earlier), &FollowOptions { pinned: &log.verifier(), policy: None }).is_err());
}

/// Two logs that share their first `common` records and then differ.
fn forked(common: u32, a: u32, b: u32) -> (Log, Log) {
    let mut first = grown(common);
    let mut second = first.clone();
    grow(&mut first, a);
    second.add(&second.record(RecordKind::Claim, 9, "elsewhere"), &[]);
    grow(&mut second, b);
    (first, second)
}

#[test]
fn a_fork_is_a_contradiction_whose_evidence_convinces_a_stranger() {
    for (common, a, b) in [(3, 5, 90), (255, 10, 80), (40, 1, 1), (1, 2, 400)] {
        let (first, second) = forked(common, a, b);
        let seen = look(&served(&first), None).keep.unwrap();
        let followed = look(&served(&second), Some(&seen));
        assert_eq!(followed.report.exit_code(), CONTRADICTION, "{}", followed.report);
        assert!(followed.keep.is_none());
        let kept = followed.contradiction.unwrap();
        assert_eq!((kept.first.as_str(), &kept.second), (seen.as_str(), &second.checkpoint(second.size())));
        let tiles = Kept(kept.tiles.into_iter().collect());
        let report = audit_evidence(&kept.first, &kept.second, &tiles, &first.verifier());
        assert!(report.outcome == Outcome::Trusted && report.has(Code::EvidenceProven), "{report}");
        // In either order, and under that key alone.
        let report = audit_evidence(&kept.second, &kept.first, &tiles, &first.verifier());
        assert_eq!(report.outcome, Outcome::Trusted, "{report}");
        let mut other = first.clone();
        other.signer = key(77);
        let report = audit_evidence(&kept.first, &kept.second, &tiles, &other.verifier());
        assert_eq!(report.outcome, Outcome::Invalid, "{report}");
        // A changed tile proves nothing, and no tile neither.
        if first.size() != second.size() {
            for spoiled in [None, Some(0)] {
                let mut tiles = tiles.0.clone();
                match spoiled {
                    None => tiles.clear(),
                    Some(at) => tiles.values_mut().for_each(|tile| tile[at] ^= 1),
                }
                let report = audit_evidence(&kept.first, &kept.second, &Kept(tiles), &first.verifier());
                assert_eq!(report.outcome, Outcome::Valid, "{report}");
                assert!(report.has(Code::EvidenceUntold), "{report}");
            }
        }
    }
}

/// Files of an evidence folder.
struct Kept(BTreeMap<String, Vec<u8>>);

impl Fetch for Kept {
    fn fetch(&self, path: &str, _: usize) -> Result<Option<Vec<u8>>, FollowError> {
        Ok(self.0.get(path).cloned())
    }
}

#[test]
fn a_step_back_and_another_root_are_contradictions() {
    let log = grown(100);
    let seen = look(&served(&log), None).keep.unwrap();
    let mut back = served(&log);
    back.size = log.sizes[0];
    let followed = look(&back, Some(&seen));
    assert_eq!(followed.report.exit_code(), CONTRADICTION, "{}", followed.report);
    let kept = followed.contradiction.unwrap();
    let tiles = Kept(kept.tiles.into_iter().collect());
    let report = audit_evidence(&kept.first, &kept.second, &tiles, &log.verifier());
    assert_eq!(report.outcome, Outcome::Valid, "an old state alone excludes nothing: {report}");

    // Two logs of one size that differ in their first record.
    let of = |scene: &str| {
        let mut log = Log::default();
        log.add(&log.record(RecordKind::Claim, 5, scene), &[]);
        grow(&mut log, 99);
        log
    };
    let (one, other) = (of("x"), of("y"));
    let one_seen = look(&served(&one), None).keep.unwrap();
    let followed = look(&served(&other), Some(&one_seen));
    assert_eq!(followed.report.exit_code(), CONTRADICTION, "{}", followed.report);
    let kept = followed.contradiction.unwrap();
    let report = audit_evidence(&kept.first, &kept.second, &Kept(BTreeMap::new()), &log.verifier());
    assert_eq!(report.outcome, Outcome::Trusted, "{report}");
    // The same note twice shows nothing.
    let report = audit_evidence(&seen, &seen, &Kept(BTreeMap::new()), &log.verifier());
    assert!(report.outcome == Outcome::Invalid && report.has(Code::EvidenceNone), "{report}");
}

#[test]
fn tiles_and_entries_other_than_those_signed_are_no_contradiction_and_no_success() {
    let mut log = grown(100);
    let seen = look(&served(&log), None).keep.unwrap();
    grow(&mut log, 30);
    let names = [format!("tile/0/000.p/{}", log.size()), format!("tile/entries/000.p/{}", log.size())];
    for (name, each) in names.iter().zip([32, 164]) {
        // The first bytes belong to what was seen before and count as well, where they are read at all.
        for entry in [0, 64, 101, 110, log.size() as usize - 1] {
            let mut bytes = log.file(name, log.size()).unwrap();
            bytes[entry * each + 9] ^= 4;
            let mut spoiled = served(&log);
            spoiled.over.insert(name.clone(), Some(bytes.clone()));
            let followed = look(&spoiled, Some(&seen));
            let old_entry = each == 164 && entry < 103;
            assert_eq!(followed.report.exit_code() == 0, old_entry, "{name} {entry}: {}", followed.report);
            assert!(followed.contradiction.is_none(), "{}", followed.report);
            if !old_entry {
                assert_eq!((followed.report.exit_code(), followed.keep), (11, None));
            }
        }
        let mut short = served(&log);
        short.over.insert(name.clone(), Some(vec![0; 40]));
        let options = FollowOptions { pinned: &log.verifier(), policy: None };
        assert!(matches!(follow(&short, Some(&seen), &options), Err(FollowError::Short { .. })));
        short.over.insert(name.clone(), None);
        assert!(matches!(follow(&short, Some(&seen), &options), Err(FollowError::Missing { .. })));
    }
}

#[test]
fn unsigned_checkpoints_map_leaves_and_foreign_states_are_refused() {
    let log = grown(5);
    let mut other = log.clone();
    other.signer = key(77);
    let options = |log: &Log| log.verifier();
    let followed = follow(&served(&log), None, &FollowOptions { pinned: &options(&other), policy: None }).unwrap();
    assert_eq!((followed.report.exit_code(), followed.keep), (10, None));
    let seen = look(&served(&other), None);
    // The log's own map leaves are signed by another key than its checkpoints.
    assert_eq!(seen.report.exit_code(), 13, "{}", seen.report);
    let foreign = other.checkpoint(6);
    let error = follow(&served(&log), Some(&foreign), &FollowOptions { pinned: &log.verifier(), policy: None });
    assert!(matches!(error, Err(FollowError::State { .. })));

    let mut no_map = grown(5);
    no_map.add(&no_map.record(RecordKind::Claim, 1, "town"), &[]);
    assert_eq!(look(&served(&no_map), None).report.exit_code(), 13);
    let mut wrong = grown(5);
    wrong.push_map_leaf(Digest::of("any"));
    assert_eq!(look(&served(&wrong), None).report.exit_code(), 0, "roots are for whoever has the records");
}

#[test]
fn a_policy_asks_for_its_witnesses_at_every_look() {
    let log = grown(5);
    let witness = WitnessVerifier::new("w.example", key(90).public()).unwrap();
    let policy = Policy::parse(format!("log {}\nwitness w {witness}\nquorum w\n", log.verifier())).unwrap();
    let options = FollowOptions { pinned: &log.verifier(), policy: Some(&policy) };
    let followed = follow(&served(&log), None, &options).unwrap();
    assert!(followed.report.exit_code() == 10 && followed.report.has(Code::PolicyQuorumMissing));
    let mut note = cairn_log::format::Note::parse(&log.checkpoint(log.size())).unwrap();
    note.signatures.push(cosign(&note.text, 1_700_000_000, "w.example", &key(90)).unwrap());
    let mut cosigned = served(&log);
    cosigned.over.insert("checkpoint".into(), Some(note.to_string().into_bytes()));
    let followed = follow(&cosigned, None, &options).unwrap();
    assert_eq!(followed.report.exit_code(), 0, "{}", followed.report);
    assert!(followed.report.to_string().contains("2023-11-14T22:13:20Z"), "{}", followed.report);
    let at = note.signatures.len() - 1;
    note.signatures[at].signature[20] ^= 1;
    cosigned.over.insert("checkpoint".into(), Some(note.to_string().into_bytes()));
    let followed = follow(&cosigned, None, &options).unwrap();
    assert!(followed.report.exit_code() == 10 && followed.report.has(Code::PolicySignatureInvalid));
}
