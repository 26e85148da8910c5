//! Serving as a part: a fresh process that loads a stored field and renders, and
//! nothing else, timed and its memory read.

use std::path::PathBuf;

use anyhow::Context;
use cairn_eval::{Stopwatch, median};
use cairn_field::Field;
use cairn_scene::Camera;
use serde::{Deserialize, Serialize};

use super::super::memory::peak_mib;
use super::progress::Progress;

/// Renders of a view that are timed at most, and seconds after which no more are.
const LAPS: (usize, f64) = (5, 4.0);

/// What to render.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Task {
    /// The stored field.
    pub field: PathBuf,
    /// From where.
    pub cameras: Vec<Camera>,
    /// What people are told.
    pub label: String,
}

/// How it went.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Served {
    /// Rays a second: the median over views of each one's median warm render.
    pub rays_per_s: f64,
    /// The most memory held, MiB; `None` where the system does not tell.
    pub peak_mib: Option<f64>,
}

/// Loads and renders, in the field's own appearance.
///
/// # Errors
/// For a field that does not read.
pub fn run(task: &Task) -> anyhow::Result<Served> {
    let field = Field::read_from(&mut super::open(&task.field)?).with_context(|| task.field.display().to_string())?;
    let mut progress = Progress::new(&task.label, task.cameras.len() as u64);
    let mut rates = Vec::new();
    for camera in &task.cameras {
        progress.at(rates.len() as u64, "");
        let render = || field.render(camera, field.canonical_appearance());
        let seconds = Stopwatch::median_within(LAPS.0, LAPS.1, render);
        rates.push((camera.intrinsics.width * camera.intrinsics.height) as f64 / seconds.max(1e-9));
    }
    let rays_per_s = median(&rates).ok_or_else(|| anyhow::anyhow!("there is no view to render"))?;
    Ok(Served { rays_per_s, peak_mib: peak_mib() })
}
