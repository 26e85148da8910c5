//! A view of a field whose densities move as well as its colours. Then a pixel is no
//! fixed sum of coefficients any more: every look at the view marches its rays anew, and
//! a picture's gradient walks back along them (`composite`), as in stage 1.

use super::model::{CHANGE, Field};
use crate::appearance::code::{Appearance, FEATURES, features};
use crate::grid::sh::SH;
use crate::rays::lens::{Eye, Lens};
use crate::render::composite::{Kept, Thresholds, gather, push_back};
use crate::render::patch::{Debts, Patch, Roulette};
use crate::render::picture::{Seen, Tiling};
use cairn_scene::Camera;
use rayon::prelude::*;

/// Pixels a task handles, and tasks whose gradients are held at a time.
const TASK: usize = 32;
const WAVE: usize = 64;

/// One view, marched anew each time; see the module's text.
#[derive(Debug)]
pub struct MarchedView {
    width: usize,
    height: usize,
    /// Rays across a pixel.
    rays: usize,
    /// `rays` times as large as the view.
    fine: Camera,
    lens: Lens,
}

/// A thread's room, used again for every pixel.
#[derive(Default)]
struct Room {
    patch: Patch<f32>,
    tape: Vec<Kept<f32>>,
}

impl MarchedView {
    /// The view of `camera`, whose pixels are means over `rays x rays` rays each.
    ///
    /// # Panics
    /// When `rays` is 0.
    pub fn new(camera: &Camera, rays: usize) -> Self {
        assert!(rays > 0, "a pixel needs a ray");
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        let fine = if rays == 1 { *camera } else { camera.resized(width * rays, height * rays) };
        Self { width, height, rays, lens: Lens::new(&fine), fine }
    }

    /// The picture of `field`, `height x width x 3`, not clamped.
    pub fn render(&self, field: &Field, appearance: &Appearance) -> Vec<f32> {
        let share = 1.0 / (self.rays * self.rays) as f32;
        let eye = Eye { camera: &self.fine, lens: &self.lens };
        let tiling = Tiling::of(&field.grid, &field.frame, eye, Thresholds::SHOWN, self.rays);
        let add = |sum: &mut [f32; FEATURES], seen: &Seen<'_>| {
            sum.iter_mut().zip(features(&seen.gathered, &seen.harmonics)).for_each(|(s, f)| *s += f);
        };
        let sums = tiling.gather(add, |sum| sum.iter_mut().for_each(|s| *s *= share));
        sums.into_iter().flat_map(|sum| appearance.shade(&sum)).collect()
    }

    /// Adds to `gradient` (`rows x` [`CHANGE`]) what d(loss)/d(picture) owes the field's
    /// coefficients and raw densities; `touched` hears each row. A pixel's rays share their
    /// middle's colour basis ([`Patch`]). Sums come out the same with any number of threads.
    ///
    /// # Panics
    /// When `slope` is of another size.
    pub fn push_back(
        &self,
        field: &Field,
        slope: &[f32],
        appearance: &Appearance,
        gradient: &mut [f32],
        touched: &mut [bool],
    ) {
        assert_eq!(slope.len(), self.width * self.height * 3, "a picture of this view's size");
        for (wave, slopes) in slope.chunks(WAVE * TASK * 3).enumerate() {
            let task = |room: &mut Room, (n, slopes): (usize, &[f32])| {
                let mut debts = Debts::default();
                for (i, g) in slopes.chunks_exact(3).enumerate() {
                    let at = (wave * WAVE + n) * TASK + i;
                    self.pixel_back(field, at, [g[0], g[1], g[2]], appearance, room, &mut debts);
                }
                debts
            };
            let tasks = slopes.par_chunks(TASK * 3).enumerate();
            let all: Vec<Debts<f32>> = tasks.map_init(Room::default, task).collect();
            for debts in &all {
                pay(debts, gradient, touched);
            }
        }
    }

    /// Walks one pixel's rays back.
    fn pixel_back(
        &self,
        field: &Field,
        at: usize,
        slope: [f32; 3],
        appearance: &Appearance,
        room: &mut Room,
        debts: &mut Debts<f32>,
    ) {
        // Most of a picture may lie outside the window that was looked at.
        if slope == [0.0; 3] {
            return;
        }
        let share = 1.0 / (self.rays * self.rays) as f32;
        let middle = self.first_ray(at) + self.rays / 2 * (self.width * self.rays + 1);
        let Room { patch, tape } = room;
        patch.begin(self.lens.ray(&self.fine, &field.frame, middle).1);
        for of in self.rays_of(at) {
            let (path, basis) = self.lens.ray(&self.fine, &field.frame, of);
            let gathered = gather(&field.grid, patch, &path, 0.5, Thresholds::SHOWN, tape);
            let pulled = appearance.pull(slope.map(|g| g * share), &basis);
            push_back(patch, tape, gathered.end, &pulled, 0.0);
        }
        // What is not finite stays so in the sum, and whoever takes the step looks at that.
        let mut all = Roulette::NONE;
        patch.settle(&mut all, debts);
    }

    /// The first of a pixel's rays, in the larger view.
    fn first_ray(&self, pixel: usize) -> usize {
        pixel / self.width * self.rays * (self.width * self.rays) + pixel % self.width * self.rays
    }

    fn rays_of(&self, pixel: usize) -> impl Iterator<Item = usize> + use<> {
        let (first, rays, across) = (self.first_ray(pixel), self.rays, self.width * self.rays);
        (0..rays * rays).map(move |ray| first + ray / rays * across + ray % rays)
    }
}

/// Adds debts to a gradient, in their order.
fn pay(debts: &Debts<f32>, gradient: &mut [f32], touched: &mut [bool]) {
    for debt in &debts.owed {
        let (row, basis) = (debt.row as usize, &debts.bases[debt.tile as usize]);
        touched[row] = true;
        let out = &mut gradient[row * CHANGE..(row + 1) * CHANGE];
        for (c, light) in debt.light.iter().enumerate() {
            for (o, b) in out[c * SH..(c + 1) * SH].iter_mut().zip(basis) {
                *o += light * b;
            }
        }
        out[3 * SH] += debt.raw;
    }
}
