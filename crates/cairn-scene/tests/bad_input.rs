//! What people bring can be wrong in any way: each kind of wrong is one clear
//! error that names the file, the entry and the remedy, and nothing panics or
//! takes memory for what a header merely claims.

use std::fs;
use std::path::Path;

use crate::common::{Colmap, npy, photograph, read, refuses};
use cairn_scene::{Capture, CaptureError, Distortion, ReadOptions, Unused, UnusedPhotographs};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use serde_json::{Value, json};

/// A small model with `change` made to it, written and read.
fn colmap(change: impl FnOnce(&mut Colmap)) -> Result<Capture, CaptureError> {
    let mut model = Colmap::small();
    change(&mut model);
    let folder = tempfile::tempdir().unwrap();
    model.write_bin(folder.path());
    Colmap::small().write_photographs(folder.path());
    read(folder.path())
}

#[test]
fn the_small_model_itself_is_good() {
    let capture = colmap(|_| {}).unwrap();
    assert_eq!((capture.views.len(), capture.points.len()), (3, 2));
    assert_eq!(capture.training().collect::<Vec<_>>(), [0, 1, 2]);
}

#[test]
fn nothing_there() {
    let empty = tempfile::tempdir().unwrap();
    refuses(read(empty.path()), &["holds no capture", "poses_bounds.npy", "transforms.json"]);
    refuses(read(&empty.path().join("absent")), &["cannot open", "absent"]);
}

#[test]
fn photographs_without_cameras_are_answered_with_the_way_to_cameras() {
    let place = tempfile::tempdir().unwrap();
    // A stray file in the folder above makes no capture of that.
    fs::write(place.path().join("cameras.txt"), b"").unwrap();
    for (folder, images) in [("plain", "plain"), ("with images", "with images/images")] {
        let (folder, images) = (place.path().join(folder), place.path().join(images));
        fs::create_dir_all(&images).unwrap();
        for name in ["a.JPG", "b.png"] {
            fs::write(images.join(name), b"").unwrap();
        }
        let error = read(&folder).unwrap_err().to_string();
        assert!(error.contains("holds 2 photographs and no cameras"), "{error}");
        let lines: Vec<&str> = error.lines().map(str::trim).collect();
        let image_path = match folder == images {
            true => format!("--image_path {}", images.display()),
            // A path with blanks is quoted, so that the line can be copied.
            false => format!("--image_path '{}'", images.display()),
        };
        assert!(lines[1].starts_with("colmap feature_extractor") && lines[1].contains(&image_path), "{error}");
        assert!(lines[1].ends_with("--SiftExtraction.use_gpu 0"), "{error}");
        assert!(lines[2].starts_with("colmap exhaustive_matcher") && lines[2].contains("use_gpu 0"), "{error}");
        assert!(lines[3].contains("&& colmap mapper") && lines[3].contains("/sparse"), "{error}");
    }
}

#[test]
fn poses_that_are_none() {
    refuses(colmap(|m| m.images[1].quaternion[2] = f64::NAN), &["images.bin", "image 2 (2.png)", "quaternion", "NaN"]);
    refuses(colmap(|m| m.images[1].quaternion = [0.0; 4]), &["image 2 (2.png)", "quaternion of length 1", "length 0"]);
    refuses(colmap(|m| m.images[1].quaternion[0] = 1.002), &["length 1.002", "colmap model_converter"]);
    assert!(colmap(|m| m.images[1].quaternion[0] = 1.0005).is_ok());
    refuses(colmap(|m| m.images[2].translation[0] = f64::INFINITY), &["image 3 (3.png)", "not finite"]);
    refuses(colmap(|m| m.points[1][2] = f64::NAN), &["points3D.bin", "point 1", "finite"]);
}

#[test]
fn cameras_that_are_none() {
    refuses(colmap(|m| m.cameras[0].4[0] = 0.0), &["cameras.bin", "camera 1", "focal length above 0"]);
    refuses(colmap(|m| m.cameras[0].4[1] = -5.0), &["focal length above 0", "-5"]);
    refuses(colmap(|m| m.cameras[0].4[2] = f64::NAN), &["finite principal point"]);
    refuses(colmap(|m| m.cameras[0].3[0] = 0), &["camera 1", "0 x 48"]);
    refuses(colmap(|m| m.cameras[0].3[0] = u64::MAX), &["camera 1", "1 to 1048576 pixels"]);
    refuses(colmap(|m| m.images[0].camera = 9), &["image 1 (1.png)", "camera 9"]);
    refuses(colmap(|m| m.cameras.push(m.cameras[0].clone())), &["camera 1", "used only once"]);
    let other = |m: &mut Colmap| m.cameras[0] = (4, 6, "FULL_OPENCV", [64, 48], vec![50.0; 12]);
    let known = "SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, OPENCV_FISHEYE or SIMPLE_RADIAL_FISHEYE";
    refuses(colmap(other), &["camera 4", "FULL_OPENCV", known, "image_undistorter", "model_converter"]);
    refuses(colmap(|m| m.cameras[0].1 = -1), &["camera 1", "number -1"]);
}

#[test]
fn fisheyes_that_end_within_their_picture() {
    let with = |change: fn(&mut Vec<f64>)| {
        colmap(|m| {
            let mut parameters = vec![24.0, 25.0, 31.0, 25.0, 0.05, -0.01, 0.003, -0.0005];
            change(&mut parameters);
            m.cameras[0] = (1, 5, "OPENCV_FISHEYE", [64, 48], parameters);
        })
    };
    assert!(with(|_| {}).is_ok());
    // t (1 - 0.25 t^2) turns back at 66 degrees, and the corner is farther out than where it has come to.
    let refused = ["cameras.bin", "camera 1", "ends 66.2 degrees", "turns back", "0.7698", "corner lies", "crop"];
    refuses(with(|p| p[4..].copy_from_slice(&[-0.25, 0.0, 0.0, 0.0])), &refused);
    // It turns back beyond the corner of a longer lens.
    assert!(with(|p| *p = vec![60.0, 60.0, 31.0, 25.0, -0.25, 0.0, 0.0, 0.0]).is_ok());
    refuses(
        with(|p| *p = vec![12.0, 12.0, 31.0, 25.0, 0.0, 0.0, 0.0, 0.0]),
        &["ends 180.0 degrees", "straight behind"],
    );
    refuses(with(|p| p[7] = f64::NAN), &["camera 1", "finite distortion"]);
    refuses(with(|p| p[0] = 0.0), &["camera 1", "focal length above 0"]);
    let simple = |m: &mut Colmap| {
        m.cameras[0] = (1, 8, "SIMPLE_RADIAL_FISHEYE", [64, 48], vec![24.0, 31.0, 25.0, -0.25]);
    };
    refuses(colmap(simple), &["camera 1", "ends 66.2 degrees"]);
}

#[test]
fn names_that_lead_astray() {
    refuses(colmap(|m| m.images[1].name = "1.png".into()), &["image 2 (1.png)", "image 1 (1.png)", "used only once"]);
    refuses(colmap(|m| m.images[1].name = "../../etc/passwd".into()), &["image 2", "inside the folder", "passwd"]);
    refuses(colmap(|m| m.images[1].name = "/etc/passwd".into()), &["image 2", "inside the folder"]);
    refuses(colmap(|m| m.images[1].name = "7.png".into()), &["images.bin", "image 2 (7.png)", "7.png is missing"]);
    refuses(colmap(|m| m.images[1].name = "x".repeat(5000)), &["image at index 1", "at most 4096 bytes"]);
}

#[test]
fn photographs_that_are_none() {
    let folder = Colmap::small().folder();
    let path = folder.path().join("images/2.png");
    fs::write(&path, "this is a letter").unwrap();
    refuses(read(folder.path()), &["2.png", "cannot be decoded", "leave it out"]);
    fs::write(&path, []).unwrap();
    refuses(read(folder.path()), &["2.png", "cannot be decoded"]);
    fs::write(&path, cairn_scene::encode_png(&cairn_scene::Picture::constant(48, 64, [0.5; 3]))).unwrap();
    refuses(read(folder.path()), &["2.png", "64 x 48", "48 x 64"]);
    // A header that is fine and pixels that stop half way: found when it is decoded.
    let whole = photograph();
    fs::write(&path, &whole[..whole.len() - 30]).unwrap();
    refuses(read(folder.path()).unwrap().photograph(1), &["2.png", "cannot be decoded"]);
    refuses(read(folder.path()).unwrap().photograph(3), &["no view 3", "0 to 2"]);
}

#[test]
fn counts_and_sizes_over_the_limits() {
    let folder = Colmap::small().folder();
    let with = |change: fn(&mut ReadOptions)| {
        let mut options = ReadOptions::default();
        change(&mut options);
        Capture::read(folder.path(), &options)
    };
    refuses(with(|o| o.limits.max_views = 2), &["images.bin", "number of views is 3", "limit is 2"]);
    refuses(with(|o| o.limits.max_side_px = 63), &["longest side in pixels is 64", "limit is 63"]);
    refuses(with(|o| o.limits.max_pixels = 3000), &["number of pixels is 3072", "limit is 3000"]);
    refuses(with(|o| o.limits.max_file_bytes = 40), &["1.png", "file size in bytes"]);
    refuses(colmap(|m| m.images.clear()), &["images.bin", "at least one view"]);
}

#[test]
fn binary_counts_that_would_take_gigabytes() {
    for file in ["cameras.bin", "images.bin", "points3D.bin"] {
        let folder = Colmap::small().folder();
        let path = folder.path().join("sparse/0").join(file);
        let good = fs::read(&path).unwrap();
        for count in [u64::MAX, u64::MAX / 51, 1 << 40, 1 << 33] {
            let mut bytes = good.clone();
            bytes[..8].copy_from_slice(&count.to_le_bytes());
            fs::write(&path, &bytes).unwrap();
            refuses(read(folder.path()), &[file, &count.to_string()]);
        }
        let mut bytes = good.clone();
        bytes.push(0);
        fs::write(&path, &bytes).unwrap();
        refuses(read(folder.path()), &[file, "1 more bytes"]);
    }
    // The count of an image's observations, of 24 bytes each.
    let folder = Colmap::small().folder();
    let path = folder.path().join("sparse/0/images.bin");
    let mut bytes = fs::read(&path).unwrap();
    let at = 8 + 4 + 56 + 4 + "1.png".len() + 1;
    bytes[at..at + 8].copy_from_slice(&u64::MAX.to_le_bytes());
    fs::write(&path, bytes).unwrap();
    refuses(read(folder.path()), &["image at index 0", "before the file ends"]);
}

/// Cut at every length, and with bytes flipped at random: an error or a capture
/// whose every number is finite, never a panic.
#[test]
fn truncated_and_mutated_binaries_never_panic() {
    let folder = Colmap::small().folder();
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let (mut refused, mut accepted) = (0, 0);
    for file in ["cameras.bin", "images.bin", "points3D.bin"] {
        let path = folder.path().join("sparse/0").join(file);
        let good = fs::read(&path).unwrap();
        for length in 0..good.len() {
            fs::write(&path, &good[..length]).unwrap();
            refuses(read(folder.path()), &[file]);
        }
        for _ in 0..500 {
            let mut bytes = good.clone();
            for _ in 0..1 + rng.next_u32() % 4 {
                let at = rng.next_u32() as usize % bytes.len();
                bytes[at] = match rng.next_u32() % 3 {
                    0 => 0,
                    1 => 255,
                    _ => rng.next_u32() as u8,
                };
            }
            fs::write(&path, &bytes).unwrap();
            match read(folder.path()) {
                Err(_) => refused += 1,
                Ok(capture) => {
                    accepted += 1;
                    let finite = |v: &cairn_scene::View| {
                        v.camera.pose.rotation.is_finite() && v.camera.pose.position.is_finite()
                    };
                    assert!(capture.views.iter().all(finite));
                    assert!(capture.points.iter().all(|p| p.is_finite()));
                }
            }
        }
        fs::write(&path, good).unwrap();
    }
    // Both must occur, or the mutations test nothing.
    assert!(refused > 200 && accepted > 200, "{refused} refused, {accepted} accepted");
}

#[test]
fn text_models_name_the_line() {
    let folder = tempfile::tempdir().unwrap();
    Colmap::small().write_text(folder.path());
    Colmap::small().write_photographs(folder.path());
    assert!(read(folder.path()).is_ok());
    let write = |file: &str, text: &str| fs::write(folder.path().join("sparse").join(file), text).unwrap();
    let good = fs::read_to_string(folder.path().join("sparse/images.txt")).unwrap();
    write("images.txt", &good.replace(" 2 2.png", " two 2.png").replace("1 2.png", "one 2.png"));
    refuses(read(folder.path()), &["images.txt", "line 4", "a camera number", "\"one\""]);
    write("images.txt", "1 1 0 0 0 0 0\n\n");
    refuses(read(folder.path()), &["images.txt", "line 1", "translation", "end of the line"]);
    write("images.txt", "1 1 0 0 0 nan 0 0 1 1.png\n\n");
    refuses(read(folder.path()), &["images.txt", "image 1 (1.png)", "not finite"]);
    // Without lines of observations every other image would be lost unnoticed.
    write(
        "images.txt",
        &good.lines().filter(|l| l.split(' ').count() >= 10 && !l.starts_with('#')).collect::<Vec<_>>().join("\n"),
    );
    refuses(read(folder.path()), &["images.txt", "line 2", "a line of observations"]);
    write("images.txt", &good);
    write("cameras.txt", "1 PINHOLE 64 48 55 57.5 31\n");
    refuses(read(folder.path()), &["cameras.txt", "camera 1", "4 parameters of PINHOLE", "got 3"]);
    write("cameras.txt", "1 FOV 64 48 55 57.5 31 25 0.1\n");
    refuses(read(folder.path()), &["cameras.txt", "camera 1", "FOV", "image_undistorter"]);
    fs::write(folder.path().join("sparse/cameras.txt"), [b'1', 0xff, 0xfe]).unwrap();
    refuses(read(folder.path()), &["cameras.txt"]);
}

#[test]
fn llff_rows_and_files() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("images")).unwrap();
    for i in 0..2 {
        fs::write(folder.path().join(format!("images/{i}.png")), photograph()).unwrap();
    }
    // Down, right, backwards, position, (height, width, focal); near, far.
    let row = [0.0, 1.0, 0.0, 0.0, 480.0, 1.0, 0.0, 0.0, 0.0, 640.0, 0.0, 0.0, -1.0, 0.0, 550.0, 1.0, 9.0];
    let write = |rows: &[[f64; 17]], shape: &str| {
        let data: Vec<u8> = rows.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        fs::write(folder.path().join("poses_bounds.npy"), npy("<f8", shape, &data)).unwrap();
        read(folder.path())
    };
    let changed = |at: usize, to: f64| {
        let mut bad = row;
        bad[at] = to;
        write(&[row, bad], "(2, 17)")
    };
    assert_eq!(write(&[row; 2], "(2, 17)").unwrap().views.len(), 2);
    refuses(changed(3, f64::NAN), &["poses_bounds.npy", "row 1 (1.png)", "not finite"]);
    refuses(changed(1, 0.5), &["row 1 (1.png)", "rotation is not one"]);
    refuses(changed(12, 1.0), &["row 1 (1.png)", "determinant -1"]);
    refuses(changed(14, 0.0), &["row 1 (1.png)", "focal length above 0"]);
    refuses(changed(9, 640.5), &["row 1", "whole pixels", "640.5"]);
    refuses(changed(9, 500.0), &["1.png", "500 x 480", "64 x 48"]);
    refuses(changed(16, 0.5), &["row 1", "0 < near < far"]);
    refuses(write(&[row; 3], "(3, 17)"), &["3 photographs", "got 2", "one for each row"]);
    refuses(write(&[row; 2], "(2, 18)"), &["the data", "2 x 18", "272 bytes"]);
    refuses(write(&[row; 2], "(34, 1)"), &["17 columns", "got 1"]);
    refuses(write(&[row; 2], "(34,)"), &["shape", "(34,)"]);
    refuses(write(&[row; 2], "(9223372036854775807, 17)"), &["the data", "9223372036854775807 x 17"]);
    for (bytes, part) in [
        (npy("<i8", "(2, 17)", &[0; 272]), "'<i8'"),
        (b"PK\x03\x04 a zip file".to_vec(), "first bytes"),
        (b"\x93NUMPY\x01\x00\xff\xff{".to_vec(), "complete NumPy header"),
        (b"\x93NUMPY\x09\x00".to_vec(), "1, 2 or 3, got 9"),
        (b"\x93NUMPY".to_vec(), "complete NumPy header"),
    ] {
        fs::write(folder.path().join("poses_bounds.npy"), bytes).unwrap();
        refuses(read(folder.path()), &["poses_bounds.npy", part, "numpy.save"]);
    }
    fs::remove_dir_all(folder.path().join("images")).unwrap();
    refuses(write(&[row; 2], "(2, 17)"), &["the photographs", "images_2, images, got none"]);
}

fn transforms(folder: &Path, change: impl FnOnce(&mut Value)) -> Result<Capture, CaptureError> {
    let matrix = json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]);
    let frame = |name: &str| json!({"file_path": name, "transform_matrix": matrix});
    let mut document = json!({"fl_x": 55.0, "frames": [frame("./a.png"), frame("b")]});
    change(&mut document);
    for name in ["a.png", "b.jpeg"] {
        fs::write(folder.join(name), photograph()).unwrap();
    }
    fs::write(folder.join("transforms.json"), document.to_string()).unwrap();
    read(folder)
}

#[test]
fn transforms_frames_and_files() {
    let folder = tempfile::tempdir().unwrap();
    let with = |change: fn(&mut Value)| transforms(folder.path(), change);
    let good = with(|_| {}).unwrap();
    assert_eq!(good.views.iter().map(|v| v.name.as_str()).collect::<Vec<_>>(), ["a.png", "b.jpeg"]);
    refuses(with(|d| d["frames"][1]["file_path"] = json!("../b.png")), &["frame 1 (../b.png)", "inside the capture"]);
    refuses(with(|d| d["frames"][1]["file_path"] = json!("/b.png")), &["frame 1 (/b.png)", "inside the capture"]);
    refuses(with(|d| d["frames"][1]["file_path"] = json!("")), &["frame 1", "inside the capture"]);
    refuses(with(|d| d["frames"][1]["file_path"] = json!("c")), &["transforms.json, frame 1 (c)", "c is missing"]);
    refuses(with(|d| d["frames"][1]["file_path"] = json!("a")), &["a.png", "used only once"]);
    refuses(with(|d| d["frames"][1]["transform_matrix"][0][0] = json!(2)), &["frame 1 (b)", "rotation is not one"]);
    refuses(with(|d| d["frames"][1]["transform_matrix"][3][3] = json!(2)), &["frame 1 (b)", "0 0 0 1"]);
    refuses(with(|d| d["frames"][1]["transform_matrix"] = json!([[1]])), &["frame 1 (b)", "4 x 4", "1 rows"]);
    refuses(with(|d| d["fl_x"] = json!(0)), &["focal length above 0"]);
    refuses(with(|d| d["fl_x"] = Value::Null), &["frame 0", "fl_x or camera_angle_x"]);
    refuses(with(|d| d["w"] = json!(64)), &["frame 0", "both w and h"]);
    refuses(with(|d| d["camera_model"] = json!("EQUIRECTANGULAR")), &["EQUIRECTANGULAR", "image_undistorter"]);
    refuses(with(|d| d["frames"][1]["k4"] = json!(0.1)), &["frame 1 (b)", "k4 = 0.1"]);
    let fisheye = |change: fn(&mut Value)| {
        transforms(folder.path(), |d| {
            d["camera_model"] = json!("OPENCV_FISHEYE");
            change(d);
        })
    };
    assert!(fisheye(|d| d["frames"][1]["k4"] = json!(0.1)).is_ok());
    refuses(fisheye(|d| d["frames"][1]["k1"] = json!(-2)), &["transforms.json", "frame 1 (b)", "turns back"]);
    refuses(fisheye(|d| d["frames"][1]["p2"] = json!(0.1)), &["frame 1 (b)", "OPENCV_FISHEYE with p2 = 0.1"]);
    let angle = |d: &mut Value| (d["fl_x"], d["camera_angle_x"]) = (Value::Null, json!(1.0));
    refuses(fisheye(angle), &["frame 0", "a fisheye's focal length: fl_x or fl_y"]);
    let both = |d: &mut Value| (d["camera_model"], d["is_fisheye"]) = (json!("OPENCV"), json!(true));
    refuses(with(both), &["frame 0", "OPENCV with is_fisheye"]);
    // One frame may have been taken by another lens.
    let mixed = fisheye(|d| d["frames"][1]["camera_model"] = json!("OPENCV")).unwrap();
    let kinds = mixed.views.iter().map(|v| matches!(v.camera.intrinsics.distortion, Distortion::Fisheye(_)));
    assert_eq!(kinds.collect::<Vec<_>>(), [true, false]);
    refuses(with(|d| d["frames"] = json!([])), &["transforms.json", "at least one view"]);
    refuses(with(|d| d["frames"] = json!(3)), &["transforms.json", "the JSON"]);
    fs::write(folder.path().join("transforms.json"), "{\"frames\": [{\"transform_matrix\": [[NaN").unwrap();
    refuses(read(folder.path()), &["transforms.json", "finite numbers", "line 1"]);
    fs::write(folder.path().join("transforms.json"), "[".repeat(1 << 20)).unwrap();
    refuses(read(folder.path()), &["transforms.json", "the JSON"]);
}

#[test]
fn contributor_tables() {
    let folder = Colmap::small().folder();
    let table = folder.path().join("who.csv");
    let with = |text: &str| {
        fs::write(&table, text).unwrap();
        let options = ReadOptions { contributors: Some(table.clone()), ..Default::default() };
        Capture::read(folder.path(), &options)
    };
    let good = with("\u{feff}note,contributor,image\n,ana, 1.png\n,\"Ben, jr\",2.png\n,ana,3.png\n").unwrap();
    assert_eq!(good.views.iter().map(|v| v.contributor.as_str()).collect::<Vec<_>>(), ["ana", "Ben, jr", "ana"]);
    let head = "image,contributor\n1.png,ana\n2.png,ben\n";
    refuses(with(head), &["who.csv", "photograph 3.png", "no row", "add a row"]);
    refuses(with(&format!("{head}4.png,ana\n")), &["line 4 (4.png)", "no photograph of that name", "remove the row"]);
    let said = with(&format!("{head}4.png,ana\n3.png,ana\n5.png,ana\n"));
    refuses(said, &["line 4 (4.png), line 6 (5.png)", "no photograph of these names"]);
    refuses(with("image,contributor\n2.png,ana\n"), &["photographs 1.png, 3.png: they have no row"]);
    refuses(with(&format!("{head}2.png,ana\n")), &["line 4 (2.png)", "already has a row, line 3"]);
    refuses(with(&format!("{head}3.png, \n")), &["line 4 (3.png)", "empty", "who took it"]);
    refuses(with("picture,person\n1.png,ana\n"), &["line 2", "image", "heading"]);
    refuses(with(&format!("{head}3.png\n")), &["line 4"]);
    refuses(with(""), &["photographs 1.png, 2.png, 3.png", "no row"]);
    // A third column: any row of a contributor's has the key of all of theirs.
    let (one, two) = ("0b".repeat(32), "0c".repeat(32));
    let keyed = |rows: &str| with(&format!("image,contributor,key\n{rows}"));
    let good = keyed(&format!("1.png,ana,\n2.png,ben,\n3.png,ana,{one}\n")).unwrap();
    assert_eq!(
        good.views.iter().map(|v| v.contributor_key).collect::<Vec<_>>(),
        [Some([11; 32]), None, Some([11; 32])]
    );
    for (rows, parts) in [
        (
            format!("1.png,ana,{one}\n2.png,ben,\n3.png,ana,{two}\n"),
            ["line 4 (3.png)", "\"ana\" has another key in line 2"],
        ),
        (format!("1.png,ana,{}\n2.png,ben,\n3.png,ana,\n", &one[2..]), ["line 2 (1.png)", "is no public key"]),
        (format!("1.png,ana,{}g\n2.png,ben,\n3.png,ana,\n", &one[1..]), ["line 2 (1.png)", "64 hexadecimal digits"]),
    ] {
        refuses(keyed(&rows), &parts);
    }
    fs::remove_file(&table).unwrap();
    let options = ReadOptions { contributors: Some(table), ..Default::default() };
    refuses(Capture::read(folder.path(), &options), &["cannot open", "who.csv"]);
}

#[test]
fn photographs_and_models_that_are_not_read_are_said() {
    let mut model = Colmap::small();
    let folder = model.folder();
    let root = folder.path();
    fs::create_dir_all(root.join("images/eve")).unwrap();
    for name in ["4.png", "eve/5.png", "eve/._5.png"] {
        fs::write(root.join("images").join(name), photograph()).unwrap();
    }
    let table = root.join("who.csv");
    let with = |text: &str| {
        fs::write(&table, text).unwrap();
        Capture::read(root, &ReadOptions { contributors: Some(table.clone()), ..Default::default() })
    };
    // A row for one of these photographs is accepted; a row for a photograph that is not there is refused.
    let head = "image,contributor\n1.png,ana\n2.png,ben\n3.png,ana\n4.png,ana\n";
    let capture = with(&format!("{head}5.png,eve\n")).unwrap();
    assert_eq!(
        (capture.views.len(), &capture.left_out.without_camera[..]),
        (3, &["4.png", "eve/5.png"].map(String::from)[..])
    );
    assert_eq!(capture.notes(), ["2 photographs have no camera, and the scene leaves them out: 4.png, eve/5.png"]);
    refuses(with(&format!("{head}6.png,eve\n")), &["line 6 (6.png)", "no photograph of that name"]);
    // Two photographs of one file name, of which one has a camera.
    fs::write(root.join("images/eve/1.png"), photograph()).unwrap();
    assert_eq!(with(head).unwrap().left_out.without_camera.len(), 3);
    // The model that the note names can be read as it says.
    let one = root.join("sparse/1");
    fs::create_dir(&one).unwrap();
    model.images.truncate(2);
    fs::write(one.join("cameras.bin"), model.cameras_bin()).unwrap();
    fs::write(one.join("images.bin"), model.images_bin()).unwrap();
    let capture = read(root).unwrap();
    assert_eq!(capture.left_out.models, [Path::new("sparse/1")]);
    let images = root.join("images");
    let options = format!("`--from {} --images {}`", one.display(), images.display());
    let named = ReadOptions { images: Some(images), ..Default::default() };
    for notes in [capture.notes(), Capture::read(root, &named).unwrap().notes()] {
        assert!(notes.iter().any(|note| note.contains(&options)), "{notes:?}");
    }
    assert_eq!(Capture::read(&one, &named).unwrap().views.len(), 2);
    // A transforms.json leaves out what its structure from motion did; a split of files says nothing of the kind.
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("images")).unwrap();
    for name in ["a.png", "b.png", "c.png"] {
        fs::write(folder.path().join("images").join(name), photograph()).unwrap();
    }
    let matrix = json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]);
    let frame = |name: &str| json!({"file_path": name, "transform_matrix": matrix});
    let frames = json!({"camera_angle_x": 0.7, "frames": [frame("images/a.png"), frame("images/b.png")]}).to_string();
    fs::write(folder.path().join("transforms.json"), &frames).unwrap();
    assert_eq!(read(folder.path()).unwrap().left_out.without_camera, ["images/c.png"]);
    fs::rename(folder.path().join("transforms.json"), folder.path().join("transforms_train.json")).unwrap();
    assert!(read(folder.path()).unwrap().left_out.without_camera.is_empty());
}

#[test]
fn views_without_photographs_are_left_out_where_that_is_asked_for() {
    let skip = |folder: &Path| Capture::read(folder, &ReadOptions { skip_missing: true, ..ReadOptions::default() });
    let names = |capture: &Capture| capture.views.iter().map(|v| v.name.clone()).collect::<Vec<_>>();
    // COLMAP, with a table that knows all three.
    let folder = Colmap::small().folder();
    let table = folder.path().join("who.csv");
    fs::write(&table, "image,contributor\n1.png,ada\n2.png,bo\n3.png,cy\n").unwrap();
    fs::remove_file(folder.path().join("images/2.png")).unwrap();
    refuses(read(folder.path()), &["(2.png)", "2.png is missing", "--skip-missing"]);
    let options = ReadOptions { skip_missing: true, contributors: Some(table), ..ReadOptions::default() };
    let capture = Capture::read(folder.path(), &options).unwrap();
    assert_eq!(names(&capture), ["1.png", "3.png"]);
    assert_eq!(capture.views.iter().map(|v| v.contributor.as_str()).collect::<Vec<_>>(), ["ada", "cy"]);
    assert_eq!(capture.left_out.missing, ["2.png"]);
    // A name that is neither there nor missing is still a mistake.
    fs::write(folder.path().join("who.csv"), "image,contributor\n1.png,ada\n9.png,bo\n3.png,cy\n").unwrap();
    refuses(Capture::read(folder.path(), &options), &["9.png", "no photograph of that name"]);
    // None at all is no capture.
    for name in ["1.png", "3.png"] {
        fs::remove_file(folder.path().join("images").join(name)).unwrap();
    }
    refuses(skip(folder.path()), &["1.png is missing"]);
    // Transforms, where a camera without a size would take it from the photograph.
    let folder = tempfile::tempdir().unwrap();
    assert!(transforms(folder.path(), |d| d["frames"][1]["file_path"] = json!("./sub/c")).is_err());
    let capture = skip(folder.path()).unwrap();
    assert_eq!(
        (names(&capture), capture.left_out.missing.clone()),
        (vec!["a.png".to_owned()], vec!["sub/c".to_owned()])
    );
    // A table has endings where the file leaves them away.
    let table = folder.path().join("who.csv");
    fs::write(&table, "image,contributor\na.png,ada\nsub/c.jpg,bo\n").unwrap();
    let listed = ReadOptions { skip_missing: true, contributors: Some(table), ..ReadOptions::default() };
    assert_eq!(Capture::read(folder.path(), &listed).unwrap().views[0].contributor, "ada");
    fs::remove_file(folder.path().join("a.png")).unwrap();
    refuses(skip(folder.path()), &["frame 0 (./a.png)", "a.png is missing"]);
}

#[test]
fn every_photograph_is_trained_on_unless_some_are_to_be_held_out() {
    let folder = Colmap::small().folder();
    let with = |hold_out| Capture::read(folder.path(), &ReadOptions { hold_out, ..ReadOptions::default() });
    assert_eq!(with(None).unwrap().training().collect::<Vec<_>>(), [0, 1, 2]);
    assert_eq!(with(Some(2)).unwrap().held_out().collect::<Vec<_>>(), [0, 2]);
    assert_eq!(with(Some(8)).unwrap().held_out().collect::<Vec<_>>(), [0]);
    refuses(with(Some(0)), &["--hold-out) is 0", "expected 2 or more", "leave it away to train on every photograph"]);
    refuses(with(Some(1)), &["--hold-out) is 1", "expected 2 or more"]);
    // Of one view none can be kept back.
    for name in ["2.png", "3.png"] {
        fs::remove_file(folder.path().join("images").join(name)).unwrap();
    }
    let options = ReadOptions { hold_out: Some(2), skip_missing: true, ..ReadOptions::default() };
    refuses(Capture::read(folder.path(), &options), &["at least one view to train on", "all 1 held out", "--hold-out"]);
}

#[test]
fn contributors_who_get_no_share_are_named_with_the_reason() {
    let folder = Colmap::small().folder();
    let images = folder.path().join("images");
    // Photographs that no camera was found for, and one that a camera names and that is not there.
    for name in ["4.png", "5.png"] {
        fs::write(images.join(name), photograph()).unwrap();
    }
    fs::remove_file(images.join("3.png")).unwrap();
    let table = folder.path().join("who.csv");
    fs::write(&table, "image,contributor\n1.png,ada\n2.png,bo\n3.png,cy\n4.png,di\n5.png,bo\n").unwrap();
    let with = |hold_out| {
        let contributors = Some(table.clone());
        let options = ReadOptions { contributors, hold_out, skip_missing: true, ..ReadOptions::default() };
        Capture::read(folder.path(), &options).unwrap()
    };
    let row = |contributor: &str, why| UnusedPhotographs { contributor: contributor.into(), why, photographs: 1 };
    let capture = with(None);
    assert_eq!(
        capture.left_out.listed,
        [row("bo", Unused::NoCamera), row("cy", Unused::Missing), row("di", Unused::NoCamera)]
    );
    // bo has a photograph that teaches, too.
    assert_eq!(capture.without_share(), [row("cy", Unused::Missing), row("di", Unused::NoCamera)]);
    let capture = with(Some(8));
    assert_eq!(
        capture.without_share(),
        [row("ada", Unused::HeldOut), row("cy", Unused::Missing), row("di", Unused::NoCamera)]
    );
    // Those of a capture without a table are all by one, who is credited.
    let plain = Colmap::small().folder();
    assert_eq!(read(plain.path()).unwrap().without_share(), []);
}

#[test]
fn a_missing_photograph_gives_its_credit_to_nobody() {
    // Of two photographs with one file name, that name alone is neither's, whichever is there.
    let folder = tempfile::tempdir().unwrap();
    transforms(folder.path(), |d| {
        d["frames"][0]["file_path"] = json!("one/1.png");
        d["frames"][1]["file_path"] = json!("two/1.png");
    })
    .unwrap_err();
    fs::create_dir(folder.path().join("one")).unwrap();
    fs::write(folder.path().join("one/1.png"), photograph()).unwrap();
    let table = folder.path().join("who.csv");
    let read = |rows: &str| {
        fs::write(&table, format!("image,contributor\n{rows}")).unwrap();
        let contributors = Some(table.clone());
        let options = ReadOptions { skip_missing: true, contributors, ..ReadOptions::default() };
        Capture::read(folder.path(), &options)
    };
    refuses(read("1.png,bo\n"), &["1.png", "or several"]);
    assert_eq!(read("one/1.png,ada\ntwo/1.png,bo\n").unwrap().views[0].contributor, "ada");
    refuses(read("one/1.png,ada\ntwo/1.png,\n"), &["line 3 (two/1.png)", "empty"]);
    refuses(read("two/1.png,bo\n"), &["one/1.png", "no row"]);
}

#[test]
fn a_split_without_its_photographs_is_none() {
    let folder = tempfile::tempdir().unwrap();
    transforms(folder.path(), |_| {}).unwrap();
    let document = fs::read_to_string(folder.path().join("transforms.json")).unwrap();
    fs::write(folder.path().join("transforms_train.json"), &document).unwrap();
    let absent = document.replace("./a.png", "./test/a").replace("\"b\"", "\"./test/b\"");
    fs::write(folder.path().join("transforms_test.json"), absent).unwrap();
    refuses(read(folder.path()), &["transforms_test.json", "--skip-missing"]);
    let options = ReadOptions { skip_missing: true, hold_out: Some(2), ..ReadOptions::default() };
    let capture = Capture::read(folder.path(), &options).unwrap();
    assert_eq!(capture.held_out().collect::<Vec<_>>(), [0], "every second one instead");
    assert_eq!(capture.left_out.missing, ["test/a", "test/b"]);
}
