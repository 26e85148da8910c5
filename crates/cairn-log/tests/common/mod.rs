//! What the registry's tests share: keys from seeds, the vectors' folder, and, with the store, a log's work.

// Each test binary uses its own part of this.
#![allow(dead_code, unused_imports)]

use std::{env, path::PathBuf};

use cairn_log::OwnerKey;

#[cfg(feature = "store")]
mod log;
#[cfg(feature = "store")]
pub use log::*;

pub const ORIGIN: &str = "cairn.example/log";

pub fn registry_key() -> OwnerKey {
    OwnerKey::from_seed(&[200; 32])
}

pub fn owner(number: u8) -> OwnerKey {
    OwnerKey::from_seed(&[number; 32])
}

/// The vectors' folder, or a visible line that the test was skipped.
pub fn vectors(test: &str) -> Option<PathBuf> {
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/vectors");
    let folder = env::var_os("CAIRN_VECTORS").map_or_else(|| beside.into(), PathBuf::from).join("merkle");
    if folder.is_dir() {
        return Some(folder);
    }
    eprintln!("SKIPPED {test}: no vectors at {}", folder.display());
    None
}
