//! From where to look, as commands take it: a view of the scene, or a camera in a file.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_api::v1;
use cairn_scene::LensModel;
use serde::Deserialize;

use super::files::read;

/// From where to look.
#[derive(Clone, Debug, clap::Args)]
#[group(required = true, multiple = false)]
pub struct FromWhere {
    /// The name of one of the scene's views
    #[arg(long, value_name = "VIEW")]
    pub view: Option<String>,
    /// A camera: JSON with width, height, fx, fy, cx, cy (px), camera_to_world (3 or 4 rows of 4 numbers, OpenCV axes),
    /// and k1, k2, k3, p1, p2 where the lens distorts; of a fisheye camera_model "OPENCV_FISHEYE" and k1, k2, k3, k4
    #[arg(long, value_name = "FILE")]
    pub pose: Option<PathBuf>,
    /// A picture of the scene, PNG, JPEG or WebP, whose camera is looked for first, as `cairn locate` does
    #[arg(long, value_name = "FILE")]
    pub picture: Option<PathBuf>,
}

/// A camera as people write it down.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseFile {
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    /// The lens's name, COLMAP's or nerfstudio's; without one it is a pinhole's.
    camera_model: Option<String>,
    #[serde(default)]
    k1: f64,
    #[serde(default)]
    k2: f64,
    #[serde(default)]
    k3: f64,
    #[serde(default)]
    k4: f64,
    #[serde(default)]
    p1: f64,
    #[serde(default)]
    p2: f64,
    camera_to_world: Vec<[f64; 4]>,
}

impl PoseFile {
    /// Whether the lens is a fisheye.
    fn is_fisheye(&self, path: &Path) -> anyhow::Result<bool> {
        let Some(name) = &self.camera_model else { return Ok(false) };
        let model = LensModel::from_name(name).with_context(|| {
            format!("{}: the camera_model {name:?} is not known; expected {}", path.display(), LensModel::list())
        })?;
        Ok(model.is_fisheye())
    }
}

fn camera(path: &Path) -> anyhow::Result<v1::Camera> {
    let f: PoseFile =
        serde_json::from_slice(&read(path)?).with_context(|| format!("{} is no camera", path.display()))?;
    let rows = &f.camera_to_world;
    let last_is_right = rows.get(3).is_none_or(|row| *row == [0.0, 0.0, 0.0, 1.0]);
    anyhow::ensure!(
        (rows.len() == 3 || rows.len() == 4) && last_is_right,
        "{}: camera_to_world needs 3 rows of 4 numbers, or 4 with the last one 0, 0, 0, 1",
        path.display()
    );
    let rotation = rows[..3].iter().flat_map(|row| row[..3].iter().copied()).collect();
    let position = rows[..3].iter().map(|row| row[3]).collect();
    let (fx, fy, cx, cy) = (f.fx, f.fy, f.cx, f.cy);
    let (k1, k2, k3, k4, p1, p2) = (f.k1, f.k2, f.k3, f.k4, f.p1, f.p2);
    let plain = v1::Intrinsics { width: f.width, height: f.height, fx, fy, cx, cy, ..v1::Intrinsics::default() };
    let intrinsics = if f.is_fisheye(path)? {
        // What a fisheye does not have is sent on, for the daemon to refuse by name.
        v1::Intrinsics { fisheye: Some(v1::Fisheye { k1, k2, k3, k4 }), p1, p2, ..plain }
    } else {
        anyhow::ensure!(
            k4 == 0.0,
            "{}: only a fisheye has k4; name it (\"camera_model\": \"OPENCV_FISHEYE\") or leave k4 out",
            path.display()
        );
        v1::Intrinsics { k1, k2, k3, p1, p2, ..plain }
    };
    Ok(v1::Camera { intrinsics: Some(intrinsics), pose: Some(v1::Pose { rotation, position }) })
}

/// The viewpoint of a view or of a camera's file.
///
/// # Errors
/// For a file that is no camera, and where neither is given.
pub fn viewpoint(view: Option<String>, pose: Option<&Path>) -> anyhow::Result<v1::Viewpoint> {
    use v1::viewpoint::From;
    let from = match (view, pose) {
        (Some(name), _) => From::ViewName(name),
        (None, Some(path)) => From::Camera(camera(path)?),
        (None, None) => anyhow::bail!("say from where: --view or --pose"),
    };
    Ok(v1::Viewpoint { from: Some(from) })
}

/// Looking from a camera of one's own: the pose file of a [`cairn_scene::Camera`].
#[cfg(test)]
fn pose_file(camera: &cairn_scene::Camera) -> serde_json::Value {
    let (i, p) = (&camera.intrinsics, &camera.pose);
    let row = |r: usize| {
        let rotation = p.rotation.row(r);
        [rotation.x, rotation.y, rotation.z, p.position[r]]
    };
    serde_json::json!({
        "width": i.width, "height": i.height, "fx": i.fx, "fy": i.fy, "cx": i.cx, "cy": i.cy,
        "camera_to_world": [row(0), row(1), row(2)],
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_scene::{Camera, Distortion, Fisheye, Intrinsics, Pose};
    use glam::{DMat3, DVec3};

    #[test]
    fn a_pose_file_is_the_camera_it_describes() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("pose.json");
        let pose = Pose::look_at(DVec3::new(1.0, -2.0, 3.0), DVec3::ZERO, DVec3::Z).unwrap();
        let distortion = Distortion::default();
        let intrinsics = Intrinsics { width: 8, height: 6, fx: 7.0, fy: 7.0, cx: 4.0, cy: 3.0, distortion };
        let wanted = Camera { intrinsics, pose };
        std::fs::write(&path, pose_file(&wanted).to_string()).unwrap();
        let read = cairn_service::grpc::from_proto::camera("c", Some(&camera(&path).unwrap())).unwrap();
        assert!((read.pose.position - wanted.pose.position).length() < 1e-12);
        let difference: DMat3 = read.pose.rotation - wanted.pose.rotation;
        assert!(difference.to_cols_array().iter().all(|v| v.abs() < 1e-9), "{difference}");
        assert!((wanted.ray(1.0, 2.0).1 - read.ray(1.0, 2.0).1).length() < 1e-9);
    }

    #[test]
    fn a_fisheye_s_pose_file_is_the_camera_it_describes() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("pose.json");
        let pose = Pose::look_at(DVec3::new(1.0, -2.0, 3.0), DVec3::ZERO, DVec3::Z).unwrap();
        let lens = Fisheye::new([-0.03, 0.004, -0.003, 0.0004]);
        let distortion = lens.into();
        let intrinsics = Intrinsics { width: 8, height: 6, fx: 3.0, fy: 3.1, cx: 4.0, cy: 3.0, distortion };
        let with = |change: fn(&mut serde_json::Value)| {
            let mut file = pose_file(&Camera { intrinsics, pose });
            for (n, k) in (1..).zip(lens.k()) {
                file[format!("k{n}")] = k.into();
            }
            file["camera_model"] = "OPENCV_FISHEYE".into();
            change(&mut file);
            std::fs::write(&path, file.to_string()).unwrap();
            let sent = camera(&path).map_err(|e| e.to_string())?;
            cairn_service::grpc::from_proto::camera("c", Some(&sent)).map_err(|e| e.to_string())
        };
        assert_eq!(with(|_| {}).unwrap().intrinsics, intrinsics);
        assert_eq!(with(|f| f["camera_model"] = "simple_radial_fisheye".into()).unwrap().intrinsics, intrinsics);
        for (change, says) in [
            (
                |f: &mut serde_json::Value| f["camera_model"] = "FOV".into(),
                "\"FOV\" is not known; expected SIMPLE_PINHOLE",
            ),
            (|f| f["camera_model"] = "OPENCV".into(), "only a fisheye has k4"),
            (|f| f["camera_model"] = serde_json::Value::Null, "only a fisheye has k4"),
            (|f| f["p2"] = 0.1.into(), "p2 is 0.1; allowed is 0 beside a fisheye"),
            (|f| f["k1"] = (-2.0).into(), "turns back"),
        ] as [(fn(&mut serde_json::Value), &str); 5]
        {
            let refused = with(change).unwrap_err();
            assert!(refused.contains(says), "{refused} does not say {says}");
        }
    }

    #[test]
    fn a_wrong_last_row_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("pose.json");
        let text = r#"{"width":1,"height":1,"fx":1,"fy":1,"cx":0,"cy":0,
            "camera_to_world":[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,1,1]]}"#;
        std::fs::write(&path, text).unwrap();
        assert!(camera(&path).unwrap_err().to_string().contains("0, 0, 0, 1"));
    }
}
