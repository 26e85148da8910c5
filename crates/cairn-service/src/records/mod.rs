//! Owner records: submitting, reading, correcting and publishing them, and the key and the anchor of their log.

pub mod anchor;
pub mod bindings;
pub mod corrections;
pub mod credits;
pub mod owners;
pub mod publisher;
pub mod rebuild;
pub(crate) mod registry_key;
#[cfg(test)]
pub(crate) mod testing;
