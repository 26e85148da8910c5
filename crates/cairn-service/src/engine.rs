//! The engine: everything the daemon does, knowing no gRPC. It owns one data
//! folder: scenes, training jobs, models, and the log of owner records.
//!
//! All calls block, some for long; the edge puts them on threads of their own.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use cairn_log::witness::WitnessClient;
use cairn_log::{Digest, Registry};
use cairn_scene::SceneFolder;

use crate::config::{Config, Limits};
use crate::error::EngineError;
use crate::records::published::LastPublished;
use crate::records::publisher::Publisher;
use crate::records::{anchor, registry_key};
use crate::store::access::Access;
use crate::store::folder::DataFolder;
use crate::store::hidden::Parts;
use crate::store::model::{Model, ModelInfo};
use crate::store::quarantine::Quarantine;
use crate::store::{model, quarantine, scenes};
use crate::train::jobs::Jobs;
use crate::train::training;

/// One data folder at work.
pub struct Engine {
    pub(crate) jobs: Jobs,
    /// Before the registry: it publishes a last time when it is dropped.
    pub(crate) publisher: Publisher,
    pub(crate) registry: Arc<Registry>,
    pub(crate) access: Arc<Access>,
    pub(crate) quarantine: Arc<Quarantine>,
    pub(crate) limits: Limits,
    /// The training settings that the daemon's own file sets, TOML.
    pub(crate) configured: String,
    /// The model used last: loading one takes seconds, and queries come in rows.
    pub(crate) cache: Mutex<Option<Arc<Model>>>,
    // Last, so that the folder is let go when all else in it is closed.
    pub(crate) folder: DataFolder,
}

impl Engine {
    /// Opens the data folder, re-reads the log of owner records, and goes on with
    /// the trainings that were cut off.
    ///
    /// # Errors
    /// [`EngineError::Locked`] while another process has the folder;
    /// [`EngineError::KeyMissing`], [`EngineError::SealingKeyMissing`]; what the stored files say.
    pub fn open(data: &Path, config: &Config) -> Result<Self, EngineError> {
        let folder = DataFolder::open(data)?;
        let key = registry_key::open(&folder, config.registry_key_file.as_deref())?;
        let anchor = anchor::of(data, config.anchor_file.as_deref())?;
        let registry = Arc::new(Registry::open_anchored(&folder.registry(), key, &config.origin, anchor)?);
        let witnesses = config
            .witnesses
            .iter()
            .map(|w| WitnessClient::new(w.verifier.clone(), &w.url))
            .collect::<Result<_, _>>()?;
        let last = LastPublished::of(folder.last_checkpoint(), data, &registry.public_key());
        let publisher = Publisher::start(registry.clone(), last, witnesses)?;
        let quarantine = Arc::new(Quarantine::open(folder.quarantine(), &folder.scenes())?);
        let work = training::Training {
            quarantine: quarantine.clone(),
            scenes: folder.scenes(),
            models: folder.models(),
            jobs: folder.jobs(),
            checkpoint_every: Duration::from_secs(config.checkpoint_every_s),
        };
        let access = Arc::new(Access::open(&folder, config.access.quota)?);
        access.follow_all(&registry)?;
        // The daemon may have died between a removal and giving its owner back what was removed.
        for name in scenes::list(&folder.scenes())? {
            if quarantine.has_removed(&name)? {
                give_back(&access, &folder.scenes(), &name);
            }
        }
        let jobs = Jobs::open(folder.jobs(), config.limits.queue_length, Some(access.clone()), work)?;
        folder.seal_at_end();
        Ok(Self {
            folder,
            jobs,
            registry,
            publisher,
            access,
            quarantine,
            limits: config.limits.clone(),
            configured: config.training_configured.clone(),
            cache: Mutex::new(None),
        })
    }

    /// The training jobs.
    pub fn jobs(&self) -> &Jobs {
        &self.jobs
    }

    /// The log of owner records.
    pub fn registry(&self) -> &Registry {
        &self.registry
    }

    /// Accounts, quotas and owners.
    pub fn access(&self) -> &Access {
        &self.access
    }

    /// Begins an import, which `owner` is charged with from now on.
    ///
    /// # Errors
    /// As [`scenes::Import::begin`]; the quota's.
    pub fn begin_import(&self, plan: scenes::ImportPlan, owner: Option<Digest>) -> Result<scenes::Import, EngineError> {
        let mut import = scenes::Import::begin(plan, &self.limits, &self.folder.scenes(), &self.folder.staging())?;
        if let Some(owner) = owner {
            import.owned = Some(self.access.reserve(owner, &import.id(), import.takes())?);
        }
        Ok(import)
    }

    /// Ends an import; the scene is durable on return.
    ///
    /// # Errors
    /// As [`scenes::Import::finish`].
    pub fn finish_import(&self, mut import: scenes::Import) -> Result<SceneFolder, EngineError> {
        let place = self.access.place(import.scene(), self.folder.scenes().join(import.scene()))?;
        let owned = import.owned.take();
        self.access.announce(&place, owned.as_ref())?;
        match import.finish(&self.folder.scenes()) {
            Ok(scene) => {
                self.access.became(&place, owned);
                Ok(scene)
            }
            Err(error) => {
                // The first error is the one to tell; what is left of the second is cleared at the next start.
                let _ = self.access.announce(&place, None);
                Err(error)
            }
        }
    }

    /// Names of all scenes, sorted.
    ///
    /// # Errors
    /// The file system's.
    pub fn scene_names(&self) -> Result<Vec<String>, EngineError> {
        scenes::list(&self.folder.scenes())
    }

    /// One scene.
    ///
    /// # Errors
    /// [`EngineError::NotFound`], and cairn-scene's.
    pub fn scene(&self, name: &str) -> Result<SceneFolder, EngineError> {
        scenes::open(&self.folder.scenes(), name)
    }

    /// One scene without the views that are in quarantine.
    ///
    /// # Errors
    /// As [`Engine::scene`].
    pub fn sound_scene(&self, name: &str) -> Result<SceneFolder, EngineError> {
        self.quarantine.without(name, self.scene(name)?)
    }

    /// The views of a scene that are, or were, in quarantine, by name.
    ///
    /// # Errors
    /// As [`Engine::scene`].
    pub fn quarantined(&self, scene: &str) -> Result<Vec<quarantine::Entry>, EngineError> {
        self.scene(scene)?;
        self.quarantine.of(scene)
    }

    /// Names of the scene's views that are left out.
    ///
    /// # Errors
    /// [`EngineError::Stored`].
    pub fn out_of_scene(&self, name: &str, scene: &SceneFolder) -> Result<BTreeSet<String>, EngineError> {
        Ok(self.quarantine.names(name, scene)?.0)
    }

    /// Lets views out of quarantine; see [`Quarantine::release`].
    ///
    /// # Errors
    /// As there, and [`Engine::scene`]'s.
    pub fn release_views(
        &self,
        scene: &str,
        views: &[String],
        by: Option<Digest>,
    ) -> Result<Vec<quarantine::Entry>, EngineError> {
        self.scene(scene)?;
        self.quarantine.release(scene, views, by)
    }

    /// Removes views of a scene for good; see [`Quarantine::remove`].
    ///
    /// # Errors
    /// As there; [`EngineError::WrongState`] while a job trains on the scene.
    pub fn remove_views(
        &self,
        scene: &str,
        views: &[String],
        by: Option<Digest>,
    ) -> Result<Vec<quarantine::Entry>, EngineError> {
        let folder = self.scene(scene)?;
        self.refuse_in_training(scene, format!("views of scene {scene:?}"), "removed")?;
        let removed = self.quarantine.remove((scene, &folder), views, by)?;
        give_back(&self.access, &self.folder.scenes(), scene);
        Ok(removed)
    }

    /// Refuses what must not be done while a job trains on a scene.
    fn refuse_in_training(&self, scene: &str, what: String, operation: &'static str) -> Result<(), EngineError> {
        match self.jobs.list().iter().find(|j| j.spec.is_of(scene) && !j.state.has_ended()) {
            Some(job) => {
                let why = format!("{} is {} on it; cancel that first", job.id, job.state.name());
                Err(EngineError::WrongState { what, operation, why })
            }
            None => Ok(()),
        }
    }

    /// What the scene's newest model says of itself; `None` before the first.
    ///
    /// # Errors
    /// [`EngineError::Stored`].
    pub fn newest_model(&self, scene: &str) -> Result<Option<ModelInfo>, EngineError> {
        scenes::check_scene_name(scene)?;
        model::newest(&self.folder.models(), scene)
    }

    /// Deletes a scene with its models.
    ///
    /// # Errors
    /// [`EngineError::WrongState`] while a job trains on it.
    pub fn delete_scene(&self, name: &str) -> Result<(), EngineError> {
        scenes::check_scene_name(name)?;
        let path = self.folder.scenes().join(name);
        if !path.is_dir() {
            self.scene(name)?;
        }
        self.refuse_in_training(name, format!("scene {name:?}"), "deleted")?;
        // Out of the way at once, so that no half of it can be read.
        let gone = self.folder.staging().join(format!("deleted-{name}"));
        cairn_durable::remove(&gone)?;
        std::fs::rename(&path, &gone).map_err(EngineError::io("delete", &path))?;
        cairn_durable::sync_folder(&self.folder.scenes())?;
        self.access.forget(name)?;
        self.quarantine.forget(name)?;
        cairn_durable::remove(&self.folder.models().join(name))?;
        *self.cache.lock().unwrap_or_else(PoisonError::into_inner) = None;
        Ok(cairn_durable::remove(&gone)?)
    }

    /// The scene's newest model, loaded.
    ///
    /// # Errors
    /// [`EngineError::NotTrained`]; [`EngineError::Stored`] for a file that was altered.
    pub fn model(&self, scene: &str) -> Result<Arc<Model>, EngineError> {
        let Some(info) = self.newest_model(scene)? else {
            self.scene(scene)?;
            return Err(EngineError::NotTrained { scene: scene.to_owned() });
        };
        let mut cache = self.cache.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(model) = cache.as_ref().filter(|m| m.info == info) {
            return Ok(model.clone());
        }
        // The old one goes first: two large fields may not fit at once.
        *cache = None;
        let model = Arc::new(Model::load(&self.folder.models(), info)?);
        *cache = Some(model.clone());
        Ok(model)
    }

    /// The files of an identity's hidden signal.
    ///
    /// # Errors
    /// [`EngineError::NotFound`], [`EngineError::Stored`].
    pub fn signal(&self, info: &ModelInfo, identity: u32) -> Result<Parts<Vec<u8>>, EngineError> {
        info.signal(&self.folder.models(), identity)
    }

    /// Checkpoints and stops training, and lets the folder go when dropped. Blocks.
    pub fn shut_down(&self) {
        self.jobs.shut_down();
    }

    /// Publishes what is left. After the last request: what comes in later is published at the next start.
    pub fn close(&self) {
        self.publisher.stop();
    }
}

/// Charges a scene's owner, if any, with no more than what is left of it: the removed views are gone in any case.
fn give_back(access: &Access, scenes: &Path, scene: &str) {
    if let Err(error) = scenes::open(scenes, scene).and_then(|left| access.lower(scene, &left)) {
        tracing::warn!(scene, %error, "removed views stay charged until a start at which they can be measured");
    }
}
