//! How far a long piece of work is, and whether it is to go on.

use crate::error::MarkError;

/// Parts of a whole, done one after another.
pub(crate) struct Progress<'a> {
    done: usize,
    total: usize,
    hears: &'a mut dyn FnMut(usize, usize) -> bool,
}

impl<'a> Progress<'a> {
    /// `done` of `total` parts before the first. `hears` gets how many are done (`total` at most) and how many there
    /// are before each, and says whether to go on.
    pub(crate) fn new(done: usize, total: usize, hears: &'a mut dyn FnMut(usize, usize) -> bool) -> Self {
        Self { done, total, hears }
    }

    /// The next part begins.
    ///
    /// # Errors
    /// [`MarkError::Stopped`] where it is not to.
    pub(crate) fn next(&mut self) -> Result<(), MarkError> {
        let go_on = (self.hears)(self.done.min(self.total), self.total);
        self.done += 1;
        if go_on { Ok(()) } else { Err(MarkError::Stopped) }
    }
}
