//! What owners' renders look like to the classifier at the end of a training, as they are and
//! after what happens to pictures: how far from these a picture may lie and still be
//! believed is learnt from it (`familiar`).

use crate::attack::{Attack, Distortion};
use crate::detect::blind::networks::to_tensor;
use crate::detect::blind::out_of_distribution::{Familiar, Shown};
use crate::error::MarkError;
use crate::marked::MarkedField;
use crate::progress::Progress;
use crate::stega::judge::winner;
use crate::stega::negatives::shrunk;
use crate::stega::poses::{PlannedView, at_most, evenly, virtual_views};
use crate::stega::recipe::Guidance;
use crate::stega::site::Site;
use crate::stega::trainer::MarkTrainer;
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
const FRESH: usize = 24;
/// The least share of a side that a cut leaves.
const MIN_CUT: f32 = 0.6;

impl MarkTrainer {
    /// Where each owner's renders lie, as they are and after what happens to pictures; `None` where nobody asks, or
    /// an owner's are all the same. `hears` is asked before each picture, as [`Progress`] has it.
    ///
    /// # Errors
    /// [`MarkError::NotFinite`] for a feature that is not; [`MarkError`] for marks that do not fit their field;
    /// [`MarkError::Stopped`].
    pub(crate) fn familiar(&self, hears: &mut dyn FnMut(usize, usize) -> bool) -> Result<Option<Familiar>, MarkError> {
        let (beyond, owners) = (self.config.max_feature_distance, self.signals.len());
        if beyond == 0.0 || self.config.guidance == Guidance::NoClassifier {
            return Ok(None);
        }
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(STREAM);
        let each = RENDERS_EACH.max(RENDERS.div_ceil(owners));
        // Where views are few, or many, some more or less.
        let files = if self.config.robust.enabled { FILES } else { 0 };
        let mut progress = Progress::new((0, owners * (each + files + FRESH)), hears);
        let mut classes = Vec::with_capacity(owners);
        for site in &self.sites {
            let field = self.marked(site)?;
            for identity in site.identities.clone() {
                let mut class = match self.config.robust.enabled {
                    true => self.as_harmed_files(&field, (site, identity), each, (&mut rng, &mut progress))?,
                    false => self.as_trained_on((site, identity), each, (&mut rng, &mut progress))?,
                };
                class.extend(self.as_fresh_files(&field, (site, identity), (&mut rng, &mut progress))?);
                classes.push(class);
            }
        }
        match classes.iter().flatten().flat_map(|r| &r.features).all(|v| v.is_finite()) {
            true => Ok(Familiar::fit(&classes, beyond)),
            false => Err(MarkError::NotFinite { step: None, place: "a feature of a marked render".into() }),
        }
    }

    /// Each view that `identity` is trained on as it is, then again and again after something.
    fn as_trained_on(
        &self,
        (site, identity): (&Site, usize),
        each: usize,
        (rng, progress): (&mut ChaCha8Rng, &mut Progress<'_>),
    ) -> Result<Vec<Shown>, MarkError> {
        let own = identity - site.identities.start;
        let (views, staying) = (site.bank.views_of(own), site.bank.staying(own));
        let mut renders = Vec::with_capacity(each);
        for at in 0..each.max(views.len()) {
            progress.next()?;
            let (view, harmed) = (views[at % views.len()], at >= views.len());
            let attack = if harmed { Attack::one(&self.config.robust, rng) } else { Attack::none() };
            // The twin meets the same.
            let mut same = rng.clone();
            let picture = self.as_a_file(site, Some(identity), view, (&attack, harmed), rng);
            let twin = || self.as_a_file(site, None, view, (&attack, harmed), &mut same);
            // A view that came late may not be read yet, and then says nothing of where marks are.
            let late = site.config.view_refresh_steps > 0 && at % views.len() >= staying;
            let shown = self.shown((picture, twin), identity, (view, harmed || late))?;
            renders.extend(shown.map(|shown| Shown { harmed, ..shown }));
        }
        Ok(renders)
    }

    /// Views of `identity` between its photographs, drawn anew, at their own size (`mark.robust.native_px` at most).
    fn as_fresh_files(
        &self,
        field: &MarkedField,
        (site, identity): (&Site, usize),
        (rng, progress): (&mut ChaCha8Rng, &mut Progress<'_>),
    ) -> Result<Vec<Shown>, MarkError> {
        let (number, members) = self.members(field, (site, identity));
        let views = virtual_views(field.clusters(), number, &members, FRESH, rng);
        let shown = views.iter().enumerate().map(|(view, PlannedView { camera, appearance })| {
            progress.next()?;
            let camera = at_most(camera, self.config.robust.native_px);
            let side = self.config.shown_px();
            let render = field.render_as(&camera, appearance, Some(number)).in_8_bits();
            // As with harm: what is not read says nothing of where marks are.
            let twin = || shrunk(&field.base().render(&camera, appearance).in_8_bits(), side);
            let shown = self.shown((shrunk(&render, side), twin), identity, (view, true))?;
            Ok(shown.map(|shown| Shown { harmed: false, fresh: true, ..shown }))
        });
        Ok(shown.collect::<Result<Vec<_>, MarkError>>()?.into_iter().flatten().collect())
    }

    /// The number of `identity` within its scene, and the views that photographs of its cluster were taken from.
    fn members(&self, field: &MarkedField, (site, identity): (&Site, usize)) -> (u32, Vec<PlannedView>) {
        let number = (identity - site.identities.start) as u32 + 1;
        let of = |v: &&PlannedView| field.clusters().identity_of(&v.camera.pose).identity == Some(number);
        (number, site.scene.plan.views.iter().filter(of).cloned().collect())
    }

    /// Views of `identity` at their own size (`mark.robust.native_px` at most), as they are and after one thing or several. Marks that outlast harm are
    /// met as files that went through it, and what it does to a small render
    /// made large is something else: learnt from such, every third mark after JPEG 50 was unfamiliar.
    fn as_harmed_files(
        &self,
        field: &MarkedField,
        (site, identity): (&Site, usize),
        each: usize,
        (rng, progress): (&mut ChaCha8Rng, &mut Progress<'_>),
    ) -> Result<Vec<Shown>, MarkError> {
        let side = self.config.shown_px();
        let (number, members) = self.members(field, (site, identity));
        let mut views = evenly(members, FILES);
        let between = virtual_views(field.clusters(), number, &views, FILES - views.len(), rng);
        views.extend(between);
        let copies = each.div_ceil(views.len().max(1));
        let mut renders = Vec::with_capacity(views.len() * (1 + copies));
        for (view, PlannedView { camera, appearance }) in views.iter().enumerate() {
            progress.next()?;
            let camera = at_most(camera, self.config.robust.native_px);
            let render = field.render_as(&camera, appearance, Some(number)).in_8_bits();
            let bare = field.base().render(&camera, appearance).in_8_bits();
            renders.extend(self.shown((shrunk(&render, side), || shrunk(&bare, side)), identity, (view, false))?);
            for copy in 0..copies {
                progress.next()?;
                let attack = match copy % 3 {
                    0 => Attack::one(&self.config.robust, rng),
                    _ => Attack::always(&self.config.robust, rng),
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
                renders.extend(self.shown((after(&render), || after(&bare)), identity, (view, true))?);
            }
        }
        Ok(renders)
    }

    /// What the classifier makes of `picture`, `side x side x 3`; nothing where harm has made the mark unreadable: that
    /// says nothing of where one is read. It is read where its `twin`, which met the same without the mark, is not taken for
    /// the identity's as well: there it was the harm that spoke, and whatever is harmed so would be believed.
    fn shown(
        &self,
        (picture, twin): (Vec<f32>, impl FnOnce() -> Vec<f32>),
        identity: usize,
        (view, harmed): (usize, bool),
    ) -> Result<Option<Shown>, MarkError> {
        let (features, said) = self.told(picture)?;
        let is_read = !harmed || is_read(identity + 1, said, || Ok(self.told(twin())?.1))?;
        Ok(is_read.then_some(Shown { view, harmed, fresh: false, features }))
    }

    /// The features of a picture, and the class that the classifier alone gives it.
    fn told(&self, picture: Vec<f32>) -> Result<(Vec<f32>, usize), MarkError> {
        let features = self.networks.classifier.features(&to_tensor(&[picture], self.config.shown_px())?)?;
        let said = self.networks.classifier.classify(&features)?.flatten_all()?.to_vec1::<f32>()?;
        Ok((features.flatten_all()?.to_vec1::<f32>()?, winner(&said)))
    }

    /// A scene's marked field as it stands.
    fn marked(&self, site: &Site) -> Result<MarkedField, MarkError> {
        let carriers = self.carriers[site.carriers.clone()].iter().map(|c| c.values.clone()).collect();
        let kind = (self.config.carrier, self.config.density);
        MarkedField::new(site.scene.field.clone(), site.scene.plan.clusters.clone(), kind, carriers)
    }
}

/// Whether the mark of `class` is what a classifier goes by that says `said` of a marked render: it says otherwise of its `twin`.
fn is_read(class: usize, said: usize, twin: impl FnOnce() -> Result<usize, MarkError>) -> Result<bool, MarkError> {
    Ok(said == class && twin()? != class)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mark_is_read_where_the_same_without_it_is_not_taken_for_one() {
        assert!(is_read(2, 2, || Ok(0)).unwrap());
        assert!(is_read(2, 2, || Ok(1)).unwrap(), "harm speaks for another, and the mark against it");
        assert!(!is_read(2, 2, || Ok(2)).unwrap(), "harm says as much");
        assert!(!is_read(2, 0, || panic!("a twin was shown for nothing")).unwrap());
    }
}
