//! The made-up landmark for tests of stage 1: its box, settings as landmarks have them, and
//! how well held-out photographs are shown.

use cairn_field::{Field, FieldConfig, SceneFrame};
use cairn_landmark::{LandmarkCapture, LandmarkView};
use cairn_scene::SceneKind;
use glam::DVec3;

/// What the settings for landmarks are, on fewer rays.
pub fn wild(steps: u64) -> FieldConfig {
    FieldConfig {
        steps,
        rays_per_step: 2048,
        voxels: 8_000_000,
        levels: 4,
        huber: 0.2,
        smooth_density: 1e-4,
        smooth_colour: 1e-3,
        distortion: 0.03,
        ..FieldConfig::default()
    }
}

/// The box around the landmark, from where its photographers stood.
pub fn frame(capture: &LandmarkCapture) -> SceneFrame {
    let cameras = capture.views.iter().map(|v| v.camera).collect();
    SceneFrame::from_capture(&super::capture(SceneKind::Unbounded, cameras, 1.2, DVec3::new(0.0, 0.0, 1.0)))
        .expect("a box")
}

/// Mean PSNR of `views` without passers-by, their light fitted to left halves, right halves
/// scored, dB.
pub fn held_out_db<'a>(field: &Field, views: impl Iterator<Item = &'a LandmarkView>) -> f64 {
    let db = |view: &LandmarkView| {
        let light = field.fit_appearance_left_half(&view.camera, &view.clean).expect("a light");
        let render = field.render(&view.camera, &light).clamped();
        let (w, h) = (render.width(), render.height());
        let (mut sum, mut count) = (0.0f64, 0.0f64);
        for (x, y) in (0..h).flat_map(|y| (w / 2..w).map(move |x| (x, y))) {
            for (a, b) in render.pixel(x, y).iter().zip(view.clean.pixel(x, y)) {
                sum += f64::from(a - b).powi(2);
                count += 1.0;
            }
        }
        -10.0 * (sum / count).log10()
    };
    let each: Vec<f64> = views.map(db).collect();
    each.iter().sum::<f64>() / each.len() as f64
}
