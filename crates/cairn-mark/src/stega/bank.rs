//! The views stage 2 trains on: each cluster's photographs' poses and virtual
//! ones between them, with ray weights worked out once a view, and unmarked pictures.

use crate::attack::{Attack, Distortion};
use crate::error::MarkError;
use crate::progress::Progress;
use crate::stega::hard_examples::Draws;
use crate::stega::negatives::Negatives;
use crate::stega::plan::{MarkPlan, MarkScene};
use crate::stega::poses::{PlannedView, at_most, covering, evenly, virtual_views};
use crate::stega::recipe::{CarrierKind, DensityKind, Recipe};
use crate::stega::view_refresh::{Fresh, Stream};
use crate::stega::window::Window;
use crate::tensors::shrunk;
use cairn_field::MarchedView;
use cairn_field::{Appearance, Field};
use cairn_field::{LinearView, MarkableField};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Entries of a view's linear map below this share of a pixel are left out
/// while training: a quarter of an 8-bit step at full contrast.
const CUTOFF: f32 = 1e-3;
/// Virtual poses a cluster is judged on at least, and base renders outside clusters.
pub(crate) const JUDGED: usize = 3;
/// One more virtual pose to judge on for so many that teach.
const TEACH_PER_JUDGED: usize = 8;
/// Times as many poses are trained on where those of the only cluster look far apart; of several, each has
/// its part, so that ray weights of many clusters still fit.
const MAX_TIMES: usize = 3;
/// Each photograph is an unmarked picture as it is, and as a JPEG of one of these.
const QUALITIES: [u8; 4] = [50, 75, 30, 90];
/// A view is settled when its cross-entropy is below this share of `classify_until`.
const SETTLED: f64 = 0.2;
/// Most rays across a pixel.
const MAX_RAYS: usize = 3;

/// A view to train on.
pub(crate) struct BankView {
    /// theta_0's picture, and where colours alone move what a carrier adds to it.
    pub(crate) linear: LinearView,
    /// For theta's, where densities are free and a carrier is seen here.
    marched: Option<MarchedView>,
    pub(crate) appearance: Appearance,
}

impl BankView {
    /// The view to be marched, of a bank for free densities.
    pub(crate) fn marched(&self) -> &MarchedView {
        self.marched.as_ref().expect("a bank for free densities marches the views that marks are seen on")
    }
}

/// See the module's text.
pub(crate) struct Bank {
    pub(crate) views: Vec<BankView>,
    /// Views of each identity, from 0.
    of: Vec<Vec<usize>>,
    /// Which of them come up next.
    pub(crate) draws: Draws,
    /// Views of nobody's cluster, to be silent on.
    outside: Vec<BankView>,
    /// Whether a carrier is seen on those as well; else they are without entries for marks.
    marked_outside: bool,
    negatives: Negatives,
    /// How many of them are shown for each base render.
    others: u32,
    /// Virtual views kept for judging: identity (from 0) and view.
    pub(crate) judged: Vec<(usize, BankView)>,
    /// Views of nobody's cluster kept for judging, where a carrier is seen on them.
    pub(crate) judged_outside: Vec<BankView>,
    /// Unmarked pictures kept for judging, at the networks' size.
    pub(crate) judged_unmarked: Vec<Vec<f32>>,
    /// Where virtual views come and go.
    stream: Stream,
}

/// The views of a bank before their ray weights are worked out.
pub(crate) struct Chosen {
    /// Each identity's views to train on, virtual ones last, and those to judge it by.
    of: Vec<(Vec<PlannedView>, Vec<PlannedView>)>,
    stream: Stream,
    outside: Vec<PlannedView>,
    judged_outside: Vec<PlannedView>,
}

impl Chosen {
    /// Everything drawn follows from `seed`.
    pub(crate) fn draw(plan: &MarkPlan, config: &Recipe, seed: u64) -> Result<Self, MarkError> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let shrink = |v: &PlannedView| PlannedView {
            camera: at_most(&v.camera, config.longest_side_px),
            appearance: v.appearance.clone(),
        };
        let small: Vec<PlannedView> = plan.views.iter().map(shrink).collect();
        let identity_of = |v: &PlannedView| plan.clusters.identity_of(&v.camera.pose).identity;
        let most = config.views.max(MAX_TIMES * config.views / plan.clusters.clusters.len().max(1));
        let (mut of, mut stream) = (Vec::new(), Stream::new(seed));
        for cluster in &plan.clusters.clusters {
            let members = small.iter().filter(|v| identity_of(v) == Some(cluster.identity)).cloned().collect();
            let members = covering(members, config.views, most, config.views_apart_deg);
            if members.is_empty() {
                return Err(MarkError::Plan(format!(
                    "identity {} has no training view; ask for fewer anchors or more neighbours",
                    cluster.identity
                )));
            }
            // Where photographs look far apart, there is as much to see between them.
            let apart = members.len() > config.views && config.virtual_views > 0;
            let between = if apart { members.len() } else { config.virtual_views };
            let between = virtual_views(&plan.clusters, cluster.identity, &members, between, &mut rng);
            let held = JUDGED.max(members.len() / TEACH_PER_JUDGED);
            let held = virtual_views(&plan.clusters, cluster.identity, &members, held, &mut rng);
            stream.add(cluster.identity, members.clone(), between.len());
            of.push((members.into_iter().chain(between).collect(), held));
        }
        let (mut outside, mut judged_outside) = (Vec::new(), Vec::new());
        let nobodys = small.into_iter().filter(|v| identity_of(v).is_none()).collect();
        for (i, v) in evenly(nobodys, 2 * config.views).into_iter().enumerate() {
            let list =
                if kept_to_judge(i, judged_outside.len(), 4 * JUDGED) { &mut judged_outside } else { &mut outside };
            list.push(v);
        }
        Ok(Self { of, stream, outside, judged_outside })
    }

    /// With the first `count` fresh views of a training in their places.
    pub(crate) fn renewed(mut self, plan: &MarkPlan, count: u64) -> Self {
        for Fresh { identity, place, view } in self.stream.last(&plan.clusters, count) {
            self.of[identity].0[place] = view;
        }
        self
    }

    pub(crate) fn len(&self) -> usize {
        let of: usize = self.of.iter().map(|(views, judged)| views.len() + judged.len()).sum();
        of + self.outside.len() + self.judged_outside.len()
    }
}

/// Rays across a pixel of the small views that training looks at. What people have are
/// pictures of the views' own size, made smaller for the networks: detail that one ray a
/// small pixel would see at random is averaged away there, and a mark trained on it is lost.
fn rays_across(plan: &MarkPlan, config: &Recipe) -> usize {
    let longest = |v: &PlannedView| v.camera.intrinsics.width.max(v.camera.intrinsics.height);
    let own = plan.views.iter().map(longest).max().unwrap_or(1);
    (own as f64 / config.longest_side_px as f64).ceil().clamp(1.0, MAX_RAYS as f64) as usize
}

/// Every fifth unmarked picture judges and does not teach, up to `most` that judge.
fn kept_to_judge(i: usize, so_far: usize, most: usize) -> bool {
    i % 5 == 4 && so_far < most
}

/// How ray weights of a scene's views are worked out.
struct Rays {
    field: Arc<Field>,
    /// Rays across a pixel of the views.
    across: usize,
    /// Whether densities move as well.
    free: bool,
}

impl Rays {
    fn new(scene: &MarkScene, config: &Recipe) -> Self {
        let (across, free) = (rays_across(&scene.plan, config), config.density == DensityKind::Free);
        Self { field: scene.field.clone(), across, free }
    }

    fn view(&self, v: PlannedView, cutoff: f32) -> BankView {
        // Entries are for colours alone.
        let marched = (self.free && cutoff.is_finite()).then(|| MarchedView::new(&v.camera, self.across));
        let cutoff = if self.free { f32::INFINITY } else { cutoff };
        BankView { linear: self.field.view(&v.camera, cutoff, self.across), marched, appearance: v.appearance }
    }
}

/// Works out ray weights, view after view, as long as `progress` wants it.
pub(crate) struct Prepare<'a> {
    rays: Rays,
    progress: Progress<'a>,
}

impl<'a> Prepare<'a> {
    /// For `scene`; `progress` goes through the views of all scenes.
    pub(crate) fn new(scene: &MarkScene, config: &Recipe, progress: Progress<'a>) -> Self {
        Self { rays: Rays::new(scene, config), progress }
    }

    fn view(&mut self, v: PlannedView, cutoff: f32) -> Result<BankView, MarkError> {
        self.progress.next()?;
        Ok(self.rays.view(v, cutoff))
    }

    fn views(&mut self, views: Vec<PlannedView>, cutoff: f32) -> Result<Vec<BankView>, MarkError> {
        views.into_iter().map(|v| self.view(v, cutoff)).collect()
    }
}

impl Bank {
    /// Works out all ray weights of the views `chosen`.
    pub(crate) fn new(
        plan: &MarkPlan,
        chosen: Chosen,
        config: &Recipe,
        prepare: &mut Prepare<'_>,
    ) -> Result<Self, MarkError> {
        let side = config.shown_px();
        let (mut views, mut of, mut judged) = (Vec::new(), Vec::new(), Vec::new());
        for (identity, (teach, judge)) in chosen.of.into_iter().enumerate() {
            let first = views.len();
            views.extend(prepare.views(teach, CUTOFF)?);
            of.push((first..views.len()).collect());
            judged.extend(prepare.views(judge, CUTOFF)?.into_iter().map(|view| (identity, view)));
        }
        // One carrier for all is seen from everywhere, also where it must say nothing.
        let marked_outside = config.carrier == CarrierKind::Harmonics;
        let outside = prepare.views(chosen.outside, if marked_outside { CUTOFF } else { f32::INFINITY })?;
        let (mut judged_outside, mut judge, mut teach) = (Vec::new(), Vec::new(), Vec::new());
        for v in chosen.judged_outside {
            if marked_outside {
                judged_outside.push(prepare.view(v, CUTOFF)?);
            } else {
                prepare.progress.next()?;
                judge.push(shrunk(&prepare.rays.field.render(&v.camera, &v.appearance), side));
            }
        }
        for (i, photograph) in plan.negatives.iter().enumerate() {
            let kept = kept_to_judge(i, judged_outside.len() + judge.len(), 8 * JUDGED);
            // At the size that files have: what JPEG does to a copy for the networks is something else.
            let photograph = photograph.to_picture();
            let jpeg = Distortion::Jpeg { quality: QUALITIES[i % QUALITIES.len()] }.apply(&photograph, 0);
            let pictures = [&photograph, &jpeg].map(|picture| shrunk(picture, side));
            if kept {
                judge.extend(pictures);
            } else {
                teach.push(pictures);
            }
        }
        let settled = (config.classify_until * SETTLED) as f32;
        Ok(Self {
            draws: Draws::new(views.len(), settled, config.easy_view_share),
            views,
            of,
            outside,
            marked_outside,
            negatives: Negatives::new(side, config, teach.into_iter()),
            others: config.others,
            judged,
            judged_outside,
            judged_unmarked: judge,
            stream: chosen.stream,
        })
    }

    /// Puts the `k`-th fresh view of a training in its place: `ready`, where it was worked out before.
    pub(crate) fn renew(&mut self, scene: &MarkScene, config: &Recipe, k: u64, ready: Option<BankView>) {
        if let Some(Fresh { identity, place, view }) = self.stream.fresh(&scene.plan.clusters, k) {
            let at = self.of[identity][place];
            self.views[at] = ready.unwrap_or_else(|| Rays::new(scene, config).view(view, CUTOFF));
            self.draws.forget(at);
        }
    }

    /// How the `k`-th fresh view is worked out; `None` where none comes.
    pub(crate) fn fresh(
        &self,
        scene: &MarkScene,
        config: &Recipe,
        k: u64,
    ) -> Option<impl FnOnce() -> BankView + Send + 'static + use<>> {
        let Fresh { view, .. } = self.stream.fresh(&scene.plan.clusters, k)?;
        let rays = Rays::new(scene, config);
        Some(move || rays.view(view, CUTOFF))
    }

    /// An unmarked picture, `attack` done to it: one of the base field's renders of any view in any light, or, by
    /// `mark.others`, a picture of something else, with `jpegs` half of those as JPEGs.
    pub(crate) fn unmarked(&self, side: usize, attack: &Attack, jpegs: bool, rng: &mut ChaCha8Rng) -> Vec<f32> {
        if rng.random_range(0..=self.others) < self.others {
            let seen = attack.apply(self.negatives.draw(jpegs, rng), [side, side]);
            return Window::whole(seen.size[0], seen.size[1], side).apply(&seen.rgb);
        }
        let at = rng.random_range(0..self.views.len() + self.outside.len());
        let view = self.view(at);
        let mut base = view.linear.base(&self.mixed(&view.appearance, rng));
        base.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
        let seen = attack.apply(base, [view.linear.width(), view.linear.height()]);
        Window::draw(seen.size[0], seen.size[1], side, rng).apply(&seen.rgb)
    }

    /// A view to train on; those outside all clusters come last.
    pub(crate) fn view(&self, at: usize) -> &BankView {
        self.views.get(at).unwrap_or_else(|| &self.outside[at - self.views.len()])
    }

    /// A view outside all clusters on which a carrier is seen all the same.
    pub(crate) fn draw_outside(&self, rng: &mut ChaCha8Rng) -> Option<usize> {
        let some = self.marked_outside && !self.outside.is_empty();
        some.then(|| self.views.len() + rng.random_range(0..self.outside.len()))
    }

    /// The views of `identity` (from 0).
    pub(crate) fn views_of(&self, identity: usize) -> &[usize] {
        &self.of[identity]
    }

    /// How many of them, the first, stay for all of a training: photographs' poses.
    pub(crate) fn staying(&self, identity: usize) -> usize {
        self.stream.members(identity)
    }

    /// A view of `identity` (from 0).
    pub(crate) fn draw(&self, identity: usize, rng: &mut ChaCha8Rng) -> usize {
        self.draws.draw(&self.of[identity], rng)
    }

    /// How views of `identity` (from 0) were told lately, nats.
    pub(crate) fn told(&self, identity: usize) -> f32 {
        self.draws.told(&self.of[identity])
    }

    /// The appearance to show a view in.
    pub(crate) fn appearance(&self, view: usize, rng: &mut ChaCha8Rng) -> Appearance {
        self.mixed(&self.view(view).appearance, rng)
    }

    /// As often a view's own appearance as one on the way to another's: marks
    /// must outlast a change of light, and unmarked pictures come in any.
    fn mixed(&self, own: &Appearance, rng: &mut ChaCha8Rng) -> Appearance {
        let (other, share) = (rng.random_range(0..self.views.len()), rng.random_range(-1.0f32..1.0));
        if share <= 0.0 { own.clone() } else { own.mixed(&self.views[other].appearance, share) }
    }
}
