//! Clusters of the real landmark capture: by anchors and by contributor.
//! Skipped, visibly, where it is not there.

use std::path::PathBuf;

use cairn_scene::cluster::{ClusterConfig, Clusters, Grouping};
use cairn_scene::{Capture, Pose, ReadOptions};

#[test]
fn liberty() {
    let data = std::env::var_os("CAIRN_DATA")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data")), PathBuf::from);
    let folder = data.join("liberty");
    if !folder.is_dir() {
        eprintln!("SKIPPED liberty: no captures at {}", data.display());
        return;
    }
    let options = ReadOptions { contributors: Some(folder.join("contributors.csv")), ..Default::default() };
    let capture = Capture::read(&folder, &options).unwrap();
    let poses: Vec<Pose> = capture.views.iter().map(|v| v.camera.pose).collect();
    let contributors: Vec<String> = capture.views.iter().map(|v| v.contributor.clone()).collect();

    for seed in 0..5 {
        let anchors = Grouping::Anchors(ClusterConfig::default());
        let clusters = Clusters::build(&poses, &anchors, &contributors, seed).unwrap();
        for cluster in &clusters.clusters {
            assert!((5..=20).contains(&cluster.members.len()), "{} members", cluster.members.len());
            for &member in &cluster.members {
                assert_eq!(clusters.identity_of(&poses[member]).identity, Some(cluster.identity));
            }
        }
        let outside = poses.iter().filter(|p| clusters.identity_of(p).identity.is_none()).count();
        let inside: usize = clusters.clusters.iter().map(|c| c.members.len()).sum();
        assert_eq!(inside + outside, 135);
    }

    // Four drones have five photographs or more; every visitor has one.
    let grouping = Grouping::ByContributor { min_views: 5, direction_weight: 1.0 };
    let clusters = Clusters::build(&poses, &grouping, &contributors, 0).unwrap();
    let sizes: Vec<usize> = clusters.clusters.iter().map(|c| c.members.len()).collect();
    assert_eq!(sizes, [6, 17, 5, 8]);
    for (view, pose) in poses.iter().enumerate() {
        let told = clusters.identity_of(pose).identity;
        let expected = contributors[view].strip_prefix("drone-").map(|n| n.parse::<u32>().unwrap());
        assert_eq!(told, expected, "view {view} of {}", contributors[view]);
    }
}
