//! Asks a detector about held-out renders after strong harm, many times over, and prints how many answers are right: what a setting of
//! `[mark.robust]` does, in less than the minutes of `cairn bench mark`. Pictures that nobody marked are the `strangers` example's.
//!
//! `cargo run --release -p cairn-mark --example harmed -- FOLDER MARKED DETECTOR [TRIES]`

use cairn_mark::{Detector, Distortion, MarkedField};
use cairn_scene::{Capture, Picture, ReadOptions};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, folder, marked, detector, rest @ ..] = arguments.as_slice() else {
        return Err("usage: harmed FOLDER MARKED DETECTOR [TRIES]".into());
    };
    let tries: u64 = rest.first().map_or(Ok(10), |n| n.parse())?;
    let capture = Capture::read(folder.as_ref(), &ReadOptions::default())?;
    let marked = MarkedField::from_bytes(&std::fs::read(marked)?)?;
    let detector = Detector::from_bytes(&std::fs::read(detector)?)?;
    let bits = |p: Picture| Picture::from_rgb8(p.width(), p.height(), &p.to_rgb8());
    let light = marked.base().canonical_appearance();
    let mut views = Vec::new();
    for index in capture.held_out() {
        let camera = capture.views[index].camera;
        let owner = marked.clusters().identity_of(&camera.pose).identity.unwrap_or(0);
        views.push((owner, bits(marked.render(&camera, light))?, bits(marked.base().render(&camera, light))?));
    }
    let one = |distortion: Distortion| move |_: u64| vec![distortion];
    let combined = |degrees: [f32; 4]| {
        move |n: u64| {
            let share = |k: u64| ((n * 7 + k * 3) % 10) as f32 / 9.0;
            vec![
                Distortion::Rotate { degrees: degrees[n as usize % 4] },
                Distortion::Crop { kept: 0.7746, across: share(0), down: share(1) },
                Distortion::Scale { factor: 0.75 },
                Distortion::Noise { sigma: 0.1 },
                Distortion::Jpeg { quality: 50 },
            ]
        }
    };
    type Harm<'a> = (&'a str, Box<dyn Fn(u64) -> Vec<Distortion>>);
    let harms: Vec<Harm<'_>> = vec![
        ("8 bits", Box::new(|_| Vec::new())),
        ("JPEG 50", Box::new(one(Distortion::Jpeg { quality: 50 }))),
        ("JPEG 30", Box::new(one(Distortion::Jpeg { quality: 30 }))),
        ("blur 1 px", Box::new(one(Distortion::Blur { sigma_px: 1.0 }))),
        ("blur 2 px", Box::new(one(Distortion::Blur { sigma_px: 2.0 }))),
        ("contrast 1.2", Box::new(one(Distortion::Light { brightness: 1.0, contrast: 1.2 }))),
        ("noise 0.02", Box::new(one(Distortion::Noise { sigma: 0.02 }))),
        ("noise 0.05", Box::new(one(Distortion::Noise { sigma: 0.05 }))),
        ("noise 0.1", Box::new(one(Distortion::Noise { sigma: 0.1 }))),
        ("combined 30", Box::new(combined([30.0, -30.0, 30.0, -30.0]))),
        ("combined 15", Box::new(combined([15.0, -15.0, 10.0, -10.0]))),
    ];
    for (name, harm) in &harms {
        let (mut right, mut silent, mut odds) = (0, 0, 0.0);
        for (at, (owner, with, base)) in views.iter().enumerate() {
            for n in 0..tries {
                let done = |p: &Picture, salt: u64| {
                    let list = harm(n);
                    list.iter().enumerate().fold(p.clone(), |p, (k, d)| d.apply(&p, 1000 * n + 10 * k as u64 + salt))
                };
                let salt = 100_000 * at as u64;
                let told = detector.detect(&done(with, salt))?;
                right += usize::from(told.identity.unwrap_or(0) == *owner);
                odds += f64::from(told.probabilities[*owner as usize]);
                silent += usize::from(detector.detect(&done(base, salt + 1))?.identity.is_none());
            }
        }
        let all = views.len() * tries as usize;
        println!(
            "{name:12} {right} of {all} right, {:.3} sure of it; {silent} of {all} without a mark silent",
            odds / all as f64
        );
    }
    Ok(())
}
