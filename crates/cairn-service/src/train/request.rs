//! From a training as it is asked for to a job that is queued: everything that can be
//! refused is refused here, rather than after an hour of stage 1.

use std::collections::BTreeSet;

use cairn_log::Digest;
use cairn_mark::Recipe;
use cairn_scene::cluster::{Clusters, Grouping};

use crate::config::{Chosen, TrainingOptions, TrainingSettings};
use crate::engine::Engine;
use crate::error::EngineError;
use crate::store::given::{Added, Given, assigned, hides_note, left_over_note};
use crate::store::hidden;
use crate::store::model::{IdentityInfo, ModelInfo};
use crate::train::clusters;
use crate::train::job::{Beside, Job, JobSpec};

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
    /// The seed; 0 with `grow` is the newest model's.
    pub seed: u64,
    /// How to train.
    pub plan: Plan,
    /// What to hide, by the names of identities or else identity 1 first ([`assigned`]); empty to draw pictures. Where
    /// the training goes on from another, what the added identities hide.
    pub signals: Vec<Given>,
    /// Whether to stop after stage 1.
    pub base_only: bool,
    /// Who pays: the id of an account's key; `None` for nobody.
    pub owner: Option<Digest>,
}

/// How to train.
#[derive(Clone, Debug, PartialEq)]
pub enum Plan {
    /// By named presets with these options. A training that goes on from another keeps its settings and takes no options.
    Options(TrainingOptions),
    /// With these settings, in every scene: a program's own, which cannot be asked for over the network.
    Given(Box<TrainingSettings>),
}

impl Default for Plan {
    fn default() -> Self {
        Self::Options(TrainingOptions::default())
    }
}

/// A scene of a request.
struct Wanted {
    scene: String,
    settings: TrainingSettings,
    clusters: Clusters,
    /// Identities that have no mark yet.
    added: Vec<Added>,
    /// Labels of those that have one.
    marked: BTreeSet<String>,
    earlier: Option<ModelInfo>,
}

impl Engine {
    /// Queues a training; durable on return.
    ///
    /// # Errors
    /// For settings that are not allowed, clusters to mark that a scene has not the
    /// views for, a scene named twice, nothing to go on from or to add, clusters that leave an earlier identity out, signals
    /// that do not decode or cannot be hidden, fewer of them than identities to mark, and [`crate::train::jobs::Jobs::submit`]'s.
    pub fn train(&self, request: TrainingRequest) -> Result<Job, EngineError> {
        request.check()?;
        let request = self.as_before(request)?;
        let shared = match request.grow {
            true => Some(self.detector_of(&request.scene)?),
            false => None,
        };
        let mut wanted = vec![self.wanted(&request, &request.scene, shared.as_ref())?];
        let request = request.of_quality(wanted[0].settings.chosen);
        for scene in &request.also {
            wanted.push(self.wanted(&request, scene, shared.as_ref())?);
        }
        let (settings, marks, said) = shared_settings(&wanted);
        let added: Vec<Added> = wanted.iter().flat_map(|w| w.added.iter().cloned()).collect();
        if request.grow && added.is_empty() {
            let identities = wanted.iter().map(|w| w.clusters.clusters.len()).sum::<usize>();
            let expected = "clusters among which there is one without a mark";
            return Err(EngineError::invalid(
                "what to add",
                format!("all {identities} identities are marked"),
                expected,
            ));
        }
        let mut notes: Vec<String> = Vec::new();
        notes.extend(said);
        let marked = wanted.iter().flat_map(|w| w.marked.iter().cloned()).collect();
        let mut signals = Vec::with_capacity(added.len());
        let places = assigned(&request.signals, &added, &marked)?;
        for (identity, at) in added.iter().zip(&places) {
            let given = &request.signals[*at];
            let (signal, said) = given.signal(identity.number, &settings.mark, &self.limits)?;
            notes.push(hides_note(identity, given, &signal));
            notes.extend(said);
            signals.push(signal);
        }
        notes.extend(left_over_note(&request.signals, &places));
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
            marks,
            base_only: request.base_only,
        };
        self.jobs.submit(request.owner, spec, notes, |folder| {
            (1..).zip(&signals).try_for_each(|(number, signal)| hidden::keep(folder, number, signal))
        })
    }

    /// A request to go on in which clusters are as large as they are where it gives no size: whose views
    /// are credited does not change because somebody else's are added. Without a seed it has theirs, from which anchors follow.
    fn as_before(&self, mut request: TrainingRequest) -> Result<TrainingRequest, EngineError> {
        let Some(info) = (if request.grow { self.newest_model(&request.scene)? } else { None }) else {
            return Ok(request);
        };
        if let Grouping::Anchors(config) = &mut request.grouping
            && config.neighbours == 0
            && let Grouping::Anchors(before) = info.clusters.grouping()
        {
            config.neighbours = before.neighbours;
        }
        if request.seed == 0 {
            let unread = |_| EngineError::Internal(format!("{} has no seed but {:?}", info.job, info.seed));
            request.seed = info.seed.parse().map_err(unread)?;
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
                let why = "it has no marks yet; train it without --grow";
                Err(EngineError::wrong_state(format!("scene {scene:?}"), "grown", why))
            }
        }
    }

    /// What is wanted of `scene`; it goes on from its newest model where that has the detector `shared`.
    fn wanted(&self, request: &TrainingRequest, scene: &str, shared: Option<&Digest>) -> Result<Wanted, EngineError> {
        let folder = self.scene(scene)?;
        let newest = if shared.is_some() { self.newest_model(scene)? } else { None };
        let earlier = newest.filter(|info| info.mark.as_ref().is_some_and(|mark| Some(&mark.detector) == shared));
        let settings = match (&request.plan, &earlier) {
            (Plan::Given(settings), _) => {
                settings.check()?;
                TrainingSettings::clone(settings)
            }
            (Plan::Options(_), Some(info)) => info.settings(&self.folder.models())?,
            (Plan::Options(options), None) => options.settings(&self.training, folder.capture().kind)?,
        };
        let folder = self.exclusions.without(scene, folder)?;
        let (clusters, _) = clusters::clusters_if_any(&folder, &request.grouping, request.seed, request.base_only)?;
        let identities = clusters::identities(&folder, &clusters);
        if let Some(info) = &earlier {
            clusters::all_are_kept(info, &identities)?;
        }
        let marked: BTreeSet<String> =
            earlier.iter().flat_map(|info| info.identities.iter().map(|i| i.label.clone())).collect();
        let of_scene = if request.also.is_empty() { String::new() } else { format!(" of scene {scene:?}") };
        let new = identities.into_iter().filter(|identity| !marked.contains(&identity.label));
        let added = new.map(|IdentityInfo { number, label, .. }| Added {
            called: format!("identity {number} ({label}){of_scene}"),
            number: number as usize,
            label,
        });
        Ok(Wanted { scene: scene.into(), settings, clusters, added: added.collect(), marked, earlier })
    }
}

/// The settings of a training, what each of several scenes has its marks made by, and what to say of it.
///
/// Several scenes share classifier and detector. These are as one wants them that goes on from an earlier training, else as
/// [`Recipe::finest`] says, and sure of owners as [`Recipe::min_confidence_of`] does.
fn shared_settings(wanted: &[Wanted]) -> (TrainingSettings, Vec<Recipe>, Option<String>) {
    let of_first = wanted[0].settings.clone();
    if wanted.len() == 1 {
        return (of_first, Vec::new(), None);
    }
    let finest = Recipe::finest(wanted.iter().map(|w| &w.settings.mark));
    let shared = wanted.iter().find(|w| w.earlier.is_some()).unwrap_or(&wanted[finest]);
    let min_confidence = Recipe::min_confidence_of(wanted.iter().map(|w| &w.settings.mark));
    let mark = &Recipe { min_confidence, ..shared.settings.mark.clone() };
    let marks = wanted.iter().map(|w| mark.for_scene(&w.settings.mark)).collect();
    let finer = |w: &&Wanted| w.settings.mark.finer > mark.finer;
    let said = if let Some(w) = wanted.iter().find(finer) {
        Some(format!(
            "marks of scene {:?} want to be looked at more finely ({} times) than by the detector that is gone on from ({} times): \
             if they are not read, train all scenes from the start",
            w.scene, w.settings.mark.finer, mark.finer
        ))
    } else {
        (mark.finer != of_first.mark.finer).then(|| {
            format!(
                "all scenes are marked with classifier and detector as scene {:?} wants them, which looks at marks most finely \
                 ({} times); how strong marks are and which views are looked at is each scene's own",
                shared.scene, mark.finer
            )
        })
    };
    (TrainingSettings { mark: mark.clone(), ..of_first }, marks, said)
}

impl TrainingRequest {
    /// The request for further scenes: those that begin beside one that goes on take its quality.
    fn of_quality(mut self, chosen: Option<Chosen>) -> Self {
        if let (true, Plan::Options(options), Some(chosen)) = (self.grow, &mut self.plan, chosen) {
            (options.quality, options.robust) = (Some(chosen.quality), Some(chosen.robust));
        }
        self
    }

    fn check(&self) -> Result<(), EngineError> {
        let names: BTreeSet<&String> = self.also.iter().chain([&self.scene]).collect();
        if names.len() <= self.also.len() {
            let got = format!("{:?} beside {:?}", self.also, self.scene);
            return Err(EngineError::invalid("the scenes", got, "each scene once"));
        }
        if let (true, Plan::Options(options)) = (self.grow, &self.plan)
            && *options != TrainingOptions::default()
        {
            let expected = "none: a training that goes on keeps the earlier one's settings";
            return Err(EngineError::invalid("options", format!("{options:?}"), expected));
        }
        if self.base_only && (self.grow || !self.also.is_empty() || !self.signals.is_empty()) {
            let got = match (self.grow, self.also.is_empty()) {
                (true, _) => "grow",
                (false, false) => "other scenes",
                (false, true) => "signals to hide",
            };
            let expected = "none of them: it makes no marks";
            return Err(EngineError::invalid("a training of the base field only", got, expected));
        }
        Ok(())
    }
}
