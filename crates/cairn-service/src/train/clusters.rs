//! Which views a training puts together, and what the identities of these clusters are called.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use cairn_log::Digest;
use cairn_scene::SceneFolder;
use cairn_scene::cluster::{ClusterConfig, ClusterError, Clusters, Grouping};

use crate::error::EngineError;
use crate::store::model::{IdentityInfo, ModelInfo};

/// Clusters over the scene's training views, in their order. Around anchors with a K of 0: of as many
/// views as there are for each ([`cairn_scene::cluster::ClusterConfig::within`]).
///
/// # Errors
/// [`EngineError::Invalid`] where the scene has too few views for what is asked.
pub fn clusters(scene: &SceneFolder, grouping: &Grouping, seed: u64) -> Result<Clusters, EngineError> {
    let capture = scene.capture();
    let (mut poses, mut contributors) = (Vec::new(), Vec::new());
    for index in scene.training() {
        poses.push(capture.views[index].camera.pose);
        contributors.push(capture.views[index].contributor.clone());
    }
    let grouping = match *grouping {
        Grouping::Anchors(config) if config.neighbours == 0 => Grouping::Anchors(config.within(poses.len())),
        given => given,
    };
    Ok(Clusters::build(&poses, &grouping, &contributors, seed)?)
}

/// As [`clusters`], for a training that may mark nothing. That needs no clusters: where the scene has not the views for those
/// asked for, all views are one, and what to say of it comes with them. A later training with marks makes its own.
///
/// # Errors
/// [`EngineError::Invalid`] where the scene has too few views for what is asked.
pub fn clusters_if_any(
    scene: &SceneFolder,
    grouping: &Grouping,
    seed: u64,
    base_only: bool,
) -> Result<(Clusters, Option<String>), EngineError> {
    let why = match clusters(scene, grouping, seed) {
        Err(EngineError::Cluster(
            why @ (ClusterError::TooFewViews { .. }
            | ClusterError::TooFewPoses { .. }
            | ClusterError::NoContributor { .. }),
        )) if base_only => why,
        made => return made.map(|clusters| (clusters, None)),
    };
    let views = scene.training().count();
    let all = ClusterConfig { anchors: 1, neighbours: views.max(1), ..ClusterConfig::default() };
    let note = format!("all {views} training views are one cluster, which a base field needs no more of ({why})");
    Ok((clusters(scene, &Grouping::Anchors(all), seed)?, Some(note)))
}

/// What the clusters' identities are called, and whose photographs they are.
pub fn identities(scene: &SceneFolder, clusters: &Clusters) -> Vec<IdentityInfo> {
    let capture = scene.capture();
    let training: Vec<usize> = scene.training().collect();
    let describe = |cluster: &cairn_scene::cluster::Cluster| {
        let anchor = &capture.views[training[cluster.anchor]];
        let members: Vec<usize> = cluster.members.iter().map(|m| training[*m]).collect();
        IdentityInfo {
            number: cluster.identity,
            label: match clusters.grouping() {
                Grouping::Anchors(_) => format!("anchor-{}", anchor.name),
                Grouping::ByContributor { .. } => anchor.contributor.clone(),
            },
            views: members.iter().map(|m| capture.views[*m].name.clone()).collect(),
            photographs: members.iter().map(|m| Digest::from_bytes(scene.photograph_digest(*m))).collect(),
            contributors: contributors(members.iter().map(|m| capture.views[*m].contributor.as_str())),
        }
    };
    clusters.clusters.iter().map(describe).collect()
}

/// Refuses to go on from `earlier` where one of its identities is not among `now`: nothing would read its mark any more.
///
/// # Errors
/// [`EngineError::Invalid`] naming those that are missing.
pub fn all_are_kept(earlier: &ModelInfo, now: &[IdentityInfo]) -> Result<(), EngineError> {
    let is_kept = |label: &str| now.iter().any(|identity| identity.label == label);
    let lost = earlier.identities.iter().map(|i| i.label.as_str()).filter(|label| !is_kept(label));
    let lost: Vec<&str> = lost.collect();
    if lost.is_empty() {
        return Ok(());
    }
    let got = format!("without {}, marked by {}, whose marks nobody would read any more", lost.join(", "), earlier.job);
    let (scene, seed) = (&earlier.scene, &earlier.seed);
    let grouping = match earlier.clusters.grouping() {
        Grouping::Anchors(c) => format!("{} anchors or more of {} views, seed {seed}", c.anchors, c.neighbours),
        Grouping::ByContributor { .. } => "clusters by contributor, as small as then or smaller".to_owned(),
    };
    let expected = format!(
        "all {} identities that {scene:?} has, and more: {grouping}, over the views of then (`cairn scene check {scene}` shows \
         which went or came back since); or train it anew, without growing",
        earlier.identities.len()
    );
    Err(EngineError::invalid(format!("the clusters of {scene:?}"), got, expected))
}

/// Contributors of the photographs with how many each took, most first, then by name.
fn contributors<'a>(of_photographs: impl Iterator<Item = &'a str>) -> Vec<(String, usize)> {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for name in of_photographs {
        *counts.entry(name).or_default() += 1;
    }
    let mut counted: Vec<(String, usize)> = counts.into_iter().map(|(name, count)| (name.to_owned(), count)).collect();
    // The sort is stable: equal counts stay in the order of names.
    counted.sort_by_key(|(_, count)| Reverse(*count));
    counted
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contributors_are_counted_most_first_then_by_name() {
        let names = ["visitor-31", "drone-2", "ada", "drone-2", "drone-2", "ada", "zoe", "zoe"];
        let wanted = [("drone-2", 3), ("ada", 2), ("zoe", 2), ("visitor-31", 1)].map(|(n, c)| (n.to_owned(), c));
        assert_eq!(contributors(names.into_iter()), wanted);
        assert_eq!(contributors(std::iter::empty()), []);
    }
}
