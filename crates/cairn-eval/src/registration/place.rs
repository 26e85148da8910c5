//! A held-out view, of which pictures are made to look for its camera.

use cairn_field::{Appearance, Field, distance};
use cairn_scene::{Camera, Picture};
use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::condition::{BENT, Condition, Shown};
use super::follow::follow;
use crate::source::SizedView;

/// Points of a view that cameras are compared by: so many columns and rows of them.
const GRID: usize = 16;
/// Where less than this share of the light is stopped, there is no point.
const MIN_ACCUMULATION: f32 = 0.7;

/// A held-out view.
pub struct Place {
    view: SizedView,
    /// The light of its photograph,
    own: Appearance,
    /// and of another one, where the field knows several.
    other: Option<Appearance>,
    /// Points that it shows, by rendered depth, capture units.
    pub points: Vec<DVec3>,
}

/// A picture, and the truth about it.
pub struct Case<'a> {
    /// The picture.
    pub picture: Picture,
    /// Its camera.
    pub truth: Camera,
    /// Its light.
    pub light: &'a Appearance,
}

impl Place {
    /// Of `view`. The other light is drawn from `seed`.
    ///
    /// # Errors
    /// Those of fitting a light.
    pub fn new(field: &Field, view: SizedView, seed: u64) -> anyhow::Result<Self> {
        let lights = field.appearances();
        let own = if lights.is_empty() {
            field.canonical_appearance().clone()
        } else {
            field.fit_appearance(&view.camera, &view.picture)?
        };
        let other = (!lights.is_empty()).then(|| ChaCha8Rng::seed_from_u64(seed).random_range(0..lights.len()));
        let other = other.and_then(|at| lights.get(at)).map(|(_, light)| light.clone());
        let points = points(field, &view.camera, &own);
        Ok(Self { view, own, other, points })
    }

    /// Its view's name.
    pub fn name(&self) -> &str {
        &self.view.name
    }

    /// Its picture under `condition`, whose noise is drawn from `seed`; `None` where there is no other light.
    pub fn case(&self, field: &Field, condition: &Condition, seed: u64) -> Option<Case<'_>> {
        let light = if condition.shown == Shown::AnotherLight { self.other.as_ref()? } else { &self.own };
        let mut truth = self.view.camera;
        if condition.shown == Shown::AnotherLens {
            let lens = &mut truth.intrinsics.distortion;
            *lens = lens.with_first_radial(lens.first_radial() - BENT);
        }
        let mut picture = match condition.shown {
            Shown::Photograph => self.view.picture.clone(),
            Shown::Render | Shown::AnotherLight | Shown::AnotherLens => field.render(&truth, light).clamped(),
        };
        for distortion in condition.chain {
            picture = distortion.apply(&picture, seed);
            truth = follow(distortion, &truth);
        }
        Some(Case { picture, truth, light })
    }
}

fn points(field: &Field, camera: &Camera, light: &Appearance) -> Vec<DVec3> {
    let maps = field.render_maps(camera, light);
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let middle = |k: usize, side: usize| (2 * k + 1) * side / (2 * GRID);
    let of = |k: usize| {
        let (x, y) = (middle(k % GRID, width), middle(k / GRID, height));
        let at = y * width + x;
        let (origin, direction) = camera.ray(x as f64 + 0.5, y as f64 + 0.5);
        let seen = maps.accumulation[at] >= MIN_ACCUMULATION;
        let away = seen.then(|| distance(field.frame(), origin, direction, f64::from(maps.depth[at])))??;
        Some(origin + direction * away)
    };
    (0..GRID * GRID).filter_map(of).collect()
}
