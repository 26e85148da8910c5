//! Buffers that threads keep between calls, so that a convolution allocates
//! nothing but its result.

use std::cell::RefCell;
use std::ops::{Deref, DerefMut};

/// A cache line, so that whole vectors lie in one.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Line([f32; 16]);

thread_local! {
    /// Idle buffers. A stack: a thread that waits for others may begin another convolution.
    static IDLE: RefCell<Vec<Vec<Line>>> = const { RefCell::new(Vec::new()) };
}

/// Numbers aligned to a cache line, with what was left in them.
pub(crate) struct Scratch {
    lines: Vec<Line>,
    len: usize,
}

impl Scratch {
    /// `len` numbers that the caller MUST write before it reads them: they are
    /// left from earlier work.
    pub(crate) fn take(len: usize) -> Self {
        let mut lines = IDLE.with_borrow_mut(|idle| idle.pop()).unwrap_or_default();
        let needed = len.div_ceil(16);
        if lines.len() < needed {
            lines.resize(needed, Line([0.0; 16]));
        }
        Self { lines, len }
    }
}

/// Lines of a buffer that is kept, at most: 16 MiB.
const KEPT: usize = 1 << 18;

impl Drop for Scratch {
    fn drop(&mut self) {
        let lines = std::mem::take(&mut self.lines);
        if lines.len() > KEPT {
            return;
        }
        IDLE.with_borrow_mut(|idle| idle.push(lines));
    }
}

impl Deref for Scratch {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        // SAFETY: `lines` holds at least `len` initialised floats, one after another.
        unsafe { std::slice::from_raw_parts(self.lines.as_ptr().cast(), self.len) }
    }
}

impl DerefMut for Scratch {
    fn deref_mut(&mut self) -> &mut [f32] {
        // SAFETY: as in `deref`, and `self` is borrowed mutably.
        unsafe { std::slice::from_raw_parts_mut(self.lines.as_mut_ptr().cast(), self.len) }
    }
}
