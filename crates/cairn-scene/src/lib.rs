//! What contributors bring: cameras, poses, photographs, and who took what.
//!
//! This is the only crate that reads photographs, camera files and sounds. Everything
//! after it works on [`Camera`]s and [`Picture`]s in memory, so a new camera
//! format is added here and nowhere else.
//!
//! Convention everywhere in Cairn: a [`Pose`] is camera-to-world, in OpenCV axes
//! (x right, y down, z forward); lengths are in the capture's own unit; pixel
//! (0, 0)'s centre lies at (0.5, 0.5).

mod assemble;
mod camera;
mod capture;
pub mod cluster;
mod colmap;
mod contributors;
mod emblem;
mod error;
mod facing;
mod grey;
mod llff;
mod manifest;
mod mask;
pub mod metrics;
mod named;
mod notes;
mod npy;
mod photograph;
mod photograph_file;
mod picture;
mod removal;
mod resample;
mod resize;
mod scene;
mod scene_file;
mod sound;
mod train_view;
mod transforms;

pub use camera::{Camera, Distortion, Intrinsics, Pose, PoseError};
pub use capture::{Capture, ReadOptions, SceneKind, UNKNOWN_CONTRIBUTOR, View};
pub use emblem::{Ground, decode_emblem};
pub use error::CaptureError;
pub use grey::encode_grey16;
pub use manifest::{MANIFEST, write_manifest};
pub use mask::Mask;
pub use photograph::{Limits, decode_picture, encode_png, save_png};
pub use photograph_file::PhotographFile;
pub use picture::{Picture, Picture8, PictureError};
pub use resize::AreaFilter;
pub use scene::{Mismatch, SceneFolder};
pub use sound::{SAMPLE_RATES_HZ, Sound, SoundLimits, decode_wav, encode_wav};
pub use train_view::TrainView;
