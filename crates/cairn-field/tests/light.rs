//! Whether photographs differ in light is found out, and stays found out.

use crate::common::{Photo, named};
use crate::common::{ball_box, ball_in_the_open, ring, tiny};
use cairn_field::{AppearanceMode, BaseTrainer, FieldConfig, LightVerdict};
use cairn_scene::{Camera, Picture};
use glam::DVec3;

/// Photographs of one ball, two from each of four places; with `tints`, the second was
/// taken on another day.
fn photographs(tints: bool) -> Vec<Photo> {
    pairs(32, if tints { [0.4, 0.7, 1.0] } else { [1.0; 3] })
}

fn pairs(size: usize, tint: [f32; 3]) -> Vec<Photo> {
    let places = ring(4, size, 1.0, DVec3::ZERO);
    let mut all = crate::common::photographs(&[&places[..], &places[..]].concat(), 1.0, DVec3::ZERO);
    for view in &mut all[4..] {
        let rgb = view.picture.rgb().iter().enumerate().map(|(i, v)| v * tint[i % 3]).collect();
        view.picture = Picture::new(size, size, rgb).expect("three numbers a pixel");
    }
    all
}

fn trained(tints: bool, frame: &cairn_field::SceneFrame, appearance: AppearanceMode) -> BaseTrainer {
    let config = FieldConfig { appearance, ..tiny(800) };
    let mut trainer =
        BaseTrainer::new(named(photographs(tints)), frame.clone(), Some([0.5; 3]), config, 3).expect("sound");
    while trainer.steps_done() < trainer.steps_total() {
        trainer.step().expect("finite numbers");
    }
    trainer
}

#[test]
fn one_light_needs_no_appearances_and_many_do() {
    for frame in [ball_box(), ball_in_the_open()] {
        let one = trained(false, &frame, AppearanceMode::Auto);
        assert!(matches!(one.light(), LightVerdict::OneLight { .. }), "{:?}", one.light());
        assert!(!one.has_appearance());
        let many = trained(true, &frame, AppearanceMode::Auto);
        assert!(matches!(many.light(), LightVerdict::ManyLights { .. }), "{:?}", many.light());
        assert!(many.has_appearance());
        let field = many.finish();
        assert_eq!(field.appearances().len(), 8);
        let known = photographs(true);
        let names: Vec<&String> = known.iter().map(|v| &v.name).collect();
        assert!(field.appearances().iter().map(|(n, _)| n).eq(names));
    }
}

#[test]
fn visitors_who_stand_elsewhere_differ_in_light_too() {
    // One visitor on this side of the ring, one on the other, two places shared. It is the
    // light that tells, not where they stand: the last pair has the same.
    let places = ring(16, 32, 1.0, DVec3::ZERO);
    let both: Vec<Camera> = (0..9).chain(8..17).map(|i| places[i % 16]).collect();
    for (tint, frame) in [([0.4, 0.7, 1.0], ball_box()), ([0.4, 0.7, 1.0], ball_in_the_open()), ([1.0; 3], ball_box())]
    {
        let mut all = crate::common::photographs(&both, 1.0, DVec3::ZERO);
        for view in &mut all[9..] {
            let rgb = view.picture.rgb().iter().enumerate().map(|(i, v)| v * tint[i % 3]).collect();
            view.picture = Picture::new(32, 32, rgb).expect("three numbers a pixel");
        }
        let config = FieldConfig { appearance: AppearanceMode::Auto, ..tiny(800) };
        let mut trainer = BaseTrainer::new(named(all), frame, Some([0.5; 3]), config, 3).expect("sound settings");
        while trainer.light() == LightVerdict::Open {
            trainer.step().expect("finite numbers");
        }
        let many = matches!(trainer.light(), LightVerdict::ManyLights { .. });
        assert_eq!(many, tint != [1.0; 3], "{:?}", trainer.light());
    }
}

#[test]
fn the_look_spreads_over_larger_photographs_too() {
    // 64 columns and one pixel in four: an even lattice would see the other light nowhere.
    let mut all = pairs(64, [1.0; 3]);
    for view in &mut all[4..] {
        let tint = |i: usize| if (i / 3).is_multiple_of(4) { 1.0 } else { [0.4, 0.7, 1.0][i % 3] };
        let rgb = view.picture.rgb().iter().enumerate().map(|(i, v)| v * tint(i)).collect();
        view.picture = Picture::new(64, 64, rgb).expect("three numbers a pixel");
    }
    let mut trainer = BaseTrainer::new(named(all), ball_box(), Some([0.5; 3]), tiny(1600), 3).expect("sound settings");
    while trainer.light() == LightVerdict::Open {
        trainer.step().expect("finite numbers");
    }
    assert!(matches!(trainer.light(), LightVerdict::ManyLights { .. }), "{:?}", trainer.light());
}

#[test]
fn photographs_that_nothing_explains_are_decided_on_too() {
    let mut numbers = crate::common::Numbers(5);
    let mut all = photographs(false);
    for view in &mut all {
        let rgb = (0..3 * 32 * 32).map(|_| numbers.share() as f32).collect();
        view.picture = Picture::new(32, 32, rgb).expect("three numbers a pixel");
    }
    let mut trainer = BaseTrainer::new(named(all), ball_box(), Some([0.5; 3]), tiny(64), 3).expect("sound settings");
    for step in 1..=40 {
        trainer.step().expect("finite numbers");
        assert!(step >= 32 || trainer.light() == LightVerdict::Open, "noise told anything after {step} steps");
    }
    assert_ne!(trainer.light(), LightVerdict::Open);
}

#[test]
fn the_settings_have_the_last_word() {
    let off = trained(true, &ball_box(), AppearanceMode::Off);
    assert_eq!((off.light(), off.has_appearance()), (LightVerdict::Settled, false));
    let on = trained(false, &ball_box(), AppearanceMode::On);
    assert_eq!((on.light(), on.has_appearance()), (LightVerdict::Settled, true));
}

#[test]
fn a_resumed_training_knows_what_was_found() {
    let go_on = |trainer: &mut BaseTrainer| {
        while trainer.steps_done() < 260 {
            trainer.step().expect("finite numbers");
        }
        trainer.checkpoint().expect("a checkpoint")
    };
    for tints in [false, true] {
        let config = FieldConfig { appearance: AppearanceMode::Auto, ..tiny(800) };
        let mut trainer =
            BaseTrainer::new(named(photographs(tints)), ball_box(), Some([0.5; 3]), config, 3).expect("sound settings");
        let mut saved = Vec::new();
        for step in 0..240 {
            // Before the look (after step 200), just before, just after, later.
            if [3, 199, 200, 230].contains(&step) {
                saved.push(trainer.checkpoint().expect("a checkpoint"));
                assert_eq!(trainer.light() == LightVerdict::Open, step < 200, "step {step}");
            }
            trainer.step().expect("finite numbers");
        }
        assert_eq!(matches!(trainer.light(), LightVerdict::ManyLights { .. }), tints, "{:?}", trainer.light());
        let expected = go_on(&mut trainer);
        for bytes in &saved {
            let mut resumed = BaseTrainer::resume(bytes, named(photographs(tints))).expect("a sound checkpoint");
            assert!(resumed.checkpoint().expect("a checkpoint") == *bytes, "read as it was written");
            assert!(go_on(&mut resumed) == expected);
        }
    }
}

#[test]
fn views_of_a_pixel_leave_it_open_or_say_a_number() {
    // Both pixels may fall to the half that fits, and none be left to judge by.
    for seed in 0..8 {
        let all = crate::common::photographs(&ring(2, 1, 1.0, DVec3::ZERO), 1.0, DVec3::ZERO);
        let mut trainer =
            BaseTrainer::new(named(all.clone()), ball_box(), None, tiny(30), seed).expect("sound settings");
        for _ in 0..30 {
            trainer.step().expect("finite numbers");
        }
        if let LightVerdict::OneLight { spread } | LightVerdict::ManyLights { spread } = trainer.light() {
            assert!(spread.is_finite(), "seed {seed}");
        }
        BaseTrainer::resume(&trainer.checkpoint().expect("a checkpoint"), named(all)).expect("reads its own file");
    }
}

#[test]
fn a_flipped_bit_in_a_checkpoint_is_noticed() {
    let mut trainer =
        BaseTrainer::new(named(photographs(false)), ball_box(), None, tiny(10), 3).expect("sound settings");
    trainer.step().expect("finite numbers");
    let mut bytes = trainer.checkpoint().expect("a checkpoint");
    // The lowest bits all over the file, header included: nobody would see most.
    for at in (0..bytes.len()).step_by(bytes.len() / 97) {
        bytes[at] ^= 1;
        assert!(BaseTrainer::resume(&bytes, named(photographs(false))).is_err(), "byte {at} of {}", bytes.len());
        bytes[at] ^= 1;
    }
    assert!(BaseTrainer::resume(&bytes, named(photographs(false))).is_ok());
}
