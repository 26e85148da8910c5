//! How a camera follows what is done to its picture: the camera that would have taken the picture as it then is.

use cairn_mark::Distortion;
use cairn_scene::{Camera, Distortion as LensDistortion};
use glam::{DMat2, DMat3, DVec2};

/// The camera of `camera`'s picture once `distortion` was applied to it.
///
/// A turn takes pixels to be square, as they are in the captures to a part in a thousand: a pinhole cannot say others.
pub fn follow(distortion: &Distortion, camera: &Camera) -> Camera {
    let mut camera = *camera;
    let lens = &mut camera.intrinsics;
    match *distortion {
        Distortion::Crop { kept, across, down } => {
            let part = |whole: usize| ((whole as f32 * kept).round() as usize).clamp(1, whole);
            let before = |whole: usize, at: f32| f64::from(((whole - part(whole)) as f32 * at).round());
            lens.cx -= before(lens.width, across);
            lens.cy -= before(lens.height, down);
            (lens.width, lens.height) = (part(lens.width), part(lens.height));
        }
        Distortion::Scale { factor } => {
            let side = |whole: usize| ((whole as f32 * factor).round() as usize).max(1);
            let (width, height) = (side(lens.width), side(lens.height));
            *lens = lens.resized(width, height);
        }
        Distortion::Rotate { degrees } => {
            let angle = f64::from(degrees).to_radians();
            // Rows go down, so that a turn counter-clockwise to the eye is by a negative angle.
            let turn = DMat2::from_angle(-angle);
            let middle = DVec2::new(lens.width as f64, lens.height as f64) / 2.0;
            let centre = middle + turn * (DVec2::new(lens.cx, lens.cy) - middle);
            (lens.cx, lens.cy) = (centre.x, centre.y);
            if let LensDistortion::Pinhole(lens) = &mut lens.distortion {
                // What is tangential moves x by r^2 q + 2 (q x) x, where q is (p2, p1).
                let q = turn * DVec2::new(lens.p2, lens.p1);
                (lens.p2, lens.p1) = (q.x, q.y);
            }
            camera.pose.rotation *= DMat3::from_rotation_z(angle);
        }
        Distortion::Jpeg { .. }
        | Distortion::Blur { .. }
        | Distortion::Noise { .. }
        | Distortion::Light { .. }
        | Distortion::EightBits => {}
    }
    camera
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_scene::{BrownConrady, Intrinsics, Picture, Pose};
    use glam::DVec3;

    fn camera() -> Camera {
        let distortion = BrownConrady { k1: -0.1, k2: 0.02, k3: 0.0, p1: 0.02, p2: -0.03 }.into();
        let intrinsics = Intrinsics { width: 201, height: 144, fx: 170.0, fy: 170.0, cx: 95.0, cy: 77.0, distortion };
        let pose = Pose::look_at(DVec3::new(1.0, 2.0, -3.0), DVec3::new(0.1, 0.2, 0.3), DVec3::Y).unwrap();
        Camera { intrinsics, pose }
    }

    /// Black with a white spot about `at`, px.
    fn with_spot(camera: &Camera, at: DVec2) -> Picture {
        let (w, h) = (camera.intrinsics.width, camera.intrinsics.height);
        let light = |k: usize| {
            let off = DVec2::new((k % w) as f64 + 0.5, (k / w) as f64 + 0.5) - at;
            (-0.5 * off.length_squared() / 4.0).exp() as f32
        };
        Picture::new(w, h, (0..w * h).flat_map(|k| [light(k); 3]).collect()).unwrap()
    }

    /// Where the spot is, px.
    fn spot(picture: &Picture) -> DVec2 {
        let mut sum = DVec2::ZERO;
        let mut weight = 0.0;
        for y in 0..picture.height() {
            for x in 0..picture.width() {
                let light = f64::from(picture.pixel(x, y)[0]).powi(2);
                sum += DVec2::new(x as f64 + 0.5, y as f64 + 0.5) * light;
                weight += light;
            }
        }
        sum / weight
    }

    #[test]
    fn a_point_is_where_the_followed_camera_has_it() {
        let crop = Distortion::Crop { kept: 0.7746, across: 0.2, down: 0.7 };
        let turn = |degrees| Distortion::Rotate { degrees };
        let scale = |factor| Distortion::Scale { factor };
        let chains: [&[Distortion]; 8] = [
            &[Distortion::Jpeg { quality: 90 }, Distortion::Light { brightness: 0.8, contrast: 1.0 }],
            &[crop],
            &[turn(30.0)],
            &[turn(-45.0)],
            &[scale(0.75)],
            &[scale(0.5)],
            &[turn(30.0), crop, scale(0.75)],
            &[Distortion::Crop { kept: 0.7, across: 0.9, down: 0.6 }, turn(-15.0)],
        ];
        for chain in chains {
            for from in [DVec2::new(110.0, 70.0), DVec2::new(95.5, 91.25), DVec2::new(128.0, 52.0)] {
                let mut camera = camera();
                let (origin, direction) = camera.ray(from.x, from.y);
                let point = origin + direction * 4.0;
                let mut picture = with_spot(&camera, from);
                for distortion in chain {
                    picture = distortion.apply(&picture, 1);
                    camera = follow(distortion, &camera);
                }
                let size = (camera.intrinsics.width, camera.intrinsics.height);
                assert_eq!(size, (picture.width(), picture.height()), "{chain:?}");
                let (shown, said) = (spot(&picture), camera.project(point).unwrap());
                assert!((shown - said).length() < 0.1, "{chain:?}: {from} is at {shown}, and the camera says {said}");
            }
        }
    }
}
