//! A trained field: what it renders, how it is stored, and what stage 2 needs of it.

pub(crate) mod basis;
pub(crate) mod coverage;
pub(crate) mod linear;
pub(crate) mod marched;
pub(crate) mod model;
mod overlay;
pub(crate) mod survey;
mod weights;
