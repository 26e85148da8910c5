//! Screens a capture into which wrong photographs were put, and prints the fits of the worst: how
//! the quarantine's settings were chosen, and what they leave as margin.
//!
//! `cargo run --release -p cairn-field --example screen -- FOLDER SCALE SETTINGS WRONG SEEDS [FOLDER of other photographs]`:
//! stage 1's settings as JSON, how many photographs to spoil, and seeds 1 to SEEDS.

use cairn_field::{FieldConfig, QuarantineConfig, SceneFrame, Screening, TrainingView};
use cairn_scene::{Capture, Picture, ReadOptions};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Instant;

type Fallible<T> = Result<T, Box<dyn std::error::Error>>;

/// Views printed.
const SHOWN: usize = 12;

fn views(capture: &Capture, scale: f64) -> Fallible<Vec<TrainingView>> {
    let view = |i: usize| {
        let view = &capture.views[i];
        let size = |v: usize| ((v as f64 * scale).round() as usize).max(1);
        let (w, h) = (size(view.camera.intrinsics.width), size(view.camera.intrinsics.height));
        let picture = Arc::new(capture.photograph(i)?.resized(w, h));
        Ok(TrainingView {
            name: view.name.clone(),
            contributor: view.contributor.clone(),
            camera: view.camera.resized(w, h),
            picture,
        })
    };
    capture.training().map(view).collect()
}

/// Spoils view `at`, and says how.
fn spoil(views: &mut [TrainingView], at: usize, how: usize, other: Option<&Capture>) -> Fallible<&'static str> {
    let n = views.len();
    let (w, h) = (views[at].picture.width(), views[at].picture.height());
    let kinds = ["noise", "turned", "another's", "pose", "mirrored", "15 degrees", "elsewhere"];
    let kind = kinds[how % if other.is_some() { 7 } else { 6 }];
    let mut state = at as u64;
    let mut noise = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1u64 << 24) as f32
    };
    let picture = &views[at].picture;
    let rgb: Vec<f32> = match kind {
        "noise" => (0..w * h * 3).map(|_| noise()).collect(),
        "turned" => picture.rgb().chunks(3).rev().flatten().copied().collect(),
        "mirrored" => picture.rgb().chunks(3 * w).flat_map(|row| row.chunks(3).rev().flatten()).copied().collect(),
        "another's" => views[(at + n / 2 + 1) % n].picture.resized(w, h).rgb().to_vec(),
        "elsewhere" => match other {
            Some(other) => other.photograph(how % other.views.len())?.resized(w, h).rgb().to_vec(),
            None => Vec::new(),
        },
        _ => picture.rgb().to_vec(),
    };
    if kind == "pose" {
        views[at].camera.pose = views[(at + n / 3 + 1) % n].camera.pose;
    } else if kind == "15 degrees" {
        let pose = &mut views[at].camera.pose;
        pose.rotation *= glam::DMat3::from_rotation_y(15f64.to_radians());
    }
    views[at].picture = Arc::new(Picture::new(w, h, rgb)?);
    Ok(kind)
}

fn main() -> Fallible<()> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, folder, scale, config, wrong, seeds, rest @ ..] = arguments.as_slice() else {
        return Err("usage: screen FOLDER SCALE SETTINGS WRONG SEEDS [FOLDER of other photographs]".into());
    };
    let config: FieldConfig = serde_json::from_str(config)?;
    let (scale, wrong, seeds): (f64, usize, u64) = (scale.parse()?, wrong.parse()?, seeds.parse()?);
    let capture = Capture::read(folder.as_ref(), &ReadOptions::default())?;
    let other = rest.first().map(|f| Capture::read(f.as_ref(), &ReadOptions::default())).transpose()?;
    for seed in 1..=seeds {
        let mut views = views(&capture, scale)?;
        let mut kinds = vec!["good"; views.len()];
        for k in 0..wrong {
            let at = (k * views.len() / wrong + 3 * seed as usize) % views.len();
            kinds[at] = spoil(&mut views, at, k, other.as_ref())?;
        }
        let started = Instant::now();
        let place = (SceneFrame::from_capture(&capture)?, capture.background);
        let settings = QuarantineConfig::default();
        let mut screening = Screening::new(views, &BTreeSet::new(), place, (&config, &settings), seed)?;
        while screening.steps_done() < screening.steps_total() {
            screening.step()?;
        }
        let found = screening.finish().ok_or("it goes on")?;
        println!(
            "seed {seed}: {} views, {:.1} s, median {:.2} dB, spread {:.2}, limit {:.2} dB: {:?}",
            kinds.len(),
            started.elapsed().as_secs_f64(),
            found.median_db,
            found.spread,
            found.limit_db,
            found.outcome
        );
        let mut rows: Vec<_> = found.fits.iter().zip(&kinds).enumerate().collect();
        rows.sort_by(|a, b| a.1.0.fit_db.total_cmp(&b.1.0.fit_db));
        for (n, (at, (fit, kind))) in rows.iter().enumerate() {
            if n < SHOWN || **kind != "good" {
                println!("  {at:4} {:24} {kind:10} {:6.2} dB {:6.2} deviations", fit.view, fit.fit_db, fit.deviations);
            }
        }
    }
    Ok(())
}
