//! What contributors bring: cameras, poses, photographs, masks, sounds, and who took what.
//!
//! This is the only crate that reads photographs, camera files and sounds. Everything
//! after it works on [`Camera`]s and [`Picture`]s in memory, so a new camera
//! format is added here and nowhere else.
//!
//! Convention everywhere in Cairn: a [`Pose`] is camera-to-world, in OpenCV axes
//! (x right, y down, z forward); lengths are in the capture's own unit; pixel
//! (0, 0)'s centre lies at (0.5, 0.5).

mod cameras;
mod capture;
pub mod cluster;
mod error;
mod images;
mod import;
pub mod metrics;
mod scene;
mod shell;
mod sound;
mod train_view;
mod unused;

pub use cameras::{BrownConrady, Camera, Distortion, Fisheye, Intrinsics, LensError, LensModel, Pose, PoseError};
pub use capture::{Capture, LeftOut, SceneKind, Support, UNKNOWN_CONTRIBUTOR, View};
pub use error::CaptureError;
pub use images::{
    AreaFilter, Ground, ImageFormat, Limits, Mask, Picture, Picture8, PictureError, decode_emblem, decode_picture,
    encode_grey16, encode_png, save_png,
};
pub use import::ReadOptions;
pub use scene::{MANIFEST, SceneFolder, write_manifest};
pub use shell::quoted;
pub use sound::{SAMPLE_RATES_HZ, Sound, SoundLimits, decode_wav, encode_wav};
pub use train_view::TrainView;
pub use unused::{Standing, Unused, UnusedPhotographs, no_share, without_share};
