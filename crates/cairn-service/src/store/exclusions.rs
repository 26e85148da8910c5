//! Which views of a scene are excluded: from trainings, and from answers. `DIR/exclusions/NAME.json`, one file a
//! scene, with what the last screening measured beside it.
//!
//! Contract. What is excluded stays so until a person includes it, and what a person included is never excluded by
//! the program. Photographs stay as they are.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use cairn_durable::{remove, sync_folder};
use cairn_log::Digest;
use cairn_scene::{SceneFolder, View};
use serde::{Deserialize, Serialize};

use crate::error::EngineError;
use crate::store::access::unix_s;
use crate::store::folder::{read_json, write_json};
use crate::store::model::{IdentityInfo, ModelInfo};
use crate::store::scenes;

const VERSION: u32 = 1;
/// Longest reason, bytes.
const MAX_WHY_BYTES: usize = 512;

/// A view about which something was decided.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    /// Its name.
    pub view: String,
    /// Who brought it.
    pub contributor: String,
    /// What was decided.
    pub state: State,
    /// Why.
    pub why: String,
    /// Whether the program decided.
    pub automatic: bool,
    /// Id of the account that decided; `None` where the program did, or the daemon keeps no accounts.
    pub by: Option<Digest>,
    /// When, seconds since 1970.
    pub unix_s: u64,
}

/// What was decided about a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// It teaches nothing, and nobody is credited with it.
    Excluded,
    /// A person says that it is good.
    Included,
}

/// What a screening measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Measured {
    /// The training that screened; empty where a check did.
    pub job: String,
    /// Median of the views' fits, dB.
    pub median_db: f64,
    /// What an outlier stays below, dB.
    pub limit_db: f64,
    /// Why nothing was judged; empty where something was.
    pub doubt: String,
    /// The views that were screened.
    pub scores: Vec<Score>,
}

/// What a screening measured of one view; see cairn-field's `screening`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Score {
    /// Its name.
    pub view: String,
    /// How many sigmas its fit lies below the median.
    pub score: f64,
    /// How much better the other views explain it from its own pose than from other views', dB.
    pub fit_db: f64,
    /// Whether the other views do not explain it.
    pub is_outlier: bool,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Stored {
    format_version: u32,
    /// By name.
    views: Vec<Entry>,
    measured: Option<Measured>,
}

/// A person's decision about views.
#[derive(Clone, Debug)]
pub struct Decision {
    /// What it is.
    pub state: State,
    /// Why; may be empty.
    pub why: String,
    /// The account's id, where there are accounts.
    pub by: Option<Digest>,
}

impl Entry {
    /// What a person decides now about a view.
    fn by_person(view: &View, Decision { state, why, by }: &Decision) -> Self {
        let (name, contributor) = (view.name.clone(), view.contributor.clone());
        let (state, why, by) = (*state, why.clone(), *by);
        Self { view: name, contributor, state, why, automatic: false, by, unix_s: unix_s() }
    }
}

/// Contributors with how many photographs each took, most first, then by name.
pub type Credited = Vec<(String, usize)>;

/// What was decided about a scene's views, by name, and what was measured of them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Entries {
    /// Decisions, by the views' names.
    pub views: Vec<Entry>,
    /// The last screening; `None` before the first.
    pub measured: Option<Measured>,
}

impl Entries {
    fn names(&self, state: State) -> BTreeSet<String> {
        self.views.iter().filter(|e| e.state == state).map(|e| e.view.clone()).collect()
    }

    /// Names of the views that are excluded.
    pub fn excluded(&self) -> BTreeSet<String> {
        self.names(State::Excluded)
    }

    /// Names of the views that a person included.
    pub fn included(&self) -> BTreeSet<String> {
        self.names(State::Included)
    }

    /// Which views of a model's identities are excluded, by their index in its clusters.
    pub fn out_of(&self, info: &ModelInfo) -> BTreeSet<usize> {
        let excluded = self.excluded();
        let mut out = BTreeSet::new();
        for (identity, cluster) in info.identities.iter().zip(&info.clusters.clusters) {
            let members = identity.views.iter().zip(&cluster.members);
            out.extend(members.filter(|(view, _)| excluded.contains(*view)).map(|(_, member)| *member));
        }
        out
    }

    /// Who took an identity's photographs that are not excluded, as [`IdentityInfo::contributors`]; `None` where
    /// all of them are.
    pub fn credited(&self, identity: &IdentityInfo) -> Option<Credited> {
        let mut left = identity.views.len();
        let mut credited = identity.contributors.clone();
        for entry in self.views.iter().filter(|e| e.state == State::Excluded && identity.views.contains(&e.view)) {
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

/// The exclusions of all scenes.
#[derive(Debug)]
pub struct Exclusions {
    folder: PathBuf,
    /// One change at a time.
    changing: Mutex<()>,
    /// How often anything changed since the start.
    changes: AtomicU64,
}

impl Exclusions {
    /// Opens them, and drops those of scenes that are gone.
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
                Some(name) => drop(made.of(name)?),
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
        let Stored { format_version: _, views, measured } = read_json(&path, VERSION)?;
        Ok(Entries { views, measured })
    }

    /// How often what is excluded has changed since the start, in any scene.
    pub fn changes(&self) -> u64 {
        self.changes.load(Ordering::Acquire)
    }

    fn write(&self, scene: &str, entries: Entries) -> Result<(), EngineError> {
        let Entries { mut views, measured } = entries;
        views.sort_by(|a, b| a.view.cmp(&b.view));
        let written = write_json(&self.file(scene), &Stored { format_version: VERSION, views, measured });
        self.changes.fetch_add(1, Ordering::Release);
        written
    }

    /// The scene without what is excluded.
    ///
    /// # Errors
    /// As [`Exclusions::of`].
    pub fn without(&self, name: &str, scene: SceneFolder) -> Result<SceneFolder, EngineError> {
        Ok(leaving_out(scene, &self.of(name)?.excluded()))
    }

    /// Keeps what a screening measured, and excludes the views that it gives reasons against, but for those about
    /// which something was decided. Durable on return. Names of the views that it excluded.
    ///
    /// # Errors
    /// [`EngineError::Stored`], and the file system's.
    pub fn screened(
        &self,
        name: &str,
        scene: &SceneFolder,
        measured: Measured,
        against: &[Against],
    ) -> Result<Vec<String>, EngineError> {
        let _changing = self.lock();
        let mut entries = self.of(name)?;
        let mut excluded = Vec::new();
        for Against { view, why } in against {
            let view = &scene.capture().views[*view];
            if entries.views.iter().any(|e| e.view == view.name) {
                continue;
            }
            excluded.push(view.name.clone());
            let decision = Decision { state: State::Excluded, why: why.clone(), by: None };
            entries.views.push(Entry { automatic: true, ..Entry::by_person(view, &decision) });
        }
        entries.measured = Some(measured);
        self.write(name, entries)?;
        Ok(excluded)
    }

    /// Carries out a person's decision about views. Durable on return; how many views of the scene
    /// are excluded then.
    ///
    /// # Errors
    /// [`EngineError::NotFound`] for a view that the scene has not, [`EngineError::Invalid`] for a reason that is too
    /// long, [`EngineError::WrongState`] where no view to train on would be left. Then nothing has changed.
    pub fn decide(
        &self,
        name: &str,
        scene: &SceneFolder,
        views: &[String],
        decision: &Decision,
    ) -> Result<usize, EngineError> {
        let why = &decision.why;
        if why.len() > MAX_WHY_BYTES || why.chars().any(char::is_control) {
            let expected = format!("{MAX_WHY_BYTES} bytes at most, without control characters");
            return Err(EngineError::invalid("the reason", format!("{} bytes", why.len()), expected));
        }
        let _changing = self.lock();
        let capture = scene.capture();
        let indices: BTreeSet<usize> =
            views.iter().map(|view| scenes::view_index(capture, view)).collect::<Result<_, _>>()?;
        let mut entries = self.of(name)?;
        entries.views.retain(|e| !views.contains(&e.view));
        entries.views.extend(indices.iter().map(|index| Entry::by_person(&capture.views[*index], decision)));
        let excluded = entries.excluded();
        if capture.training().all(|view| excluded.contains(&capture.views[view].name)) {
            let what = format!("{} views of scene {name:?}", views.len());
            let why = "no view to train on would be left; delete the scene instead";
            return Err(EngineError::wrong_state(what, "excluded", why));
        }
        self.write(name, entries)?;
        Ok(excluded.len())
    }

    /// The scene is gone.
    ///
    /// # Errors
    /// The file system's.
    pub fn forget(&self, scene: &str) -> Result<(), EngineError> {
        let _changing = self.lock();
        remove(&self.file(scene))?;
        self.changes.fetch_add(1, Ordering::Release);
        Ok(sync_folder(&self.folder)?)
    }
}

/// A reason to exclude a view.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Against {
    /// The view's index in its capture.
    pub view: usize,
    /// The reason.
    pub why: String,
}

/// The scene without the views of these names; names that it does not have change nothing.
pub fn leaving_out(scene: SceneFolder, names: &BTreeSet<String>) -> SceneFolder {
    let views = scene.capture().views.iter().enumerate();
    let out = views.filter(|(_, view)| names.contains(&view.name)).map(|(at, _)| at).collect();
    scene.leaving_out(out)
}

#[cfg(test)]
#[path = "exclusions_tests.rs"]
mod tests;
