//! Everything here that reads bytes of contributors', as functions of bytes: what the property tests and the fuzz
//! targets of `fuzz/` share.
//!
//! Captures are read from folders, so a target writes its input over one file of a good capture and reads that. A reader
//! may refuse; what it takes is finite, within the limits, and names nothing outside the folder.
#![allow(dead_code)] // Every binary that takes these uses its own part.

use std::cell::OnceCell;
use std::fs;
use std::path::Component;

use cairn_scene::{
    Capture, Distortion, Limits, ReadOptions, Sound, SoundLimits, decode_picture, decode_wav, encode_wav,
};
use tempfile::TempDir;

use crate::common::{Colmap, npy, photograph, webp};

/// One reader.
pub struct Target {
    pub name: &'static str,
    /// Input that it takes.
    pub good: fn() -> Vec<Vec<u8>>,
    /// What it may allocate at its peak: bytes for each byte of input, and bytes beside.
    pub limit: (usize, usize),
    /// Reads; panics where the reader breaks its word.
    pub read: fn(&[u8]),
}

/// A view is some hundred bytes for a line or entry of a few dozen, in lists that grow by doubling; reading three small
/// photographs' headers takes the rest.
const CAPTURE: (usize, usize) = (24, 768 << 10);
/// The pixels of the limits below, in every form that decoding brings them through, and the decoder's tables.
const PICTURE: (usize, usize) = (8, 4 << 20);

/// As of other pictures; a part of a lossy frame may say that it has 16 MiB, which the decoder believes.
const WEBP: (usize, usize) = (8, 20 << 20);

/// A byte is at most one sample; errors take the rest.
const SOUND: (usize, usize) = (8, 64 << 10);

/// All readers.
pub const TARGETS: [Target; 13] = [
    Target { name: "cameras.bin", good: cameras, limit: CAPTURE, read: cameras_bin },
    Target { name: "images.bin", good: || vec![Colmap::small().images_bin()], limit: CAPTURE, read: images_bin },
    Target { name: "points3D.bin", good: || vec![Colmap::small().points_bin()], limit: CAPTURE, read: points_bin },
    Target { name: "cameras.txt", good: || colmap_text("cameras.txt"), limit: CAPTURE, read: cameras_txt },
    Target { name: "images.txt", good: || colmap_text("images.txt"), limit: CAPTURE, read: images_txt },
    Target { name: "points3D.txt", good: || colmap_text("points3D.txt"), limit: CAPTURE, read: points_txt },
    Target { name: "transforms.json", good: transforms, limit: CAPTURE, read: transforms_json },
    Target { name: "poses_bounds.npy", good: poses_bounds, limit: CAPTURE, read: llff },
    Target { name: "contributors.csv", good: contributors, limit: CAPTURE, read: contributors_csv },
    Target { name: "png", good: || vec![photograph(), grey_png()], limit: PICTURE, read: picture },
    Target { name: "jpeg", good: || vec![jpeg()], limit: PICTURE, read: picture },
    Target { name: "webp", good: webps, limit: WEBP, read: picture },
    Target { name: "wav", good: wavs, limit: SOUND, read: wav },
];

/// The target called `name`.
pub fn target(name: &str) -> &'static Target {
    TARGETS.iter().find(|target| target.name == name).unwrap()
}

/// The limits that pictures are decoded under here: a little more than the good ones need.
pub fn limits() -> Limits {
    Limits { max_file_bytes: 1 << 20, max_side_px: 200, max_pixels: 10_000, max_views: 100 }
}

/// Of a pinhole, and of a pinhole and two fisheyes.
fn cameras() -> Vec<Vec<u8>> {
    let mut lenses = Colmap::small();
    let fisheye = vec![24.0, 25.0, 31.0, 25.0, 0.05, -0.01, 0.003, -0.0005];
    lenses.cameras.push((2, 5, "OPENCV_FISHEYE", [64, 48], fisheye));
    lenses.cameras.push((3, 8, "SIMPLE_RADIAL_FISHEYE", [64, 48], vec![24.0, 31.0, 25.0, -0.04]));
    vec![Colmap::small().cameras_bin(), lenses.cameras_bin()]
}

fn colmap_text(file: &str) -> Vec<Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    Colmap::small().write_text(folder.path());
    vec![fs::read(folder.path().join("sparse").join(file)).unwrap()]
}

fn transforms() -> Vec<Vec<u8>> {
    let frame = |name: &str| {
        format!(r#"{{"file_path":"{name}","transform_matrix":[[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]],"k1":0.01}}"#)
    };
    let frames = [frame("1.png"), frame("./2"), frame("3.png")].join(",");
    let plain = format!(r#"{{"fl_x":55.0,"aabb_scale":4,"frames":[{frames}]}}"#);
    let full = format!(
        r#"{{"camera_angle_x":0.7,"w":64,"h":48,"cx":32,"cy":24,"camera_model":"OPENCV","made by":["a",{{"b":[1,2]}}],
        "test_filenames":["1.png"],"frames":[{frames}]}}"#
    );
    let fisheye = format!(r#"{{"camera_model":"OPENCV_FISHEYE","fl_x":55.0,"k4":0.001,"frames":[{frames}]}}"#);
    vec![plain.into_bytes(), full.into_bytes(), fisheye.into_bytes()]
}

fn poses_bounds() -> Vec<Vec<u8>> {
    let row = [0.0, 1.0, 0.0, 0.0, 48.0, 1.0, 0.0, 0.0, 0.0, 64.0, 0.0, 0.0, -1.0, 0.0, 55.0, 1.0, 9.0];
    let data: Vec<u8> = [row; 3].iter().flatten().flat_map(|v: &f64| v.to_le_bytes()).collect();
    let single: Vec<u8> = [row; 3].iter().flatten().flat_map(|v| (*v as f32).to_le_bytes()).collect();
    vec![npy("<f8", "(3, 17)", &data), npy("<f4", "(3, 17)", &single)]
}

fn contributors() -> Vec<Vec<u8>> {
    let plain = "image,contributor\n1.png,ana\n2.png,ben\n3.png,ana\n";
    let quoted = "\u{feff}note,contributor,image\n,ana, 1.png\n\"a\n\"\"b\"\"\",\"Ben, jr\",2.png\n,ana,3.png\n";
    vec![plain.into(), quoted.into()]
}

fn grey_png() -> Vec<u8> {
    let mut out = Vec::new();
    let picture = image::GrayAlphaImage::from_fn(40, 30, |x, y| image::LumaA([(x * y) as u8, (x + y) as u8]));
    picture.write_to(&mut std::io::Cursor::new(&mut out), image::ImageFormat::Png).unwrap();
    out
}

/// A small JPEG.
pub fn jpeg() -> Vec<u8> {
    let mut out = Vec::new();
    let picture = image::RgbImage::from_fn(40, 30, |x, y| image::Rgb([(6 * x) as u8, (8 * y) as u8, 128]));
    picture.write_to(&mut std::io::Cursor::new(&mut out), image::ImageFormat::Jpeg).unwrap();
    out
}

/// Small WebP files, lossy and lossless, with and without alpha and EXIF.
pub fn webps() -> Vec<Vec<u8>> {
    ["lossy", "lossy, alpha", "lossless", "lossless, alpha", "lossy, turned", "lossless, turned"].map(webp).into()
}

/// Small WAV files: ours, and one of two channels and 24 bits with a foreign chunk.
fn wavs() -> Vec<Vec<u8>> {
    let ours = encode_wav(&Sound::new((0..200).map(|i| (i as f32 * 0.2).sin()).collect(), 16_000).unwrap());
    let data: Vec<u8> = (0..600u32).map(|i| (i * 7) as u8).collect();
    let format = [1u16, 2, 0xac44, 0, 0x0998, 4, 6, 24].iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let chunk = |name: &[u8; 4], body: &[u8]| [&name[..], &(body.len() as u32).to_le_bytes(), body].concat();
    let body = [b"WAVE".to_vec(), chunk(b"LIST", b"INFO"), chunk(b"fmt ", &format), chunk(b"data", &data)].concat();
    vec![ours, chunk(b"RIFF", &body)]
}

fn wav(input: &[u8]) {
    let limits = SoundLimits { max_file_bytes: 1 << 20, longest_s: 1.0 };
    if let Ok(sound) = decode_wav("a", input, &limits) {
        assert!(sound.seconds() <= 1.0 && sound.samples().len() <= input.len());
        assert!(sound.samples().iter().all(|v| v.is_finite()));
        assert_eq!(decode_wav("b", &encode_wav(&sound), &limits).unwrap().to_pcm16(), sound.to_pcm16());
    }
}

/// Which capture a target's file is part of.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Binary,
    Text,
    Transforms,
    Llff,
}

fn place(kind: Kind) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let model = Colmap::small();
    match kind {
        Kind::Binary => model.write_bin(folder.path()),
        Kind::Text => model.write_text(folder.path()),
        Kind::Transforms | Kind::Llff => {}
    }
    if kind == Kind::Transforms {
        model.images.iter().for_each(|i| fs::write(folder.path().join(&i.name), photograph()).unwrap());
    } else {
        model.write_photographs(folder.path());
    }
    folder
}

thread_local! {
    /// One folder a thread and kind, made once: a case costs one file.
    static PLACES: [OnceCell<TempDir>; 4] = const { [const { OnceCell::new() }; 4] };
}

/// Writes `input` as `file` of a good capture of this kind, and reads that.
fn read_as(kind: Kind, file: &str, input: &[u8]) {
    PLACES.with(|places| {
        let folder = places[kind as usize].get_or_init(|| place(kind)).path();
        let path = folder.join(file);
        let before = fs::read(&path).ok();
        fs::write(&path, input).unwrap();
        let contributors = file.ends_with(".csv").then(|| path.clone());
        let read = Capture::read(folder, &ReadOptions { contributors, limits: limits(), ..ReadOptions::default() });
        match before {
            Some(good) => fs::write(&path, good).unwrap(),
            None => fs::remove_file(&path).unwrap(),
        }
        match read {
            Ok(capture) => sound(&capture),
            Err(refused) => assert!(!refused.to_string().is_empty()),
        }
    });
}

/// What must hold of everything that was taken.
fn sound(capture: &Capture) {
    assert!((1..=limits().max_views).contains(&capture.views.len()));
    for view in &capture.views {
        let (i, pose) = (&view.camera.intrinsics, &view.camera.pose);
        assert!(pose.rotation.is_finite() && pose.position.is_finite(), "{view:?}");
        assert!([i.fx, i.fy, i.cx, i.cy].iter().all(|v| v.is_finite()) && i.fx > 0.0 && i.fy > 0.0, "{view:?}");
        assert!(i.width <= limits().max_side_px && i.height <= limits().max_side_px, "{view:?}");
        if let Distortion::Fisheye(_) = i.distortion {
            let corners = [[0, 0], [i.width, 0], [0, i.height], [i.width, i.height]].map(|c| c.map(|v| v as f64));
            let seen = corners.map(|[x, y]| (view.camera.direction(x, y).length() - 1.0).abs() < 1e-9);
            assert_eq!(seen, [true; 4], "{view:?}");
        }
        assert!(!view.contributor.is_empty());
        let stays = |part| matches!(part, Component::Normal(_));
        assert!(view.photograph.components().all(stays), "{view:?} leaves the folder");
    }
    assert!(capture.points.iter().all(|p| p.is_finite()));
}

pub fn cameras_bin(input: &[u8]) {
    read_as(Kind::Binary, "sparse/0/cameras.bin", input);
}

pub fn images_bin(input: &[u8]) {
    read_as(Kind::Binary, "sparse/0/images.bin", input);
}

pub fn points_bin(input: &[u8]) {
    read_as(Kind::Binary, "sparse/0/points3D.bin", input);
}

pub fn cameras_txt(input: &[u8]) {
    read_as(Kind::Text, "sparse/cameras.txt", input);
}

pub fn images_txt(input: &[u8]) {
    read_as(Kind::Text, "sparse/images.txt", input);
}

pub fn points_txt(input: &[u8]) {
    read_as(Kind::Text, "sparse/points3D.txt", input);
}

pub fn transforms_json(input: &[u8]) {
    read_as(Kind::Transforms, "transforms.json", input);
}

pub fn llff(input: &[u8]) {
    read_as(Kind::Llff, "poses_bounds.npy", input);
}

pub fn contributors_csv(input: &[u8]) {
    read_as(Kind::Binary, "who.csv", input);
}

/// A picture as the daemon is sent one.
pub fn picture(input: &[u8]) {
    if let Ok(picture) = decode_picture(input, &limits(), None) {
        assert!(picture.width() * picture.height() <= limits().max_pixels as usize);
        assert!(picture.rgb().iter().all(|v| (0.0..=1.0).contains(v)));
    }
}
