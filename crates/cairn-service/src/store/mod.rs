//! What lies on the disk: the data folder, scenes, models, hidden payloads, and whose each scene is.

pub mod access;
pub mod checked;
pub mod classes;
pub mod exclusions;
pub mod folder;
pub mod given;
pub mod hidden;
pub mod import;
pub mod model;
pub mod scenes;
pub(crate) mod seal;
pub(crate) mod shadow;
pub mod snapshot;
pub mod support;
#[cfg(test)]
#[path = "folder_tests.rs"]
pub mod test_folder;
