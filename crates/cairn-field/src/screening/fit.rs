//! How well a photograph fits its pose: what a scout that never saw it makes of it from there,
//! against what it makes of it from other views' poses.
//!
//! All is compared at the same spots of every picture, in its light (an appearance fitted to half of the
//! spots explains the other half, both ways round). Comparing poses cancels what has
//! nothing to do with the place: how much sky there is, how dark it was, how busy the picture
//! is. A smooth gradient, which an appearance explains from anywhere, gains nothing.

use crate::appearance::code::{Appearance, FEATURES, features};
use crate::appearance::prior::Prior;
use crate::chance::mixed;
use crate::render::composite::{Kept, Thresholds, see};
use crate::train::shown::Shown;
use crate::train::views::Prepared;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Spots along each side of a picture: one anywhere in each of 40 x 40 fields.
const SIDE: usize = 40;
/// Share of a pixel that the inner box has where it is taken to be seen.
const SOLID: f32 = 0.5;
/// Its place among the features.
const NEAR_WEIGHT: usize = 3;
/// Fewer such spots than this are too few to judge by.
const MIN_SPOTS: usize = SIDE * SIDE / 16;
/// Other poses that a photograph is tried at.
const POSES: usize = 24;
/// Spread of the other poses' figures below which it is taken for rounding, dB: noise is
/// explained equally badly from everywhere.
const MIN_SPREAD_DB: f64 = 0.1;

/// How well a photograph fits the pose that it is said to have.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct ViewFit {
    /// The view.
    pub(super) view: String,
    /// PSNR of the photograph as the others explain it from its own pose, less the median of the same
    /// from other poses, dB. About 0, or below, where it has nothing to do with its pose.
    pub(super) fit_db: f64,
    /// The same against the mean over the other poses, in standard deviations of what they
    /// give: what chance makes of a photograph without a pose is within about 1.
    pub(super) deviations: f64,
}

/// Where pictures are compared.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Spot {
    /// Shares of width and height.
    x: f64,
    y: f64,
    /// Which half it is in.
    second: bool,
}

/// A scout that judges views.
pub(super) struct Judge<'a> {
    scout: Shown<'a>,
    views: &'a [Arc<Prepared>],
    spots: Vec<Spot>,
    prior: Prior,
    /// Poses to try photographs at, with what is seen from there.
    others: Vec<(usize, Vec<[f32; FEATURES]>)>,
}

impl<'a> Judge<'a> {
    pub(super) fn new(scout: Shown<'a>, views: &'a [Arc<Prepared>], seed: u64) -> Self {
        let codes: Vec<&Appearance> = scout.appearances.iter().collect();
        // Around the mean, and not like the codes seen: some of them may be poisoned.
        let prior = Prior::around(Appearance::mean(&codes).unwrap_or_else(|| scout.neutral.clone()));
        let mut order: Vec<usize> = (0..views.len()).collect();
        order.sort_by_key(|v| (mixed(seed ^ mixed(!(*v as u64))), *v));
        // One more, since a view is not compared with itself.
        order.truncate(POSES + 1);
        let mut judge = Self { scout, views, spots: spots(seed), prior, others: Vec::new() };
        judge.others = order.into_par_iter().map(|v| (v, judge.seen_from(v))).collect();
        judge
    }

    /// The fit of each of `unseen`, in their order.
    pub(super) fn fits(&self, unseen: &[usize]) -> Vec<ViewFit> {
        unseen.par_iter().map(|view| self.fit(*view)).collect()
    }

    /// Over all of the picture, where outlines tell most, and over what is solid, where the sky that an honest
    /// visitor alone saw does not count: the mean of both.
    fn fit(&self, view: usize) -> ViewFit {
        let (seen, pixels) = (self.seen_from(view), self.pixels(view));
        let shown = |at: &usize| self.views[view].uses(self.pixel_at(view, self.spots[*at]));
        let all: Vec<usize> = (0..seen.len()).filter(shown).collect();
        let solid = solid(&seen, &all);
        let [a, b] = [all, solid].map(|spots| self.fit_at(view, &seen, &pixels, &spots));
        ViewFit { view: self.views[view].name.clone(), fit_db: (a.0 + b.0) / 2.0, deviations: (a.1 + b.1) / 2.0 }
    }

    /// How much better a photograph is explained at these spots by what is seen from its pose than from others:
    /// dB over the median, and standard deviations over the mean.
    fn fit_at(&self, view: usize, seen: &[[f32; FEATURES]], pixels: &[[f32; 3]], spots: &[usize]) -> (f64, f64) {
        let own = self.psnr_db(seen, pixels, spots);
        let elsewhere = self.others.iter().filter(|(other, _)| *other != view).take(POSES);
        let mut all: Vec<f64> = elsewhere.map(|(_, seen)| self.psnr_db(seen, pixels, spots)).collect();
        all.sort_by(f64::total_cmp);
        let mean = all.iter().sum::<f64>() / all.len() as f64;
        let variance = all.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / all.len() as f64;
        (own - all[all.len() / 2], (own - mean) / variance.sqrt().max(MIN_SPREAD_DB))
    }

    /// Which pixel of `view` lies at a spot.
    fn pixel_at(&self, view: usize, spot: Spot) -> usize {
        let (w, h) = self.views[view].lens.size();
        (spot.y * h as f64) as usize * w + (spot.x * w as f64) as usize
    }

    /// What is seen from a view's pose.
    fn seen_from(&self, view: usize) -> Vec<[f32; FEATURES]> {
        let prepared = &self.views[view];
        let mut tape: Vec<Kept<f32>> = Vec::new();
        let one = |spot: &Spot| {
            let at = self.pixel_at(view, *spot);
            let (path, basis) = prepared.eye().ray(self.scout.frame, at);
            features(&see(self.scout.grid, &path, &basis, Thresholds::SHOWN, &mut tape), &basis)
        };
        self.spots.iter().map(one).collect()
    }

    /// A view's photograph at the spots.
    fn pixels(&self, view: usize) -> Vec<[f32; 3]> {
        self.spots.iter().map(|spot| self.views[view].colour(self.pixel_at(view, *spot))).collect()
    }

    /// PSNR of a photograph at some spots as what is seen explains it, in the likeliest light, dB.
    fn psnr_db(&self, seen: &[[f32; FEATURES]], pixels: &[[f32; 3]], spots: &[usize]) -> f64 {
        let half = |which: bool| -> (Vec<[f32; FEATURES]>, Vec<[f32; 3]>) {
            spots.iter().filter(|at| self.spots[**at].second == which).map(|at| (seen[*at], pixels[*at])).unzip()
        };
        let halves = [half(false), half(true)];
        let mut sum = 0.0;
        for (fit, judged) in [(&halves[0], &halves[1]), (&halves[1], &halves[0])] {
            // Numbers of a scout are finite, and pixels are: so is what is fitted to them.
            let Some(light) = self.prior.fit(&fit.0, &fit.1) else { return 0.0 };
            sum += judged.0.iter().zip(&judged.1).map(|(f, p)| squared(light.shade(f), *p)).sum::<f64>();
        }
        -10.0 * (sum / (3 * spots.len()) as f64).max(1e-12).log10()
    }
}

/// Of `spots` those at which something of the inner box is seen; all of them where that is too little to judge by.
fn solid(seen: &[[f32; FEATURES]], spots: &[usize]) -> Vec<usize> {
    let near: Vec<usize> = spots.iter().copied().filter(|at| seen[*at][NEAR_WEIGHT] > SOLID).collect();
    if near.len() >= MIN_SPOTS { near } else { spots.to_vec() }
}

/// Squared error of a colour, over its channels.
fn squared(a: [f32; 3], b: [f32; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum()
}

/// Spots spread evenly over a picture, each anywhere in its field and in either half.
fn spots(seed: u64) -> Vec<Spot> {
    let share = |bits: u64| (bits & 0xffff) as f64 / 65_536.0;
    let one = |n: usize| {
        let chance = mixed(seed ^ mixed(n as u64));
        let (x, y) = ((n % SIDE) as f64 + share(chance), (n / SIDE) as f64 + share(chance >> 16));
        Spot { x: x / SIDE as f64, y: y / SIDE as f64, second: chance >> 32 & 1 == 1 }
    };
    (0..SIDE * SIDE).map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_solid_is_judged_only_where_enough_of_it_is_seen() {
        let mut seen = vec![[0.0; FEATURES]; 400];
        (0..150).for_each(|at| seen[at][NEAR_WEIGHT] = 1.0);
        let all: Vec<usize> = (0..400).collect();
        assert_eq!(solid(&seen, &all), (0..150).collect::<Vec<_>>());
        // A mask over most of it: the rest of it is too little, and nothing that it leaves out comes back.
        let left: Vec<usize> = (100..400).collect();
        assert_eq!(solid(&seen, &left), left);
    }

    #[test]
    fn spots_cover_the_picture_in_two_halves() {
        let all = spots(5);
        assert!(all.iter().all(|s| (0.0..1.0).contains(&s.x) && (0.0..1.0).contains(&s.y)));
        let halves = all.iter().filter(|s| s.second).count();
        assert!((700..900).contains(&halves), "{halves} of {}", all.len());
        assert_ne!(all, spots(6));
    }
}
