//! Where a picture of a made-up landmark was taken is found again, also where it was turned, cut or lit otherwise since;
//! and a picture of something else is located nowhere.

use std::io::Cursor;
use std::sync::{Arc, OnceLock};

use cairn_field::{BaseTrainer, Field, FieldConfig, NamedView, SceneFrame};
use cairn_landmark::{Landmark, LandmarkCapture, LandmarkConfig};
use cairn_register::{Index, Located, NotLocated, Reference, Registrar};
use cairn_scene::{BrownConrady, Camera, Fisheye, Picture};
use glam::{DMat3, DVec3};

/// Pixels of a photograph along each side.
const SIDE: usize = 128;

struct Scene {
    capture: LandmarkCapture,
    field: Arc<Field>,
    index: Arc<Index>,
    registrar: Registrar,
}

/// A landmark that two people photographed in one light; every fifth photograph taught nothing.
fn scene() -> &'static Scene {
    static SCENE: OnceLock<Scene> = OnceLock::new();
    SCENE.get_or_init(|| {
        let config = LandmarkConfig {
            contributors: 2,
            photographs: 12,
            width: SIDE,
            height: SIDE,
            passers_by: false,
            light_variation: 0.0,
            ..LandmarkConfig::default()
        };
        let capture = Landmark::generate(&config, 3).unwrap();
        let taught = || capture.views.iter().enumerate().filter(|(k, _)| k % 5 != 2).map(|(_, view)| view);
        let frame = SceneFrame::Unbounded { centre: DVec3::new(0.0, 0.0, 1.2), half: DVec3::splat(1.6) };
        let config =
            FieldConfig { steps: 400, rays_per_step: 2048, voxels: 200_000, levels: 2, ..FieldConfig::default() };
        let views = taught().map(|v| NamedView::new(v.name.clone(), v.camera, &v.picture)).collect();
        let mut trainer = BaseTrainer::new(views, frame, None, config, 3).unwrap();
        while trainer.steps_done() < trainer.steps_total() {
            trainer.step().unwrap();
        }
        let field = Arc::new(trainer.finish());
        let references: Vec<Reference<'_>> = taught()
            .map(|v| Reference {
                camera: v.camera,
                name: &v.name,
                photograph: Box::new(move || Some(v.picture.clone())),
            })
            .collect();
        let index = Arc::new(Index::build(&field, &references, &mut |_, _| true).expect("an index"));
        drop(references);
        let registrar = Registrar::new(field.clone(), Some(index.clone()));
        Scene { capture, field, index, registrar }
    })
}

/// The camera of a photograph that taught nothing, `scale` times as large.
fn held_out(k: usize, scale: usize) -> Camera {
    scene().capture.views[2 + 5 * k].camera.resized(scale * SIDE, scale * SIDE)
}

/// What the field shows there, as a file has it.
fn shot(camera: &Camera) -> Picture {
    let field = &scene().field;
    field.render(camera, field.canonical_appearance()).clamped().in_8_bits()
}

/// The part of `whole` from `left`, `top` on, and the camera that took it.
fn part(camera: &Camera, whole: &Picture, [left, top, width, height]: [usize; 4]) -> (Camera, Picture) {
    let rgb = (0..width * height).flat_map(|i| whole.pixel(left + i % width, top + i / width)).collect();
    let mut part = *camera;
    let i = &mut part.intrinsics;
    (i.cx, i.cy, i.width, i.height) = (i.cx - left as f64, i.cy - top as f64, width, height);
    (part, Picture::new(width, height, rgb).unwrap())
}

/// `picture` with a blur of 2 px standard deviation: twice means of five across and down, each of a variance of 2 px squared.
fn blurred(picture: &Picture) -> Picture {
    let (w, h) = (picture.width(), picture.height());
    let mean = |of: &Picture, across: usize, down: usize| {
        let at = |x: usize, y: usize, k: usize| {
            let along = |at: usize, by: usize, end: usize| (at + by * k).saturating_sub(2 * by).min(end - 1);
            of.pixel(along(x, across, w), along(y, down, h))
        };
        let of_five = |x: usize, y: usize| (0..5).flat_map(|k| at(x, y, k)).collect::<Vec<f32>>();
        let rgb = (0..w * h).flat_map(|i| {
            let five = of_five(i % w, i / w);
            (0..3).map(move |c| five.iter().skip(c).step_by(3).sum::<f32>() / 5.0).collect::<Vec<f32>>()
        });
        Picture::new(w, h, rgb.collect()).unwrap()
    };
    [(1, 0), (0, 1), (1, 0), (0, 1)].iter().fold(picture.clone(), |of, (across, down)| mean(&of, *across, *down))
}

/// The furthest that one of the landmark's points lands from where it is in the picture, px.
fn off_px(found: &Located, truth: &Camera) -> f64 {
    let points = (0..60).map(|i| {
        let (angle, height) = (f64::from(i) * 2.4, 0.1 + 0.035 * f64::from(i));
        DVec3::new(0.4 * angle.cos(), 0.4 * angle.sin(), height)
    });
    let off = points.map(|p| match (found.registered.camera.project(p), truth.project(p)) {
        (Some(a), Some(b)) => (a - b).length(),
        _ => f64::INFINITY,
    });
    off.fold(0.0, f64::max)
}

/// What was found, for messages.
fn said(found: &Located) -> String {
    let Located { registered, uncertainty_px, places, surprise } = found;
    let explained = registered.explained;
    format!(
        "{explained:.3} explained, uncertain by {uncertainty_px:.3} px, {} agree, surprise {surprise:.1}",
        places.len()
    )
}

fn located(picture: &Picture) -> Located {
    scene().registrar.locate(picture, &|| true).unwrap_or_else(|why| panic!("{why}"))
}

#[test]
fn a_render_from_between_the_photographs_is_located_to_a_part_of_a_pixel() {
    for k in 0..3 {
        let truth = held_out(k, 2);
        let found = located(&shot(&truth));
        let off = off_px(&found, &truth);
        assert!(off < 1.0, "view {k}: {off} px, {}", said(&found));
        // A weak field: what is stated is no less than the truth.
        assert!(
            found.registered.explained > 0.8 && off < 3.0 * found.uncertainty_px,
            "view {k}: {off} px, {}",
            said(&found)
        );
        assert!(found.surprise > 20.0 && found.places.len() > 20, "view {k}: {}", said(&found));
    }
}

#[test]
fn turned_cut_small_dark_blurred_and_bent_pictures_are_located_as_well() {
    let camera = held_out(1, 2);
    // A camera that was turned takes a turned picture.
    let mut turned = camera;
    turned.pose.rotation *= DMat3::from_rotation_z(0.6);
    let (cut, of_cut) = part(&camera, &shot(&camera), [40, 20, 180, 200]);
    let small = camera.resized(SIDE, SIDE);
    // A lens as wide ones of telephones are: of the ends of a side it shows 3 % less than their distance.
    let mut bent = camera;
    bent.intrinsics.distortion = bent.intrinsics.distortion.with_first_radial(-0.1);
    let mut dark = shot(&camera);
    dark.rgb_mut().iter_mut().for_each(|v| *v = 0.1 + 0.6 * *v);
    for (what, truth, picture) in [
        ("turned", turned, shot(&turned)),
        ("cut", cut, of_cut),
        ("small", small, shot(&camera).resized(SIDE, SIDE).in_8_bits()),
        ("dark", camera, dark.in_8_bits()),
        ("blurred", camera, blurred(&shot(&camera)).in_8_bits()),
        ("bent", bent, shot(&bent)),
    ] {
        let found = located(&picture);
        let off = off_px(&found, &truth);
        assert!(off < 1.0, "{what}: {off} px, {}", said(&found));
    }
}

#[test]
fn a_photograph_of_the_place_is_located() {
    let view = &scene().capture.views[2 + 5];
    let found = located(&view.picture);
    let off = off_px(&found, &view.camera);
    assert!(off < 3.0, "{off} px, {}", said(&found));
}

#[test]
fn by_the_others_places_a_photograph_says_how_far_off_a_camera_is() {
    let Scene { capture, field, index, .. } = scene();
    let (own, other) = (&capture.views[5], &capture.views[capture.views.len() - 1]);
    let others = index.without(&own.name);
    assert!(others.points() < index.points() && index.without("none") == **index);
    let registrar = Registrar::new(field.clone(), Some(Arc::new(others)));
    let found = registrar.locate(&own.picture, &|| true).unwrap_or_else(|why| panic!("{why}"));
    assert!(found.off_px(&own.camera) < 3.0, "{} px, {}", found.off_px(&own.camera), said(&found));
    // In pixels of the picture, whatever size the camera has.
    let larger = own.camera.resized(3 * SIDE, 3 * SIDE);
    assert!((found.off_px(&larger) - found.off_px(&own.camera)).abs() < 1e-6);
    assert!(found.off_px(&other.camera) > 10.0, "{} px", found.off_px(&other.camera));
    let mut away = own.camera;
    away.pose.rotation *= DMat3::from_rotation_y(std::f64::consts::PI);
    assert_eq!(found.off_px(&away), f64::INFINITY);
}

#[test]
fn what_shows_something_else_is_located_nowhere() {
    let registrar = &scene().registrar;
    let mut state = 9u32;
    let mut noise = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32
    };
    let rough: Vec<f32> = (0..32 * 32 * 3).map(|_| noise()).collect();
    let blocks = Picture::new(32, 32, rough).unwrap().resized(8, 8);
    let coarse = (0..256 * 256).flat_map(|i| blocks.pixel(i % 256 / 32, i / 256 / 32)).collect();
    for picture in [
        Picture::new(256, 256, (0..256 * 256 * 3).map(|_| noise()).collect()).unwrap(),
        Picture::new(256, 256, coarse).unwrap(),
        Picture::constant(256, 256, [0.3; 3]),
    ] {
        let found = registrar.locate(&picture, &|| true);
        assert!(matches!(found, Err(NotLocated::NoAgreement { .. })), "{:?}", found.map(|f| said(&f)));
    }
    let found = registrar.locate(&Picture::constant(8, 300, [0.3; 3]), &|| true);
    assert_eq!(found.unwrap_err(), NotLocated::TooSmall { width: 8, height: 300 });
    let blind = Registrar::new(scene().field.clone(), None);
    assert_eq!(blind.locate(&shot(&held_out(0, 1)), &|| true).unwrap_err(), NotLocated::NoIndex);
}

#[test]
fn a_number_that_is_none_is_black_and_stops_nothing() {
    let truth = held_out(0, 2);
    let mut broken = shot(&truth);
    broken.rgb_mut()[7_777] = f32::NAN;
    broken.rgb_mut()[99] = f32::INFINITY;
    let found = located(&broken);
    let off = off_px(&found, &truth);
    assert!(off < 1.0, "{off} px, {}", said(&found));
}

#[test]
fn a_search_ends_once_it_is_not_wanted() {
    let picture = shot(&held_out(0, 1));
    let asked = std::cell::Cell::new(0u32);
    let until = |last: u32| {
        asked.set(0);
        let wanted = || {
            asked.set(asked.get() + 1);
            asked.get() <= last
        };
        scene().registrar.locate(&picture, &wanted)
    };
    let found = until(u32::MAX);
    let all = asked.get();
    assert!(found.is_ok() && all > 8, "asked {all} times");
    for last in [0, 1, all / 2, all - 1] {
        assert_eq!(until(last).unwrap_err(), NotLocated::GivenUp, "after {last} of {all}");
        assert!(asked.get() <= last + 2, "asked {} times after no at {last}", asked.get());
    }
    assert!(until(all).is_ok());
}

#[test]
fn where_the_camera_is_known_only_the_light_is_found() {
    let truth = held_out(1, 1);
    let mut dark = shot(&truth);
    dark.rgb_mut().iter_mut().for_each(|v| *v = 0.1 + 0.7 * *v);
    let registrar = Registrar::new(scene().field.clone(), None);
    let found = registrar.register_at(&dark, &truth).expect("a light");
    assert_eq!(found.camera, truth);
    assert!(found.explained > 0.98, "{}", found.explained);
    // A smaller copy is a smaller camera's.
    let found = registrar.register_at(&dark.resized(60, 60), &truth).expect("a light");
    assert_eq!(found.camera, truth.resized(60, 60));
    // From elsewhere the field shows something else, though another light makes much of it alike.
    let beside = registrar.register_at(&dark, &held_out(3, 1)).map_or(0.0, |f| f.explained);
    assert!(beside < 0.9, "{beside}");
}

#[test]
fn odd_cameras_and_pictures_are_registered_nowhere_or_somewhere_and_stop_nothing() {
    let (camera, registrar) = (held_out(0, 1), &scene().registrar);
    let picture = shot(&camera);
    let odd = |change: &dyn Fn(&mut Camera)| {
        let mut camera = camera;
        change(&mut camera);
        camera
    };
    let cameras = [
        odd(&|c| c.intrinsics.fx = f64::MIN_POSITIVE),
        odd(&|c| c.intrinsics.fx = 1e308),
        odd(&|c| c.intrinsics.cx = 1e308),
        odd(&|c| c.intrinsics.distortion = BrownConrady { k1: 1e300, ..Default::default() }.into()),
        odd(&|c| c.intrinsics.distortion = Fisheye::new([1e300, -1e300, 0.0, -0.1]).into()),
        odd(&|c| c.pose.position = DVec3::splat(1e308)),
        odd(&|c| (c.intrinsics.width, c.intrinsics.height) = (1, 1)),
        odd(&|c| (c.intrinsics.width, c.intrinsics.height) = (1 << 20, 1)),
    ];
    for camera in cameras {
        let found = registrar.register_at(&picture, &camera);
        assert!(found.is_none_or(|f| f.explained.is_finite() && f.explained <= 1.0), "{camera:?}");
    }
    for [w, h] in [[1, 1], [20, 20], [20, 5000], [64, 64]] {
        let flat = Picture::constant(w, h, [0.5; 3]);
        assert!(registrar.register_at(&flat, &camera).is_none_or(|f| f.explained.is_finite()), "{w} x {h}");
        assert!(registrar.locate(&flat, &|| true).is_err(), "{w} x {h}");
    }
}

#[test]
fn an_index_is_stored_and_comes_back_and_a_damaged_one_does_not() {
    let index = &scene().index;
    let bytes = index.to_bytes().unwrap();
    assert_eq!(&Index::read_from(&mut Cursor::new(&bytes)).unwrap(), index.as_ref());
    assert!(index.points() > 500, "{}", index.points());
    for cut in [0, 7, bytes.len() / 2, bytes.len() - 1] {
        assert!(Index::read_from(&mut Cursor::new(&bytes[..cut])).is_err(), "{cut} bytes");
    }
    let text = bytes.windows(14).position(|w| w == b"cairn.places/1").expect("its format");
    let mut other = bytes.clone();
    other[text + 13] = b'9';
    let refused = Index::read_from(&mut Cursor::new(&other)).unwrap_err().to_string();
    assert!(refused.contains("cairn.places/9"), "{refused}");
}

#[test]
fn an_index_that_is_not_wanted_any_more_is_given_up() {
    let view = &scene().capture.views[0];
    let references: Vec<Reference<'_>> = (0..40)
        .map(|_| Reference { camera: view.camera.resized(24, 24), name: &view.name, photograph: Box::new(|| None) })
        .collect();
    let mut asked = Vec::new();
    let given_up = Index::build(&scene().field, &references, &mut |done, of| {
        asked.push([done, of]);
        asked.len() < 2
    });
    assert!(given_up.is_none());
    assert!(asked.len() == 2 && asked[0] == [0, 40] && asked[1][0] > 0 && asked[1][0] < 40, "{asked:?}");
    assert!(Index::build(&scene().field, &[], &mut |_, _| true).is_none());
}
