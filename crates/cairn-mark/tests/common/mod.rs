//! A tiny scene: a ball, twelve cameras around it, two owners.

use cairn_field::{AppearanceMode, BaseTrainer, Field, FieldConfig, NamedView, SceneFrame};
use cairn_mark::{Detector, MarkPlan, MarkTrainer, MarkedField, PlannedView, Recipe};
use cairn_nn::{ClassifierConfig, UNetConfig};
use cairn_scene::cluster::{ClusterConfig, Clusters, Grouping};
use cairn_scene::{Camera, Distortion, Intrinsics, Picture, Pose};
use glam::DVec3;
use std::sync::{Arc, OnceLock};

pub const SIDE: usize = 32;

/// Twelve cameras around a ball, seen against a plain sky.
pub fn cameras() -> Vec<Camera> {
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
pub fn photograph(camera: &Camera) -> Picture {
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

/// The ball after `steps` steps of stage 1.
pub fn train_field(steps: u64) -> Arc<Field> {
    train_field_of(steps, photograph)
}

/// What `photograph` shows after `steps` steps of stage 1.
pub fn train_field_of(steps: u64, photograph: fn(&Camera) -> Picture) -> Arc<Field> {
    train_field_lit(steps, photograph, AppearanceMode::default())
}

/// The same, with views' own light or without.
pub fn train_field_lit(steps: u64, photograph: fn(&Camera) -> Picture, appearance: AppearanceMode) -> Arc<Field> {
    let view = |(i, camera): (usize, Camera)| NamedView::new(format!("view{i}"), camera, &photograph(&camera));
    let views = cameras().into_iter().enumerate().map(view).collect();
    let frame = SceneFrame::Bounded { centre: DVec3::ZERO, half: DVec3::splat(1.2) };
    let config =
        FieldConfig { steps, rays_per_step: 1024, voxels: 8000, levels: 1, appearance, ..FieldConfig::default() };
    let mut trainer = BaseTrainer::new(views, frame, Some([0.8; 3]), config, 3).unwrap();
    while trainer.steps_done() < trainer.steps_total() {
        trainer.step().unwrap();
    }
    Arc::new(trainer.finish())
}

pub fn field() -> Arc<Field> {
    static FIELD: OnceLock<Arc<Field>> = OnceLock::new();
    FIELD.get_or_init(|| train_field(60)).clone()
}

pub fn signal(identity: usize) -> Picture {
    let on = |x: usize, y: usize| if identity == 0 { (x / 8 + y / 8).is_multiple_of(2) } else { x.abs_diff(y) < 8 };
    let pixel = |i: usize| if on(i % SIDE, i / SIDE) { [0.9, 0.2, 0.3] } else { [0.1, 0.5, 0.8] };
    Picture::new(SIDE, SIDE, (0..SIDE * SIDE).flat_map(pixel).collect()).unwrap()
}

pub fn plan() -> MarkPlan {
    plan_of(&field(), 2, photograph)
}

/// A plan for `identities` clusters of a scene that `photograph` shows.
pub fn plan_of(field: &Field, identities: usize, photograph: fn(&Camera) -> Picture) -> MarkPlan {
    let cameras = cameras();
    let poses: Vec<Pose> = cameras.iter().map(|c| c.pose).collect();
    let neighbours = 4.min(cameras.len() / identities);
    let grouping = Grouping::Anchors(ClusterConfig { anchors: identities, neighbours, ..ClusterConfig::default() });
    let appearance = field.canonical_appearance().clone();
    MarkPlan {
        clusters: Clusters::build(&poses, &grouping, &[], 5).unwrap(),
        views: cameras.iter().map(|c| PlannedView { camera: *c, appearance: appearance.clone() }).collect(),
        signals: (0..identities).map(|i| signal(i).into()).collect(),
        negatives: cameras.iter().map(|camera| (&photograph(camera)).into()).collect(),
    }
}

/// So few steps that the detector has to join at once.
pub fn config(steps: u64) -> Recipe {
    Recipe {
        steps,
        classify_until: 10.0,
        virtual_views: 2,
        enough_ssim: 2.0,
        classifier: ClassifierConfig { channels: vec![8, 16], ..ClassifierConfig::default() },
        detector: UNetConfig { size: [SIDE, SIDE], channels: vec![8, 12, 16], ..UNetConfig::default() },
        ..Recipe::default()
    }
}

/// A trainer over [`plan`] that nobody stops.
pub fn start(config: Recipe) -> MarkTrainer {
    MarkTrainer::new(field(), plan(), config, 7, &mut |_, _| true).unwrap()
}

/// Takes all steps that are left, judging at every fifth.
pub fn run(trainer: &mut MarkTrainer) {
    while trainer.steps_done() < trainer.steps_total() {
        trainer.step().unwrap();
        if trainer.steps_done().is_multiple_of(5) {
            trainer.judge().unwrap();
        }
    }
}

/// A trainer over [`plan`] that has taken all its steps.
pub fn ran(config: Recipe) -> MarkTrainer {
    let mut trainer = start(config);
    run(&mut trainer);
    trainer
}

pub fn trained(config: Recipe) -> (MarkedField, Detector) {
    ran(config).finish().unwrap()
}

/// The files of the marked field and of the detector that a training ends in.
pub fn bytes(trainer: MarkTrainer) -> [Vec<u8>; 2] {
    let (marked, detector) = trainer.finish().unwrap();
    [marked.to_bytes().unwrap(), detector.to_bytes().unwrap()]
}
