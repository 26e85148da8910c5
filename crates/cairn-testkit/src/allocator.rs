//! The system's allocator, counting what the running thread holds and how often it asks, so that a test can bound what a
//! reader takes, and hold a loop to asking for nothing.

use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
};

thread_local! {
    /// Bytes that this thread allocated and did not free; below zero where it frees what others allocated.
    static HELD: Cell<isize> = const { Cell::new(0) };
    /// The most that [`HELD`] was since it was last set back.
    static PEAK: Cell<isize> = const { Cell::new(0) };
    /// How often this thread asked for memory.
    static ASKED: Cell<usize> = const { Cell::new(0) };
}

/// The system's allocator with a count for each thread; see [`peak_of`].
#[derive(Debug)]
pub struct Counting;

fn add(bytes: isize) {
    // A thread that is going down has no counters any more; nobody measures it.
    let _ = HELD.try_with(|held| {
        held.set(held.get() + bytes);
        let _ = PEAK.try_with(|peak| peak.set(peak.get().max(held.get())));
    });
}

fn asked() {
    let _ = ASKED.try_with(|asked| asked.set(asked.get() + 1));
}

// SAFETY: every call goes to `System` as it came; counting touches only `Cell`s without destructors, which allocate nothing.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        asked();
        add(layout.size() as isize);
        // SAFETY: the caller's promises about `layout` are handed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        asked();
        add(layout.size() as isize);
        // SAFETY: the caller's promises about `layout` are handed on.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        add(-(layout.size() as isize));
        // SAFETY: `memory` came from `System` with this `layout`.
        unsafe { System.dealloc(memory, layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        asked();
        // Old and new may both be there while the bytes move.
        add(size as isize);
        add(-(layout.size() as isize));
        // SAFETY: `memory` came from `System` with this `layout`, and `size` is the caller's promise.
        unsafe { System.realloc(memory, layout, size) }
    }
}

/// What `work` gives, and the most bytes that this thread held during it beyond what it held before.
///
/// Counts only where [`Counting`] is the binary's global allocator, and only this thread's.
pub fn peak_of<T>(work: impl FnOnce() -> T) -> (T, usize) {
    let before = HELD.with(Cell::get);
    PEAK.with(|peak| peak.set(before));
    let done = work();
    (done, usize::try_from(PEAK.with(Cell::get) - before).unwrap_or(0))
}

/// What `work` gives, and how often this thread asked for memory, or for more of it, meanwhile.
///
/// Counts as [`peak_of`] does.
pub fn allocations_of<T>(work: impl FnOnce() -> T) -> (T, usize) {
    let before = ASKED.with(Cell::get);
    let done = work();
    (done, ASKED.with(Cell::get) - before)
}
