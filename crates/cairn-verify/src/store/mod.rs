//! The audit of a data folder's registry: every byte hashed again, the log, its tiles
//! and its map rebuilt from the records.
//!
//! ```text
//! registry/public/checkpoint, registry/public/tile/...   against what the records make
//! registry/envelopes/...                                 the records themselves
//! registry/working.seal, registry/working/               against each other
//! ```
//!
//! Reads and never writes. Goes through the log once, 256 entries at a time, on all
//! cores; what grows with the log is the map alone (about 200 bytes for each distinct
//! scene, view, ended key and record spoken about) and 24 bytes a batch for the sizes
//! that records may say to have seen.

mod chunk;
mod class;
mod files;
mod log;
mod options;
mod record;
mod replaced;
mod report;
mod seal;
mod tail;
mod tiles;

use std::path::Path;

use cairn_log::format::{Checkpoint, Policy, merkle};

pub use class::Class;
pub use files::StoreError;
pub use options::{Stock, StoreOptions};
pub use report::StoreReport;
pub(crate) use seal::{Covered, compare, read_manifest, read_seal};

use crate::{code::Code, policy, report::Findings};
use files::Files;
use report::Tally;

/// Audits the registry of the data folder `dir`.
///
/// Damage is a finding, which names the file; it is never an error.
///
/// # Errors
/// [`StoreError`] where `dir` holds no registry or cannot be listed.
pub fn audit_store(dir: &Path, options: &StoreOptions<'_>) -> Result<StoreReport, StoreError> {
    let files = Files::open(dir)?;
    let mut findings = Findings::default();
    let mut tally = Tally::default();
    let checkpoint = published(&files, options, &mut findings);
    log::check(&files, options, checkpoint.as_ref(), &mut tally, &mut findings)?;
    seal::check(&files, &mut findings)?;
    Ok(StoreReport::new(checkpoint, tally, findings, options.pinned.is_some()))
}

/// The published checkpoint, under the best key there is.
fn published(files: &Files, options: &StoreOptions<'_>, findings: &mut Findings) -> Option<Checkpoint> {
    let place = files.name_public("checkpoint");
    let text = match files.checkpoint() {
        Ok(Some(text)) => text,
        Ok(None) => {
            findings.add(Code::StoreCheckpointMissing, place, "a signed checkpoint", "no file");
            return None;
        }
        Err(cause) => {
            findings.add(Code::StoreCheckpointMalformed, place, "a signed checkpoint", cause);
            return None;
        }
    };
    let (note, checkpoint) = match Checkpoint::read(&text) {
        Ok(parsed) => parsed,
        Err(e) => {
            findings.add(Code::StoreCheckpointMalformed, place, "a signed checkpoint", e);
            return None;
        }
    };
    let Some(key) = options.pinned.or(options.found) else {
        findings.add(Code::StoreKeyMissing, place, "the log's verifier key", "none");
        return Some(checkpoint);
    };
    if options.pinned.is_none() {
        findings.add(Code::StoreKeyUnpinned, place.clone(), "a pinned verifier key", format!("{key}, of this folder"));
    }
    match Checkpoint::verify(&text, key) {
        Err(e) => findings.add(Code::StoreCheckpointSignature, place.clone(), format!("signed by {key}"), e),
        // A note is read liberally; the registry writes it in one way.
        Ok(_) if note.to_string() != text => {
            findings.add(Code::StoreCheckpointMalformed, place.clone(), "a note as the registry writes it", "another")
        }
        Ok(_) => {
            let got = format!("size {}, root {}", checkpoint.size, checkpoint.root);
            findings.add(Code::StoreCheckpointVerified, place.clone(), "", got);
        }
    }
    let known = options.policy.map_or(&[][..], Policy::witnesses);
    if let Some(policy) = options.policy {
        policy::check(policy, key, &text, &place, findings);
    }
    let strangers = note.signatures.iter().filter(|line| !known.iter().any(|w| w.verifier.claims(line)));
    for line in strangers.filter(|line| line.key_id != key.key_id() || line.name != key.name()) {
        findings.add(Code::StoreCosignatureUnknown, place.clone(), "", format!("a line by {:?}", line.name));
    }
    if checkpoint.size == 0 && checkpoint.root != merkle::empty_root() {
        findings.add(Code::StoreRoot, place, merkle::empty_root(), checkpoint.root);
    }
    Some(checkpoint)
}
