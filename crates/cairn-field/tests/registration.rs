//! Where a picture was taken is found again, also where it was turned, cut or lit otherwise since; and a picture of
//! something else is explained from nowhere.

use crate::common::named;
use crate::common::{ball_box, ring, rms, views};
use cairn_field::{BaseTrainer, Field, FieldConfig};
use cairn_field::{Registered, Registrar};
use cairn_scene::{BrownConrady, Camera, Fisheye, Picture};
use glam::{DMat3, DVec3};
use std::sync::{Arc, OnceLock};

/// A banded ball, trained on eighteen views around it, and what registers pictures to it.
fn ball() -> &'static (Arc<Field>, Registrar) {
    static BALL: OnceLock<(Arc<Field>, Registrar)> = OnceLock::new();
    BALL.get_or_init(trained)
}

fn trained() -> (Arc<Field>, Registrar) {
    let config = FieldConfig { steps: 250, rays_per_step: 2048, voxels: 60_000, levels: 2, ..FieldConfig::default() };
    let mut trainer = BaseTrainer::new(named(views(18, 96, 1.0, DVec3::ZERO)), ball_box(), None, config, 3).unwrap();
    while trainer.steps_done() < trainer.steps_total() {
        trainer.step().unwrap();
    }
    let field = Arc::new(trainer.finish());
    let cameras = ring(18, 96, 1.0, DVec3::ZERO);
    let named: Vec<_> = cameras.iter().map(|camera| (*camera, "")).collect();
    let registrar = Registrar::new(field.clone(), &named).expect("views");
    (field, registrar)
}

/// A camera between those of the ring, a little closer and tilted.
fn beside(degrees: f64, roll: f64) -> Camera {
    let mut camera = ring(18, 96, 1.0, DVec3::ZERO)[4];
    let turn = DMat3::from_rotation_y(degrees.to_radians());
    camera.pose.position = turn * camera.pose.position * 0.97;
    camera.pose.rotation = turn * camera.pose.rotation * DMat3::from_rotation_z(roll.to_radians());
    camera
}

fn shot(field: &Field, camera: &Camera) -> Picture {
    let render = field.render(camera, field.canonical_appearance());
    Picture::from_rgb8(render.width(), render.height(), &render.to_rgb8()).unwrap()
}

/// The furthest that a point of the ball's near side lands from where it is in the picture, px.
fn off_px(found: &Registered, truth: &Camera) -> f64 {
    let towards = truth.pose.position.normalize();
    let points = (0..40).map(|i| {
        let a = f64::from(i) * 2.4;
        let aside =
            towards.any_orthonormal_vector() * a.cos() + towards.cross(towards.any_orthonormal_vector()) * a.sin();
        (towards + aside * (0.02 * f64::from(i))).normalize()
    });
    points.map(|p| (found.camera.project(p).unwrap() - truth.project(p).unwrap()).length()).fold(0.0, f64::max)
}

#[test]
fn a_picture_is_laid_where_it_was_taken() {
    let (field, registrar) = ball();
    for (degrees, roll) in [(0.0, 0.0), (5.0, 0.0), (-8.0, 3.0)] {
        let truth = beside(degrees, roll);
        let found = registrar.register(&shot(field, &truth)).expect("a place");
        let off = off_px(&found, &truth);
        // The ball is smooth: a longer lens further off shows it nearly the same.
        assert!(off < 1.0 && found.explained > 0.9, "{off} px, {} explained", found.explained);
    }
}

#[test]
fn turned_cut_and_darker_pictures_are_laid_as_well() {
    let (field, registrar) = ball();
    let truth = beside(4.0, 0.0);
    // Darker and of less contrast.
    let mut dark = shot(field, &truth);
    dark.rgb_mut().iter_mut().for_each(|v| *v = 0.1 + 0.7 * *v);
    let found = registrar.register(&dark).expect("a place");
    assert!(off_px(&found, &truth) < 1.0, "{}", off_px(&found, &truth));
    // Turned by a quarter of a right angle: the same as a camera that was. Found less exactly, as the
    // search has no such turn.
    let turned = beside(4.0, 22.0);
    let found = registrar.register(&shot(field, &turned)).expect("a place");
    assert!(off_px(&found, &turned) < 2.0, "{}", off_px(&found, &turned));
    // A corner of 72 x 72 px cut out of it.
    let whole = shot(field, &truth);
    let rgb = (0..72 * 72).flat_map(|i| whole.pixel(i % 72 + 4, i / 72 + 14)).collect();
    let found = registrar.register(&Picture::new(72, 72, rgb).unwrap()).expect("a place");
    let mut cut = truth;
    (cut.intrinsics.cx, cut.intrinsics.cy) = (cut.intrinsics.cx - 4.0, cut.intrinsics.cy - 14.0);
    assert!(off_px(&found, &cut) < 2.0, "{}", off_px(&found, &cut));
}

#[test]
fn a_fisheye_s_pictures_are_laid_among_a_fisheye_s_views_turned_and_cut_as_well() {
    let (field, _) = ball();
    let fisheye = |camera: Camera| {
        let mut camera = camera;
        camera.intrinsics.distortion = Fisheye::new([-0.03, 0.004, -0.003, 0.0004]).into();
        camera
    };
    let cameras: Vec<_> = ring(18, 96, 1.0, DVec3::ZERO).into_iter().map(|camera| (fisheye(camera), "")).collect();
    let registrar = Registrar::new(field.clone(), &cameras).expect("views");
    for (degrees, roll) in [(5.0, 0.0), (-8.0, 3.0)] {
        let truth = fisheye(beside(degrees, roll));
        let found = registrar.register(&shot(field, &truth)).expect("a place");
        assert_eq!(found.camera.intrinsics.distortion, truth.intrinsics.distortion);
        let off = off_px(&found, &truth);
        assert!(off < 1.0 && found.explained > 0.9, "{off} px, {} explained", found.explained);
    }
    let truth = fisheye(beside(4.0, 0.0));
    let whole = shot(field, &truth);
    let rgb = (0..72 * 72).flat_map(|i| whole.pixel(i % 72 + 4, i / 72 + 14)).collect();
    let found = registrar.register(&Picture::new(72, 72, rgb).unwrap()).expect("a place");
    let mut cut = truth;
    (cut.intrinsics.cx, cut.intrinsics.cy) = (cut.intrinsics.cx - 4.0, cut.intrinsics.cy - 14.0);
    assert!(off_px(&found, &cut) < 2.0, "{}", off_px(&found, &cut));
}

#[test]
fn where_the_camera_is_known_only_the_light_is_found() {
    let (field, registrar) = ball();
    let truth = beside(4.0, 3.0);
    let mut dark = shot(field, &truth);
    dark.rgb_mut().iter_mut().for_each(|v| *v = 0.1 + 0.7 * *v);
    let found = registrar.register_at(&dark, &truth).expect("a light");
    assert_eq!(found.camera, truth);
    assert!(found.explained > 0.99, "{}", found.explained);
    let there = field.render(&truth, &found.appearance).clamped();
    assert!(rms(there.rgb(), dark.rgb()) < 0.01, "{}", rms(there.rgb(), dark.rgb()));
    // A smaller copy is a smaller camera's.
    let found = registrar.register_at(&dark.resized(60, 60), &truth).expect("a light");
    assert_eq!(found.camera, truth.resized(60, 60));
    assert!(found.explained > 0.9, "{}", found.explained);
    // From elsewhere the field shows something else, though another light makes much of it alike.
    let beside = registrar.register_at(&dark, &beside(40.0, 0.0)).map_or(0.0, |f| f.explained);
    assert!(beside < 0.9, "{beside}");
}

#[test]
fn odd_cameras_and_pictures_are_laid_nowhere_or_somewhere_and_stop_nothing() {
    let (field, registrar) = ball();
    let picture = shot(field, &beside(0.0, 0.0));
    let odd = |change: &dyn Fn(&mut Camera)| {
        let mut camera = beside(0.0, 0.0);
        change(&mut camera);
        camera
    };
    let cameras = [
        odd(&|c| c.intrinsics.fx = f64::MIN_POSITIVE),
        odd(&|c| c.intrinsics.fx = 1e308),
        odd(&|c| c.intrinsics.cx = 1e308),
        odd(&|c| c.intrinsics.distortion = BrownConrady { k1: 1e300, ..Default::default() }.into()),
        odd(&|c| c.intrinsics.distortion = Fisheye::new([1e300, -1e300, 0.0, -0.1]).into()),
        odd(&|c| c.intrinsics.distortion = Fisheye::new([-1e300, 0.0, 0.0, 0.0]).into()),
        odd(&|c| c.pose.position = DVec3::splat(1e308)),
        odd(&|c| (c.intrinsics.width, c.intrinsics.height) = (1, 1)),
        odd(&|c| (c.intrinsics.width, c.intrinsics.height) = (1 << 20, 1)),
    ];
    for camera in cameras {
        let found = registrar.register_at(&picture, &camera);
        assert!(found.is_none_or(|f| f.explained.is_finite() && f.explained <= 1.0), "{camera:?}");
    }
    for (w, h) in [(1, 1), (20, 20), (20, 5000), (64, 64)] {
        let flat = Picture::constant(w, h, [0.5; 3]);
        let found = registrar.register_at(&flat, &beside(0.0, 0.0));
        assert!(found.is_none_or(|f| f.explained.is_finite()), "{w} x {h}");
    }
}

#[test]
fn what_shows_something_else_is_explained_from_nowhere() {
    let (field, registrar) = ball();
    let mut noise = crate::common::Numbers(9);
    let rgb = (0..96 * 96 * 3).map(|_| noise.share() as f32).collect();
    let found = registrar.register(&Picture::new(96, 96, rgb).unwrap());
    assert!(found.is_none_or(|f| f.explained < 0.5));
    // Nothing to see, too little to see, and numbers that are none: no place, and no panic.
    assert!(registrar.register(&Picture::constant(96, 96, [0.3; 3])).is_none_or(|f| f.explained < 0.5));
    assert!(registrar.register(&Picture::constant(8, 300, [0.3; 3])).is_none());
    let mut broken = shot(field, &beside(0.0, 0.0));
    broken.rgb_mut()[77] = f32::NAN;
    assert!(registrar.register(&broken).is_some_and(|f| f.explained > 0.9));
    assert!(Registrar::new(field.clone(), &[]).is_none());
}

#[test]
fn a_search_ends_once_nobody_wants_it() {
    let (field, registrar) = ball();
    let picture = shot(field, &beside(0.1, 0.05));
    let asked = std::cell::Cell::new(0u32);
    let until = |last: u32| {
        asked.set(0);
        registrar.register_while(&picture, &|| {
            asked.set(asked.get() + 1);
            asked.get() <= last
        })
    };
    let found = until(u32::MAX).expect("a place");
    let all = asked.get();
    assert!(found.explained > 0.9 && all > 10, "asked {all} times");
    // Whenever it is: at once, in the middle, before the very end.
    for last in [0, 1, all / 2, all - 1] {
        assert!(until(last).is_none(), "after {last} of {all}");
        // Each of the places at hand may ask once more.
        assert!(asked.get() <= last + 5, "asked {} times after no at {last}", asked.get());
    }
    assert!(until(all).is_some());
}
