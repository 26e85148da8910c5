//! What of a trained field shows. Training leaves thin haze and the inside of things
//! behind, that no picture needs and every ray has to step through.

use super::model::Field;
use crate::chance::mixed;
use crate::rays::lens::{Eye, Lens};
use crate::render::composite::{Kept, Thresholds, runs, weigh};
use cairn_scene::Camera;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Rays that are looked along for every occupied cell, spread evenly over all cameras'
/// pixels; at least and at most so many (if there are as many pixels).
const RAYS_A_CELL: usize = 4;
const MIN_RAYS: usize = 200_000;
const MAX_RAYS: usize = 4_000_000;

/// `field` without the cells that weigh less than `min_weight` (a share of a pixel,
/// [0, 1]) in every pixel looked at of the pictures that `cameras` take: a sample
/// of four pixels for every occupied cell, four million at most. Densities and colours of the other cells
/// stay as they are.
#[must_use]
pub fn only_what_shows(field: Field, cameras: &[Camera], min_weight: f64) -> Field {
    let lenses = Lens::shared(cameras.iter().copied());
    let eyes: Vec<Eye<'_>> = cameras.iter().zip(&lenses).map(|(camera, lens)| Eye { camera, lens }).collect();
    only_what_shows_to(field, &eyes, min_weight)
}

/// As [`only_what_shows`], with the cameras' lenses.
pub(crate) fn only_what_shows_to(mut field: Field, eyes: &[Eye<'_>], min_weight: f64) -> Field {
    let Field { grid, frame, .. } = &mut field;
    let occupancy = &grid.occupancy;
    let rays = (RAYS_A_CELL * occupancy.cells()).clamp(MIN_RAYS, MAX_RAYS);
    let every = (eyes.iter().map(|eye| eye.lens.pixels()).sum::<usize>() / rays).max(1);
    let seen: Vec<AtomicU64> = occupancy.words().iter().map(|_| AtomicU64::new(0)).collect();
    let [nx, ny, _] = grid.dims;
    let rows: Vec<(usize, usize)> =
        eyes.iter().enumerate().flat_map(|(n, eye)| (0..eye.lens.size().1).map(move |y| (n, y))).collect();
    rows.into_par_iter().for_each_init(Vec::new, |tape: &mut Vec<Kept<f32>>, (n, y)| {
        let width = eyes[n].lens.size().0;
        let first = mixed((n as u64) << 32 | y as u64) as usize % every;
        for x in (first..width).step_by(every) {
            let (path, _) = eyes[n].ray(frame, y * width + x);
            weigh(grid, &path, Thresholds::SHOWN, tape);
            for run in runs(tape) {
                if run.iter().map(|kept| f64::from(kept.weight)).sum::<f64>() >= min_weight {
                    let cell = run[0].cell as usize;
                    let (block, bit) = occupancy.place([cell % nx, cell / nx % ny, cell / (nx * ny)]);
                    seen[block].fetch_or(1 << bit, Ordering::Relaxed);
                }
            }
        }
    });
    grid.keep_cells(&seen.into_iter().map(AtomicU64::into_inner).collect::<Vec<_>>());
    field
}
