//! How close a picture, a sound or a text came to the truth.
//!
//! Every number Cairn reports is computed here, once, so that two commands can
//! never mean different things by "PSNR" or "SSIM". Definitions follow the
//! public reference implementations (scikit-image, SciPy), and the tests hold
//! them to values those produced; the script that did is beside the tests.
//!
//! Nothing here guesses: pictures of different sizes or a number
//! that is not finite are errors, while perfect agreement is the honest infinity.

mod error;
mod picture;
mod sound;
mod ssim;
mod text;

pub use error::MetricError;
pub use picture::{mse, psnr_db, psnr_db_from_mse};
pub use sound::{LSD_FLOOR_DB, LSD_FRAME, LSD_HOP, log_spectral_distance_db, log_spectrum_db, snr_db};
pub use ssim::{SSIM_WINDOW, ssim};
pub use text::{TextAccuracy, text_accuracy};
