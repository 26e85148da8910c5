//! Which poses belong to whom. Views are grouped into clusters, one an identity,
//! either around anchor views (the method's M anchors and K neighbours) or by
//! contributor; afterwards any pose, seen or new, is told its identity.
//!
//! This is geometry only: no photographs, no files, and no randomness but a
//! seeded choice of the first anchor. The same poses and seed give the same
//! clusters, also when the scene is scaled, turned or moved.
//!
//! Search is exact and linear: a capture has at most 1e5 views, and one pose
//! against that many takes under a millisecond.

mod anchors;
mod build;
mod by_contributor;
mod clusters;
mod metric;

pub use clusters::{Cluster, ClusterConfig, ClusterError, Clusters, Grouping, Membership, Neighbour};
pub use metric::PoseMetric;
