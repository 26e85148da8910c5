//! Renders of base fields that are kept in a folder, so that they are rendered once and not for each training's
//! judgement: theta_0 never changes. A render belongs to the program, the field and the camera and light it was made with.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_capture::{Limits, Picture, decode_picture, save_png};
use cairn_field::Field;
use cairn_stega::PlannedView;
use sha2::{Digest as _, Sha256};

use super::read;
use crate::engine::evaluate::eight_bits;

/// A field's renders.
pub struct Kept<'a> {
    field: &'a Field,
    folder: PathBuf,
}

impl<'a> Kept<'a> {
    /// Those of `field` that this program made, in a folder of their own within `all`.
    ///
    /// # Errors
    /// For a field that cannot be written out, a program that does not read, and a folder that cannot be made.
    pub fn new(field: &'a Field, all: &Path) -> anyhow::Result<Self> {
        let program = std::env::current_exe().context("where is this program?")?;
        let made_by = Sha256::new().chain_update(read(&program)?).chain_update(field.to_bytes()?).finalize();
        let folder = all.join(short(&made_by));
        std::fs::create_dir_all(&folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
        Ok(Self { field, folder })
    }

    /// The render from `view`, as files hold it.
    ///
    /// # Errors
    /// For renders that are not finite, and a folder that cannot be written.
    pub fn render(&self, view: &PlannedView) -> anyhow::Result<Picture> {
        let file = self.folder.join(format!("{}.png", short(&Sha256::digest(format!("{view:?}")))));
        if file.is_file() {
            return Ok(decode_picture(&read(&file)?, &Limits::default(), None)?);
        }
        let render = eight_bits(&self.field.render(&view.camera, &view.appearance))?;
        save_png(&file, &render)?;
        Ok(render)
    }
}

/// Half of a digest, as a name.
fn short(digest: &[u8]) -> String {
    digest.iter().take(16).map(|byte| format!("{byte:02x}")).collect()
}
