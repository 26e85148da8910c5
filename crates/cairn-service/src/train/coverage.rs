//! Which photograph taught a base field what: its share table, worked out once it is trained.

use cairn_field::{Field, NamedView, VisibleField};
use cairn_share::{Builder, Photograph, taught};

use crate::error::EngineError;
use crate::train::joint::Part;
use crate::train::stages::{Preparing, SHARE_TABLE};

/// The bytes of the share table of `base`, which was trained on the photographs of `part`; `None` when `preparing` did
/// not want to go on.
///
/// # Errors
/// For photographs that were altered, and more than a table has numbers for.
pub(crate) fn share_table(part: &Part, base: &[u8], preparing: Preparing<'_>) -> Result<Option<Vec<u8>>, EngineError> {
    let Some(views) = part.photographs.views(&part.scene, preparing)? else { return Ok(None) };
    let base = Field::from_bytes(base)?;
    let huber = part.job.spec.settings.field.huber;
    let mut builder = Builder::new(base.rows());
    for (done, NamedView { name, view }) in views.iter().enumerate() {
        if !preparing(SHARE_TABLE, done, views.len()) {
            return Ok(None);
        }
        let photograph = Photograph { name: name.clone(), position: view.camera.pose.position };
        builder.add(photograph, &taught(&base, name, view, huber))?;
    }
    Ok(Some(builder.finish()?.to_bytes()?))
}
