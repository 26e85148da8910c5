//! What a picture's keypoints are matched with: keypoints of a field's renders from about where its photographs were
//! taken, and of the photographs themselves, each with the place in space that it shows, by the field's depth.
//!
//! Renders are what marked pictures are made of; photographs are what other photographs are like where the field is
//! not.

use std::io::{Read, Seek};

use crate::keypoints::{DESCRIPTOR, Keypoint, keypoints};
use crate::sizes::{ratio, shrunk, smaller};
use cairn_field::stats::median;
use cairn_field::{Field, FieldError, Part, Rendering, TensorFile, distance, packed};
use cairn_scene::{Camera, Picture};
use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;
use safetensors::Dtype;
use serde::{Deserialize, Serialize};

/// Format of a stored index; another one is refused by name.
pub const INDEX_FORMAT: &str = "cairn.places/1";
/// Views that an index is made of, at most: a larger scene's are thinned evenly.
pub const MAX_VIEWS: usize = 128;
/// Longest side of the renders that keypoints are looked for in, px.
pub(crate) const RENDERED_PX: usize = 300;
/// Longest side of the pictures that keypoints are looked for in, px: of photographs, and of what is asked about. What is
/// finer in one has no counterpart in the other.
pub(crate) const PHOTOGRAPHED_PX: usize = 400;
/// Keypoints of a picture that are kept, at most.
const KEPT: usize = 600;
/// Where less than this share of the light is stopped, there is no place.
const MIN_ACCUMULATION: f32 = 0.7;
/// Where depths around a keypoint differ by a larger share, it shows an edge, and no one place.
const MAX_SPREAD: f64 = 0.1;
/// What errors call the file.
const WHAT: &str = "index of places";

/// A view that an index is made of.
pub struct Reference<'a> {
    /// Its camera.
    pub camera: Camera,
    /// Its name, by which the field knows its appearance.
    pub name: &'a str,
    /// Brings its photograph; `None` where there is none, or it cannot be read.
    pub photograph: Box<dyn Fn() -> Option<Picture> + Send + Sync + 'a>,
}

impl std::fmt::Debug for Reference<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Reference").field("name", &self.name).finish_non_exhaustive()
    }
}

/// Keypoints with places; see the module's text.
#[derive(Clone, Debug, PartialEq)]
pub struct Index {
    /// The cameras, of the size that their renders had.
    pub(crate) cameras: Vec<Camera>,
    /// Names of their views.
    pub(crate) names: Vec<String>,
    /// Middling distance from cameras to what they see, capture units.
    pub(crate) reach: f64,
    pub(crate) points: Vec<Point>,
    /// The points' descriptors, in their order.
    pub(crate) descriptors: Vec<[u8; DESCRIPTOR]>,
}

/// A keypoint's place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Point {
    /// Where, capture units from the first camera.
    pub(crate) place: Vec3,
    /// What a pixel of the render spans there, capture units.
    pub(crate) span: f32,
    /// Of the keypoint, px of the view's render.
    pub(crate) scale: f32,
    /// Of the keypoint, radians.
    pub(crate) angle: f32,
    /// The camera, by its number.
    pub(crate) view: u32,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    format: String,
    reach: f64,
    cameras: Vec<Camera>,
    names: Vec<String>,
}

impl Index {
    /// Of `field`, as `references` show it: evenly thinned to [`MAX_VIEWS`]. `went` gets how many of how many are done,
    /// and says whether it is still wanted; `None` once it is not, or without references.
    pub fn build(
        field: &Field,
        references: &[Reference<'_>],
        went: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Option<Self> {
        let count = references.len().min(MAX_VIEWS);
        let origin = references.first()?.camera.pose.position;
        let chosen: Vec<&Reference<'_>> = (0..count).map(|k| &references[k * references.len() / count]).collect();
        let (mut views, mut done) = (Vec::with_capacity(count), 0);
        // Some at a time, so that it can be given up, and few photographs are in memory.
        for some in chosen.chunks(2 * rayon::current_num_threads()) {
            if !went(done, count) {
                return None;
            }
            views.par_extend(some.par_iter().map(|reference| ViewPoints::of(field, reference, origin)));
            done += some.len();
        }
        let mut index =
            Self { cameras: Vec::new(), names: Vec::new(), reach: 0.0, points: Vec::new(), descriptors: Vec::new() };
        for (view, (reference, of)) in chosen.iter().zip::<Vec<ViewPoints>>(views).enumerate() {
            index.points.extend(of.points.into_iter().map(|point| Point { view: view as u32, ..point }));
            index.descriptors.extend(of.descriptors);
            index.cameras.push(of.camera);
            index.names.push(reference.name.to_owned());
        }
        let away = |k: usize| (index.place(k) - index.cameras[index.points[k].view as usize].pose.position).length();
        index.reach = median((0..index.points.len()).map(away).collect());
        Some(index)
    }

    /// The index without what `view` told: a photograph that is looked for in it is not found by its own keypoints.
    #[must_use]
    pub fn without(&self, view: &str) -> Self {
        let others = |(point, _): &(&Point, &[u8; DESCRIPTOR])| self.names[point.view as usize] != view;
        let (points, descriptors) = self.points.iter().zip(&self.descriptors).filter(others).unzip();
        Self { cameras: self.cameras.clone(), names: self.names.clone(), reach: self.reach, points, descriptors }
    }

    /// How many keypoints it has.
    pub fn points(&self) -> usize {
        self.points.len()
    }

    /// Where point `k` is, capture units.
    pub(crate) fn place(&self, k: usize) -> DVec3 {
        self.cameras[0].pose.position + self.points[k].place.as_dvec3()
    }

    /// The index as safetensors with a versioned header. Equal indices give equal bytes.
    ///
    /// # Errors
    /// [`FieldError::Stored`] when it cannot be written out.
    pub fn to_bytes(&self) -> Result<Vec<u8>, FieldError> {
        let header = Header {
            format: INDEX_FORMAT.into(),
            reach: self.reach,
            cameras: self.cameras.clone(),
            names: self.names.clone(),
        };
        let floats = |of: &dyn Fn(&Point) -> [f32; 6]| -> Vec<u8> {
            self.points.iter().flat_map(of).flat_map(f32::to_le_bytes).collect()
        };
        let places = floats(&|p| [p.place.x, p.place.y, p.place.z, p.span, p.scale, p.angle]);
        let views: Vec<u8> = self.points.iter().flat_map(|p| p.view.to_le_bytes()).collect();
        let parts = [
            Part::row("descriptor", Dtype::U8, self.descriptors.as_flattened()),
            Part::row("place", Dtype::F32, &places),
            Part::row("view", Dtype::U32, &views),
        ];
        packed(WHAT, &header, parts)
    }

    /// Reads what [`Index::to_bytes`] wrote.
    ///
    /// # Errors
    /// [`FieldError::Stored`] for an unknown format or a damaged file, [`FieldError::Read`] for one that cannot be read.
    pub fn read_from(file: &mut (impl Read + Seek)) -> Result<Self, FieldError> {
        let mut file = TensorFile::open(file, WHAT)?;
        let Header { reach, cameras, names, .. } = file.header(INDEX_FORMAT)?;
        let descriptors = file.numbers("descriptor", Dtype::U8, |[v]| v)?;
        let places = file.numbers("place", Dtype::F32, f32::from_le_bytes)?;
        let views = file.numbers("view", Dtype::U32, u32::from_le_bytes)?;
        let damaged = |why: &str| FieldError::Stored { what: WHAT, why: why.into() };
        let (descriptors, []) = descriptors.as_chunks::<DESCRIPTOR>() else {
            return Err(damaged("its last descriptor ends early"));
        };
        let (places, []) = places.as_chunks::<6>() else { return Err(damaged("its last place ends early")) };
        if places.len() != views.len() || places.len() != descriptors.len() || cameras.len() != names.len() {
            return Err(damaged("its parts do not fit together"));
        }
        let bad = places.as_flattened().iter().any(|v| !v.is_finite())
            || places.iter().any(|p| p[3] <= 0.0 || p[4] <= 0.0)
            || views.iter().any(|view| *view as usize >= cameras.len())
            // Of a field in which nothing has a place there is no distance.
            || !((reach > 0.0 || places.is_empty()) && reach.is_finite())
            || cameras.iter().any(|c| !c.pose.position.is_finite());
        if bad {
            return Err(damaged("it has a place or a view that there cannot be"));
        }
        let point = |(p, view): (&[f32; 6], &u32)| Point {
            place: Vec3::new(p[0], p[1], p[2]),
            span: p[3],
            scale: p[4],
            angle: p[5],
            view: *view,
        };
        let points = places.iter().zip(&views).map(point).collect();
        Ok(Self { cameras, names, reach, points, descriptors: descriptors.to_vec() })
    }
}

/// A view's keypoints with places.
struct ViewPoints {
    /// Of the size of its render.
    camera: Camera,
    points: Vec<Point>,
    descriptors: Vec<[u8; DESCRIPTOR]>,
}

impl ViewPoints {
    fn of(field: &Field, reference: &Reference<'_>, origin: DVec3) -> Self {
        let camera = shrunk(&reference.camera, RENDERED_PX);
        let seen = Seen::at(field, &camera, field.appearance_of(reference.name));
        let photograph = (reference.photograph)().map(|p| smaller(&p, PHOTOGRAPHED_PX));
        let (mut points, mut descriptors) = (Vec::new(), Vec::new());
        for picture in std::iter::once(&seen.maps.picture).chain(&photograph) {
            let size = [camera.intrinsics.width, camera.intrinsics.height];
            let ratio = ratio(size, [picture.width(), picture.height()]);
            for keypoint in keypoints(picture, KEPT) {
                let Some((place, depth)) = seen.place(keypoint.at * ratio) else { continue };
                points.push(Point {
                    place: (place - origin).as_vec3(),
                    span: (depth / camera.intrinsics.fx) as f32,
                    scale: keypoint.scale * ratio.x as f32,
                    angle: keypoint.angle,
                    view: 0,
                });
                descriptors.push(keypoint.descriptor);
            }
        }
        Self { camera, points, descriptors }
    }
}

/// What a field shows at a camera, with places.
pub(crate) struct Seen<'a> {
    field: &'a Field,
    pub(crate) camera: Camera,
    pub(crate) maps: Rendering,
}

impl<'a> Seen<'a> {
    pub(crate) fn at(field: &'a Field, camera: &Camera, light: &cairn_field::Appearance) -> Self {
        let mut maps = field.render_maps(camera, light);
        maps.picture.rgb_mut().iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
        Self { field, camera: *camera, maps }
    }

    /// The place that image point `at` (px) shows, capture units, and its distance along the axis; `None` where the field
    /// is thin there, or breaks off.
    pub(crate) fn place(&self, at: DVec2) -> Option<(DVec3, f64)> {
        let (w, h) = (self.camera.intrinsics.width, self.camera.intrinsics.height);
        let (x, y) = ((at.x as usize).min(w - 1), (at.y as usize).min(h - 1));
        let around = [
            (x, y),
            (x.saturating_sub(1), y),
            ((x + 1).min(w - 1), y),
            (x, y.saturating_sub(1)),
            (x, (y + 1).min(h - 1)),
        ];
        let depths = around.map(|(x, y)| f64::from(self.maps.depth[y * w + x]));
        if around.iter().any(|(x, y)| self.maps.accumulation[y * w + x] < MIN_ACCUMULATION) {
            return None;
        }
        let (origin, direction) = self.camera.ray(at.x, at.y);
        let frame = self.field.frame();
        let away = depths.map(|along| distance(frame, origin, direction, along));
        let here = away[0]?;
        if away.iter().any(|a| a.is_none_or(|a| (a - here).abs() > MAX_SPREAD * here)) {
            return None;
        }
        let place = origin + direction * here;
        (place.is_finite() && here > 0.0).then(|| (place, here * direction.dot(self.camera.pose.forward()).abs()))
    }
}

/// The keypoints of a render that have places.
pub(crate) fn placed(seen: &Seen<'_>, count: usize) -> Vec<(Keypoint, DVec3)> {
    let of = |keypoint: Keypoint| Some((keypoint, seen.place(keypoint.at)?.0));
    keypoints(&seen.maps.picture, count).into_iter().filter_map(of).collect()
}
