//! Photographs and folders by the names that camera files of other systems give
//! them, and what is said of a capture that was read.

use std::error::Error;
use std::fs;
use std::path::Path;

use crate::common::{Colmap, npy, photograph, read, refuses};
use cairn_scene::{Capture, CaptureError, ReadOptions, SceneKind};
use serde_json::{Value, json};

const STRAIGHT: [[f64; 4]; 4] =
    [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 4.0], [0.0, 0.0, 0.0, 1.0]];

fn document(paths: &[&str]) -> Value {
    let frames: Vec<Value> =
        paths.iter().map(|path| json!({"file_path": path, "transform_matrix": STRAIGHT})).collect();
    json!({"fl_x": 55.0, "frames": frames})
}

/// A capture whose `transforms.json` names `paths` and whose folder has `files`.
fn transforms(paths: &[&str], files: &[&str]) -> Result<Capture, CaptureError> {
    let folder = tempfile::tempdir().unwrap();
    for file in files {
        let path = folder.path().join(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, photograph()).unwrap();
    }
    fs::write(folder.path().join("transforms.json"), document(paths).to_string()).unwrap();
    read(folder.path())
}

fn names(capture: &Capture) -> Vec<&str> {
    capture.views.iter().map(|v| v.name.as_str()).collect()
}

#[test]
fn endings_separators_and_accents_of_other_systems() {
    let read = transforms(&["images/i00", "images/i01"], &["images/i00.PNG", "images/i01.JPG"]).unwrap();
    assert_eq!(names(&read), ["images/i00.PNG", "images/i01.JPG"]);
    let read = transforms(&["images\\i00.png", ".\\images\\i01"], &["images/i00.png", "images/i01.jpeg"]).unwrap();
    assert_eq!(names(&read), ["images/i00.png", "images/i01.jpeg"]);
    let read = transforms(&["images/i00", "images/i01"], &["images/i00.webp", "images/i01.WEBP"]).unwrap();
    assert_eq!(names(&read), ["images/i00.webp", "images/i01.WEBP"]);
    // `é` and `ü` as one character each in the file, as letter and accent on the disk; and the other way round.
    let read = transforms(&["caf\u{e9}/m\u{fc}.png", "b"], &["cafe\u{301}/mu\u{308}.png", "b.png"]).unwrap();
    assert_eq!(names(&read), ["b.png", "cafe\u{301}/mu\u{308}.png"]);
    let read = transforms(&["mu\u{308}", "b"], &["m\u{fc}.png", "b.png"]).unwrap();
    assert_eq!(names(&read), ["b.png", "m\u{fc}.png"]);
    refuses(transforms(&["images\\..\\..\\i00.png"], &["i00.png"]), &["is missing"]);
    refuses(transforms(&["caf\u{e9}"], &["cafe.png"]), &["is missing"]);
    // COLMAP's names as well.
    let folder = Colmap::small().folder();
    let mut model = Colmap::small();
    model.images[0].name = "left\\1.png".into();
    model.write_bin(folder.path());
    fs::create_dir(folder.path().join("images/left")).unwrap();
    fs::rename(folder.path().join("images/1.png"), folder.path().join("images/left/1.png")).unwrap();
    assert_eq!(crate::common::read(folder.path()).unwrap().views.len(), 3);
}

#[test]
fn a_table_names_photographs_in_any_unicode_form() {
    // Composed in the table and apart on the disk, and the other way round; by path and by file name.
    let files = ["cafe\u{301}/1.png", "m\u{fc}.png", "left/e\u{301}.png"];
    let folder = tempfile::tempdir().unwrap();
    for file in files {
        let path = folder.path().join(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, photograph()).unwrap();
    }
    fs::write(folder.path().join("transforms.json"), document(&files).to_string()).unwrap();
    let table = folder.path().join("contributors.csv");
    let with = |rows: &str| {
        fs::write(&table, format!("\u{feff}image,contributor\n{rows}")).unwrap();
        Capture::read(folder.path(), &ReadOptions { contributors: Some(table.clone()), ..ReadOptions::default() })
    };
    let read = with("caf\u{e9}/1.png,ada\nmu\u{308}.png,bo\n\u{e9}.png,cy\n").unwrap();
    let whose: Vec<_> = read.views.iter().map(|v| (v.name.as_str(), v.contributor.as_str())).collect();
    assert_eq!(whose, [(files[0], "ada"), (files[2], "cy"), (files[1], "bo")]);
    let twice = "caf\u{e9}/1.png,ada\ncafe\u{301}/1.png,bo\nm\u{fc}.png,bo\n\u{e9}.png,cy\n";
    refuses(with(twice), &["line 3", "already has a row, line 2"]);
    refuses(with("cafe/1.png,ada\nm\u{fc}.png,bo\n\u{e9}.png,cy\n"), &["line 2 (cafe/1.png)", "no photograph"]);
}

#[test]
fn a_text_model_may_begin_with_a_byte_order_mark() {
    let folder = tempfile::tempdir().unwrap();
    Colmap::small().write_photographs(folder.path());
    Colmap::small().write_text(folder.path());
    let plain = read(folder.path()).unwrap();
    for name in ["cameras.txt", "images.txt", "points3D.txt"] {
        let path = folder.path().join("sparse").join(name);
        let text = fs::read_to_string(&path).unwrap();
        fs::write(&path, format!("\u{feff}{text}")).unwrap();
    }
    let marked = read(folder.path()).unwrap();
    assert_eq!(format!("{:?}", marked.views), format!("{:?}", plain.views));
}

#[cfg(unix)]
#[test]
fn a_file_of_just_that_name_comes_first() {
    let read = transforms(&["images\\1.png", "b"], &["images\\1.png", "images/1.png", "b.png"]).unwrap();
    assert_eq!(&*read.views[1].photograph, Path::new("images\\1.png"));
}

#[test]
fn a_split_of_its_own_is_found_however_it_spells_names() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.png", "b.png"] {
        fs::write(folder.path().join(name), photograph()).unwrap();
    }
    let mut document = document(&["./a", "./b"]);
    document["test_filenames"] = json!([".\\b"]);
    fs::write(folder.path().join("transforms.json"), document.to_string()).unwrap();
    let options = ReadOptions { hold_out: Some(8), ..ReadOptions::default() };
    assert_eq!(Capture::read(folder.path(), &options).unwrap().held_out().collect::<Vec<_>>(), [1]);
}

#[test]
fn a_byte_order_mark_and_the_file_s_own_path_are_taken() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.png", "b.png"] {
        fs::write(folder.path().join(name), photograph()).unwrap();
    }
    let file = folder.path().join("transforms.json");
    fs::write(&file, format!("\u{feff}{}", document(&["a", "b"]))).unwrap();
    let of_folder = read(folder.path()).unwrap();
    assert_eq!(of_folder.views.len(), 2);
    assert_eq!(read(&file).unwrap(), of_folder);
    assert_eq!(Capture::folder_of(&file), folder.path());
    // The file that is named is read, whatever else is there.
    Colmap::small().write_bin(folder.path());
    fs::write(folder.path().join("transforms_train.json"), document(&["a", "b"]).to_string()).unwrap();
    assert_eq!(read(&file).unwrap(), of_folder);
    assert_eq!(of_folder.kind, SceneKind::Unbounded);
    assert_eq!(read(&folder.path().join("transforms_train.json")).unwrap().kind, SceneKind::Bounded, "a synthetic one");
    refuses(read(&folder.path().join("a.png")), &["cannot open", "a.png"]);
    fs::remove_file(&file).unwrap();
    refuses(read(&file), &["cannot open", "transforms.json"]);
}

#[test]
fn an_error_s_text_is_its_own_and_nobody_prints_it_twice() {
    let folder = tempfile::tempdir().unwrap();
    let absent = read(&folder.path().join("absent")).unwrap_err();
    assert!(absent.source().is_none() && absent.to_string().matches("o such file").count() == 1, "{absent}");
    let mut document = document(&["a"]);
    document["frames"][0]["transform_matrix"][0][0] = json!(2);
    fs::write(folder.path().join("a.png"), photograph()).unwrap();
    fs::write(folder.path().join("transforms.json"), document.to_string()).unwrap();
    let wrong = read(folder.path()).unwrap_err();
    assert!(wrong.source().is_none() && wrong.to_string().contains("allowed is 2e-2"), "{wrong}");
}

/// A camera's scale and two decimals an entry are no reason to refuse a pose.
#[test]
fn scaled_and_rounded_rotations_are_read() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a.png"), photograph()).unwrap();
    fs::write(folder.path().join("b.png"), photograph()).unwrap();
    let mut document = document(&["a", "b"]);
    let rows = [[0.0, -0.87, 0.5, 1.0], [1.0, 0.0, 0.0, 2.0], [0.0, 0.5, 0.87, 3.0], [0.0, 0.0, 0.0, 1.0]];
    document["frames"][0]["transform_matrix"] = json!(rows);
    let scaled = rows.map(|[x, y, z, t]| [0.4 * x, 0.4 * y, 0.4 * z, t]);
    document["frames"][1]["transform_matrix"] = json!([scaled[0], scaled[1], scaled[2], rows[3]]);
    fs::write(folder.path().join("transforms.json"), document.to_string()).unwrap();
    let capture = read(folder.path()).unwrap();
    let [a, b] = [0, 1].map(|view: usize| capture.views[view].camera.pose);
    assert!((a.rotation - b.rotation).to_cols_array().iter().all(|v| v.abs() < 1e-12));
    assert_eq!(a.position, b.position);
    assert!((a.rotation.x_axis - glam::DVec3::Y).length() < 1e-9, "{}", a.rotation);
}

/// One LLFF row of a camera at the origin.
fn row() -> [f64; 17] {
    [0.0, 1.0, 0.0, 0.0, 48.0, 1.0, 0.0, 0.0, 0.0, 64.0, 0.0, 0.0, -1.0, 0.0, 55.0, 1.0, 9.0]
}

#[test]
fn hidden_files_are_no_photographs_of_llff() {
    let folder = tempfile::tempdir().unwrap();
    let images = folder.path().join("images");
    fs::create_dir(&images).unwrap();
    for name in ["1.png", "2.webp"] {
        fs::write(images.join(name), photograph()).unwrap();
        fs::write(images.join(format!("._{name}")), "what macOS leaves beside it").unwrap();
    }
    let data: Vec<u8> = [row(), row()].iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    fs::write(folder.path().join("poses_bounds.npy"), npy("<f8", "(2, 17)", &data)).unwrap();
    assert_eq!(names(&read(folder.path()).unwrap()), ["1.png", "2.webp"]);
}

#[test]
fn notes_say_which_folder_was_taken_and_whose_lenses_fold() {
    let folder = Colmap::small().folder();
    assert!(read(folder.path()).unwrap().notes().is_empty());
    let half = folder.path().join("images_2");
    fs::create_dir(&half).unwrap();
    for i in 1..4 {
        fs::write(half.join(format!("{i}.png")), photograph()).unwrap();
    }
    let notes = read(folder.path()).unwrap().notes();
    assert_eq!(notes, ["photographs are those in images; there is images_2, too (--images DIR)"]);
    let options = ReadOptions { images: Some("images_2".into()), ..Default::default() };
    let notes = Capture::read(folder.path(), &options).unwrap().notes();
    assert!(notes[0].contains("those in images_2; there is images, too"), "{notes:?}");
    fs::remove_dir_all(half).unwrap();

    let mut model = Colmap::small();
    model.cameras.push((2, 2, "SIMPLE_RADIAL", [64, 48], vec![55.0, 32.0, 24.0, -0.9]));
    model.images[1].camera = 2;
    model.write_bin(folder.path());
    let notes = read(folder.path()).unwrap().notes();
    assert_eq!(notes.len(), 1, "{notes:?}");
    assert!(notes[0].contains("of 2.png folds") && notes[0].contains("image_undistorter"), "{notes:?}");
}

/// With a chosen folder, photographs go by their file names, wherever the folder is.
#[test]
fn a_chosen_folder_for_transforms_may_lie_elsewhere() {
    let (folder, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    for name in ["a.JPG", "b.png"] {
        fs::write(elsewhere.path().join(name), photograph()).unwrap();
    }
    fs::write(folder.path().join("transforms.json"), document(&["images\\a", "images/b"]).to_string()).unwrap();
    refuses(read(folder.path()), &["images\\a", "--images DIR"]);
    let options = ReadOptions { images: Some(elsewhere.path().into()), ..Default::default() };
    let capture = Capture::read(folder.path(), &options).unwrap();
    assert_eq!(names(&capture), ["a.JPG", "b.png"]);
    assert_eq!(capture.photograph(0).unwrap().width(), 64);
}
