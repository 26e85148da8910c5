//! Virtual poses: between a cluster's photographs lie views that nobody took.
//! Stage 2 needs no photographs, so it can train on them as well, and be judged
//! on others.

use cairn_field::Appearance;
use cairn_scene::cluster::Clusters;
use cairn_scene::{Camera, Pose};
use glam::{DMat3, DQuat};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// A pose to render, as whose view.
#[derive(Clone, Debug)]
pub struct PlannedView {
    /// The camera.
    pub camera: Camera,
    /// The view's appearance.
    pub appearance: Appearance,
}

/// The pose a share of the way from `a` to `b`: position on the line, rotation
/// on the great arc. `None` when the mixture is no rotation.
pub fn between(a: &Pose, b: &Pose, share: f64) -> Option<Pose> {
    let rotation = DQuat::from_mat3(&a.rotation).slerp(DQuat::from_mat3(&b.rotation), share);
    Pose::new(DMat3::from_quat(rotation), a.position.lerp(b.position, share)).ok()
}

/// A view is mixed with one of so many of its nearest.
const NEAREST: usize = 12;
/// And with none that looks further away than this, radians: half-way to one from the other side lies inside what was
/// photographed.
const MAX_APART: f64 = std::f64::consts::FRAC_PI_3;
/// How far beyond either view a mixture may lie, as a share of the way between them.
const BEYOND: f64 = 0.25;
/// Of so many mixtures the one is taken that looks furthest away from all photographs: marks are missed from where nobody
/// stood, and mixtures of neighbours are seldom there.
const CANDIDATES: usize = 4;

/// Mixtures that are tried for each that is wanted.
const TRIES: usize = 20;

/// Draws up to `count` virtual views of cluster `identity` from its `members`, rather where these look far apart;
/// each belongs to the cluster by the clusters' own rule.
pub fn virtual_views(
    clusters: &Clusters,
    identity: u32,
    members: &[PlannedView],
    count: usize,
    rng: &mut ChaCha8Rng,
) -> Vec<PlannedView> {
    let mut views = Vec::with_capacity(count);
    let away = |view: &PlannedView| members.iter().map(|m| apart(m, view)).fold(f64::INFINITY, f64::min);
    while views.len() < count && !members.is_empty() {
        let candidates: Vec<PlannedView> =
            (0..CANDIDATES).filter_map(|_| mixture(clusters, identity, members, rng)).collect();
        let Some(best) = candidates.into_iter().max_by(|a, b| away(a).total_cmp(&away(b))) else { break };
        views.push(best);
    }
    views
}

/// A mixture of two views that belongs to the cluster.
fn mixture(clusters: &Clusters, identity: u32, members: &[PlannedView], rng: &mut ChaCha8Rng) -> Option<PlannedView> {
    // A cluster bent around others may refuse mixtures: bounded tries.
    (0..TRIES).find_map(|_| {
        let a = &members[rng.random_range(0..members.len())];
        let b = near(clusters, a, members, rng.random_range(0..NEAREST.min(members.len())));
        let (share, tint) = (rng.random_range(-BEYOND..1.0 + BEYOND), rng.random_range(0.0f32..1.0));
        let pose = between(&a.camera.pose, &b.camera.pose, share).filter(|_| apart(a, b) <= MAX_APART)?;
        let camera = Camera { intrinsics: a.camera.intrinsics, pose };
        let own = clusters.identity_of(&pose).identity == Some(identity);
        own.then(|| PlannedView { camera, appearance: a.appearance.mixed(&b.appearance, tint) })
    })
}

/// The angle between two views' ways of looking, radians.
fn apart(a: &PlannedView, b: &PlannedView) -> f64 {
    let [a, b] = [a, b].map(|v| DQuat::from_mat3(&v.camera.pose.rotation));
    a.angle_between(b)
}

/// The member that is `rank`-th nearest to `a`, itself being the first.
fn near<'a>(clusters: &Clusters, a: &PlannedView, members: &'a [PlannedView], rank: usize) -> &'a PlannedView {
    let mut by_distance: Vec<&PlannedView> = members.iter().collect();
    let distance = |v: &PlannedView| clusters.metric.distance(&a.camera.pose, &v.camera.pose);
    by_distance.sort_by(|v, w| distance(v).total_cmp(&distance(w)));
    by_distance[rank]
}

/// At most `most` of the views, spread over all of them.
pub(crate) fn evenly(views: Vec<PlannedView>, most: usize) -> Vec<PlannedView> {
    let stride = views.len().div_ceil(most).max(1);
    views.into_iter().step_by(stride).collect()
}

/// `some` of the views, evenly, and up to `most` where others look more than `apart_deg` degrees away from all
/// that are taken, the furthest first: networks that saw an object from two dozen sides do not know the sides between.
pub(crate) fn covering(views: Vec<PlannedView>, some: usize, most: usize, apart_deg: f64) -> Vec<PlannedView> {
    let stride = views.len().div_ceil(some).max(1);
    let mut taken: Vec<bool> = (0..views.len()).map(|i| i % stride == 0).collect();
    let nearest_taken = |v: &PlannedView| {
        let of = views.iter().step_by(stride).map(|t| apart(t, v));
        of.fold(f64::INFINITY, f64::min)
    };
    let mut away: Vec<f64> = views.iter().map(nearest_taken).collect();
    while taken.iter().filter(|t| **t).count() < most {
        let furthest = (0..views.len()).filter(|i| !taken[*i]).max_by(|a, b| away[*a].total_cmp(&away[*b]));
        let Some(furthest) = furthest.filter(|i| away[*i] > apart_deg.to_radians()) else { break };
        taken[furthest] = true;
        away.iter_mut().zip(&views).for_each(|(away, v)| *away = away.min(apart(v, &views[furthest])));
    }
    views.into_iter().zip(taken).filter_map(|(v, taken)| taken.then_some(v)).collect()
}

/// `camera` with its longest side at most `longest_px`.
pub fn at_most(camera: &Camera, longest_px: usize) -> Camera {
    let (w, h) = (camera.intrinsics.width, camera.intrinsics.height);
    let longest = w.max(h);
    if longest <= longest_px {
        return *camera;
    }
    let side = |v: usize| ((v * longest_px) as f64 / longest as f64).round().max(1.0) as usize;
    camera.resized(side(w), side(h))
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_scene::cluster::{ClusterConfig, Grouping};
    use cairn_scene::{Distortion, Intrinsics};
    use glam::DVec3;
    use rand::SeedableRng;

    /// Views from a ring, so many degrees from one to the next.
    fn ring(views: usize, step_deg: f64) -> Vec<PlannedView> {
        let intrinsics =
            Intrinsics { width: 8, height: 8, fx: 8.0, fy: 8.0, cx: 4.0, cy: 4.0, distortion: Distortion::default() };
        let view = |i: usize| {
            let at = DMat3::from_rotation_z((i as f64 * step_deg).to_radians()) * DVec3::new(3.0, 0.0, 0.5);
            let pose = Pose::look_at(at, DVec3::ZERO, DVec3::Z).unwrap();
            PlannedView { camera: Camera { intrinsics, pose }, appearance: Appearance::neutral([0.0; 3]) }
        };
        (0..views).map(view).collect()
    }

    #[test]
    fn more_views_are_taken_where_they_look_further_apart() {
        let taken = |views, step_deg| covering(ring(views, step_deg), 6, 18, 10.0).len();
        assert_eq!((taken(5, 1.0), taken(24, 1.0)), (5, 6), "what six views cover needs no more");
        assert_eq!(taken(24, 15.0), 18);
        // Every fourth, and those between that are eleven degrees from both.
        assert_eq!(taken(24, 5.5), 12);
        let far = covering(ring(24, 15.0), 6, 18, 10.0);
        let gap = |a: &PlannedView, b: &PlannedView| {
            DQuat::from_mat3(&a.camera.pose.rotation).angle_between(DQuat::from_mat3(&b.camera.pose.rotation))
        };
        assert!(far.windows(2).all(|w| gap(&w[0], &w[1]).to_degrees() < 30.5), "taken views leave a gap");
    }

    #[test]
    fn virtual_views_fill_the_gap_between_photographs() {
        // Two arcs of eight, and nobody on the 54 degrees between them on either side.
        let members: Vec<PlannedView> =
            ring(20, 18.0).into_iter().enumerate().filter(|(i, _)| i % 10 < 8).map(|(_, v)| v).collect();
        let poses: Vec<Pose> = members.iter().map(|v| v.camera.pose).collect();
        let grouping =
            Grouping::Anchors(ClusterConfig { anchors: 1, neighbours: poses.len(), ..ClusterConfig::default() });
        let clusters = Clusters::build(&poses, &grouping, &[], 5).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let views = virtual_views(&clusters, 1, &members, 400, &mut rng);
        assert_eq!(views.len(), 400);
        let away = |v: &&PlannedView| members.iter().all(|m| apart(m, v).to_degrees() > 10.0);
        let far = views.iter().filter(away).count();
        // 36; of mixtures drawn without choice 9.
        assert!(far >= 20, "{far} of 400 look more than ten degrees away from any photograph");
    }

    #[test]
    fn no_virtual_camera_stands_inside_what_few_photographs_show() {
        for count in [8, 12, 16] {
            let members = ring(count, 360.0 / count as f64);
            let poses: Vec<Pose> = members.iter().map(|v| v.camera.pose).collect();
            let grouping = ClusterConfig { anchors: 1, neighbours: count, ..ClusterConfig::default() };
            let clusters = Clusters::build(&poses, &Grouping::Anchors(grouping), &[], 5).unwrap();
            let views = virtual_views(&clusters, 1, &members, 60, &mut ChaCha8Rng::seed_from_u64(2));
            assert_eq!(views.len(), 60);
            let nearest =
                views.iter().map(|v| v.camera.pose.position.truncate().length()).fold(f64::INFINITY, f64::min);
            assert!(nearest > 0.85 * 3.0, "{count} photographs: {nearest} of 3 from the middle");
        }
    }
}
