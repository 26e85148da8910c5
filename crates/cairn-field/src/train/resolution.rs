//! How fine the grid becomes, and when. A voxel much wider than a pixel blurs what photographs show; one
//! much narrower costs memory and time for what no photograph tells. How many pixels a voxel is
//! wide depends on how far off the photographers stood and on their lenses, not on the kind of the
//! scene alone, and so each capture is asked.

use crate::config::FieldConfig;
use crate::rays::frame::SceneFrame;
use crate::stats::median;
use cairn_scene::Camera;

/// Vertices along each side at `level`, in the frame's proportions, on the way to a last
/// grid of `finest` vertices. The first level's grid does not depend on that: it is
/// there before anything is known.
pub(crate) fn dims_of_level(config: &FieldConfig, frame: &SceneFrame, level: usize, finest: usize) -> [usize; 3] {
    let p = frame.proportions();
    let left = (config.levels - 1 - level) as i32;
    // Eight times the vertices from level to level, and what more is wanted in even parts.
    let more = (finest as f64 / config.voxels as f64).powf(1.0 / (config.levels - 1).max(1) as f64);
    let voxels = finest as f64 / (8.0 * more).powi(left);
    let unit = (voxels / (p[0] * p[1] * p[2])).cbrt();
    p.map(|side| ((side * unit).round() as usize).clamp(4, 4096))
}

/// Vertices of the last grid: [`FieldConfig::voxels`]; where it may be `finer` as many more as make a voxel
/// [`FieldConfig::voxel_px`] pixels of the middling view wide, up to [`FieldConfig::max_voxels`]; and fewer
/// where it would be narrower than [`FieldConfig::min_voxel_px`].
pub(crate) fn finest(config: &FieldConfig, frame: &SceneFrame, cameras: &[Camera], finer: bool) -> usize {
    let usual = config.voxels;
    let across = pixels_across(frame, cameras);
    if config.levels < 2 || across.is_nan() {
        return usual;
    }
    // Saturates; what divides by 0 is more than there can be.
    let of_width = |px: f64| (frame.proportions().iter().product::<f64>() * (across / px).powi(3)) as usize;
    let wanted = if finer && config.voxel_px > 0.0 { of_width(config.voxel_px).min(config.max_voxels) } else { 0 };
    // The first level's grid is there already, and the last is no coarser.
    let first = usual >> (3 * (config.levels - 1));
    wanted.max(usual.min(of_width(config.min_voxel_px).max(first)))
}

/// Step at which `level` ends: the last level gets three fifths of all steps.
pub(crate) fn level_end(config: &FieldConfig, level: usize) -> u64 {
    if level + 1 >= config.levels {
        return config.steps;
    }
    let share = 0.4 * ((level + 1) as f64 / (config.levels - 1) as f64).powf(1.6);
    // However short the training, every level has a step.
    ((config.steps as f64 * share) as u64).max(level as u64 + 1)
}

/// Side of the tiles drawn at `level`, pixels: neighbours in a coarse grid meet the
/// same voxels and would say the same.
pub(crate) fn tile_side(config: &FieldConfig, level: usize) -> usize {
    (config.tile_px >> (2 * (config.levels - 1 - level))).max(1)
}

/// How many pixels the middling one of `cameras` has for the longest side of the frame's cube, as
/// it sees the scene's centre (in the open: were the whole cube as little contracted as the
/// box). Cameras within the box look at its walls. NaN without cameras.
fn pixels_across(frame: &SceneFrame, cameras: &[Camera]) -> f64 {
    let of = |camera: &Camera| {
        let focal = camera.intrinsics.fx.min(camera.intrinsics.fy);
        let boxed =
            |centre: glam::DVec3, half: f64| focal * 2.0 * half / (camera.pose.position - centre).length().max(half);
        match frame {
            // There a length is a share of the depth.
            SceneFrame::ForwardFacing { low, high, .. } => focal * (high[0] - low[0]).max(high[1] - low[1]),
            SceneFrame::Bounded { centre, half } => boxed(*centre, half.max_element()),
            SceneFrame::Unbounded { centre, half } => 2.0 * boxed(*centre, half.max_element()),
        }
    };
    if cameras.is_empty() { f64::NAN } else { median(cameras.iter().map(of).collect()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_scene::{Distortion, Intrinsics, Pose};
    use glam::{DMat3, DVec3};

    /// A camera of so many pixels' focal length at `position`, looking at `at`.
    fn camera(focal: f64, position: DVec3, at: DVec3) -> Camera {
        let intrinsics = Intrinsics {
            width: 640,
            height: 480,
            fx: focal,
            fy: focal * 1.5,
            cx: 320.0,
            cy: 240.0,
            distortion: Distortion::default(),
        };
        Camera { intrinsics, pose: Pose::look_at(position, at, DVec3::Y).unwrap() }
    }

    fn config(voxel_px: f64) -> FieldConfig {
        FieldConfig {
            voxels: 8_000,
            max_voxels: 64_000_000,
            min_voxel_px: 0.0,
            levels: 4,
            voxel_px,
            ..FieldConfig::default()
        }
    }

    #[test]
    fn a_voxel_is_as_many_pixels_wide_as_asked() {
        let (centre, half) = (DVec3::new(3.0, 0.0, 0.0), DVec3::new(1.0, 0.5, 0.25));
        // From 5 away with 500 px of focal length: 100 px a unit, 200 px for the longest side.
        let cameras = [camera(500.0, centre + DVec3::Z * 5.0, centre)];
        let bounded = SceneFrame::Bounded { centre, half };
        assert_eq!(finest(&config(2.0), &bounded, &cameras, true), 100 * 50 * 25);
        // In the open the cube is two boxes wide.
        let open = SceneFrame::Unbounded { centre, half };
        assert_eq!(finest(&config(2.0), &open, &cameras, true), 8 * 100 * 50 * 25);
        // Forward-facing: two depths wide at 500 px a depth.
        let rotation = DMat3::IDENTITY;
        let ahead = SceneFrame::ForwardFacing { rotation, position: centre, near: 1.0, low: [-1.0; 2], high: [1.0; 2] };
        let [x, y, z] = ahead.proportions().map(|p| p * 500.0);
        assert_eq!(finest(&config(2.0), &ahead, &cameras, true), (x * y * z) as usize);
    }

    #[test]
    fn limits_hold_and_zero_is_never() {
        let (centre, half) = (DVec3::ZERO, DVec3::ONE);
        let frame = SceneFrame::Unbounded { centre, half };
        let far = [camera(500.0, DVec3::Z * 500.0, centre)];
        let near = [camera(5000.0, DVec3::Z * 2.0, centre)];
        assert_eq!(finest(&config(2.0), &frame, &far, true), 8_000, "a far camera asks for less");
        assert_eq!(finest(&config(2.0), &frame, &near, true), 64_000_000);
        assert_eq!(finest(&config(0.0), &frame, &near, true), 8_000);
        assert_eq!(finest(&FieldConfig { levels: 1, ..config(2.0) }, &frame, &near, true), 8_000);
        assert_eq!(finest(&config(2.0), &frame, &[], true), 8_000);
        // Cameras in the middle see walls that are half a box off: 500 px for half of it.
        let inside = [camera(500.0, DVec3::Z * 1e-9, DVec3::Z)];
        assert_eq!(finest(&config(10.0), &frame, &inside, true), 200 * 200 * 200);
    }

    #[test]
    fn small_photographs_have_no_voxels_between_their_pixels() {
        let (centre, half) = (DVec3::ZERO, DVec3::ONE);
        let frame = SceneFrame::Bounded { centre, half };
        let many = |min_voxel_px| FieldConfig { voxels: 8_000_000, min_voxel_px, ..config(2.0) };
        // From 5 away with 100 px of focal length: 40 px for the box.
        let small = [camera(100.0, DVec3::Z * 5.0, centre)];
        for finer in [false, true] {
            assert_eq!(finest(&many(0.5), &frame, &small, finer), 80 * 80 * 80);
            assert_eq!(finest(&many(1.0), &frame, &small, finer), 40 * 40 * 40);
            assert_eq!(finest(&many(0.0), &frame, &small, finer), 8_000_000);
            assert_eq!(finest(&FieldConfig { levels: 1, ..many(0.5) }, &frame, &small, finer), 8_000_000);
            // No coarser than the first level: 8 million by three times eight.
            let smaller = [camera(10.0, DVec3::Z * 5.0, centre)];
            assert_eq!(finest(&many(1.0), &frame, &smaller, finer), 8_000_000 / 512);
        }
        // Where 200 px or more lie across it stays as it was.
        let usual = [camera(500.0, DVec3::Z * 5.0, centre)];
        assert_eq!(finest(&many(0.5), &frame, &usual, false), 8_000_000);
    }

    #[test]
    fn levels_lead_to_the_last_grid_in_even_steps() {
        let frame = SceneFrame::Bounded { centre: DVec3::ZERO, half: DVec3::ONE };
        let sides = |finest: usize| [0, 1, 2, 3].map(|level| dims_of_level(&config(2.0), &frame, level, finest)[0]);
        // 8000 vertices are 20 a side, of which the first level has an eighth (and 4 at least).
        assert_eq!(sides(8_000), [4, 5, 10, 20]);
        let config = FieldConfig { voxels: 512_000, ..config(2.0) };
        let sides = |finest: usize| [0, 1, 2, 3].map(|level| dims_of_level(&config, &frame, level, finest)[0]);
        assert_eq!(sides(512_000), [10, 20, 40, 80]);
        // Eight times as many vertices, twice the side: by a factor of 2 * 2^(1/3) a level.
        assert_eq!(sides(8 * 512_000), [10, 25, 63, 160]);
        // An eighth as many, half the side.
        assert_eq!(sides(512_000 / 8), [10, 16, 25, 40]);
    }
}
