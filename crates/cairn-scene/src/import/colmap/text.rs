//! COLMAP's text files: one entry a line (images: two), `#` starts a comment.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use glam::DVec3;

use crate::cameras::lens::LensModel;
use crate::error::CaptureError;
use crate::import::colmap::parts::{Cameras, Image, Points, REMEDY, Seen, Size, insert, intrinsics, unsupported};
use crate::import::model::check_count;

/// Longest line that is accepted, bytes: an image's observations, some 30 bytes each. A file without line ends is
/// not taken into memory whole.
const MAX_LINE_BYTES: u64 = 16 << 20;

/// Most parameters that are read of a camera: one more than any model has.
const MAX_PARAMETERS: usize = LensModel::MAX_PARAMETERS + 1;

/// Lines of a file with their numbers.
struct Reader {
    file: PathBuf,
    bytes: BufReader<File>,
    number: usize,
}

impl Reader {
    fn open(path: &Path) -> Result<Self, CaptureError> {
        let file = File::open(path).map_err(CaptureError::io("open", path))?;
        Ok(Self { file: path.to_path_buf(), bytes: BufReader::new(file), number: 0 })
    }

    /// The next line, whatever it holds; `None` at the end.
    fn any(&mut self) -> Result<Option<String>, CaptureError> {
        self.number += 1;
        let mut line = Vec::new();
        let read = (&mut self.bytes).take(MAX_LINE_BYTES + 1).read_until(b'\n', &mut line);
        let read = read.map_err(CaptureError::io("read", &self.file))?;
        if read as u64 > MAX_LINE_BYTES {
            return Err(self.wrong("a line of at most 16 MiB", "a longer one".to_owned()));
        }
        if read == 0 {
            return Ok(None);
        }
        let line = String::from_utf8(line).map_err(|e| self.wrong("a line in UTF-8", e.to_string()))?;
        // Windows' editors put a byte order mark first.
        let text = if self.number == 1 { line.trim_start_matches('\u{feff}') } else { &line };
        Ok(Some(text.trim_end_matches(['\n', '\r']).to_owned()))
    }

    /// The next line that is neither empty nor a comment; `None` at the end.
    fn entry(&mut self) -> Result<Option<String>, CaptureError> {
        while let Some(line) = self.any()? {
            if !line.trim().is_empty() && !line.starts_with('#') {
                return Ok(Some(line));
            }
        }
        Ok(None)
    }

    /// The line of observations that follows an image's: X Y POINT3D_ID, any number of times, of which those of
    /// `points` are counted. It is looked at even where there are none: where a file leaves these lines out, every
    /// other image would be taken for one and lost.
    fn observations(&mut self, points: Option<&Points>) -> Result<Seen, CaptureError> {
        let mut seen = Seen::default();
        let Some(line) = self.any()? else { return Ok(seen) };
        let mut fields = line.split_ascii_whitespace();
        while let Some(x) = fields.next() {
            let (y, id) = (fields.next().unwrap_or_default(), fields.next().unwrap_or_default());
            if ![x, y, id].iter().all(|field| field.parse::<f64>().is_ok()) {
                let got: String = line.chars().take(40).collect();
                let expected = "a line of observations (it may be empty) after each image's";
                return Err(self.wrong(expected, format!("{got:?}")));
            }
            // -1 is the number of no point.
            if let (Some(points), Ok(id)) = (points, id.parse()) {
                seen.observe(points, id);
            }
        }
        Ok(seen)
    }

    fn wrong(&self, expected: &str, got: String) -> CaptureError {
        CaptureError::malformed(&self.file, format!("line {}", self.number), expected, got, REMEDY)
    }

    /// The next field as a number; `what` names it.
    fn field<'a, T: FromStr>(
        &self,
        fields: &mut impl Iterator<Item = &'a str>,
        what: &'static str,
    ) -> Result<T, CaptureError> {
        let text = fields.next().ok_or_else(|| self.wrong(what, "the end of the line".to_owned()))?;
        text.parse().map_err(|_| self.wrong(what, format!("{text:?}")))
    }

    fn vector<'a>(
        &self,
        fields: &mut impl Iterator<Item = &'a str>,
        what: &'static str,
    ) -> Result<DVec3, CaptureError> {
        Ok(DVec3::new(self.field(fields, what)?, self.field(fields, what)?, self.field(fields, what)?))
    }
}

/// `cameras.txt`: CAMERA_ID MODEL WIDTH HEIGHT PARAMS...
pub(super) fn cameras(path: &Path) -> Result<Cameras, CaptureError> {
    let mut reader = Reader::open(path)?;
    let mut cameras = Cameras::new();
    while let Some(line) = reader.entry()? {
        let mut fields = line.split_ascii_whitespace();
        let id = reader.field(&mut fields, "a camera number")?;
        let model = fields.next().ok_or_else(|| reader.wrong("a camera model", "the end of the line".to_owned()))?;
        let model = LensModel::from_name(model).ok_or_else(|| unsupported(path, id, model.to_owned()))?;
        let width = reader.field(&mut fields, "a width in pixels")?;
        let size = Size { width, height: reader.field(&mut fields, "a height in pixels")? };
        let parameters = fields
            .take(MAX_PARAMETERS)
            .map(|text| reader.field(&mut [text].into_iter(), "a camera parameter"))
            .collect::<Result<Vec<f64>, _>>()?;
        insert(path, &mut cameras, id, intrinsics(path, id, model, &size, &parameters)?)?;
    }
    Ok(cameras)
}

/// `images.txt`: IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then a line of
/// observations, which may be empty. What it observes of `points` becomes its support.
pub(super) fn images(path: &Path, max_views: usize, points: Option<&Points>) -> Result<Vec<Image>, CaptureError> {
    let mut reader = Reader::open(path)?;
    let mut images = Vec::new();
    while let Some(line) = reader.entry()? {
        let mut fields = line.split_ascii_whitespace();
        let id = reader.field(&mut fields, "an image number")?;
        let mut rotation = [0.0; 4];
        for v in &mut rotation {
            *v = reader.field(&mut fields, "a quaternion's number")?;
        }
        let translation = reader.vector(&mut fields, "a translation's number")?;
        let camera = reader.field(&mut fields, "a camera number")?;
        // A name may hold spaces, and is the last field.
        let name = after_fields(&line, 9).to_owned();
        if name.is_empty() {
            return Err(reader.wrong("an image name", "the end of the line".to_owned()));
        }
        check_count(path, images.len() as u64 + 1, max_views)?;
        let seen = reader.observations(points)?;
        let support = points.and_then(|_| seen.support());
        images.push(Image { id, rotation, translation, camera, name, support });
    }
    Ok(images)
}

/// What follows the first `count` fields of `line`, trimmed.
fn after_fields(line: &str, count: usize) -> &str {
    let mut rest = line.trim();
    for _ in 0..count {
        rest = rest.find(|c: char| c.is_ascii_whitespace()).map_or("", |end| rest[end..].trim_start());
    }
    rest
}

/// `points3D.txt`: POINT3D_ID X Y Z R G B ERROR TRACK...
pub(super) fn points(path: &Path) -> Result<Points, CaptureError> {
    let mut reader = Reader::open(path)?;
    let mut points = Points::default();
    while let Some(line) = reader.entry()? {
        let mut fields = line.split_ascii_whitespace();
        let id = reader.field(&mut fields, "a point number")?;
        let point = reader.vector(&mut fields, "a coordinate")?;
        let mut fields = fields.skip(3);
        let error_px = reader.field(&mut fields, "a reprojection error")?;
        points.push(path, id, point, error_px)?;
    }
    Ok(points.sort())
}
