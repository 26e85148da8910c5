//! Scenes on disk: whole or not there, and what comes back is what went in.

use std::fs;
use std::path::Path;

use crate::common::{Colmap, photograph, read, refuses};
use cairn_scene::{Capture, CaptureError, Fisheye, ReadOptions, SceneFolder};
use sha2::{Digest, Sha256};

/// Names in `dir`, hidden ones too, sorted.
fn listing(dir: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(dir).unwrap().map(|item| item.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

fn capture_with_contributors(folder: &Path) -> Capture {
    let table = folder.join("who.csv");
    fs::write(&table, format!("image,contributor,key\n1.png,ana,{}\n2.png,ben,\n3.png,ana,\n", "0b".repeat(32)))
        .unwrap();
    Capture::read(folder, &ReadOptions { contributors: Some(table), hold_out: Some(8), ..Default::default() }).unwrap()
}

#[test]
fn what_comes_back_is_what_went_in_to_the_bit() {
    let mut model = Colmap::small();
    // Numbers whose decimal form is hard to read back exactly.
    model.images[0].quaternion = [0.1f64.cos(), 0.1f64.sin() * 0.6, 0.0, 0.1f64.sin() * 0.8];
    model.images[1].translation = [1.0 / 3.0, 2.0f64.sqrt() * 1e-7, -1e17 / 7.0];
    model.points[0] = [f64::MIN_POSITIVE, 1.0 + f64::EPSILON, -0.1];
    let (source, dir) = (model.folder(), tempfile::tempdir().unwrap());
    let capture = capture_with_contributors(source.path());
    let created = SceneFolder::create(dir.path(), "square", &capture).unwrap();
    drop(source);
    let opened = SceneFolder::open(dir.path(), "square").unwrap();
    assert_eq!(opened.capture(), created.capture());
    assert_eq!(opened.capture().points, capture.points);
    assert_eq!((opened.capture().kind, opened.capture().background), (capture.kind, capture.background));
    for (stored, view) in opened.capture().views.iter().zip(&capture.views) {
        assert_eq!(stored.camera, view.camera);
        assert_eq!(
            (&stored.name, &stored.contributor, stored.contributor_key, stored.held_out),
            (&view.name, &view.contributor, view.contributor_key, view.held_out)
        );
    }
    let digest: [u8; 32] = Sha256::digest(photograph()).into();
    assert_eq!(opened.photograph_digest(2), digest);
    assert_eq!(opened.photograph(2).unwrap(), opened.capture().photograph(2).unwrap());
    assert_eq!(listing(dir.path()), ["square"]);
    assert_eq!(listing(&dir.path().join("square")), ["manifest.json", "photographs", "points.bin", "scene.json"]);
}

#[test]
fn a_contributor_has_one_key_in_all_views_or_none() {
    let (source, dir) = (Colmap::small().folder(), tempfile::tempdir().unwrap());
    SceneFolder::create(dir.path(), "square", &capture_with_contributors(source.path())).unwrap();
    let path = dir.path().join("square/scene.json");
    let good: serde_json::Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    assert_eq!(good["views"][2]["contributor_key"], "0b".repeat(32));
    let with = |key: serde_json::Value| {
        let mut bad = good.clone();
        bad["views"][2]["contributor_key"] = key;
        fs::write(&path, bad.to_string()).unwrap();
        SceneFolder::open(dir.path(), "square")
    };
    refuses(with("0c".repeat(32).into()), &["view 2 (3.png)", "one key for each contributor", "\"ana\""]);
    refuses(with(serde_json::Value::Null), &["view 2 (3.png)", "one key for each contributor"]);
    refuses(with("0B".repeat(32).into()), &["view 2 (3.png)", "64 lower-case hexadecimal digits"]);
}

#[test]
fn a_fisheye_is_stored_by_its_coefficients_and_checked_when_it_is_read() {
    let mut model = Colmap::small();
    let k = [0.05, -1.0 / 300.0, 0.003, -0.0005];
    model.cameras[0] = (1, 5, "OPENCV_FISHEYE", [64, 48], [&[24.0, 25.0, 31.0, 25.0], &k[..]].concat());
    let (source, dir) = (model.folder(), tempfile::tempdir().unwrap());
    let capture = read(source.path()).unwrap();
    SceneFolder::create(dir.path(), "square", &capture).unwrap();
    let opened = SceneFolder::open(dir.path(), "square").unwrap();
    for (stored, view) in opened.capture().views.iter().zip(&capture.views) {
        assert_eq!(stored.camera, view.camera);
        assert_eq!(stored.camera.intrinsics.distortion, Fisheye::new(k).into());
    }
    let path = dir.path().join("square/scene.json");
    let good: serde_json::Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    let with = |pointer: &str, value: serde_json::Value| {
        let mut bad = good.clone();
        *bad.pointer_mut(pointer).unwrap() = value;
        fs::write(&path, bad.to_string()).unwrap();
        SceneFolder::open(dir.path(), "square")
    };
    let lens = "/views/1/camera/intrinsics/distortion";
    refuses(with(&format!("{lens}/fisheye/k1"), (-2).into()), &["scene.json", "view 1 (2.png)", "turns back"]);
    refuses(with(lens, serde_json::json!({"mirror": {}})), &["scene.json", "mirror"]);
    refuses(with(lens, serde_json::json!({"fisheye": {"k1": 0.1}})), &["scene.json", "k2"]);
}

#[test]
fn a_broken_photograph_leaves_nothing() {
    let (source, dir) = (Colmap::small().folder(), tempfile::tempdir().unwrap());
    let capture = read(source.path()).unwrap();
    // The last one, so that the others were already copied.
    let whole = photograph();
    fs::write(source.path().join("images/3.png"), &whole[..whole.len() - 30]).unwrap();
    refuses(SceneFolder::create(dir.path(), "square", &capture), &["3.png", "cannot be decoded"]);
    fs::remove_file(source.path().join("images/3.png")).unwrap();
    refuses(SceneFolder::create(dir.path(), "square", &capture), &["cannot open", "3.png"]);
    assert_eq!(listing(dir.path()), Vec::<String>::new());
}

#[test]
fn an_existing_scene_is_left_as_it_was() {
    let (source, dir) = (Colmap::small().folder(), tempfile::tempdir().unwrap());
    let capture = read(source.path()).unwrap();
    SceneFolder::create(dir.path(), "square", &capture).unwrap();
    let before = fs::read(dir.path().join("square/scene.json")).unwrap();
    let other = capture_with_contributors(source.path());
    let again = SceneFolder::create(dir.path(), "square", &other);
    assert!(matches!(again, Err(CaptureError::SceneExists { .. })));
    refuses(again, &["square already exists", "left as it was"]);
    assert_eq!(fs::read(dir.path().join("square/scene.json")).unwrap(), before);
    // Leftovers of an import that was cut off are in nobody's way.
    let leftover = format!(".staging-plaza-{}-0", std::process::id());
    fs::create_dir(dir.path().join(&leftover)).unwrap();
    SceneFolder::create(dir.path(), "plaza", &other).unwrap();
    assert_eq!(listing(dir.path()), [leftover.as_str(), "plaza", "square"]);
}

#[test]
fn names_are_checked() {
    let (source, dir) = (Colmap::small().folder(), tempfile::tempdir().unwrap());
    let capture = read(source.path()).unwrap();
    for name in ["", ".", "..", "a/b", "../x", ".hidden", "-x", "a b", "ümlaut", &"x".repeat(65)] {
        refuses(SceneFolder::create(dir.path(), name, &capture), &["scene name", "1 to 64 letters"]);
        refuses(SceneFolder::open(dir.path(), name), &["scene name"]);
    }
    refuses(SceneFolder::open(dir.path(), "absent"), &["cannot open", "absent"]);
}

#[test]
fn altered_files_are_found() {
    let (source, dir) = (Colmap::small().folder(), tempfile::tempdir().unwrap());
    let scene = SceneFolder::create(dir.path(), "square", &read(source.path()).unwrap()).unwrap();
    let photographs = dir.path().join("square/photographs");
    let other = cairn_scene::encode_png(&cairn_scene::Picture::constant(64, 48, [0.9; 3]));
    fs::write(photographs.join("000001.png"), &other).unwrap();
    fs::remove_file(photographs.join("000002.png")).unwrap();
    let digest: String = Sha256::digest(&other).iter().map(|b| format!("{b:02x}")).collect();
    refuses(scene.photograph(1), &["000001.png", "was altered", &digest]);
    refuses(scene.photograph(2), &["000002.png"]);
    assert!(scene.photograph(0).is_ok());

    let points = dir.path().join("square/points.bin");
    let mut bytes = fs::read(&points).unwrap();
    bytes[5] ^= 1;
    fs::write(&points, bytes).unwrap();
    refuses(SceneFolder::open(dir.path(), "square"), &["points.bin", "was altered"]);
}

#[test]
fn a_table_that_cannot_be_is_refused_by_name() {
    let (source, dir) = (Colmap::small().folder(), tempfile::tempdir().unwrap());
    SceneFolder::create(dir.path(), "square", &read(source.path()).unwrap()).unwrap();
    let path = dir.path().join("square/scene.json");
    let good: serde_json::Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    let with = |pointer: &str, value: serde_json::Value| {
        let mut bad = good.clone();
        *bad.pointer_mut(pointer).unwrap() = value;
        fs::write(&path, bad.to_string()).unwrap();
        SceneFolder::open(dir.path(), "square")
    };
    let future = with("/version", 5.into());
    assert!(matches!(future, Err(CaptureError::UnknownVersion { got: 5, expected: 4, .. })));
    refuses(future, &["scene.json", "version is 5", "reads version 4"]);
    refuses(with("/format", "other".into()), &["scene.json", "cairn-scene", "other"]);
    refuses(with("/views/1/photograph", "../../x.png".into()), &["view 1 (2.png)", "file name", "../../x.png"]);
    refuses(with("/views/1/photograph", "000000.png".into()), &["view 1 (2.png)", "each once"]);
    refuses(with("/views/1/name", "1.png".into()), &["view 1 (1.png)", "sorted by name"]);
    refuses(with("/views/1/sha256", "00".into()), &["view 2.png", "64 lower-case hexadecimal"]);
    refuses(with("/views/1/sha256", "é".repeat(32).into()), &["view 2.png", "64 lower-case hexadecimal"]);
    refuses(with("/views/1/camera/intrinsics/fx", 0.0.into()), &["view 1 (2.png)", "focal length"]);
    refuses(with("/views/1/camera/pose/rotation/0", 9.0.into()), &["view 1 (2.png)", "rotation is not one"]);
    refuses(with("/views", serde_json::json!([])), &["scene.json", "at least one view"]);
    refuses(with("/points/count", 99.into()), &["points.bin", "99 points"]);
    refuses(with("/kind", "round".into()), &["scene.json", "round"]);
    fs::write(&path, &good.to_string()[..100]).unwrap();
    refuses(SceneFolder::open(dir.path(), "square"), &["scene.json", "the JSON"]);
}
