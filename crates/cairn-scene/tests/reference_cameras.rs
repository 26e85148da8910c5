//! Every format and camera model against projections that independent scripts
//! computed (reference/cameras.py, lens.py, fisheye.py): a wrong axis, sign or order shows here.

use std::fs;
use std::path::Path;

use crate::common::{Colmap, Image, npy, photograph, read};
use cairn_scene::{Camera, Capture, ReadOptions, View};
use glam::DVec3;
use serde::Deserialize;
use serde_json::json;

#[derive(Deserialize)]
struct Document {
    width: usize,
    height: usize,
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    model: String,
    params: Vec<f64>,
    quaternion_wxyz: [f64; 4],
    translation: [f64; 3],
    opengl_camera_to_world: Vec<Vec<f64>>,
    llff_row: Vec<f64>,
    world: Vec<[f64; 3]>,
    pixels: Vec<[f64; 2]>,
    pixels_simple_centred: Vec<[f64; 2]>,
}

/// A lens that only transforms.json can state, and where it shows each case's points.
#[derive(Deserialize)]
struct Lens {
    lens: serde_json::Value,
    pixels: Vec<Vec<[f64; 2]>>,
}

/// Two fisheyes, and where they show points of each case's pose.
#[derive(Deserialize)]
struct Fisheyes {
    opencv: Vec<f64>,
    simple: Vec<f64>,
    /// So many points lie ahead; the others beside the camera and behind it.
    ahead: usize,
    cases: Vec<FisheyeCase>,
}

#[derive(Deserialize)]
struct FisheyeCase {
    world: Vec<[f64; 3]>,
    opencv: Vec<[f64; 2]>,
    simple: Vec<[f64; 2]>,
}

fn fisheyes() -> Fisheyes {
    serde_json::from_str(include_str!("reference/fisheye.json")).unwrap()
}

fn reference() -> Document {
    serde_json::from_str(include_str!("reference/cameras.json")).unwrap()
}

/// Projects every reference point and shoots a ray back through where it landed.
fn compare(capture: &Capture, view: usize, case: &Case, pixels: &[[f64; 2]]) {
    agrees(&capture.views[view].camera, &case.model, &case.world, pixels);
}

fn agrees(camera: &Camera, model: &str, points: &[[f64; 3]], pixels: &[[f64; 2]]) {
    for (&world, expected) in points.iter().zip(pixels) {
        let world = DVec3::from_array(world);
        let at = camera.project(world).unwrap();
        let error = (at.x - expected[0]).abs().max((at.y - expected[1]).abs());
        assert!(error < 1e-9, "{model}: {at} against {expected:?}");
        let (origin, direction) = camera.ray(expected[0], expected[1]);
        let miss = (world - origin).cross(direction).length();
        assert!(miss < 1e-8, "{model}: the ray misses its point by {miss}");
        assert!((world - origin).dot(direction) > 0.0, "{model}: the ray leads away from its point");
    }
}

fn as_colmap(document: &Document) -> Colmap {
    let numbers = ["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"];
    let size = [document.width as u64, document.height as u64];
    let mut model = Colmap { cameras: Vec::new(), images: Vec::new(), points: Vec::new(), tracks: 3 };
    for (i, case) in document.cases.iter().enumerate() {
        let number = numbers.iter().position(|n| *n == case.model).unwrap();
        model.cameras.push((i as u32 + 40, number as i32, numbers[number], size, case.params.clone()));
        model.images.push(Image {
            id: i as u32 + 7,
            quaternion: case.quaternion_wxyz,
            translation: case.translation,
            camera: i as u32 + 40,
            name: format!("{i} of {}.png", case.model),
        });
        model.points.extend(&case.world);
    }
    model
}

#[test]
fn colmap_binary_and_text_agree_with_the_reference_and_each_other() {
    let document = reference();
    let model = as_colmap(&document);
    let (binary, text) = (model.folder(), tempfile::tempdir().unwrap());
    model.write_text(text.path());
    model.write_photographs(text.path());
    let (binary, text) = (read(binary.path()).unwrap(), read(text.path()).unwrap());
    for (i, case) in document.cases.iter().enumerate() {
        compare(&binary, i, case, &case.pixels);
    }
    assert_eq!(binary.views, text.views);
    assert_eq!(binary.points, text.points);
    assert_eq!(binary.points.len(), 40);
    let supported = |view: &View| view.support.is_some_and(|s| s.points > 0 && s.reprojection_error_px > 0.0);
    assert_eq!(binary.views.iter().filter(|view| supported(view)).count(), 2, "every other view observes points");
}

#[test]
fn transforms_agree_with_the_reference() {
    let document = reference();
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("images")).unwrap();
    let mut frames = Vec::new();
    for (i, case) in document.cases.iter().enumerate() {
        fs::write(folder.path().join(format!("images/{i}.png")), photograph()).unwrap();
        // The last one's intrinsics stand for all; every other frame overrides them.
        let p = &case.params;
        let mut frame =
            json!({ "file_path": format!("./images/{i}"), "transform_matrix": case.opengl_camera_to_world });
        let own = match case.model.as_str() {
            "OPENCV" => json!({}),
            "PINHOLE" => {
                json!({"fl_x": p[0], "fl_y": p[1], "cx": p[2], "cy": p[3], "k1": 0, "k2": 0, "p1": 0, "p2": 0})
            }
            _ => {
                let k = |i: usize| p.get(i).copied().unwrap_or(0.0);
                json!({"fl_x": p[0], "cx": p[1], "cy": p[2], "k1": k(3), "k2": k(4), "p1": 0, "p2": 0})
            }
        };
        frame.as_object_mut().unwrap().extend(own.as_object().unwrap().clone());
        frames.push(frame);
    }
    let p = &document.cases[4].params;
    let all = json!({
        "camera_model": "OPENCV", "w": 64, "h": 48, "fl_x": p[0], "fl_y": p[1], "cx": p[2], "cy": p[3],
        "k1": p[4], "k2": p[5], "p1": p[6], "p2": p[7], "aabb_scale": 16, "frames": frames,
    });
    fs::write(folder.path().join("transforms.json"), all.to_string()).unwrap();
    let capture = read(folder.path()).unwrap();
    for (i, case) in document.cases.iter().enumerate() {
        assert_eq!(capture.views[i].name, format!("images/{i}.png"));
        compare(&capture, i, case, &case.pixels);
    }
}

#[test]
fn a_lens_of_sixth_order_agrees_with_the_reference_and_a_frame_may_overrule_it() {
    let document = reference();
    let Lens { lens, pixels } = serde_json::from_str(include_str!("reference/lens.json")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mut frames = Vec::new();
    for (i, case) in document.cases.iter().enumerate() {
        fs::write(folder.path().join(format!("{i}.png")), photograph()).unwrap();
        frames.push(json!({ "file_path": format!("{i}"), "transform_matrix": case.opengl_camera_to_world }));
    }
    let opencv = document.cases.iter().position(|case| case.model == "OPENCV").unwrap();
    let mut read_with = |k3: Option<f64>| {
        if let Some(k3) = k3 {
            frames[opencv]["k3"] = json!(k3);
        }
        let mut all = lens.clone();
        all.as_object_mut().unwrap().extend([("w".to_owned(), json!(64)), ("h".to_owned(), json!(48))]);
        all["frames"] = json!(frames);
        fs::write(folder.path().join("transforms.json"), all.to_string()).unwrap();
        read(folder.path()).unwrap()
    };
    let capture = read_with(None);
    for (i, case) in document.cases.iter().enumerate() {
        compare(&capture, i, case, &pixels[i]);
    }
    // Without its sixth order the lens is the one that cameras.py has.
    let case = &document.cases[opencv];
    compare(&read_with(Some(0.0)), opencv, case, &case.pixels);
    let apart = |(a, b): (&[f64; 2], &[f64; 2])| (a[0] - b[0]).hypot(a[1] - b[1]);
    let most = pixels[opencv].iter().zip(&case.pixels).map(apart).fold(0.0, f64::max);
    assert!(most > 0.1, "the sixth order moves points by {most} px only");
}

#[test]
fn fisheyes_of_colmap_agree_with_the_reference_in_both_kinds_of_file() {
    let (document, fisheyes) = (reference(), fisheyes());
    let mut model = as_colmap(&document);
    let kinds = [(5, "OPENCV_FISHEYE", &fisheyes.opencv), (8, "SIMPLE_RADIAL_FISHEYE", &fisheyes.simple)];
    for (i, camera) in model.cameras.iter_mut().enumerate() {
        let (number, name, parameters) = kinds[i % 2];
        (camera.1, camera.2, camera.4) = (number, name, parameters.clone());
    }
    let (binary, text) = (model.folder(), tempfile::tempdir().unwrap());
    model.write_text(text.path());
    model.write_photographs(text.path());
    let (binary, text) = (read(binary.path()).unwrap(), read(text.path()).unwrap());
    assert_eq!(binary.views, text.views);
    for (i, case) in fisheyes.cases.iter().enumerate() {
        let pixels = if i % 2 == 0 { &case.opencv } else { &case.simple };
        agrees(&binary.views[i].camera, kinds[i % 2].1, &case.world, pixels);
    }
    assert!(fisheyes.cases.iter().all(|case| case.world.len() > fisheyes.ahead), "some lie beside the camera");
}

#[test]
fn fisheyes_of_transforms_agree_with_the_reference_in_nerfstudio_s_words_and_instant_ngp_s() {
    let (document, fisheyes) = (reference(), fisheyes());
    let folder = tempfile::tempdir().unwrap();
    let mut frames = Vec::new();
    for (i, case) in document.cases.iter().enumerate() {
        fs::write(folder.path().join(format!("{i}.png")), photograph()).unwrap();
        frames.push(json!({ "file_path": format!("{i}"), "transform_matrix": case.opengl_camera_to_world }));
    }
    // One frame has a lens of its own.
    let p = &fisheyes.simple;
    let own = json!({"fl_x": p[0], "fl_y": p[0], "cx": p[1], "cy": p[2], "k1": p[3], "k2": 0, "k3": 0, "k4": 0});
    frames[3].as_object_mut().unwrap().extend(own.as_object().unwrap().clone());
    let p = &fisheyes.opencv;
    for words in [json!({"camera_model": "OPENCV_FISHEYE"}), json!({"is_fisheye": true, "camera_angle_x": 4.0})] {
        let mut all = json!({
            "w": 64, "h": 48, "fl_x": p[0], "fl_y": p[1], "cx": p[2], "cy": p[3],
            "k1": p[4], "k2": p[5], "k3": p[6], "k4": p[7], "p1": 0.0, "p2": 0.0, "frames": frames,
        });
        all.as_object_mut().unwrap().extend(words.as_object().unwrap().clone());
        fs::write(folder.path().join("transforms.json"), all.to_string()).unwrap();
        let capture = read(folder.path()).unwrap();
        for (i, case) in fisheyes.cases.iter().enumerate() {
            let pixels = if i == 3 { &case.simple } else { &case.opencv };
            agrees(&capture.views[i].camera, &words.to_string(), &case.world, pixels);
        }
    }
    // A pinhole of the same numbers sees something else.
    let all = json!({"fl_x": p[0], "fl_y": p[1], "cx": p[2], "cy": p[3], "k1": p[4], "frames": frames[..2]});
    fs::write(folder.path().join("transforms.json"), all.to_string()).unwrap();
    let pinhole = read(folder.path()).unwrap().views[0].camera;
    let case = &fisheyes.cases[0];
    let apart = |n: usize| {
        let at = pinhole.project(DVec3::from_array(case.world[n])).unwrap();
        (at.x - case.opencv[n][0]).hypot(at.y - case.opencv[n][1])
    };
    assert!((3..fisheyes.ahead).all(|n| apart(n) > 1.0), "{:?}", (0..fisheyes.ahead).map(apart).collect::<Vec<_>>());
}

#[test]
fn camera_angle_is_the_focal_length_in_disguise() {
    let document = reference();
    let folder = tempfile::tempdir().unwrap();
    let mut frames = Vec::new();
    for (i, case) in document.cases.iter().enumerate() {
        fs::write(folder.path().join(format!("r_{i}.png")), photograph()).unwrap();
        frames.push(json!({ "file_path": format!("r_{i}"), "transform_matrix": case.opengl_camera_to_world }));
    }
    let angle = 2.0 * (32.0f64 / 55.0).atan();
    let write = |name: &str, frames: &[serde_json::Value]| {
        fs::write(folder.path().join(name), json!({"camera_angle_x": angle, "frames": frames}).to_string()).unwrap();
    };
    write("transforms_train.json", &frames[..3]);
    write("transforms_val.json", &frames[3..]);
    let capture = read(folder.path()).unwrap();
    for (i, case) in document.cases.iter().enumerate() {
        compare(&capture, i, case, &case.pixels_simple_centred);
    }
    // Without a test split the validation split is the one to measure on; with one it is ignored.
    assert_eq!(capture.held_out().count(), 0, "no view is held out unless that is asked for");
    let options = ReadOptions { hold_out: Some(2), ..ReadOptions::default() };
    assert_eq!(Capture::read(folder.path(), &options).unwrap().held_out().collect::<Vec<_>>(), [3, 4]);
    write("transforms_test.json", &frames[4..]);
    assert_eq!(read(folder.path()).unwrap().views.len(), 4);
}

fn write_llff(folder: &Path, document: &Document, descr: &str) {
    fs::create_dir_all(folder.join("images_8")).unwrap();
    let mut data = Vec::new();
    for (i, case) in document.cases.iter().enumerate() {
        fs::write(folder.join(format!("images_8/{i}.png")), photograph()).unwrap();
        for &v in &case.llff_row {
            if descr == "<f8" { data.extend(v.to_le_bytes()) } else { data.extend((v as f32).to_le_bytes()) }
        }
    }
    fs::write(folder.join("poses_bounds.npy"), npy(descr, "(5, 17)", &data)).unwrap();
}

#[test]
fn llff_agrees_with_the_reference() {
    let document = reference();
    let folder = tempfile::tempdir().unwrap();
    write_llff(folder.path(), &document, "<f8");
    let capture = read(folder.path()).unwrap();
    assert_eq!(capture.held_out().count(), 0);
    let options = ReadOptions { hold_out: Some(3), ..ReadOptions::default() };
    assert_eq!(Capture::read(folder.path(), &options).unwrap().held_out().collect::<Vec<_>>(), [0, 3]);
    for (i, case) in document.cases.iter().enumerate() {
        assert_eq!(capture.views[i].bounds, Some((0.5, 6.0)));
        compare(&capture, i, case, &case.pixels_simple_centred);
    }
    write_llff(folder.path(), &document, "<f4");
    let single = read(folder.path()).unwrap();
    let apart = single.views[0].camera.pose.position - capture.views[0].camera.pose.position;
    assert!(apart.length() < 1e-6 && apart.length() > 0.0);
}

#[test]
fn intrinsics_follow_a_smaller_folder_of_photographs() {
    let document = reference();
    let mut model = as_colmap(&document);
    for (_, _, _, size, parameters) in &mut model.cameras {
        // The model of the full-size photographs: 4 times as large, less a rounded-off pixel.
        *size = [size[0] * 4 + 1, size[1] * 4];
        let lens = if parameters.len() == 4 && parameters[3] > 1.0 || parameters.len() == 8 { 4 } else { 3 };
        parameters[..lens].iter_mut().for_each(|v| *v *= 4.0);
    }
    let folder = model.folder();
    let capture = Capture::read(folder.path(), &ReadOptions::default()).unwrap();
    for (view, case) in capture.views.iter().zip(&document.cases) {
        assert_eq!((view.camera.intrinsics.width, view.camera.intrinsics.height), (64, 48));
        for (&world, expected) in case.world.iter().zip(&case.pixels) {
            let at = view.camera.project(DVec3::from_array(world)).unwrap();
            // One pixel of 257 is what the odd width may cost.
            assert!((at.x - expected[0]).abs() < 64.0 / 257.0 * 1.5 && (at.y - expected[1]).abs() < 1e-9);
        }
    }
}
