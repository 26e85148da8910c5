//! Lays pictures over a marked field and prints how far each identity's mark stands out: of held-out renders with the
//! mark and without, as they are and harmed, and of photographs.
//!
//! `cargo run --release -p cairn-mark --example registered -- FOLDER MARKED [VIEWS [HARM [known]]]`: at most so many
//! views, and only what has HARM in its name; with `known` at the cameras that they were rendered with.

use cairn_mark::{Distortion, MarkedField, RegisteredReader};
use cairn_scene::{Capture, Picture, ReadOptions};
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, folder, marked, rest @ ..] = arguments.as_slice() else {
        return Err("usage: registered FOLDER MARKED [VIEWS [HARM [known]]]".into());
    };
    let capture = Capture::read(folder.as_ref(), &ReadOptions::default())?;
    let marked = MarkedField::from_bytes(&std::fs::read(marked)?)?;
    let most: usize = rest.first().map_or(Ok(4), |n| n.parse())?;
    let views: Vec<_> = capture.training().map(|i| (capture.views[i].camera, capture.views[i].name.as_str())).collect();
    let known = rest.get(2).is_some_and(|word| word == "known");
    let begun = Instant::now();
    let reader = RegisteredReader::new(&marked, &views).ok_or("cannot be read so")?;
    println!("prepared in {:.2} s", begun.elapsed().as_secs_f64());
    let combined = |degrees: f32| {
        vec![
            Distortion::Rotate { degrees },
            Distortion::Crop { kept: 0.7746, across: 0.0, down: 0.0 },
            Distortion::Scale { factor: 0.75 },
            Distortion::Noise { sigma: 0.1 },
            Distortion::Jpeg { quality: 50 },
        ]
    };
    let harms: Vec<(&str, Vec<Distortion>)> = vec![
        ("8 bits", vec![]),
        ("JPEG 90", vec![Distortion::Jpeg { quality: 90 }]),
        ("JPEG 50", vec![Distortion::Jpeg { quality: 50 }]),
        ("JPEG 30", vec![Distortion::Jpeg { quality: 30 }]),
        ("blur 2", vec![Distortion::Blur { sigma_px: 2.0 }]),
        ("noise 0.05", vec![Distortion::Noise { sigma: 0.05 }]),
        ("noise 0.1", vec![Distortion::Noise { sigma: 0.1 }]),
        ("darker", vec![Distortion::Light { brightness: 0.8, contrast: 1.0 }]),
        ("crop 75", vec![Distortion::Crop { kept: 0.75, across: 0.0, down: 0.0 }]),
        ("rotate 5", vec![Distortion::Rotate { degrees: 5.0 }]),
        ("rotate 30", vec![Distortion::Rotate { degrees: 30.0 }]),
        ("scale 75", vec![Distortion::Scale { factor: 0.75 }]),
        ("combined", combined(30.0)),
        ("combined -15", combined(-15.0)),
    ];
    let held: Vec<usize> = capture.held_out().collect();
    for index in held.iter().step_by(held.len().div_ceil(most)) {
        let view = &capture.views[*index];
        let photograph = capture.photograph(*index)?;
        let light = match marked.base().appearances().is_empty() {
            true => marked.base().canonical_appearance().clone(),
            false => marked.base().fit_appearance_left_half(&view.camera, &photograph)?,
        };
        let owner = marked.clusters().identity_of(&view.camera.pose).identity;
        println!("{} of {owner:?} at {:?}", view.name, view.camera.pose.position);
        let bits = |p: Picture| Picture::from_rgb8(p.width(), p.height(), &p.to_rgb8());
        let (base, with) = (
            bits(marked.base().render(&view.camera, &light))?,
            bits(marked.render_as(&view.camera, &light, owner.or(Some(1))))?,
        );
        let show = |what: &str, picture: &Picture| {
            let begun = Instant::now();
            let Some(read) = reader.read(&marked, picture, known.then_some(&view.camera), &|| true) else {
                println!("  {what:20} nowhere");
                return;
            };
            let scores: Vec<String> = read.scores.iter().map(|z| format!("{z:6.1}")).collect();
            let off = (read.registered.camera.pose.position - view.camera.pose.position).length();
            println!(
                "  {what:20} {}  explained {:.4}  {off:.5} off  {:.2} s",
                scores.join(" "),
                read.registered.explained,
                begun.elapsed().as_secs_f64()
            );
        };
        for (name, list) in harms.iter().filter(|h| rest.get(1).is_none_or(|f| h.0.contains(f.as_str()))) {
            let done = |p: &Picture, salt: u64| list.iter().fold(p.clone(), |p, d| d.apply(&p, salt));
            show(&format!("{name}, marked"), &done(&with, 1));
            show(&format!("{name}, base"), &done(&base, 2));
        }
        show("photograph", &photograph);
    }
    Ok(())
}
