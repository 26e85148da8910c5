//! Photographs in and out: orientation, transparency, depth, limits.

use std::fs;

use crate::common::{Colmap, hex, read, refuses, webp, webp_reference};
use cairn_scene::{
    Capture, Ground, Limits, Picture, ReadOptions, SceneFolder, decode_emblem, decode_picture, encode_png, save_png,
};
use image::{DynamicImage, ImageFormat, Rgb, RgbImage, Rgba, RgbaImage};
use serde_json::json;

fn bytes_of(image: DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut out = std::io::Cursor::new(Vec::new());
    image.write_to(&mut out, format).unwrap();
    out.into_inner()
}

/// A JPEG of 64 x 48 pixels, red in its top left quarter as stored and black
/// elsewhere, that says it is to be shown under EXIF `orientation`.
fn jpeg(orientation: u8) -> Vec<u8> {
    let stored = RgbImage::from_fn(64, 48, |x, y| if x < 32 && y < 24 { Rgb([255, 0, 0]) } else { Rgb([0; 3]) });
    with_orientation(&bytes_of(stored.into(), ImageFormat::Jpeg), orientation)
}

/// The JPEG `plain` with EXIF `orientation` written into it.
fn with_orientation(plain: &[u8], orientation: u8) -> Vec<u8> {
    // TIFF, little-endian, one entry: tag 0x112 (orientation), one SHORT.
    let mut exif = b"Exif\0\0II\x2a\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".to_vec();
    exif.extend([orientation, 0, 0, 0, 0, 0, 0, 0]);
    let mut out = vec![0xff, 0xd8, 0xff, 0xe1];
    out.extend((exif.len() as u16 + 2).to_be_bytes());
    out.extend(exif);
    out.extend(&plain[2..]);
    out
}

/// In which quarter (left?, top?) the red is.
fn red_corner(picture: &Picture) -> (bool, bool) {
    let (w, h) = (picture.width(), picture.height());
    let is_red = |x: usize, y: usize| picture.pixel(x, y)[0] > 0.8;
    let found: Vec<_> = [(true, true), (false, true), (true, false), (false, false)]
        .into_iter()
        .filter(|&(left, top)| is_red(if left { w / 4 } else { w * 3 / 4 }, if top { h / 4 } else { h * 3 / 4 }))
        .collect();
    assert_eq!(found.len(), 1, "one red quarter");
    found[0]
}

/// Where each EXIF orientation puts the stored top left corner (TIFF 6.0,
/// tag 274: which sides the stored row 0 and column 0 are).
#[test]
fn exif_orientation_is_honoured() {
    for (orientation, left, top, turned) in [
        (1, true, true, false),
        (2, false, true, false),
        (3, false, false, false),
        (4, true, false, false),
        (5, true, true, true),
        (6, false, true, true),
        (7, false, false, true),
        (8, true, false, true),
    ] {
        let picture = decode_picture(&jpeg(orientation), &Limits::default(), None).unwrap();
        let size = if turned { (48, 64) } else { (64, 48) };
        assert_eq!((picture.width(), picture.height()), size, "orientation {orientation}");
        assert_eq!(red_corner(&picture), (left, top), "orientation {orientation}");
    }
}

#[test]
fn the_camera_says_which_pixels_it_means() {
    let folder = Colmap::small().folder();
    fs::write(folder.path().join("images/2.png"), jpeg(6)).unwrap();
    // The camera is 64 x 48, as the pixels are stored: it was computed on those.
    let picture = read(folder.path()).unwrap().photograph(1).unwrap();
    assert_eq!((picture.width(), picture.height(), red_corner(&picture)), (64, 48, (true, true)));
    // A camera of 48 x 64 means the photograph as it is looked at.
    let mut model = Colmap::small();
    model.cameras[0].3 = [48, 64];
    model.write_bin(folder.path());
    for name in ["1.png", "3.png"] {
        fs::write(folder.path().join("images").join(name), jpeg(6)).unwrap();
    }
    let picture = read(folder.path()).unwrap().photograph(1).unwrap();
    assert_eq!((picture.width(), picture.height(), red_corner(&picture)), (48, 64, (false, true)));
}

/// Where a photograph has the camera's size both ways, the format says which pixels the camera was computed on.
#[test]
fn the_format_says_which_pixels_are_meant_where_sizes_do_not() {
    let square = |orientation: u8| {
        let stored = RgbImage::from_fn(48, 48, |x, y| if x < 24 && y < 24 { Rgb([255, 0, 0]) } else { Rgb([0; 3]) });
        with_orientation(&bytes_of(stored.into(), ImageFormat::Jpeg), orientation)
    };
    // Orientations that keep the sides' lengths, and one that swaps those of a square: where the red is looked at.
    for (bytes, size, oriented) in [
        (jpeg(2), (64, 48), (false, true)),
        (jpeg(3), (64, 48), (false, false)),
        (jpeg(4), (64, 48), (true, false)),
        (square(6), (48, 48), (false, true)),
    ] {
        let mut model = Colmap::small();
        model.cameras[0].3 = [size.0 as u64, size.1 as u64];
        let folder = model.folder();
        let names = ["1.png", "2.png", "3.png"];
        names.iter().for_each(|name| fs::write(folder.path().join("images").join(name), &bytes).unwrap());
        let capture = read(folder.path()).unwrap();
        let picture = capture.photograph(1).unwrap();
        assert_eq!((picture.width(), picture.height(), red_corner(&picture)), (size.0, size.1, (true, true)));
        // It is so in the stored scene, too.
        let scene = SceneFolder::create(&folder.path().join("scenes"), "town", &capture).unwrap();
        assert_eq!(red_corner(&scene.photograph(1).unwrap()), (true, true));
        let scene = SceneFolder::open(&folder.path().join("scenes"), "town").unwrap();
        assert_eq!(red_corner(&scene.photograph(1).unwrap()), (true, true));

        fs::remove_dir_all(folder.path().join("sparse")).unwrap();
        let matrix = json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]);
        let frames = names.map(|n| json!({"file_path": format!("images/{n}"), "transform_matrix": matrix}));
        let document = json!({"fl_x": 55, "w": size.0, "h": size.1, "frames": frames});
        fs::write(folder.path().join("transforms.json"), document.to_string()).unwrap();
        assert_eq!(red_corner(&read(folder.path()).unwrap().photograph(1).unwrap()), oriented);
    }
}

#[test]
fn transparency_is_composited() {
    let pixels = [[255, 0, 0, 255], [255, 0, 0, 0], [0, 0, 0, 51], [255, 255, 255, 51]];
    let rgba = RgbaImage::from_fn(4, 1, |x, _| Rgba(pixels[x as usize]));
    let bytes = bytes_of(rgba.into(), ImageFormat::Png);
    let close = |a: [f32; 3], b: [f32; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
    let white = decode_picture(&bytes, &Limits::default(), None).unwrap();
    let blue = decode_picture(&bytes, &Limits::default(), Some([0.0, 0.0, 1.0])).unwrap();
    assert!(close(white.pixel(0, 0), [1.0, 0.0, 0.0]) && close(blue.pixel(0, 0), [1.0, 0.0, 0.0]));
    assert!(close(white.pixel(1, 0), [1.0; 3]) && close(blue.pixel(1, 0), [0.0, 0.0, 1.0]));
    assert!(close(white.pixel(2, 0), [0.8; 3]) && close(blue.pixel(2, 0), [0.0, 0.0, 0.8]));
    assert!(close(blue.pixel(3, 0), [0.2, 0.2, 1.0]));
}

/// WebP as libwebp reads it (reference/webp.py).
#[test]
fn webp_has_the_pixels_that_its_own_library_reads() {
    let reference = webp_reference();
    let size = ["width", "height"].map(|side| reference[side].as_u64().unwrap() as usize);
    let cases = reference["cases"].as_object().unwrap();
    let read: Vec<&String> =
        cases.iter().filter(|(_, case)| case["pixels"].is_string()).map(|(name, _)| name).collect();
    assert_eq!(read.len(), 6);
    for name in read {
        let pixels = hex(&cases[name]["pixels"]);
        let black = decode_picture(&webp(name), &Limits::default(), Some([0.0; 3])).unwrap();
        let is_turned = name.contains("turned");
        let [width, height] = if is_turned { [size[1], size[0]] } else { size };
        assert_eq!((black.width(), black.height()), (width, height), "{name}");
        let channels = if cases[name]["mode"] == "RGBA" { 4 } else { 3 };
        for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
            // Orientation 6: the stored first row is the right column.
            let (column, row) = if is_turned { (y, width - 1 - x) } else { (x, y) };
            let stored = &pixels[(row * size[0] + column) * channels..][..channels];
            let alpha = f32::from(*stored.get(3).unwrap_or(&255)) / 255.0;
            let expected = [0, 1, 2].map(|c| f32::from(stored[c]) / 255.0 * alpha);
            let apart = expected.iter().zip(black.pixel(x, y)).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(apart < 1e-6, "{name}, {x}, {y}: {expected:?}, got {:?}", black.pixel(x, y));
        }
    }
}

/// A WebP takes every way that a PNG takes: EXIF by the camera, the scene's folder, the emblem.
#[test]
fn webp_photographs_are_kept_as_they_are() {
    let mut model = Colmap::small();
    model.cameras[0].3 = [21, 18];
    let folder = model.folder();
    for (name, case) in [("1.png", "lossy"), ("2.png", "lossless, turned"), ("3.png", "lossless, alpha")] {
        fs::write(folder.path().join("images").join(name), webp(case)).unwrap();
    }
    let capture = read(folder.path()).unwrap();
    // The camera is 21 x 18, as the pixels are stored.
    let stored = capture.photograph(1).unwrap();
    assert_eq!(stored, decode_picture(&webp("lossless"), &Limits::default(), None).unwrap());
    let scene = SceneFolder::create(&folder.path().join("scenes"), "town", &capture).unwrap();
    assert_eq!(scene.photograph(1).unwrap(), stored);
    let kept = folder.path().join("scenes/town/photographs/000001.webp");
    assert_eq!(fs::read(kept).unwrap(), webp("lossless, turned"));
    let (shown, ground) = decode_emblem(&webp("lossless, alpha"), &Limits::default(), 16).unwrap();
    assert_eq!((shown.width(), ground), (16, Ground::White));
    assert_eq!(decode_emblem(&webp("lossy"), &Limits::default(), 16).unwrap().1, Ground::None);
}

#[test]
fn sixteen_bits_and_grey_keep_their_values() {
    let deep = image::ImageBuffer::<Rgb<u16>, Vec<u16>>::from_fn(3, 2, |x, y| Rgb([1000, x as u16, y as u16 + 7]));
    let picture =
        decode_picture(&bytes_of(DynamicImage::ImageRgb16(deep), ImageFormat::Png), &Limits::default(), None).unwrap();
    assert!((picture.pixel(2, 1)[0] * 65535.0 - 1000.0).abs() < 0.01);
    assert!((picture.pixel(2, 1)[2] * 65535.0 - 8.0).abs() < 0.01);
    let grey = image::GrayImage::from_pixel(2, 2, image::Luma([51]));
    let picture = decode_picture(&bytes_of(grey.into(), ImageFormat::Png), &Limits::default(), None).unwrap();
    assert!(picture.pixel(1, 1).iter().all(|v| (v - 0.2).abs() < 1e-6));
}

/// CRC-32 as PNG's specification gives it, bit by bit.
fn crc(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, &b| {
        (0..8).fold(crc ^ u32::from(b), |c, _| if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 })
    })
}

#[test]
fn a_header_that_claims_a_billion_pixels_is_refused_on_the_header() {
    let mut bomb = encode_png(&Picture::constant(4, 4, [0.5; 3]));
    let claim = |png: &mut Vec<u8>, w: u32, h: u32| {
        png[16..20].copy_from_slice(&w.to_be_bytes());
        png[20..24].copy_from_slice(&h.to_be_bytes());
        let sum = crc(&png[12..29]);
        png[29..33].copy_from_slice(&sum.to_be_bytes());
    };
    claim(&mut bomb, 60_000, 60_000);
    refuses(decode_picture(&bomb, &Limits::default(), None), &["longest side in pixels is 60000", "limit is 16384"]);
    claim(&mut bomb, 16_000, 16_000);
    refuses(decode_picture(&bomb, &Limits::default(), None), &["number of pixels is 256000000", "limit is 100000000"]);
    let folder = Colmap::small().folder();
    fs::write(folder.path().join("images/2.png"), &bomb).unwrap();
    refuses(read(folder.path()), &["2.png", "number of pixels is 256000000"]);
    // One that grew after it was read is refused by its camera's size, on the header too.
    let capture = {
        fs::write(folder.path().join("images/2.png"), crate::common::photograph()).unwrap();
        read(folder.path()).unwrap()
    };
    claim(&mut bomb, 9_000, 9_000);
    fs::write(folder.path().join("images/2.png"), &bomb).unwrap();
    refuses(capture.photograph(1), &["2.png", "64 x 48", "9000 x 9000"]);
}

#[test]
fn other_formats_and_garbage_are_refused() {
    for bytes in [
        &b"GIF89a\x01\0\x01\0"[..],
        b"",
        b"\x89PNG\r\n\x1a\n",
        b"\xff\xd8\xff",
        b"RIFF\0\0\0\0WEBPVP8 ",
        b"RIFF\x04\0\0\0WAVE",
    ] {
        refuses(decode_picture(bytes, &Limits::default(), None), &["picture cannot be decoded as PNG, JPEG or WebP"]);
    }
    let whole = jpeg(6);
    for length in (0..whole.len()).step_by(7) {
        // Whatever a decoder makes of half a JPEG, it must not panic.
        let _ = decode_picture(&whole[..length], &Limits::default(), None);
    }
    let small = Limits { max_file_bytes: 10, ..Limits::default() };
    refuses(decode_picture(&whole, &small, None), &["file size in bytes", "limit is 10"]);
}

#[test]
fn png_round_trips_and_saves_whole() {
    let rgb: Vec<f32> = (0..5 * 3 * 3).map(|v| v as f32 * 5.0 / 255.0).collect();
    let picture = Picture::new(5, 3, rgb).unwrap();
    let back = decode_picture(&encode_png(&picture), &Limits::default(), None).unwrap();
    assert_eq!(back.to_rgb8(), picture.to_rgb8());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    fs::write(&path, "old").unwrap();
    let mut broken = picture.clone();
    broken.rgb_mut()[3 * 6 + 1] = f32::NAN;
    refuses(save_png(&path, &broken), &["a.png", "NaN", "column 1, row 1"]);
    assert_eq!(fs::read(&path).unwrap(), b"old");
    save_png(&path, &picture).unwrap();
    assert_eq!(fs::read(&path).unwrap(), encode_png(&picture));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left beside it");
    refuses(save_png(&folder.path().join("no/such/b.png"), &picture), &["cannot create", "b.png"]);
}

#[test]
fn a_chosen_folder_of_photographs_is_used() {
    let folder = Colmap::small().folder();
    let half = folder.path().join("half");
    fs::create_dir(&half).unwrap();
    for i in 1..4 {
        fs::write(half.join(format!("{i}.png")), encode_png(&Picture::constant(32, 24, [0.0; 3]))).unwrap();
    }
    for images in ["half".into(), half.clone()] {
        let options = ReadOptions { images: Some(images), ..Default::default() };
        let capture = Capture::read(folder.path(), &options).unwrap();
        let i = capture.views[0].camera.intrinsics;
        assert_eq!((i.width, i.height, i.fx, i.cy), (32, 24, 27.5, 12.5));
        assert_eq!(&*capture.views[0].photograph, std::path::Path::new("half/1.png"));
        assert_eq!(capture.photograph(0).unwrap().width(), 32);
    }
}
