//! The paper's method (StegaNeRF): residuals of a field, trained together with the networks that read them.

pub(crate) mod ahead;
pub(crate) mod bank;
pub(crate) mod carrier;
pub(crate) mod checkpoint;
pub(crate) mod draws;
pub(crate) mod grain;
pub(crate) mod growth;
pub(crate) mod judge;
pub(crate) mod losses;
pub(crate) mod mask;
pub(crate) mod moves;
pub(crate) mod negatives;
pub(crate) mod poses;
pub(crate) mod recipe;
pub(crate) mod renders;
pub(crate) mod shape;
pub(crate) mod shown;
pub(crate) mod site;
pub(crate) mod stream;
pub(crate) mod trainer;
pub(crate) mod window;
