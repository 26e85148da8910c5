//! Clusters of views and who a pose belongs to.

use std::collections::BTreeSet;

use crate::cameras::pose::Pose;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::cluster::metric::PoseMetric;

/// Clusters around anchors: the method's M and K.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ClusterConfig {
    /// M, the number of clusters, at least 1.
    pub anchors: usize,
    /// K, the number of views that form a cluster, its anchor included, at least 1.
    pub neighbours: usize,
    /// Weight of the squared chord between viewing directions against squared
    /// position in units of the capture's spread; at least 0.
    pub direction_weight: f64,
}

impl Default for ClusterConfig {
    /// M = 3 and K = 20 as in the paper, direction as heavy as position.
    fn default() -> Self {
        Self { anchors: 3, neighbours: 20, direction_weight: 1.0 }
    }
}

impl ClusterConfig {
    /// The same with as many views a cluster as `views` allow, as many as in the paper at most.
    #[must_use]
    pub fn within(self, views: usize) -> Self {
        let neighbours = (views / self.anchors.max(1)).clamp(1, Self::default().neighbours);
        Self { neighbours, ..self }
    }
}

/// How views are grouped into identities.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Grouping {
    /// Around M anchors that are spread over the capture.
    Anchors(ClusterConfig),
    /// Every contributor with enough views is an identity, in order of name.
    ByContributor {
        /// Views that a contributor needs to be an identity, at least 2.
        min_views: usize,
        /// As [`ClusterConfig::direction_weight`].
        direction_weight: f64,
    },
}

/// The views of one identity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cluster {
    /// 1..=M; 0 is kept for `unmarked`.
    pub identity: u32,
    /// The view in the cluster's middle, an index into the poses it was built from.
    pub anchor: usize,
    /// Its views, the anchor among them, by distance from the anchor, then by index.
    pub members: Vec<usize>,
    /// How far from the anchor (by contributor: from the nearest of their views)
    /// a pose still belongs to the cluster, in the metric's unit.
    pub radius: f64,
}

/// Whom a pose belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Membership {
    /// The identity, or `None` for a pose outside all clusters.
    pub identity: Option<u32>,
    /// Distance to the nearest anchor (by contributor: to the nearest view).
    pub distance: f64,
    /// How much the distance may change before the answer does: positive within
    /// a cluster, negative outside, about 0 on a border. Infinite never.
    pub margin: f64,
}

/// A view near a pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Neighbour {
    /// The view's identity; `None` where it has none.
    pub identity: Option<u32>,
    /// Distance from the pose.
    pub distance: f64,
    /// Index of the view.
    pub view: usize,
}

/// A view that poses are compared with.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Reference {
    pub view: usize,
    pub identity: Option<u32>,
    pub pose: Pose,
}

/// A capture's clusters, with all that is needed to place a pose in them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Raw")]
pub struct Clusters {
    /// The distance that they were built with.
    pub metric: PoseMetric,
    /// One cluster an identity, in order of identity: `clusters[i].identity == i + 1`.
    pub clusters: Vec<Cluster>,
    pub(crate) grouping: Grouping,
    /// By view. Anchors: the members. By contributor: all views.
    pub(crate) references: Vec<Reference>,
}

/// [`Clusters`] as stored, not yet checked.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    metric: PoseMetric,
    clusters: Vec<Cluster>,
    grouping: Grouping,
    references: Vec<Reference>,
}

/// Why there are no clusters.
#[derive(Debug, Error, PartialEq)]
pub enum ClusterError {
    /// A setting out of range.
    #[error("the cluster setting {key} is {value}; it must be {allowed}")]
    Setting {
        /// The setting.
        key: &'static str,
        /// Its value.
        value: String,
        /// What is allowed.
        allowed: &'static str,
    },
    /// More views are wanted than there are.
    #[error(
        "{anchors} clusters of {neighbours} views need {} views, the capture has {views}; lower anchors (M) or neighbours (K)",
        anchors.saturating_mul(*neighbours)
    )]
    TooFewViews {
        /// M.
        anchors: usize,
        /// K.
        neighbours: usize,
        /// Views there are.
        views: usize,
    },
    /// The views stand in fewer places than there are to be anchors.
    #[error("{anchors} anchors need as many different poses, the capture has {distinct}; lower anchors (M)")]
    TooFewPoses {
        /// M.
        anchors: usize,
        /// Different poses there are.
        distinct: usize,
    },
    /// One contributor for every view is needed.
    #[error("{views} views need {views} contributors, got {contributors}; name one for each view, in the same order")]
    ContributorCount {
        /// Views.
        views: usize,
        /// Contributors.
        contributors: usize,
    },
    /// Nobody brought enough views.
    #[error(
        "no contributor has {min_views} views of their own; the most, {most}, are from {contributor:?}; lower min_views (--min-views) or bring a table of contributors"
    )]
    NoContributor {
        /// Views wanted.
        min_views: usize,
        /// Who has the most.
        contributor: String,
        /// How many.
        most: usize,
    },
    /// A pose with a number that is not finite.
    #[error("the pose of view {view} holds a number that is not finite; drop the view")]
    NotFinite {
        /// The view.
        view: usize,
    },
    /// Stored clusters that cannot be.
    #[error("the stored clusters are damaged: {problem}; build them again")]
    Damaged {
        /// What cannot be.
        problem: String,
    },
}

impl Clusters {
    /// How the views were grouped.
    pub fn grouping(&self) -> &Grouping {
        &self.grouping
    }

    /// The pose of the anchor of `identity`; `None` for one that there is not.
    pub fn anchor_pose(&self, identity: u32) -> Option<&Pose> {
        let cluster = self.cluster(identity)?;
        self.reference(cluster.anchor).map(|r| &r.pose)
    }

    /// Whom `pose`, seen or new, belongs to.
    pub fn identity_of(&self, pose: &Pose) -> Membership {
        self.identity_of_without(pose, &BTreeSet::new())
    }

    /// As [`Clusters::identity_of`], as if these views (indices) were nobody's: where views decide, by
    /// contributor, the nearest of the others does. Anchors are places and stay.
    pub fn identity_of_without(&self, pose: &Pose, left_out: &BTreeSet<usize>) -> Membership {
        match self.grouping {
            Grouping::Anchors(_) => {
                let anchors = self.clusters.iter().filter_map(|c| self.reference(c.anchor));
                self.decide(pose, anchors, false)
            }
            Grouping::ByContributor { .. } => {
                self.decide(pose, self.references.iter().filter(|r| !left_out.contains(&r.view)), true)
            }
        }
    }

    /// The `n` views nearest to `pose` among those the clusters know (anchors:
    /// the members; by contributor: all views), nearest first, ties by index.
    pub fn nearest(&self, pose: &Pose, n: usize) -> Vec<Neighbour> {
        let ranked = |r: &Reference| Neighbour {
            identity: r.identity,
            distance: self.metric.distance(pose, &r.pose),
            view: r.view,
        };
        let mut all: Vec<Neighbour> = self.references.iter().map(ranked).collect();
        all.sort_by(|a, b| a.distance.total_cmp(&b.distance).then(a.view.cmp(&b.view)));
        all.truncate(n);
        all
    }

    /// The nearest of `candidates` decides. Among equally near ones the first
    /// does, or, where `shared_is_nobodys`, nobody if they differ.
    fn decide<'a>(
        &self,
        pose: &Pose,
        candidates: impl Iterator<Item = &'a Reference>,
        shared_is_nobodys: bool,
    ) -> Membership {
        let ranked: Vec<(f64, Option<u32>)> =
            candidates.map(|c| (self.metric.distance(pose, &c.pose), c.identity)).collect();
        let first = (f64::INFINITY, None);
        let (distance, nearest) = ranked.iter().copied().fold(first, |best, c| if c.0 < best.0 { c } else { best });
        // The nearest that would give another answer.
        let other = ranked.iter().filter(|c| c.1 != nearest).fold(f64::INFINITY, |m, c| m.min(c.0));
        let radius = nearest.and_then(|identity| self.cluster(identity)).map(|c| c.radius);
        let inside = radius.is_some_and(|r| distance <= r) && !(shared_is_nobodys && other <= distance);
        // Outside the nearest view's cluster, or nearest to nobody's view: how far
        // the pose is from the radius, or from the next candidate's ground.
        let margin = match radius {
            Some(radius) if inside => (radius - distance).min(other - distance),
            Some(radius) => (radius - distance).min(0.0),
            None => distance - other,
        };
        Membership { identity: nearest.filter(|_| inside), distance, margin }
    }

    /// The same clusters with other owners: what was identity i's is identity i + `by`'s,
    /// counted round from M to 1. For tests of whether an answer comes from what is hidden
    /// or from what is seen; all M - 1 permutations of this kind together give every
    /// cluster to every other identity once.
    #[must_use]
    pub fn permuted(&self, by: usize) -> Self {
        let all = self.clusters.len().max(1);
        let other = |identity: u32| ((identity as usize - 1 + by) % all) as u32 + 1;
        let mut permuted = self.clone();
        permuted.clusters.iter_mut().for_each(|c| c.identity = other(c.identity));
        permuted.clusters.sort_by_key(|c| c.identity);
        permuted.references.iter_mut().for_each(|r| r.identity = r.identity.map(other));
        permuted
    }

    pub(crate) fn cluster(&self, identity: u32) -> Option<&Cluster> {
        self.clusters.get(usize::try_from(identity).ok()?.checked_sub(1)?)
    }

    fn reference(&self, view: usize) -> Option<&Reference> {
        self.references.binary_search_by_key(&view, |r| r.view).ok().map(|at| &self.references[at])
    }
}

impl Grouping {
    /// Refuses a setting out of range.
    pub(crate) fn check(&self) -> Result<(), ClusterError> {
        let at_least = |key, value: usize, min, allowed| {
            if value < min {
                return Err(ClusterError::Setting { key, value: value.to_string(), allowed });
            }
            Ok(())
        };
        let weight = match self {
            Self::Anchors(config) => {
                at_least("anchors", config.anchors, 1, "at least 1")?;
                at_least("neighbours", config.neighbours, 1, "at least 1")?;
                config.direction_weight
            }
            Self::ByContributor { min_views, direction_weight } => {
                at_least("min_views", *min_views, 2, "at least 2: one view says nothing about how far it reaches")?;
                *direction_weight
            }
        };
        if !(weight.is_finite() && weight >= 0.0) {
            let (key, allowed) = ("direction_weight", "a finite number, at least 0");
            return Err(ClusterError::Setting { key, value: weight.to_string(), allowed });
        }
        Ok(())
    }
}

impl TryFrom<Raw> for Clusters {
    type Error = ClusterError;

    fn try_from(raw: Raw) -> Result<Self, ClusterError> {
        let damaged = |problem: String| Err(ClusterError::Damaged { problem });
        raw.grouping.check()?;
        if !raw.metric.is_valid() {
            return damaged(format!("the metric is {:?}", raw.metric));
        }
        if !raw.references.is_sorted_by(|a, b| a.view < b.view) {
            return damaged("the views are not in order".to_owned());
        }
        if let Some(r) = raw.references.iter().find(|r| Pose::new(r.pose.rotation, r.pose.position).is_err()) {
            return damaged(format!("the pose of view {} is none", r.view));
        }
        let clusters =
            Self { metric: raw.metric, clusters: raw.clusters, grouping: raw.grouping, references: raw.references };
        for (i, cluster) in clusters.clusters.iter().enumerate() {
            if cluster.identity as usize != i + 1 {
                return damaged(format!("identity {} stands in place {}", cluster.identity, i + 1));
            }
            let theirs = |view: &usize| clusters.reference(*view).is_some_and(|r| r.identity == Some(cluster.identity));
            let valid_radius = cluster.radius.is_finite() && cluster.radius >= 0.0;
            if !valid_radius || !theirs(&cluster.anchor) || !cluster.members.iter().all(theirs) {
                return damaged(format!("identity {} has a member or a radius that is not its own", cluster.identity));
            }
        }
        let known = |r: &Reference| r.identity.is_none_or(|identity| clusters.cluster(identity).is_some());
        if clusters.clusters.is_empty() || !clusters.references.iter().all(known) {
            return damaged("a view belongs to an identity that there is not".to_owned());
        }
        Ok(clusters)
    }
}
