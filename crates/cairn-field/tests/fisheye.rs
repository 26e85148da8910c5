//! A landmark that was photographed through a fisheye becomes the landmark that pinholes show.

use crate::common::landmark::{frame, held_out_db, wild};
use crate::common::{Photo, named};
use cairn_field::{BaseTrainer, Field, FieldConfig};
use cairn_landmark::{Landmark, LandmarkCapture, LandmarkConfig};

/// Forty places around the landmark, in one light; through a fisheye photographs of the pinhole's scale in the middle.
fn capture(fisheye_deg: Option<f32>, [width, height]: [usize; 2]) -> LandmarkCapture {
    let config = LandmarkConfig {
        contributors: 2,
        photographs: 20,
        width,
        height,
        passers_by: false,
        light_variation: 0.0,
        fisheye_deg,
        ..LandmarkConfig::default()
    };
    Landmark::generate(&config, 1).expect("sound settings")
}

/// Trained on all views but each fourth.
fn trained(capture: &LandmarkCapture) -> Field {
    let view = |v: &cairn_landmark::LandmarkView| Photo {
        name: v.name.clone(),
        camera: v.camera,
        picture: v.picture.clone(),
        mask: None,
    };
    let views = capture.views.iter().enumerate().filter(|(i, _)| i % 4 != 0).map(|(_, v)| view(v)).collect();
    let config = FieldConfig { voxels: 500_000, levels: 3, ..wild(400) };
    let mut trainer = BaseTrainer::new(named(views), frame(capture), None, config, 1).expect("sound settings");
    while trainer.steps_done() < trainer.steps_total() {
        trainer.step().expect("finite numbers");
    }
    trainer.finish()
}

#[test]
fn a_fisheye_s_photographs_show_pinholes_what_pinholes_photographs_show() {
    let pinholes = capture(None, [60, 80]);
    // Both have a focal length of 86 px.
    let fisheyes = capture(Some(110.0), [120, 160]);
    let between = || pinholes.views.iter().step_by(4);
    let (pinhole, fisheye) = (trained(&pinholes), trained(&fisheyes));
    let (own, seen) = (held_out_db(&pinhole, between()), held_out_db(&fisheye, between()));
    println!("pinholes between photographs of pinholes: {own:.2} dB, of fisheyes: {seen:.2} dB");
    // Were the fisheyes taken for pinholes, it would be 3.2 dB less.
    assert!(seen > own - 1.0, "{seen:.2} dB for {own:.2} dB");
}
