//! The registry's signed word on a view's shares: what stands beside a complete answer, for an auditor to work out again.

use std::collections::HashMap;

use cairn_log::Digest;
use cairn_log::PublicKey;
use cairn_log::format::record::Seen;
use cairn_log::format::shares::{
    ContributorShares, PhotographShare, Sampled, SharedFiles, SharedView, Shares, VERSION,
};
use cairn_share::Sharpness;

use crate::error::EngineError;
use crate::query::coverage::{self, Contributors};
use crate::store::model::ModelInfo;
use crate::store::snapshot::SceneSnapshot;

/// Whose word it is, and when it is given.
#[derive(Clone, Copy, Debug)]
pub struct Signer<'a> {
    /// The log's name.
    pub origin: &'a str,
    /// The registry's key.
    pub key: PublicKey,
    /// The log's newest checkpoint.
    pub checkpoint: Seen,
}

/// What the registry is to sign of the view of the full name `view`: `found` are all contributors to what it shows, of
/// the model that says `info` of itself.
///
/// # Errors
/// [`EngineError::NotFound`] for another view.
pub fn shares(
    snapshot: &SceneSnapshot,
    info: &ModelInfo,
    view: &str,
    found: &Contributors,
    signer: Signer<'_>,
) -> Result<Shares, EngineError> {
    let camera = snapshot.camera_of(view)?;
    let sampled = coverage::sampled(&camera).intrinsics;
    let views = || snapshot.scene.capture().views.iter().enumerate();
    let digest_of = |i: usize| Digest::from_bytes(snapshot.scene.photograph_digest(i));
    let digests: HashMap<&str, Digest> = views().map(|(i, view)| (view.name.as_str(), digest_of(i))).collect();
    let excluded = views().filter(|(_, view)| snapshot.is_out(&view.name));
    let excluded = excluded.map(|(i, view)| SharedView { name: view.name.clone(), photograph: digest_of(i) });
    let photograph = |(name, share): &(String, f64)| {
        let photograph = digests.get(name.as_str()).copied()?;
        Some(PhotographShare { view: name.clone(), photograph, share: *share })
    };
    let contributor = |of: &coverage::ContributorShare| ContributorShares {
        name: of.name.clone(),
        share: of.share,
        photographs: of.photographs.iter().filter_map(photograph).collect(),
    };
    Ok(Shares {
        version: VERSION,
        origin: signer.origin.to_owned(),
        registry_key: signer.key,
        scene: snapshot.name.clone(),
        view: SharedView { name: view.to_owned(), photograph: snapshot.photograph_of(view)? },
        camera: serde_json::to_value(camera).map_err(|e| EngineError::invalid("the view's camera", e, "JSON"))?,
        files: SharedFiles {
            base_field: info.base_field,
            share_table: info.share_table,
            settings: info.settings,
            marked_field: info.mark.as_ref().map(|mark| mark.marked_field),
        },
        power: Sharpness::default().power(),
        sampled: Sampled { width: sampled.width as u32, height: sampled.height as u32 },
        contributors: found.shares.iter().map(contributor).collect(),
        excluded: found.excluded,
        excluded_views: excluded.collect(),
        unseen: found.unseen,
        behind: found.behind,
        checkpoint: signer.checkpoint,
    })
}
