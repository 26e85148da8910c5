//! Masks: each way they come in, what they come to, and what is refused.

use std::fs;
use std::path::{Path, PathBuf};

use crate::common::{Colmap, SIZE, photograph, refuses};
use cairn_scene::{Capture, CaptureError, Mask, ReadOptions, SceneFolder};
use serde_json::json;
use tempfile::TempDir;

/// A mask that leaves out column `out`, as an 8-bit grey PNG.
fn mask_png(width: usize, height: usize, out: u32) -> Vec<u8> {
    mask_in(image::ImageFormat::Png, width, height, out)
}

fn mask_in(format: image::ImageFormat, width: usize, height: usize, out: u32) -> Vec<u8> {
    let grey =
        image::GrayImage::from_fn(width as u32, height as u32, |x, _| image::Luma([if x == out { 127 } else { 128 }]));
    let mut bytes = std::io::Cursor::new(Vec::new());
    grey.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

fn write_mask(path: &Path, out: u32) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, mask_png(SIZE.0, SIZE.1, out)).unwrap();
}

/// The column that a mask leaves out.
fn left_out(mask: &Mask) -> usize {
    assert_eq!((mask.width(), mask.height(), mask.used_pixels()), (SIZE.0, SIZE.1, (SIZE.0 - 1) * SIZE.1));
    (0..SIZE.0).find(|&x| !mask.uses(x, 0)).unwrap()
}

/// The columns that the views' masks leave out.
fn columns(capture: &Capture) -> Vec<Option<usize>> {
    (0..capture.views.len()).map(|view| capture.mask(view).unwrap().map(|mask| left_out(&mask))).collect()
}

fn read_with(folder: &Path, masks: Option<&str>) -> Result<Capture, CaptureError> {
    Capture::read(folder, &ReadOptions { masks: masks.map(PathBuf::from), ..ReadOptions::default() })
}

/// Three frames of a transforms.json, of which the second names a mask.
fn transforms(mask_path: &str) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("images")).unwrap();
    let frame = |i: usize| {
        fs::write(folder.path().join(format!("images/{i}.png")), photograph()).unwrap();
        let matrix = [[1.0, 0.0, 0.0, i as f64], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 4.0], [0.0, 0.0, 0.0, 1.0]];
        let mut frame = json!({ "file_path": format!("images/{i}.png"), "transform_matrix": matrix });
        if i == 1 {
            frame["mask_path"] = json!(mask_path);
        }
        frame
    };
    let file = json!({ "fl_x": 55.0, "frames": (0..3).map(frame).collect::<Vec<_>>() });
    fs::write(folder.path().join("transforms.json"), file.to_string()).unwrap();
    folder
}

#[test]
fn colmap_keeps_masks_beside_the_photographs() {
    let folder = Colmap::small().folder();
    write_mask(&folder.path().join("masks/1.png.png"), 3);
    write_mask(&folder.path().join("masks/3.png"), 5);
    let capture = read_with(folder.path(), None).unwrap();
    assert_eq!(columns(&capture), [Some(3), None, Some(5)]);
    // A WebP is one, too; a JPEG smears the edge and is none; a PNG comes first.
    let webp = |out| mask_in(image::ImageFormat::WebP, SIZE.0, SIZE.1, out);
    fs::write(folder.path().join("masks/2.webp"), webp(7)).unwrap();
    fs::write(folder.path().join("masks/1.png.webp"), webp(9)).unwrap();
    assert_eq!(columns(&read_with(folder.path(), None).unwrap()), [Some(3), Some(7), Some(5)]);
    fs::rename(folder.path().join("masks/2.webp"), folder.path().join("masks/2.jpg")).unwrap();
    assert_eq!(columns(&read_with(folder.path(), None).unwrap()), [Some(3), None, Some(5)]);
}

#[test]
fn a_frame_names_its_mask() {
    let folder = transforms("./masks\\second.png");
    write_mask(&folder.path().join("masks/second.png"), 7);
    assert_eq!(columns(&read_with(folder.path(), None).unwrap()), [None, Some(7), None]);
    fs::remove_file(folder.path().join("masks/second.png")).unwrap();
    refuses(read_with(folder.path(), None), &["transforms.json", "frame 1", "second.png", "mask_path"]);
    let outside = transforms("../secret.png");
    refuses(read_with(outside.path(), None), &["frame 1", "mask_path inside", "../secret.png"]);
}

#[test]
fn a_folder_that_is_named_comes_before_what_the_format_says() {
    let folder = transforms("masks/second.png");
    write_mask(&folder.path().join("masks/second.png"), 7);
    // With the photographs' folders, or by file name alone.
    write_mask(&folder.path().join("others/images/0.png.png"), 9);
    write_mask(&folder.path().join("others/2.png"), 11);
    assert_eq!(columns(&read_with(folder.path(), Some("others")).unwrap()), [Some(9), None, Some(11)]);
    let elsewhere = tempfile::tempdir().unwrap();
    write_mask(&elsewhere.path().join("1.png"), 13);
    let absolute = elsewhere.path().to_str().unwrap();
    assert_eq!(columns(&read_with(folder.path(), Some(absolute)).unwrap()), [None, Some(13), None]);
    refuses(read_with(folder.path(), Some("absent")), &["open", "absent"]);
    fs::create_dir(folder.path().join("empty")).unwrap();
    refuses(read_with(folder.path(), Some("empty")), &["empty", "at least one mask", "--masks"]);
}

#[test]
fn a_mask_of_another_size_is_refused_with_both_sizes() {
    let folder = Colmap::small().folder();
    let mask = folder.path().join("masks/2.png");
    fs::create_dir(folder.path().join("masks")).unwrap();
    fs::write(&mask, mask_png(48, 64, 0)).unwrap();
    refuses(read_with(folder.path(), None), &["masks/2.png", "48 x 64", "64 x 48", "--masks"]);
}

#[test]
fn a_hostile_mask_is_refused_and_nothing_of_it_is_kept() {
    let folder = Colmap::small().folder();
    let mask = folder.path().join("masks/2.png");
    fs::create_dir(folder.path().join("masks")).unwrap();
    let good = mask_png(SIZE.0, SIZE.1, 0);
    // A header of a billion pixels is refused before one is allocated.
    let mut huge = good.clone();
    huge[16..24].copy_from_slice(&[0, 0, 0x80, 0, 0, 0, 0x80, 0]);
    for bad in [Vec::new(), b"GIF89a".to_vec(), good[..30].to_vec(), huge] {
        fs::write(&mask, &bad).unwrap();
        refuses(read_with(folder.path(), None), &["masks/2.png"]);
    }
    // What only breaks behind its header is found when the scene is made.
    let mut broken = good;
    // The first byte of the compressed pixels, behind signature, header and the chunk's own beginning.
    broken[41] ^= 0xff;
    fs::write(&mask, &broken).unwrap();
    let scenes = tempfile::tempdir().unwrap();
    let capture = read_with(folder.path(), None).unwrap();
    refuses(SceneFolder::create(scenes.path(), "a", &capture), &["masks/2.png"]);
    assert_eq!(fs::read_dir(scenes.path()).unwrap().count(), 0);
}

#[test]
fn a_scene_keeps_masks_bound_to_their_bytes() {
    let folder = Colmap::small().folder();
    write_mask(&folder.path().join("masks/2.png"), 4);
    let scenes = tempfile::tempdir().unwrap();
    let made = SceneFolder::create(scenes.path(), "a", &read_with(folder.path(), None).unwrap()).unwrap();
    let scene = SceneFolder::open(scenes.path(), "a").unwrap();
    assert_eq!(scene.capture(), made.capture());
    let mask = scene.mask(1).unwrap().unwrap();
    assert_eq!(left_out(&mask), 4);
    assert_eq!(scene.mask(0).unwrap(), None);
    let view = scene.train_view(1).unwrap();
    assert_eq!((view.camera, view.mask.as_ref()), (scene.capture().views[1].camera, Some(&mask)));
    assert!(view.uses(3, 0) && !view.uses(4, 0));
    assert_eq!(view.rgb8.to_picture(), scene.photograph(1).unwrap());
    let half = view.resized(SIZE.0 / 2, SIZE.1 / 2);
    assert_eq!(
        (half.rgb8.width(), half.camera.intrinsics.width, half.uses(1, 0), half.uses(2, 0)),
        (32, 32, true, false)
    );

    // A changed byte shows.
    let file = scene.folder().join("masks/000001.png");
    let bytes = fs::read(&file).unwrap();
    fs::write(&file, &bytes[..bytes.len() - 1]).unwrap();
    refuses(scene.mask(1), &["masks/000001.png"]);
}
