//! The daemon's own state beside the registry, against the seal that a clean stop leaves: accounts and what they use, who
//! imported which scene, which views are excluded, and the registry's key.
//!
//! These files change while the daemon runs, so `DIR/state.seal` is taken away at every start and written anew when it stops
//! cleanly, as `registry/working.seal` is. It is a [`Manifest`]: of the key, which is a secret, it holds a digest like of
//! the others.

use std::path::Path;

use crate::{
    code::Code,
    report::{self, Findings},
    store::{Covered, StoreError, compare, read_seal},
};

/// The seal.
pub(crate) const SEAL: &str = "state.seal";

/// What it covers: folders with everything in them, and single files.
pub(crate) const FOLDERS: [&str; 3] = ["access", "exclusions", "owners"];

/// See [`FOLDERS`].
pub(crate) const FILES: [&str; 1] = ["registry.key"];

/// Whether a name of the data folder is this check's business.
pub(crate) fn covers(name: &str) -> bool {
    name == SEAL || FOLDERS.contains(&name) || FILES.contains(&name)
}

/// Holds the state in the data folder `dir` to its seal. `there`: whether any of it is.
pub(crate) fn check(dir: &Path, there: bool, findings: &mut Findings) -> Result<(), StoreError> {
    let codes = there.then_some(Code::StateUnsealed);
    let Some(mut manifest) = read_seal(&dir.join(SEAL), SEAL, codes, Code::StateSeal, findings) else { return Ok(()) };
    let before = findings.0.len();
    let count = manifest.files.len();
    manifest.files.retain(|file| {
        let of_folder = file.path.split_once('/').is_some_and(|(folder, _)| FOLDERS.contains(&folder));
        let covered = of_folder || FILES.contains(&file.path.as_str());
        if !covered {
            findings.add(Code::StateSeal, SEAL, "files of the daemon's state", &file.path);
        }
        covered
    });
    for name in FILES.iter().filter(|name| manifest.files.iter().all(|file| file.path != **name)) {
        if dir.join(name).exists() {
            findings.add(Code::StateMismatch, *name, "a file that the seal names", "another file");
        }
    }
    let (changed, unknown) = (Code::StateMismatch, Code::StateMismatch);
    compare(&manifest, &Covered { root: dir, place: "", folders: &FOLDERS, except: "", changed, unknown }, findings)?;
    if findings.0.len() == before {
        findings.add(Code::StateVerified, SEAL, "", report::files(count));
    }
    Ok(())
}
