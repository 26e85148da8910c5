//! Grouping views into clusters, either way.

use crate::cameras::pose::Pose;
use crate::cluster::clusters::{ClusterError, Clusters, Grouping};
use crate::cluster::{anchors, by_contributor};

impl Clusters {
    /// Groups the views with these `poses` into identities.
    ///
    /// *Anchors*: the first is drawn with `seed`, each further one is the view
    /// farthest from those there are (farthest-point sampling; Gonzalez 1985).
    /// A cluster is its anchor's K nearest views (and any exactly as near as the
    /// last), less those that are nearer to another anchor. A pose belongs to its
    /// nearest anchor's cluster if it is within the radius, which lies half way
    /// between the farthest member and the next view of that anchor outside
    /// (or at the farthest member, where no such view is).
    ///
    /// *By contributor*: a pose belongs to whoever took the view nearest to it,
    /// if they are an identity and the view is within the radius, twice the
    /// median distance from one of their views to the next. Views from the same
    /// spot by several contributors belong to none of them, and `unknown` is
    /// nobody. `seed` is not used.
    ///
    /// In both, ties go to the lower index, a member is told its cluster's
    /// identity by [`Clusters::identity_of`], and no other view is told it.
    ///
    /// # Errors
    /// [`ClusterError`] for a setting out of range, too few views, or a pose
    /// that is not finite.
    pub fn build(
        poses: &[Pose],
        grouping: &Grouping,
        contributors: &[String],
        seed: u64,
    ) -> Result<Self, ClusterError> {
        grouping.check()?;
        if let Some(view) = poses.iter().position(|p| !p.position.is_finite() || !p.rotation.is_finite()) {
            return Err(ClusterError::NotFinite { view });
        }
        match grouping {
            Grouping::Anchors(config) => anchors::build(poses, config, seed),
            Grouping::ByContributor { min_views, direction_weight } => {
                by_contributor::build(poses, contributors, *min_views, *direction_weight)
            }
        }
    }
}
