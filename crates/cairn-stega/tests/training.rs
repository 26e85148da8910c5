//! Stage 2 on a tiny scene: the same bytes from the same seed, across threads
//! and interruptions; files that come back as they were written; plans and
//! files that do not fit refused by name; and marks that are really learnt.

use cairn_capture::{Camera, Distortion, Intrinsics, Picture, Pose};
use cairn_cluster::{ClusterConfig, Clusters, Grouping};
use cairn_field::{BaseTrainer, Field, FieldConfig, SceneFrame, TrainingView};
use cairn_nn::{ClassifierConfig, UNetConfig};
use cairn_stega::{
    CarrierKind, Detector, MarkConfig, MarkError, MarkPlan, MarkTrainer, MarkedField, MaskKind, PlannedView,
};
use glam::DVec3;
use std::sync::{Arc, OnceLock};

const SIDE: usize = 32;

/// Twelve cameras around a ball, seen against a plain sky.
fn cameras() -> Vec<Camera> {
    let intrinsics =
        Intrinsics { width: 40, height: 36, fx: 48.0, fy: 48.0, cx: 20.0, cy: 18.0, distortion: Distortion::default() };
    (0..12)
        .map(|i| {
            let angle = f64::from(i) * std::f64::consts::TAU / 12.0;
            let position = DVec3::new(3.0 * angle.cos(), 3.0 * angle.sin(), 0.6);
            Camera { intrinsics, pose: Pose::look_at(position, DVec3::ZERO, DVec3::Z).unwrap() }
        })
        .collect()
}

/// A ball of radius 1, coloured by its normal.
fn photograph(camera: &Camera) -> Picture {
    let (w, h) = (camera.intrinsics.width, camera.intrinsics.height);
    let mut rgb = Vec::new();
    for y in 0..h {
        for x in 0..w {
            let (o, d) = camera.ray(x as f64 + 0.5, y as f64 + 0.5);
            let b = o.dot(d);
            let root = b * b - (o.length_squared() - 1.0);
            let colour = if root > 0.0 { (o + d * (-b - root.sqrt())) * 0.4 + 0.5 } else { DVec3::splat(0.8) };
            rgb.extend(colour.to_array().map(|v| v as f32));
        }
    }
    Picture::new(w, h, rgb).unwrap()
}

fn field() -> Arc<Field> {
    static FIELD: OnceLock<Arc<Field>> = OnceLock::new();
    FIELD
        .get_or_init(|| {
            let views = cameras()
                .into_iter()
                .enumerate()
                .map(|(i, camera)| TrainingView {
                    name: format!("view{i}"),
                    camera,
                    picture: Arc::new(photograph(&camera)),
                })
                .collect();
            let frame = SceneFrame::Bounded { centre: DVec3::ZERO, half: DVec3::splat(1.2) };
            let config =
                FieldConfig { steps: 60, rays_per_step: 1024, voxels: 8000, levels: 1, ..FieldConfig::default() };
            let mut trainer = BaseTrainer::new(views, frame, Some([0.8; 3]), config, 3).unwrap();
            while trainer.steps_done() < trainer.steps_total() {
                trainer.step().unwrap();
            }
            Arc::new(trainer.finish())
        })
        .clone()
}

fn signal(identity: usize) -> Picture {
    let on = |x: usize, y: usize| if identity == 0 { (x / 8 + y / 8).is_multiple_of(2) } else { x.abs_diff(y) < 8 };
    let pixel = |i: usize| if on(i % SIDE, i / SIDE) { [0.9, 0.2, 0.3] } else { [0.1, 0.5, 0.8] };
    Picture::new(SIDE, SIDE, (0..SIDE * SIDE).flat_map(pixel).collect()).unwrap()
}

fn plan() -> MarkPlan {
    let cameras = cameras();
    let poses: Vec<Pose> = cameras.iter().map(|c| c.pose).collect();
    let grouping = Grouping::Anchors(ClusterConfig { anchors: 2, neighbours: 4, ..ClusterConfig::default() });
    let appearance = field().canonical_appearance().clone();
    MarkPlan {
        clusters: Clusters::build(&poses, &grouping, &[], 5).unwrap(),
        views: cameras.iter().map(|c| PlannedView { camera: *c, appearance: appearance.clone() }).collect(),
        signals: vec![signal(0), signal(1)],
        negatives: cameras.iter().map(photograph).collect(),
    }
}

fn config(steps: u64) -> MarkConfig {
    MarkConfig {
        steps,
        virtual_views: 2,
        enough_ssim: 2.0,
        classifier: ClassifierConfig { channels: vec![8, 16], ..ClassifierConfig::default() },
        detector: UNetConfig { size: [SIDE, SIDE], channels: vec![8, 12, 16], ..UNetConfig::default() },
        ..MarkConfig::default()
    }
}

fn trained(config: MarkConfig) -> (MarkedField, Detector) {
    let mut trainer = MarkTrainer::new(field(), plan(), config, 7).unwrap();
    while trainer.steps_done() < trainer.steps_total() {
        trainer.step().unwrap();
        if trainer.steps_done().is_multiple_of(5) {
            trainer.judge().unwrap();
        }
    }
    trainer.finish().unwrap()
}

fn bytes(result: (MarkedField, Detector)) -> (Vec<u8>, Vec<u8>) {
    (result.0.to_bytes().unwrap(), result.1.to_bytes().unwrap())
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| bytes(trained(config(8))))
    };
    assert!(with(1) == with(3), "one thread and three differ");
}

#[test]
fn an_interrupted_run_ends_in_the_same_bytes() {
    let whole = bytes(trained(MarkConfig { classify_until: 10.0, ..config(12) }));
    let mut first = MarkTrainer::new(field(), plan(), MarkConfig { classify_until: 10.0, ..config(12) }, 7).unwrap();
    for _ in 0..7 {
        first.step().unwrap();
        if first.steps_done() == 5 {
            first.judge().unwrap();
        }
    }
    let stopped = first.checkpoint().unwrap();
    drop(first);
    let mut second = MarkTrainer::resume(&stopped, field(), plan()).unwrap();
    assert!(second.checkpoint().unwrap() == stopped, "a checkpoint read and written again is another");
    while second.steps_done() < second.steps_total() {
        second.step().unwrap();
        if second.steps_done().is_multiple_of(5) {
            second.judge().unwrap();
        }
    }
    assert!(bytes(second.finish().unwrap()) == whole, "the resumed run ended elsewhere");
}

#[test]
fn marks_are_learnt_and_unmarked_pictures_stay_silent() {
    let (marked, detector) = trained(MarkConfig { budget_db: 36.0, ..config(400) });
    let (mut right, mut asked) = (0, 0);
    for camera in cameras() {
        let appearance = field().canonical_appearance().clone();
        let Some(identity) = marked.clusters().identity_of(&camera.pose).identity else { continue };
        let with = detector.detect(&marked.render(&camera, &appearance)).unwrap();
        let without = detector.detect(&field().render(&camera, &appearance)).unwrap();
        right += usize::from(with.identity == Some(identity)) + usize::from(without.identity.is_none());
        asked += 2;
        // The mark, not the view, carries the class: another owner's mark on
        // this view is that owner's.
        let other = 3 - identity;
        let swapped = detector.detect(&marked.render_as(&camera, &appearance, Some(other))).unwrap();
        right += usize::from(swapped.identity == Some(other));
        asked += 1;
    }
    assert!(asked >= 18, "{asked} questions are too few to mean anything");
    assert!(right as f64 >= 0.9 * f64::from(asked), "{right} of {asked} right");
}

#[test]
fn files_come_back_as_they_were_written() {
    for carrier in [CarrierKind::PerCluster, CarrierKind::Harmonics] {
        let (marked, detector) = trained(MarkConfig { carrier, mask: MaskKind::PerCoefficientGroup, ..config(3) });
        let again = MarkedField::from_bytes(&marked.to_bytes().unwrap()).unwrap();
        assert!(again.to_bytes().unwrap() == marked.to_bytes().unwrap());
        let camera = cameras()[0];
        let appearance = field().canonical_appearance().clone();
        let picture = marked.render(&camera, &appearance);
        assert!(again.render(&camera, &appearance) == picture, "the field read back renders another picture");
        let read = Detector::from_bytes(&detector.to_bytes().unwrap()).unwrap();
        let (a, b) = (detector.detect(&picture).unwrap(), read.detect(&picture).unwrap());
        assert_eq!(a.probabilities, b.probabilities);
        assert_eq!(a.recovered, b.recovered);
    }
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let mut short = plan();
    short.signals.pop();
    let error = MarkTrainer::new(field(), short, config(3), 7).err().unwrap().to_string();
    assert!(error.contains("1 signals for 2 identities"), "{error}");
    let wrong = MarkConfig { budget_db: 5.0, ..config(3) };
    let error = MarkTrainer::new(field(), plan(), wrong, 7).err().unwrap();
    assert!(matches!(error, MarkError::Setting { key: "mark.budget_db", .. }), "{error}");

    let trainer = MarkTrainer::new(field(), plan(), config(3), 7).unwrap();
    let checkpoint = trainer.checkpoint().unwrap();
    let mut other = plan();
    other.signals.swap(0, 1);
    let error = MarkTrainer::resume(&checkpoint, field(), other).err().unwrap().to_string();
    assert!(error.contains("other views, signals or photographs"), "{error}");
    let (marked, detector) = trainer.finish().unwrap();
    let (marked, detector) = (marked.to_bytes().unwrap(), detector.to_bytes().unwrap());
    assert!(MarkedField::from_bytes(&detector).is_err(), "a detector is no marked field");
    assert!(Detector::from_bytes(&marked).is_err(), "a marked field is no detector");
    for cut in [0, 7, 100, marked.len() / 2, marked.len() - 1] {
        assert!(MarkedField::from_bytes(&marked[..cut]).is_err(), "cut at {cut}");
    }
}

#[test]
fn a_pixel_that_is_not_finite_is_named() {
    let (_, detector) = trained(config(1));
    let mut picture = photograph(&cameras()[0]);
    picture.rgb_mut()[(5 * 40 + 3) * 3] = f32::NAN;
    let error = detector.detect(&picture).unwrap_err().to_string();
    assert!(error.contains("(3, 5)"), "{error}");
}
