//! Pixels that a mask leaves out teach nothing: whatever they show, field, light and screening come out
//! byte for byte the same.

use crate::common::{Photo, ball_box, ball_in_the_open, named, tiny, views};
use cairn_field::{AppearanceMode, BaseTrainer, FieldConfig, SceneFrame, Screening};
use cairn_scene::{Mask, Picture};
use glam::DVec3;
use std::collections::BTreeSet;

const SIDE: usize = 24;

/// Where a caption lies: over the lower part of the frame, off the tiles' borders.
fn caption(x: usize, y: usize) -> bool {
    (3..21).contains(&x) && (14..19).contains(&y)
}

/// Photographs of the ball; every second has a caption of `colour`, which its mask leaves out.
fn captioned(colour: f32) -> Vec<Photo> {
    let mut all = views(9, SIDE, 1.0, DVec3::ZERO);
    for view in all.iter_mut().step_by(2) {
        let covered = |i: usize| caption(i % SIDE, i / SIDE);
        let rgb = view.picture.rgb().iter().enumerate().map(|(i, v)| if covered(i / 3) { colour } else { *v });
        view.picture = Picture::new(SIDE, SIDE, rgb.collect()).expect("three numbers a pixel");
        view.mask = Some(Mask::from_fn(SIDE, SIDE, |x, y| !caption(x, y)).expect("pixels"));
    }
    all
}

/// The field of `photos` and a checkpoint of half of its training.
fn trained(photos: Vec<Photo>, frame: &SceneFrame, appearance: AppearanceMode) -> [Vec<u8>; 2] {
    let config = FieldConfig { appearance, ..tiny(60) };
    let mut trainer = BaseTrainer::new(named(photos), frame.clone(), None, config, 3).expect("sound settings");
    let mut half = Vec::new();
    while trainer.steps_done() < trainer.steps_total() {
        if trainer.steps_done() == 30 {
            half = trainer.checkpoint().expect("a checkpoint");
        }
        trainer.step().expect("finite numbers");
    }
    [trainer.finish().to_bytes().expect("a field"), half]
}

#[test]
fn what_a_mask_leaves_out_changes_no_byte() {
    for (frame, appearance) in [
        (ball_box(), AppearanceMode::Off),
        (ball_in_the_open(), AppearanceMode::On),
        (ball_box(), AppearanceMode::Auto),
    ] {
        let dark = trained(captioned(0.0), &frame, appearance);
        assert!(dark == trained(captioned(1.0), &frame, appearance), "{appearance:?}: a caption of another colour");
        let mut learnt = captioned(1.0);
        learnt.iter_mut().for_each(|view| view.mask = None);
        assert!(dark[0] != trained(learnt, &frame, appearance)[0], "{appearance:?}: without masks it is learnt");
    }
}

#[test]
fn a_mask_that_uses_every_pixel_is_none() {
    let mut all = views(9, SIDE, 1.0, DVec3::ZERO);
    let none = trained(all.clone(), &ball_box(), AppearanceMode::Auto);
    all.iter_mut().for_each(|view| view.mask = Some(Mask::from_fn(SIDE, SIDE, |_, _| true).expect("pixels")));
    assert!(none == trained(all, &ball_box(), AppearanceMode::Auto));
}

#[test]
fn screening_judges_what_masks_use() {
    let scores = |colour: f32| {
        let photos = named(captioned(colour));
        let mut screening =
            Screening::new(photos, &BTreeSet::new(), ball_box(), Some([0.5; 3]), &tiny(60), 7).expect("sound settings");
        while screening.steps_done() < screening.steps_total() {
            screening.step().expect("finite numbers");
        }
        screening.finish().expect("scores")
    };
    assert_eq!(scores(0.0), scores(1.0));
}

/// An absent view keeps its place in the order of pixels, and whatever it shows changes no byte.
#[test]
fn what_an_absent_view_shows_changes_no_byte() {
    let absent = |name: &str| name == "001.png" || name == "004.png";
    for (frame, appearance) in [(ball_box(), AppearanceMode::Off), (ball_in_the_open(), AppearanceMode::On)] {
        let trained = |photos: Vec<Photo>| {
            let config = FieldConfig { appearance, ..tiny(60) };
            let trainer = BaseTrainer::new(named(photos), frame.clone(), None, config, 3).expect("sound settings");
            let mut trainer = trainer.without(absent);
            while trainer.steps_done() < trainer.steps_total() {
                trainer.step().expect("finite numbers");
            }
            trainer.finish()
        };
        // Every second has a mask, absent ones among them.
        let photos = || captioned(0.3).into_iter().take(7).collect::<Vec<_>>();
        let field = trained(photos());
        let known = field.appearances().iter().filter(|(name, _)| absent(name)).count();
        assert_eq!(known, 0, "an absent view has no light");
        let mut turned = photos();
        assert_eq!(turned.iter().filter(|view| absent(&view.name)).count(), 2);
        for view in turned.iter_mut().filter(|view| absent(&view.name)) {
            // Mirrored, as its mask is: its mean colour, with which colours begin, stays.
            let mirrored = |row: &[f32]| row.chunks_exact(3).rev().flatten().copied().collect::<Vec<f32>>();
            let pixels = view.picture.rgb().chunks_exact(3 * SIDE).flat_map(mirrored).collect();
            view.picture = Picture::new(SIDE, SIDE, pixels).expect("three numbers a pixel");
        }
        assert!(field.to_bytes().expect("a field") == trained(turned).to_bytes().expect("a field"), "{appearance:?}");
    }
}
