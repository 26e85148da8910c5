//! `transforms.json` in its three dialects: NeRF-Synthetic (one file a split,
//! `camera_angle_x`, no file ending), instant-ngp and nerfstudio (`fl_x`, `k1`,
//! intrinsics for all frames or for each).
//!
//! All three state camera-to-world matrices in OpenGL axes (y up, looking along
//! -z); Cairn's are OpenCV's, so the second and third column change their sign.

use std::collections::HashSet;
use std::fmt;
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use cairn_durable::read_limited;
use glam::{DMat3, DVec3};
use serde::Deserialize;
use serde::de::{DeserializeSeed, Deserializer, IgnoredAny, SeqAccess, Visitor};
use serde_json::value::RawValue;

use crate::cameras::fisheye::Fisheye;
use crate::cameras::intrinsics::Intrinsics;
use crate::cameras::lens::{BrownConrady, Distortion, LensModel};
use crate::cameras::pose::Pose;
use crate::capture::LeftOut;
use crate::error::CaptureError;
use crate::images::format::Limits;
use crate::images::photograph::header;
use crate::import::model::{self, Entry, Guess, ImageFolder, Model, check_count};
use crate::import::named::{self, left_away};
use crate::import::options::ReadOptions;

const REMEDY: &str = "correct the file, or export it again";

/// A camera as JSON states it, for all frames or for one.
#[derive(Clone, Debug, Default, Deserialize)]
struct Lens {
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

/// A frame beside its [`Lens`]. Lists are kept as text until somebody counts them: JSON's `[[],[],...` takes eight
/// times its length as vectors, and what a reader does not know it need not keep at all.
#[derive(Deserialize)]
struct Frame<'a> {
    file_path: String,
    /// nerfstudio's mask of the frame.
    mask_path: Option<String>,
    #[serde(borrow)]
    transform_matrix: &'a RawValue,
}

/// The whole file beside its [`Lens`].
#[derive(Deserialize)]
struct Document<'a> {
    aabb_scale: Option<f64>,
    #[serde(borrow)]
    frames: &'a RawValue,
    /// nerfstudio's own split, where it brings one.
    #[serde(borrow)]
    test_filenames: Option<&'a RawValue>,
}

/// What a file says of the kind of scene, and its views.
struct Read {
    bounded: bool,
    entries: Vec<Entry>,
    /// Views that were left out: their names, and what would have been said.
    missing: Vec<(String, CaptureError)>,
}

/// A list of which at most `most` elements are kept, however many there are.
struct AtMost<T> {
    most: usize,
    of: PhantomData<T>,
}

impl<'de, T: Deserialize<'de>> DeserializeSeed<'de> for AtMost<T> {
    type Value = (Vec<T>, u64);

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de, T: Deserialize<'de>> Visitor<'de> for AtMost<T> {
    type Value = (Vec<T>, u64);

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Self::Value, A::Error> {
        let mut kept = Vec::new();
        while kept.len() < self.most {
            let Some(element) = list.next_element()? else { break };
            kept.push(element);
        }
        let mut count = kept.len() as u64;
        if kept.len() == self.most {
            while list.next_element::<IgnoredAny>()?.is_some() {
                count += 1;
            }
        }
        Ok((kept, count))
    }
}

/// Reads the transforms of `folder`; `None` where there are none. A split (`transforms_train.json`) comes before
/// `transforms.json`, unless `named` is that file.
///
/// # Errors
/// For JSON that is garbled, a frame that is no camera, a path that leaves the
/// folder, or a photograph that is missing.
pub(crate) fn read(folder: &Path, named: Option<&str>, options: &ReadOptions) -> Result<Option<Model>, CaptureError> {
    let train = folder.join("transforms_train.json");
    if named != Some("transforms.json") && train.is_file() {
        let Read { mut entries, mut missing, .. } = read_file(folder, &train, options, Some(false))?;
        let held = ["transforms_test.json", "transforms_val.json"].map(|name| folder.join(name));
        if let Some(held) = held.iter().find(|file| file.is_file()) {
            let held = read_file(folder, held, options, Some(true))?;
            entries.extend(held.entries);
            missing.extend(held.missing);
        }
        // No file of them, or none of their photographs is there: no split of its own.
        if !entries.iter().any(|e| e.held_out == Some(true)) {
            entries.iter_mut().for_each(|e| e.held_out = None);
        }
        let missing = names_of(missing, &entries)?;
        let left_out = LeftOut { missing, ..LeftOut::default() };
        return Ok(Some(Model { left_out, ..Model::new(train, Guess::Bounded, entries) }));
    }
    let file = folder.join("transforms.json");
    if !file.is_file() {
        return Ok(None);
    }
    let Read { bounded, entries, missing } = read_file(folder, &file, options, None)?;
    let missing = names_of(missing, &entries)?;
    let kind = if bounded { Guess::BoundedIfTransparent } else { Guess::Unbounded };
    let (images, left_out) = (image_folder(&entries, options), LeftOut { missing, ..LeftOut::default() });
    Ok(Some(Model { images, left_out, ..Model::new(file, kind, entries) }))
}

/// The one folder below the capture's own that all photographs lie in.
fn image_folder(entries: &[Entry], options: &ReadOptions) -> Option<ImageFolder> {
    let path = entries.first()?.photograph.parent().filter(|folder| !folder.as_os_str().is_empty())?;
    let holds_all = entries.iter().all(|entry| entry.photograph.parent() == Some(path));
    holds_all.then(|| ImageFolder { path: path.to_owned(), is_in_names: options.images.is_none() })
}

/// The names of what is missing, where something is there.
fn names_of(missing: Vec<(String, CaptureError)>, there: &[Entry]) -> Result<Vec<String>, CaptureError> {
    missing.into_iter().map(|(name, error)| if there.is_empty() { Err(error) } else { Ok(name) }).collect()
}

fn read_file(folder: &Path, file: &Path, options: &ReadOptions, held_out: Option<bool>) -> Result<Read, CaptureError> {
    let garbled = |e: serde_json::Error| {
        CaptureError::malformed(file, "the JSON", "transforms with frames and finite numbers", e.to_string(), REMEDY)
    };
    let most = options.limits.max_views;
    let bytes = read_limited(file, options.limits.max_file_bytes)?;
    // Windows' editors put a byte order mark first, which JSON does not know.
    let json = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
    let (document, all): (Document<'_>, Lens) = twice(json).map_err(garbled)?;
    let (frames, count) = list::<&RawValue>(document.frames, most).map_err(garbled)?;
    check_count(file, count, most)?;
    let test = document.test_filenames.map(|names| list::<String>(names, most)).transpose().map_err(garbled)?;
    let test: Option<HashSet<String>> = test.map(|(names, _)| names.iter().map(|path| named::plain(path)).collect());
    let mut missing = Vec::new();
    let entries = (frames.into_iter().enumerate())
        .map(|(index, raw)| {
            let (frame, own): (Frame<'_>, Lens) = twice(raw.get().as_bytes()).map_err(|e| {
                let expected = "a file_path, a transform_matrix and finite numbers";
                CaptureError::malformed(file, format!("frame {index}"), expected, e.to_string(), REMEDY)
            })?;
            let source = Source { folder, file, label: format!("frame {index} ({})", frame.file_path) };
            let photograph = match source.photograph(&frame.file_path, options) {
                // Here, where a camera without a stated size would take it from the photograph.
                Err(error @ CaptureError::PhotographMissing { .. }) if options.skip_missing => {
                    missing.push((named::plain(&frame.file_path), error));
                    return Ok(None);
                }
                found => found?,
            };
            let pose = source.pose(&source.matrix(frame.transform_matrix)?)?;
            let intrinsics = source.intrinsics(&own.or(&all), &photograph, &options.limits)?;
            // Where the folder was chosen, it is no part of the name: it may lie anywhere.
            let named = if options.images.is_some() { photograph.file_name().map(Path::new) } else { None };
            let name = named.unwrap_or(&photograph).to_string_lossy().replace('\\', "/");
            let in_test =
                |test: &HashSet<String>| test.contains(&name) || test.contains(&named::plain(&frame.file_path));
            let held_out = held_out.or_else(|| test.as_ref().map(in_test));
            let mask = frame.mask_path.as_deref().map(|path| source.mask(path)).transpose()?;
            let (label, bounds, support) = (source.label, None, None);
            Ok(Some(Entry { name, label, intrinsics, pose, photograph, bounds, mask, support, held_out }))
        })
        .filter_map(Result::transpose)
        .collect::<Result<Vec<_>, CaptureError>>()?;
    Ok(Read { bounded: document.aabb_scale.is_none_or(|scale| scale <= 1.0), entries, missing })
}

/// One JSON object as two structures that each take their own fields of it. Serde's `flatten` would do so as well, but
/// keeps everything that neither knows as a tree of many times its size.
fn twice<'a, A: Deserialize<'a>, B: Deserialize<'a>>(json: &'a [u8]) -> Result<(A, B), serde_json::Error> {
    Ok((serde_json::from_slice(json)?, serde_json::from_slice(json)?))
}

/// The first `most` elements of a list, and how many it has.
fn list<'a, T: Deserialize<'a>>(raw: &'a RawValue, most: usize) -> Result<(Vec<T>, u64), serde_json::Error> {
    AtMost { most, of: PhantomData }.deserialize(&mut serde_json::Deserializer::from_str(raw.get()))
}

impl Lens {
    /// This lens with what it does not state taken from `all`.
    fn or(self, all: &Self) -> Self {
        // A frame that states its focal length must not inherit another's angle,
        // nor the other way round: the nearer statement wins as a whole.
        let own_focal = self.fl_x.is_some() || self.camera_angle_x.is_some();
        let focal = |own: Option<f64>, all: Option<f64>| if own_focal { own } else { own.or(all) };
        Self {
            camera_model: self.camera_model.or_else(|| all.camera_model.clone()),
            is_fisheye: self.is_fisheye.or(all.is_fisheye),
            camera_angle_x: focal(self.camera_angle_x, all.camera_angle_x),
            camera_angle_y: focal(self.camera_angle_y, all.camera_angle_y),
            fl_x: focal(self.fl_x, all.fl_x),
            fl_y: focal(self.fl_y, all.fl_y),
            cx: self.cx.or(all.cx),
            cy: self.cy.or(all.cy),
            w: self.w.or(all.w),
            h: self.h.or(all.h),
            k1: self.k1.or(all.k1),
            k2: self.k2.or(all.k2),
            k3: self.k3.or(all.k3),
            k4: self.k4.or(all.k4),
            p1: self.p1.or(all.p1),
            p2: self.p2.or(all.p2),
        }
    }

    /// The family of lenses that the model is of: nerfstudio says so by `camera_model`, instant-ngp by `is_fisheye`.
    /// Both mean the polynomial of [`Fisheye`] by k1 to k4.
    ///
    /// # Errors
    /// What the model is called, where it is not one that Cairn reads.
    fn family(&self) -> Result<Family, String> {
        let stated = match &self.camera_model {
            Some(name) => Some(LensModel::from_name(name).ok_or_else(|| name.clone())?),
            None => None,
        };
        let fisheye = match (stated.map(LensModel::is_fisheye), self.is_fisheye) {
            (Some(false), Some(true)) => {
                return Err(format!("{} with is_fisheye", self.camera_model.as_deref().unwrap_or_default()));
            }
            (stated, flag) => stated.or(flag).unwrap_or(false),
        };
        let set = |name: &str, value: Option<f64>| value.filter(|&v| v != 0.0).map(|v| format!("with {name} = {v}"));
        // What the family does not have may stand there as 0.
        let foreign = if fisheye {
            set("p1", self.p1).or_else(|| set("p2", self.p2)).map(|p| format!("OPENCV_FISHEYE {p}"))
        } else {
            set("k4", self.k4)
        };
        foreign.map_or(Ok(if fisheye { Family::Fisheye } else { Family::Pinhole }), Err)
    }
}

/// What a model's coefficients are those of.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Family {
    Pinhole,
    Fisheye,
}

/// One frame, for its errors.
struct Source<'a> {
    folder: &'a Path,
    file: &'a Path,
    label: String,
}

impl Source<'_> {
    fn wrong(&self, expected: &str, got: String) -> CaptureError {
        CaptureError::malformed(self.file, self.label.clone(), expected, got, REMEDY)
    }

    /// The frame's photograph, relative to the folder ([`named::find`]).
    fn photograph(&self, path: &str, options: &ReadOptions) -> Result<PathBuf, CaptureError> {
        let mut stem = model::inside(path)
            .ok_or_else(|| self.wrong("a file_path inside the capture's folder", format!("{path:?}")))?;
        if let Some(images) = model::image_folder(self.folder, options, &[]) {
            stem = images.join(path.rsplit(['/', '\\']).next().unwrap_or_default());
        }
        named::find(self.folder, &stem, &left_away()).ok_or_else(|| {
            let (file, entry) = (self.file.to_path_buf(), self.label.clone());
            CaptureError::PhotographMissing { file, entry, photograph: self.folder.join(&stem) }
        })
    }

    /// The frame's mask, relative to the folder.
    fn mask(&self, path: &str) -> Result<PathBuf, CaptureError> {
        let path = model::inside(path)
            .ok_or_else(|| self.wrong("a mask_path inside the capture's folder", format!("{path:?}")))?;
        Ok(named::find(self.folder, &path, &[]).unwrap_or(path))
    }

    /// The rows of a matrix; of one that is too large as many as show it.
    fn matrix(&self, raw: &RawValue) -> Result<Vec<Vec<f64>>, CaptureError> {
        let read = || {
            let rows = list::<&RawValue>(raw, 5)?.0;
            rows.into_iter().map(|row| Ok(list(row, 5)?.0)).collect::<Result<_, serde_json::Error>>()
        };
        read().map_err(|e| self.wrong("a transform_matrix of finite numbers", e.to_string()))
    }

    /// From a 4 x 4 (or 3 x 4) camera-to-world matrix in OpenGL axes.
    fn pose(&self, matrix: &[Vec<f64>]) -> Result<Pose, CaptureError> {
        let sides = matches!(matrix.len(), 3 | 4) && matrix.iter().all(|row| row.len() == 4);
        if !sides || matrix.get(3).is_some_and(|last| last != &[0.0, 0.0, 0.0, 1.0]) {
            let got = matrix.get(3).map_or_else(|| format!("{} rows", matrix.len()), |last| format!("{last:?}"));
            return Err(self.wrong("a 4 x 4 transform_matrix whose last row is 0 0 0 1", got));
        }
        let column = |c: usize| DVec3::new(matrix[0][c], matrix[1][c], matrix[2][c]);
        let matrix = DMat3::from_cols(column(0), -column(1), -column(2));
        Pose::from_file(matrix, column(3)).map_err(|problem| CaptureError::Pose {
            file: self.file.to_path_buf(),
            entry: self.label.clone(),
            problem,
        })
    }

    /// The frame's camera; what the file does not state follows from the
    /// photograph's size: centred principal point, square pixels.
    fn intrinsics(&self, lens: &Lens, photograph: &Path, limits: &Limits) -> Result<Intrinsics, CaptureError> {
        let family = lens.family().map_err(|model| {
            let (file, entry) = (self.file.to_path_buf(), self.label.clone());
            CaptureError::UnsupportedCamera { file, entry, model }
        })?;
        let (width, height) = match (lens.w, lens.h) {
            (Some(w), Some(h)) => {
                let whole = |v: f64| (v.fract() == 0.0 && (1.0..=1e6).contains(&v)).then_some(v as usize);
                whole(w).zip(whole(h)).ok_or_else(|| self.wrong("w and h in whole pixels", format!("{w} and {h}")))?
            }
            (None, None) => header(&self.folder.join(photograph), limits)?.oriented,
            (w, h) => return Err(self.wrong("both w and h, or neither", format!("{w:?} and {h:?}"))),
        };
        let (fx, fy) = match family {
            Family::Pinhole => self.focal(lens, width as f64, height as f64)?,
            // An angle makes a focal length by a pinhole's tangent, which has none for 180 degrees.
            Family::Fisheye => lens
                .fl_x
                .or(lens.fl_y)
                .map(|f| (f, lens.fl_y.unwrap_or(f)))
                .ok_or_else(|| self.wrong("a fisheye's focal length: fl_x or fl_y", "neither".to_owned()))?,
        };
        let number = |v: Option<f64>| v.unwrap_or(0.0);
        let (k1, k2, k3) = (number(lens.k1), number(lens.k2), number(lens.k3));
        let distortion: Distortion = match family {
            Family::Pinhole => BrownConrady { k1, k2, k3, p1: number(lens.p1), p2: number(lens.p2) }.into(),
            Family::Fisheye => Fisheye::new([k1, k2, k3, number(lens.k4)]).into(),
        };
        let (cx, cy) = (lens.cx.unwrap_or(width as f64 / 2.0), lens.cy.unwrap_or(height as f64 / 2.0));
        Ok(Intrinsics { width, height, fx, fy, cx, cy, distortion })
    }

    /// Focal lengths across and down, px: stated, from the field of view
    /// (`f = w / (2 tan(angle / 2))`), or one from the other.
    fn focal(&self, lens: &Lens, width: f64, height: f64) -> Result<(f64, f64), CaptureError> {
        let angle = |side: f64, angle: Option<f64>| match angle {
            Some(a) if !(a > 0.0 && a < std::f64::consts::PI) => {
                Err(self.wrong("a camera_angle between 0 and pi (radians)", a.to_string()))
            }
            angle => Ok(angle.map(|a| 0.5 * side / (0.5 * a).tan())),
        };
        let x = lens.fl_x.map_or_else(|| angle(width, lens.camera_angle_x), |f| Ok(Some(f)))?;
        let y = lens.fl_y.map_or_else(|| angle(height, lens.camera_angle_y), |f| Ok(Some(f)))?;
        match (x, y) {
            (None, None) => Err(self.wrong("a focal length: fl_x or camera_angle_x", "neither".to_owned())),
            (x, y) => Ok((x.or(y).unwrap_or(0.0), y.or(x).unwrap_or(0.0))),
        }
    }
}
