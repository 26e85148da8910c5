//! Which keypoints the places of a base field have: the index that a picture's camera is found with, made once the field is
//! trained.

use cairn_field::{Field, NamedView};
use cairn_register::{Index, Reference};

use crate::error::EngineError;
use crate::train::joint::Part;
use crate::train::stages::{PLACES, Preparing};

/// The index of places of `base`, which was trained on the photographs of `part`; `None` when `preparing` did not want
/// to go on. What a mask leaves out has keypoints as well: it is seen in pictures, and those of passers-by agree on no camera.
///
/// # Errors
/// For photographs that were altered.
pub(crate) fn index(part: &Part, base: &Field, preparing: Preparing<'_>) -> Result<Option<Index>, EngineError> {
    let Some(views) = part.photographs.views(&part.scene, preparing)? else { return Ok(None) };
    let references: Vec<Reference<'_>> = views.iter().map(reference).collect();
    Ok(Index::build(base, &references, &mut |done, total| preparing(PLACES, done, total)))
}

/// The view, whose photograph is unpacked when it is asked for.
fn reference(NamedView { name, view }: &NamedView) -> Reference<'_> {
    Reference { camera: view.camera, name, photograph: Box::new(|| Some(view.rgb8.to_picture())) }
}
