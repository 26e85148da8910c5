//! A view whose densities move: the same picture as the linear view's where they do not,
//! and a gradient that finite differences agree with.

use crate::common::{
    Numbers, ahead, apart, ball_box, ball_in_the_open, camera, field_of, random_appearance, random_grid,
};
use cairn_field::grid::lattice::Grid;
use cairn_field::grid::sh::SH;
use cairn_field::{CHANGE, MarchedView};
use cairn_field::{CarrierBasis, MarkableField};
use cairn_field::{Field, SceneFrame};
use glam::DVec3;

/// Pixels across and down.
const SIDE: usize = 16;

fn cases() -> [(SceneFrame, DVec3); 3] {
    [
        (ball_box(), DVec3::new(-3.0, 0.7, 2.0)),
        (ball_in_the_open(), DVec3::new(-3.0, 0.7, 2.0)),
        (ahead(), DVec3::new(0.05, 0.1, 0.02)),
    ]
}

fn field(frame: &SceneFrame) -> Field {
    let grid: Grid<f32> = random_grid([16, 14, 18], 0.7, -4.0..0.5, 31);
    field_of(frame, &grid, &random_appearance(6))
}

fn seen_from(from: DVec3) -> cairn_scene::Camera {
    camera(from, if from.z < 1.0 { DVec3::new(0.0, 0.0, 4.0) } else { DVec3::ZERO }, SIDE)
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
}

#[test]
fn without_a_change_of_density_it_is_the_linear_view() {
    for (frame, from) in cases() {
        let (field, look, camera) = (field(&frame), random_appearance(12), seen_from(from));
        let mut numbers = Numbers(5);
        let colours: Vec<f32> = (0..field.grid().rows() * 3 * SH).map(|_| numbers.within(-0.3, 0.3) as f32).collect();
        let mut change = Vec::new();
        colours.chunks_exact(3 * SH).for_each(|row| {
            change.extend_from_slice(row);
            change.push(0.0);
        });
        for rays in [1, 2] {
            let linear = field.view(&camera, 0.0, rays);
            let marched = MarchedView::new(&camera, rays);
            let mut expected = linear.base(&look);
            let plain = marched.render(&field, &look);
            assert!(apart(&plain, &expected) < 1e-6, "{frame:?}, {rays} rays: as it was");
            linear.apply(&colours, CarrierBasis::Harmonics, &look, &mut expected);
            let changed = marched.render(&field.changed_by(&change), &look);
            assert!(apart(&plain, &changed) > 0.01, "{frame:?}: the change shows");
            // A pixel's rays have their own directions there and share one here.
            let off = apart(&changed, &expected);
            assert!(off < if rays == 1 { 2e-5 } else { 1e-2 }, "{frame:?}, {rays} rays: {off}");
        }
    }
}

#[test]
fn the_gradient_is_that_of_finite_differences() {
    for (frame, from) in cases() {
        for rays in [1, 3] {
            let (field, look, view) = (field(&frame), random_appearance(12), MarchedView::new(&seen_from(from), rays));
            let mut numbers = Numbers(9);
            let slope: Vec<f32> = (0..SIDE * SIDE * 3).map(|_| numbers.within(-1.0, 1.0) as f32).collect();
            let mut gradient = vec![0.0; field.grid().rows() * CHANGE];
            let mut touched = vec![false; field.grid().rows()];
            view.push_back(&field, &slope, &look, &mut gradient, &mut touched);
            for (row, numbers) in gradient.chunks_exact(CHANGE).enumerate() {
                assert!(touched[row] || numbers.iter().all(|v| *v == 0.0), "row {row} is not touched");
            }
            // Along the gradient of the colours alone, and of the densities alone.
            for (what, is_density) in [("colours", false), ("densities", true)] {
                let part = |(i, v): (usize, &f32)| if (i % CHANGE == 3 * SH) == is_density { *v } else { 0.0 };
                let along: Vec<f32> = gradient.iter().enumerate().map(part).collect();
                let square = dot(&along, &along);
                let step = 0.02 / along.iter().fold(0.0f32, |m, v| m.max(v.abs()));
                let loss = |sign: f32| {
                    let moved: Vec<f32> = along.iter().map(|v| sign * step * v).collect();
                    dot(&slope, &view.render(&field.changed_by(&moved), &look))
                };
                let expected = (loss(1.0) - loss(-1.0)) / (2.0 * f64::from(step));
                // A ray that ends a sample earlier makes a small step in the picture, which no gradient knows.
                let off = (square / expected - 1.0).abs();
                assert!(square > 0.1 && off < 0.02, "{frame:?}, {rays} rays, {what}: {square} for {expected}");
            }
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same_gradient() {
    let (field, look) = (field(&ball_in_the_open()), random_appearance(3));
    let view = MarchedView::new(&camera(DVec3::new(-3.0, 0.7, 2.0), DVec3::ZERO, 50), 1);
    let slope: Vec<f32> = (0..50 * 50 * 3).map(|i| (i as f32 * 0.7).sin()).collect();
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (mut gradient, mut touched) = (vec![0.0; field.grid().rows() * CHANGE], vec![false; field.grid().rows()]);
        pool.install(|| view.push_back(&field, &slope, &look, &mut gradient, &mut touched));
        gradient
    };
    assert!(with(1) == with(3), "one thread and three differ");
}
