//! What tests of records share: a log in memory, and owners by number.

use cairn_log::log::store::FaultyStore;
use cairn_log::{OwnerKey, Registry};

/// The log's name.
pub(crate) const ORIGIN: &str = "cairn.example/log";

/// An owner's key.
pub(crate) fn key(number: u8) -> OwnerKey {
    OwnerKey::from_seed(&[number; 32])
}

/// An empty log.
pub(crate) fn registry() -> Registry {
    let store = FaultyStore::new();
    Registry::open_store(Box::new(store.clone()), Box::new(store), key(200), ORIGIN).unwrap()
}
