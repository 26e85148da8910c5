//! The views stage 2 trains on: each cluster's photographs' poses and virtual
//! ones between them, with ray weights worked out once, and unmarked pictures.

use crate::config::MarkConfig;
use crate::error::MarkError;
use crate::negatives::{Negatives, shrunk};
use crate::poses::{PlannedView, at_most, virtual_views};
use crate::trainer::MarkPlan;
use crate::window::Window;
use cairn_field::operator::{LinearView, MarkableField};
use cairn_field::{Appearance, Field};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Entries of a view's linear map below this share of a pixel are left out
/// while training: a quarter of an 8-bit step at full contrast.
const CUTOFF: f32 = 1e-3;
/// Virtual poses a cluster is judged on, and base renders outside clusters.
pub(crate) const JUDGED: usize = 3;

/// A view to train on.
pub(crate) struct BankView {
    pub(crate) linear: LinearView,
    pub(crate) appearance: Appearance,
}

/// See the module's text.
pub(crate) struct Bank {
    pub(crate) views: Vec<BankView>,
    /// Views of each identity, from 0.
    of: Vec<Vec<usize>>,
    /// Views of nobody's cluster, to be silent on; without entries for marks.
    outside: Vec<BankView>,
    negatives: Negatives,
    /// Virtual views kept for judging: identity (from 0) and view.
    pub(crate) judged: Vec<(usize, BankView)>,
    /// Unmarked pictures kept for judging, at the networks' size.
    pub(crate) judged_unmarked: Vec<Vec<f32>>,
}

impl Bank {
    /// Works out all ray weights; everything drawn follows from `seed`.
    pub(crate) fn new(field: &Field, plan: &MarkPlan, config: &MarkConfig, seed: u64) -> Result<Self, MarkError> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let side = config.side_px();
        let small: Vec<PlannedView> = plan
            .views
            .iter()
            .map(|v| PlannedView {
                camera: at_most(&v.camera, config.longest_side_px),
                appearance: v.appearance.clone(),
            })
            .collect();
        let identity_of = |v: &PlannedView| plan.clusters.identity_of(&v.camera.pose).identity;
        let prepared = |v: PlannedView| BankView { linear: field.view(&v.camera, CUTOFF), appearance: v.appearance };
        let (mut views, mut of, mut judged) = (Vec::new(), Vec::new(), Vec::new());
        for cluster in &plan.clusters.clusters {
            let members: Vec<PlannedView> =
                small.iter().filter(|v| identity_of(v) == Some(cluster.identity)).cloned().collect();
            if members.is_empty() {
                return Err(MarkError::Plan(format!(
                    "identity {} has no training view; ask for fewer anchors or more neighbours",
                    cluster.identity
                )));
            }
            let between = virtual_views(&plan.clusters, cluster.identity, &members, config.virtual_views, &mut rng);
            let held = virtual_views(&plan.clusters, cluster.identity, &members, JUDGED, &mut rng);
            let first = views.len();
            views.extend(members.into_iter().chain(between).map(prepared));
            of.push((first..views.len()).collect());
            judged.extend(held.into_iter().map(|v| (cluster.identity as usize - 1, prepared(v))));
        }
        // Every fifth unmarked picture judges and does not teach.
        let (mut outside, mut teach, mut judge) = (Vec::new(), Vec::new(), Vec::new());
        let kept_to_judge = |i: usize, judge: &Vec<_>, most: usize| i % 5 == 4 && judge.len() < most;
        for (i, v) in small.iter().filter(|v| identity_of(v).is_none()).enumerate() {
            if kept_to_judge(i, &judge, 4 * JUDGED) {
                judge.push(shrunk(&field.render(&v.camera, &v.appearance), side));
            } else {
                let linear = field.view(&v.camera, f32::INFINITY);
                outside.push(BankView { linear, appearance: v.appearance.clone() });
            }
        }
        for (i, photograph) in plan.negatives.iter().enumerate() {
            let list = if kept_to_judge(i, &judge, 8 * JUDGED) { &mut judge } else { &mut teach };
            list.push(shrunk(photograph, side));
        }
        Ok(Self {
            views,
            of,
            outside,
            negatives: Negatives::new(side, teach.into_iter()),
            judged,
            judged_unmarked: judge,
        })
    }

    /// An unmarked picture: as often the base field's render of any view in any
    /// light as a picture of something else.
    pub(crate) fn unmarked(&self, side: usize, rng: &mut ChaCha8Rng) -> Vec<f32> {
        if rng.random_range(0..2) == 0 {
            return self.negatives.draw(rng);
        }
        let at = rng.random_range(0..self.views.len() + self.outside.len());
        let view = self.views.get(at).unwrap_or_else(|| &self.outside[at - self.views.len()]);
        let mut base = view.linear.base(&self.mixed(&view.appearance, rng));
        base.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
        Window::draw(view.linear.width(), view.linear.height(), side, rng).apply(&base)
    }

    /// A view of `identity` (from 0).
    pub(crate) fn draw(&self, identity: usize, rng: &mut ChaCha8Rng) -> usize {
        let of = &self.of[identity];
        of[rng.random_range(0..of.len())]
    }

    /// The appearance to show a view in.
    pub(crate) fn appearance(&self, view: usize, rng: &mut ChaCha8Rng) -> Appearance {
        self.mixed(&self.views[view].appearance, rng)
    }

    /// As often a view's own appearance as one on the way to another's: marks
    /// must outlast a change of light, and unmarked pictures come in any.
    fn mixed(&self, own: &Appearance, rng: &mut ChaCha8Rng) -> Appearance {
        let (other, share) = (rng.random_range(0..self.views.len()), rng.random_range(-1.0f32..1.0));
        if share <= 0.0 { own.clone() } else { own.mixed(&self.views[other].appearance, share) }
    }
}
