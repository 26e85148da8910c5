//! The quarantine: which views of a scene are left out of trainings and answers, why, and
//! what people decided about them. `DIR/quarantine/NAME.json`, one file a scene.
//!
//! Contract. What is in quarantine stays there until somebody releases or removes it. What was
//! released is not put there again by figures. A removal is written down before the
//! first byte of the photograph goes, and finished at the next start where it was cut off.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use cairn_log::Digest;
use cairn_scene::{SceneFolder, View};
use serde::{Deserialize, Serialize};

use crate::error::EngineError;
use crate::store::access::unix_s;
use crate::store::folder::{read_json, write_json};
use crate::store::model::{IdentityInfo, ModelInfo};
use crate::store::scenes;
use cairn_durable::{remove, sync_folder};

/// A view that is, or was, in quarantine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    /// Its name.
    pub view: String,
    /// Who brought it.
    pub contributor: String,
    /// SHA-256 of its photograph.
    pub photograph: Digest,
    /// What holds of it now.
    pub standing: Standing,
    /// Why it came here; `None` where somebody removed it without.
    pub found: Option<Found>,
    /// What a person decided last.
    pub decided: Option<Decision>,
}

/// What holds of a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Standing {
    /// Left out until somebody decides.
    Quarantined,
    /// A person says it is good.
    Released,
    /// Being removed: the next start goes on with it.
    Removing,
    /// Gone, with its photograph.
    Removed,
}

/// What screening found; see cairn-field's `screening`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Found {
    /// The training that found it.
    pub job: String,
    /// How much better it fits its own pose than others, dB.
    pub fit_db: f64,
    /// How far that is from the median view, in robust standard deviations; below 0 where it fits worse.
    pub deviations: f64,
    /// The median view's fit, dB.
    pub median_db: f64,
    /// What an outlier stays below, dB.
    pub limit_db: f64,
    /// When, seconds since 1970.
    pub unix_s: u64,
}

/// A person's word.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Decision {
    /// Id of the account; `None` where the daemon asks nobody who they are.
    pub by: Option<Digest>,
    /// When, seconds since 1970.
    pub unix_s: u64,
}

#[derive(Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Stored {
    format_version: u32,
    /// By name.
    views: Vec<Entry>,
}

impl Entry {
    /// Whether the view is left out of trainings and answers.
    pub fn is_out(&self) -> bool {
        self.standing != Standing::Released
    }

    fn is_of(&self, view: &str, photograph: &Digest) -> bool {
        self.view == view && self.photograph == *photograph
    }
}

/// Contributors with how many photographs each took, most first, then by name.
pub type Credited = Vec<(String, usize)>;

/// Everything that is known of a scene's views, by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Entries(pub Vec<Entry>);

impl Entries {
    /// Names of the scene's views that are left out, and of those that a person released.
    pub fn names(&self, scene: &SceneFolder) -> (BTreeSet<String>, BTreeSet<String>) {
        let of = |out: bool| {
            let bound = |(at, view): &(usize, &View)| {
                let photograph = Digest::from_bytes(scene.photograph_digest(*at));
                self.0.iter().any(|e| e.is_out() == out && e.is_of(&view.name, &photograph))
            };
            let views = scene.capture().views.iter().enumerate().filter(bound);
            views.map(|(_, view)| view.name.clone()).collect()
        };
        (of(true), of(false))
    }

    /// Which views of a model's identities are left out, by their index in its clusters.
    pub fn out_of(&self, info: &ModelInfo) -> BTreeSet<usize> {
        let mut out = BTreeSet::new();
        for (identity, cluster) in info.identities.iter().zip(&info.clusters.clusters) {
            for (at, member) in cluster.members.iter().enumerate() {
                if self.0.iter().any(|e| e.is_out() && is_at(e, identity, at)) {
                    out.insert(*member);
                }
            }
        }
        out
    }

    /// Who took an identity's photographs that are not left out, as [`IdentityInfo::contributors`]; `None` where
    /// all of them are.
    pub fn credited(&self, identity: &IdentityInfo) -> Option<Credited> {
        let mut left = identity.views.len();
        let mut credited = identity.contributors.clone();
        for at in 0..identity.views.len() {
            let Some(entry) = self.0.iter().find(|e| e.is_out() && is_at(e, identity, at)) else { continue };
            left -= 1;
            if let Some((_, count)) = credited.iter_mut().find(|(name, _)| *name == entry.contributor) {
                *count = count.saturating_sub(1);
            }
        }
        credited.retain(|(_, count)| *count > 0);
        credited.sort_by(|a, b| b.1.cmp(&a.1).then_with(|| a.0.cmp(&b.0)));
        (left > 0 || identity.views.is_empty()).then_some(credited)
    }
}

/// Whether an entry is about the identity's view at a place.
fn is_at(entry: &Entry, identity: &IdentityInfo, at: usize) -> bool {
    let photograph = identity.photographs.get(at);
    photograph.is_some_and(|photograph| entry.is_of(&identity.views[at], photograph))
}

/// The quarantines of all scenes.
#[derive(Debug)]
pub struct Quarantine {
    folder: PathBuf,
    /// One change at a time.
    changing: Mutex<()>,
    /// How often anything changed since the start.
    changes: AtomicU64,
}

impl Quarantine {
    /// Opens them, drops those of scenes that are gone, and finishes removals that were cut off.
    ///
    /// # Errors
    /// [`EngineError::Stored`] for a damaged file, and the file system's.
    pub fn open(folder: PathBuf, scenes: &Path) -> Result<Self, EngineError> {
        std::fs::create_dir_all(&folder).map_err(EngineError::io("create", &folder))?;
        let made = Self { folder, changing: Mutex::default(), changes: AtomicU64::new(0) };
        for entry in std::fs::read_dir(&made.folder).map_err(EngineError::io("list", &made.folder))? {
            let path = entry.map_err(EngineError::io("list", &made.folder))?.path();
            let name = path.file_name().and_then(|n| n.to_str()?.strip_suffix(".json"));
            match name.filter(|name| scenes.join(name).is_dir()) {
                Some(name) => made.finish_removals(name, scenes)?,
                None => remove(&path)?,
            }
        }
        Ok(made)
    }

    fn lock(&self) -> MutexGuard<'_, ()> {
        self.changing.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn file(&self, scene: &str) -> PathBuf {
        self.folder.join(format!("{scene}.json"))
    }

    /// What is known of a scene's views.
    ///
    /// # Errors
    /// [`EngineError::Stored`], and for a name that no scene can have.
    pub fn of(&self, scene: &str) -> Result<Entries, EngineError> {
        scenes::check_scene_name(scene)?;
        let path = self.file(scene);
        if !path.exists() {
            return Ok(Entries::default());
        }
        let stored: Stored = read_json(&path)?;
        Ok(Entries(stored.views))
    }

    /// How often what is left out has changed since the start, in any scene.
    pub fn changes(&self) -> u64 {
        self.changes.load(Ordering::Acquire)
    }

    /// Whether views of a scene were removed.
    ///
    /// # Errors
    /// As [`Quarantine::of`].
    pub fn has_removed(&self, scene: &str) -> Result<bool, EngineError> {
        Ok(self.of(scene)?.0.iter().any(|entry| entry.standing == Standing::Removed))
    }

    fn write(&self, scene: &str, mut views: Vec<Entry>) -> Result<(), EngineError> {
        views.sort_by(|a, b| a.view.cmp(&b.view));
        let written = write_json(&self.file(scene), &Stored { format_version: 1, views });
        self.changes.fetch_add(1, Ordering::AcqRel);
        written
    }

    /// The scene without what is left out.
    ///
    /// # Errors
    /// As [`Quarantine::of`].
    pub fn without(&self, name: &str, scene: SceneFolder) -> Result<SceneFolder, EngineError> {
        let (out, _) = self.of(name)?.names(&scene);
        Ok(leaving_out(scene, &out))
    }

    /// Puts views in quarantine that screening found; those that it knows stay as they are. Durable on return.
    ///
    /// # Errors
    /// [`EngineError::Stored`], and the file system's.
    pub fn put(&self, scene: &str, found: Vec<Entry>) -> Result<(), EngineError> {
        let _changing = self.lock();
        let mut entries = self.of(scene)?.0;
        for new in found {
            if !entries.iter().any(|e| e.is_of(&new.view, &new.photograph)) {
                entries.retain(|e| e.view != new.view);
                entries.push(new);
            }
        }
        self.write(scene, entries)
    }

    /// Lets views go: from the next training on they are trained on again, and figures do not bring them back.
    /// What holds of them then.
    ///
    /// # Errors
    /// [`EngineError::NotFound`] for a view that is not in quarantine; then nothing has changed.
    pub fn release(&self, scene: &str, views: &[String], by: Option<Digest>) -> Result<Vec<Entry>, EngineError> {
        let _changing = self.lock();
        let mut entries = self.of(scene)?.0;
        let held = |e: &Entry| e.standing == Standing::Quarantined;
        for name in views {
            if !entries.iter().any(|e| e.view == *name && held(e)) {
                let there = entries.iter().filter(|e| held(e)).map(|e| e.view.as_str());
                return Err(EngineError::not_found("view in quarantine", name, there));
            }
        }
        let mut released = Vec::with_capacity(views.len());
        for entry in entries.iter_mut().filter(|e| views.contains(&e.view)) {
            entry.standing = Standing::Released;
            entry.decided = Some(Decision { by, unix_s: unix_s() });
            released.push(entry.clone());
        }
        self.write(scene, entries)?;
        Ok(released)
    }

    /// Removes views of a scene for good, photographs and all, whether they are in quarantine or not. Durable on
    /// return. Nobody MUST train on the scene meanwhile. What holds of them then.
    ///
    /// # Errors
    /// [`EngineError::NotFound`]; [`EngineError::WrongState`] where nothing to train on would be left. Then
    /// nothing has changed.
    pub fn remove(
        &self,
        name: &str,
        scene: &SceneFolder,
        views: &[String],
        by: Option<Digest>,
    ) -> Result<Vec<Entry>, EngineError> {
        let _changing = self.lock();
        let capture = scene.capture();
        let indices =
            views.iter().map(|view| crate::store::scenes::view_index(capture, view)).collect::<Result<Vec<_>, _>>()?;
        if capture.training().all(|view| indices.contains(&view)) {
            let what = format!("{} views of scene {name:?}", indices.len());
            let why = "no view to train on would be left; delete the scene instead".to_owned();
            return Err(EngineError::WrongState { what, operation: "removed", why });
        }
        let mut entries = self.of(name)?.0;
        let decided = Some(Decision { by, unix_s: unix_s() });
        for index in indices {
            let (view, photograph) = (&capture.views[index], Digest::from_bytes(scene.photograph_digest(index)));
            let known = entries.iter().find(|e| e.is_of(&view.name, &photograph));
            let found = known.and_then(|e| e.found.clone());
            entries.retain(|e| e.view != view.name);
            let (view, contributor) = (view.name.clone(), view.contributor.clone());
            let (standing, decided) = (Standing::Removing, decided.clone());
            entries.push(Entry { view, contributor, photograph, standing, found, decided });
        }
        self.write(name, entries)?;
        self.finish(name, scene)?;
        Ok(self.of(name)?.0.into_iter().filter(|e| views.contains(&e.view)).collect())
    }

    fn finish_removals(&self, name: &str, scenes: &Path) -> Result<(), EngineError> {
        if self.of(name)?.0.iter().any(|e| e.standing == Standing::Removing) {
            self.finish(name, &scenes::open(scenes, name)?)?;
        }
        Ok(())
    }

    /// Carries out what was written down.
    fn finish(&self, name: &str, scene: &SceneFolder) -> Result<(), EngineError> {
        let mut entries = self.of(name)?.0;
        let going = |e: &&Entry| e.standing == Standing::Removing;
        let names: Vec<&str> = entries.iter().filter(going).map(|e| e.view.as_str()).collect();
        scene.without_for_good(&names)?;
        for entry in entries.iter_mut().filter(|e| e.standing == Standing::Removing) {
            tracing::warn!(scene = name, view = entry.view, contributor = entry.contributor, "view removed");
            entry.standing = Standing::Removed;
        }
        self.write(name, entries)
    }

    /// The scene is gone.
    ///
    /// # Errors
    /// The file system's.
    pub fn forget(&self, scene: &str) -> Result<(), EngineError> {
        let _changing = self.lock();
        self.changes.fetch_add(1, Ordering::AcqRel);
        remove(&self.file(scene))?;
        Ok(sync_folder(&self.folder)?)
    }
}

/// The scene without the views of these names; names that it does not have change nothing.
pub fn leaving_out(scene: SceneFolder, names: &BTreeSet<String>) -> SceneFolder {
    let views = scene.capture().views.iter().enumerate();
    let out = views.filter(|(_, view)| names.contains(&view.name)).map(|(at, _)| at).collect();
    scene.leaving_out(out)
}

#[cfg(test)]
#[path = "quarantine_tests.rs"]
mod tests;
