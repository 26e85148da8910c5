//! The next fresh view's ray weights, worked out beside the steps before it comes.
//!
//! A step leaves a third of two cores idle, where it goes through a mark's coefficients one after another or waits for
//! the networks' slowest part; a fresh view takes as long as a step. It hangs on nothing that steps change, so when it
//! is begun changes no byte of what is trained.

use crate::bank::{BankView, Rays};
use crate::poses::PlannedView;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::sync::Arc;
use std::thread::JoinHandle;

/// A view under way, if any.
#[derive(Default)]
pub(crate) struct Ahead {
    /// Of its own: a step that waits in the common pool would take the view's work up, and finish it first.
    pool: Option<Arc<ThreadPool>>,
    /// Which of the fresh views.
    coming: Option<(u64, JoinHandle<BankView>)>,
}

impl Ahead {
    /// Begins the `k`-th fresh view; not where only one thread is to work, or no other can be had.
    pub(crate) fn begin(&mut self, k: u64, rays: Rays, view: PlannedView) {
        let threads = rayon::current_num_threads() / 2;
        if threads == 0 {
            return;
        }
        if self.pool.is_none() {
            self.pool = ThreadPoolBuilder::new().num_threads(threads).build().ok().map(Arc::new);
        }
        let Some(pool) = self.pool.clone() else { return };
        let work = move || pool.install(|| rays.taught(view));
        self.coming = std::thread::Builder::new().spawn(work).ok().map(|thread| (k, thread));
    }

    /// The `k`-th fresh view, waited for; `None` where it was not begun.
    pub(crate) fn take(&mut self, k: u64) -> Option<BankView> {
        let (_, thread) = self.coming.take_if(|(coming, _)| *coming == k)?;
        Some(thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    }
}
