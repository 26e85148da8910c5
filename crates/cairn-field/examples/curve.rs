//! Trains a capture and prints seconds against held-out PSNR: the quickest way
//! to see what a setting does.
//!
//! `cargo run --release -p cairn-field --example curve -- FOLDER SCALE [settings as JSON] [FILE for the field [FOLDER
//! whose photographs are scored against]]`. The last must have the same views and cameras; held-out light is fitted
//! to its photographs, too.

use cairn_field::{BaseTrainer, Field, FieldConfig, FieldError, SceneFrame, TrainingView};
use cairn_scene::{Capture, Picture, ReadOptions, encode_png};
use std::sync::Arc;
use std::time::Instant;

/// Held-out views that are scored, at most.
const MOST_SCORED: usize = 24;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, folder, scale, rest @ ..] = arguments.as_slice() else {
        return Err(
            "usage: curve FOLDER SCALE [settings as JSON] [FILE for the field [FOLDER to score against]]".into()
        );
    };
    let scale: f64 = scale.parse()?;
    let config: FieldConfig = serde_json::from_str(rest.first().map_or("{}", String::as_str))?;
    let table = std::path::Path::new(folder).join("contributors.csv");
    let options = ReadOptions { contributors: table.is_file().then_some(table), ..ReadOptions::default() };
    let capture = Capture::read(folder.as_ref(), &options)?;
    let truth = rest.get(2).map(|f| Capture::read(f.as_ref(), &ReadOptions::default())).transpose()?;
    let truth = truth.as_ref().unwrap_or(&capture);
    if !truth.views.iter().map(|v| &v.name).eq(capture.views.iter().map(|v| &v.name)) {
        return Err("the folder to score against has other views; bring the same ones".into());
    }
    let view = |capture: &Capture, i: usize| -> Result<TrainingView, Box<dyn std::error::Error>> {
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
    let train = capture.training().map(|i| view(&capture, i)).collect::<Result<Vec<_>, _>>()?;
    let test = capture
        .held_out()
        .step_by(capture.held_out().count().div_ceil(MOST_SCORED).max(1))
        .map(|i| view(truth, i))
        .collect::<Result<Vec<_>, _>>()?;
    let frame = SceneFrame::from_capture(&capture)?;
    // Visitors' photographs: a held-out view's light is fitted on its left half.
    let wild = frame.is_unbounded();
    println!("{} training and {} held-out views, {frame:?}", train.len(), test.len());
    let mut trainer = BaseTrainer::new(train.clone(), frame, capture.background, config, 1)?;
    let started = Instant::now();
    let every = trainer.steps_total().div_ceil(10);
    while trainer.steps_done() < trainer.steps_total() {
        let stats = trainer.step()?;
        if stats.step % every == 0 {
            let seconds = started.elapsed().as_secs_f64();
            println!("{:6} {seconds:7.1} s  {:5.2} dB  {:?}", stats.step, stats.psnr_db, trainer.size());
        }
    }
    println!("{:?}", trainer.light());
    let seconds = started.elapsed().as_secs_f64();
    let field = trainer.finish();
    if let Some(file) = rest.get(1) {
        std::fs::write(file, field.to_bytes()?)?;
    }
    let learnt = train.iter().step_by(train.len().div_ceil(3));
    let known = learnt.clone().map(|view| Ok(shown(&field, view, false)?.0)).sum::<Result<f64, FieldError>>()?;
    println!("training views {:.2} dB", known / learnt.count() as f64);
    let (mut sum, started) = (0.0, Instant::now());
    for (n, view) in test.iter().enumerate() {
        let (db, render) = shown(&field, view, wild)?;
        sum += db;
        let mut both = view.picture.rgb().to_vec();
        both.extend_from_slice(render.rgb());
        let sheet = Picture::new(render.width(), 2 * render.height(), both)?;
        std::fs::write(std::env::temp_dir().join(format!("curve-{n}.png")), encode_png(&sheet))?;
    }
    let each = started.elapsed().as_secs_f64() / test.len() as f64;
    println!(
        "{seconds:.1} s, held out {:.2} dB, {each:.2} s a picture, {} rows",
        sum / test.len() as f64,
        field.grid().rows()
    );
    Ok(())
}

/// A view's PSNR and render; with `half`, appearance is fitted on its left half
/// and its right half scored.
fn shown(field: &Field, view: &TrainingView, half: bool) -> Result<(f64, Picture), FieldError> {
    let appearance = if half {
        field.fit_appearance_left_half(&view.camera, &view.picture)?
    } else {
        field.appearance_of(&view.name).clone()
    };
    let render = field.render(&view.camera, &appearance).clamped();
    let (mut error, mut count) = (0.0f64, 0.0f64);
    for y in 0..render.height() {
        for x in if half { render.width() / 2 } else { 0 }..render.width() {
            for c in 0..3 {
                error += f64::from(render.pixel(x, y)[c] - view.picture.pixel(x, y)[c]).powi(2);
                count += 1.0;
            }
        }
    }
    Ok((-10.0 * (error / count).log10(), render))
}
