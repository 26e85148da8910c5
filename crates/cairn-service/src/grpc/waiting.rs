//! Callers who wait for much work.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A caller who waits, and whether it is gone: where it goes without its answer, this is dropped,
/// and the work for it ends.
#[derive(Default)]
pub struct Waiting(pub Arc<AtomicBool>);

impl Drop for Waiting {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}
