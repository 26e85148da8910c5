//! Weaving: each contributor's keyed mark in what their photographs taught.
//!
//! - [`keys`]: the weaving secret, and each contributor's mark key
//! - [`lots`]: which cells of a field are whose, drawn by what their photographs showed of them
//! - [`eye`]: how strong a mark may be where it must not be seen
//! - [`woven`]: the published field, and what reading its marks takes
//!
//! A base field that is woven is secret, and woven once: two weavings of one base show the marks by their difference.

pub mod eye;
pub mod keys;
pub mod lots;
pub mod woven;
