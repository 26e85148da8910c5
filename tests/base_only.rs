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

/// A place with that capture as the scene `few`, imported with these options.
fn few(poses: &[[f64; 3]], side: usize, options: &[&str]) -> Place {
    let place = Place { dir: tempfile::tempdir().unwrap() };
    capture(&place.path("capture"), poses, side);
    let (from, data) = (place.text("capture"), place.text("data"));
    place.cairn_ok(&[&["scene", "import", "few", "--from", &from, "--data", &data][..], options].concat());
    place
}

fn said(output: &std::process::Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn one_training_view_is_enough_for_a_base_field() {
    for (what, poses, options) in [
        ("two views, one held out", vec![[0.0, 0.0, 3.0], [0.5, 0.0, 3.0]], &["--hold-out", "2"][..]),
        ("one view", vec![[0.0, 0.0, 3.0]], &[]),
        ("one pose", vec![[0.0, 0.0, 3.0]; 6], &[]),
    ] {
        let place = few(&poses, 24, options);
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
    let place = few(&[[0.0, 0.0, 3.0], [0.5, 0.0, 3.0]], 24, &[]);
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
    let import = ["--from", &from, "--data", &data, "--hold-out"];
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
    // A split that leaves nothing to train on, or nothing to score, is refused with what to do.
    for every in ["0", "1"] {
        let refused = place.cairn_refused(&[&["scene", "import", "c"][..], &import, &[every]].concat());
        let wanted = format!("--hold-out) is {every}, expected 2 or more; leave it away to train on every photograph");
        assert!(refused.contains(&wanted), "{refused}");
    }
}

/// By default every photograph is trained on; who gets no share all the same is named, and so is the way to scores.
#[test]
fn every_photograph_counts_unless_it_cannot_and_who_gets_nothing_is_named() {
    let place = Place { dir: tempfile::tempdir().unwrap() };
    let poses: Vec<[f64; 3]> = (0..4).map(|i| [f64::from(i) * 0.3, 0.0, 3.0]).collect();
    capture(&place.path("capture"), &poses, 24);
    let images = place.path("capture/images");
    // A photograph that no camera was found for, and one with a camera that is gone.
    std::fs::copy(images.join("000.png"), images.join("004.png")).unwrap();
    std::fs::remove_file(images.join("003.png")).unwrap();
    let rows = "image,contributor\n000.png,ada\n001.png,bo\n002.png,cy\n003.png,di\n004.png,eve\n";
    std::fs::write(place.path("capture/who.csv"), rows).unwrap();
    let data = place.text("data");
    let import = |scene: &str, options: &[&str]| {
        let from = ["scene", "import", scene, "--from", "capture", "--contributors", "who.csv", "--skip-missing"];
        place.cairn_ok(&[&from[..], &["--data", &data], options].concat())
    };
    let imported = import("all", &[]);
    assert!(imported.contains("all: 3 views (0 held out) by 3 contributors"), "{imported}");
    let nothing = "no share for di (1 photograph missing); eve (1 photograph without a camera)";
    assert!(imported.contains(nothing), "{imported}");
    let answer: serde_json::Value = serde_json::from_str(&import("some", &["--hold-out", "3", "--json"])).unwrap();
    assert_eq!(answer["scene"]["held_out_views"], 1);
    let row =
        |contributor: &str, why: &str| serde_json::json!({ "contributor": contributor, "why": why, "photographs": 1 });
    let wanted = [row("ada", "held-out"), row("di", "missing"), row("eve", "no-camera")];
    assert_eq!(answer["without_share"], serde_json::json!(wanted));

    let train = |scene: &str| place.cairn_ok(&["train", scene, "--base-only", "--quality", "smoke", "--data", &data]);
    assert!(!train("all").contains("no share for"));
    let refused = place.cairn_refused(&["evaluate", "all", "--data", &data]);
    assert!(refused.contains("scene \"all\" cannot be scored") && refused.contains("--hold-out 8"), "{refused}");
    place.cairn_ok(&["scene", "exclude", "some", "001.png", "--data", &data]);
    let nothing = "no share for ada (1 photograph held out); bo (1 photograph excluded)";
    let trained = train("some");
    assert!(trained.contains(&format!("some: {nothing}")), "{trained}");
    let shown = place.cairn_ok(&["scene", "show", "some", "--data", &data]);
    assert!(shown.contains(&format!("\n  {nothing}\n")), "{shown}");
    let shown = place.cairn_json(&["scene", "show", "some", "--json", "--data", &data]);
    assert_eq!(shown["model"]["without_share"], serde_json::json!([row("ada", "held-out"), row("bo", "excluded")]));

    let who = |view: &str| place.cairn_ok(&["who", "some", "--view", view, "--data", &data]);
    assert!(
        who("000.png").contains("photographed by ada, who gets no share for it: it is held out"),
        "{}",
        who("000.png")
    );
    assert!(who("001.png").contains("the view itself is excluded: no contributor gets a share for it"));
    assert!(who("002.png").contains("the view itself was photographed by cy\n"));
    let who = place.cairn_json(&["who", "some", "--view", "000.png", "--json", "--data", &data]);
    assert_eq!((&who["photographed_by"], &who["view_unused"]), (&"ada".into(), &"held-out".into()));
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
    let place = few(&poses, side, &[]);
    let data = place.text("data");
    let most = peak(&place, &["train", "few", "--base-only", "--quality", "smoke", "--data", &data]);
    let in_full = views as usize * side * side * 12;
    assert!(most > 0 && most < in_full, "{most} bytes at a time, of {in_full} that the photographs take in full");
}
