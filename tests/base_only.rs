//! Base fields alone, through the binary: of captures with too few views or poses for clusters, what is said of
//! them, what is asked of them that they have not, and how much memory their photographs take.

use std::path::Path;

use cairn_scene::{Picture, save_png};
use cairn_testkit::daemon::Place;

/// A capture of one photograph a pose, of so many pixels a side: stripes, each photograph's at another place.
fn capture(folder: &Path, poses: &[[f64; 3]], side: usize) {
    std::fs::create_dir_all(folder.join("images")).unwrap();
    let mut frames = Vec::new();
    for (at, [x, y, z]) in poses.iter().enumerate() {
        let file = format!("images/{at:03}.png");
        let pixel = |i: usize| ((i % side / 4 + at) % 2) as f32 * 0.6 + 0.2;
        let rgb = (0..side * side).flat_map(|i| [pixel(i), 0.5, (i / side) as f32 / side as f32]).collect();
        save_png(&folder.join(&file), &Picture::new(side, side, rgb).unwrap()).unwrap();
        // OpenGL axes: it looks along -z.
        let pose = [[1.0, 0.0, 0.0, *x], [0.0, 1.0, 0.0, *y], [0.0, 0.0, 1.0, *z], [0.0, 0.0, 0.0, 1.0]];
        frames.push(serde_json::json!({ "file_path": file, "transform_matrix": pose }));
    }
    let text = serde_json::json!({ "camera_angle_x": 0.9, "frames": frames }).to_string();
    std::fs::write(folder.join("transforms.json"), text).unwrap();
}

/// A place with that capture as the scene `few`.
fn few(poses: &[[f64; 3]], side: usize, hold_every: &str) -> Place {
    let place = Place { dir: tempfile::tempdir().unwrap() };
    capture(&place.path("capture"), poses, side);
    let (from, data) = (place.text("capture"), place.text("data"));
    place.cairn_ok(&["scene", "import", "few", "--from", &from, "--hold-every", hold_every, "--data", &data]);
    place
}

fn said(output: &std::process::Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn one_training_view_is_enough_for_a_base_field() {
    for (what, poses, hold_every) in [
        ("two views, one held out", vec![[0.0, 0.0, 3.0], [0.5, 0.0, 3.0]], "2"),
        ("one view", vec![[0.0, 0.0, 3.0]], "0"),
        ("one pose", vec![[0.0, 0.0, 3.0]; 6], "0"),
    ] {
        let place = few(&poses, 24, hold_every);
        let data = place.text("data");
        let train = ["train", "few", "--quality", "smoke", "--data", &data];
        // To mark it there are too few views or poses still.
        let refused = place.cairn(&train);
        assert!(!refused.status.success() && said(&refused).contains("lower anchors (M)"), "{what}: {refused:?}");
        let done = place.cairn_ok(&[&train[..], &["--base-only"]].concat());
        assert!(done.contains("done") && done.contains("training views are one cluster"), "{what}: {done}");
        place.cairn_ok(&[&train[..], &["--base-only", "--by-contributor"]].concat());
        let out = place.text("view.png");
        let render = ["render", "few", "--view", "images/000.png", "--base", "--out", &out, "--data", &data];
        assert!(place.cairn_ok(&render).starts_with("24 x 24 px"), "{what}");
    }
}

#[test]
fn clusters_of_a_base_field_bind_no_later_marks() {
    let place = Place::new();
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    let train = ["train", "town", "--quality", "smoke", "--data", &data];
    let done = place.cairn_ok(&[&train[..], &["--base-only", "--anchors", "11"]].concat());
    assert!(done.contains("all 10 training views are one cluster"), "{done}");
    place.cairn_ok(&[&train[..], &["--anchors", "2"]].concat());
    let shown = place.cairn_ok(&["scene", "show", "town", "--data", &data]);
    assert!(shown.contains("identity 2: ") && !shown.contains("identity 3: "), "{shown}");
}

#[test]
fn a_base_field_alone_says_how_it_is_rendered() {
    let place = few(&[[0.0, 0.0, 3.0], [0.5, 0.0, 3.0]], 24, "0");
    let (data, out) = (place.text("data"), place.text("out.png"));
    place.cairn_ok(&["train", "few", "--base-only", "--quality", "smoke", "--data", &data]);
    let refused = place.cairn(&["render", "few", "--view", "images/000.png", "--out", &out, "--data", &data]);
    assert!(said(&refused).contains("ask for that (--base, or FIELD_KIND_BASE)"), "{refused:?}");
    let frames = place.text("frames");
    let ends = ["--path", "between", "--from", "images/000.png", "--to", "images/001.png"];
    let path = [&["render", "few"][..], &ends, &["--frames", "2", "--out", &frames, "--data", &data]];
    let refused = place.cairn(&path.concat());
    assert!(said(&refused).contains("--base"), "{refused:?}");
    assert!(!place.path("frames").exists(), "a refused path left a folder behind");
    assert!(place.cairn_ok(&[&path.concat()[..], &["--base"]].concat()).starts_with("2 frames"));
}

#[test]
fn how_a_scene_lies_is_said() {
    let place = Place { dir: tempfile::tempdir().unwrap() };
    capture(&place.path("capture"), &[[0.0, 0.0, 3.0], [0.5, 0.0, 3.0]], 24);
    let (from, data) = (place.text("capture"), place.text("data"));
    let import = ["--from", &from, "--data", &data, "--hold-every"];
    let guessed = place.cairn_ok(&[&["scene", "import", "a"][..], &import, &["2"]].concat());
    assert!(guessed.contains(" MB, unbounded (guessed; --kind says otherwise), not trained"), "{guessed}");
    let given = place.cairn_ok(&[&["scene", "import", "b", "--kind", "bounded"][..], &import, &["2"]].concat());
    assert!(given.contains(" MB, bounded, not trained"), "{given}");
    for shown in [vec!["list"], vec!["show", "b"]] {
        let shown = place.cairn_ok(&[&["scene"][..], &shown, &["--data", &data]].concat());
        assert!(shown.contains("b: 2 views (1 held out)") && shown.contains(", bounded, not trained"), "{shown}");
    }
    let trained = place.cairn_ok(&["train", "b", "--base-only", "--quality", "smoke", "--data", &data]);
    assert!(trained.contains(" accepted for b (bounded)"), "{trained}");
    // A split that leaves nothing is refused in the words of the command line.
    let refused = place.cairn(&[&["scene", "import", "c"][..], &import, &["1"]].concat());
    assert!(said(&refused).contains("--hold-every 0") && !said(&refused).contains("hold_every"), "{refused:?}");
}

/// The most memory that `cairn` with `arguments` held at a time, bytes.
#[cfg(target_os = "linux")]
fn peak(place: &Place, arguments: &[&str]) -> usize {
    let mut child = cairn_testkit::daemon::command()
        .args(arguments)
        .current_dir(place.dir.path())
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let mut most = 0;
    while child.try_wait().unwrap().is_none() {
        let status = std::fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
        let held = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let held = held.and_then(|line| line.split_whitespace().next()?.parse::<usize>().ok());
        most = most.max(held.unwrap_or(0) * 1024);
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    assert!(child.wait().unwrap().success(), "cairn {arguments:?}");
    most
}

/// In full these photographs take 288 MB, in 8 bits 72.
#[cfg(target_os = "linux")]
#[test]
fn photographs_are_kept_in_8_bits_as_they_are_read() {
    let (views, side) = (24, 1000);
    let poses: Vec<[f64; 3]> = (0..views).map(|i| [f64::from(i) * 0.05, 0.0, 3.0]).collect();
    let place = few(&poses, side, "0");
    let data = place.text("data");
    let most = peak(&place, &["train", "few", "--base-only", "--quality", "smoke", "--data", &data]);
    let in_full = views as usize * side * side * 12;
    assert!(most > 0 && most < in_full, "{most} bytes at a time, of {in_full} that the photographs take in full");
}
