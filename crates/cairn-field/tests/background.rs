//! A known background is known to be empty: nothing of its colour is left before it.

use crate::common::named;
use crate::common::{ball_box, ball_in_the_open, photograph, ring, tiny, views};
use cairn_field::{AppearanceMode, BaseTrainer, Field, FieldConfig, SceneFrame};
use glam::DVec3;

const BACKGROUND: [f32; 3] = [0.5; 3];

fn trained(clear_background: f64, background: Option<[f32; 3]>) -> Field {
    trained_in(&ball_box(), clear_background, background)
}

fn trained_in(frame: &SceneFrame, clear_background: f64, background: Option<[f32; 3]>) -> Field {
    let config = FieldConfig {
        clear_background,
        distortion: 0.0,
        prune_weight: 0.0,
        appearance: AppearanceMode::Off,
        ..tiny(200)
    };
    let all = views(12, 32, 1.0, DVec3::ZERO);
    let mut trainer = BaseTrainer::new(named(all), frame.clone(), background, config, 3).expect("sound settings");
    while trainer.steps_done() < trainer.steps_total() {
        trainer.step().expect("finite numbers");
    }
    trainer.finish()
}

/// Mean share of light stopped where the ball is and where nothing is, from places
/// between the photographs'.
fn stopped(field: &Field) -> (f64, f64) {
    let (mut ball, mut nothing) = (Vec::new(), Vec::new());
    for camera in ring(5, 32, 1.0, DVec3::ZERO) {
        let truth = photograph(&camera, 1.0, DVec3::ZERO);
        let seen = field.render_maps(&camera, field.canonical_appearance());
        for (pixel, a) in truth.rgb().chunks_exact(3).zip(&seen.accumulation) {
            if pixel == BACKGROUND { nothing.push(f64::from(*a)) } else { ball.push(f64::from(*a)) }
        }
    }
    let mean = |v: Vec<f64>| v.iter().sum::<f64>() / v.len() as f64;
    (mean(ball), mean(nothing))
}

#[test]
fn nothing_is_left_before_a_known_background() {
    let (ball, before) = stopped(&trained(0.0, Some(BACKGROUND)));
    let (cleared_ball, cleared) = stopped(&trained(0.05, Some(BACKGROUND)));
    assert!(before > 0.05, "there is something to clear: {before}");
    assert!(cleared < 0.25 * before, "{cleared} of {before} left");
    assert!(cleared_ball > ball - 0.05, "the ball is there as before: {cleared_ball} of {ball}");
}

#[test]
fn in_the_open_a_pixel_of_that_colour_is_no_empty_place() {
    let bytes = |price| trained_in(&ball_in_the_open(), price, Some(BACKGROUND)).to_bytes().expect("a field");
    assert!(bytes(0.05) == bytes(0.0));
}

#[test]
fn where_no_background_is_known_nothing_is_cleared() {
    let bytes = |price| trained(price, None).to_bytes().expect("a field");
    assert!(bytes(0.05) == bytes(0.0));
}
