//! Reading captures: COLMAP, LLFF and transforms files, contributor tables, masks.
//!
//! Each format's reader gives a model; `assemble` holds it to the photographs, so that no format can forget a check.

mod assemble;
mod colmap;
mod contributors;
mod llff;
mod masks;
mod model;
mod named;
mod npy;
pub(crate) mod options;
mod read;
mod transforms;

pub use options::ReadOptions;
