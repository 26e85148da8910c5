//! Detection from the picture alone: classifier, heads, and how far a picture may lie from what was learnt.

pub(crate) mod detector;
pub(crate) mod heads;
pub(crate) mod networks;
pub(crate) mod out_of_distribution;
