//! Work that is begun before its result is wanted, beside the steps of a training.
//!
//! A fresh view takes as long as a step, and hangs on nothing that steps change, so that when it is begun changes no
//! byte of what is trained. Steps leave cores idle now and then, where they wait for their slowest part.

use rayon::{ThreadPool, ThreadPoolBuilder};
use std::collections::HashMap;
use std::hash::Hash;
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};

/// Pieces of work under way, each by its key.
pub(crate) struct Prefetch<K, T> {
    /// Of its own: a step that waits in the common pool would take this work up, and finish it first.
    pool: Option<Arc<ThreadPool>>,
    coming: HashMap<K, JoinHandle<T>>,
}

impl<K: Eq + Hash, T: Send + 'static> Prefetch<K, T> {
    pub(crate) fn new() -> Self {
        Self { pool: None, coming: HashMap::new() }
    }

    /// Begins `work` on half of the threads that there are; not where only one is to work, or no other can be had.
    pub(crate) fn begin(&mut self, key: K, work: impl FnOnce() -> T + Send + 'static) {
        let threads = rayon::current_num_threads() / 2;
        if threads == 0 {
            return;
        }
        if self.pool.is_none() {
            self.pool = ThreadPoolBuilder::new().num_threads(threads).build().ok().map(Arc::new);
        }
        let Some(pool) = self.pool.clone() else { return };
        if let Ok(thread) = Builder::new().name("ahead".into()).spawn(move || pool.install(work)) {
            self.coming.insert(key, thread);
        }
    }

    /// What came of the work of that key, waited for; `None` where it was not begun.
    pub(crate) fn take(&mut self, key: &K) -> Option<T> {
        let thread = self.coming.remove(key)?;
        Some(thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    }
}

impl<K, T> Drop for Prefetch<K, T> {
    /// Nothing outlives a training: what nobody wants any more is waited for.
    fn drop(&mut self) {
        // Its panics go with it.
        self.coming.drain().for_each(|(_, thread)| drop(thread.join()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    fn on(threads: usize, work: impl FnOnce() + Send) {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work);
    }

    #[test]
    fn what_was_begun_is_taken_once_by_its_own_key() {
        on(4, || {
            let mut ahead = Prefetch::new();
            (0..3).for_each(|k| ahead.begin(k, move || (10 * k, rayon::current_num_threads())));
            assert_eq!(ahead.take(&3), None);
            assert_eq!(ahead.take(&1), Some((10, 2)));
            assert_eq!(ahead.take(&1), None);
            assert_eq!(ahead.take(&2), Some((20, 2)));
        });
    }

    #[test]
    fn one_thread_begins_nothing_and_nothing_outlives_its_owner() {
        let done = Arc::new(AtomicUsize::new(0));
        for (threads, expected) in [(1, 0), (2, 1)] {
            let (heard, work) = (done.clone(), done.clone());
            on(threads, move || {
                let mut ahead = Prefetch::new();
                ahead.begin(0, move || {
                    std::thread::sleep(std::time::Duration::from_millis(50));
                    work.fetch_add(1, Ordering::SeqCst);
                });
                drop(ahead);
                assert_eq!(heard.load(Ordering::SeqCst), expected, "{threads} threads");
            });
        }
    }

    #[test]
    #[should_panic(expected = "a view that cannot be")]
    fn a_panic_reaches_who_wants_the_result() {
        let mut ahead = Prefetch::<u8, ()>::new();
        on(2, || ahead.begin(0, || panic!("a view that cannot be")));
        ahead.take(&0);
    }
}
