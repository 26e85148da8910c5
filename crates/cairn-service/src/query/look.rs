//! Rendering, asking who contributed, and identifying pictures.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use cairn_field::Appearance;
use cairn_scene::{Camera, Picture};

use crate::config::Limits;
use crate::error::EngineError;
use crate::query::maps::Maps;
use crate::query::viewpoint::{FieldKind, Viewpoint, camera_of, must_be_whole};
use crate::store::classes::Found;
use crate::store::model::Model;
use crate::store::snapshot::SceneSnapshot;

/// Who it is, and how sure that is, 0 to 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Who {
    /// Number and label; `None` for nobody.
    pub identity: Option<(u32, String)>,
    /// Who took the photographs of the identity's cluster and how many each, most first, then by name.
    pub contributors: Vec<(String, usize)>,
    /// Of a picture the answer's probability; of a place 1 in a cluster's middle, 0 on its border.
    pub confidence: f64,
    /// Log indices of the owner records that count for the identity, rising: see [`crate::records::owners::bearing_on`].
    pub records: Vec<u64>,
}

/// Whose mark a picture carries, and all that was read from it.
#[derive(Clone, Debug)]
pub struct Identified {
    /// Whose it is.
    pub who: Who,
    /// What was read.
    pub found: Found,
    /// What the identities of the model are called, identity 1 first.
    pub labels: Vec<String>,
}

impl Who {
    /// Nobody, as sure as that.
    fn nobody(confidence: f64) -> Self {
        Self { identity: None, contributors: Vec::new(), confidence, records: Vec::new() }
    }

    /// The identity `number`, or nobody where none is given or all its photographs are left out; without its records.
    pub(crate) fn of(snapshot: &SceneSnapshot, number: Option<u32>, confidence: f64) -> Result<Self, EngineError> {
        let Some(number) = number else { return Ok(Self::nobody(confidence)) };
        let (identity, credited) = snapshot.identity(number)?;
        let Some(contributors) = credited.cloned() else { return Ok(Self::nobody(confidence)) };
        Ok(Self { identity: Some((number, identity.label.clone())), contributors, ..Self::nobody(confidence) })
    }
}

/// How a picture is to be registered with the field.
#[derive(Clone, Debug)]
pub struct FieldRegistration {
    /// From where the picture was rendered, where that is known.
    pub from: Option<Viewpoint>,
    /// Says so once nobody waits for the answer any more.
    pub given_up: Arc<AtomicBool>,
}

/// Renders a view, clamped to [0, 1]; with accumulation and depth where `maps` asks for them.
///
/// # Errors
/// As [`Model::marked_field`].
pub fn render(
    model: &Model,
    camera: &Camera,
    field: FieldKind,
    appearance: &Appearance,
    maps: bool,
) -> Result<(Picture, Option<Maps>), EngineError> {
    if !maps {
        return Ok((model.look(field, camera, appearance)?, None));
    }
    // Where densities are frozen a mark is colour alone, and what lies behind it the base field's.
    let shapes = match field {
        FieldKind::Base => &model.base,
        FieldKind::Marked => model.marked_field()?.theta(),
    };
    let seen = shapes.render_maps(camera, appearance);
    let maps = Maps::new(model.base.frame(), camera, &seen);
    let picture = match field {
        FieldKind::Base => seen.picture.clamped(),
        FieldKind::Marked => model.look(field, camera, appearance)?,
    };
    Ok((picture, Some(maps)))
}

/// Whose cluster a viewpoint belongs to, without the owner's records.
///
/// # Errors
/// As [`camera_of`]; [`EngineError::NotTrained`].
pub fn place_of(snapshot: &SceneSnapshot, viewpoint: &Viewpoint, limits: &Limits) -> Result<Who, EngineError> {
    let camera = camera_of("the render", snapshot, viewpoint, limits)?;
    let found = snapshot.info()?.clusters.identity_of_without(&camera.pose, &snapshot.out_of_clusters);
    // Nobody is credited with a view that is left out, wherever it says that it was taken.
    if let Viewpoint::View(name) = viewpoint
        && snapshot.is_out(snapshot.full_name(name)?)
    {
        return Ok(Who::nobody(1.0));
    }
    // How far from the border, in units of the way from the middle to the border.
    let reach = found.distance + found.margin.abs();
    let confidence = if reach > 0.0 && reach.is_finite() { (found.margin.abs() / reach).min(1.0) } else { 1.0 };
    Who::of(snapshot, found.identity, confidence)
}

/// What the model reads from a picture; with `register` the picture is registered with the field as
/// well.
///
/// # Errors
/// For a picture that `register`'s camera cannot have taken whole; [`Model::mark`]'s, [`Model::places`]'s and the
/// detector's.
pub fn read_picture(
    model: &Model,
    snapshot: &SceneSnapshot,
    picture: &Picture,
    register: Option<FieldRegistration>,
    limits: &Limits,
) -> Result<Found, EngineError> {
    let mark = model.mark()?;
    let Some(FieldRegistration { from, given_up }) = register else { return mark.detect(picture) };
    let from = from.map(|viewpoint| camera_of("the render", snapshot, &viewpoint, limits)).transpose()?;
    if let Some(camera) = &from {
        must_be_whole("the picture", picture, camera, "what it was rendered at", "or no viewpoint at all")?;
    }
    let places = if from.is_none() { Some(model.places()?) } else { None };
    mark.detect_registered(picture, places, from.as_ref(), &|| !given_up.load(Ordering::Relaxed))
}
