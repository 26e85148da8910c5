//! Which photograph taught a base field what: its share table, worked out once it is trained, and who gets nothing of it.

use std::collections::BTreeMap;

use cairn_field::{Field, NamedView, VisibleField};
use cairn_scene::{Capture, Standing, Unused, UnusedPhotographs, View};
use cairn_share::{Builder, Photograph, ShareTable, taught};

use crate::error::EngineError;
use crate::train::joint::Part;
use crate::train::stages::{Preparing, SHARE_TABLE};

/// The share table of `base`, which was trained on the photographs of `part`; `None` when `preparing` did not want to
/// go on.
///
/// # Errors
/// For photographs that were altered, and more than a table has numbers for.
pub(crate) fn share_table(
    part: &Part,
    base: &Field,
    preparing: Preparing<'_>,
) -> Result<Option<ShareTable>, EngineError> {
    let Some(views) = part.photographs.views(&part.scene, preparing)? else { return Ok(None) };
    let huber = part.job.spec.settings.field.huber;
    let mut builder = Builder::new(base.rows());
    for (done, NamedView { name, view }) in views.iter().enumerate() {
        if !preparing(SHARE_TABLE, done, views.len()) {
            return Ok(None);
        }
        let photograph = Photograph { name: name.clone(), position: view.camera.pose.position };
        builder.add(photograph, &taught(base, name, view, huber))?;
    }
    Ok(Some(builder.finish()?))
}

/// The contributors of `capture` whom `table`, which was made of its training views, gives nothing. A view that is not
/// in the table was held out or else excluded; one without an entry was masked.
pub(crate) fn without_share(capture: &Capture, table: &ShareTable) -> Vec<UnusedPhotographs> {
    let names = table.photographs().iter().map(|photograph| photograph.name.as_str());
    let entries: BTreeMap<&str, usize> = names.zip(table.entries()).collect();
    let why = |view: &View| match entries.get(view.name.as_str()) {
        Some(0) => Some(Unused::Masked),
        Some(_) => None,
        None if view.held_out => Some(Unused::HeldOut),
        None => Some(Unused::Excluded),
    };
    let views = capture.views.iter();
    cairn_scene::without_share(views.map(|view| Standing {
        contributor: &view.contributor,
        why: why(view),
        photographs: 1,
    }))
}

#[cfg(test)]
#[path = "coverage_tests.rs"]
mod tests;
