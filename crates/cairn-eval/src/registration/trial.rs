//! What a try to find a camera came to, by where the found camera and the true one have the same places.

use cairn_scene::Camera;
use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::timing::median;

/// A picture is placed where the camera is off by less, px.
const PLACED_PX: f64 = 2.0;
/// Off by a larger share of the picture's longer side is another place.
const WRONG_SHARE: f64 = 0.05;
/// The truth is to lie within so many of the stated standard deviations.
const DEVIATIONS: f64 = 3.0;

/// A try.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Trial {
    /// Which condition, by its number.
    pub condition: usize,
    /// Which place, by its number.
    pub place: usize,
    /// The name of the place's view.
    pub view: String,
    /// Seconds of the search.
    pub seconds: f64,
    /// What was found.
    pub outcome: Outcome,
}

/// What was found.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Outcome {
    /// A camera.
    Located(Fix),
    /// None, for this reason.
    NotLocated(String),
}

/// How good a found camera is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fix {
    /// How far from each other the found camera and the true one have a place: the median over places, px. The picture's
    /// longer side where the found camera does not see them.
    pub off_px: f64,
    /// The picture's longer side, px.
    pub longest_px: usize,
    /// PSNR between the renders from both cameras in one light, dB.
    pub psnr_db: f64,
    /// The stated uncertainty, px; `None` where it is unbounded.
    pub uncertainty_px: Option<f64>,
    /// The stated share of the picture that is explained.
    pub explained: f64,
    /// How surprising the agreement of keypoints is.
    pub surprise: f64,
}

impl Fix {
    /// Whether the picture is placed.
    pub fn is_placed(&self) -> bool {
        self.off_px < PLACED_PX
    }

    /// Whether the render from there is so near the right one.
    pub fn is_at(&self, min_db: f64) -> bool {
        self.is_placed() && self.psnr_db >= min_db
    }

    /// Whether the camera is somewhere else.
    pub fn is_wrong(&self) -> bool {
        self.off_px > WRONG_SHARE * self.longest_px as f64
    }

    /// Whether the true camera lies within three of the stated uncertainties; `None` where none is stated.
    pub fn is_within(&self) -> Option<bool> {
        self.uncertainty_px.map(|uncertainty| self.off_px <= DEVIATIONS * uncertainty)
    }
}

impl Trial {
    /// How good the found camera is, where there is one.
    pub fn fix(&self) -> Option<&Fix> {
        match &self.outcome {
            Outcome::Located(fix) => Some(fix),
            Outcome::NotLocated(_) => None,
        }
    }
}

/// How far from each other two cameras have those of some `points` that the picture of `truth` shows: the median, px of that
/// picture, its longer side at most. As much where it shows none: no camera is right for it.
pub fn off_px(found: &Camera, truth: &Camera, points: &[DVec3]) -> f64 {
    let (width, height) = (truth.intrinsics.width, truth.intrinsics.height);
    let max = width.max(height) as f64;
    let found = found.resized(width, height);
    let off = |point: &DVec3| {
        let at = truth.project(*point)?;
        let inside = at.x >= 0.0 && at.y >= 0.0 && at.x < width as f64 && at.y < height as f64;
        inside.then(|| found.project(*point).map_or(max, |there| there.distance(at).min(max)))
    };
    median(&points.iter().filter_map(off).collect::<Vec<f64>>()).unwrap_or(max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_scene::{Intrinsics, Pose};
    use glam::DMat3;

    #[test]
    fn cameras_are_apart_by_where_they_have_places() {
        let intrinsics = Intrinsics {
            width: 100,
            height: 80,
            fx: 50.0,
            fy: 50.0,
            cx: 50.0,
            cy: 40.0,
            distortion: Default::default(),
        };
        let truth = Camera { intrinsics, pose: Pose { rotation: DMat3::IDENTITY, position: DVec3::ZERO } };
        let points = [DVec3::new(0.0, 0.0, 5.0), DVec3::new(1.0, 0.5, 5.0), DVec3::new(-1.0, 0.0, 5.0)];
        assert_eq!(off_px(&truth, &truth, &points), 0.0);
        let moved = Camera { pose: Pose { position: DVec3::new(0.5, 0.0, 0.0), ..truth.pose }, ..truth };
        // 50 px times 0.5 over a depth of 5; as much in pixels of the truth where the found camera's picture is larger.
        for found in [moved, moved.resized(200, 160)] {
            assert!((off_px(&found, &truth, &points) - 5.0).abs() < 1e-9);
        }
        // What the picture does not show does not count.
        let beside = [points[0], DVec3::new(50.0, 0.0, 5.0), DVec3::new(0.0, 0.0, -5.0)];
        assert!((off_px(&moved, &truth, &beside) - 5.0).abs() < 1e-9);
        assert_eq!(off_px(&truth, &truth, &beside[1..]), 100.0);
        let away = Camera { pose: Pose { position: DVec3::new(0.0, 0.0, 9.0), ..truth.pose }, ..truth };
        assert_eq!(off_px(&away, &truth, &points), 100.0, "they lie behind it");
    }

    #[test]
    fn a_fix_is_judged_by_its_limits() {
        let fix = Fix {
            off_px: 1.9,
            longest_px: 300,
            psnr_db: 38.0,
            uncertainty_px: Some(0.6),
            explained: 0.9,
            surprise: 20.0,
        };
        assert!(fix.is_placed() && fix.is_at(35.0) && !fix.is_at(40.0) && !fix.is_wrong());
        assert_eq!((fix.is_within(), Fix { uncertainty_px: None, ..fix }.is_within()), (Some(false), None));
        let off = Fix { off_px: 14.0, ..fix };
        assert!(!off.is_placed() && !off.is_at(35.0) && !off.is_wrong() && Fix { off_px: 16.0, ..fix }.is_wrong());
    }
}
