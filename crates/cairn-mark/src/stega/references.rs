//! What owners' renders look like to the classifier at the end of a training, as they are and
//! after what happens to pictures: how far from these a picture may lie and still be
//! believed is learnt from it (`out_of_distribution`).

use crate::attack::{Attack, Distortion};
use crate::detect::blind::out_of_distribution::{OutOfDistribution, RenderFeatures};
use crate::error::MarkError;
use crate::marked::MarkedField;
use crate::progress::Progress;
use crate::stega::poses::{PlannedView, at_most, evenly, virtual_views};
use crate::stega::recipe::{Guidance, Recipe};
use crate::stega::sample::as_a_file;
use crate::stega::site::Site;
use crate::stega::state::State;
use crate::tensors::{shrunk, to_tensor, winner};
use cairn_scene::Picture;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Marked renders of an owner, at least, and of all owners together.
const RENDERS_EACH: usize = 192;
const RENDERS: usize = 384;
/// Stream of their draws, apart from steps' and the judge's.
const STREAM: u64 = 1 << 34;
/// Views of an owner that are rendered as files.
const FILES: usize = 24;
/// Views of an owner that no step saw, which are rendered as files as well.
const UNSEEN: usize = 24;
/// The least share of a side that a cut leaves.
const MIN_CUT: f32 = 0.6;

/// Where each owner's renders lie, as they are and after what happens to pictures; `None` where nobody asks, or
/// an owner's are all the same. `hears` is asked before each picture, as [`Progress`] has it.
///
/// # Errors
/// [`MarkError::NotFinite`] for a feature that is not; [`MarkError`] for marks that do not fit their field;
/// [`MarkError::Stopped`].
pub(crate) fn references(
    state: &State,
    hears: &mut dyn FnMut(usize, usize) -> bool,
) -> Result<Option<OutOfDistribution>, MarkError> {
    let (beyond, owners) = (state.config.max_feature_distance, state.signals.len());
    if beyond == 0.0 || state.config.guidance == Guidance::NoClassifier {
        return Ok(None);
    }
    let mut rng = ChaCha8Rng::seed_from_u64(state.seed);
    rng.set_stream(STREAM);
    let each = RENDERS_EACH.max(RENDERS.div_ceil(owners));
    // Where views are few, or many, some more or less.
    let files = if state.config.robust.enabled { FILES } else { 0 };
    let progress = Progress::new(0, owners * (each + files + UNSEEN), hears);
    let mut classes = Vec::with_capacity(owners);
    let mut shows = Shows { state, rng, progress };
    for site in &state.sites {
        let field = marked(state, site)?;
        for identity in site.identities.clone() {
            let mut class = match state.config.robust.enabled {
                true => shows.distorted_files(&field, site, identity, each)?,
                false => shows.trained_views(site, identity, each)?,
            };
            class.extend(shows.unseen_files(&field, site, identity)?);
            classes.push(class);
        }
    }
    match classes.iter().flatten().flat_map(|r| &r.features).all(|v| v.is_finite()) {
        true => Ok(OutOfDistribution::fit(&classes, beyond)),
        false => Err(MarkError::NotFinite { step: None, place: "a feature of a marked render".into() }),
    }
}

/// Shows marked renders to the classifier, one after another.
struct Shows<'a> {
    state: &'a State,
    rng: ChaCha8Rng,
    progress: Progress<'a>,
}

impl Shows<'_> {
    /// Each view that `identity` is trained on as it is, then again and again after something.
    fn trained_views(&mut self, site: &Site, identity: usize, each: usize) -> Result<Vec<RenderFeatures>, MarkError> {
        let state = self.state;
        let own = identity - site.identities.start;
        let (views, staying) = (site.bank.views_of(own), site.bank.staying(own));
        let mut renders = Vec::with_capacity(each);
        for at in 0..each.max(views.len()) {
            self.progress.next()?;
            let (view, distorted) = (views[at % views.len()], at >= views.len());
            let attack = if distorted { Attack::one(&state.config.robust, &mut self.rng) } else { Attack::none() };
            // The unmarked pair meets the same.
            let mut same = self.rng.clone();
            let picture = as_a_file(state, site, Some(identity), view, &attack, distorted, &mut self.rng);
            let pair = || as_a_file(state, site, None, view, &attack, distorted, &mut same);
            // A view that came late may not be read yet, and then says nothing of where marks are.
            let late = site.config.view_refresh_steps > 0 && at % views.len() >= staying;
            let features = features_if_read(state, picture, pair, identity, distorted || late)?;
            renders.extend(features.map(|features| RenderFeatures { view, distorted, unseen: false, features }));
        }
        Ok(renders)
    }

    /// Views of `identity` between its photographs, drawn anew, at their own size (`mark.robust.native_px` at most).
    fn unseen_files(
        &mut self,
        field: &MarkedField,
        site: &Site,
        identity: usize,
    ) -> Result<Vec<RenderFeatures>, MarkError> {
        let (number, members) = members(field, site, identity);
        let views = virtual_views(field.clusters(), number, &members, UNSEEN, &mut self.rng);
        let side = self.state.config.shown_px();
        let mut renders = Vec::with_capacity(views.len());
        for (view, PlannedView { camera, appearance }) in views.iter().enumerate() {
            self.progress.next()?;
            let camera = at_most(camera, self.state.config.robust.native_px);
            let render = field.render_as(&camera, appearance, Some(number)).in_8_bits();
            // As after a distortion: what is not read says nothing of where marks are.
            let pair = || shrunk(&field.base().render(&camera, appearance).in_8_bits(), side);
            let features = features_if_read(self.state, shrunk(&render, side), pair, identity, true)?;
            renders.extend(features.map(|features| RenderFeatures { view, distorted: false, unseen: true, features }));
        }
        Ok(renders)
    }

    /// Views of `identity` at their own size (`mark.robust.native_px` at most), as they are and after one distortion or
    /// several. Marks that outlast distortions are met as files that went through them, and a small render made large
    /// suffers differently: learnt from such, every third mark after JPEG 50 was out of distribution.
    fn distorted_files(
        &mut self,
        field: &MarkedField,
        site: &Site,
        identity: usize,
        each: usize,
    ) -> Result<Vec<RenderFeatures>, MarkError> {
        let (state, rng) = (self.state, &mut self.rng);
        let robust = &state.config.robust;
        let side = state.config.shown_px();
        let (number, members) = members(field, site, identity);
        let mut views = evenly(members, FILES);
        let between = virtual_views(field.clusters(), number, &views, FILES - views.len(), rng);
        views.extend(between);
        let copies = each.div_ceil(views.len().max(1));
        let mut renders = Vec::with_capacity(views.len() * (1 + copies));
        for (view, PlannedView { camera, appearance }) in views.iter().enumerate() {
            self.progress.next()?;
            let camera = at_most(camera, robust.native_px);
            let render = field.render_as(&camera, appearance, Some(number)).in_8_bits();
            let bare = field.base().render(&camera, appearance).in_8_bits();
            let pair = || shrunk(&bare, side);
            let features = features_if_read(state, shrunk(&render, side), pair, identity, false)?;
            renders.extend(features.map(|features| RenderFeatures { view, distorted: false, unseen: false, features }));
            for copy in 0..copies {
                self.progress.next()?;
                let attack = match copy % 3 {
                    0 => Attack::one(robust, rng),
                    _ => Attack::always(robust, rng),
                };
                let cut = rng.random_bool(0.5).then(|| Distortion::Crop {
                    kept: rng.random_range(MIN_CUT..1.0),
                    across: rng.random_range(0.0..1.0),
                    down: rng.random_range(0.0..1.0),
                });
                let after = |picture: &Picture| {
                    let cut = cut.as_ref().map_or_else(|| picture.clone(), |cut| cut.apply(picture, 0));
                    shrunk(&attack.on_file(&cut).in_8_bits(), side)
                };
                let features = features_if_read(state, after(&render), || after(&bare), identity, true)?;
                renders.extend(features.map(|f| RenderFeatures { view, distorted: true, unseen: false, features: f }));
            }
        }
        Ok(renders)
    }
}

/// The number of `identity` within its scene, and the views that photographs of its cluster were taken from.
fn members(field: &MarkedField, site: &Site, identity: usize) -> (u32, Vec<PlannedView>) {
    let number = (identity - site.identities.start) as u32 + 1;
    let of = |v: &&PlannedView| field.clusters().identity_of(&v.camera.pose).identity == Some(number);
    (number, site.scene.plan.views.iter().filter(of).cloned().collect())
}

/// The classifier's features of `picture`, `side x side x 3`; with `must_be_read` none where the mark is unreadable,
/// which says nothing of where one is read. It is read where its `pair`, which met the same without the mark, is not
/// taken for the identity's as well: there the distortion spoke, and whatever met the same would be believed.
fn features_if_read(
    state: &State,
    picture: Vec<f32>,
    pair: impl FnOnce() -> Vec<f32>,
    identity: usize,
    must_be_read: bool,
) -> Result<Option<Vec<f32>>, MarkError> {
    let (features, class) = features(state, picture)?;
    let is_read = !must_be_read || is_read(identity + 1, class, || Ok(self::features(state, pair())?.1))?;
    Ok(is_read.then_some(features))
}

/// The features of a picture, and the class that the classifier alone gives it.
fn features(state: &State, picture: Vec<f32>) -> Result<(Vec<f32>, usize), MarkError> {
    let classifier = &state.networks.classifier;
    let features = classifier.features(&to_tensor(&[picture], state.config.shown_px())?)?;
    let logits = classifier.classify(&features)?.flatten_all()?.to_vec1::<f32>()?;
    Ok((features.flatten_all()?.to_vec1::<f32>()?, winner(&logits)))
}

/// A scene's marked field as it stands.
fn marked(state: &State, site: &Site) -> Result<MarkedField, MarkError> {
    let carriers = state.carriers[site.carriers.clone()].iter().map(|c| c.values.clone()).collect();
    let Recipe { carrier, density, .. } = state.config;
    MarkedField::new(site.scene.field.clone(), site.scene.plan.clusters.clone(), carrier, density, carriers)
}

/// Whether the mark of `class` is what a classifier goes by that says `said` of a marked render: it says otherwise of its `pair`.
fn is_read(class: usize, said: usize, pair: impl FnOnce() -> Result<usize, MarkError>) -> Result<bool, MarkError> {
    Ok(said == class && pair()? != class)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mark_is_read_where_the_same_without_it_is_not_taken_for_one() {
        assert!(is_read(2, 2, || Ok(0)).unwrap());
        assert!(is_read(2, 2, || Ok(1)).unwrap(), "the distortion speaks for another, and the mark against it");
        assert!(!is_read(2, 2, || Ok(2)).unwrap(), "the distortion says as much");
        assert!(!is_read(2, 0, || panic!("a pair was shown for nothing")).unwrap());
    }
}
