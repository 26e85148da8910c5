//! Which camera file is read where there are several, what kind of scene is
//! guessed, and whose split counts.

use std::fs;
use std::path::Path;

use crate::common::{Colmap, npy, photograph, read, refuses};
use cairn_scene::{Capture, ReadOptions, SceneFolder, SceneKind};
use image::{ImageFormat, Rgba, RgbaImage};
use serde_json::{Value, json};

/// LLFF rows of three cameras at the origin, each turned about its vertical axis.
fn write_llff(folder: &Path, turns_deg: [f64; 3]) {
    let mut data: Vec<u8> = Vec::new();
    for turn in turns_deg.map(f64::to_radians) {
        // Right, down and forward of a camera turned about the world's y (down).
        let (right, down, forward) = ([turn.cos(), 0.0, -turn.sin()], [0.0, 1.0, 0.0], [turn.sin(), 0.0, turn.cos()]);
        for (axis, size) in [48.0, 64.0, 55.0].into_iter().enumerate() {
            let row = [down[axis], right[axis], -forward[axis], 0.0, size];
            data.extend(row.iter().flat_map(|v| v.to_le_bytes()));
        }
        data.extend([1.0f64, 9.0].iter().flat_map(|v| v.to_le_bytes()));
    }
    fs::write(folder.join("poses_bounds.npy"), npy("<f8", "(3, 17)", &data)).unwrap();
}

#[test]
fn llff_wins_only_where_it_faces_one_way() {
    let folder = Colmap::small().folder();
    write_llff(folder.path(), [-20.0, 0.0, 20.0]);
    let forward = read(folder.path()).unwrap();
    assert_eq!((forward.kind, forward.views[0].bounds), (SceneKind::ForwardFacing, Some((1.0, 9.0))));
    write_llff(folder.path(), [-120.0, 0.0, 120.0]);
    let around = read(folder.path()).unwrap();
    assert_eq!((around.kind, around.views[0].bounds), (SceneKind::Unbounded, None));
    assert_eq!(around.points.len(), 2, "the COLMAP model's");
    fs::remove_dir_all(folder.path().join("sparse")).unwrap();
    let around = read(folder.path()).unwrap();
    assert_eq!((around.kind, around.views[0].bounds), (SceneKind::Unbounded, Some((1.0, 9.0))));
}

#[test]
fn the_usual_folders_are_tried_in_order() {
    let folder = Colmap::small().folder();
    let small = folder.path().join("images_4");
    fs::create_dir(&small).unwrap();
    for i in 1..4 {
        fs::write(small.join(format!("{i}.png")), photograph()).unwrap();
    }
    let first = |folder: &Path| read(folder).unwrap().views[0].photograph.clone();
    assert_eq!(first(folder.path()), Path::new("images/1.png"));
    write_llff(folder.path(), [0.0; 3]);
    assert_eq!(first(folder.path()), Path::new("images_4/1.png"), "LLFF takes the smallest");
    fs::remove_file(folder.path().join("poses_bounds.npy")).unwrap();
    fs::remove_dir_all(folder.path().join("images")).unwrap();
    assert_eq!(first(folder.path()), Path::new("images_4/1.png"));
    // A model whose photographs lie right beside it.
    let flat = tempfile::tempdir().unwrap();
    let model = Colmap::small();
    fs::write(flat.path().join("cameras.bin"), model.cameras_bin()).unwrap();
    fs::write(flat.path().join("images.bin"), model.images_bin()).unwrap();
    for i in 1..4 {
        fs::write(flat.path().join(format!("{i}.png")), photograph()).unwrap();
    }
    assert_eq!(first(flat.path()), Path::new("1.png"));
    assert!(read(flat.path()).unwrap().points.is_empty(), "a model without points is one too");
}

fn transforms(folder: &Path, transparent: [bool; 2], change: impl FnOnce(&mut Value)) -> Capture {
    transforms_of(folder, transparent.map(|t| if t { GLASS } else { RGB }), change)
}

/// An alpha of 0 everywhere, of 255 everywhere, and a photograph without alpha.
const GLASS: Option<u8> = Some(0);
const FULL: Option<u8> = Some(255);
const RGB: Option<u8> = None;

/// Two frames whose photographs have these alphas.
fn transforms_of(folder: &Path, alphas: [Option<u8>; 2], change: impl FnOnce(&mut Value)) -> Capture {
    let matrix = json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]);
    let frame = |name: &str| json!({"file_path": name, "transform_matrix": matrix});
    let mut document = json!({"camera_angle_x": 0.7, "frames": [frame("a.png"), frame("./b.png")]});
    change(&mut document);
    fs::write(folder.join("transforms.json"), document.to_string()).unwrap();
    for (name, alpha) in ["a.png", "b.png"].into_iter().zip(alphas) {
        match alpha {
            Some(alpha) => RgbaImage::from_pixel(64, 48, Rgba([0, 0, 0, alpha]))
                .save_with_format(folder.join(name), ImageFormat::Png)
                .unwrap(),
            None => fs::write(folder.join(name), photograph()).unwrap(),
        }
    }
    read(folder).unwrap()
}

#[test]
fn the_kind_of_scene_is_guessed_and_can_be_said() {
    let folder = tempfile::tempdir().unwrap();
    let guess = |transparent, aabb: f64| {
        let capture = transforms(folder.path(), transparent, |d| d["aabb_scale"] = json!(aabb));
        (capture.kind, capture.background)
    };
    assert_eq!(guess([true, true], 1.0), (SceneKind::Bounded, Some([1.0; 3])));
    assert_eq!(guess([true, true], 16.0), (SceneKind::Unbounded, Some([1.0; 3])));
    assert_eq!(guess([true, false], 1.0), (SceneKind::Unbounded, None));
    assert_eq!(guess([false, false], 1.0), (SceneKind::Unbounded, None));
    let said = ReadOptions { kind: Some(SceneKind::Bounded), ..Default::default() };
    assert_eq!(Capture::read(folder.path(), &said).unwrap().kind, SceneKind::Bounded);
    assert_eq!(serde_json::to_value(SceneKind::ForwardFacing).unwrap(), "forward_facing");
}

/// A COLMAP model of photographs that were all taken from one side is forward-facing where its points say that it is
/// deep; a landmark seen from one side, whose photographers stand nearer and farther, is not.
#[test]
fn a_colmap_model_that_looks_one_way_into_a_deep_scene_is_forward_facing() {
    let kind = |turn_deg: f64, step_back: f64, depths: [f64; 2], count: usize| {
        let mut model = Colmap::small();
        for (image, side) in model.images.iter_mut().zip([-1.0, 0.0, 1.0]) {
            let half = (side * turn_deg / 2.0).to_radians();
            image.quaternion = [half.cos(), 0.0, half.sin(), 0.0];
            // World to camera: the camera stands near `side` x and `-step_back` z.
            let turned = glam::DQuat::from_rotation_y(2.0 * half) * glam::DVec3::new(side, 0.0, -step_back * side);
            image.translation = (-turned).to_array();
        }
        let share = |i: usize| i as f64 / count as f64;
        model.points = (0..count).map(|i| [share(i * 7 % count), 0.1, depths[0] + depths[1] * share(i)]).collect();
        read(model.folder().path()).unwrap().kind
    };
    assert_eq!(kind(10.0, 0.5, [8.0, 30.0], 200), SceneKind::ForwardFacing);
    assert_eq!(kind(40.0, 0.5, [8.0, 30.0], 200), SceneKind::Unbounded, "cameras that look apart");
    assert_eq!(kind(10.0, 3.0, [8.0, 30.0], 200), SceneKind::Unbounded, "cameras nearer and farther");
    assert_eq!(kind(10.0, 0.5, [8.0, 4.0], 200), SceneKind::Unbounded, "all at about one depth");
    assert_eq!(kind(10.0, 0.5, [-1.0, 30.0], 200), SceneKind::Unbounded, "points behind the cameras");
    assert_eq!(kind(10.0, 0.5, [8.0, 30.0], 50), SceneKind::Unbounded, "too few points to tell");
}

#[test]
fn forward_facing_is_refused_where_nothing_says_where_the_scene_begins() {
    let folder = Colmap::small().folder();
    let said = ReadOptions { kind: Some(SceneKind::ForwardFacing), ..Default::default() };
    let mut capture = Capture::read(folder.path(), &said).unwrap();
    assert_eq!(capture.kind, SceneKind::ForwardFacing, "it has points");
    let scenes = folder.path().join("scenes");
    SceneFolder::create(&scenes, "wall", &capture).unwrap();
    // Whoever sends a scene past the reader is held to it as well.
    capture.points = vec![glam::DVec3::new(0.0, 0.0, -100.0)];
    refuses(SceneFolder::create(&scenes, "again", &capture), &["again, forward-facing", "depth bounds"]);
    fs::remove_file(folder.path().join("sparse/0/points3D.bin")).unwrap();
    refuses(Capture::read(folder.path(), &said), &["images.bin, forward-facing", "depth bounds", "--kind unbounded"]);
}

/// Many programs save photographs with an alpha channel that is full everywhere: that is no object before white.
#[test]
fn an_alpha_channel_that_is_full_is_not_transparent() {
    let folder = tempfile::tempdir().unwrap();
    let guess = |alphas| {
        let capture = transforms_of(folder.path(), alphas, |_| {});
        (capture.kind, capture.background)
    };
    let (object, open) = ((SceneKind::Bounded, Some([1.0; 3])), (SceneKind::Unbounded, None));
    assert_eq!(guess([GLASS, Some(254)]), object);
    for alphas in [[FULL, FULL], [FULL, GLASS], [FULL, RGB], [RGB, GLASS]] {
        assert_eq!(guess(alphas), open, "{alphas:?}");
    }
    // Said to be an object, one cut-out is enough to say before what.
    let said = ReadOptions { kind: Some(SceneKind::Bounded), ..Default::default() };
    assert_eq!(Capture::read(folder.path(), &said).unwrap().background, Some([1.0; 3]));
    // Of COLMAP's photographs one that is transparent says nothing of the others.
    let folder = Colmap::small().folder();
    let glass = RgbaImage::from_pixel(64, 48, Rgba([0; 4]));
    glass.save_with_format(folder.path().join("images/2.png"), ImageFormat::Png).unwrap();
    let capture = read(folder.path()).unwrap();
    assert_eq!((capture.kind, capture.background), open);
}

#[test]
fn a_capture_that_brings_its_own_split_keeps_it() {
    let folder = tempfile::tempdir().unwrap();
    let held = |change: fn(&mut Value)| {
        let by_default = transforms(folder.path(), [false; 2], change);
        assert_eq!(by_default.training().collect::<Vec<_>>(), [0, 1], "unless it is asked for, no view is held out");
        let options = ReadOptions { hold_out: Some(8), ..ReadOptions::default() };
        Capture::read(folder.path(), &options).unwrap().held_out().collect::<Vec<_>>()
    };
    assert_eq!(held(|_| {}), [0]);
    assert_eq!(held(|d| d["test_filenames"] = json!(["./b.png"])), [1]);
    // One that names no view of the capture is no split.
    assert_eq!(held(|d| d["test_filenames"] = json!([])), [0]);
    assert_eq!(held(|d| d["test_filenames"] = json!(["c.png"])), [0]);
}
