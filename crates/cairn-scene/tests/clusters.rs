//! What clusters promise: the same in every unit and axes, every member told its
//! identity and nobody else, ties by index, and clear refusals.

use cairn_scene::Pose;
use cairn_scene::cluster::{ClusterConfig, ClusterError, Clusters, Grouping};
use glam::{DMat3, DQuat, DVec3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Uniform in [-1, 1].
fn number(rng: &mut ChaCha8Rng) -> f64 {
    f64::from(rng.next_u32()) / f64::from(u32::MAX) * 2.0 - 1.0
}

/// `n` cameras scattered around the origin that look roughly at it.
fn scattered(n: usize, seed: u64) -> Vec<Pose> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut vector = move |scale: f64| DVec3::new(number(&mut rng), number(&mut rng), number(&mut rng)) * scale;
    let up = DVec3::new(0.1, 1.0, 0.2);
    (0..n).map(|_| Pose::look_at(vector(5.0), vector(0.5), up).unwrap()).collect()
}

/// Cameras on a regular grid that all look the same way: full of exact ties.
fn grid(side: usize) -> Vec<Pose> {
    let place = |i: usize| DVec3::new((i % side) as f64, (i / side) as f64, 0.0);
    (0..side * side).map(|i| Pose::new(DMat3::IDENTITY, place(i)).unwrap()).collect()
}

fn anchors(m: usize, k: usize) -> Grouping {
    Grouping::Anchors(ClusterConfig { anchors: m, neighbours: k, direction_weight: 1.0 })
}

fn by_contributor(min_views: usize) -> Grouping {
    Grouping::ByContributor { min_views, direction_weight: 1.0 }
}

/// Contributors a, b, c of runs of `run` views each; the rest is unknown.
fn runs(views: usize, run: usize) -> Vec<String> {
    let name = |i: usize| ["a", "b", "c"].get(i / run).copied().unwrap_or("unknown").to_owned();
    (0..views).map(name).collect()
}

fn moved(poses: &[Pose], scale: f64, turn: DQuat, shift: DVec3) -> Vec<Pose> {
    let turn = DMat3::from_quat(turn);
    let apply = |p: &Pose| Pose { rotation: turn * p.rotation, position: turn * (p.position * scale) + shift };
    poses.iter().map(apply).collect()
}

/// Members are told their identity, and no other view is told any.
fn check_consistent(clusters: &Clusters, poses: &[Pose]) {
    let mut identity = vec![None; poses.len()];
    for (i, cluster) in clusters.clusters.iter().enumerate() {
        assert_eq!(cluster.identity as usize, i + 1);
        assert!(cluster.members.contains(&cluster.anchor));
        for &member in &cluster.members {
            assert_eq!(identity[member], None, "view {member} is in two clusters");
            identity[member] = Some(cluster.identity);
        }
        let from_anchor = |&v: &usize| clusters.metric.distance(&poses[cluster.anchor], &poses[v]);
        assert!(cluster.members.is_sorted_by(|a, b| (from_anchor(a), a) < (from_anchor(b), b)));
    }
    for (view, pose) in poses.iter().enumerate() {
        let told = clusters.identity_of(pose);
        assert_eq!(told.identity, identity[view], "view {view}: {told:?}");
        assert!(told.margin.is_finite());
        assert!(if told.identity.is_some() { told.margin >= 0.0 } else { told.margin <= 0.0 }, "{told:?}");
    }
}

#[test]
fn members_and_only_members_are_told_their_identity() {
    for seed in 0..20 {
        let poses = scattered(100, seed);
        let clusters = Clusters::build(&poses, &anchors(3, 20), &[], seed).unwrap();
        assert_eq!(clusters.clusters.len(), 3);
        assert!(clusters.clusters.iter().all(|c| c.members.len() <= 20 && c.members[0] == c.anchor));
        check_consistent(&clusters, &poses);
        let clusters = Clusters::build(&poses, &by_contributor(2), &runs(100, 25), seed).unwrap();
        assert_eq!(clusters.clusters.len(), 3);
        assert!(clusters.clusters.iter().all(|c| c.members.len() == 25));
        check_consistent(&clusters, &poses);
    }
}

#[test]
fn groups_that_are_plainly_apart_are_found_whatever_the_seed() {
    // Three tight groups of ten, far apart, in scrambled order.
    let poses: Vec<Pose> = scattered(30, 5)
        .into_iter()
        .enumerate()
        .map(|(i, p)| Pose {
            position: p.position * 0.01 + DVec3::X * (i % 3) as f64 * 10.0,
            rotation: DMat3::IDENTITY,
        })
        .collect();
    for seed in 0..10 {
        let clusters = Clusters::build(&poses, &anchors(3, 10), &[], seed).unwrap();
        for cluster in &clusters.clusters {
            let mut members = cluster.members.clone();
            members.sort_unstable();
            let group = cluster.anchor % 3;
            assert_eq!(members, (0..10).map(|i| i * 3 + group).collect::<Vec<_>>());
        }
        check_consistent(&clusters, &poses);
        // A new pose beside a group belongs to it; one between two, or far outside, to none.
        let near = Pose { position: DVec3::new(10.001, 0.0, 0.0), rotation: DMat3::IDENTITY };
        let told = clusters.identity_of(&near);
        assert_eq!(told.identity, clusters.identity_of(&poses[1]).identity);
        assert!(told.identity.is_some());
        assert_eq!(clusters.nearest(&near, 4).iter().filter(|n| n.view % 3 == 1).count(), 4);
        let outside = Pose { position: DVec3::new(10.0, 500.0, 0.0), rotation: DMat3::IDENTITY };
        let told = clusters.identity_of(&outside);
        assert!(told.identity.is_none() && told.margin < -1.0, "{told:?}");
    }
}

#[test]
fn looking_elsewhere_is_being_elsewhere() {
    // One spot, a full turn: the groups are by direction alone.
    let looking = |angle_deg: f64| {
        let angle = angle_deg.to_radians();
        Pose::look_at(DVec3::splat(3.0), DVec3::splat(3.0) + DVec3::new(angle.sin(), 0.0, angle.cos()), DVec3::Y)
            .unwrap()
    };
    let poses: Vec<Pose> = (0..12).map(|i| looking(f64::from(i / 4) * 120.0 + f64::from(i % 4))).collect();
    let clusters = Clusters::build(&poses, &anchors(3, 4), &[], 1).unwrap();
    for cluster in &clusters.clusters {
        assert!(cluster.members.iter().all(|m| m / 4 == cluster.anchor / 4));
    }
    check_consistent(&clusters, &poses);
    assert_eq!(clusters.metric.spread(), 0.0);
    assert_eq!(clusters.identity_of(&looking(60.0)).identity, None);
}

#[test]
fn unit_axes_and_origin_do_not_matter() {
    let turn = DQuat::from_euler(glam::EulerRot::XYZ, 0.4, -1.1, 2.3);
    let contributors = runs(49, 12);
    for (poses, grouping) in [
        (scattered(49, 3), anchors(3, 12)),
        (scattered(49, 4), by_contributor(5)),
        (grid(7), anchors(3, 12)),
        (grid(7), anchors(2, 20)),
        (grid(7), by_contributor(5)),
    ] {
        let original = Clusters::build(&poses, &grouping, &contributors, 9).unwrap();
        check_consistent(&original, &poses);
        for scale in [1e-6, 1e-3, 1.0, 3.0, 1e6] {
            for shift in [DVec3::ZERO, DVec3::new(0.3, -0.7, 0.65) * scale * 1e6] {
                for turn in [DQuat::IDENTITY, turn] {
                    let changed = moved(&poses, scale, turn, shift);
                    let clusters = Clusters::build(&changed, &grouping, &contributors, 9).unwrap();
                    for (a, b) in original.clusters.iter().zip(&clusters.clusters) {
                        assert_eq!((a.anchor, &a.members), (b.anchor, &b.members), "{scale} {shift} {turn}");
                        assert!((a.radius - b.radius).abs() < 1e-6);
                    }
                    check_consistent(&clusters, &changed);
                }
            }
        }
    }
}

#[test]
fn ties_go_by_index() {
    // Views 0 to 4 on a line; the anchors are its ends whatever the seed picks first
    // among them, and view 2 is as far from one as from the other.
    let poses: Vec<Pose> = (0..5).map(|i| Pose::new(DMat3::IDENTITY, DVec3::X * f64::from(i)).unwrap()).collect();
    let ends = (0..100).map(|seed| Clusters::build(&poses, &anchors(2, 2), &[], seed).unwrap());
    let mut seen = 0;
    for clusters in ends {
        check_consistent(&clusters, &poses);
        let first = &clusters.clusters[0];
        match first.anchor {
            // From the middle both ends are as far: the lower index is second.
            2 => assert_eq!(clusters.clusters[1].anchor, 0),
            0 | 4 => {
                // The middle view is as far from both: it lies on the first's ground, outside its cluster.
                let told = clusters.identity_of(&poses[2]);
                assert_eq!(told.identity, None);
                assert!((told.margin + 0.5 / clusters.metric.spread()).abs() < 1e-6);
            }
            _ => continue,
        }
        seen += 1;
    }
    assert!(seen > 20);
    // Views exactly as far as the K-th cannot be told apart from it, so they are in.
    let clusters = Clusters::build(&grid(3), &anchors(1, 2), &[], 3).unwrap();
    assert!(clusters.clusters[0].members.len() > 2);
    check_consistent(&clusters, &grid(3));
}

#[test]
fn the_same_seed_is_the_same_and_another_may_differ() {
    let poses = scattered(60, 8);
    let build = |seed| Clusters::build(&poses, &anchors(3, 10), &[], seed).unwrap();
    assert_eq!(build(4), build(4));
    let firsts: std::collections::BTreeSet<usize> = (0..20).map(|s| build(s).clusters[0].anchor).collect();
    assert!(firsts.len() > 5, "the seed picks the first anchor");
}

#[test]
fn shared_spots_and_strangers_belong_to_nobody() {
    let mut poses = scattered(20, 6);
    let mut contributors = runs(20, 5);
    // Views 0 (a) and 7 (b) stand on one spot; 15 to 19 are unknown; d has one view only.
    poses[7] = poses[0];
    contributors[14] = "d".to_owned();
    let clusters = Clusters::build(&poses, &by_contributor(4), &contributors, 0).unwrap();
    check_consistent(&clusters, &poses);
    let members: Vec<usize> = clusters.clusters.iter().map(|c| c.members.len()).collect();
    assert_eq!(members, [4, 4, 4]);
    assert_eq!(clusters.identity_of(&poses[0]).identity, None);
    assert_eq!(clusters.identity_of(&poses[14]).identity, None);
    assert_eq!(clusters.identity_of(&poses[17]).identity, None);
    assert_eq!(clusters.nearest(&poses[17], 1)[0].identity, None);
    // The order is by name, not by view.
    let renamed: Vec<String> = contributors.iter().map(|c| if c == "a" { "z".to_owned() } else { c.clone() }).collect();
    let clusters = Clusters::build(&poses, &by_contributor(4), &renamed, 0).unwrap();
    assert_eq!(clusters.identity_of(&poses[1]).identity, Some(3));
}

#[test]
fn a_view_that_is_left_out_is_nobodys() {
    let poses = scattered(60, 8);
    let clusters = Clusters::build(&poses, &by_contributor(2), &runs(60, 20), 0).unwrap();
    for view in 0..60 {
        let all = clusters.identity_of(&poses[view]);
        let out = clusters.identity_of_without(&poses[view], &[view].into());
        // The next view decides, which stands farther off.
        assert!(all.distance == 0.0 && out.distance > 0.0, "view {view}");
        let next = clusters.nearest(&poses[view], 2)[1];
        assert_eq!(out.distance, next.distance);
        assert!(out.identity.is_none() || out.identity == next.identity);
    }
    // All of an identity's views out: nobody is told it.
    let first: std::collections::BTreeSet<usize> = clusters.clusters[0].members.iter().copied().collect();
    assert!(poses.iter().all(|pose| clusters.identity_of_without(pose, &first).identity != Some(1)));
}

#[test]
fn a_small_capture_has_smaller_clusters() {
    let sizes = |anchors: usize, views: usize| ClusterConfig { anchors, ..ClusterConfig::default() }.within(views);
    assert_eq!(sizes(3, 200), ClusterConfig::default(), "as many as in the paper at most");
    assert_eq!(sizes(3, 43).neighbours, 14);
    assert_eq!(sizes(3, 8).neighbours, 2);
    for (anchors, views) in [(3, 43), (3, 8), (8, 8)] {
        assert!(Clusters::build(&scattered(views, 1), &Grouping::Anchors(sizes(anchors, views)), &[], 0).is_ok());
    }
    // Too few for one view each is for the build to say; no anchors as well.
    let none = Clusters::build(&scattered(2, 1), &Grouping::Anchors(sizes(3, 2)), &[], 0).unwrap_err().to_string();
    assert!(none.starts_with("3 clusters of 1 views need 3 views, the capture has 2"), "{none}");
    assert_eq!(sizes(0, 5).neighbours, 5);
}

#[test]
fn what_cannot_be_is_refused() {
    let poses = scattered(20, 1);
    let build = |grouping: Grouping| Clusters::build(&poses, &grouping, &runs(20, 5), 0);
    let text = |result: Result<Clusters, ClusterError>| result.unwrap_err().to_string();
    assert_eq!(
        text(build(Grouping::Anchors(ClusterConfig::default()))),
        "3 clusters of 20 views need 60 views, the capture has 20; lower anchors (M) or neighbours (K)"
    );
    assert!(build(anchors(2, 10)).is_ok());
    assert!(matches!(build(anchors(21, 1)), Err(ClusterError::TooFewViews { .. })));
    assert!(matches!(build(anchors(usize::MAX, 2)), Err(ClusterError::TooFewViews { .. })));
    assert!(text(build(anchors(0, 5))).contains("anchors is 0; it must be at least 1"));
    assert!(text(build(anchors(2, 0))).contains("neighbours is 0"));
    assert!(text(build(by_contributor(1))).contains("min_views is 1; it must be at least 2"));
    let heavy = Grouping::ByContributor { min_views: 2, direction_weight: f64::NAN };
    assert!(text(build(heavy)).contains("direction_weight is NaN"));
    assert_eq!(
        text(build(by_contributor(6))),
        "no contributor has 6 views of their own; the most, 5, are from \"c\"; lower min_views (--min-views) or bring a table of contributors"
    );
    let few = Clusters::build(&poses, &by_contributor(2), &runs(3, 1), 0);
    assert_eq!(few, Err(ClusterError::ContributorCount { views: 20, contributors: 3 }));
    let same = vec![poses[0]; 10];
    let none = Clusters::build(&same, &anchors(2, 3), &[], 0);
    assert_eq!(none, Err(ClusterError::TooFewPoses { anchors: 2, distinct: 1 }));
    let one = Clusters::build(&same, &anchors(1, 3), &[], 0).unwrap();
    assert_eq!(one.clusters[0].members.len(), 10, "they cannot be told apart");
    check_consistent(&one, &same);
    let mut broken = poses.clone();
    broken[4].position.y = f64::NAN;
    assert_eq!(Clusters::build(&broken, &anchors(1, 3), &[], 0), Err(ClusterError::NotFinite { view: 4 }));
    assert!(matches!(Clusters::build(&[], &anchors(1, 1), &[], 0), Err(ClusterError::TooFewViews { .. })));
}

#[test]
fn permuted_clusters_are_the_same_places_under_other_identities() {
    let poses = scattered(40, 6);
    for (clusters, all) in [
        (Clusters::build(&poses, &anchors(3, 6), &[], 2).unwrap(), 3),
        (Clusters::build(&poses, &by_contributor(2), &runs(40, 12), 2).unwrap(), 3),
    ] {
        assert_eq!(clusters.clusters.len(), all);
        for by in 1..all {
            let permuted = clusters.permuted(by);
            check_consistent(&permuted, &poses);
            for pose in poses.iter().chain(&scattered(60, 7)) {
                let other = |identity: u32| (identity as usize - 1 + by) as u32 % all as u32 + 1;
                let (was, is) = (clusters.identity_of(pose), permuted.identity_of(pose));
                assert_eq!(is.identity, was.identity.map(other), "by {by}");
                assert_eq!((is.distance, is.margin), (was.distance, was.margin), "by {by}");
            }
            assert_eq!(permuted.permuted(all - by), clusters, "and back");
        }
    }
}

#[test]
fn stored_clusters_come_back_or_are_refused() {
    let poses = scattered(60, 2);
    for grouping in [anchors(3, 10), by_contributor(3)] {
        let clusters = Clusters::build(&poses, &grouping, &runs(60, 20), 5).unwrap();
        let stored = serde_json::to_value(&clusters).unwrap();
        let back: Clusters = serde_json::from_str(&stored.to_string()).unwrap();
        assert_eq!(back, clusters);
        let mut spoilt = 0;
        for (pointer, value) in [
            ("/clusters/1/identity", serde_json::json!(3)),
            ("/clusters/1/anchor", serde_json::json!(4000)),
            ("/clusters/1/members/0", serde_json::json!(4000)),
            ("/clusters/1/radius", serde_json::json!(-1.0)),
            ("/clusters", serde_json::json!([])),
            ("/references/1/view", serde_json::json!(0)),
            ("/references/1/identity", serde_json::json!(9)),
            ("/references/1/pose/rotation/0", serde_json::json!(7.0)),
            ("/metric/spread", serde_json::json!(-1.0)),
        ] {
            let mut bad = stored.clone();
            *bad.pointer_mut(pointer).unwrap() = value;
            let error = serde_json::from_value::<Clusters>(bad).unwrap_err().to_string();
            assert!(error.contains("damaged"), "{pointer}: {error}");
            spoilt += 1;
        }
        assert_eq!(spoilt, 9);
    }
    let config: ClusterConfig = serde_json::from_str("{\"neighbours\": 7}").unwrap();
    assert_eq!(config, ClusterConfig { neighbours: 7, ..Default::default() });
    assert!(serde_json::from_str::<ClusterConfig>("{\"neighbors\": 7}").is_err());
}
