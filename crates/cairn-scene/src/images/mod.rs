//! Pictures in memory and as files: photographs, masks, emblems, values in grey.

pub(crate) mod emblem;
pub(crate) mod format;
pub(crate) mod grey;
pub(crate) mod mask;
pub(crate) mod photograph;
pub(crate) mod picture;
pub(crate) mod resize;
pub(crate) mod webp;

pub use emblem::{Ground, decode_emblem};
pub use format::{ImageFormat, Limits};
pub use grey::encode_grey16;
pub use mask::Mask;
pub use photograph::{decode_picture, encode_png, save_png};
pub use picture::{Picture, Picture8, PictureError};
pub use resize::AreaFilter;
