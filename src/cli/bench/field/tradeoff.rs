//! Limits of a render as a part: step, early stop, least alpha and storage, one
//! varied at a time, each with its speed and its error against exact pictures.
//!
//! Speed is measured on whole pictures. Exact pictures in f64 take long, so errors
//! are measured on a coarser lattice of the same view's rays, for both alike.

use std::borrow::Cow;
use std::path::PathBuf;

use cairn_eval::{Stopwatch, median};
use cairn_field::{Field, Thresholds};
use cairn_scene::{Camera, Picture};
use serde::{Deserialize, Serialize};

use super::adapter::{self, SHIPPED, STORED, Storage};
use super::progress::Progress;

/// Distance between samples of the finest exact picture, voxels.
pub const FINE_STEP: f64 = 0.0625;
/// Rays of a view whose error is looked at, at most.
const ERROR_RAYS: usize = 20_000;
/// Rounds of renders, the one to warm up included, and seconds after which no more
/// follow, but one that was timed.
const ROUNDS: usize = 6;
const ENOUGH_S: f64 = 90.0;

const STEPS: [f64; 5] = [0.125, 0.25, 0.5, 1.0, 2.0];
const TRANSMITTANCES: [f64; 8] = [0.0, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1];
const ALPHAS: [f64; 6] = [0.0, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2];

/// What to measure.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Task {
    /// The stored field.
    pub field: PathBuf,
    /// From where, at full size.
    pub cameras: Vec<Camera>,
    /// What people are told.
    pub label: String,
}

/// What is varied; everything else is as shipped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Varied {
    /// Nothing is left out, at the shipped step and in f32.
    Nothing,
    /// Distance between samples, voxels.
    Step,
    /// Light from behind below which a ray ends.
    Transmittance,
    /// Alpha below which a sample is passed over.
    Alpha,
    /// Bits that colours are stored in.
    Storage,
}

impl Varied {
    /// As it stands in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Nothing => "nothing left out",
            Self::Step => "step",
            Self::Transmittance => "transmittance",
            Self::Alpha => "alpha",
            Self::Storage => "storage",
        }
    }
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
    /// What was varied.
    pub varied: Varied,
    /// To what.
    pub value: f64,
    /// The same for people.
    pub label: String,
    /// Whether this is how it is shipped.
    pub shipped: bool,
    /// Rays a second at full size: the median over views of warm renders.
    pub rays_per_s: f64,
    /// Against f64 with samples as far apart and nothing left out.
    pub own: Error,
    /// Against f64 with samples [`FINE_STEP`] apart and nothing left out.
    pub fine: Error,
    /// Views looked at.
    pub views: usize,
    /// Rays whose error was looked at, of all views together.
    pub error_rays: usize,
    /// All rays of those views.
    pub rays: usize,
}

/// A view with its exact pictures.
struct Reference {
    camera: Camera,
    small: Camera,
    fine: Vec<f64>,
    /// At the shipped step.
    shipped: Vec<f64>,
}

/// Measures them all. Precisions that this release cannot store are said on
/// standard error.
///
/// # Errors
/// For a field that does not read, and for no cameras.
pub fn run(task: &Task) -> anyhow::Result<Vec<Tradeoff>> {
    let field = Field::from_bytes(&super::read(&task.field)?)?;
    anyhow::ensure!(!task.cameras.is_empty(), "there is no view to render");
    let (wanted, fields) = possible(&field);
    let units = task.cameras.len() + wanted.len() * (1 + ROUNDS);
    let mut progress = Progress::new(&task.label, units as u64);
    let mut references = Vec::new();
    for camera in &task.cameras {
        progress.at(references.len() as u64, "exact pictures, ");
        references.push(Reference::new(&field, camera));
    }
    let mut errors = Vec::new();
    for (w, stored) in wanted.iter().zip(&fields) {
        progress.at((references.len() + errors.len()) as u64, "errors, ");
        errors.push(w.errors(stored, &field, &references));
    }
    let rates = rates(&wanted, &fields, &task.cameras, &mut progress);
    let pixels = |of: fn(&Reference) -> &Camera| references.iter().map(|r| rays(of(r))).sum();
    let found = wanted.into_iter().zip(errors).zip(rates).map(|((w, (own, fine)), rays_per_s)| Tradeoff {
        varied: w.varied,
        value: w.value,
        label: w.label,
        shipped: w.shipped,
        rays_per_s,
        own,
        fine,
        views: references.len(),
        error_rays: pixels(|r| &r.small),
        rays: pixels(|r| &r.camera),
    });
    Ok(found.collect())
}

/// What this release can measure, each with the field to render; the rest is said.
fn possible(field: &Field) -> (Vec<Wanted>, Vec<Cow<'_, Field>>) {
    let as_wanted = |w: Wanted| {
        let Some(storage) = w.storage.filter(|s| *s != STORED) else { return Some((w, Cow::Borrowed(field))) };
        let stored = adapter::stored_as(field, storage);
        if stored.is_none() {
            eprintln!("SKIPPED storage {}: this release cannot store it", storage.as_str());
        }
        Some((w, Cow::Owned(stored?)))
    };
    plan().into_iter().filter_map(as_wanted).unzip()
}

/// Rays a second of each, the median over views of its renders' median. They take
/// turns, so that a busy moment of the machine is shared by all. What is as shipped
/// is the same render under several names, and takes one turn.
fn rates(wanted: &[Wanted], fields: &[Cow<'_, Field>], cameras: &[Camera], progress: &mut Progress) -> Vec<f64> {
    let first_shipped = wanted.iter().position(|w| w.shipped);
    let own_turn = |at: usize| !wanted[at].shipped || Some(at) == first_shipped;
    let mut seconds = vec![vec![Vec::new(); cameras.len()]; wanted.len()];
    let mut watch = Stopwatch::start();
    let prepared = cameras.len() + wanted.len();
    // The first round warms up.
    for round in 0..ROUNDS {
        for at in (0..wanted.len()).filter(|at| own_turn(*at)) {
            progress.at((prepared + round * wanted.len() + at) as u64, "timing, ");
            for (camera, laps) in cameras.iter().zip(&mut seconds[at]) {
                watch.lap();
                std::hint::black_box(wanted[at].render(&fields[at], camera));
                let lap = watch.lap().as_secs_f64();
                if round > 0 {
                    laps.push(lap);
                }
            }
        }
        if round > 0 && watch.laps_s().iter().sum::<f64>() > ENOUGH_S {
            break;
        }
    }
    let rate = |at: usize| {
        let at = if own_turn(at) { at } else { first_shipped.unwrap_or(at) };
        let views = cameras.iter().zip(&seconds[at]);
        let rates: Vec<f64> =
            views.filter_map(|(camera, laps)| Some(rays(camera) as f64 / median(laps)?.max(1e-9))).collect();
        median(&rates).unwrap_or(f64::NAN)
    };
    (0..wanted.len()).map(rate).collect()
}

/// Pixels of a camera.
fn rays(camera: &Camera) -> usize {
    camera.intrinsics.width * camera.intrinsics.height
}

/// A measurement to be made.
struct Wanted {
    varied: Varied,
    value: f64,
    label: String,
    shipped: bool,
    limits: Thresholds,
    storage: Option<Storage>,
}

/// Everything that is varied, one at a time. Shipped values are in every row of them.
fn plan() -> Vec<Wanted> {
    let limits = |varied, value: f64, shipped: f64, limits| Wanted {
        varied,
        value,
        label: if value != 0.0 && value < 1e-3 { format!("{value:e}") } else { format!("{value}") },
        shipped: value == shipped,
        limits,
        storage: None,
    };
    let nothing = Thresholds { step: SHIPPED.step, ..Thresholds::EXACT };
    let mut plan = vec![Wanted { label: String::new(), ..limits(Varied::Nothing, 0.0, f64::NAN, nothing) }];
    for v in with(&STEPS, SHIPPED.step) {
        plan.push(limits(Varied::Step, v, SHIPPED.step, Thresholds { step: v, ..SHIPPED }));
    }
    for v in with(&TRANSMITTANCES, SHIPPED.transmittance) {
        let changed = Thresholds { transmittance: v, ..SHIPPED };
        plan.push(limits(Varied::Transmittance, v, SHIPPED.transmittance, changed));
    }
    for v in with(&ALPHAS, SHIPPED.alpha) {
        plan.push(limits(Varied::Alpha, v, SHIPPED.alpha, Thresholds { alpha: v, ..SHIPPED }));
    }
    plan.extend(Storage::ALL.map(|storage| Wanted {
        varied: Varied::Storage,
        value: storage.bits(),
        label: storage.as_str().to_owned(),
        shipped: storage == STORED,
        limits: SHIPPED,
        storage: Some(storage),
    }));
    plan
}

/// `values` with the shipped one among them, ascending.
fn with(values: &[f64], shipped: f64) -> Vec<f64> {
    let mut all = values.to_vec();
    all.push(shipped);
    all.sort_by(f64::total_cmp);
    all.dedup();
    all
}

impl Reference {
    fn new(field: &Field, camera: &Camera) -> Self {
        let (w, h) = (camera.intrinsics.width, camera.intrinsics.height);
        let every = ((w * h) as f64 / ERROR_RAYS as f64).sqrt().ceil().max(1.0) as usize;
        let small = if every == 1 { *camera } else { camera.resized((w / every).max(1), (h / every).max(1)) };
        let exact = |step| adapter::render_exact(field, &small, field.canonical_appearance(), step);
        Self { camera: *camera, small, fine: exact(FINE_STEP), shipped: exact(SHIPPED.step) }
    }
}

impl Wanted {
    fn render(&self, field: &Field, camera: &Camera) -> Picture {
        field.render_within(camera, field.canonical_appearance(), self.limits)
    }

    /// Errors of `field` so rendered, against exact pictures of the field as
    /// `trained`: at the same step, and at the finest.
    fn errors(&self, field: &Field, trained: &Field, references: &[Reference]) -> (Error, Error) {
        let (mut own, mut fine) = (Sum::default(), Sum::default());
        for r in references {
            let picture = self.render(field, &r.small);
            fine.add(picture.rgb(), &r.fine);
            if self.limits.step == SHIPPED.step {
                own.add(picture.rgb(), &r.shipped);
            } else {
                let exact = adapter::render_exact(trained, &r.small, trained.canonical_appearance(), self.limits.step);
                own.add(picture.rgb(), &exact);
            }
        }
        (own.error(), fine.error())
    }
}

/// What storing does to pictures of `exact`, a field whose colours are not rounded: `stored` against it, both rendered as
/// shipped, in the light that fits every view.
pub fn storing(exact: &Field, stored: &Field, cameras: &[Camera]) -> Error {
    let mut sum = Sum::default();
    for camera in cameras {
        let [exact, stored] = [exact, stored].map(|field| field.render(camera, field.canonical_appearance()));
        let exact: Vec<f64> = exact.rgb().iter().map(|v| f64::from(*v)).collect();
        sum.add(stored.rgb(), &exact);
    }
    sum.error()
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
    fn every_limit_is_varied_around_its_shipped_value() {
        let plan = plan();
        for varied in [Varied::Step, Varied::Transmittance, Varied::Alpha, Varied::Storage] {
            let of = plan.iter().filter(|w| w.varied == varied);
            assert_eq!(of.clone().filter(|w| w.shipped).count(), 1, "{varied:?}");
            assert!(of.count() >= if varied == Varied::Storage { 2 } else { 3 }, "{varied:?}");
        }
        assert_eq!(with(&[0.0, 2.0], 1.0), [0.0, 1.0, 2.0]);
        assert_eq!(with(&[0.0, 1.0], 1.0), [0.0, 1.0]);
    }

    #[test]
    fn errors_are_those_of_clamped_colours_in_levels() {
        let mut sum = Sum::default();
        sum.add(&[0.5, 1.5], &[0.5 - 2.0 / 255.0, 1.2]);
        let error = sum.error();
        assert!((error.max - 2.0).abs() < 1e-4 && (error.rms - 2f64.sqrt()).abs() < 1e-4, "{error:?}");
    }
}
