//! The paper's method (StegaNeRF): residuals of a field, trained together with the networks that read them.

pub(crate) mod backward;
pub(crate) mod bank;
pub(crate) mod carrier;
pub(crate) mod checkpoint;
pub(crate) mod forward;
pub(crate) mod grain;
pub(crate) mod growth;
pub(crate) mod hard_examples;
pub(crate) mod judge;
pub(crate) mod judgement;
pub(crate) mod mask;
pub(crate) mod negatives;
pub(crate) mod plan;
pub(crate) mod poses;
pub(crate) mod prefetch;
pub(crate) mod recipe;
pub(crate) mod references;
pub(crate) mod sample;
pub(crate) mod shape;
pub(crate) mod site;
pub(crate) mod state;
pub(crate) mod trainer;
pub(crate) mod view_refresh;
pub(crate) mod window;

pub use growth::{Earlier, Known, Restarted};
pub use judgement::{Judgement, Recovered, Weakest};
pub use plan::{MarkPlan, MarkScene};
pub use poses::{PlannedView, at_most, between, virtual_views};
pub use recipe::{CarrierKind, DensityKind, Guidance, LossKind, MaskKind, OtherColours, Recipe};
pub use trainer::{MarkStats, MarkTrainer};
