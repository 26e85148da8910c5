//! Stage 2 (StegaNeRF, ICCV 2023, for several owners): hide a signal of each
//! identity (a picture, a sound, a text) in what the field renders, and train with it the detector and the
//! classifier that recover it and say `unmarked` where there is none.
//!
//! [`MarkTrainer`] drives it: `bank` holds the views as fixed linear maps and
//! the unmarked pictures, `renders` what the networks are shown of them,
//! [`Carrier`] the coefficients that move, `moves` when, and `mask` how much each
//! may, `losses` what a step is to make smaller, `heads` what recovers a [`Signal`], `judge` which state was best. The outcome is a
//! [`MarkedField`] and a [`Detector`]. Several scenes may share a detector (`site`), and identities
//! may come later (`growth`).

mod ahead;
mod bank;
mod carrier;
mod checkpoint;
mod config;
mod deepstega;
mod detector;
mod distort;
mod draws;
mod error;
mod familiar;
mod grain;
mod growth;
mod heads;
mod judge;
mod losses;
mod lsb;
mod marked;
mod mask;
mod moves;
mod negatives;
mod networks;
mod poses;
mod progress;
mod registered;
mod renders;
mod shape;
mod shown;
mod signal;
mod site;
mod stream;
mod trainer;
mod window;

pub use carrier::Carrier;
pub use config::{CarrierKind, DensityKind, Guidance, LossKind, MarkConfig, MaskKind, OthersColours};
pub use deepstega::{DeepConfig, DeepStats, DeepStega, DeepTrainer};
pub use detector::{DETECTOR_FORMAT, Detection, Detector};
pub use distort::{Distortion, RobustConfig};
pub use error::MarkError;
pub use growth::{Earlier, Known, Restarted};
pub use judge::{Judgement, Recovered, Weakest};
pub use lsb::{hide_in_lowest_bits, read_lowest_bits};
pub use marked::{MARKED_FORMAT, MarkedField};
pub use mask::gradient_mask;
pub use poses::{PlannedView, at_most, between, virtual_views};
pub use registered::{BELIEVED, RegisteredReader, RegisteredReading};
pub use shape::CarrierShape;
pub use signal::{HeadSizes, Signal};
pub use site::MarkScene;
pub use trainer::{MarkPlan, MarkStats, MarkTrainer};
