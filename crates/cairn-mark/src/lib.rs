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

mod attack;
mod deepstega;
mod detect;
mod error;
mod lsb;
mod marked;
mod payload;
mod progress;
mod stega;

pub use attack::{Distortion, RobustConfig};
pub use deepstega::{DeepConfig, DeepStats, DeepStega, DeepTrainer};
pub use detect::blind::detector::{DETECTOR_FORMAT, Detection, Detector};
pub use detect::informed::{BELIEVED, RegisteredReader, RegisteredReading};
pub use error::MarkError;
pub use lsb::{hide_in_lowest_bits, read_lowest_bits};
pub use marked::{MARKED_FORMAT, MarkedField};
pub use payload::{HeadSizes, Signal};
pub use stega::carrier::Carrier;
pub use stega::growth::{Earlier, Known, Restarted};
pub use stega::judge::{Judgement, Recovered, Weakest};
pub use stega::mask::gradient_mask;
pub use stega::poses::{PlannedView, at_most, between, virtual_views};
pub use stega::recipe::{CarrierKind, DensityKind, Guidance, LossKind, MaskKind, OtherColours, Recipe};
pub use stega::shape::CarrierShape;
pub use stega::site::MarkScene;
pub use stega::trainer::{MarkPlan, MarkStats, MarkTrainer};
