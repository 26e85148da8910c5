//! From a training as it is asked for to a job that is queued: everything that can be
//! refused is refused here, rather than after an hour of stage 1.

use std::collections::BTreeSet;

use cairn_cluster::{Clusters, Grouping};
use cairn_registry::Digest;

use super::Engine;
use super::error::EngineError;
use super::hidden::{self, Given};
use super::job::{Beside, Job, JobSpec};
use super::model::ModelInfo;
use super::training;
use crate::config::{QUICK_TOML, TrainingSettings, overlay_for, training_settings};

/// What to train, as it is asked for.
#[derive(Clone, Debug)]
pub struct TrainingRequest {
    /// The scene's name.
    pub scene: String,
    /// Other scenes to mark together with it.
    pub also: Vec<String>,
    /// Whether to go on from the newest models.
    pub grow: bool,
    /// How views become identities; a K of 0 is as many views a cluster as the scene has for it.
    pub grouping: Grouping,
    /// The seed.
    pub seed: u64,
    /// TOML that goes over the settings.
    pub settings_toml: String,
    /// What to hide, identity 1 first; empty to draw pictures. Where the training goes on from
    /// another, what the added identities hide.
    pub signals: Vec<Given>,
    /// Whether to lay the quick settings over the daemon's.
    pub quick: bool,
    /// Whether to stop after stage 1.
    pub base_only: bool,
    /// Who pays: the id of an account's key; `None` for nobody.
    pub owner: Option<Digest>,
}

/// A scene of a request.
struct Wanted {
    settings: TrainingSettings,
    clusters: Clusters,
    /// Identities that have no mark yet.
    added: usize,
    earlier: Option<ModelInfo>,
}

impl Engine {
    /// Queues a training; durable on return.
    ///
    /// # Errors
    /// For settings that are not allowed, clusters to mark that a scene has not the
    /// views for, a scene named twice, nothing to go on from or to add, signals that do not decode or
    /// cannot be hidden, and [`super::jobs::Jobs::submit`]'s.
    pub fn train(&self, request: TrainingRequest) -> Result<Job, EngineError> {
        request.check()?;
        let request = self.as_large_as_before(request)?;
        let shared = match request.grow {
            true => Some(self.detector_of(&request.scene)?),
            false => None,
        };
        let mut wanted = vec![self.wanted(&request, &request.scene, shared.as_ref())?];
        for scene in &request.also {
            wanted.push(self.wanted(&request, scene, shared.as_ref())?);
        }
        let settings = wanted[0].settings.clone();
        let added = wanted.iter().map(|w| w.added).sum::<usize>();
        if request.grow && added == 0 {
            let identities = wanted.iter().map(|w| w.clusters.clusters.len()).sum::<usize>();
            let expected = "clusters among which there is one without a mark";
            return Err(EngineError::invalid(
                "what to add",
                format!("all {identities} identities are marked"),
                expected,
            ));
        }
        if !request.signals.is_empty() && request.signals.len() < added {
            let expected = format!("none, or one for each of the {added} identities");
            return Err(EngineError::invalid("the number of signals", request.signals.len(), expected));
        }
        let mut signals = Vec::with_capacity(added);
        for (number, given) in (1..=added).zip(&request.signals) {
            signals.push(given.signal(number, &settings.mark, &self.limits)?);
        }
        let also = request.also.into_iter().zip(&wanted[1..]);
        let spec = JobSpec {
            scene: request.scene,
            also: also.map(|(scene, w)| Beside { scene, field: w.settings.field.clone() }).collect(),
            grow_from: match request.grow {
                true => wanted.iter().map(|w| w.earlier.as_ref().map(|info| info.job.clone())).collect(),
                false => Vec::new(),
            },
            grouping: request.grouping,
            seed: request.seed,
            settings,
            signals: signals.iter().map(hidden::kinds_of).collect(),
            base_only: request.base_only,
        };
        self.jobs.submit(request.owner, spec, |folder| {
            (1..).zip(&signals).try_for_each(|(number, signal)| hidden::keep(folder, number, signal))
        })
    }

    /// A request to go on in which clusters are as large as they are where it gives no size: whose views
    /// are credited does not change because somebody else's are added.
    fn as_large_as_before(&self, mut request: TrainingRequest) -> Result<TrainingRequest, EngineError> {
        if let Grouping::Anchors(config) = &mut request.grouping
            && request.grow
            && config.neighbours == 0
            && let Some(info) = self.newest_model(&request.scene)?
            && let Grouping::Anchors(before) = info.clusters.grouping()
        {
            config.neighbours = before.neighbours;
        }
        Ok(request)
    }

    /// The digest of the detector that `scene` goes on from.
    fn detector_of(&self, scene: &str) -> Result<Digest, EngineError> {
        let info = self.newest_model(scene)?;
        match info.and_then(|info| info.mark) {
            Some(mark) => Ok(mark.detector),
            None => {
                self.scene(scene)?;
                let (what, why) = (format!("scene {scene:?}"), "it has no marks yet; train it without --grow".into());
                Err(EngineError::WrongState { what, operation: "grown", why })
            }
        }
    }

    /// What is wanted of `scene`; it goes on from its newest model where that has the detector `shared`.
    fn wanted(&self, request: &TrainingRequest, scene: &str, shared: Option<&Digest>) -> Result<Wanted, EngineError> {
        let folder = self.scene(scene)?;
        let newest = if shared.is_some() { self.newest_model(scene)? } else { None };
        let earlier = newest.filter(|info| info.mark.as_ref().is_some_and(|mark| Some(&mark.detector) == shared));
        let own = ("the request's settings", request.settings_toml.as_str());
        let settings = match &earlier {
            Some(info) => {
                let before = info.settings_toml(&self.folder.models())?;
                training_settings(&self.training, &[("the earlier training's settings", &before), own])?
            }
            None => {
                // Who configured stage 1 himself is taken at his word; else the kind of scene decides.
                let configured = self.training.field != TrainingSettings::default().field;
                let kind = if configured { ("no settings", "") } else { overlay_for(folder.capture().kind) };
                let quick = ("configs/quick.toml", if request.quick { QUICK_TOML } else { "" });
                training_settings(&self.training, &[kind, quick, own])?
            }
        };
        let folder = self.quarantine.without(scene, folder)?;
        let (clusters, _) = training::clusters_if_any(&folder, &request.grouping, (request.seed, request.base_only))?;
        let known: BTreeSet<String> =
            earlier.iter().flat_map(|info| info.identities.iter().map(|i| i.label.clone())).collect();
        let identities = training::identities(&folder, &clusters);
        let added = identities.iter().filter(|identity| !known.contains(&identity.label)).count();
        if let Some(info) = earlier.as_ref().filter(|_| added == identities.len()) {
            let what = format!("none of the identities of {scene:?} that {} marked", info.job);
            return Err(EngineError::invalid("the clusters", what, "the earlier ones and more, with the same seed"));
        }
        Ok(Wanted { settings, clusters, added, earlier })
    }
}

impl TrainingRequest {
    fn check(&self) -> Result<(), EngineError> {
        let names: BTreeSet<&String> = self.also.iter().chain([&self.scene]).collect();
        if names.len() <= self.also.len() {
            let got = format!("{:?} beside {:?}", self.also, self.scene);
            return Err(EngineError::invalid("the scenes", got, "each scene once"));
        }
        if self.base_only && (self.grow || !self.also.is_empty()) {
            let got = if self.grow { "grow" } else { "other scenes" };
            let expected = "neither: what they share are marks";
            return Err(EngineError::invalid("a training of the base field only", got, expected));
        }
        Ok(())
    }
}
