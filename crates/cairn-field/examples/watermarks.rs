//! Looks for visible watermarks in a capture's photographs and says how much of the frame they cover; with a folder, one
//! photograph of each such contributor is written there, with what is covered in magenta. With N, every N photographs on end, and
//! every so many apart, are taken for a contributor's: how often is one found where none is?
//!
//! `cargo run --release -p cairn-field --example watermarks -- FOLDER [FOLDER for pictures [N]]`

use cairn_field::watermarks;
use cairn_scene::{Capture, Picture, Picture8, ReadOptions, encode_png};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, folder, rest @ ..] = arguments.as_slice() else {
        return Err("usage: watermarks FOLDER [FOLDER for pictures [N]]".into());
    };
    let table = std::path::Path::new(folder).join("contributors.csv");
    let options = ReadOptions { contributors: table.is_file().then_some(table), ..ReadOptions::default() };
    let capture = Capture::read(folder.as_ref(), &options)?;
    let view = |i: usize| Ok((capture.views[i].contributor.clone(), Picture8::from(&capture.photograph(i)?)));
    let views = capture.training().map(view).collect::<Result<Vec<_>, Box<dyn std::error::Error>>>()?;
    if let Some(n) = rest.get(1) {
        let n: usize = n.parse()?;
        let groups = views.len() / n;
        let (mut found, mut most) = (0, 0.0f64);
        for by in [|at: usize, n: usize, _: usize| at / n, |at: usize, _: usize, groups: usize| at % groups] {
            let whose: Vec<String> = (0..groups * n).map(|at| by(at, n, groups).to_string()).collect();
            let dealt: Vec<_> = whose.iter().map(String::as_str).zip(views.iter().map(|v| &v.1)).collect();
            let marks = watermarks(&dealt);
            found += marks.len();
            most = marks.iter().map(|mark| mark.share()).fold(most, f64::max);
        }
        println!("{n} photographs: {found} of {} groups, {:.2} % of the frame at most", 2 * groups, 100.0 * most);
        return Ok(());
    }
    let begun = std::time::Instant::now();
    let found = watermarks(&views.iter().map(|(whose, picture)| (whose.as_str(), picture)).collect::<Vec<_>>());
    println!("{} in {} photographs, {:.2} s", found.len(), views.len(), begun.elapsed().as_secs_f64());
    for mark in found {
        println!("{}: {} photographs, {:.2} % of the frame", mark.contributor, mark.views.len(), 100.0 * mark.share());
        let Some(out) = rest.first() else { continue };
        let picture = &views[mark.views[0]].1;
        let mut bits = picture.rgb().to_vec();
        for (pixel, _) in bits.chunks_exact_mut(3).zip(mark.covered.iter()).filter(|(_, on)| **on) {
            pixel.copy_from_slice(&[255, 0, 255]);
        }
        let shown = Picture::from_rgb8(picture.width(), picture.height(), &bits)?;
        let name = format!("{}.png", mark.contributor.replace('/', "-"));
        std::fs::write(std::path::Path::new(out).join(name), encode_png(&shown))?;
    }
    Ok(())
}
