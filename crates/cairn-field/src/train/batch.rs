//! One training batch: which rays, what they show, and what their errors owe the
//! grid and the appearances.

use super::sampling::Tile;
use super::shown::Shown;
use crate::appearance::code::{FEATURES, features};
use crate::chance::mixed;
use crate::render::composite::{Kept, Thresholds, gather, push_back};
use crate::render::patch::{Debts, Patch, Roulette};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::sync::{Mutex, PoisonError};

/// Rays a task handles: enough to amortise, few enough to balance two cores.
const TASK_RAYS: usize = 128;

/// What a batch is drawn from.
pub(crate) struct BatchSettings<'a> {
    pub(crate) shown: Shown<'a>,
    pub(crate) tiles: &'a [Tile],
    pub(crate) huber: f32,
    /// The colour of pixels that show nothing, and the price of light stopped before one.
    pub(crate) nothing: Option<([u8; 3], f32)>,
    pub(crate) distortion: f32,
    pub(crate) limits: Thresholds,
    /// Vertices that weigh less in their tile take their chance; see [`Roulette`].
    pub(crate) faint: f32,
    /// Seed and step: the only source of chance.
    pub(crate) stream: (u64, u64),
}

/// A shaded ray, for the appearances' gradient.
pub(crate) struct Shaded {
    pub(crate) view: u32,
    pub(crate) slope: [f32; 3],
    pub(crate) features: [f32; FEATURES],
}

/// A batch's outcome, in room that the next batch uses again.
#[derive(Default)]
pub(crate) struct Batch {
    /// Mean squared error a channel.
    pub(crate) loss: f64,
    /// Whether every gradient at a sample is a finite number.
    pub(crate) finite: bool,
    tasks: Vec<Task>,
    /// Tasks of this batch; those behind are left over from a larger one.
    used: usize,
    /// Patches at rest: a thread takes one for a task, so that it stays in its cache.
    patches: Mutex<Vec<Patch<f32>>>,
}

#[derive(Default)]
struct Task {
    loss: f64,
    /// Rays that were walked: those whose pixels are to be learnt from.
    rays: usize,
    broken: bool,
    tape: Vec<Kept<f32>>,
    debts: Debts<f32>,
    roulette: Roulette,
    /// Empty where the scene has no appearances.
    shaded: Vec<Shaded>,
}

impl Batch {
    /// Renders the tiles' rays and walks their errors back.
    pub(crate) fn draw(&mut self, settings: &BatchSettings<'_>) {
        let (seed, step) = settings.stream;
        let a_task = (TASK_RAYS / settings.tiles.first().map_or(1, Tile::len)).max(1);
        self.used = settings.tiles.len().div_ceil(a_task);
        if self.tasks.len() < self.used {
            self.tasks.resize_with(self.used, Task::default);
        }
        let patches = &self.patches;
        self.tasks.par_iter_mut().zip(settings.tiles.par_chunks(a_task)).enumerate().for_each(|(n, (task, tiles))| {
            let mut rng = ChaCha8Rng::seed_from_u64(mixed(seed ^ mixed(n as u64)));
            rng.set_stream(step + 1);
            task.clear(Roulette { below: settings.faint, state: rng.random() });
            let at_rest = || patches.lock().unwrap_or_else(PoisonError::into_inner);
            let taken = at_rest().pop();
            let mut patch = taken.unwrap_or_default();
            for tile in tiles {
                task.tile(settings, tile, &mut patch, &mut rng);
            }
            at_rest().push(patch);
        });
        let tasks = &self.tasks[..self.used];
        let rays = tasks.iter().map(|t| t.rays).sum::<usize>().max(1);
        self.loss = tasks.iter().map(|t| t.loss).sum::<f64>() / (3 * rays) as f64;
        self.finite = !tasks.iter().any(|t| t.broken);
    }

    /// What is owed the grid, by task.
    pub(crate) fn debts(&self) -> Vec<&Debts<f32>> {
        self.tasks[..self.used].iter().map(|t| &t.debts).collect()
    }

    /// The shaded rays in their order; none where the scene has no appearances.
    pub(crate) fn shaded(&self) -> impl Iterator<Item = &Shaded> {
        self.tasks[..self.used].iter().flat_map(|t| &t.shaded)
    }
}

impl Task {
    fn clear(&mut self, roulette: Roulette) {
        (self.loss, self.rays, self.broken) = (0.0, 0, false);
        self.debts.owed.clear();
        self.debts.bases.clear();
        self.shaded.clear();
        self.roulette = roulette;
    }

    fn tile(&mut self, s: &BatchSettings<'_>, tile: &Tile, patch: &mut Patch<f32>, rng: &mut ChaCha8Rng) {
        let prepared = &s.shown.views[tile.view];
        let width = prepared.lens.size().0;
        let middle = (tile.y + tile.bottom) / 2 * width + (tile.x + tile.right) / 2;
        patch.begin(prepared.eye().ray(s.shown.frame, middle).1);
        for y in tile.y..tile.bottom {
            for x in tile.x..tile.right {
                self.ray(s, tile.view, y * width + x, rng.random(), patch);
            }
        }
        self.broken |= !patch.settle(&mut self.roulette, &mut self.debts);
    }

    fn ray(&mut self, s: &BatchSettings<'_>, view: usize, at: usize, offset: f32, patch: &mut Patch<f32>) {
        let prepared = &s.shown.views[view];
        if !prepared.uses(at) {
            return;
        }
        self.rays += 1;
        let (path, basis) = prepared.eye().ray(s.shown.frame, at);
        let gathered = gather(s.shown.grid, patch, &path, f64::from(offset), s.limits, &mut self.tape);
        let appearance = s.shown.look(view);
        let f = features(&gathered, &basis);
        let shade = appearance.shade(&f);
        let pixel = &prepared.pixels()[at * 3..at * 3 + 3];
        let slope: [f32; 3] = std::array::from_fn(|c| {
            let residual = shade[c] - f32::from(pixel[c]) / 255.0;
            self.loss += f64::from(residual * residual);
            2.0 * if s.huber > 0.0 { residual.clamp(-s.huber, s.huber) } else { residual }
        });
        let mut pulled = appearance.pull(slope, &basis);
        if let Some((colour, price)) = s.nothing
            && pixel == colour
        {
            pulled.end -= price;
        }
        push_back(patch, &self.tape, gathered.end, &pulled, s.distortion);
        if !s.shown.appearances.is_empty() {
            self.shaded.push(Shaded { view: view as u32, slope, features: f });
        }
    }
}
