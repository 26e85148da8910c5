//! Holds folders to their manifests, and the registry's working state to its seal.

use std::{collections::BTreeSet, path::Path};

use cairn_log::format::manifest::Manifest;

use super::{
    StoreError,
    files::{self, Files},
};
use crate::{FileInHand, code::Code, report::Findings};

/// Largest manifest that is read, bytes: some 500 000 files.
const MAX_BYTES: usize = 64 << 20;

/// Holds the files of `folder` to the manifest. `name`: the folder's in the findings. `except`: files that are no
/// business of the manifest. Gives how many files differ.
pub(crate) fn compare(
    manifest: &Manifest,
    folder: &Path,
    name: &str,
    except: &[&str],
    [changed, unknown]: [Code; 2],
    findings: &mut Findings,
) -> Result<usize, StoreError> {
    let differ = compare_listed(manifest, folder, name, changed, findings);
    Ok(differ + strangers(manifest, folder, name, except, unknown, findings)?)
}

/// The files that the manifest names; gives how many of them differ. `name`: empty where their paths say it all.
pub(crate) fn compare_listed(
    manifest: &Manifest,
    folder: &Path,
    name: &str,
    changed: Code,
    findings: &mut Findings,
) -> usize {
    let before = findings.0.len();
    for file in &manifest.files {
        let place = if name.is_empty() { file.path.clone() } else { format!("{name}/{}", file.path) };
        let expected = format!("{} bytes, SHA-256 {}", file.size, file.sha256);
        if file.path.split('/').any(|part| part.is_empty() || part == "." || part == "..") {
            findings.add(changed, place, "a path within the folder", &file.path);
            continue;
        }
        let path = folder.join(&file.path);
        match (FileInHand::read(&path), std::fs::metadata(&path)) {
            (Ok(got), Ok(metadata)) if got.digest == file.sha256 && metadata.len() == file.size => {}
            (Ok(got), Ok(metadata)) => {
                findings.add(changed, place, expected, format!("{} bytes, SHA-256 {}", metadata.len(), got.digest));
            }
            (Err(e), _) => findings.add(changed, place, expected, e.source),
            (_, Err(e)) => findings.add(changed, place, expected, e),
        }
    }
    findings.0.len() - before
}

/// The files that the manifest does not name; gives how many.
pub(crate) fn strangers(
    manifest: &Manifest,
    folder: &Path,
    name: &str,
    except: &[&str],
    unknown: Code,
    findings: &mut Findings,
) -> Result<usize, StoreError> {
    let named: BTreeSet<&str> = manifest.files.iter().map(|file| file.path.as_str()).collect();
    let mut strangers = Vec::new();
    files::walk(folder, &mut |path, _| {
        if !named.contains(path) && !except.contains(&path) {
            strangers.push(path.to_owned());
        }
    })?;
    for path in &strangers {
        findings.add(unknown, format!("{name}/{path}"), "a file that the manifest names", "another file");
    }
    Ok(strangers.len())
}

/// Checks the working state against its seal.
pub(super) fn check(files: &Files, findings: &mut Findings) -> Result<(), StoreError> {
    let (seal, working) = (files.registry().join("working.seal"), files.registry().join("working"));
    let place = "registry/working.seal";
    let json = match files::read(&seal, MAX_BYTES) {
        Ok(Some(json)) => json,
        Ok(None) => {
            let got = "none: the registry is running, or was not stopped cleanly";
            findings.add(Code::WorkingUnsealed, place, "a seal", got);
            return Ok(());
        }
        Err(cause) => {
            findings.add(Code::WorkingSeal, place, "a seal", cause);
            return Ok(());
        }
    };
    match Manifest::parse(&json) {
        Err(cause) => findings.add(Code::WorkingSeal, place, "a seal of version 1", cause),
        Ok(mut manifest) => {
            // The seal's paths begin where it lies.
            for file in &mut manifest.files {
                match file.path.strip_prefix("working/") {
                    Some(path) => file.path = path.to_owned(),
                    None => {
                        findings.add(Code::WorkingSeal, place, "files of working/", &file.path);
                        return Ok(());
                    }
                }
            }
            let codes = [Code::WorkingMismatch, Code::WorkingMismatch];
            if compare(&manifest, &working, "registry/working", &[], codes, findings)? == 0 {
                findings.add(Code::WorkingVerified, place, "", format!("{} files", manifest.files.len()));
            }
        }
    }
    Ok(())
}

/// Reads the manifest at `path`: none where there is none.
pub(crate) fn read_manifest(path: &Path) -> Result<Option<Manifest>, String> {
    files::read(path, MAX_BYTES)?.map(|json| Manifest::parse(&json)).transpose()
}
