//! Writes the made-up landmark's photographs as two captures: `seen`, as taken, and
//! `clean`, without the passers-by. A field trained on the first and scored on the
//! second shows what passers-by cost, and one trained on the second what could be had.
//!
//! `cargo run --release -p cairn-landmark --example photograph -- FOLDER SEED [settings as JSON]`

use cairn_landmark::{Landmark, LandmarkConfig};
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, folder, seed, rest @ ..] = arguments.as_slice() else {
        return Err("usage: photograph FOLDER SEED [settings as JSON]".into());
    };
    let config: LandmarkConfig = serde_json::from_str(rest.first().map_or("{}", String::as_str))?;
    let mut capture = Landmark::generate(&config, seed.parse()?)?;
    capture.write(&Path::new(folder).join("seen"))?;
    for view in &mut capture.views {
        view.picture = view.clean.clone();
    }
    capture.write(&Path::new(folder).join("clean"))?;
    Ok(())
}
