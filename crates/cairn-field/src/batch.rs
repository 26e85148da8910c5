//! One training batch: which rays, what they show, and what their errors owe the
//! grid and the appearances.

use crate::appearance::{Appearance, FEATURES, features};
use crate::composite::{Kept, Owed, Regularise, Thresholds, gather, push_back};
use crate::frame::SceneFrame;
use crate::grid::Grid;
use crate::sh::SH;
use crate::trainer::Prepared;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Rays a task handles: enough to amortise, few enough to balance two cores.
const CHUNK: usize = 128;

/// What a batch is drawn from.
pub(crate) struct BatchSettings<'a> {
    pub(crate) views: &'a [Prepared],
    pub(crate) frame: &'a SceneFrame,
    pub(crate) grid: &'a Grid<f32>,
    pub(crate) neutral: &'a Appearance,
    pub(crate) appearances: &'a [Appearance],
    pub(crate) rays: usize,
    pub(crate) huber: f32,
    pub(crate) regularise: Regularise<f32>,
    pub(crate) limits: Thresholds,
    /// Seed and step: the only source of chance.
    pub(crate) stream: (u64, u64),
}

/// A shaded ray, for the appearances' gradient.
pub(crate) struct Shaded {
    pub(crate) view: u32,
    pub(crate) slope: [f32; 3],
    pub(crate) features: [f32; FEATURES],
}

/// A batch's outcome.
pub(crate) struct Batch {
    /// Mean squared error a channel.
    pub(crate) loss: f64,
    /// Whether every gradient at a sample is a finite number.
    pub(crate) finite: bool,
    /// Gradients at samples, in chunks in ray order.
    pub(crate) owed: Vec<Vec<Owed<f32>>>,
    /// Colour basis of each ray.
    pub(crate) bases: Vec<[f32; SH]>,
    /// Empty where the scene has no appearances.
    pub(crate) shaded: Vec<Shaded>,
}

#[derive(Default)]
struct Chunk {
    loss: f64,
    broken: bool,
    owed: Vec<Owed<f32>>,
    bases: Vec<[f32; SH]>,
    shaded: Vec<Shaded>,
}

impl Batch {
    /// Draws rays uniformly over all pixels of all views, renders them and
    /// walks their errors back.
    pub(crate) fn draw(settings: &BatchSettings<'_>) -> Self {
        let (seed, step) = settings.stream;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(step + 1);
        let mut ends = Vec::with_capacity(settings.views.len());
        let mut all = 0u64;
        for view in settings.views {
            all += view.lens.pixels() as u64;
            ends.push(all);
        }
        let rays: Vec<(u64, f32)> =
            (0..settings.rays).map(|_| (rng.random_range(0..all), rng.random::<f32>())).collect();
        let chunks: Vec<Chunk> = rays
            .par_chunks(CHUNK)
            .enumerate()
            .map_init(Vec::new, |tape, (c, rays)| {
                let mut out = Chunk { owed: Vec::with_capacity(CHUNK * 48), ..Chunk::default() };
                for (i, (pixel, offset)) in rays.iter().enumerate() {
                    let view = ends.partition_point(|e| e <= pixel);
                    let first = if view == 0 { 0 } else { ends[view - 1] };
                    one_ray(settings, view, (pixel - first) as usize, *offset, (c * CHUNK + i) as u32, tape, &mut out);
                }
                out
            })
            .collect();
        let loss = chunks.iter().map(|c| c.loss).sum::<f64>() / (3 * settings.rays) as f64;
        let finite = !chunks.iter().any(|c| c.broken);
        let (mut owed, mut bases, mut shaded) = (Vec::new(), Vec::with_capacity(settings.rays), Vec::new());
        for chunk in chunks {
            owed.push(chunk.owed);
            bases.extend(chunk.bases);
            shaded.extend(chunk.shaded);
        }
        Self { loss, finite, owed, bases, shaded }
    }
}

fn one_ray(
    s: &BatchSettings<'_>,
    view: usize,
    at: usize,
    offset: f32,
    ray: u32,
    tape: &mut Vec<Kept<f32>>,
    out: &mut Chunk,
) {
    let prepared = &s.views[view];
    let (path, basis) = prepared.lens.ray(&prepared.camera, s.frame, at);
    let gathered = gather(s.grid, &path, &basis, f64::from(offset), s.limits, tape);
    let appearance = s.appearances.get(view).unwrap_or(s.neutral);
    let f = features(&gathered, &basis);
    let shade = appearance.shade(&f);
    let slope: [f32; 3] = std::array::from_fn(|c| {
        let residual = shade[c] - f32::from(prepared.pixels[at * 3 + c]) / 255.0;
        out.loss += f64::from(residual * residual);
        2.0 * if s.huber > 0.0 { residual.clamp(-s.huber, s.huber) } else { residual }
    });
    let first = out.owed.len();
    push_back(tape, gathered.end, &appearance.pull(slope, &basis), &s.regularise, ray, &mut out.owed);
    // One not finite makes the sum so (they are few, and none nears f32's end).
    let sum: f32 = out.owed[first..].iter().map(|o| o.raw + o.colour[0] + o.colour[1] + o.colour[2]).sum();
    out.broken |= !sum.is_finite();
    out.bases.push(basis);
    if !s.appearances.is_empty() {
        out.shaded.push(Shaded { view: view as u32, slope, features: f });
    }
}
