//! COLMAP sparse models, binary and text: cameras, images, points3D.
//! Format: <https://colmap.github.io/format.html>.

mod binary;
mod parts;
mod read;
mod text;

pub(crate) use read::{is_in, read};
