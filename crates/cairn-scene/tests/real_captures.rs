//! The four real captures: what is known about them must come out of reading
//! them. Skipped, visibly, where they are not there.

use std::collections::BTreeSet;
use std::path::PathBuf;

use cairn_scene::{BrownConrady, Capture, ReadOptions, SceneKind, Unused};

/// The folder of one real capture, or `None` after saying so.
fn real(test: &str, name: &str) -> Option<PathBuf> {
    let data = std::env::var_os("CAIRN_DATA")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data")), PathBuf::from);
    let folder = data.join(name);
    if !folder.is_dir() {
        eprintln!("SKIPPED {test}: no captures at {}", data.display());
        return None;
    }
    Some(folder)
}

/// Every 8th view is held out, or the capture's own test views.
fn some_held_out() -> ReadOptions {
    ReadOptions { hold_out: Some(8), ..ReadOptions::default() }
}

/// Every photograph of some views decodes at its camera's size, within [0, 1].
fn decodes(capture: &Capture, step: usize) {
    for view in (0..capture.views.len()).step_by(step) {
        let picture = capture.photograph(view).unwrap();
        let i = &capture.views[view].camera.intrinsics;
        assert_eq!((picture.width(), picture.height()), (i.width, i.height));
        assert!(picture.rgb().iter().all(|v| (0.0..=1.0).contains(v)));
    }
}

#[test]
fn liberty() {
    let Some(folder) = real("liberty", "liberty") else { return };
    let contributors = Some(folder.join("contributors.csv"));
    let options = ReadOptions { contributors, hold_out: Some(8), ..Default::default() };
    let capture = Capture::read(&folder, &options).unwrap();
    assert_eq!(capture.views.len(), 135);
    assert_eq!(capture.kind, SceneKind::Unbounded);
    assert_eq!(capture.background, None);
    assert_eq!(capture.points.len(), 27_509);
    assert_eq!(capture.held_out().count(), 17);
    assert_eq!(capture.held_out().nth(1), Some(8));
    assert_eq!(capture.training().count(), 118);
    // Visitors brought a photograph each: those whose only one is held out are named. By default there is none.
    assert!(capture.without_share().iter().all(|row| (row.why, row.photographs) == (Unused::HeldOut, 1)));
    assert_eq!(capture.without_share().len(), 13);
    let all = Capture::read(&folder, &ReadOptions { hold_out: None, ..options }).unwrap();
    assert_eq!((all.training().count(), all.without_share()), (135, Vec::new()));
    let contributors: BTreeSet<&str> = capture.views.iter().map(|v| v.contributor.as_str()).collect();
    assert_eq!(contributors.len(), 103);
    assert_eq!(capture.views.iter().filter(|v| v.contributor == "drone-2").count(), 17);
    let i = capture.views[0].camera.intrinsics;
    assert_eq!((i.width, i.height, i.fx), (400, 600, 1237.1509936802545));
    assert_eq!(i.distortion, BrownConrady { k1: -0.5517206422349514, ..Default::default() }.into());
    // A photograph of the statue sees a good part of the points on the statue.
    for view in &capture.views {
        let inside = capture.points.iter().filter_map(|&p| view.camera.project(p));
        let seen = inside.filter(|at| (0.0..400.0).contains(&at.x) && (0.0..600.0).contains(&at.y)).count();
        assert!(seen > 1000, "{} sees only {seen} points", view.name);
    }
    decodes(&capture, 40);
}

#[test]
fn fern_and_trex() {
    for (name, views, held_out, size, full) in
        [("fern", 20, 3, (504, 378), 4032.0), ("trex", 55, 7, (400, 300), 4032.0)]
    {
        let Some(folder) = real("fern_and_trex", name) else { return };
        let capture = Capture::read(&folder, &some_held_out()).unwrap();
        assert_eq!(capture.views.len(), views);
        assert_eq!(capture.held_out().count(), held_out);
        assert_eq!(capture.kind, SceneKind::ForwardFacing);
        assert!(capture.views.iter().all(|v| v.contributor == "unknown"));
        for view in &capture.views {
            let i = view.camera.intrinsics;
            assert_eq!((i.width, i.height), size);
            // A phone's field of view, whatever the size: the focal was scaled with it.
            assert!((0.5..1.5).contains(&(i.fx / i.width as f64)), "focal {} at {full}", i.fx);
            let (near, far) = view.bounds.unwrap();
            assert!(near > 0.0 && near < far);
        }
        // What lies in front of one camera at its far bound, all the others see ahead of them.
        let first = capture.views[0].camera;
        let middle = first.pose.position + first.pose.forward() * capture.views[0].bounds.unwrap().1;
        assert!(capture.views.iter().all(|v| v.camera.project(middle).is_some()));
        decodes(&capture, 7);
    }
}

#[test]
fn lego() {
    let Some(folder) = real("lego", "lego") else { return };
    let capture = Capture::read(&folder, &some_held_out()).unwrap();
    assert_eq!((capture.training().count(), capture.held_out().count()), (100, 25));
    assert_eq!(capture.kind, SceneKind::Bounded);
    assert_eq!(capture.background, Some([1.0; 3]));
    for view in &capture.views {
        assert_eq!(view.held_out, view.name.starts_with("test/"));
        // The object stands at the origin and every camera looks at it, upright.
        let at = view.camera.project(glam::DVec3::ZERO).unwrap();
        assert!((at.x - 200.0).abs() < 1e-2 && (at.y - 200.0).abs() < 1e-2, "{} sees it at {at}", view.name);
        let above = view.camera.project(glam::DVec3::Z * 0.1).unwrap();
        assert!(above.y < at.y, "{} is upside down", view.name);
        assert!((view.camera.intrinsics.fx - 555.5555155968841).abs() < 1e-6);
    }
    // A corner is transparent, so white; the middle is brick, so not.
    let picture = capture.photograph(0).unwrap();
    assert_eq!(picture.pixel(0, 0), [1.0; 3]);
    assert!(picture.pixel(200, 200).iter().sum::<f32>() < 2.5);
    decodes(&capture, 50);
}
