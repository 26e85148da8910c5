//! Manifests: which files a folder has, each with its size and SHA-256. The seal of the
//! registry's working state is one, and so are those of scenes, models and jobs.
//!
//! A manifest tells bit rot and half-restored copies; who can write the folder can write
//! the manifest, so it is no defence against them. Signatures are.

use std::{collections::BTreeSet, path::Path};

use cairn_log::format::Digest;
use serde::{Deserialize, Serialize};

use super::{
    StoreError,
    files::{self, Files},
};
use crate::{FileInHand, code::Code, report::Findings};

/// Largest manifest that is read, bytes: some 500 000 files.
const MAX_BYTES: usize = 64 << 20;

/// A folder's files.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// 1.
    pub format_version: u32,
    /// All files but the manifest itself, ascending by path.
    pub files: Vec<ManifestFile>,
}

/// One file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ManifestFile {
    /// From the folder, with `/`.
    pub path: String,
    /// Bytes.
    pub size: u64,
    /// SHA-256 (hex).
    pub sha256: Digest,
}

impl Manifest {
    /// Reads a manifest; only the one way of writing it is taken (compact or indented as serde_json does), so that no
    /// byte can change unnoticed.
    ///
    /// # Errors
    /// What is wrong.
    pub fn parse(json: &[u8]) -> Result<Self, String> {
        #[derive(Deserialize)]
        struct Stated {
            format_version: u64,
        }
        let stated: Stated = serde_json::from_slice(json).map_err(|e| e.to_string())?;
        if stated.format_version != 1 {
            return Err(format!("format version {}, this release reads 1", stated.format_version));
        }
        let manifest: Self = serde_json::from_slice(json).map_err(|e| e.to_string())?;
        let compact = serde_json::to_vec(&manifest).map_err(|e| e.to_string())?;
        let indented = serde_json::to_vec_pretty(&manifest).map_err(|e| e.to_string())?;
        if json != compact && json != indented {
            return Err("not as it is written: blanks or escapes differ".to_owned());
        }
        if manifest.files.windows(2).any(|pair| pair[0].path >= pair[1].path) {
            return Err("files out of order, or one twice".to_owned());
        }
        Ok(manifest)
    }

    /// Holds the files of `folder` to the manifest. `name`: the folder's in the findings. `except`: files that are no
    /// business of the manifest. Gives how many files differ.
    pub(crate) fn compare(
        &self,
        folder: &Path,
        name: &str,
        except: &[&str],
        [changed, unknown]: [Code; 2],
        findings: &mut Findings,
    ) -> Result<usize, StoreError> {
        let differ = self.compare_listed(folder, name, changed, findings);
        Ok(differ + self.strangers(folder, name, except, unknown, findings)?)
    }

    /// The files that the manifest names; gives how many of them differ. `name`: empty where their paths say it all.
    pub(crate) fn compare_listed(&self, folder: &Path, name: &str, changed: Code, findings: &mut Findings) -> usize {
        let before = findings.0.len();
        for file in &self.files {
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
        &self,
        folder: &Path,
        name: &str,
        except: &[&str],
        unknown: Code,
        findings: &mut Findings,
    ) -> Result<usize, StoreError> {
        let named: BTreeSet<&str> = self.files.iter().map(|file| file.path.as_str()).collect();
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
            if manifest.compare(&working, "registry/working", &[], codes, findings)? == 0 {
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
