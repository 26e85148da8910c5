//! Training: the queue of jobs, their stages, and what a request turns into.

pub(crate) mod ahead;
pub mod clusters;
pub(crate) mod coverage;
pub(crate) mod drive;
pub mod job;
pub mod jobs;
pub(crate) mod joint;
pub mod marks;
pub(crate) mod places;
pub mod request;
pub(crate) mod screen;
pub mod stages;
pub mod training;
