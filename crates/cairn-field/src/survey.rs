//! What of a trained field shows. Training leaves thin haze and the inside of things
//! behind, that no picture needs and every ray has to step through.

use crate::composite::{Kept, Thresholds, runs, weigh};
use crate::field::Field;
use crate::rays::Lens;
use crate::sampling::mixed;
use cairn_scene::Camera;
use rayon::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Rays that are looked along for every occupied cell, spread evenly over all cameras'
/// pixels; at least and at most so many (if there are as many pixels).
const RAYS_A_CELL: usize = 4;
const LEAST_RAYS: usize = 200_000;
const MOST_RAYS: usize = 4_000_000;

impl Field {
    /// The field without the cells that weigh less than `least` (a share of a pixel,
    /// [0, 1]) in every pixel looked at of the pictures that `cameras` take: a sample
    /// of four pixels for every occupied cell, four million at most. Densities and colours of the other cells
    /// stay as they are.
    #[must_use]
    pub fn only_what_shows(self, cameras: &[Camera], least: f64) -> Self {
        let lenses = Lens::shared(cameras.iter().copied());
        let views: Vec<(Camera, Arc<Lens>)> = cameras.iter().copied().zip(lenses).collect();
        self.only_what_shows_in(&views, least)
    }

    /// As [`Field::only_what_shows`], with the cameras' lenses.
    pub(crate) fn only_what_shows_in(mut self, views: &[(Camera, Arc<Lens>)], least: f64) -> Self {
        let occupancy = &self.grid.occupancy;
        let rays = (RAYS_A_CELL * occupancy.cells()).clamp(LEAST_RAYS, MOST_RAYS);
        let every = (views.iter().map(|(_, l)| l.pixels()).sum::<usize>() / rays).max(1);
        let seen: Vec<AtomicU64> = occupancy.words().iter().map(|_| AtomicU64::new(0)).collect();
        let [nx, ny, _] = self.grid.dims;
        let rows: Vec<(usize, usize)> =
            views.iter().enumerate().flat_map(|(n, (_, l))| (0..l.size().1).map(move |y| (n, y))).collect();
        rows.into_par_iter().for_each_init(Vec::new, |tape: &mut Vec<Kept<f32>>, (n, y)| {
            let (camera, lens) = &views[n];
            let width = lens.size().0;
            let first = mixed((n as u64) << 32 | y as u64) as usize % every;
            for x in (first..width).step_by(every) {
                let (path, _) = lens.ray(camera, &self.frame, y * width + x);
                weigh(&self.grid, &path, Thresholds::SHOWN, tape);
                for run in runs(tape) {
                    if run.iter().map(|kept| f64::from(kept.weight)).sum::<f64>() >= least {
                        let cell = run[0].cell as usize;
                        let (block, bit) = occupancy.place([cell % nx, cell / nx % ny, cell / (nx * ny)]);
                        seen[block].fetch_or(1 << bit, Ordering::Relaxed);
                    }
                }
            }
        });
        self.grid.keep_cells(&seen.into_iter().map(AtomicU64::into_inner).collect::<Vec<_>>());
        self
    }
}
