//! Drops what shows less than LEAST from a stored field, then prints PSNR and rays a second.
//!
//! `cargo run --release -p cairn-field --example show -- FIELD FOLDER SCALE LEAST`

use cairn_field::{Field, Thresholds};
use cairn_scene::{Capture, ReadOptions};
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, file, folder, scale, least] = arguments.as_slice() else {
        return Err("usage: show FIELD FOLDER SCALE LEAST".into());
    };
    let field = Field::from_bytes(&std::fs::read(file)?)?;
    let capture = Capture::read(folder.as_ref(), &ReadOptions::default())?;
    let cameras: Vec<_> = capture.training().map(|i| capture.views[i].camera).collect();
    let field = field.only_what_shows(&cameras, least.parse()?);
    let db = |i: usize| -> Result<f64, Box<dyn std::error::Error>> {
        let photograph = capture.photograph(i)?;
        let camera = capture.views[i].camera;
        let render = field.render(&camera, field.canonical_appearance()).clamped();
        let d = render.rgb().iter().zip(photograph.rgb()).map(|(a, b)| f64::from(a - b).powi(2));
        Ok(-10.0 * (d.sum::<f64>() / photograph.rgb().len() as f64).log10())
    };
    let n = capture.held_out().take(12).count() as f64;
    println!("{:.2} dB", capture.held_out().take(12).map(db).sum::<Result<f64, _>>()? / n);
    let scale: f64 = scale.parse()?;
    let (mut rays, started) = (0.0, Instant::now());
    for i in capture.held_out().take(12) {
        let camera = capture.views[i].camera;
        let (w, h) = (camera.intrinsics.width as f64 * scale, camera.intrinsics.height as f64 * scale);
        let camera = camera.resized(w as usize, h as usize);
        for _ in 0..3 {
            rays += field.gather_view(&camera, field.canonical_appearance(), Thresholds::SHOWN).len() as f64;
        }
    }
    let seconds = started.elapsed().as_secs_f64();
    let (rows, cells) = (field.grid().rows(), field.grid().occupancy.cells());
    println!("{:.3} million rays/s, {rows} rows, {cells} cells, {:?}", rays / seconds / 1e6, field.grid().dims);
    Ok(())
}
