//! Virtual views that come and go while stage 2 trains.
//!
//! A training that sees the same views again and again learns them by heart: a mark moves to where these very views
//! read it best, and is missed from others. What a view costs is its ray weights, some tenths of a second; so a
//! virtual one can give its place to another every few steps, and a training sees hundreds of poses in the memory
//! that dozens take. Which comes when follows from the seed alone, so that a training that is resumed goes on with
//! the same.

use crate::stega::poses::{PlannedView, virtual_views};
use cairn_scene::cluster::Clusters;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::collections::HashSet;

/// Streams of fresh views' draws, apart from those of steps and the judge.
const STREAM: u64 = 1 << 35;

/// Where fresh views come from, and where they go.
pub(crate) struct Stream {
    seed: u64,
    of: Vec<Source>,
}

/// Of one identity.
struct Source {
    /// Its number in its scene.
    identity: u32,
    /// The poses that fresh views are mixtures of.
    members: Vec<PlannedView>,
    /// How many views, the last of its own, give their places in turn.
    places: usize,
}

/// A view that takes another's place.
pub(crate) struct Fresh {
    /// Whose, from 0.
    pub(crate) identity: usize,
    /// Its place among the identity's views: photographs' poses come first, then virtual ones.
    pub(crate) place: usize,
    pub(crate) view: PlannedView,
}

impl Stream {
    pub(crate) fn new(seed: u64) -> Self {
        Self { seed, of: Vec::new() }
    }

    /// One more identity, with views of `members` and `places` virtual ones behind them.
    pub(crate) fn add(&mut self, identity: u32, members: Vec<PlannedView>, places: usize) {
        self.of.push(Source { identity, members, places });
    }

    /// The `k`-th fresh view: identities take turns, and the places of each. `None` where the identity whose turn it is
    /// has no virtual views, or the poses drawn are none of its cluster's.
    pub(crate) fn fresh(&self, clusters: &Clusters, k: u64) -> Option<Fresh> {
        let (identity, place) = self.place(k)?;
        let Source { identity: number, members, .. } = &self.of[identity];
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(STREAM + k);
        let view = virtual_views(clusters, *number, members, 1, &mut rng).pop()?;
        Some(Fresh { identity, place, view })
    }

    /// What the first `count` fresh views leave: the last that came to each place.
    pub(crate) fn last(&self, clusters: &Clusters, count: u64) -> Vec<Fresh> {
        let all: usize = self.of.iter().map(|of| of.places).sum();
        let (mut left, mut taken) = (Vec::new(), HashSet::new());
        for k in (0..count).rev() {
            if taken.len() == all {
                break;
            }
            let Some(at) = self.place(k).filter(|at| !taken.contains(at)) else { continue };
            if let Some(fresh) = self.fresh(clusters, k) {
                taken.insert(at);
                left.push(fresh);
            }
        }
        left
    }

    /// How many views of `identity` (from 0) never give their places away.
    pub(crate) fn members(&self, identity: usize) -> usize {
        self.of[identity].members.len()
    }

    /// Whose turn the `k`-th is, from 0, and which of its places'.
    fn place(&self, k: u64) -> Option<(usize, usize)> {
        let identity = k.checked_rem(self.of.len() as u64)? as usize;
        let Source { members, places, .. } = &self.of[identity];
        let turn = (k / self.of.len() as u64).checked_rem(*places as u64)?;
        Some((identity, members.len() + turn as usize))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_field::Appearance;
    use cairn_scene::cluster::{ClusterConfig, Grouping};
    use cairn_scene::{Camera, Distortion, Intrinsics, Pose};
    use glam::{DMat3, DVec3};
    use std::collections::HashMap;

    /// Twelve views from a ring in two clusters, and each one's views.
    fn clustered() -> (Clusters, [Vec<PlannedView>; 2]) {
        let intrinsics =
            Intrinsics { width: 8, height: 8, fx: 8.0, fy: 8.0, cx: 4.0, cy: 4.0, distortion: Distortion::default() };
        let pose = |i: usize| {
            let at = DMat3::from_rotation_z((30.0 * i as f64).to_radians()) * DVec3::new(3.0, 0.0, 0.5);
            Pose::look_at(at, DVec3::ZERO, DVec3::Z).unwrap()
        };
        let poses: Vec<Pose> = (0..12).map(pose).collect();
        let grouping = Grouping::Anchors(ClusterConfig { anchors: 2, neighbours: 5, ..ClusterConfig::default() });
        let clusters = Clusters::build(&poses, &grouping, &[], 5).unwrap();
        let of = |identity| {
            let own = poses.iter().filter(|pose| clusters.identity_of(pose).identity == Some(identity));
            let view = |pose: &Pose| PlannedView {
                camera: Camera { intrinsics, pose: *pose },
                appearance: Appearance::neutral([0.0; 3]),
            };
            own.map(view).collect()
        };
        let members = [of(1), of(2)];
        (clusters, members)
    }

    #[test]
    fn fresh_views_take_the_virtual_ones_places_in_turn_and_are_the_same_each_time() {
        let (clusters, members) = clustered();
        let stream = || {
            let mut stream = Stream::new(3);
            (1..).zip(&members).for_each(|(identity, members)| stream.add(identity, members.clone(), 2));
            stream
        };
        let (one, another) = (stream(), stream());
        let mut seen: Vec<DVec3> = Vec::new();
        for k in 0..12u64 {
            let Fresh { identity, place, view } = one.fresh(&clusters, k).expect("a view between five");
            assert_eq!(identity as u64, k % 2);
            assert_eq!(place as u64, members[identity].len() as u64 + k / 2 % 2);
            assert_eq!(clusters.identity_of(&view.camera.pose).identity, Some(identity as u32 + 1));
            let at = view.camera.pose.position;
            assert!(seen.iter().all(|other| other.distance(at) > 1e-6), "view {k} came before");
            assert_eq!(another.fresh(&clusters, k).unwrap().view.camera, view.camera);
            seen.push(at);
        }
    }

    #[test]
    fn what_is_left_is_the_last_of_each_place() {
        let (clusters, members) = clustered();
        let mut stream = Stream::new(3);
        (1..).zip(&members).for_each(|(identity, members)| stream.add(identity, members.clone(), 3));
        for count in [0, 1, 5, 6, 7, 20] {
            let mut one_by_one = HashMap::new();
            for fresh in (0..count).filter_map(|k| stream.fresh(&clusters, k)) {
                one_by_one.insert((fresh.identity, fresh.place), fresh.view.camera);
            }
            let left = stream.last(&clusters, count);
            assert_eq!(left.len(), one_by_one.len(), "{count}");
            for fresh in left {
                assert_eq!(one_by_one[&(fresh.identity, fresh.place)], fresh.view.camera, "{count}");
            }
        }
        // Only as many are drawn as there are places.
        assert_eq!(stream.last(&clusters, 1_000_000_000_000).len(), 6);
    }

    #[test]
    fn who_has_no_virtual_views_keeps_the_others() {
        let (clusters, members) = clustered();
        let mut stream = Stream::new(3);
        stream.add(1, members[0].clone(), 0);
        stream.add(2, members[1].clone(), 1);
        assert!(stream.fresh(&clusters, 0).is_none() && stream.fresh(&clusters, 1).is_some());
    }
}
