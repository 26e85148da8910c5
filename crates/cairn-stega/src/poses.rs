//! Virtual poses: between a cluster's photographs lie views that nobody took.
//! Stage 2 needs no photographs, so it can train on them as well, and be judged
//! on others.

use cairn_capture::{Camera, Pose};
use cairn_cluster::Clusters;
use cairn_field::Appearance;
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

/// A view is mixed with one of so many of its nearest: half-way to one from the other
/// side lies inside what was photographed.
const NEAREST: usize = 6;

/// Draws up to `count` virtual views of cluster `identity` from its `members`;
/// each belongs to the cluster by the clusters' own rule.
pub fn virtual_views(
    clusters: &Clusters,
    identity: u32,
    members: &[PlannedView],
    count: usize,
    rng: &mut ChaCha8Rng,
) -> Vec<PlannedView> {
    let mut views = Vec::with_capacity(count);
    // A cluster bent around others may refuse mixtures: bounded tries.
    for _ in 0..count * 20 {
        if views.len() == count || members.is_empty() {
            break;
        }
        let a = &members[rng.random_range(0..members.len())];
        let b = near(clusters, a, members, rng.random_range(0..NEAREST.min(members.len())));
        let (share, tint) = (rng.random_range(0.0..1.0), rng.random_range(0.0f32..1.0));
        let Some(pose) = between(&a.camera.pose, &b.camera.pose, share) else { continue };
        if clusters.identity_of(&pose).identity == Some(identity) {
            let camera = Camera { intrinsics: a.camera.intrinsics, pose };
            views.push(PlannedView { camera, appearance: a.appearance.mixed(&b.appearance, tint) });
        }
    }
    views
}

/// The member that is `rank`-th nearest to `a`, itself being the first.
fn near<'a>(clusters: &Clusters, a: &PlannedView, members: &'a [PlannedView], rank: usize) -> &'a PlannedView {
    let mut by_distance: Vec<&PlannedView> = members.iter().collect();
    let distance = |v: &PlannedView| clusters.metric.distance(&a.camera.pose, &v.camera.pose);
    by_distance.sort_by(|v, w| distance(v).total_cmp(&distance(w)));
    by_distance[rank]
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
