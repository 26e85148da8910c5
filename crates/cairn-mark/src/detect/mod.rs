//! Which identity's mark a picture carries, and what the mark hides.

pub(crate) mod blind;
pub(crate) mod informed;
pub(crate) mod keyed;
mod opponent;
