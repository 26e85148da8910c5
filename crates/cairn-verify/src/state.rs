//! The daemon's own state beside the registry, against the seal that a clean stop leaves: accounts and what they use, who
//! imported which scene, which views are excluded, and the registry's key.
//!
//! These files change while the daemon runs, so `DIR/state.seal` is taken away at every start and written anew when it stops
//! cleanly, as `registry/working.seal` is. It is a [`Manifest`]: of the key, which is a secret, it holds a digest like of
//! the others.

use std::path::Path;

use cairn_log::format::manifest::Manifest;

use crate::{
    code::Code,
    report::Findings,
    store::{StoreError, compare_listed, read_manifest, strangers},
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
    let manifest = match read_manifest(&dir.join(SEAL)) {
        Ok(Some(manifest)) => manifest,
        Ok(None) => {
            if there {
                let got = "none: the daemon is running, or was not stopped cleanly";
                findings.add(Code::StateUnsealed, SEAL, "a seal", got);
            }
            return Ok(());
        }
        Err(cause) => {
            findings.add(Code::StateSeal, SEAL, "a seal of version 1", cause);
            return Ok(());
        }
    };
    let count = manifest.files.len();
    let mut differ = 0;
    let mut rest = manifest.files;
    let codes = [Code::StateMismatch, Code::StateMismatch];
    for folder in FOLDERS {
        let (of_folder, others): (Vec<_>, Vec<_>) =
            rest.into_iter().partition(|file| within(&file.path, folder).is_some());
        rest = others;
        let files = of_folder.into_iter().map(|mut file| {
            file.path = within(&file.path, folder).unwrap_or_default().to_owned();
            file
        });
        let part = Manifest { format_version: manifest.format_version, files: files.collect() };
        if dir.join(folder).is_dir() || !part.files.is_empty() {
            differ += compare_listed(&part, &dir.join(folder), folder, codes[0], findings);
        }
        if dir.join(folder).is_dir() {
            differ += strangers(&part, &dir.join(folder), folder, &[], codes[1], findings)?;
        }
    }
    for file in &rest {
        if !FILES.contains(&file.path.as_str()) {
            findings.add(Code::StateSeal, SEAL, "files of the daemon's state", &file.path);
            differ += 1;
        }
    }
    for name in FILES.iter().filter(|name| dir.join(name).exists() && rest.iter().all(|file| file.path != **name)) {
        findings.add(Code::StateMismatch, *name, "a file that the seal names", "another file");
        differ += 1;
    }
    rest.retain(|file| FILES.contains(&file.path.as_str()));
    differ +=
        compare_listed(&Manifest { format_version: manifest.format_version, files: rest }, dir, "", codes[0], findings);
    if differ == 0 {
        findings.add(Code::StateVerified, SEAL, "", format!("{count} files"));
    }
    Ok(())
}

fn within<'a>(path: &'a str, folder: &str) -> Option<&'a str> {
    path.strip_prefix(folder)?.strip_prefix('/')
}
