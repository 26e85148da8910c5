//! Serving marks as a part: a fresh process that loads a stored marked field and its
//! detector, renders views with their marks and reads them, as a daemon does when it is asked.

use std::path::PathBuf;

use anyhow::Context;
use cairn_eval::{Stopwatch, median};
use cairn_mark::{Detector, MarkedField};
use cairn_scene::Camera;
use serde::{Deserialize, Serialize};

use super::super::field::progress::Progress;
use super::super::memory::peak_mib;
use cairn_service::query::evaluate::eight_bits;

/// Renders and readings of a view that are timed at most, and seconds after which no more are.
const LAPS: (usize, f64) = (3, 2.0);

/// What to serve.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Task {
    /// The stored marked field.
    pub marked: PathBuf,
    /// The stored detector.
    pub detector: PathBuf,
    /// From where.
    pub cameras: Vec<Camera>,
    /// What people are told.
    pub label: String,
}

/// How it went.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Served {
    /// Rays a second of renders with a mark (without, where a pose is nobody's): the median over views.
    pub rays_per_s: f64,
    /// Seconds to say whose a picture is and what it hides: the median over views.
    pub reading_s: f64,
    /// The same of renders of the base field, which are looked at more closely.
    pub reading_unmarked_s: f64,
    /// The most memory held, MiB; `None` where the system does not tell.
    pub peak_mib: Option<f64>,
}

/// Loads, renders in the field's own appearance, and reads.
///
/// # Errors
/// For a field or detector that does not read, and no camera at all.
pub fn run(task: &Task) -> anyhow::Result<Served> {
    let marked =
        MarkedField::read_from(&mut super::open(&task.marked)?).with_context(|| task.marked.display().to_string())?;
    let detector = Detector::from_bytes(&super::read(&task.detector)?)?;
    let appearance = marked.base().canonical_appearance().clone();
    let mut progress = Progress::new(&task.label, task.cameras.len() as u64);
    let (mut rates, mut reading, mut reading_unmarked) = (Vec::new(), Vec::new(), Vec::new());
    for camera in &task.cameras {
        progress.at(rates.len() as u64, "");
        let seconds = Stopwatch::median_within(LAPS.0, LAPS.1, || marked.render(camera, &appearance));
        rates.push((camera.intrinsics.width * camera.intrinsics.height) as f64 / seconds.max(1e-9));
        let renders = [marked.render(camera, &appearance), marked.base().render(camera, &appearance)];
        for (render, seconds) in renders.iter().zip([&mut reading, &mut reading_unmarked]) {
            let picture = eight_bits(render)?;
            detector.detect(&picture)?;
            seconds.push(Stopwatch::median_within(LAPS.0, LAPS.1, || detector.detect(&picture)));
        }
    }
    let no_view = || anyhow::anyhow!("there is no view to render");
    let [rays_per_s, reading_s, reading_unmarked_s] = [&rates, &reading, &reading_unmarked].map(|all| median(all));
    Ok(Served {
        rays_per_s: rays_per_s.ok_or_else(no_view)?,
        reading_s: reading_s.ok_or_else(no_view)?,
        reading_unmarked_s: reading_unmarked_s.ok_or_else(no_view)?,
        peak_mib: peak_mib(),
    })
}
