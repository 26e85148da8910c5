//! What storing colours in half precision does to pictures.

use super::trainer::BaseTrainer;
use super::views::NamedView;
use crate::config::{AppearanceMode, FieldConfig};
use crate::field::model::Field;
use crate::rays::frame::SceneFrame;
use cairn_landmark::{Landmark, LandmarkConfig, LandmarkView};
use glam::DVec3;

/// A small training on the made-up landmark, in two visitors' lights, to its end; and the cameras.
fn trained() -> (BaseTrainer, Vec<LandmarkView>) {
    let config = LandmarkConfig { contributors: 2, photographs: 6, width: 40, height: 48, ..LandmarkConfig::default() };
    let photographs = Landmark::generate(&config, 3).expect("a landmark").views;
    let view = |v: &LandmarkView| NamedView::new(v.name.clone(), v.camera, &v.picture);
    let frame = SceneFrame::Unbounded { centre: DVec3::Z, half: DVec3::splat(1.4) };
    let appearance = AppearanceMode::On;
    let config = FieldConfig { steps: 400, rays_per_step: 512, voxels: 60_000, appearance, ..FieldConfig::default() };
    let mut trainer =
        BaseTrainer::new(photographs.iter().map(view).collect(), frame, None, config, 5).expect("settings");
    while trainer.steps_done() < trainer.steps_total() {
        trainer.step().expect("finite numbers");
    }
    trainer.settle();
    (trainer, photographs)
}

#[test]
fn half_precision_colours_change_no_picture_by_half_an_8_bit_level() {
    let (trainer, photographs) = trained();
    let unrounded = trainer.finish_in_f32();
    assert_eq!(unrounded.appearances.len(), photographs.len());
    let stored = unrounded.clone().with_stored_colours();
    let read = Field::from_bytes(&unrounded.to_bytes().expect("bytes")).expect("a field");
    assert!(read.grid.colour == stored.grid.colour, "files hold them so");
    let apart = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    let rounded = apart(&stored.grid.colour, &unrounded.grid.colour);
    let mut most = 0.0f32;
    for view in &photographs {
        let [a, b] = [&stored, &unrounded].map(|field| field.render(&view.camera, field.appearance_of(&view.name)));
        assert!(b.rgb().iter().all(|v| v.is_finite()), "{}", view.name);
        most = most.max(apart(a.rgb(), b.rgb()));
    }
    assert!(rounded > 1e-4, "rounding is to be seen in the coefficients: {rounded}");
    // It came to 0.05 of a level (0.07 where appearances are left to the photographs): coefficients of up to 3.4 are
    // 1e-3 off at most, and a pixel is a mean of many.
    assert!(most < 0.5 / 255.0, "{most}: {} of an 8-bit level", most * 255.0);
}
