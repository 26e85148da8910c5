//! Callers who wait for much work.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A caller who waits: where it goes without its answer, this is dropped, and the work for it ends.
#[derive(Default)]
pub struct Waiting(Arc<AtomicBool>);

impl Waiting {
    /// A caller whose work looks at `given_up`.
    pub fn of(given_up: Arc<AtomicBool>) -> Self {
        Self(given_up)
    }

    /// Says so once the caller is gone.
    pub fn given_up(&self) -> Arc<AtomicBool> {
        self.0.clone()
    }
}

impl Drop for Waiting {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}
