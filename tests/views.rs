//! Looking at a scene through the real daemon: maps behind a render, camera paths,
//! and the drawing of its cameras.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use cairn_api::v1::render_path_request::Path as Way;
use cairn_api::v1::render_service_client::RenderServiceClient;
use cairn_api::v1::{self};
use cairn_landmark::{Landmark, LandmarkConfig};
use cairn_scene::{Distortion, Limits, Picture, decode_picture};
use cairn_testkit::daemon::{Daemon, Place};
use tonic::Code;
use tonic::transport::Endpoint;

const FIRST: &str = "images/ada_002.png";
const SECOND: &str = "images/ada_004.png";

/// A place whose scene `town` has a base field.
fn trained() -> Place {
    let place = Place::new();
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    place.cairn_ok(&["train", "town", "--by-contributor", "--base-only", "--quality", "smoke", "--data", &data]);
    place
}

/// `poses_bounds.npy` beside the capture's `transforms.json`: the same cameras, with depth bounds.
fn write_bounds(capture: &Path) {
    let document: serde_json::Value =
        serde_json::from_slice(&std::fs::read(capture.join("transforms.json")).unwrap()).unwrap();
    let mut frames = document["frames"].as_array().unwrap().clone();
    frames.sort_by_key(|frame| frame["file_path"].to_string());
    let mut numbers: Vec<f64> = Vec::new();
    for frame in &frames {
        for (row, size) in [32.0, 32.0, 40.0].into_iter().enumerate() {
            let at = |column: usize| frame["transform_matrix"][row][column].as_f64().unwrap();
            // Down, right, backwards, position.
            numbers.extend([-at(1), at(0), at(2), at(3), size]);
        }
        numbers.extend([1.0, 9.0]);
    }
    let shape = format!("({}, 17)", frames.len());
    let head = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}");
    let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    bytes.extend(format!("{head:<117}\n").bytes());
    bytes.extend(numbers.iter().flat_map(|v| v.to_le_bytes()));
    std::fs::write(capture.join("poses_bounds.npy"), bytes).unwrap();
}

fn picture(path: &Path) -> Picture {
    decode_picture(&std::fs::read(path).unwrap(), &Limits::default(), None).unwrap()
}

fn orbit(frames: u32) -> v1::RenderPathRequest {
    v1::RenderPathRequest {
        scene: "town".into(),
        path: Some(Way::Orbit(v1::OrbitPath::default())),
        frames,
        field: v1::FieldKind::Base.into(),
        ..v1::RenderPathRequest::default()
    }
}

#[test]
fn maps_are_written_beside_a_render_and_agree() {
    let place = trained();
    let data = place.text("data");
    let files = ["view.png", "depth.png", "colours.png", "accumulation.png"].map(|f| place.text(f));
    let render = ["render", "town", "--view", FIRST, "--base", "--data", &data, "--out", &files[0]];
    let maps = ["--depth", &files[1], "--depth-colours", &files[2], "--accumulation", &files[3]];
    let said = place.cairn_ok(&[&render[..], &maps].concat());
    assert!(said.contains("capture units") && said.lines().count() == 4, "{said}");
    let alone = place.text("alone.png");
    place.cairn_ok(&["render", "town", "--view", FIRST, "--base", "--data", &data, "--out", &alone]);
    assert_eq!(std::fs::read(&alone).unwrap(), std::fs::read(&files[0]).unwrap(), "maps change no picture");

    let [_, depth, colours, accumulation] = files.map(|f| picture(Path::new(&f)));
    assert_eq!((colours.width(), colours.height()), (32, 32));
    let mut deep = 0;
    for (depth, accumulation) in depth.rgb().iter().zip(accumulation.rgb()) {
        assert_eq!(*depth > 0.0, *accumulation >= 0.1, "depth {depth} where {accumulation} is stopped");
        deep += usize::from(*depth > 0.0);
    }
    assert!(deep > 0, "nothing at all is in the picture");
}

#[test]
fn the_ending_of_a_render_decides_its_format() {
    let place = trained();
    let render = |name: &str| {
        let out = place.text(name);
        let output =
            place.cairn(&["render", "town", "--view", FIRST, "--base", "--data", &place.text("data"), "--out", &out]);
        (output.status.success(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let shown = |name: &str| picture(&place.path(name));
    for name in ["a.png", "a.webp", "a.JPG"] {
        assert!(render(name).0, "{name}");
    }
    assert_eq!(shown("a.webp").rgb(), shown("a.png").rgb());
    assert!(std::fs::read(place.path("a.webp")).unwrap().starts_with(b"RIFF"));
    assert!(std::fs::read(place.path("a.JPG")).unwrap().starts_with(b"\xff\xd8\xff"));
    let apart = shown("a.JPG").rgb().iter().zip(shown("a.png").rgb()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(apart > 0.0 && apart < 0.1, "{apart}");
    // Nothing is rendered for another ending: not even the scene is looked for.
    let out = place.text("a.tiff");
    let refused = place.cairn(&["render", "none", "--view", "none", "--data", &place.text("data"), "--out", &out]);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(said.contains("a.tiff") && said.contains(".png, .jpg, .jpeg or .webp"), "{said}");
}

#[test]
fn a_path_begins_and_ends_in_its_views() {
    let place = trained();
    let daemon = Daemon::start(&place.path("data"), "");
    let to = ["--connect", daemon.url.as_str()];
    let frames = place.text("path");
    let path = ["render", "town", "--path", "between", "--from", FIRST, "--to", SECOND, "--base", "--frames", "4"];
    let said = place.cairn_ok(&[&path[..], &["--out", &frames], &to].concat());
    assert!(said.starts_with("4 frames of 32 x 32 px in "), "{said}");
    for (frame, view) in [("frame-00000.png", FIRST), ("frame-00003.png", SECOND)] {
        let there = place.text("there.png");
        place.cairn_ok(&["render", "town", "--view", view, "--light", view, "--base", "--out", &there, to[0], to[1]]);
        let (frame, there) = (std::fs::read(place.path("path").join(frame)), std::fs::read(there));
        assert_eq!(frame.unwrap(), there.unwrap(), "{view}");
    }
    for (arguments, says) in [
        (&["--path", "between", "--from", FIRST, "--to", SECOND, "--out", &frames][..], "holds frames already"),
        (&["--path", "between", "--out", "x.gif"], "needs --from VIEW and --to VIEW"),
        (&["--path", "spiral", "--arc", "90", "--out", "x.gif"], "--arc is for --path orbit"),
        (&["--path", "orbit", "--arc", "0", "--out", "x.gif"], "allowed is above 0, to 360"),
        (&["--path", "orbit", "--out", "x.mp4"], ".gif file, or into a folder"),
        (&["--view", FIRST, "--arc", "90", "--out", "x.png"], "--path <SHAPE>"),
        (&["--path", "orbit", "--depth", "d.png", "--out", "x.gif"], "cannot be used with"),
    ] {
        let refused = place.cairn(&[&["render", "town", "--base"], arguments, &to].concat());
        assert!(String::from_utf8_lossy(&refused.stderr).contains(says), "{arguments:?}: {refused:?}");
    }

    let gif = place.text("orbit.gif");
    let orbit = ["render", "town", "--path", "orbit", "--base", "--frames", "3", "--width", "24", "--out", &gif];
    place.cairn_ok(&[&orbit[..], &to].concat());
    let mut reader = gif::DecodeOptions::new().read_info(std::fs::File::open(gif).unwrap()).unwrap();
    let mut read = 0;
    while let Some(frame) = reader.read_next_frame().unwrap() {
        assert_eq!((frame.width, frame.height), (24, 24));
        read += 1;
    }
    assert_eq!(read, 3);
}

#[test]
fn a_fisheye_s_capture_goes_the_whole_way_and_a_pose_file_sees_with_its_lens() {
    let place = Place::new();
    let config = LandmarkConfig {
        contributors: 2,
        photographs: 6,
        width: 32,
        height: 32,
        fisheye_deg: Some(170.0),
        ..LandmarkConfig::default()
    };
    let landmark = Landmark::generate(&config, 3).unwrap();
    std::fs::remove_dir_all(place.path("capture")).unwrap();
    landmark.write(&place.path("capture")).unwrap();
    let daemon = Daemon::start(&place.path("data"), "");
    let to = ["--connect", daemon.url.as_str()];
    let cairn = |arguments: &[&str]| place.cairn_ok(&[arguments, &to].concat());
    place.import("town", to);
    let poses = place.text("poses.png");
    assert!(cairn(&["scene", "show", "town", "--poses", &poses]).contains("12 cameras by contributor"));
    cairn(&["train", "town", "--by-contributor", "--quality", "smoke"]);

    // What the view's camera sees a file of the same camera sees, to the bit.
    let view = landmark.views.iter().find(|view| view.name == FIRST).unwrap();
    let (r, at) = (view.camera.pose.rotation.transpose(), view.camera.pose.position);
    let Distortion::Fisheye(lens) = view.camera.intrinsics.distortion else { panic!("no fisheye: {:?}", view.camera) };
    let row = |n: usize| [r.col(n).x, r.col(n).y, r.col(n).z, at[n]];
    let pose_file = |k: [f64; 4], times: usize| {
        let i = view.camera.intrinsics.resized(32 * times, 32 * times);
        let json = serde_json::json!({
            "width": i.width, "height": i.height, "fx": i.fx, "fy": i.fy, "cx": i.cx, "cy": i.cy,
            "camera_model": "OPENCV_FISHEYE", "k1": k[0], "k2": k[1], "k3": k[2], "k4": k[3],
            "camera_to_world": [row(0), row(1), row(2)],
        });
        std::fs::write(place.path("pose.json"), json.to_string()).unwrap();
        place.text("pose.json")
    };
    let pose = pose_file(lens.k(), 1);
    let out = ["of-view.png", "of-pose.png", "depth.png"].map(|file| place.text(file));
    cairn(&["render", "town", "--view", FIRST, "--out", &out[0], "--depth", &out[2]]);
    cairn(&["render", "town", "--pose", &pose, "--out", &out[1]]);
    let [of_view, of_pose] = [0, 1].map(|n| std::fs::read(&out[n]).unwrap());
    assert_eq!(of_view, of_pose);
    // The corners lie 120 degrees off the axis, where there is no depth along it.
    let depth = picture(Path::new(&out[2]));
    assert_eq!([depth.pixel(0, 0)[0], depth.pixel(31, 31)[0]], [0.0; 2]);
    assert!(depth.rgb().iter().any(|v| *v > 0.0), "nothing at all is in the picture");
    let other = pose_file([0.1, 0.0, 0.0, 0.0], 1);
    cairn(&["render", "town", "--pose", &other, "--out", &out[1]]);
    assert_ne!(of_view, std::fs::read(&out[1]).unwrap(), "another lens sees otherwise");
    let folds = pose_file([-1.0, 0.0, 0.0, 0.0], 1);
    let refused = place.cairn(&[&["render", "town", "--pose", &folds, "--out", &out[1]][..], &to].concat());
    assert!(String::from_utf8_lossy(&refused.stderr).contains("its polynomial turns back"), "{refused:?}");

    // Questions about it, and flights through it.
    let larger = pose_file(lens.k(), 3);
    cairn(&["render", "town", "--pose", &larger, "--out", &out[1]]);
    for how in [&["--pose", &larger][..], &["--view", FIRST], &["--register"], &[]] {
        cairn(&[&["identify", "town", &out[1]], how].concat());
    }
    assert!(cairn(&["who", "town", "--view", FIRST]).contains("ada"));
    let frames = ["between", "orbit"].map(|path| place.text(path));
    let between = ["render", "town", "--path", "between", "--from", FIRST, "--to", SECOND, "--frames", "3"];
    assert!(cairn(&[&between[..], &["--out", &frames[0]]].concat()).starts_with("3 frames of 32 x 32 px"));
    cairn(&["render", "town", "--path", "orbit", "--frames", "2", "--out", &frames[1]]);
}

#[tokio::test(flavor = "multi_thread")]
async fn paths_beyond_the_limits_or_the_cameras_are_refused() {
    let place = trained();
    let settings = "[limits]\nmax_path_frames = 50\nmax_pixels = 4096\nconcurrent_renders = 1";
    let daemon = Daemon::start(&place.path("data"), settings);
    let mut render = RenderServiceClient::connect(daemon.url.clone()).await.unwrap();
    let between =
        |from: &str, to: &str| Some(Way::Between(v1::BetweenPath { from_view: from.into(), to_view: to.into() }));
    let bad_arc = Some(Way::Orbit(v1::OrbitPath { arc_deg: f64::NAN }));
    for (request, code, says) in [
        (orbit(1), Code::InvalidArgument, "number of frames is 1"),
        (orbit(51), Code::InvalidArgument, "limits.max_path_frames"),
        (v1::RenderPathRequest { width: 65, height: 65, ..orbit(9) }, Code::InvalidArgument, "limits.max_pixels"),
        (v1::RenderPathRequest { width: u32::MAX, ..orbit(9) }, Code::InvalidArgument, "limits.max_side_px"),
        (v1::RenderPathRequest { path: None, ..orbit(9) }, Code::InvalidArgument, "the path"),
        (v1::RenderPathRequest { path: bad_arc, ..orbit(9) }, Code::InvalidArgument, "arc_deg"),
        (v1::RenderPathRequest { path: between(FIRST, "none"), ..orbit(9) }, Code::NotFound, "no view"),
        (v1::RenderPathRequest { field: v1::FieldKind::Marked.into(), ..orbit(9) }, Code::FailedPrecondition, "marks"),
        (v1::RenderPathRequest { scene: "tow".into(), ..orbit(9) }, Code::NotFound, "tow"),
    ] {
        let refused = render.render_path(request).await.unwrap_err();
        assert_eq!(refused.code(), code, "{refused}");
        assert!(refused.message().contains(says), "{refused} does not say {says}");
    }
    // A scene seen from one side has no orbit; it says so before it is trained.
    let (capture, to) = (place.text("capture"), ["--connect", daemon.url.as_str()]);
    let import = ["scene", "import", "wall", "--from", &capture, "--kind", "forward-facing"];
    let without_bounds = place.cairn(&[&import[..], &to].concat());
    assert!(String::from_utf8_lossy(&without_bounds.stderr).contains("--kind unbounded"), "{without_bounds:?}");
    write_bounds(Path::new(&capture));
    // Smaller photographs would be taken first; the import says so.
    std::fs::create_dir(Path::new(&capture).join("images_2")).unwrap();
    let imported = place.cairn(&[&import[..], &["--images", "images"], &to].concat());
    let said = String::from_utf8_lossy(&imported.stderr);
    assert!(imported.status.success() && said.contains("those in images; there is images_2, too"), "{said}");
    let wall = |frames| v1::RenderPathRequest { scene: "wall".into(), ..orbit(frames) };
    let spiral = Some(Way::Spiral(v1::SpiralPath {}));
    for (request, code, says) in [
        (wall(9), Code::FailedPrecondition, "--path spiral"),
        (wall(1), Code::InvalidArgument, "number of frames is 1"),
        (v1::RenderPathRequest { path: between(FIRST, "none"), ..wall(9) }, Code::NotFound, "no view"),
        (v1::RenderPathRequest { path: spiral, ..wall(9) }, Code::FailedPrecondition, "train it first"),
    ] {
        let refused = render.render_path(request).await.unwrap_err();
        assert_eq!(refused.code(), code, "{refused}");
        assert!(refused.message().contains(says), "{refused} does not say {says}");
    }

    // Who stops reading frees the only place for others.
    let mut stream = render.render_path(orbit(50)).await.unwrap().into_inner();
    let first = stream.message().await.unwrap().unwrap();
    assert_eq!((first.frame, first.frames, first.job_id.as_str()), (0, 50, "job-000001"));
    drop(stream);
    let viewpoint = Some(v1::Viewpoint { from: Some(v1::viewpoint::From::Camera(first.camera.unwrap())) });
    let field = v1::FieldKind::Base.into();
    let same = v1::RenderRequest { scene: "town".into(), viewpoint, field, ..Default::default() };
    let answer = tokio::time::timeout(Duration::from_secs(20), render.render(same)).await.unwrap().unwrap();
    assert_eq!(answer.into_inner().png, first.png, "a frame is what its camera sees");

    // A flight that its scene's next training overtakes ends, and does not change fields in the air.
    // A narrow line keeps the frames from all being sent ahead.
    let narrow = Endpoint::from_shared(daemon.url.clone()).unwrap().initial_stream_window_size(65_535);
    let mut render = RenderServiceClient::new(narrow.connect().await.unwrap());
    let large = v1::RenderPathRequest { width: 64, height: 64, ..orbit(50) };
    let mut stream = render.render_path(large).await.unwrap().into_inner();
    stream.message().await.unwrap().unwrap();
    let train = ["train", "town", "--by-contributor", "--base-only", "--seed", "2", "--quality", "smoke"];
    place.cairn_ok(&[&train[..], &to].concat());
    let overtaken = loop {
        match stream.message().await {
            Ok(frame) => assert_eq!(frame.expect("an error before the end").job_id, "job-000001"),
            Err(overtaken) => break overtaken,
        }
    };
    assert_eq!(overtaken.code(), Code::FailedPrecondition);
    assert!(overtaken.message().contains("begin again"), "{overtaken}");
}

#[cfg(unix)]
#[test]
fn an_interrupt_keeps_whole_frames_and_nothing_else() {
    let place = trained();
    let data = place.text("data");
    let frames = place.path("long");
    let path = ["render", "town", "--path", "orbit", "--base", "--frames", "2000", "--width", "200", "--data", &data];
    let child = cairn_testkit::daemon::command()
        .args(path)
        .args(["--out", frames.to_str().unwrap()])
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let begun = Instant::now();
    while !frames.join("frame-00001.png").exists() {
        assert!(begun.elapsed() < Duration::from_secs(60), "no second frame in a minute");
        std::thread::sleep(Duration::from_millis(20));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let ended = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&ended.stderr).into_owned();
    assert_eq!(ended.status.code(), Some(130), "{said}");
    assert!(said.contains("cancelled after") && said.contains("of 2000 frames"), "{said}");
    for entry in std::fs::read_dir(&frames).unwrap() {
        assert_eq!(picture(&entry.unwrap().path()).width(), 200);
    }
}

#[test]
fn cameras_are_drawn_by_contributor_and_by_cluster() {
    let place = Place::new();
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    let (png, svg) = (place.text("poses.png"), place.text("poses.svg"));
    let poses = ["scene", "show", "town", "--data", &data, "--poses"];
    let said = place.cairn_ok(&[&poses[..], &[&png]].concat());
    assert!(said.contains("\n12 cameras by contributor in "), "{said}");
    let said = place.cairn_ok(&[&poses[..], &[&svg, "--anchors", "2", "--neighbours", "4"]].concat());
    assert!(said.contains("in 2 clusters"), "{said}");
    let (drawn, svg) = (picture(Path::new(&png)), std::fs::read_to_string(svg).unwrap());
    assert!(drawn.width() > 1000 && svg.contains("\nada\n</text>") && svg.contains("ringed: anchor"));
    let refused = place.cairn(&[&poses[..], &["poses.bmp"]].concat());
    assert!(String::from_utf8_lossy(&refused.stderr).contains(".png or .svg"));
    let refused = place.cairn(&[&poses[..], &[&png, "--anchors", "9", "--neighbours", "9"]].concat());
    assert!(String::from_utf8_lossy(&refused.stderr).contains("need 81 views"), "{refused:?}");
}
