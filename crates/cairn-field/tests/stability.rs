//! Numbers at their ends: what has an exact answer gets exactly that, or as near as
//! stated; what has none gets an error; and nothing is ever not a number.

use crate::common::{Numbers, Ray, ahead, apart, ball_box, ball_in_the_open, camera, field_of, random_grid, raw_for};
use cairn_field::appearance::code::features;
use cairn_field::grid::lattice::Grid;
use cairn_field::grid::sh::basis;
use cairn_field::render::composite::{Gathered, Kept, gather};
use cairn_field::render::patch::Patch;
use cairn_field::{Appearance, FieldConfig, RayPath, Real, SceneFrame, Thresholds, contract};
use glam::DVec3;

const SKY: [f32; 3] = [0.1, 0.2, 0.3];

/// Rays that meet the grid, from inside, outside and along axes.
fn rays(frame: &SceneFrame) -> Vec<Ray> {
    let mut numbers = Numbers(9);
    let mut cube = |size: f64| DVec3::from([0.0; 3].map(|_| numbers.within(-size, size)));
    let mut rays: Vec<_> = (0..100).map(|i| (cube(if i % 2 == 0 { 0.9 } else { 6.0 }), cube(0.9))).collect();
    // What forward-facing rays may do.
    rays.extend((0..40).map(|_| (cube(0.1), cube(1.0) + DVec3::new(0.0, 0.0, 4.0))));
    rays.extend([DVec3::X, -DVec3::Y, DVec3::Z].map(|d| (-3.0 * d, d)));
    rays.into_iter()
        .map(|(origin, target)| Ray::towards(origin, target))
        .filter(|ray| ray.path(frame) != RayPath::Miss)
        .collect()
}

fn gathered<T: Real>(frame: &SceneFrame, grid: &Grid<T>, ray: Ray, limits: Thresholds) -> Gathered<T> {
    let mut patch = Patch::default();
    patch.begin(basis(ray.direction.to_array().map(T::of)));
    gather(grid, &mut patch, &ray.path(frame), 0.5, limits, &mut Vec::<Kept<T>>::new())
}

fn frames() -> [SceneFrame; 3] {
    [ball_box(), ball_in_the_open(), ahead()]
}

#[test]
fn nothing_and_walls_are_exact_along_whole_rays() {
    let dims = [9, 8, 10];
    for frame in frames() {
        let rays = rays(&frame);
        assert!(rays.len() > 20, "only {} rays", rays.len());
        for limits in [Thresholds::SHOWN, Thresholds::EXACT] {
            // Neither a grid without rows nor one of the least densities stops anything.
            let nothing: Grid<f32> = Grid::with_vertices(dims, Vec::new());
            let thin: Grid<f32> = Grid::full(dims, -1e4, 0.6);
            for ray in &rays {
                let g = gathered(&frame, &nothing, *ray, limits);
                assert_eq!(g, Gathered { end: 1.0, ..Gathered::default() }, "{ray:?}");
                let g = gathered(&frame, &thin, *ray, limits);
                assert_eq!(g.end, 1.0, "{ray:?}");
                assert!([g.near_weight, g.far_weight, g.along].iter().all(|v| (0.0..1e-30).contains(v)), "{g:?}");
            }
            // A wall everywhere: all of the light from its first sample, in its colour.
            for raw in [500.0, 1e4, 1e8, 1e30] {
                let grid: Grid<f32> = Grid::full(dims, raw, 0.625);
                for ray in &rays {
                    let g = gathered(&frame, &grid, *ray, limits);
                    assert_eq!((g.end, g.near_weight + g.far_weight), (0.0, 1.0), "raw {raw}, {ray:?}");
                    let colour: [f32; 3] = std::array::from_fn(|c| g.near[c] + g.far[c]);
                    assert!(apart(&colour, &[0.625; 3]) < 2e-7, "raw {raw}, {ray:?}: {colour:?}");
                }
                let grid = grid.cast::<f64>();
                for ray in &rays {
                    let g = gathered(&frame, &grid, *ray, limits);
                    assert_eq!((g.end, g.near_weight + g.far_weight), (0.0, 1.0), "raw {raw}, {ray:?}");
                    let off = (0..3).map(|c| (g.near[c] + g.far[c] - 0.625).abs()).fold(0.0, f64::max);
                    // The colour's coefficient was an f32.
                    assert!(off < 1e-7, "raw {raw}, {ray:?}: {off}");
                }
            }
        }
    }
}

/// How far a ray goes through the unit cube.
fn length(frame: &SceneFrame, ray: Ray) -> f64 {
    match ray.path(frame) {
        RayPath::Straight { direction, start, end, .. } => DVec3::from(direction).length() * (end - start),
        RayPath::Contracted { origin, direction } => {
            let (o, d) = (DVec3::from(origin), DVec3::from(direction));
            let places = 100_000;
            let at = |i: usize| match i as f64 / f64::from(places) {
                1.0 => 0.5 * d,
                u => 0.25 * contract(o + d * (u / (1.0 - u))),
            };
            (0..places as usize).map(|i| (at(i + 1) - at(i)).length()).sum()
        }
        RayPath::Miss => panic!("it meets the box"),
    }
}

/// Light that a constant medium leaves of a ray's, and how many samples it took.
fn light_left<T: Real>(frame: &SceneFrame, density: f64, step: f64, side: usize, ray: Ray) -> (f64, f64) {
    let grid: Grid<T> = Grid::full([side; 3], raw_for(density), 0.625);
    let (mut patch, mut tape) = (Patch::default(), Vec::<Kept<T>>::new());
    patch.begin(basis(ray.direction.to_array().map(T::of)));
    let limits = Thresholds { step, ..Thresholds::EXACT };
    let g = gather(&grid, &mut patch, &ray.path(frame), 0.5, limits, &mut tape);
    let (all, samples) = (g.near_weight.wide() + g.far_weight.wide() + g.end.wide(), tape.len() as f64);
    assert!((all - 1.0).abs() < 1e-9 + samples * T::epsilon().wide(), "{all}: what is not stopped goes on");
    (g.end.wide(), samples)
}

/// A constant medium in a box whose unit cube is a cube: light left is exp(-density length).
fn medium<T: Real>(density: f64, step: f64, side: usize, ray: Ray) -> (f64, f64) {
    let frame = ball_box();
    (light_left::<T>(&frame, density, step, side, ray).0, (-density * length(&frame, ray)).exp())
}

const ACROSS: Ray = Ray { origin: DVec3::new(-3.0, 0.1, 0.2), direction: DVec3::X };

/// Two rays that cross the frame.
fn crossing(frame: &SceneFrame) -> [Ray; 2] {
    match frame {
        SceneFrame::ForwardFacing { .. } => [
            Ray::towards(DVec3::new(0.1, 0.0, -0.5), DVec3::new(0.1, 0.0, 4.0)),
            Ray::towards(DVec3::new(-0.3, 0.2, 0.0), DVec3::new(1.1, -0.9, 4.0)),
        ],
        _ => [ACROSS, Ray::towards(DVec3::new(-3.0, 0.7, 2.0), DVec3::new(0.0, 0.2, 0.2))],
    }
}

#[test]
fn steps_over_eight_orders_of_magnitude_give_the_closed_form() {
    for frame in frames() {
        // Contracted space is sampled a voxel at a time at the finest, here a third of the cube.
        let quadrature = if frame.is_unbounded() { 1e-3 } else { 1e-9 };
        for (ray, smallest) in crossing(&frame).into_iter().zip([-6, -5]) {
            let length = length(&frame, ray);
            for density in [1e-3, 1.0, 3.7] {
                let expected = (-density * length).exp();
                for power in smallest..=2 {
                    // Three million samples at the smallest.
                    let step = 10f64.powi(power);
                    let place = format!("{frame:?}, density {density}, step {step}");
                    let (wide, _) = light_left::<f64>(&frame, density, step, 4, ray);
                    assert!((wide - expected).abs() < quadrature, "f64, {place}: {wide}, not {expected}");
                    let (short, samples) = light_left::<f32>(&frame, density, step, 4, ray);
                    // Each sample rounds what it lets through and what is left, by a quarter of an epsilon
                    // each at most. For three million that would be 0.2; they come to 0.024.
                    let rounding = (1e-6 + samples * f64::from(f32::EPSILON) / 2.0).min(0.03);
                    assert!((short - wide).abs() < rounding, "f32, {place}: {short}, not {wide}");
                }
            }
        }
    }
}

#[test]
fn contracted_space_gives_the_closed_form_on_finer_lattices() {
    let frame = ball_in_the_open();
    for ray in crossing(&frame) {
        let length = length(&frame, ray);
        for density in [1e-3, 1.0, 3.7] {
            let expected = (-density * length).exp();
            let (wide, _) = light_left::<f64>(&frame, density, 0.5, 129, ray);
            let (short, samples) = light_left::<f32>(&frame, density, 0.5, 129, ray);
            assert!((wide - expected).abs() < 1e-6, "f64, density {density}: {wide}, not {expected}");
            assert!((short - wide).abs() < 1e-6 + samples * f64::from(f32::EPSILON) / 2.0, "f32: {short}, not {wide}");
        }
    }
}

#[test]
fn settings_allow_no_step_but_those_that_pictures_are_made_of() {
    for step in [1e-6, 0.249, 2.001, 1e2, f64::INFINITY, f64::NAN] {
        let config = FieldConfig { step_voxels: step, ..FieldConfig::default() };
        let error = config.validate().expect_err("out of range").to_string();
        assert!(error.contains("field.step_voxels") && error.contains("0.25 to 2"), "{step}: {error}");
    }
    for step in [0.25, 2.0] {
        FieldConfig { step_voxels: step, ..FieldConfig::default() }.validate().expect("in range");
    }
}

#[test]
fn absurd_steps_are_bounded_work() {
    // Without a bound on samples, the first would take a million years.
    for step in [1e-30, 0.0] {
        let (got, expected) = medium::<f64>(1.0, step, 2, ACROSS);
        assert!((got - expected).abs() < 1e-8, "step {step}: {got}, not {expected}");
    }
    for step in [1e30, f64::INFINITY] {
        let (got, expected) = medium::<f64>(1.0, step, 5, ACROSS);
        assert!((got - expected).abs() < 1e-12, "one sample for all: {got}, not {expected}");
    }
}

#[test]
fn densities_from_nothing_to_a_hundred_million_give_the_closed_form() {
    for i in -80..=80 {
        let density = 10f64.powf(f64::from(i) / 10.0);
        for step in [0.5, 1.0] {
            let (got, expected) = medium::<f64>(density, step, 20, ACROSS);
            assert!((got - expected).abs() < 1e-11, "f64, density {density}: {got}, not {expected}");
            let (got, expected) = medium::<f32>(density, step, 20, ACROSS);
            assert!((got - expected).abs() < 3e-6, "f32, density {density}: {got}, not {expected}");
            // What is nearly all stopped is as exact as what is nearly all let through.
            let off = (got - expected).abs() / expected.max(1e-30);
            assert!(density > 60.0 || off < 2e-5, "f32, density {density}: {got}, {off} of {expected} off");
        }
    }
}

#[test]
fn cameras_in_the_grid_on_one_another_and_looking_away_show_what_is_there() {
    let look = Appearance::neutral(SKY);
    let background = |d: DVec3| {
        let basis = basis(d.to_array().map(|v| v as f32));
        look.shade(&features(&Gathered { end: 1.0f32, ..Gathered::default() }, &basis))
    };
    for frame in frames() {
        let field = field_of(&frame, &random_grid([12, 12, 12], 1.0, -3.0..0.0, 2), &look);
        let finite = |camera| {
            let maps = field.render_maps(&camera, &look);
            assert!(maps.picture.rgb().iter().chain(&maps.accumulation).chain(&maps.depth).all(|v| v.is_finite()));
            maps
        };
        // On a vertex, on a side of the cube, at its corner, and beyond.
        for place in [DVec3::ZERO, DVec3::splat(1.25), DVec3::new(1.25, 0.0, 0.0), DVec3::new(0.1, 0.2, -0.1)] {
            let inwards = camera(place, DVec3::new(0.05, 0.1, 0.6), 8);
            let maps = finite(inwards);
            assert!(maps.accumulation.iter().any(|a| *a > 0.1), "{frame:?}, from {place}");
            // A second camera in the same place sees the same.
            assert_eq!(maps.picture, finite(inwards).picture);
        }
        let away = match &frame {
            SceneFrame::ForwardFacing { .. } => camera(DVec3::ZERO, DVec3::new(0.1, 0.3, -5.0), 8),
            _ => camera(DVec3::new(0.0, 0.0, 3.0), DVec3::new(0.0, 0.5, 9.0), 8),
        };
        let maps = finite(away);
        if !frame.is_unbounded() {
            assert!(maps.accumulation.iter().chain(&maps.depth).all(|v| *v == 0.0), "{frame:?}");
            for (i, pixel) in maps.picture.rgb().chunks_exact(3).enumerate() {
                let (_, d) = away.ray((i % 8) as f64 + 0.5, (i / 8) as f64 + 0.5);
                assert!(apart(pixel, &background(d)) == 0.0, "{frame:?}: {pixel:?} is not the background");
            }
        }
    }
}
