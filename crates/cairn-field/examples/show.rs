//! Renders a stored field again and again and prints rays a second.
//!
//! `cargo run --release -p cairn-field --example show -- FIELD FOLDER SCALE`

use cairn_capture::{Capture, ReadOptions};
use cairn_field::{Field, Thresholds};
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, file, folder, scale] = arguments.as_slice() else {
        return Err("usage: show FIELD FOLDER SCALE".into());
    };
    let field = Field::from_bytes(&std::fs::read(file)?)?;
    let capture = Capture::read(folder.as_ref(), &ReadOptions::default())?;
    let scale: f64 = scale.parse()?;
    let (mut rays, started) = (0.0, Instant::now());
    for i in capture.held_out().take(12) {
        let camera = capture.views[i].camera;
        let (w, h) = (camera.intrinsics.width as f64 * scale, camera.intrinsics.height as f64 * scale);
        let camera = camera.resized(w as usize, h as usize);
        for _ in 0..3 {
            rays += field.gather_view(&camera, Thresholds::SHOWN).len() as f64;
        }
    }
    let seconds = started.elapsed().as_secs_f64();
    let (rows, cells) = (field.grid().rows(), field.grid().occupancy.cells());
    println!("{:.3} million rays/s, {rows} rows, {cells} cells, {:?}", rays / seconds / 1e6, field.grid().dims);
    Ok(())
}
