//! COLMAP's binary files, little-endian. No count is believed before the bytes
//! that it promises are known to be there, so that a header cannot make the
//! reader allocate more than the file is long.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use glam::DVec3;

use crate::cameras::lens::LensModel;
use crate::error::CaptureError;
use crate::import::colmap::parts::{Cameras, Image, Points, REMEDY, Seen, Size, insert, intrinsics, unsupported};
use crate::import::model::check_count;

/// Longest image name that is accepted, bytes.
const MAX_NAME_BYTES: usize = 4096;

/// Length of an observation in `images.bin`, bytes.
const OBSERVATION_BYTES: u64 = 24;

/// A file read from front to back, with what is left of it and where it is.
struct Reader {
    file: PathBuf,
    bytes: BufReader<File>,
    left: u64,
    /// What is being read, for errors: a kind of entry and its index.
    entry: (&'static str, u64),
}

impl Reader {
    fn open(path: &Path) -> Result<Self, CaptureError> {
        let file = File::open(path).map_err(CaptureError::io("open", path))?;
        let left = file.metadata().map_err(CaptureError::io("read", path))?.len();
        Ok(Self { file: path.to_path_buf(), bytes: BufReader::new(file), left, entry: ("header", 0) })
    }

    fn wrong(&self, expected: String, got: String) -> CaptureError {
        let entry = format!("{} {}", self.entry.0, self.entry.1);
        CaptureError::malformed(&self.file, entry, expected, got, REMEDY)
    }

    /// Refuses to go on unless `bytes` more bytes are there.
    fn need(&self, bytes: u64) -> Result<(), CaptureError> {
        if bytes > self.left {
            return Err(self.wrong(format!("{bytes} more bytes"), format!("{} before the file ends", self.left)));
        }
        Ok(())
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], CaptureError> {
        self.need(N as u64)?;
        let mut bytes = [0; N];
        self.bytes.read_exact(&mut bytes).map_err(CaptureError::io("read", &self.file))?;
        self.left -= N as u64;
        Ok(bytes)
    }

    fn u64(&mut self) -> Result<u64, CaptureError> {
        Ok(u64::from_le_bytes(self.take()?))
    }

    fn u32(&mut self) -> Result<u32, CaptureError> {
        Ok(u32::from_le_bytes(self.take()?))
    }

    fn f64(&mut self) -> Result<f64, CaptureError> {
        Ok(f64::from_le_bytes(self.take()?))
    }

    fn vector(&mut self) -> Result<DVec3, CaptureError> {
        Ok(DVec3::new(self.f64()?, self.f64()?, self.f64()?))
    }

    /// The number of entries that follow, each at least `min_bytes` bytes long.
    fn count(&mut self, min_bytes: u64) -> Result<u64, CaptureError> {
        let count = self.u64()?;
        if count > self.left / min_bytes {
            let got = format!("{count}, in a file with {} bytes left", self.left);
            return Err(self.wrong(format!("a count of entries of at least {min_bytes} bytes each"), got));
        }
        Ok(count)
    }

    /// Passes over `count` entries of `size` bytes.
    fn skip(&mut self, count: u64, size: u64) -> Result<(), CaptureError> {
        let bytes = count.saturating_mul(size);
        self.need(bytes)?;
        let offset = i64::try_from(bytes).map_err(|_| self.wrong("a file".to_owned(), format!("{bytes} bytes")))?;
        self.bytes.seek_relative(offset).map_err(CaptureError::io("read", &self.file))?;
        self.left -= bytes;
        Ok(())
    }

    /// `count` observations, x and y f64 and the point's number u64 each (all ones where it is none), of which those
    /// of `points` are counted.
    fn observations(&mut self, count: u64, points: &Points) -> Result<Seen, CaptureError> {
        self.need(count.saturating_mul(OBSERVATION_BYTES))?;
        let mut seen = Seen::default();
        for _ in 0..count {
            self.skip(1, 16)?;
            seen.observe(points, self.u64()?);
        }
        Ok(seen)
    }

    /// Text up to a zero byte.
    fn name(&mut self) -> Result<String, CaptureError> {
        let mut name = Vec::new();
        loop {
            match self.take::<1>()? {
                [0] => break,
                [_] if name.len() == MAX_NAME_BYTES => {
                    return Err(self.wrong(format!("a name of at most {MAX_NAME_BYTES} bytes"), "more".to_owned()));
                }
                [byte] => name.push(byte),
            }
        }
        String::from_utf8(name).map_err(|e| self.wrong("a name in UTF-8".to_owned(), e.to_string()))
    }

    /// Refuses bytes after the last entry: then the count is wrong.
    fn finish(self) -> Result<(), CaptureError> {
        if self.left > 0 {
            return Err(self.wrong("the end of the file after it".to_owned(), format!("{} more bytes", self.left)));
        }
        Ok(())
    }
}

/// `cameras.bin`: count; then id u32, model i32, width u64, height u64, parameters f64.
pub(super) fn cameras(path: &Path) -> Result<Cameras, CaptureError> {
    let mut reader = Reader::open(path)?;
    let count = reader.count(24 + 3 * 8)?;
    let mut cameras = Cameras::new();
    for index in 0..count {
        reader.entry = ("camera at index", index);
        let (id, model) = (reader.u32()?, reader.u32()?);
        let size = Size { width: reader.u64()?, height: reader.u64()? };
        let model = LensModel::from_colmap_number(model).map_err(|name| unsupported(path, id, name))?;
        let parameters = (0..model.parameters()).map(|_| reader.f64()).collect::<Result<Vec<_>, _>>()?;
        insert(path, &mut cameras, id, intrinsics(path, id, model, &size, &parameters)?)?;
    }
    reader.finish()?;
    Ok(cameras)
}

/// `images.bin`: count; then id u32, quaternion 4 f64, translation 3 f64, camera
/// u32, name, zero byte, count of observations u64 and 24 bytes for each.
/// What it observes of `points` becomes its support.
pub(super) fn images(path: &Path, max_views: usize, points: Option<&Points>) -> Result<Vec<Image>, CaptureError> {
    let mut reader = Reader::open(path)?;
    let count = reader.count(4 + 56 + 4 + 1 + 8)?;
    check_count(path, count, max_views)?;
    let mut images = Vec::with_capacity(count as usize);
    for index in 0..count {
        reader.entry = ("image at index", index);
        let id = reader.u32()?;
        let rotation = [reader.f64()?, reader.f64()?, reader.f64()?, reader.f64()?];
        let translation = reader.vector()?;
        let camera = reader.u32()?;
        let name = reader.name()?;
        let observations = reader.u64()?;
        let support = match points {
            None => {
                reader.skip(observations, OBSERVATION_BYTES)?;
                None
            }
            Some(points) => reader.observations(observations, points)?.support(),
        };
        images.push(Image { id, rotation, translation, camera, name, support });
    }
    reader.finish()?;
    Ok(images)
}

/// `points3D.bin`: count; then id u64, position 3 f64, colour 3 u8, error f64,
/// count of track elements u64 and 8 bytes for each.
pub(super) fn points(path: &Path) -> Result<Points, CaptureError> {
    let mut reader = Reader::open(path)?;
    let count = reader.count(8 + 24 + 3 + 8 + 8)?;
    let mut points = Points::default();
    for index in 0..count {
        reader.entry = ("point at index", index);
        let id = reader.u64()?;
        let point = reader.vector()?;
        reader.take::<3>()?;
        let error_px = reader.f64()?;
        let track = reader.u64()?;
        reader.skip(track, 8)?;
        points.push(path, id, point, error_px)?;
    }
    reader.finish()?;
    Ok(points.sort())
}
