//! How close a picture, a sound, a text or an answer came to the truth.
//!
//! Every number Cairn reports is computed here, once, so that two commands can
//! never mean different things by "PSNR" or "SSIM". Definitions follow the
//! public reference implementations (scikit-image, SciPy), and the tests hold
//! them to values those produced; the script that did is beside the tests.
//!
//! Nothing here guesses: pictures of different sizes, an empty mask or a number
//! that is not finite are errors, while perfect agreement is the honest infinity.

mod answers;
mod error;
mod picture;
mod sound;
mod ssim;
mod text;

pub use answers::{Accuracy, Confusion, expected_calibration_error};
pub use error::MetricError;
pub use picture::{mae, mse, mse_masked, psnr_db, psnr_db_from_mse, psnr_db_masked};
pub use sound::{LSD_FLOOR_DB, LSD_FRAME, LSD_HOP, log_spectral_distance_db, log_spectrum_db, snr_db};
pub use ssim::{SSIM_WINDOW, ssim, ssim_masked};
pub use text::{TextAccuracy, text_accuracy};
