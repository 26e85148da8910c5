//! Ten photographs from all around a landmark, as visitors bring home: views between
//! them must show it, and not the clouds that explain each photograph by itself.

use crate::common::landmark::{frame, held_out_db, wild};
use crate::common::{Photo, named};
use cairn_field::{BaseTrainer, Field, FieldConfig, Spacing};
use cairn_landmark::{Landmark, LandmarkCapture, LandmarkConfig};

/// Thirty places around the landmark, in one light: every third is trained on.
fn ring(seed: u64) -> LandmarkCapture {
    let config = LandmarkConfig {
        contributors: 2,
        photographs: 15,
        width: 60,
        height: 80,
        passers_by: false,
        light_variation: 0.0,
        ..LandmarkConfig::default()
    };
    Landmark::generate(&config, seed).expect("sound settings")
}

fn trained(capture: &LandmarkCapture, smoother_beyond_deg: f64) -> (Spacing, Field) {
    let view = |v: &cairn_landmark::LandmarkView| Photo {
        name: v.name.clone(),
        camera: v.camera,
        picture: v.picture.clone(),
        mask: None,
    };
    let views = capture.views.iter().skip(1).step_by(3).map(view).collect();
    let config = FieldConfig { voxels: 1_000_000, levels: 3, smoother_beyond_deg, ..wild(400) };
    let mut trainer = BaseTrainer::new(named(views), frame(capture), None, config, 1).expect("sound settings");
    while trainer.steps_done() < trainer.steps_total() {
        trainer.step().expect("finite numbers");
    }
    (trainer.spacing(), trainer.finish())
}

#[test]
fn views_between_few_photographs_show_the_landmark() {
    let capture = ring(1);
    let between = || capture.views.iter().step_by(3);
    let ((never, plain), (spacing, smooth)) = (trained(&capture, 180.0), trained(&capture, 14.0));
    assert!(never.smoothing == 1.0 && spacing.smoothing > 4.0, "{never:?}, {spacing:?}");
    let (plain, smooth) = (held_out_db(&plain, between()), held_out_db(&smooth, between()));
    println!("views between ten photographs {:.0} degrees apart: {plain:.2} dB, {smooth:.2} dB", spacing.apart_deg);
    // Landmarks of seeds 1 to 5 gained 0.9 to 1.3 dB.
    assert!(smooth > plain + 0.5, "{plain:.2} dB, {smooth:.2} dB");
}
