//! Holds folders to their manifests, and the registry's working state to its seal.

use std::{collections::BTreeSet, path::Path};

use cairn_log::format::manifest::Manifest;

use super::{
    StoreError,
    files::{self, Files},
};
use crate::{
    FileInHand,
    bounded::read,
    code::Code,
    report::{self, Findings},
};

/// Largest manifest that is read, bytes: some 500 000 files.
const MAX_BYTES: usize = 64 << 20;

/// What a manifest covers, and how findings about it are named.
pub(crate) struct Covered<'a> {
    /// The folder that the manifest's paths begin in.
    pub(crate) root: &'a Path,
    /// What stands before a path in a finding's place.
    pub(crate) place: &'a str,
    /// The folders below `root` that hold nothing but what the manifest names; `""` is `root` itself.
    pub(crate) folders: &'a [&'a str],
    /// A file that is no business of the manifest.
    pub(crate) except: &'a str,
    /// Code of a file that differs.
    pub(crate) changed: Code,
    /// Code of a file that the manifest does not name.
    pub(crate) unknown: Code,
}

/// Holds files to the manifest; every one that differs, or that it does not name, is a finding.
pub(crate) fn compare(manifest: &Manifest, covered: &Covered<'_>, findings: &mut Findings) -> Result<(), StoreError> {
    for file in &manifest.files {
        let place = format!("{}{}", covered.place, file.path);
        let expected = format!("{} bytes, SHA-256 {}", file.size, file.sha256);
        if file.path.split('/').any(|part| part.is_empty() || part == "." || part == "..") {
            findings.add(covered.changed, place, "a path within the folder", &file.path);
            continue;
        }
        let path = covered.root.join(&file.path);
        match (FileInHand::read(&path), std::fs::metadata(&path)) {
            (Ok(got), Ok(metadata)) if got.digest == file.sha256 && metadata.len() == file.size => {}
            (Ok(got), Ok(metadata)) => {
                let got = format!("{} bytes, SHA-256 {}", metadata.len(), got.digest);
                findings.add(covered.changed, place, expected, got);
            }
            (Err(e), _) => findings.add(covered.changed, place, expected, e.source),
            (_, Err(e)) => findings.add(covered.changed, place, expected, e),
        }
    }
    let named: BTreeSet<&str> = manifest.files.iter().map(|file| file.path.as_str()).collect();
    for folder in covered.folders {
        let prefix = if folder.is_empty() { String::new() } else { format!("{folder}/") };
        files::walk(&covered.root.join(folder), &mut |path| {
            let path = format!("{prefix}{path}");
            if !named.contains(path.as_str()) && path != covered.except {
                let place = format!("{}{path}", covered.place);
                findings.add(covered.unknown, place, "a file that the manifest names", "another file");
            }
        })?;
    }
    Ok(())
}

/// Checks the working state against its seal.
pub(super) fn check(files: &Files, findings: &mut Findings) -> Result<(), StoreError> {
    let (root, place) = (files.registry(), "registry/working.seal");
    let (unsealed, broken) = (Some(Code::WorkingUnsealed), Code::WorkingSeal);
    let manifest = read_seal(&root.join("working.seal"), place, unsealed, broken, findings);
    let Some(manifest) = manifest else { return Ok(()) };
    if let Some(file) = manifest.files.iter().find(|file| !file.path.starts_with("working/")) {
        findings.add(Code::WorkingSeal, place, "files of working/", &file.path);
        return Ok(());
    }
    let before = findings.0.len();
    let (changed, unknown) = (Code::WorkingMismatch, Code::WorkingMismatch);
    let covered = Covered { root, place: "registry/", folders: &["working"], except: "", changed, unknown };
    compare(&manifest, &covered, findings)?;
    if findings.0.len() == before {
        findings.add(Code::WorkingVerified, place, "", report::files(manifest.files.len()));
    }
    Ok(())
}

/// Reads a seal; without one, and for one that is malformed, a finding says so. `unsealed`: its code, if its absence is
/// worth one.
pub(crate) fn read_seal(
    path: &Path,
    place: &str,
    unsealed: Option<Code>,
    malformed: Code,
    findings: &mut Findings,
) -> Option<Manifest> {
    match read_manifest(path) {
        Ok(None) => {
            if let Some(code) = unsealed {
                let got = "none: the daemon is running, or was not stopped cleanly";
                findings.add(code, place, "a seal", got);
            }
            None
        }
        Ok(manifest) => manifest,
        Err(cause) => {
            findings.add(malformed, place, "a seal of version 1", cause);
            None
        }
    }
}

/// Reads the manifest at `path`: none where there is none.
pub(crate) fn read_manifest(path: &Path) -> Result<Option<Manifest>, String> {
    read(path, MAX_BYTES)?.map(|json| Manifest::parse(&json)).transpose()
}
