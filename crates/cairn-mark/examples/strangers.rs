//! Asks a detector about pictures that nobody marked, every PNG and JPEG of some folders: as they are, as JPEG 50, and
//! the middle of them. Prints for each folder how many answers name nobody, and the surest that names somebody: what false
//! owners a training brings on photographs of other places.
//!
//! `cargo run --release -p cairn-mark --example strangers -- DETECTOR FOLDER [FOLDER ...]`

use cairn_mark::{Detector, Distortion};
use cairn_scene::{Limits, decode_picture};
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, detector, folders @ ..] = arguments.as_slice() else {
        return Err("usage: strangers DETECTOR FOLDER [FOLDER ...]".into());
    };
    let detector = Detector::from_bytes(&std::fs::read(detector)?)?;
    for folder in folders {
        let mut files: Vec<PathBuf> =
            std::fs::read_dir(folder)?.map(|e| e.map(|e| e.path())).collect::<Result<_, _>>()?;
        files.retain(|f| {
            f.extension().is_some_and(|e| ["png", "jpg", "jpeg"].iter().any(|x| e.eq_ignore_ascii_case(x)))
        });
        files.sort();
        let (mut silent, mut surest) = ([0; 3], (0.0f32, String::new()));
        for file in &files {
            let picture = decode_picture(&std::fs::read(file)?, &Limits::default(), Some([1.0; 3]))?;
            let jpeg = Distortion::Jpeg { quality: 50 }.apply(&picture, 0);
            let middle = Distortion::Crop { kept: 0.75, across: 0.5, down: 0.5 }.apply(&picture, 0);
            for (silent, (how, picture)) in
                silent.iter_mut().zip([("", &picture), (" as JPEG 50", &jpeg), (", its middle", &middle)])
            {
                let told = detector.detect(picture)?;
                *silent += usize::from(told.identity.is_none());
                let named = told.probabilities.iter().skip(1).copied().fold(0.0, f32::max);
                if told.identity.is_some() && named > surest.0 {
                    surest = (named, format!("{}{how}", file.display()));
                }
            }
        }
        let [plain, jpeg, middle] = silent;
        let surest = if surest.0 > 0.0 { format!("; surest {} with {:.3}", surest.1, surest.0) } else { String::new() };
        println!("{folder}: of {} {plain} silent, {jpeg} as JPEG 50, {middle} of their middles{surest}", files.len());
    }
    Ok(())
}
