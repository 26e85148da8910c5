//! Clusters by contributor: who took the nearest view has the pose.

use std::collections::BTreeMap;

use crate::cameras::pose::Pose;
use crate::capture::UNKNOWN_CONTRIBUTOR;

use crate::cluster::clusters::{Cluster, ClusterError, Clusters, Grouping, Reference};
use crate::cluster::metric::PoseMetric;

/// A pose belongs to a contributor up to this many times the median distance
/// between one of their views and their next.
const REACH: f64 = 2.0;

/// Views that the median is taken over; more would say the same and cost more.
const SAMPLE: usize = 1000;

/// Builds one cluster a contributor; see [`Clusters::build`].
pub(crate) fn build(
    poses: &[Pose],
    contributors: &[String],
    min_views: usize,
    direction_weight: f64,
) -> Result<Clusters, ClusterError> {
    if contributors.len() != poses.len() {
        return Err(ClusterError::ContributorCount { views: poses.len(), contributors: contributors.len() });
    }
    let metric = PoseMetric::new(poses, direction_weight);
    let shared = shared(poses, contributors, &metric);
    let mut views: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (view, contributor) in contributors.iter().enumerate() {
        if !shared[view] && contributor != UNKNOWN_CONTRIBUTOR {
            views.entry(contributor).or_default().push(view);
        }
    }
    let most = views.iter().map(|(name, v)| (v.len(), *name)).max_by_key(|&(count, _)| count).unwrap_or((0, ""));
    views.retain(|_, v| v.len() >= min_views);
    if views.is_empty() {
        return Err(ClusterError::NoContributor { min_views, contributor: most.1.to_owned(), most: most.0 });
    }
    let clusters: Vec<Cluster> =
        views.into_values().enumerate().map(|(i, members)| cluster(i as u32 + 1, members, poses, &metric)).collect();
    let mut references: Vec<Reference> =
        poses.iter().enumerate().map(|(view, &pose)| Reference { view, identity: None, pose }).collect();
    for cluster in &clusters {
        for &view in &cluster.members {
            references[view].identity = Some(cluster.identity);
        }
    }
    let grouping = Grouping::ByContributor { min_views, direction_weight };
    Ok(Clusters { metric, clusters, grouping, references })
}

/// Which views stand exactly where another contributor's does.
fn shared(poses: &[Pose], contributors: &[String], metric: &PoseMetric) -> Vec<bool> {
    // Coincident views are neighbours in the order of any one coordinate, up to
    // the metric's rounding, so only a short run after each needs looking at.
    let unit = if metric.spread() > 0.0 { metric.spread() } else { f64::INFINITY };
    let along = |view: usize| poses[view].position.x / unit;
    let mut order: Vec<usize> = (0..poses.len()).collect();
    order.sort_by(|&a, &b| along(a).total_cmp(&along(b)));
    let mut shared = vec![false; poses.len()];
    for (at, &a) in order.iter().enumerate() {
        for &b in order[at + 1..].iter().take_while(|&&b| along(b) - along(a) < 1e-6) {
            if contributors[a] != contributors[b] && metric.distance(&poses[a], &poses[b]) == 0.0 {
                shared[a] = true;
                shared[b] = true;
            }
        }
    }
    shared
}

/// The cluster of one contributor's views (at least two).
fn cluster(identity: u32, mut members: Vec<usize>, poses: &[Pose], metric: &PoseMetric) -> Cluster {
    let middle = members.iter().map(|&v| poses[v].position / members.len() as f64).sum();
    let forward = members.iter().map(|&v| poses[v].forward()).sum::<glam::DVec3>();
    // The metric only reads positions and viewing directions, so a pose with
    // their means is the members' middle, whatever its other two axes are.
    let mean = Pose {
        rotation: glam::DMat3::from_cols(glam::DVec3::ZERO, glam::DVec3::ZERO, forward.normalize_or_zero()),
        position: middle,
    };
    let from_mean = |v: usize| metric.distance(&mean, &poses[v]);
    let anchor =
        members.iter().copied().fold(members[0], |best, v| if from_mean(v) < from_mean(best) { v } else { best });

    let step = members.len().div_ceil(SAMPLE);
    let next = |v: usize| {
        let others = members.iter().filter(|&&o| o != v);
        others.map(|&o| metric.distance(&poses[v], &poses[o])).fold(f64::INFINITY, f64::min)
    };
    let mut gaps: Vec<f64> = members.iter().step_by(step).map(|&v| next(v)).collect();
    gaps.sort_by(f64::total_cmp);
    let radius = REACH * gaps[gaps.len() / 2];

    let from_anchor = |v: usize| metric.distance(&poses[anchor], &poses[v]);
    members.sort_by(|&a, &b| from_anchor(a).total_cmp(&from_anchor(b)).then(a.cmp(&b)));
    Cluster { identity, anchor, members, radius }
}
