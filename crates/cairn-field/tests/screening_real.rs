//! Screening of real captures: honest photographs stay, noise among them goes.
//! Skipped, visibly, where they are not there.

use std::collections::BTreeSet;
use std::path::PathBuf;

use crate::common::{Photo, named};
use cairn_field::{FieldConfig, SceneFrame, Screened, Screening};
use cairn_scene::{Capture, Picture, ReadOptions};

/// A capture's training views, `scale` as large; `None` where it is not there.
fn read(name: &str, scale: f64) -> Option<(Capture, Vec<Photo>)> {
    let data = std::env::var_os("CAIRN_DATA")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data")), PathBuf::from);
    if !data.join(name).is_dir() {
        eprintln!("SKIPPED {name}: no captures at {}", data.display());
        return None;
    }
    let options = ReadOptions { hold_out: Some(8), ..ReadOptions::default() };
    let capture = Capture::read(&data.join(name), &options).expect("a capture");
    let view = |at: usize| {
        let view = &capture.views[at];
        let size = |side: usize| ((side as f64 * scale).round() as usize).max(1);
        let (w, h) = (size(view.camera.intrinsics.width), size(view.camera.intrinsics.height));
        let picture = capture.photograph(at).expect("a photograph").resized(w, h);
        Photo { name: view.name.clone(), camera: view.camera.resized(w, h), picture, mask: None }
    };
    let views = capture.training().map(view).collect();
    Some((capture, views))
}

fn screened(capture: &Capture, views: Vec<Photo>, field: &FieldConfig, seed: u64) -> Screened {
    let frame = SceneFrame::from_capture(capture).expect("a frame");
    let mut screening =
        Screening::new(named(views), &BTreeSet::new(), frame, capture.background, field, seed).expect("sound settings");
    while screening.steps_done() < screening.steps_total() {
        screening.step().expect("finite numbers");
    }
    screening.finish().expect("a verdict")
}

/// Places of the outliers.
fn outliers(found: &Screened) -> Vec<usize> {
    assert_eq!(found.doubt, None, "{found:?}");
    (0..found.scores.len()).filter(|v| found.scores[*v].is_outlier).collect()
}

/// Nobody is an outlier; with a grey chequer in the place of one photograph, that one is.
fn honest(name: &str, scale: f64, field: &FieldConfig) {
    let Some((capture, mut views)) = read(name, scale) else { return };
    for seed in 1..=2 {
        let clean = screened(&capture, views.clone(), field, seed);
        let least = clean.scores.iter().map(|f| f.fit_db).fold(f64::INFINITY, f64::min);
        println!(
            "{name}, seed {seed}: median {:.2} dB, limit {:.2}, least {least:.2}",
            clean.median_db, clean.limit_db
        );
        assert_eq!(outliers(&clean), [0; 0], "{name}, seed {seed}");
        assert!(least > 2.0 * clean.limit_db, "{name}, seed {seed}: {least:.2} dB leave no margin");
    }
    let (w, h) = (views[5].picture.width(), views[5].picture.height());
    let chequer = |at: usize| if (at % w / 4 + at / w / 4).is_multiple_of(2) { 0.2 } else { 0.8 };
    let rgb = (0..w * h).flat_map(|at| [chequer(at); 3]).collect();
    views[5].picture = Picture::new(w, h, rgb).expect("three numbers a pixel");
    assert_eq!(outliers(&screened(&capture, views, field, 1)), [5], "{name}");
}

#[test]
fn fern_loses_nobody() {
    let field = FieldConfig {
        steps: 1500,
        rays_per_step: 1024,
        voxels: 12_000_000,
        levels: 4,
        learning_rate_density: 0.8,
        smooth_density: 3e-5,
        smooth_colour: 1e-3,
        initial_opacity: 0.5,
        prune_weight: 0.03,
        ..FieldConfig::default()
    };
    honest("fern", 0.25, &field);
}

#[test]
fn lego_loses_nobody() {
    let field = FieldConfig {
        steps: 1500,
        rays_per_step: 1024,
        voxels: 12_000_000,
        levels: 4,
        learning_rate_density: 0.5,
        initial_opacity: 0.05,
        distortion: 0.005,
        ..FieldConfig::default()
    };
    honest("lego", 0.15, &field);
}
