//! Paths against what they promise: distances, where they look, where they begin
//! and end, and what they do with cameras that make no sense.

use super::*;
use cairn_scene::{BrownConrady, Fisheye};

const CENTRE: DVec3 = DVec3::new(5.0, -1.0, 2.0);

fn look(position: DVec3, target: DVec3) -> Pose {
    Pose::look_at(position, target, DVec3::Z).unwrap()
}

/// Two thirds of a ring at several heights and distances, looking in.
fn ring() -> Vec<Pose> {
    let at = |i: i32| {
        let (a, far) = (f64::from(i) * 0.4, 3.0 + f64::from(i % 3));
        look(CENTRE + DVec3::new(far * a.cos(), far * a.sin(), 0.5 + 0.3 * f64::from(i % 2)), CENTRE)
    };
    (0..11).map(at).collect()
}

/// A grid of cameras that look the same way.
fn wall() -> Vec<Pose> {
    let at = |i: i32| {
        let position = DVec3::new(f64::from(i % 4), 0.05 * f64::from(i % 3), f64::from(i / 4));
        look(position, position + DVec3::new(0.02 * f64::from(i % 5), 10.0, 0.0))
    };
    (0..12).map(at).collect()
}

fn lens(width: usize, height: usize) -> Intrinsics {
    let distortion = BrownConrady { k1: 0.1, ..BrownConrady::default() }.into();
    Intrinsics { width, height, fx: 100.0, fy: 110.0, cx: 49.0, cy: 41.0, distortion }
}

fn assert_sane(poses: &[Pose]) {
    for pose in poses {
        Pose::new(pose.rotation, pose.position).expect("a pose");
    }
}

#[test]
fn orbit_cameras_are_equidistant_from_the_centre_and_look_at_it_upright() {
    let poses = orbit(&ring(), CENTRE, 360.0, 24).unwrap();
    assert_eq!(poses.len(), 24);
    assert_sane(&poses);
    let mut distances: Vec<f64> = ring().iter().map(|p| (p.position - CENTRE).length()).collect();
    distances.sort_by(f64::total_cmp);
    for pose in &poses {
        let inwards = CENTRE - pose.position;
        assert!((inwards.length() - distances[5]).abs() < 1e-9, "{} for {}", inwards.length(), distances[5]);
        assert!(inwards.normalize().dot(pose.forward()) > 1.0 - 1e-12);
        assert!(pose.rotation.x_axis.z.abs() < 1e-9, "level");
        assert!(-pose.rotation.y_axis.z > 0.9, "upright");
        assert!((pose.position.z - poses[0].position.z).abs() < 1e-9, "at one height");
    }
    // Steps are even, the one from the last to the first too.
    let step = |i: usize| (poses[(i + 1) % 24].position - poses[i].position).length();
    assert!((0..24).all(|i| (step(i) - step(0)).abs() < 1e-9));
    // It begins on the cameras' side.
    let mean = ring().iter().map(|p| p.position).sum::<DVec3>() / 11.0 - CENTRE;
    let first = poses[0].position - CENTRE;
    assert!(mean.truncate().normalize().dot(first.truncate().normalize()) > 1.0 - 1e-9);
}

#[test]
fn an_arc_has_its_angle_and_lies_evenly_around_the_cameras() {
    let (arc, whole) = (orbit(&ring(), CENTRE, 90.0, 7).unwrap(), orbit(&ring(), CENTRE, 360.0, 4).unwrap());
    let level = |p: &Pose| (p.position - CENTRE).truncate().normalize();
    assert!(level(&arc[0]).dot(level(&arc[6])).abs() < 1e-9);
    assert!((arc[3].position - whole[0].position).length() < 1e-9);
}

#[test]
fn a_spiral_closes_on_itself_and_stays_among_the_cameras() {
    let wall = wall();
    // Whichever the number of frames, one more would be the first again.
    for frames in [8, 60] {
        let poses = spiral(&wall, 8.0, frames).unwrap();
        assert_sane(&poses);
        let steps: Vec<f64> =
            (0..frames).map(|i| (poses[(i + 1) % frames].position - poses[i].position).length()).collect();
        let inner = steps[..frames - 1].iter().copied().fold(0.0, f64::max);
        assert!(steps[frames - 1] <= inner * 1.01, "a jump of {} at the end", steps[frames - 1]);
        let middle = wall.iter().map(|p| p.position).sum::<DVec3>() / 12.0;
        for pose in &poses {
            let off = pose.position - middle;
            assert!(off.x.abs() <= 1.55 && off.z.abs() <= 1.05 && off.y.abs() < 0.2, "{off}");
            let target = (middle - pose.position).dot(DVec3::Y) + 8.0;
            assert!(target > 0.0 && pose.forward().y > 0.9);
        }
    }
    assert_eq!(spiral(&ring(), 8.0, 9).unwrap_err(), PathError::NoCommonView);
}

#[test]
fn between_begins_and_ends_in_the_very_views() {
    let ring = ring();
    let camera = |i: usize| Camera { intrinsics: lens(100, 80), pose: ring[i] };
    let (a, b) = (camera(0), camera(7));
    assert_eq!(between(&a, &b, CENTRE, 0.0), Ok(a));
    assert_eq!(between(&a, &b, CENTRE, 1.0), Ok(b));
    // Nearly there is nearly the view: no jump at the ends.
    for (share, end) in [(1e-9, &a), (1.0 - 1e-9, &b)] {
        let near = between(&a, &b, CENTRE, share).unwrap();
        assert!((near.pose.position - end.pose.position).length() < 1e-6);
        assert!((near.pose.rotation - end.pose.rotation).to_cols_array().iter().all(|v| v.abs() < 1e-6));
    }
    // On the way what both look at stays in the middle, and is not run into.
    for i in 0..=20 {
        let pose = between(&a, &b, CENTRE, f64::from(i) / 20.0).unwrap().pose;
        assert_sane(&[pose]);
        let inwards = CENTRE - pose.position;
        assert!(inwards.length() > 2.9 && inwards.normalize().dot(pose.forward()) > 1.0 - 1e-9, "{i}: {inwards}");
    }
    // Cameras that look one way move in a straight line.
    let (mut a, mut b) = (a, b);
    (a.pose, b.pose) = (wall()[0], Pose { rotation: wall()[0].rotation, ..wall()[7] });
    let half = between(&a, &b, CENTRE, 0.5).unwrap().pose.position;
    assert!((half - a.pose.position.lerp(b.pose.position, 0.5)).length() < 1e-9);
}

#[test]
fn one_view_and_coincident_cameras_give_an_error_or_a_sane_path() {
    let one = [look(CENTRE + DVec3::X * 3.0, CENTRE)];
    let poses = orbit(&one, CENTRE, 360.0, 5).unwrap();
    assert_sane(&poses);
    assert!((poses[0].position - one[0].position).length() < 1e-9);
    assert!(matches!(spiral(&one, 3.0, 5), Err(PathError::OnePlace { .. })));
    let camera = Camera { intrinsics: lens(100, 80), pose: one[0] };
    let half = between(&camera, &camera, CENTRE, 0.5).unwrap();
    assert!((half.pose.position - one[0].position).length() < 1e-9);
    assert!((half.pose.rotation - one[0].rotation).to_cols_array().iter().all(|v| v.abs() < 1e-9));

    let together = vec![one[0]; 9];
    assert_sane(&orbit(&together, CENTRE, 360.0, 5).unwrap());
    assert!(matches!(orbit(&together, one[0].position, 360.0, 5), Err(PathError::OnePlace { .. })));
    assert!(matches!(spiral(&together, 3.0, 5), Err(PathError::OnePlace { .. })));
    assert_eq!(orbit(&[], CENTRE, 360.0, 5), Err(PathError::NoViews));
    assert_eq!(spiral(&[], 3.0, 5), Err(PathError::NoViews));
    for depth in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(spiral(&wall(), depth, 5).is_err(), "{depth}");
    }
}

#[test]
fn cameras_that_look_away_or_straight_down_are_met() {
    let away: Vec<Pose> =
        ring().iter().map(|p| look(p.position, p.position + (p.position - CENTRE).with_z(0.0))).collect();
    assert_eq!(orbit(&away, CENTRE, 360.0, 5).unwrap_err(), PathError::LookingAway { away: 11, views: 11 });
    let down: Vec<Pose> = (0..6)
        .map(|i| f64::from(i).sin_cos())
        .map(|(s, c)| Pose::look_at(CENTRE + DVec3::Z * 4.0, CENTRE, DVec3::new(c, s, 0.0)).unwrap())
        .collect();
    let poses = orbit(&down, CENTRE, 360.0, 8).unwrap();
    assert_sane(&poses);
    assert!(poses.iter().all(|p| (p.position - CENTRE).length() - 4.0 < 1e-9));
    // Two cameras back to back: half a turn has no shortest way, and any will do.
    let pair = [look(CENTRE + DVec3::X, CENTRE), look(CENTRE - DVec3::X, CENTRE)];
    let camera = |i: usize| Camera { intrinsics: lens(100, 80), pose: pair[i] };
    for i in 0..=10 {
        assert_sane(&[between(&camera(0), &camera(1), CENTRE, f64::from(i) / 10.0).unwrap().pose]);
    }
}

#[test]
fn lenses_keep_their_pixels_shape_and_cut_what_is_too_wide() {
    let own = lens(100, 80);
    assert_eq!(fitted(&own, 100, 80), own);
    let half = fitted(&own, 50, 40);
    assert_eq!((half.fx, half.fy, half.cx, half.cy), (50.0, 55.0, 24.5, 20.5));
    let wide = fitted(&own, 100, 40);
    assert_eq!((wide.fx, wide.cx, wide.cy), (100.0, 49.0, 21.0));
    let middling = middling_lens(&[own, own], 200, 160).unwrap();
    assert_eq!((middling.fx, middling.fy, middling.cx, middling.cy), (210.0, 210.0, 100.0, 80.0));
    assert!(middling.distortion.is_none() && middling_lens(&[], 4, 4).is_none());
}

#[test]
fn a_flight_between_two_fisheyes_has_their_lens_and_there_is_none_to_a_pinhole() {
    let ring = ring();
    let camera = |i: usize, k1: f64| {
        let distortion = Fisheye::new([k1, 0.0, 0.0, 0.01]).into();
        Camera { intrinsics: Intrinsics { distortion, ..lens(100, 80) }, pose: ring[i] }
    };
    let (a, b) = (camera(0, 0.1), camera(7, -0.02));
    let half = between(&a, &b, CENTRE, 0.5).unwrap();
    assert_eq!(half.intrinsics.distortion, Fisheye::new([0.04, 0.0, 0.0, 0.01]).into());
    assert_eq!(half.intrinsics.check_lens(), Ok(()));
    let pinhole = Camera { intrinsics: lens(100, 80), ..b };
    for share in [0.0, 0.5, 1.0] {
        assert_eq!(between(&a, &pinhole, CENTRE, share), Err(PathError::OtherLens), "{share}");
        assert_eq!(between(&pinhole, &b, CENTRE, share), Err(PathError::OtherLens), "{share}");
    }
    // A camera that took no photograph is a pinhole of the same scale.
    let middling = middling_lens(&[a.intrinsics, b.intrinsics], 100, 80).unwrap();
    assert!(middling.fx == 105.0 && middling.distortion.is_none());
}
