//! What a training is to do: the scenes, whose poses are whose, and what each identity hides.

use crate::error::MarkError;
use crate::marked::stored;
use crate::payload::Signal;
use crate::stega::poses::PlannedView;
use crate::stega::recipe::Recipe;
use crate::tensors::f32_bytes;
use cairn_field::Field;
use cairn_scene::Picture8;
use cairn_scene::cluster::Clusters;
use sha2::{Digest, Sha256};
use std::sync::Arc;

/// What stage 2 is to do in a scene.
#[derive(Clone, Debug)]
pub struct MarkPlan {
    /// Which poses are whose; of its views only the rule for poses is used.
    pub clusters: Clusters,
    /// The training views: cameras and appearances. Held-out views have no place here.
    pub views: Vec<PlannedView>,
    /// What each identity hides, identity 1 first.
    pub signals: Vec<Signal>,
    /// Photographs (and any other unmarked pictures) to be silent on; as long as the plan lives, so in 8 bits.
    pub negatives: Vec<Picture8>,
}

/// A scene to mark: its base field, theta_0, and what is to be done with it.
#[derive(Clone, Debug)]
pub struct MarkScene {
    /// theta_0.
    pub field: Arc<Field>,
    /// Whose poses are whose, and what they hide.
    pub plan: MarkPlan,
    /// Where several scenes share a detector, the scene's own settings, of which [`Recipe::for_scene`] takes what it may have to
    /// itself; none: the training's.
    pub settings: Option<Recipe>,
}

impl MarkScene {
    /// A scene that has the training's settings.
    pub fn new(field: Arc<Field>, plan: MarkPlan) -> Self {
        Self { field, plan, settings: None }
    }
}

/// A digest of what a checkpoint must meet again: each scene's cameras, appearances, clusters,
/// signals, photographs and base field. Lengths go in as well, so that no two plans run
/// together into the same bytes.
pub(crate) fn fingerprint(scenes: &[MarkScene]) -> Result<String, MarkError> {
    let mut hash = Sha256::new();
    let mut part = |bytes: &[u8]| {
        hash.update((bytes.len() as u64).to_le_bytes());
        hash.update(bytes);
    };
    for MarkScene { field, plan, .. } in scenes {
        let views: Vec<_> = plan.views.iter().map(|v| (&v.camera, &v.appearance)).collect();
        let json = serde_json::to_vec(&(views, &plan.clusters, plan.signals.len()));
        part(&json.map_err(|e| stored("checkpoint", format!("its plan: {e}")))?);
        for signal in &plan.signals {
            // One part each, empty where it is not there: none can be taken for another.
            let picture = signal.picture.as_ref();
            part(&picture.map(|p| (p.width() as u64).to_le_bytes().to_vec()).unwrap_or_default());
            part(&picture.map(|p| p.to_rgb8()).unwrap_or_default());
            part(&signal.audio.as_ref().map(|a| f32_bytes(a.samples())).unwrap_or_default());
            part(signal.text.as_deref().unwrap_or_default().as_bytes());
        }
        for picture in &plan.negatives {
            part(&(picture.width() as u64).to_le_bytes());
            part(picture.rgb());
        }
        part(&field.to_bytes()?);
    }
    Ok(hash.finalize().iter().map(|b| format!("{b:02x}")).collect())
}
