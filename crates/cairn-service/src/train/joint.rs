//! The scenes of one training. Most have one; several are marked together with one
//! detector for all, and any of them may go on from an earlier model instead of
//! starting over. Stage 1 takes them one after another, each as if the job were its own.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use cairn_log::Digest;
use cairn_mark::{Detector, MarkedField, Signal, emblem};
use cairn_scene::SceneFolder;
use cairn_scene::cluster::Clusters;

use crate::error::EngineError;
use crate::store::classes::Share;
use crate::store::hidden;
use crate::store::model::{self, BaseFiles, MarkFiles, Model, ModelInfo};
use crate::store::scenes;
use crate::train::clusters::{all_are_kept, clusters_if_any, identities};
use crate::train::job::Job;
use crate::train::jobs::Control;
use crate::train::marks::Grown;
use crate::train::screen::Screen;
use crate::train::stages::Photographs;

/// A scene of a training.
pub(crate) struct Part {
    /// The job as if it were of this scene alone.
    pub(crate) job: Job,
    /// Where the scene's part of the job is kept.
    pub(crate) folder: PathBuf,
    /// The scene with the views to train on.
    pub(crate) scene: SceneFolder,
    /// Their photographs.
    pub(crate) photographs: Photographs,
    /// Over those views.
    pub(crate) clusters: Clusters,
    /// The model that it goes on from.
    pub(crate) earlier: Option<ModelInfo>,
}

/// The job's scenes, screened; `None` when it was asked to stop.
pub(crate) fn parts(
    scenes: &Path,
    models: &Path,
    screen: &Screen<'_>,
    job: &Job,
    folder: &Path,
    control: &Control<'_>,
) -> Result<Option<Vec<Part>>, EngineError> {
    let mut parts = Vec::new();
    for (at, name) in job.spec.scenes().enumerate() {
        let own = job.of_scene(at);
        let folder = if at == 0 { folder.to_path_buf() } else { folder.join(format!("scene-{}", at + 1)) };
        std::fs::create_dir_all(&folder).map_err(EngineError::io("create", &folder))?;
        let scene = scenes::open(scenes, name)?;
        let photographs = Photographs::default();
        let Some(scene) = screen.screened(&own, scene, &photographs, &folder, control)? else { return Ok(None) };
        let (clusters, note) = clusters_if_any(&scene, &own.spec.grouping, own.spec.seed, own.spec.base_only)?;
        note.into_iter().for_each(|note| control.note(note));
        let earlier = own.spec.grow_from.first().cloned().flatten();
        let earlier = earlier.map(|from| model::of_job(models, name, &from)).transpose()?;
        parts.push(Part { job: own, folder, scene, photographs, clusters, earlier });
    }
    Ok(Some(parts))
}

/// Whether the newest model of each scene is this job's. Its number alone does not
/// say: numbers start again where somebody emptied the folder of jobs.
pub(crate) fn are_published(models: &Path, parts: &[Part]) -> Result<bool, EngineError> {
    for Part { job, clusters, .. } in parts {
        let Some(model) = model::newest(models, &job.spec.scene)? else { return Ok(false) };
        let is_it = model.job == job.id
            && model.seed == job.spec.seed.to_string()
            && model.settings == Digest::of(job.spec.settings.to_toml()?)
            && model.clusters == *clusters
            && model.mark.is_none() == job.spec.base_only;
        if !is_it {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Puts a scene's model in its place.
pub(crate) fn publish(
    models: &Path,
    part: &Part,
    base: &BaseFiles,
    mark: Option<&MarkFiles>,
    shares: &[Share],
) -> Result<(), EngineError> {
    let spec = &part.job.spec;
    let settings = spec.settings.to_toml()?;
    let info = ModelInfo {
        format_version: model::VERSION,
        scene: spec.scene.clone(),
        job: part.job.id.clone(),
        seed: spec.seed.to_string(),
        identities: identities(&part.scene, &part.clusters),
        clusters: part.clusters.clone(),
        base_field: Digest::of(&base.field),
        share_table: Digest::of(&base.share_table),
        places: Digest::of(&base.places),
        without_share: base.without_share.clone(),
        settings: Digest::of(&settings),
        mark: mark.map(|files| files.info(shares)),
    };
    model::publish(models, &info, base, &settings, mark)
}

/// What the parts go on from; `None` where all begin.
pub(crate) fn grown(models: &Path, parts: &[Part]) -> Result<Option<Grown>, EngineError> {
    let mut detector: Option<Detector> = None;
    let (mut fields, mut known, mut signals): (Vec<MarkedField>, _, _) = (Vec::new(), Vec::new(), Vec::new());
    for part in parts {
        let now = identities(&part.scene, &part.clusters);
        let Some(info) = part.earlier.clone() else {
            known.extend(now.iter().map(|_| None));
            signals.extend(now.iter().map(|_| None));
            continue;
        };
        // Views may have been excluded since the job was accepted.
        all_are_kept(&info, &now)?;
        let before: BTreeMap<String, u32> = info.identities.iter().map(|i| (i.label.clone(), i.number)).collect();
        let Model { info, mark, .. } = Model::load(models, info)?;
        let mark = mark.ok_or_else(|| EngineError::Internal(format!("{} has no marks to go on from", info.job)))?;
        for identity in &now {
            let number = before.get(&identity.label).copied();
            known.push(number.map(|number| (fields.len(), number, mark.classes.of(number))));
            signals.push(number.and_then(|number| mark.signals.get(number as usize - 1).cloned()));
        }
        fields.push(mark.field);
        detector.get_or_insert(mark.detector);
    }
    Ok(detector.map(|detector| Grown { detector, fields, known, signals }))
}

/// What each scene has of the detector's classes; nothing where there is one scene.
pub(crate) fn shares(parts: &[Part]) -> Vec<Share> {
    if parts.len() < 2 {
        return Vec::new();
    }
    let labels = |part: &Part| identities(&part.scene, &part.clusters).into_iter().map(|i| i.label).collect();
    parts.iter().map(|part| Share { scene: part.job.spec.scene.clone(), labels: labels(part) }).collect()
}

/// What each scene's identities hide: what they hid before, else what the job brought for those
/// that it adds, in their order, else emblems of their own.
pub(crate) fn signals(
    job: &Job,
    folder: &Path,
    parts: &[Part],
    grown: Option<&Grown>,
) -> Result<Vec<Vec<Signal>>, EngineError> {
    let mark = &job.spec.settings.mark;
    // Emblems are drawn by number: those that are taken are not drawn again.
    let drawn = grown.map_or(0, |grown| grown.detector.classes() - 1);
    let mut before = grown.iter().flat_map(|grown| grown.signals.clone());
    let (mut all, mut added) = (Vec::new(), 0);
    for part in parts {
        let mut own = Vec::new();
        for _ in 0..part.clusters.clusters.len() {
            own.push(match (before.next().flatten(), job.spec.signals.get(added)) {
                (Some(before), _) => before,
                (None, kinds) => {
                    added += 1;
                    match kinds {
                        Some(kinds) => hidden::kept(folder, added, *kinds, mark)?,
                        None => emblem(drawn + added - 1, mark.side_px(), job.spec.seed).into(),
                    }
                }
            });
        }
        all.push(own);
    }
    Ok(all)
}
