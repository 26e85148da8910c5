//! Cameras: lenses, intrinsics, poses, and how they lie around a scene.

pub(crate) mod camera;
pub(crate) mod facing;
pub(crate) mod fisheye;
pub(crate) mod intrinsics;
pub(crate) mod lens;
pub(crate) mod pose;

pub use camera::Camera;
pub use fisheye::{Fisheye, LensError};
pub use intrinsics::Intrinsics;
pub use lens::{BrownConrady, Distortion, LensModel};
pub use pose::{Pose, PoseError};
