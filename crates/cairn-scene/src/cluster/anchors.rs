//! Clusters around anchors: farthest-point sampling, then the nearest views.

use crate::cameras::pose::Pose;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::cluster::clusters::{Cluster, ClusterConfig, ClusterError, Clusters, Grouping, Reference};
use crate::cluster::metric::PoseMetric;

/// Builds M clusters of at most K views (more only where several are exactly as
/// far as the K-th); see [`Clusters::build`].
pub(crate) fn build(poses: &[Pose], config: &ClusterConfig, seed: u64) -> Result<Clusters, ClusterError> {
    let &ClusterConfig { anchors, neighbours, direction_weight } = config;
    let views = poses.len();
    if anchors.saturating_mul(neighbours) > views {
        return Err(ClusterError::TooFewViews { anchors, neighbours, views });
    }
    let metric = PoseMetric::new(poses, direction_weight);
    let anchors = choose(poses, &metric, anchors, seed)?;
    let distances: Vec<Vec<f64>> =
        anchors.iter().map(|&a| poses.iter().map(|p| metric.distance(&poses[a], p)).collect()).collect();
    let clusters: Vec<Cluster> = (0..anchors.len()).map(|i| cluster(i, anchors[i], neighbours, &distances)).collect();
    let mut references: Vec<Reference> = clusters
        .iter()
        .flat_map(|c| c.members.iter().map(|&view| (view, c.identity)))
        .map(|(view, identity)| Reference { view, identity: Some(identity), pose: poses[view] })
        .collect();
    references.sort_by_key(|r| r.view);
    Ok(Clusters { metric, clusters, grouping: Grouping::Anchors(*config), references })
}

/// `count` views that are spread over the capture, in the order chosen.
fn choose(poses: &[Pose], metric: &PoseMetric, count: usize, seed: u64) -> Result<Vec<usize>, ClusterError> {
    // The bias of the remainder is below 1e-14 for any capture, and the same on every platform.
    let first = (ChaCha8Rng::seed_from_u64(seed).next_u64() % poses.len() as u64) as usize;
    let mut chosen = vec![first];
    let mut nearest: Vec<f64> = poses.iter().map(|p| metric.distance(&poses[first], p)).collect();
    while chosen.len() < count {
        // The first of the farthest, so that ties go to the lower index.
        let farthest = (0..poses.len()).fold(0, |best, i| if nearest[i] > nearest[best] { i } else { best });
        if nearest[farthest] == 0.0 {
            return Err(ClusterError::TooFewPoses { anchors: count, distinct: chosen.len() });
        }
        chosen.push(farthest);
        for (d, pose) in nearest.iter_mut().zip(poses) {
            *d = d.min(metric.distance(&poses[farthest], pose));
        }
    }
    Ok(chosen)
}

/// The cluster around anchor number `index`, given every anchor's distance to every view.
fn cluster(index: usize, anchor: usize, neighbours: usize, distances: &[Vec<f64>]) -> Cluster {
    let own = &distances[index];
    let mut ranked: Vec<usize> = (0..own.len()).collect();
    ranked.sort_by(|&a, &b| own[a].total_cmp(&own[b]).then(a.cmp(&b)));
    // A pose cannot tell two views apart that are exactly as far, so both are in.
    let reach = own[ranked[neighbours - 1]];
    // On a tie between anchors the earlier one has the view.
    let is_nearest = |view: usize| {
        distances
            .iter()
            .enumerate()
            .all(|(j, other)| if j < index { own[view] < other[view] } else { own[view] <= other[view] })
    };
    let ground: Vec<usize> = ranked.into_iter().filter(|&view| is_nearest(view)).collect();
    let (members, outside): (Vec<usize>, Vec<usize>) = ground.into_iter().partition(|&view| own[view] <= reach);
    let farthest = members.last().map_or(0.0, |&view| own[view]);
    let radius = outside.first().map_or(farthest, |&next| 0.5 * (farthest + own[next]));
    Cluster { identity: index as u32 + 1, anchor, members, radius }
}
