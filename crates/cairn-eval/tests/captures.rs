//! Tiny captures by the names that the bench suites know.

use cairn_scene::Picture;
use serde_json::Value;

use super::Place;

/// `liberty` as the made-up landmark with masks, and `lego` as the same in
/// NeRF-Synthetic's form with a split of its own.
pub fn captures(place: &Place) {
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
