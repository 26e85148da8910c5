//! The same seed gives the same bytes: with any number of threads, and with a
//! training that was stopped and taken up again, also across a level.

use crate::common::named;
use crate::common::{ball_box, ball_in_the_open, tiny, views};
use cairn_field::{AppearanceMode, BaseTrainer, Field, FieldConfig, SceneFrame};
use glam::DVec3;

fn trainer(frame: &SceneFrame, config: &FieldConfig, seed: u64) -> BaseTrainer {
    BaseTrainer::new(named(views(5, 24, 1.0, DVec3::ZERO)), frame.clone(), None, config.clone(), seed)
        .expect("sound settings")
}

fn bytes_with(threads: usize, frame: &SceneFrame, config: &FieldConfig, seed: u64) -> Vec<u8> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
    pool.install(|| {
        let mut trainer = trainer(frame, config, seed);
        (0..config.steps).for_each(|_| {
            trainer.step().expect("finite numbers");
        });
        trainer.finish().to_bytes().expect("a field")
    })
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    for frame in [ball_box(), ball_in_the_open()] {
        let config = tiny(40);
        let one = bytes_with(1, &frame, &config, 7);
        assert!(one == bytes_with(2, &frame, &config, 7), "two threads");
        assert!(one == bytes_with(3, &frame, &config, 7), "three threads");
        assert!(one != bytes_with(2, &frame, &config, 8), "another seed is another field");
    }
}

#[test]
fn a_resumed_training_ends_in_the_same_bytes() {
    for (frame, appearance) in [(ball_box(), AppearanceMode::Off), (ball_in_the_open(), AppearanceMode::On)] {
        let config = FieldConfig { appearance, ..tiny(60) };
        let mut whole = trainer(&frame, &config, 3);
        let mut saved = Vec::new();
        let mut sizes = Vec::new();
        for step in 0..config.steps {
            // Before, at and after the level's change, and late.
            if [5, 23, 24, 25, 50].contains(&step) {
                saved.push(whole.checkpoint().expect("a checkpoint"));
            }
            sizes.push(whole.size().1);
            whole.step().expect("finite numbers");
        }
        assert_ne!(sizes[5], sizes[50], "the level changes in between");
        let expected = whole.finish().to_bytes().expect("a field");
        for (n, bytes) in saved.iter().enumerate() {
            let mut resumed =
                BaseTrainer::resume(bytes, named(views(5, 24, 1.0, DVec3::ZERO))).expect("a sound checkpoint");
            assert!(resumed.checkpoint().expect("a checkpoint") == *bytes, "checkpoint {n} is read as it was written");
            while resumed.steps_done() < resumed.steps_total() {
                resumed.step().expect("finite numbers");
            }
            assert!(resumed.finish().to_bytes().expect("a field") == expected, "taken up at checkpoint {n}");
        }
    }
}

#[test]
fn a_training_stopped_before_every_step_ends_in_the_same_bytes() {
    for frame in [ball_box(), ball_in_the_open()] {
        // Past a level's change, its half and a refreshing of what is occupied.
        let config = tiny(70);
        let mut whole = trainer(&frame, &config, 4);
        let mut broken = trainer(&frame, &config, 4);
        for _ in 0..config.steps {
            let stats = whole.step().expect("finite numbers");
            let bytes = broken.checkpoint().expect("a checkpoint");
            broken = BaseTrainer::resume(&bytes, named(views(5, 24, 1.0, DVec3::ZERO))).expect("a sound checkpoint");
            assert_eq!(broken.step().expect("finite numbers"), stats);
        }
        assert!(whole.finish().to_bytes().expect("a field") == broken.finish().to_bytes().expect("a field"));
    }
}

#[test]
fn a_stored_field_is_the_field_in_memory() {
    let mut trainer = trainer(&ball_in_the_open(), &tiny(30), 3);
    (0..30).for_each(|_| {
        trainer.step().expect("finite numbers");
    });
    let field = trainer.finish();
    let bytes = field.to_bytes().expect("a field");
    let back = Field::from_bytes(&bytes).expect("what was just written");
    assert!(back.to_bytes().expect("a field") == bytes);
    for view in views(3, 20, 1.0, DVec3::ZERO) {
        let look = field.appearance_of(&view.name);
        assert_eq!(back.appearance_of(&view.name), look);
        assert_eq!(field.render(&view.camera, look), back.render(&view.camera, look));
    }
}
