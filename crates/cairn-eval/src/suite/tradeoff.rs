//! What each limit of a render costs: the step, the early stop and the smallest alpha, varied one at a time, each with its
//! speed and its error against exact pictures.
//!
//! Speed is measured on whole pictures. Exact pictures in f64 take long, so errors are measured on a coarser lattice of
//! the same view's rays, for both alike.

use std::path::PathBuf;

use anyhow::Context as _;
use cairn_field::appearance::code::features;
use cairn_field::grid::sh;
use cairn_field::render::composite::gather;
use cairn_field::render::patch::Patch;
use cairn_field::{Appearance, Field, Thresholds};
use cairn_scene::Camera;
use serde::{Deserialize, Serialize};

use crate::children::Work;
use crate::file::read;
use crate::progress::Progress;
use crate::timing::{median, median_within};

/// What a pixel leaves out as shipped.
const SHIPPED: Thresholds = Thresholds::SHOWN;
/// Distance between samples of the exact picture, voxels.
const FINE_STEP: f64 = 0.0625;
/// Rays of a view whose error is looked at, at most.
const ERROR_RAYS: usize = 20_000;
/// Renders of a view that are timed at most, and seconds after which no more are.
const LAPS: (usize, f64) = (5, 4.0);
/// Distances between samples, voxels.
const STEPS: [f64; 4] = [0.125, 0.25, 0.5, 1.0];
const TRANSMITTANCES: [f64; 4] = [1e-4, 1e-3, 1e-2, 0.1];
const ALPHAS: [f64; 3] = [1e-5, 1e-4, 1e-3];

/// The renders of a stored field under other limits.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Tradeoffs {
    /// The stored field.
    pub field: PathBuf,
    /// From where, at full size.
    pub cameras: Vec<Camera>,
    /// What is shown while it runs.
    pub label: String,
}

/// Differences of pictures, in 8-bit levels (1/255 of white), before rounding.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Error {
    /// The largest of any pixel and channel.
    pub max: f64,
    /// Root of the mean square.
    pub rms: f64,
}

/// A render's limits, its speed and its error.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Tradeoff {
    /// What is varied.
    pub varied: String,
    /// What is varied, and to what.
    pub name: String,
    /// Rays a second at full size: the median over views of warm renders.
    pub rays_per_s: f64,
    /// Against f64 with samples [`FINE_STEP`] apart and nothing left out.
    pub error: Error,
}

impl Work for Tradeoffs {
    const NAME: &'static str = "tradeoffs";
    type Result = Vec<Tradeoff>;

    fn label(&self) -> &str {
        &self.label
    }

    fn run(&self) -> anyhow::Result<Vec<Tradeoff>> {
        let field = Field::from_bytes(&read(&self.field)?)?;
        let plan = plan();
        let mut progress = Progress::new(&self.label, (self.cameras.len() + plan.len()) as u64);
        let mut exact = Vec::new();
        for camera in &self.cameras {
            progress.at(exact.len() as u64, "exact pictures, ");
            let small = coarser(camera);
            exact.push((small, render_exact(&field, &small, field.canonical_appearance())));
        }
        let mut found = Vec::new();
        for (varied, name, limits) in plan {
            progress.at((exact.len() + found.len()) as u64, "");
            let render = |camera: &Camera| field.render_within(camera, field.canonical_appearance(), limits);
            let mut sum = Sum::default();
            exact.iter().for_each(|(small, exact)| sum.add(render(small).rgb(), exact));
            let rate = |camera: &Camera| {
                let seconds = median_within(LAPS.0, LAPS.1, || render(camera));
                (camera.intrinsics.width * camera.intrinsics.height) as f64 / seconds.max(1e-9)
            };
            let rates: Vec<f64> = self.cameras.iter().map(rate).collect();
            let rays_per_s = median(&rates).context("there is no view to render")?;
            found.push(Tradeoff { varied: varied.to_owned(), name, rays_per_s, error: sum.error() });
        }
        Ok(found)
    }
}

/// Everything that is varied, one at a time: what, a name for it, and the limits.
fn plan() -> Vec<(&'static str, String, Thresholds)> {
    let mut plan = vec![("as shipped", "as shipped".to_owned(), SHIPPED)];
    let nothing = Thresholds { step: SHIPPED.step, ..Thresholds::EXACT };
    plan.push(("nothing left out", "nothing left out".to_owned(), nothing));
    for step in STEPS.into_iter().filter(|step| *step != SHIPPED.step) {
        plan.push(("step", format!("step of {step} voxels"), Thresholds { step, ..SHIPPED }));
    }
    for transmittance in TRANSMITTANCES.into_iter().filter(|t| *t != SHIPPED.transmittance) {
        plan.push(("transmittance", format!("stop at {transmittance}"), Thresholds { transmittance, ..SHIPPED }));
    }
    for alpha in ALPHAS.into_iter().filter(|alpha| *alpha != SHIPPED.alpha) {
        plan.push(("alpha", format!("alpha from {alpha}"), Thresholds { alpha, ..SHIPPED }));
    }
    plan
}

/// The same view with fewer pixels.
fn coarser(camera: &Camera) -> Camera {
    let (w, h) = (camera.intrinsics.width, camera.intrinsics.height);
    let every = ((w * h) as f64 / ERROR_RAYS as f64).sqrt().ceil().max(1.0) as usize;
    if every == 1 { *camera } else { camera.resized((w / every).max(1), (h / every).max(1)) }
}

/// The picture in f64 with nothing left out, samples [`FINE_STEP`] apart: `height * width * 3` numbers, row-major, not
/// clamped.
fn render_exact(field: &Field, camera: &Camera, appearance: &Appearance) -> Vec<f64> {
    let mut grid = field.grid().cast::<f64>();
    grid.refresh_occupancy(0.0);
    let limits = Thresholds { step: FINE_STEP, ..Thresholds::EXACT };
    let (w, h) = (camera.intrinsics.width, camera.intrinsics.height);
    let (mut tape, mut patch) = (Vec::new(), Patch::default());
    let mut pixel = |at: usize| {
        let (origin, direction) = camera.ray((at % w) as f64 + 0.5, (at / w) as f64 + 0.5);
        let harmonics = sh::basis(direction.to_array());
        patch.begin(harmonics);
        let gathered = gather(&grid, &mut patch, &field.frame().path(origin, direction), 0.5, limits, &mut tape);
        appearance.shade(&features(&gathered, &harmonics))
    };
    (0..w * h).flat_map(&mut pixel).collect()
}

/// Sums of differences of clamped colours.
#[derive(Default)]
struct Sum {
    max: f64,
    squares: f64,
    count: f64,
}

impl Sum {
    fn add(&mut self, picture: &[f32], exact: &[f64]) {
        for (a, b) in picture.iter().zip(exact) {
            let difference = (f64::from(a.clamp(0.0, 1.0)) - b.clamp(0.0, 1.0)).abs() * 255.0;
            self.max = self.max.max(difference);
            self.squares += difference * difference;
            self.count += 1.0;
        }
    }

    fn error(&self) -> Error {
        Error { max: self.max, rms: (self.squares / self.count.max(1.0)).sqrt() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_those_of_clamped_colours_in_levels() {
        let mut sum = Sum::default();
        sum.add(&[0.5, 1.5], &[0.5 - 2.0 / 255.0, 1.2]);
        let error = sum.error();
        assert!((error.max - 2.0).abs() < 1e-4 && (error.rms - 2f64.sqrt()).abs() < 1e-4, "{error:?}");
    }
}
