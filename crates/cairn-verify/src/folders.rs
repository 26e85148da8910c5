//! What lies beside the registry: scenes, models and jobs, each file against the
//! manifest of its folder and against the digests that tables and models name.
//!
//! Covered: every file of a scene, a model or an ended job that has a manifest, the
//! manifests, `current.json` and `format.json`; accounts, owners, the registry's key and the checkpoint published last by
//! the seal of a clean stop ([`crate::state`]). Not covered, and named so: `lock` (the number of a
//! process), jobs that have not ended and `staging` (work under way), and whatever else lies there.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use cairn_log::format::{Digest, record::photographs_root};
use serde_json::Value;

use cairn_log::format::manifest::Manifest;

use crate::{
    FileInHand,
    bounded::read,
    code::Code,
    report::{self, Finding, Findings},
    state,
    store::{Covered, Stock, StoreError, compare, read_manifest},
};

const MANIFEST: &str = "manifest.json";
/// Largest JSON file that is read, bytes.
const MAX_JSON: usize = 256 << 20;
const FORMAT: &str = "{\n  \"format_version\": 1\n}";

/// Hashes everything in the data folder `dir` but its registry. Also gives the digests that its models have, for
/// [`crate::StoreOptions::stock`].
///
/// # Errors
/// [`StoreError`] for a folder that cannot be listed.
pub fn audit_folders(dir: &Path) -> Result<(Vec<Finding>, Stock), StoreError> {
    let mut audit = Folders { dir, findings: Findings::default(), stock: Stock::default() };
    let mut state = false;
    for entry in names(dir)? {
        match entry.as_str() {
            "scenes" => audit.each("scenes", Folders::scene)?,
            "models" => audit.each("models", Folders::models)?,
            "jobs" => audit.each("jobs", Folders::job)?,
            "format.json" => audit.format(),
            "registry" => {}
            name if state::covers(name) => state = true,
            other => audit.findings.add(Code::FileUncovered, other, "", "no digest names it"),
        }
    }
    state::check(dir, state, &mut audit.findings)?;
    Ok((audit.findings.0, audit.stock))
}

struct Folders<'a> {
    dir: &'a Path,
    findings: Findings,
    stock: Stock,
}

/// Names in a folder, sorted.
fn names(folder: &Path) -> Result<Vec<String>, StoreError> {
    let failed = |source| StoreError::Io { path: folder.display().to_string(), source };
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        names.push(entry.map_err(failed)?.file_name().to_string_lossy().into_owned());
    }
    names.sort();
    Ok(names)
}

type Check<'a> = fn(&mut Folders<'a>, &str) -> Result<(), StoreError>;

impl<'a> Folders<'a> {
    /// Runs a check on every folder below `kind`.
    fn each(&mut self, kind: &str, check: Check<'a>) -> Result<(), StoreError> {
        for name in names(&self.dir.join(kind))? {
            let path = format!("{kind}/{name}");
            if name.starts_with('.') {
                self.findings.add(Code::FileUncovered, path, "", "left of work that was cut off");
            } else if self.dir.join(&path).is_dir() {
                check(self, &path)?;
            } else {
                self.findings.add(Code::FileUnknown, path, "a folder", "a file");
            }
        }
        Ok(())
    }

    fn format(&mut self) {
        let got = match read(&self.dir.join("format.json"), FORMAT.len()) {
            Ok(Some(bytes)) if bytes == FORMAT.as_bytes() => return,
            Ok(_) => "another text".to_owned(),
            Err(cause) => cause,
        };
        self.findings.add(Code::FileMismatch, "format.json", FORMAT, got);
    }

    /// Holds a folder to its manifest; the digests that it vouches for, by path.
    fn manifest(&mut self, name: &str) -> Result<BTreeMap<String, Digest>, StoreError> {
        let folder = self.dir.join(name);
        let place = format!("{name}/{MANIFEST}");
        let manifest: Manifest = match read_manifest(&folder.join(MANIFEST)) {
            Ok(Some(manifest)) => manifest,
            Ok(None) => {
                self.findings.add(Code::ManifestMissing, place, "a manifest", "none");
                return Ok(BTreeMap::new());
            }
            Err(cause) => {
                self.findings.add(Code::ManifestMalformed, place, "a manifest of version 1", cause);
                return Ok(BTreeMap::new());
            }
        };
        let before = self.findings.0.len();
        let (changed, unknown, within) = (Code::FileMismatch, Code::FileUnknown, format!("{name}/"));
        let covered = Covered { root: &folder, place: &within, folders: &[""], except: MANIFEST, changed, unknown };
        compare(&manifest, &covered, &mut self.findings)?;
        if self.findings.0.len() == before {
            self.findings.add(Code::FolderVerified, name, "", report::files(manifest.files.len()));
        }
        Ok(manifest.files.into_iter().map(|file| (file.path, file.sha256)).collect())
    }

    /// Holds one file to a digest that a table names. Where the manifest vouches for the same one its bytes were hashed already.
    fn file(&mut self, folder: &str, path: &str, named: &Value, vouched: &BTreeMap<String, Digest>) -> Option<Digest> {
        let place = format!("{folder}/{path}");
        let Some(named) = named.as_str().and_then(|hex| hex.parse::<Digest>().ok()) else {
            self.findings.add(Code::FileMismatch, place, "a digest in the table that names it", named);
            return None;
        };
        let got = match vouched.get(path) {
            Some(digest) => Ok(*digest),
            None if !Path::new(path).components().all(|c| matches!(c, std::path::Component::Normal(_))) => {
                Err("a path that leaves its folder".to_owned())
            }
            None => {
                let read = FileInHand::read(&self.dir.join(&place));
                read.map(|file| file.digest).map_err(|e| e.source.to_string())
            }
        };
        match got {
            Ok(got) if got == named => {}
            Ok(got) => self.findings.add(Code::FileMismatch, place, format!("SHA-256 {named}"), got),
            Err(cause) => self.findings.add(Code::FileMismatch, place, format!("SHA-256 {named}"), cause),
        }
        Some(named)
    }

    fn json(&mut self, path: &str) -> Option<Value> {
        let parsed = read(&self.dir.join(path), MAX_JSON)
            .and_then(|bytes| serde_json::from_slice(&bytes.ok_or("no such file")?).map_err(|e| e.to_string()));
        parsed.map_err(|cause| self.findings.add(Code::FileMismatch, path, "JSON", cause)).ok()
    }

    fn scene(&mut self, name: &str) -> Result<(), StoreError> {
        let vouched = self.manifest(name)?;
        let Some(table) = self.json(&format!("{name}/scene.json")) else { return Ok(()) };
        self.file(name, "points.bin", &table["points"]["sha256"], &vouched);
        for view in table["views"].as_array().into_iter().flatten() {
            let path = format!("photographs/{}", view["photograph"].as_str().unwrap_or_default());
            self.file(name, &path, &view["sha256"], &vouched);
        }
        Ok(())
    }

    /// All models of a scene, and which of them is the newest.
    fn models(&mut self, name: &str) -> Result<(), StoreError> {
        let scene = name.rsplit('/').next().unwrap_or(name).to_owned();
        for job in names(&self.dir.join(name))? {
            let path = format!("{name}/{job}");
            if job.starts_with('.') {
                self.findings.add(Code::FileUncovered, path, "", "left of work that was cut off");
            } else if self.dir.join(&path).is_dir() {
                let had = self.model(&path)?;
                self.stock.scenes.entry(scene.clone()).or_default().extend(had);
            } else if job != "current.json" {
                self.findings.add(Code::FileUnknown, path, "a model, or current.json", "another file");
            }
        }
        self.current(name);
        Ok(())
    }

    /// `current.json` is bound by the digest of the manifest that it leads to, and by being written in one way only.
    fn current(&mut self, name: &str) {
        let place = format!("{name}/current.json");
        let bytes = read(&self.dir.join(&place), MAX_JSON).ok().flatten().unwrap_or_default();
        let current: Value = serde_json::from_slice(&bytes).unwrap_or_default();
        let job = current["job"].as_str().unwrap_or_default();
        let manifest = FileInHand::read(&self.dir.join(name).join(job).join(MANIFEST));
        let text = |digest: &Digest| {
            format!("{{\n  \"format_version\": 1,\n  \"job\": \"{job}\",\n  \"manifest\": \"{digest}\"\n}}")
        };
        if !manifest.is_ok_and(|file| text(&file.digest).as_bytes() == bytes) {
            let expected = "the name of a model and the SHA-256 of its manifest";
            self.findings.add(Code::FileMismatch, place, expected, current);
        }
    }

    /// A model; the digests by which records may name it.
    fn model(&mut self, name: &str) -> Result<BTreeSet<Digest>, StoreError> {
        let vouched = self.manifest(name)?;
        let mut had = BTreeSet::new();
        let Some(model) = self.json(&format!("{name}/model.json")) else { return Ok(had) };
        had.extend(self.file(name, "base.field", &model["base_field"], &vouched));
        had.extend(self.file(name, "settings.toml", &model["settings"], &vouched));
        if let Some(mark) = model.get("mark").filter(|mark| !mark.is_null()) {
            had.extend(self.file(name, "marked.field", &mark["marked_field"], &vouched));
            had.extend(self.file(name, "detector", &mark["detector"], &vouched));
            for (number, signal) in (1..).zip(mark["signals"].as_array().into_iter().flatten()) {
                for (ending, part) in [("png", "picture"), ("wav", "audio"), ("txt", "text")] {
                    if let Some(digest) = signal.get(part) {
                        self.file(name, &format!("signal-{number}.{ending}"), digest, &vouched);
                    }
                }
            }
        }
        for identity in model["identities"].as_array().into_iter().flatten() {
            let photographs = identity["photographs"].as_array().into_iter().flatten();
            let digests: Option<Vec<Digest>> = photographs.map(|d| d.as_str()?.parse().ok()).collect();
            had.extend(digests.map(|digests| photographs_root(&digests)));
        }
        Ok(had)
    }

    fn job(&mut self, name: &str) -> Result<(), StoreError> {
        self.manifest(name).map(drop)
    }
}
