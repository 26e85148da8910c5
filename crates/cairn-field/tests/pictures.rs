//! Whole pictures go tile by tile, and a tile's vertices are looked up once: they show what
//! each ray by itself shows, whatever the tile.

use crate::common::{ahead, apart, ball_box, ball_in_the_open, camera, field_of, random_appearance, random_grid};
use cairn_field::MarchedView;
use cairn_field::MarkableField;
use cairn_field::appearance::code::features;
use cairn_field::grid::lattice::Grid;
use cairn_field::rays::lens::Lens;
use cairn_field::render::composite::see;
use cairn_field::{Field, SceneFrame, Thresholds};
use cairn_scene::Camera;
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
    camera.intrinsics.distortion.k1 = -0.3;
    let shown = field.render(&camera, field.canonical_appearance());
    let off = apart(shown.rgb(), &ray_by_ray(&field, &camera, Thresholds::SHOWN));
    assert!(off < 0.05 / 255.0, "{off} off");
    // Neighbouring pixels look elsewhere altogether in some corner: it does fold.
    let along = |x: usize| camera.ray(x as f64 + 0.5, 0.5).1;
    assert!((1..400).any(|x| (along(x) - along(x - 1)).length() > 0.1), "a rim that is not folded shows nothing");
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
