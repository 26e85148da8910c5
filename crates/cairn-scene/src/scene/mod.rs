//! A stored scene: its folder, its table, its manifest.

mod folder;
mod manifest;
mod table;

pub use folder::SceneFolder;
pub use manifest::{MANIFEST, write_manifest};
