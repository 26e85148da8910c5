//! The program `cairn-eval` at work in a folder with tiny captures of a made-up landmark.

use std::path::PathBuf;
use std::process::{Command, Output};

use cairn_eval::results::{Results, Row};
use cairn_landmark::{Landmark, LandmarkConfig};
use cairn_scene::Picture;
use serde_json::Value;
use tempfile::TempDir;

/// A folder that goes with the test, with captures in it.
pub struct Place {
    pub dir: TempDir,
}

impl Place {
    /// Two contributors' photographs of the landmark, 12 views of 32 x 32 px, as captures `liberty` and `lego`, and three
    /// pictures to hide.
    pub fn new() -> Self {
        let place = Self { dir: tempfile::tempdir().unwrap() };
        let config =
            LandmarkConfig { contributors: 2, photographs: 6, width: 32, height: 32, ..LandmarkConfig::default() };
        Landmark::generate(&config, 3).unwrap().write(&place.path("capture")).unwrap();
        captures(&place);
        std::fs::create_dir(place.path("captures/signals")).unwrap();
        for (at, rgb) in [[0.9, 0.2, 0.1], [0.1, 0.8, 0.2], [0.2, 0.3, 0.9]].into_iter().enumerate() {
            let mut picture = Picture::constant(32, 32, rgb);
            picture.rgb_mut()[..16 * 32 * 3].fill(0.1 * at as f32);
            cairn_scene::save_png(&place.path(&format!("captures/signals/{at}.png")), &picture).unwrap();
        }
        place
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// Starts `cairn-eval` in this folder, quick, on its captures.
    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_cairn-eval"));
        command.args(arguments).args(["--quick", "--captures", "captures", "--results", "results"]);
        command.args(["--page", "results.md", "--out", "out"]).current_dir(self.dir.path());
        command
    }

    /// Runs [`Place::command`].
    pub fn eval(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().unwrap()
    }

    /// As [`Place::eval`]; it must succeed. What it printed.
    pub fn eval_ok(&self, arguments: &[&str]) -> String {
        let output = self.eval(arguments);
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{arguments:?}: {said}{}", String::from_utf8_lossy(&output.stderr));
        said
    }

    /// All rows of the runs in this folder.
    pub fn rows(&self) -> Vec<Row> {
        Results::load(&self.path("out/rows")).unwrap().rows().to_vec()
    }
}

/// A figure among `rows`.
pub fn value(rows: &[Row], case: &str, metric: &str) -> f64 {
    let row = rows.iter().find(|row| row.case == case && row.metric == metric);
    row.unwrap_or_else(|| panic!("no row {case}, {metric}")).value
}

/// `liberty` as the made-up landmark with masks, and `lego` as the same in NeRF-Synthetic's form with a split of its own.
fn captures(place: &Place) {
    let capture = place.path("capture");
    let (liberty, lego) = (place.path("captures/liberty"), place.path("captures/lego"));
    for folder in [liberty.join("images"), liberty.join("masks"), lego.join("images")] {
        std::fs::create_dir_all(folder).unwrap();
    }
    for entry in std::fs::read_dir(capture.join("images")).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap();
        std::fs::copy(&path, liberty.join("images").join(name)).unwrap();
        std::fs::copy(&path, lego.join("images").join(name)).unwrap();
        let mut mask = Picture::constant(32, 32, [0.0; 3]);
        mask.rgb_mut()[16 * 32 * 3..].fill(1.0);
        cairn_scene::save_png(&liberty.join("masks").join(name), &mask).unwrap();
    }
    std::fs::copy(capture.join("transforms.json"), liberty.join("transforms.json")).unwrap();
    let all: Value = serde_json::from_slice(&std::fs::read(capture.join("transforms.json")).unwrap()).unwrap();
    let frames = all["frames"].as_array().unwrap();
    for (file, held_out) in [("transforms_train.json", false), ("transforms_test.json", true)] {
        let split: Vec<Value> = frames
            .iter()
            .enumerate()
            .filter(|(i, _)| (i % 4 == 0) == held_out)
            .map(|(_, f)| serde_json::json!({ "file_path": f["file_path"], "transform_matrix": f["transform_matrix"] }))
            .collect();
        let text = serde_json::json!({ "camera_angle_x": 50f64.to_radians(), "frames": split }).to_string();
        std::fs::write(lego.join(file), text).unwrap();
    }
}
