//! The linear view of a field is what it says: the difference of true renders,
//! with its exact transpose.

use crate::common::{
    Numbers, ahead, apart, ball_box, ball_in_the_open, camera, field_of, random_appearance, random_grid,
};
use cairn_field::grid::lattice::{Grid, ROW};
use cairn_field::grid::sh::{SH, SH_DC};
use cairn_field::{Appearance, Field, SceneFrame};
use cairn_field::{CarrierBasis, LinearView, MarkableField};
use glam::DVec3;

const BASES: [CarrierBasis; 2] = [CarrierBasis::Constant, CarrierBasis::Harmonics];

/// A field, the same with other colours, and the change as a carrier.
fn pair(frame: &SceneFrame, basis: CarrierBasis) -> (Field, Field, Vec<f32>) {
    let grid: Grid<f32> = random_grid([16, 14, 18], 0.7, -5.0..0.0, 31);
    let look = random_appearance(6);
    let before = field_of(frame, &grid, &look);
    let mut numbers = Numbers(77);
    let mut changed = grid.clone();
    for row in 1..grid.rows() {
        for c in 0..3 {
            for k in 0..if basis == CarrierBasis::Constant { 1 } else { SH } {
                changed.colour[row * ROW + 3 * k + c] += numbers.within(-0.5, 0.5) as f32;
            }
        }
    }
    let after = field_of(frame, &changed, &look);
    // Stored colours are half precision: the change is what became of them.
    let mut carrier = vec![0.0; grid.rows() * basis.width()];
    for row in 1..grid.rows() {
        for c in 0..3 {
            let change = |k: usize| {
                let at = row * ROW + 3 * k + c;
                after.grid().colour[at] - before.grid().colour[at]
            };
            match basis {
                CarrierBasis::Constant => carrier[row * 3 + c] = change(0) * SH_DC as f32,
                CarrierBasis::Harmonics => (0..SH).for_each(|k| carrier[(row * 3 + c) * SH + k] = change(k)),
            }
        }
    }
    (before, after, carrier)
}

fn cases() -> [(SceneFrame, DVec3); 3] {
    [
        (ball_box(), DVec3::new(-3.0, 0.7, 2.0)),
        (ball_in_the_open(), DVec3::new(-3.0, 0.7, 2.0)),
        (ahead(), DVec3::new(0.05, 0.1, 0.02)),
    ]
}

fn view(field: &Field, from: DVec3, cutoff: f32) -> (LinearView, cairn_scene::Camera) {
    let target = if from.z < 1.0 { DVec3::new(0.0, 0.0, 4.0) } else { DVec3::ZERO };
    let camera = camera(from, target, 24);
    (field.view(&camera, cutoff, 1), camera)
}

#[test]
fn a_change_of_colour_is_the_difference_of_renders() {
    for (frame, from) in cases() {
        for basis in BASES {
            let (before, after, carrier) = pair(&frame, basis);
            let look = random_appearance(12);
            let (linear, camera) = view(&before, from, 0.0);
            assert_eq!((linear.width(), linear.height()), (24, 24));
            let mut picture = linear.base(&look);
            assert!(apart(&picture, before.render(&camera, &look).rgb()) < 1e-5, "{frame:?}: the base is the render");
            linear.apply(&carrier, basis, &look, &mut picture);
            let [seen, changed] = [&before, &after].map(|field| field.render(&camera, &look));
            let expected = match basis {
                CarrierBasis::Harmonics => changed.rgb().to_vec(),
                // In no light but its own.
                CarrierBasis::Constant => {
                    let plain = Appearance::neutral([0.3; 3]);
                    let [seen_plain, changed_plain] = [&before, &after].map(|field| field.render(&camera, &plain));
                    let change = changed_plain.rgb().iter().zip(seen_plain.rgb()).map(|(a, b)| a - b);
                    seen.rgb().iter().zip(change).map(|(v, change)| v + change).collect()
                }
            };
            assert!(apart(&expected, seen.rgb()) > 0.02, "the change shows");
            let off = apart(&picture, &expected);
            assert!(off < 2e-5, "{frame:?}, {basis:?}: {off}");
            let off = apart(before.render_with(&camera, &look, &carrier, basis).rgb(), &expected);
            assert!(off < 2e-5, "{frame:?}, {basis:?}, rendered: {off}");
        }
    }
}

#[test]
fn the_transpose_is_exact() {
    for (frame, from) in cases() {
        for basis in BASES {
            let (field, _, x) = pair(&frame, basis);
            let look = random_appearance(12);
            let (linear, _) = view(&field, from, 1e-4);
            let mut ax = vec![0.0; 24 * 24 * 3];
            linear.apply(&x, basis, &look, &mut ax);
            let mut numbers = Numbers(4);
            let y: Vec<f32> = ax.iter().map(|_| numbers.within(-1.0, 1.0) as f32).collect();
            let mut aty = vec![0.0; x.len()];
            let mut touched = vec![false; field.rows()];
            linear.push_back(&y, basis, &look, &mut aty, &mut touched);
            let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
            let size = dot(&ax, &ax).sqrt() * dot(&y, &y).sqrt();
            let off = (dot(&ax, &y) - dot(&x, &aty)).abs();
            assert!(size > 0.1 && off < 1e-6 * size, "{frame:?}, {basis:?}: {off} of {size}");
            for (row, touched) in touched.iter().enumerate() {
                let any = aty[row * basis.width()..(row + 1) * basis.width()].iter().any(|v| *v != 0.0);
                assert!(*touched || !any, "row {row} has a gradient and is not touched");
            }
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same_transpose() {
    for (frame, from) in cases() {
        for basis in BASES {
            let (field, ..) = pair(&frame, basis);
            let (linear, _) = view(&field, from, 0.0);
            let (look, slope) = (random_appearance(12), (0..24 * 24 * 3).map(|i| (i as f32 * 0.7).sin()));
            let slope: Vec<f32> = slope.collect();
            let with = |threads| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                let (mut gradient, mut touched) = (vec![0.0; field.rows() * basis.width()], vec![false; field.rows()]);
                pool.install(|| linear.push_back(&slope, basis, &look, &mut gradient, &mut touched));
                (gradient, touched)
            };
            let one = with(1);
            assert!(one.1.iter().filter(|touched| **touched).count() > 100, "{frame:?}: rows are seen");
            for threads in [2, 5, 20] {
                assert!(with(threads) == one, "{frame:?}, {basis:?}: one thread and {threads} differ");
            }
        }
    }
}

#[test]
fn a_cutoff_leaves_out_little_and_saves_entries() {
    let (field, _, carrier) = pair(&ball_box(), CarrierBasis::Constant);
    let look = random_appearance(12);
    let from = DVec3::new(-3.0, 0.7, 2.0);
    let (whole, lean) = (view(&field, from, 0.0).0, view(&field, from, 2e-3).0);
    assert!(lean.density() < 0.8 * whole.density(), "{} of {}", lean.density(), whole.density());
    let (mut a, mut b) = (vec![0.0; 24 * 24 * 3], vec![0.0; 24 * 24 * 3]);
    whole.apply(&carrier, CarrierBasis::Constant, &look, &mut a);
    lean.apply(&carrier, CarrierBasis::Constant, &look, &mut b);
    assert!(crate::common::rms(&a, &b) < 0.01, "{}", crate::common::rms(&a, &b));
}

/// Several rays a pixel are a larger picture made smaller by area.
#[test]
fn several_rays_a_pixel_are_the_mean_of_a_larger_picture() {
    for (frame, from) in cases() {
        let (before, _, carrier) = pair(&frame, CarrierBasis::Constant);
        let look = random_appearance(12);
        let (one, camera) = view(&before, from, 0.0);
        let many = before.view(&camera, 0.0, 3);
        let large = before.view(&camera.resized(72, 72), 0.0, 1);
        assert_eq!((many.width(), many.height()), (24, 24));
        let picture = |linear: &LinearView| {
            let mut rgb = linear.base(&look);
            linear.apply(&carrier, CarrierBasis::Constant, &look, &mut rgb);
            rgb
        };
        let smaller = cairn_scene::AreaFilter::new([72, 72], [24, 24]).apply(&picture(&large));
        // Tiles are cut in other places, which is worth a fiftieth of an 8-bit step.
        assert!(apart(&picture(&many), &smaller) < 1e-4, "{frame:?}: {}", apart(&picture(&many), &smaller));
        assert!(apart(&picture(&one), &smaller) > 1e-3, "one ray a pixel sees the same");
        assert!(many.density() < 0.8 * 9.0 * large.density(), "rows are not put together");
        // And its transpose, where entries of many rays were put together.
        let mut numbers = Numbers(4);
        let y: Vec<f32> = (0..24 * 24 * 3).map(|_| numbers.within(-1.0, 1.0) as f32).collect();
        let (mut ax, mut aty) = (vec![0.0; y.len()], vec![0.0; carrier.len()]);
        many.apply(&carrier, CarrierBasis::Constant, &look, &mut ax);
        many.push_back(&y, CarrierBasis::Constant, &look, &mut aty, &mut vec![false; before.rows()]);
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
        assert!((dot(&ax, &y) - dot(&carrier, &aty)).abs() < 1e-6 * dot(&ax, &ax).sqrt() * dot(&y, &y).sqrt());
    }
}

/// A picture's bands and tiles need not come out even: pixels lie where they belong all the same.
#[test]
fn pictures_of_any_size_are_put_together_in_order() {
    let (frame, from) = cases()[0].clone();
    let (field, after, carrier) = pair(&frame, CarrierBasis::Constant);
    let plain = Appearance::neutral([0.3; 3]);
    for (width, height, rays) in [(37, 29, 1), (17, 9, 1), (1, 31, 1), (13, 11, 3), (5, 2, 7)] {
        let (_, square) = view(&field, from, 0.0);
        let camera = square.resized(width, height);
        let linear = field.view(&camera, 0.0, rays);
        let smaller = |field: &Field| {
            let large = field.render(&camera.resized(width * rays, height * rays), &plain);
            cairn_scene::AreaFilter::new([width * rays, height * rays], [width, height]).apply(large.rgb())
        };
        let mut picture = linear.base(&plain);
        assert!(apart(&picture, &smaller(&field)) < 1e-4, "{width} x {height} px, {rays} rays across one");
        linear.apply(&carrier, CarrierBasis::Constant, &plain, &mut picture);
        assert!(apart(&picture, &smaller(&after)) < 1e-4, "{width} x {height} px, {rays} rays across one, marked");
    }
}

/// A change of the field's own constant colours is what harmonics of degree 0 are, in any light, and has a transpose.
#[test]
fn constant_colours_are_seen_in_the_light_of_the_field_s_own() {
    for (frame, from) in cases() {
        let (field, _, carrier) = pair(&frame, CarrierBasis::Constant);
        let (linear, _) = view(&field, from, 0.0);
        let look = random_appearance(12);
        let mut harmonics = vec![0.0; carrier.len() * SH];
        harmonics.iter_mut().step_by(SH).zip(&carrier).for_each(|(h, c)| *h = c / SH_DC as f32);
        let (mut lit, mut expected) = (vec![0.0; 24 * 24 * 3], vec![0.0; 24 * 24 * 3]);
        linear.apply_lit(&carrier, &look, &mut lit);
        linear.apply(&harmonics, CarrierBasis::Harmonics, &look, &mut expected);
        let size = expected.iter().fold(0.0, |max: f32, v| max.max(v.abs()));
        let off = apart(&lit, &expected);
        assert!(size > 0.01 && off < 1e-5 * size, "{frame:?}: {off} of {size}");
        let mut numbers = Numbers(5);
        let y: Vec<f32> = (0..lit.len()).map(|_| numbers.within(-1.0, 1.0) as f32).collect();
        let mut back = vec![0.0; carrier.len()];
        linear.push_back_lit(&y, &look, &mut back);
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
        assert!((dot(&lit, &y) - dot(&carrier, &back)).abs() < 1e-6 * dot(&lit, &lit).sqrt() * dot(&y, &y).sqrt());
    }
}
