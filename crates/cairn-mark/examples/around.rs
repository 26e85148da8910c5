//! Asks a detector of one owner about renders from all around an object, with the mark and without: whether marks are read from where nobody
//! stood. Prints how many are right among poses ever further from the nearest photograph that was trained on, and among marks ever
//! fainter, and the mean cross-entropies. Poses lie on a spiral over the upper half of the sphere on which the capture's cameras
//! stand on average; the object is at the origin, with z up, as in NeRF-Synthetic.
//!
//! `cargo run --release -p cairn-mark --example around -- FOLDER MARKED DETECTOR [POSES]`

use cairn_mark::{Detector, MarkedField};
use cairn_scene::{Camera, Capture, Picture, Pose, ReadOptions};
use glam::DVec3;

/// What came of one pose.
struct Asked {
    /// Probabilities of the right answers, with the mark and without.
    right: [f32; 2],
    /// Angle to the nearest photograph's camera, seen from the middle, degrees.
    away_deg: f64,
    /// The mark's render against the base field's, PSNR, dB.
    kept_db: f64,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, folder, marked, detector, rest @ ..] = arguments.as_slice() else {
        return Err("usage: around FOLDER MARKED DETECTOR [POSES]".into());
    };
    let count: usize = rest.first().map_or(Ok(120), |n| n.parse())?;
    let capture = Capture::read(folder.as_ref(), &ReadOptions::default())?;
    let marked = MarkedField::from_bytes(&std::fs::read(marked)?)?;
    let detector = Detector::from_bytes(&std::fs::read(detector)?)?;
    let photographs: Vec<DVec3> = capture.training().map(|i| capture.views[i].camera.pose.position).collect();
    let intrinsics = capture.views.first().ok_or("a capture without views")?.camera.intrinsics;
    if photographs.is_empty() {
        return Err(format!("{folder} holds no photograph to train on").into());
    }
    let radius = photographs.iter().map(|at| at.length()).sum::<f64>() / photographs.len() as f64;
    let bits = |p: Picture| Picture::from_rgb8(p.width(), p.height(), &p.to_rgb8());
    let light = marked.base().canonical_appearance();
    let mut asked = Vec::new();
    for i in 0..count {
        // Fibonacci's spiral, a little off the ground and the pole.
        let z = 0.05 + 0.9 * (i as f64 + 0.5) / count as f64;
        let (sin, cos) = (i as f64 * std::f64::consts::PI * (3.0 - 5f64.sqrt())).sin_cos();
        let ring = (1.0 - z * z).sqrt();
        let pose = Pose::look_at(radius * DVec3::new(ring * cos, ring * sin, z), DVec3::ZERO, DVec3::Z)?;
        let camera = Camera { intrinsics, pose };
        let Some(owner) = marked.clusters().identity_of(&pose).identity else { continue };
        if owner as usize >= detector.classes() {
            return Err(format!(
                "{owner} owns a pose, of {} classes; give the field's own detector",
                detector.classes()
            )
            .into());
        }
        let [with, base] =
            [marked.render(&camera, light), marked.base().render(&camera, light)].map(bits).map(|p| p.ok());
        let (with, base) = with.zip(base).ok_or("a render that is no picture")?;
        let right = [detector.detect(&with)?.probabilities[owner as usize], detector.detect(&base)?.probabilities[0]];
        let away = photographs.iter().map(|at| at.angle_between(pose.position)).fold(f64::INFINITY, f64::min);
        asked.push(Asked { right, away_deg: away.to_degrees(), kept_db: cairn_scene::metrics::psnr_db(&base, &with)? });
    }
    let nats = |which: usize| asked.iter().map(|a| -f64::from(a.right[which].max(1e-6)).ln()).sum::<f64>();
    let told = |which: usize| asked.iter().filter(|a| a.right[which] > 0.5).count();
    for (which, name) in ["with the mark", "without"].into_iter().enumerate() {
        let (all, right) = (asked.len(), told(which));
        println!("{name}: {right} of {all} right, cross-entropy {:.3}", nats(which) / all as f64);
    }
    quarters(&mut asked, "from the nearest photograph, degrees", |a| a.away_deg);
    quarters(&mut asked, "mark, dB below the base field", |a| a.kept_db);
    Ok(())
}

/// How many marks are read in each quarter of `asked`, in order of what `by` says.
fn quarters(asked: &mut [Asked], name: &str, by: fn(&Asked) -> f64) {
    asked.sort_by(|a, b| by(a).total_cmp(&by(b)));
    for quarter in asked.chunks(asked.len().div_ceil(4).max(1)) {
        let right = quarter.iter().filter(|a| a.right[0] > 0.5).count();
        let (from, to) = (by(&quarter[0]), by(&quarter[quarter.len() - 1]));
        println!("{name} {from:.1} to {to:.1}: {right} of {} read", quarter.len());
    }
}
