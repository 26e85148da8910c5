//! Whole pictures go tile by tile, and a tile's vertices are looked up once: they show what
//! each ray by itself shows, whatever the tile.

use crate::common::{ahead, apart, ball_box, ball_in_the_open, camera, field_of, random_appearance, random_grid};
use cairn_field::MarchedView;
use cairn_field::MarkableField;
use cairn_field::appearance::code::features;
use cairn_field::grid::lattice::Grid;
use cairn_field::rays::lens::Lens;
use cairn_field::render::composite::see;
use cairn_field::{Field, RayPath, SceneFrame, Thresholds};
use cairn_scene::{BrownConrady, Camera, Fisheye};
use glam::DVec3;

/// A camera of `across` x `down` pixels that sees `degrees` across.
fn sees(position: DVec3, target: DVec3, [across, down]: [usize; 2], degrees: f64) -> Camera {
    let mut camera = camera(position, target, across);
    let focal = across as f64 / 2.0 / (degrees.to_radians() / 2.0).tan();
    let i = &mut camera.intrinsics;
    (i.height, i.fx, i.fy, i.cy) = (down, focal, focal, down as f64 / 2.0);
    camera
}

/// The picture, each ray by itself and with its own colour basis.
fn ray_by_ray(field: &Field, camera: &Camera, limits: Thresholds) -> Vec<f32> {
    let (lens, look) = (Lens::new(camera), field.canonical_appearance());
    let mut tape = Vec::new();
    let pixel = |at| {
        let (path, basis) = lens.ray(camera, field.frame(), at);
        look.shade(&features(&see(field.grid(), &path, &basis, limits, &mut tape), &basis))
    };
    (0..lens.pixels()).flat_map(pixel).collect()
}

/// Sizes that tiles and groups of rays do not divide; a narrow angle, whose tiles are as large as they get,
/// and wider ones, whose tiles are a ray or a few.
const SHAPES: [([usize; 2], f64); 4] = [([67, 41], 40.0), ([33, 18], 3.0), ([1, 5], 10.0), ([13, 9], 110.0)];

fn check(frame: &SceneFrame, places: &[(DVec3, DVec3)]) {
    // Thin, so that rays meet many cells that lie far behind one another.
    let grid: Grid<f32> = random_grid([57, 49, 66], 0.7, -9.0..-3.0, 3);
    let field = field_of(frame, &grid, &random_appearance(5));
    for (position, target) in places {
        for (shape, degrees) in SHAPES {
            let camera = sees(*position, *target, shape, degrees);
            for limits in [Thresholds::SHOWN, Thresholds::EXACT] {
                let shown = field.render_within(&camera, field.canonical_appearance(), limits);
                let alone = ray_by_ray(&field, &camera, limits);
                let off = apart(shown.rgb(), &alone);
                // A twentieth of an 8-bit step, where colours turn with the direction far more than a real field's.
                assert!(off < 0.05 / 255.0, "from {position}, {shape:?}, {degrees} degrees: {off} off");
                let (low, high) = alone.iter().fold((f32::MAX, f32::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
                assert!(shape[0] == 1 || high - low > 0.05, "it shows something: {low} to {high}");
            }
        }
    }
}

#[test]
fn a_lens_that_folds_its_rim_spoils_no_pixel_beside_it() {
    let grid: Grid<f32> = random_grid([57, 49, 66], 0.7, -9.0..-3.0, 3);
    let field = field_of(&ball_box(), &grid, &random_appearance(5));
    let mut camera = sees(DVec3::new(-3.0, 0.7, 2.0), DVec3::ZERO, [400, 300], 71.0);
    camera.intrinsics.distortion = BrownConrady { k1: -0.3, ..Default::default() }.into();
    let shown = field.render(&camera, field.canonical_appearance());
    let off = apart(shown.rgb(), &ray_by_ray(&field, &camera, Thresholds::SHOWN));
    assert!(off < 0.05 / 255.0, "{off} off");
    // Neighbouring pixels look elsewhere altogether in some corner: it does fold.
    let along = |x: usize| camera.ray(x as f64 + 0.5, 0.5).1;
    assert!((1..400).any(|x| (along(x) - along(x - 1)).length() > 0.1), "a rim that is not folded shows nothing");
}

#[test]
fn a_fisheye_shows_what_its_rays_show_also_beside_and_behind_itself() {
    let grid: Grid<f32> = random_grid([57, 49, 66], 0.7, -9.0..-3.0, 3);
    for (frame, degrees) in [(ball_box(), 60.0), (ball_in_the_open(), 100.0), (ball_in_the_open(), 300.0)] {
        let field = field_of(&frame, &grid, &random_appearance(5));
        let look = field.canonical_appearance();
        let mut camera = sees(DVec3::new(-1.9, 0.7, 1.5), DVec3::ZERO, [67, 41], 40.0);
        let lens = Fisheye::new([-0.03, 0.004, -0.003, 0.0004]);
        let focal = 67f64.hypot(41.0) / 2.0 / lens.radius(f64::to_radians(degrees) / 2.0);
        let i = &mut camera.intrinsics;
        (i.fx, i.fy, i.distortion) = (focal, focal, lens.into());
        i.check_lens().unwrap();
        let alone = ray_by_ray(&field, &camera, Thresholds::SHOWN);
        let off = apart(field.render(&camera, look).rgb(), &alone);
        assert!(off < 0.05 / 255.0, "{degrees} degrees: {off} off");
        let weights = apart(&field.view(&camera, 0.0, 1).base(look), &alone);
        assert!(weights < 0.05 / 255.0, "{degrees} degrees: ray weights are {weights} off");
        let marched = apart(&MarchedView::new(&camera, 1).render(&field, look), &alone);
        assert!(marched < 0.05 / 255.0, "{degrees} degrees: marched it is {marched} off");
        let (low, high) = alone.iter().fold((f32::MAX, f32::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
        assert!(high - low > 0.05, "it shows something: {low} to {high}");
        // Each pixel's ray is the camera's, to what f32 keeps of a direction.
        let kept = Lens::new(&camera);
        for at in 0..kept.pixels() {
            let (origin, direction) = camera.ray((at % 67) as f64 + 0.5, (at / 67) as f64 + 0.5);
            match (kept.ray(&camera, &frame, at).0, frame.path(origin, direction)) {
                (
                    RayPath::Straight { direction: a, .. } | RayPath::Contracted { direction: a, .. },
                    RayPath::Straight { direction: b, .. } | RayPath::Contracted { direction: b, .. },
                ) => {
                    assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 2e-7), "{degrees} degrees, {at}: {a:?}, {b:?}")
                }
                (a, b) => assert_eq!(a, b, "{degrees} degrees, {at}"),
            }
        }
        let behind = camera.ray(0.5, 0.5).1.dot(camera.pose.forward());
        assert_eq!(behind < 0.0, degrees > 180.0);
    }
}

/// Pixels of several rays, in tiles of several pixels: a larger picture made smaller by area.
#[test]
fn pixels_of_several_rays_are_means_whatever_the_tile() {
    let grid: Grid<f32> = random_grid([57, 49, 66], 0.7, -9.0..-3.0, 3);
    for frame in [ball_box(), ball_in_the_open()] {
        let field = field_of(&frame, &grid, &random_appearance(5));
        let look = field.canonical_appearance();
        for (rays, degrees) in [(2, 3.0), (3, 3.0), (3, 25.0), (7, 3.0)] {
            let camera = sees(DVec3::new(-3.0, 0.7, 2.0), DVec3::ZERO, [33, 18], degrees);
            let large = camera.resized(33 * rays, 18 * rays);
            let mean = cairn_scene::AreaFilter::new([33 * rays, 18 * rays], [33, 18]).apply(&ray_by_ray(
                &field,
                &large,
                Thresholds::SHOWN,
            ));
            let told = format!("{rays} rays, {degrees} degrees");
            let linear = apart(&field.view(&camera, 0.0, rays).base(look), &mean);
            assert!(linear < 0.05 / 255.0, "{told}: ray weights are {linear} off");
            let marched = apart(&MarchedView::new(&camera, rays).render(&field, look), &mean);
            assert!(marched < 0.05 / 255.0, "{told}: marched it is {marched} off");
        }
    }
}

#[test]
fn a_picture_shows_what_its_rays_show_in_a_box() {
    let inside = (DVec3::new(0.2, 0.1, -0.3), DVec3::new(1.0, 0.3, 0.0));
    check(&ball_box(), &[(DVec3::new(-3.0, 0.7, 2.0), DVec3::ZERO), inside]);
}

#[test]
fn a_picture_shows_what_its_rays_show_in_the_open() {
    let inside = (DVec3::new(0.2, 0.1, -0.3), DVec3::new(1.0, 0.3, 0.0));
    let away = (DVec3::new(2.0, 0.3, 3.0), DVec3::new(5.0, 1.0, 9.0));
    check(&ball_in_the_open(), &[(DVec3::new(-3.0, 0.7, 2.0), DVec3::ZERO), inside, away]);
}

#[test]
fn a_picture_shows_what_its_rays_show_straight_ahead() {
    check(&ahead(), &[(DVec3::new(-0.3, 0.1, -0.2), DVec3::new(0.4, 0.0, 4.0))]);
}
