//! What a state of training shows, beside the photographs that it is to show.

use super::views::Prepared;
use crate::appearance::code::Appearance;
use crate::grid::lattice::Grid;
use crate::rays::frame::SceneFrame;
use std::sync::Arc;

/// The parts of a state that make its pictures, and the photographs.
#[derive(Clone, Copy)]
pub(crate) struct Shown<'a> {
    pub(crate) views: &'a [Arc<Prepared>],
    pub(crate) frame: &'a SceneFrame,
    pub(crate) grid: &'a Grid<f32>,
    pub(crate) neutral: &'a Appearance,
    /// One a view; empty where the scene needs none.
    pub(crate) appearances: &'a [Appearance],
}

impl<'a> Shown<'a> {
    /// The appearance of view `n`.
    #[inline(always)]
    pub(crate) fn look(&self, n: usize) -> &'a Appearance {
        self.appearances.get(n).unwrap_or(self.neutral)
    }
}
