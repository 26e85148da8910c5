//! Visible watermarks on the made-up landmark: a contributor's caption must not hang in the field, honest photographs must
//! not lose pixels, and a training that leaves pixels out resumes as any other.

use std::sync::Arc;

use crate::common::landmark::{frame, held_out_db, wild};
use cairn_field::{BaseTrainer, Field, FieldConfig, TrainingView, VisibleWatermark, watermarks};
use cairn_landmark::{Landmark, LandmarkCapture, LandmarkConfig};
use cairn_scene::{Picture, Picture8};

const SIZE: (usize, usize) = (60, 80);

fn landmark(seed: u64) -> LandmarkCapture {
    let config = LandmarkConfig {
        photographs: 12,
        width: SIZE.0,
        height: SIZE.1,
        passers_by: false,
        ..LandmarkConfig::default()
    };
    Landmark::generate(&config, seed).expect("sound settings")
}

/// All views but every sixth; those of the first contributor have a caption over the monument's foot: bright strokes on black.
fn captioned(capture: &LandmarkCapture) -> Vec<TrainingView> {
    let whose = &capture.views[0].contributor;
    let of = capture.views.iter().enumerate().filter(|(n, _)| n % 6 != 0);
    of.map(|(_, view)| {
        let mut picture = view.picture.clone();
        if view.contributor == *whose {
            let rgb: Vec<f32> =
                picture.rgb().chunks(3).enumerate().flat_map(|(at, p)| over(at, [p[0], p[1], p[2]])).collect();
            picture = Picture::new(SIZE.0, SIZE.1, rgb).expect("three numbers a pixel");
        }
        TrainingView {
            name: view.name.clone(),
            contributor: view.contributor.clone(),
            camera: view.camera,
            picture: Arc::new(picture),
        }
    })
    .collect()
}

/// The caption at pixel `at`, and elsewhere what is there.
fn over(at: usize, scene: [f32; 3]) -> [f32; 3] {
    let (x, y) = (at % SIZE.0, at / SIZE.0);
    match (6..54).contains(&x) && (50..66).contains(&y) {
        true if x / 2 % 3 == 0 && (53..63).contains(&y) => [1.0, 0.9, 0.2],
        true => [0.02, 0.02, 0.1],
        false => scene,
    }
}

fn found(views: &[TrainingView]) -> Vec<VisibleWatermark> {
    let kept: Vec<Picture8> = views.iter().map(|v| Picture8::from(&*v.picture)).collect();
    watermarks(&views.iter().map(|v| v.contributor.as_str()).zip(&kept).collect::<Vec<_>>())
}

fn trainer(views: Vec<TrainingView>, capture: &LandmarkCapture, leave_out_watermarks: bool) -> BaseTrainer {
    let config = FieldConfig { voxels: 500_000, levels: 3, leave_out_watermarks, ..wild(300) };
    BaseTrainer::new(views, frame(capture), None, config, 1).expect("sound settings")
}

fn trained(mut trainer: BaseTrainer) -> Field {
    while trainer.steps_done() < trainer.steps_total() {
        trainer.step().expect("finite numbers");
    }
    trainer.finish()
}

#[test]
fn a_caption_is_found_where_it_is_and_nowhere_else() {
    for seed in 1..=4 {
        let capture = landmark(seed);
        let views = captioned(&capture);
        let marks = found(&views);
        assert_eq!(marks.len(), 1, "seed {seed}: {:?}", marks.iter().map(|f| &f.contributor).collect::<Vec<_>>());
        let whose = |v: &TrainingView| v.contributor == capture.views[0].contributor;
        assert_eq!(marks[0].views, (0..views.len()).filter(|v| whose(&views[*v])).collect::<Vec<_>>());
        let is_over = |at: usize| over(at, [-1.0; 3]) != [-1.0; 3];
        let missed = (0..SIZE.0 * SIZE.1).filter(|at| is_over(*at) && !marks[0].covered[*at]).count();
        let beside = (0..SIZE.0 * SIZE.1).filter(|at| !is_over(*at) && marks[0].covered[*at]).count();
        // It has 768 pixels; two on every side are left out with it, 272, and what is as bright beside it (seed 1: 405 in all).
        assert!(missed == 0 && beside <= 500, "seed {seed}: {missed} missed, {beside} beside");
        let honest: Vec<TrainingView> = views.iter().filter(|v| !whose(v)).cloned().collect();
        assert_eq!(found(&honest), vec![], "seed {seed}");
    }
}

#[test]
fn a_caption_does_not_hang_in_the_field() {
    let capture = landmark(1);
    let whose = &capture.views[0].contributor;
    let held_out = || capture.views.iter().step_by(6).filter(|v| v.contributor == *whose);
    let [out, learnt] = [true, false].map(|leave_out| {
        let trainer = trainer(captioned(&capture), &capture, leave_out);
        assert_eq!(trainer.watermarks().len(), usize::from(leave_out));
        held_out_db(&trained(trainer), held_out())
    });
    println!("held-out views: {out:.2} dB with the caption left out, {learnt:.2} dB with it learnt");
    // About half of what it was: 19.9 and 18.3 dB, with seed 2 19.6 and 18.7.
    assert!(out > learnt + 0.7, "{out:.2} dB with the caption left out, {learnt:.2} dB with it learnt");
}

#[test]
fn a_stop_changes_nothing_whether_it_is_left_out_or_learnt() {
    let capture = landmark(1);
    let mut ends = Vec::new();
    for leave_out_watermarks in [true, false] {
        let config = FieldConfig { voxels: 32_768, levels: 2, leave_out_watermarks, ..wild(40) };
        let begin = || BaseTrainer::new(captioned(&capture), frame(&capture), None, config.clone(), 1).expect("sound");
        let whole = trained(begin()).to_bytes().expect("bytes");
        let mut first = begin();
        for _ in 0..17 {
            first.step().expect("finite numbers");
        }
        let checkpoint = first.checkpoint().expect("bytes");
        let resumed = BaseTrainer::resume(&checkpoint, captioned(&capture)).expect("the same views");
        assert_eq!(resumed.watermarks().len(), usize::from(leave_out_watermarks));
        assert!(trained(resumed).to_bytes().expect("bytes") == whole);
        ends.push(whole);
    }
    assert!(ends[0] != ends[1], "it is left out or learnt");
}
