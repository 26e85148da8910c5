//! Shares: whose photographs account for what is seen of a field.
//!
//! - [`taught`]: what a photograph's pixels counted
//! - [`ShareTable`]: what each photograph taught each row, packed
//! - [`SeenFrom`]: the shares of a view, of a part of it, and of its pixels
//! - [`Necessity`]: what would change without some photographs
//!
//! A share is *coverage*: how much of what is seen a photograph showed to the training. It is no measure of worth, and
//! it does not say what would be missed without the photograph.

mod coverage;
mod error;
mod necessity;
mod table;
mod taught;

pub use coverage::{SeenFrom, Shares, Sharpness};
pub use error::ShareError;
pub use necessity::{Lesson, Necessity, PULL, STEPS};
pub use table::{Builder, Photograph, SHARES_FORMAT, ShareTable};
pub use taught::{SAMPLED_PIXELS, taught};
