//! Where a picture was taken, through the real program: located, compared, and asked about.

use std::fs::File;
use std::path::Path;

use cairn_landmark::{Landmark, LandmarkCapture, LandmarkConfig};
use cairn_scene::{Camera, Limits, Picture, decode_picture, encode_png};
use cairn_testkit::daemon::{Daemon, Place, smoke_settings, train_to_end};

/// Pixels of a photograph along each side.
const SIDE: usize = 96;
/// A view that was held out.
const HELD_OUT: &str = "images/bela_001.png";

/// A landmark in one light, of photographs large enough for keypoints.
fn landmark() -> LandmarkCapture {
    let config = LandmarkConfig {
        contributors: 2,
        photographs: 8,
        width: SIDE,
        height: SIDE,
        passers_by: false,
        light_variation: 0.0,
        ..LandmarkConfig::default()
    };
    Landmark::generate(&config, 3).unwrap()
}

/// A place whose scene `town` has a field that shows what it is of, and marks.
fn trained(landmark: &LandmarkCapture) -> Place {
    let place = Place { dir: tempfile::tempdir().unwrap() };
    landmark.write(&place.path("capture")).unwrap();
    place.import("town", ["--data", &place.text("data")]);
    let mut settings = smoke_settings();
    (settings.field.steps, settings.field.rays_per_step) = (400, 1024);
    (settings.field.voxels, settings.field.levels) = (40_000, 2);
    train_to_end(&place.path("data"), "town", settings, false);
    place
}

fn picture(path: &Path) -> Picture {
    decode_picture(&std::fs::read(path).unwrap(), &Limits::default(), None).unwrap()
}

/// A quarter of a turn clockwise.
fn turned(picture: &Picture) -> Picture {
    let (w, h) = (picture.width(), picture.height());
    let rgb = (0..w * h).flat_map(|at| picture.pixel(at / h, h - 1 - at % h)).collect();
    Picture::new(h, w, rgb).unwrap()
}

/// Where the camera of an answer in JSON stands.
fn position(found: &serde_json::Value) -> glam::DVec3 {
    let position: [f64; 3] = serde_json::from_value(found["camera"]["pose"]["position"].clone()).unwrap();
    position.into()
}

/// The share of each contributor of an answer in JSON.
fn shares(answer: &serde_json::Value) -> Vec<(String, f64)> {
    let of = |of: &serde_json::Value| (of["name"].as_str().unwrap().to_owned(), of["share"].as_f64().unwrap());
    let mut shares: Vec<_> = answer["contributors"].as_array().unwrap().iter().map(of).collect();
    shares.sort_by(|a, b| a.0.cmp(&b.0));
    shares
}

#[test]
fn a_picture_is_located_compared_and_asked_about() {
    let landmark = landmark();
    let truth: Camera = landmark.views.iter().find(|view| view.name == HELD_OUT).unwrap().camera;
    let away = truth.pose.position.length();
    let place = trained(&landmark);
    let daemon = Daemon::start(&place.path("data"), "");
    let to = ["--connect", daemon.url.as_str()];
    let cairn = |arguments: &[&str]| place.cairn_ok(&[arguments, &to].concat());
    let json = |arguments: &[&str]| place.cairn_json(&[arguments, &["--json"], &to].concat());

    // By the others' places honest photographs are where their cameras say, in pixels of the photographs.
    let checked = json(&["scene", "check", "town", "--places"]);
    let off = |view: &serde_json::Value| view["found"]["off"]["off_px"].as_f64();
    let off: Vec<f64> = checked["views"].as_array().unwrap().iter().filter_map(off).collect();
    assert!(off.len() > 3 && off.iter().all(|px| *px < 10.0), "{off:?}");

    // Larger than the photographs, from where none of them taught anything.
    let render = place.text("render.png");
    let pose = pose_file(&place, &truth.resized(2 * SIDE, 2 * SIDE));
    cairn(&["render", "town", "--pose", &pose, "--out", &render]);
    let blink = place.text("blink.gif");
    let found = &json(&["locate", "town", &render, "--out", &blink])["found"];
    assert!((position(found) - truth.pose.position).length() < 0.01 * away, "{found}");
    assert!(found["turned_deg"].as_f64().unwrap().abs() < 1.0 && found["uncertainty_px"].as_f64().unwrap() < 1.0);
    assert!(found["explained"].as_f64().unwrap() > 0.8 && found["render_png"] == "", "{found}");
    let mut frames = gif::DecodeOptions::new().read_info(File::open(&blink).unwrap()).unwrap();
    for _ in 0..2 {
        let frame = frames.read_next_frame().unwrap().expect("picture and render");
        assert_eq!((frame.delay, usize::from(frame.width)), (50, 2 * SIDE));
    }
    assert!(frames.read_next_frame().unwrap().is_none());

    // Turned and made smaller, and drawn side by side.
    let (bent, sheet) = (place.path("bent.png"), place.text("sheet.png"));
    std::fs::write(&bent, encode_png(&turned(&picture(Path::new(&render))).resized(150, 150))).unwrap();
    let said = cairn(&["locate", "town", &place.text("bent.png"), "--out", &sheet]);
    assert!(
        said.starts_with("camera at (") && said.contains("px of 150 x 150 px; ") && said.contains("uncertain by 0.")
    );
    let by = said.split("turned clockwise by ").nth(1).and_then(|rest| rest.split(' ').next()).unwrap();
    assert!((by.parse::<f64>().unwrap() - 90.0).abs() < 1.0, "{said}");
    assert!(said.ends_with(&format!("picture, render and their difference times 5 in {sheet}\n")), "{said}");
    let drawn = picture(Path::new(&sheet));
    assert!(drawn.width() > 3 * 150 && drawn.height() > 150, "{} x {}", drawn.width(), drawn.height());

    // Who shows what the picture shows is who shows what its camera sees.
    let of_pose = json(&["who", "town", "--pose", &pose]);
    let of_picture = json(&["who", "town", "--picture", &render]);
    for (known, found) in shares(&of_pose).iter().zip(shares(&of_picture)) {
        assert!(known.0 == found.0 && (known.1 - found.1).abs() < 0.01, "{of_pose} {of_picture}");
    }
    assert!((position(&of_picture["located"]) - truth.pose.position).length() < 0.01 * away, "{of_picture}");

    // A photograph's light is fitted from where it was found; this scene has no light but one.
    let light = ["render", "town", "--view", HELD_OUT, "--out", "lit.png", "--light-of", &render];
    let refused = place.cairn_refused(&[&light[..], &to].concat());
    assert!(refused.contains("render.png: camera at (") && refused.contains("as of one light"), "{refused}");

    // Its mark stands out from where it was found.
    let said = cairn(&["identify", "town", &render, "--register"]);
    assert!(said.contains("registered: the field explains ") && said.contains(" stands out and is believed"), "{said}");

    // What is not of the scene is not placed, and says so.
    let stranger = place.text("stranger.png");
    let noise = (0..SIDE * SIDE * 3).map(|i| (i * i % 251) as f32 / 250.0).collect();
    std::fs::write(&stranger, encode_png(&Picture::new(SIDE, SIDE, noise).unwrap())).unwrap();
    let said = cairn(&["locate", "town", &stranger]);
    assert!(said.starts_with("not found: no camera was found: of "), "{said}");
    assert!(json(&["locate", "town", &stranger])["not_found"].as_str().unwrap().contains("agree"));
    let refused =
        place.cairn_refused(&[&["locate", "town", &stranger, "--out", &place.text("no.gif")], &to[..]].concat());
    assert!(
        refused.contains("no.gif: the picture's camera was not found") && !place.path("no.gif").exists(),
        "{refused}"
    );
    let refused = place.cairn_refused(&[&["who", "town", "--picture", &stranger], &to[..]].concat());
    assert!(refused.contains("stranger.png: no camera was found"), "{refused}");
    let refused = place.cairn_refused(&[&["locate", "town", &render, "--out", "x.jpg"], &to[..]].concat());
    assert!(refused.contains("x.jpg: the comparison's name ends in .gif or .png"), "{refused}");
}

/// The camera as a file for `--pose`.
fn pose_file(place: &Place, camera: &Camera) -> String {
    let (i, r, at) = (camera.intrinsics, camera.pose.rotation.transpose(), camera.pose.position.to_array());
    let row = |n: usize| -> Vec<f64> { r.col(n).to_array().into_iter().chain([at[n]]).collect() };
    let json = serde_json::json!({
        "width": i.width, "height": i.height, "fx": i.fx, "fy": i.fy, "cx": i.cx, "cy": i.cy,
        "camera_to_world": [row(0), row(1), row(2)],
    });
    std::fs::write(place.path("pose.json"), json.to_string()).unwrap();
    place.text("pose.json")
}

#[test]
fn a_model_whose_index_is_damaged_or_gone_is_refused_by_name() {
    let place = Place::new();
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    place.cairn_ok(&["train", "town", "--by-contributor", "--base-only", "--quality", "smoke", "--data", &data]);
    let photograph = place.text("capture/images/ada_002.png");
    let locate = ["locate", "town", &photograph, "--data", &data];
    // So short a training knows no place again, and says so.
    assert!(place.cairn_ok(&locate).starts_with("not found: "));
    let index = place.path("data/models/town/job-000001/base.places");
    let mut bytes = std::fs::read(&index).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(&index, &bytes).unwrap();
    let refused = place.cairn_refused(&locate);
    assert!(refused.contains("base.places") && refused.contains("it was altered"), "{refused}");
    std::fs::remove_file(&index).unwrap();
    assert!(place.cairn_refused(&locate).contains("base.places"));
    // What needs no index goes on.
    place.cairn_ok(&["who", "town", "--view", "images/ada_002.png", "--data", &data]);
}
