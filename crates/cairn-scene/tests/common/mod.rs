//! Small captures written to a temporary folder, as their own formats want them.
#![allow(dead_code, reason = "every test binary uses its own share of these")]

use std::fs;
use std::path::Path;

use cairn_scene::{Capture, CaptureError, Picture, ReadOptions, encode_png};
use tempfile::TempDir;

/// Width and height of the photographs, px.
pub const SIZE: (usize, usize) = (64, 48);

/// One image of a COLMAP model.
#[derive(Clone)]
pub struct Image {
    pub id: u32,
    pub quaternion: [f64; 4],
    pub translation: [f64; 3],
    pub camera: u32,
    pub name: String,
}

/// A camera: number, model number, model name, size, parameters.
pub type ColmapCamera = (u32, i32, &'static str, [u64; 2], Vec<f64>);

/// A COLMAP model, to be written as binary or text.
#[derive(Clone)]
pub struct Colmap {
    pub cameras: Vec<ColmapCamera>,
    pub images: Vec<Image>,
    pub points: Vec<[f64; 3]>,
    /// Observations of each image but every other one, which has none, and track elements of each point.
    pub tracks: usize,
}

impl Colmap {
    /// Three views of a few points by one pinhole.
    pub fn small() -> Self {
        let image = |id: u32| Image {
            id,
            quaternion: [1.0, 0.0, 0.0, 0.0],
            translation: [f64::from(id), 0.5, 2.0],
            camera: 1,
            name: format!("{id}.png"),
        };
        Self {
            cameras: vec![(1, 1, "PINHOLE", [64, 48], vec![55.0, 57.5, 31.0, 25.0])],
            images: (1..4).map(image).collect(),
            points: vec![[0.0, 0.1, 1.0], [0.2, -0.1, 3.0]],
            tracks: 2,
        }
    }

    /// What the `i`th image observes: where, px, and which point, -1 for none.
    fn observations(&self, i: usize) -> Vec<(f64, f64, i64)> {
        let count = if i.is_multiple_of(2) { 0 } else { self.tracks };
        let point = |k: usize| if k % 3 == 1 { -1 } else { ((i + k) % self.points.len().max(1)) as i64 };
        (0..count).map(|k| (1.5 + k as f64, 2.5, point(k))).collect()
    }

    /// How far off a point's observations are on average, px.
    fn error_px(point: usize) -> f64 {
        0.5 + point as f64 / 8.0
    }

    pub fn cameras_bin(&self) -> Vec<u8> {
        let mut out = (self.cameras.len() as u64).to_le_bytes().to_vec();
        for (id, model, _, size, parameters) in &self.cameras {
            out.extend(id.to_le_bytes());
            out.extend(model.to_le_bytes());
            out.extend(size.iter().flat_map(|v| v.to_le_bytes()));
            out.extend(parameters.iter().flat_map(|v| v.to_le_bytes()));
        }
        out
    }

    pub fn images_bin(&self) -> Vec<u8> {
        let mut out = (self.images.len() as u64).to_le_bytes().to_vec();
        for (i, image) in self.images.iter().enumerate() {
            out.extend(image.id.to_le_bytes());
            out.extend(image.quaternion.iter().chain(&image.translation).flat_map(|v| v.to_le_bytes()));
            out.extend(image.camera.to_le_bytes());
            out.extend(image.name.as_bytes());
            out.push(0);
            let seen = self.observations(i);
            out.extend((seen.len() as u64).to_le_bytes());
            for (x, y, point) in seen {
                out.extend([x, y].iter().flat_map(|v| v.to_le_bytes()));
                out.extend(point.to_le_bytes());
            }
        }
        out
    }

    pub fn points_bin(&self) -> Vec<u8> {
        let mut out = (self.points.len() as u64).to_le_bytes().to_vec();
        for (id, point) in self.points.iter().enumerate() {
            out.extend((id as u64).to_le_bytes());
            out.extend(point.iter().flat_map(|v| v.to_le_bytes()));
            out.extend([1, 2, 3]);
            out.extend(Self::error_px(id).to_le_bytes());
            out.extend((self.tracks as u64).to_le_bytes());
            out.extend((0..2 * self.tracks as u32).flat_map(|v| v.to_le_bytes()));
        }
        out
    }

    /// Writes the binary model into `folder/sparse/0`.
    pub fn write_bin(&self, folder: &Path) {
        let place = folder.join("sparse/0");
        fs::create_dir_all(&place).unwrap();
        fs::write(place.join("cameras.bin"), self.cameras_bin()).unwrap();
        fs::write(place.join("images.bin"), self.images_bin()).unwrap();
        fs::write(place.join("points3D.bin"), self.points_bin()).unwrap();
    }

    /// Writes the text model into `folder/sparse`.
    pub fn write_text(&self, folder: &Path) {
        let place = folder.join("sparse");
        fs::create_dir_all(&place).unwrap();
        let joined = |numbers: &[f64]| numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
        let mut cameras = "# Camera list with one line of data per camera:\n".to_owned();
        for (id, _, name, [w, h], parameters) in &self.cameras {
            cameras += &format!("{id} {name} {w} {h} {}\n", joined(parameters));
        }
        let mut images = "# Image list with two lines of data per image:\n".to_owned();
        for (i, image) in self.images.iter().enumerate() {
            let Image { id, quaternion, translation, camera, name } = image;
            images += &format!("{id} {} {} {camera} {name}\n", joined(quaternion), joined(translation));
            // An image without observations has an empty second line.
            let seen = self.observations(i).into_iter().map(|(x, y, point)| format!("{x} {y} {point}"));
            images += &format!("{}\n", seen.collect::<Vec<_>>().join(" "));
        }
        let mut points = String::new();
        for (id, point) in self.points.iter().enumerate() {
            let track: Vec<String> = (0..2 * self.tracks).map(|v| v.to_string()).collect();
            points += &format!("{id} {} 1 2 3 {} {}\n", joined(point), Self::error_px(id), track.join(" "));
        }
        fs::write(place.join("cameras.txt"), cameras).unwrap();
        fs::write(place.join("images.txt"), images).unwrap();
        fs::write(place.join("points3D.txt"), points).unwrap();
    }

    /// Writes a photograph for every image into `folder/images`.
    pub fn write_photographs(&self, folder: &Path) {
        fs::create_dir_all(folder.join("images")).unwrap();
        for image in &self.images {
            fs::write(folder.join("images").join(&image.name), photograph()).unwrap();
        }
    }

    /// A temporary folder with the binary model and its photographs.
    pub fn folder(&self) -> TempDir {
        let folder = tempfile::tempdir().unwrap();
        self.write_bin(folder.path());
        self.write_photographs(folder.path());
        folder
    }
}

/// A PNG of the usual size.
pub fn photograph() -> Vec<u8> {
    encode_png(&Picture::constant(SIZE.0, SIZE.1, [0.2, 0.4, 0.6]))
}

/// The file of a case of reference/webp.json, which libwebp wrote.
pub fn webp(case: &str) -> Vec<u8> {
    hex(&webp_reference()["cases"][case]["file"])
}

/// reference/webp.json.
pub fn webp_reference() -> serde_json::Value {
    serde_json::from_str(include_str!("../reference/webp.json")).unwrap()
}

/// The bytes that hexadecimal digits say.
pub fn hex(digits: &serde_json::Value) -> Vec<u8> {
    let digits = digits.as_str().unwrap().as_bytes();
    digits.chunks(2).map(|two| u8::from_str_radix(std::str::from_utf8(two).unwrap(), 16).unwrap()).collect()
}

/// A RIFF file of the form WEBP with these chunks, each padded to an even length.
pub fn riff_webp(chunks: &[Chunk<'_>]) -> Vec<u8> {
    let mut body = b"WEBP".to_vec();
    for Chunk { name, data } in chunks {
        body.extend_from_slice(*name);
        body.extend((data.len() as u32).to_le_bytes());
        body.extend_from_slice(data);
        body.resize(body.len().next_multiple_of(2), 0);
    }
    [&b"RIFF"[..], &(body.len() as u32).to_le_bytes(), &body].concat()
}

/// A chunk of a RIFF file.
pub struct Chunk<'a> {
    pub name: &'a [u8; 4],
    pub data: &'a [u8],
}

/// A NumPy file of format version 1.
pub fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
    while !(10 + header.len() + 1).is_multiple_of(64) {
        header.push(' ');
    }
    header.push('\n');
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    out.extend((header.len() as u16).to_le_bytes());
    out.extend(header.as_bytes());
    out.extend(data);
    out
}

/// Reads with default options.
pub fn read(folder: &Path) -> Result<Capture, CaptureError> {
    Capture::read(folder, &ReadOptions::default())
}

/// The error's text, which must name every one of `parts`.
#[track_caller]
pub fn refuses<T>(result: Result<T, CaptureError>, parts: &[&str]) {
    let text = match result {
        Ok(_) => panic!("accepted what should be refused for {parts:?}"),
        Err(error) => error.to_string(),
    };
    for part in parts {
        assert!(text.contains(part), "the error does not say {part:?}: {text}");
    }
}
