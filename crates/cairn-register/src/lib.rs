//! Registration: the camera and the light with which a field looks most like a picture. With them the picture can be
//! compared with what the field shows there, pixel by pixel.
//!
//! A picture may have been turned, cut and made smaller on its way, and another lens may have taken it. All of that is a
//! change of camera (roll, principal point, focal length, distortion), so that eleven numbers say it: six of the pose, five of the lens. They are found in steps:
//!
//! 1. [`Index`]: keypoints of renders and photographs with places in space, made once a field (`keypoints`).
//! 2. The picture's keypoints are matched with them (`matching`), and the camera is found that most surprisingly many
//!    agree on (`consensus`).
//! 3. Keypoints of a render from there are matched again nearby.
//! 4. Direct alignment: Levenberg and Marquardt's steps on the difference of colours (Lucas and Kanade 1981; on radiance
//!    fields iNeRF, Yen-Chen et al. 2021), with the light a linear regression at every step (`alignment`), and renders
//!    as blurred as the picture (`blur`).

mod alignment;
mod blur;
mod consensus;
mod index;
mod keypoints;
mod matching;
mod matrix;
mod sizes;
mod windows;

use alignment::{Against, MIN_SPREAD, NUMBERS, Pass, Refined, SHAPE};
use blur::Blur;
use cairn_field::appearance::prior::Prior;
use cairn_field::stats::median;
use cairn_field::{Appearance, Field};
use cairn_scene::{Camera, Intrinsics, Picture};
use consensus::{Agreed, Chance, Solve};
use glam::DVec3;
use index::{PHOTOGRAPHED_PX, RENDERED_PX, Seen, placed};
use keypoints::{Keypoint, keypoints};
use matching::{Match, one_a_spot};
use sizes::{ratio, shrunk, smaller};
use std::sync::Arc;
use thiserror::Error;
use windows::Parts;

pub use index::{INDEX_FORMAT, Index, MAX_VIEWS, Reference};

/// Keypoints of a picture that are looked at, at most.
const KEYPOINTS: usize = 1500;
/// How far off a keypoint of a render from there may be, shares of the picture's longer side.
const REMATCHED: f64 = 0.04;
/// In such a small neighbourhood the second nearest must be farther by this.
const REMATCH_RATIO: f64 = 0.9;
/// Shortest side of a picture whose camera is looked for, px.
const MIN_SIDE: usize = 20;
/// Pictures are compared at most this large, longest side, px: a larger one is made smaller.
pub const LONGEST_PX: usize = 800;
/// Steps from keypoints: what stands a pixel aside is no outlier before it can have been moved. The lens's shape, which moves
/// things least, waits for the next: from far off it led astray.
const ROUGHLY: Pass = Pass { numbers: NUMBERS - SHAPE, steps: 24, settled_px: 0.1, min_spread: 0.03, is_last: false };
/// Steps from there, until they are a third of the tenth of a pixel that is wanted.
const FINELY: Pass = Pass { numbers: NUMBERS, steps: 24, settled_px: 0.03, min_spread: MIN_SPREAD, is_last: true };

/// Registers pictures to one field; see the module's text.
#[derive(Debug)]
pub struct Registrar {
    field: Arc<Field>,
    prior: Prior,
    index: Option<Arc<Index>>,
}

/// A picture and where it was taken.
#[derive(Clone, Debug)]
pub struct Registered {
    /// The camera, of the size of [`Registered::picture`].
    pub camera: Camera,
    /// The light that explains the picture best from there.
    pub appearance: Appearance,
    /// The picture as it was compared: at most [`LONGEST_PX`] long.
    pub picture: Picture,
    /// Share of the picture's variance that the field explains from there, above 0, 1 at most, where
    /// it was looked at, outliers left out: near 1 for renders of the field, less for photographs.
    pub explained: f64,
}

/// A picture whose camera was found.
#[derive(Clone, Debug)]
pub struct Located {
    /// The picture and its camera.
    pub registered: Registered,
    /// Standard deviation of where the camera has what the picture shows, the median over places, px of
    /// [`Registered::picture`]: by its keypoints, by its pixels, or by how far these are apart, whichever is the
    /// largest. A longer lens farther off shows nearly the same, so that the camera's own place is less sure than that.
    pub uncertainty_px: f64,
    /// The places of the keypoints that agree on the camera, capture units.
    pub places: Vec<DVec3>,
    /// Negative decimal logarithm of how many agreements as good one expects by chance.
    pub surprise: f64,
}

impl Located {
    /// How far from where `camera` has it lies what the picture shows: the median over the places that agree, px of
    /// [`Registered::picture`]. Infinite where most of them lie behind `camera`.
    pub fn off_px(&self, camera: &Camera) -> f64 {
        let Registered { camera: found, picture, .. } = &self.registered;
        let camera = camera.resized(picture.width(), picture.height());
        let apart = |place: &DVec3| match (found.project(*place), camera.project(*place)) {
            (Some(here), Some(there)) => here.distance(there),
            _ => f64::INFINITY,
        };
        median(self.places.iter().map(apart).collect())
    }
}

/// Why no camera was found.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum NotLocated {
    /// Too small a picture.
    #[error("the picture is {width} x {height} px; its shorter side must have {MIN_SIDE} px at least")]
    TooSmall {
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
    },
    /// No index to look in.
    #[error("the field has no index of places")]
    NoIndex,
    /// No camera on which enough keypoints agree.
    #[error("no camera was found: of {matches} keypoints that look like places of the scene {agreeing} agree on one")]
    NoAgreement {
        /// Matches.
        matches: usize,
        /// Those that agree.
        agreeing: usize,
    },
    /// The field explains nothing there.
    #[error("no light makes the field look like the picture from where its keypoints lie")]
    NotExplained,
    /// It was no longer wanted.
    #[error("the search was given up")]
    GivenUp,
}

/// A camera is believed where one expects an agreement as good less often than once in a million pictures by chance.
const MIN_SURPRISE: f64 = 6.0;

impl Registrar {
    /// Prepares registration to `field`: with an index of places pictures are looked for, without one those whose camera is
    /// known are registered.
    pub fn new(field: Arc<Field>, index: Option<Arc<Index>>) -> Self {
        let seen: Vec<&Appearance> = field.appearances().iter().map(|(_, code)| code).collect();
        let around = || Prior::around(field.canonical_appearance().clone());
        let prior = if seen.is_empty() { around() } else { Prior::of(&seen).unwrap_or_else(around) };
        Self { field, prior, index }
    }

    /// The field.
    pub fn field(&self) -> &Arc<Field> {
        &self.field
    }

    /// `picture` where it is known that `camera` took it, or a larger or smaller copy of it (of the same
    /// proportions; others are stretched): the light alone is found. `None` where no light explains any of
    /// it, or it is too small to tell.
    pub fn register_at(&self, picture: &Picture, camera: &Camera) -> Option<Registered> {
        let picture = bounded(picture)?;
        let camera = camera.resized(picture.width(), picture.height());
        let pass = Pass { steps: 0, is_last: false, ..FINELY };
        let found = alignment::refine(&self.against(1.0), &Parts::of(&picture), camera, pass, &|| true);
        let found = found.filter(|found| found.explained > 0.0)?;
        Some(Registered { camera, appearance: found.appearance, picture, explained: found.explained })
    }

    /// The camera and light from which the field looks most like `picture` (any size; a number that is not finite
    /// counts as 0). It goes on for as long as it is `wanted`: that is asked between keypoints, matches, agreement and
    /// rematching, and before every step of the alignment.
    ///
    /// # Errors
    /// [`NotLocated`], with the reason.
    pub fn locate(&self, picture: &Picture, wanted: &dyn Fn() -> bool) -> Result<Located, NotLocated> {
        let (width, height) = (picture.width(), picture.height());
        let picture = bounded(picture).ok_or(NotLocated::TooSmall { width, height })?;
        let index = self.index.as_deref().ok_or(NotLocated::NoIndex)?;
        let go_on = || if wanted() { Ok(()) } else { Err(NotLocated::GivenUp) };
        let size = [picture.width(), picture.height()];
        let found = found_in(&picture);
        go_on()?;
        let matches = matching::matches(index, &found);
        go_on()?;
        let agreed = consensus::agreed(index, &matches, size);
        let agreeing = agreed.as_ref().map_or(0, |a| a.matches.len());
        let none = NotLocated::NoAgreement { matches: matches.len(), agreeing };
        let agreed = agreed.filter(|a| a.surprise > MIN_SURPRISE).ok_or(none)?;
        let light = self.light_near(index, &agreed, &matches);
        let surprise = agreed.surprise;
        let by = ByKeypoints::of(&agreed, &matches, index.reach);
        go_on()?;
        let by = self.rematched(&found, &by, &light, index.reach).unwrap_or(by);
        let against = self.against(index.reach);
        let refined = |parts: &Parts, from: &Camera, pass: Pass| {
            let next = alignment::refine(&against, parts, *from, pass, wanted);
            go_on()?;
            next.ok_or(NotLocated::NotExplained)
        };
        let blur_at = |parts: &Parts, place: &Refined| {
            alignment::blur_at(&against, parts, &place.camera).ok_or(NotLocated::NotExplained)
        };
        let mut parts = Parts::of(&picture);
        let mut rough = refined(&parts, &by.camera, ROUGHLY)?;
        parts.blur = blur_at(&parts, &rough)?;
        if parts.blur != Blur::NONE {
            if let Some(blur) = parts.blur.halved() {
                let half = picture.resized(picture.width().div_ceil(2), picture.height().div_ceil(2));
                parts = Parts { blur, ..Parts::of(&half) };
            }
            // Compared sharp it settled beside its place, and from there it looked more blurred than it is.
            rough = refined(&parts, &rough.camera, ROUGHLY)?;
            parts.blur = blur_at(&parts, &rough)?;
        }
        let Refined { camera, appearance, explained, covariance } = refined(&parts, &rough.camera, FINELY)?;
        if explained <= 0.0 {
            return Err(NotLocated::NotExplained);
        }
        let aligned_px = covariance.map_or(f64::INFINITY, |c| c.median_px(&camera, &by.places));
        // Pixels that settled beside the best place do not say so; how far they went from the keypoints does.
        let apart = |p: &DVec3| Some((camera.project(*p)? - by.camera.project(*p)?).length());
        let apart_px = median(by.places.iter().filter_map(apart).collect());
        let uncertainty_px = aligned_px.max(by.off_px).max(apart_px);
        let registered = Registered { camera, appearance, picture, explained };
        Ok(Located { registered, uncertainty_px, places: by.places, surprise })
    }

    fn against(&self, reach: f64) -> Against<'_> {
        Against { field: &self.field, prior: &self.prior, reach }
    }

    /// The light of the view that most of what agrees is known from.
    fn light_near(&self, index: &Index, agreed: &Agreed, matches: &[Match]) -> Appearance {
        let mut counts = vec![0usize; index.names.len()];
        agreed.matches.iter().for_each(|k| counts[matches[*k].view as usize] += 1);
        let best = (0..counts.len()).max_by_key(|k| (counts[*k], std::cmp::Reverse(*k)));
        best.map_or(self.field.canonical_appearance(), |k| self.field.appearance_of(&index.names[k])).clone()
    }

    /// The camera by keypoints of a render from where they said, which lie near where they were.
    fn rematched(
        &self,
        found: &[Keypoint],
        ByKeypoints { camera, lens, .. }: &ByKeypoints,
        light: &Appearance,
        reach: f64,
    ) -> Option<ByKeypoints> {
        let size = |camera: &Camera| [camera.intrinsics.width, camera.intrinsics.height];
        let longest = camera.intrinsics.width.max(camera.intrinsics.height);
        let small = shrunk(camera, RENDERED_PX);
        let ratio = ratio(size(camera), size(&small));
        let seen = Seen::at(&self.field, &small, light);
        let shown = placed(&seen, KEYPOINTS);
        let radius = (REMATCHED * longest as f64).max(3.0);
        let wide: Vec<_> = shown.iter().map(|(k, _)| keypoints::widened(&k.descriptor)).collect();
        let of = |keypoint: &Keypoint| {
            let own = keypoints::widened(&keypoint.descriptor);
            let near = |k: &usize| (shown[*k].0.at * ratio - keypoint.at).length() < radius;
            let mut all: Vec<(i32, usize)> =
                (0..shown.len()).filter(near).map(|k| (keypoints::likeness(&own, &wide[k]), k)).collect();
            all.sort_by_key(|(like, _)| std::cmp::Reverse(*like));
            let (like, best) = *all.first()?;
            let aside = |k: usize| (shown[k].0.at - shown[best].0.at).length() > 2.0;
            let next = all.iter().find(|(_, k)| aside(*k));
            let test = next.map_or(0.0, |(next, _)| keypoints::distance_ratio(like, *next));
            let (known, place) = &shown[best];
            let turned = f64::from(keypoint.angle - known.angle);
            let larger = f64::from(keypoint.scale) / (f64::from(known.scale) * ratio.x);
            (test < REMATCH_RATIO).then_some(Match {
                at: keypoint.at,
                place: *place,
                view: 0,
                larger,
                turned,
                ratio: test,
            })
        };
        let mut matches: Vec<Match> = found.iter().filter_map(of).collect();
        matches.sort_by(|a, b| a.ratio.total_cmp(&b.ratio));
        let matches = one_a_spot(matches);
        let chance = Chance::within(radius);
        let how = Solve { lens, numbers: NUMBERS, steps: 20, spread_px: (radius / 8.0).max(0.7), expected: 1.0 };
        let next = consensus::solved(camera, &matches, reach, &how)?;
        let agreed = consensus::refined(chance.of(&next, lens, &matches), &matches, reach, &chance);
        (agreed.surprise > MIN_SURPRISE).then(|| ByKeypoints::of(&agreed, &matches, reach))
    }
}

/// A camera by keypoints.
struct ByKeypoints {
    camera: Camera,
    /// What was expected of its lens.
    lens: Intrinsics,
    /// What agrees on it, capture units.
    places: Vec<DVec3>,
    /// Standard deviation of where it has them, px.
    off_px: f64,
}

impl ByKeypoints {
    fn of(agreed: &Agreed, matches: &[Match], reach: f64) -> Self {
        let with: Vec<Match> = agreed.matches.iter().map(|k| matches[*k]).collect();
        let places: Vec<DVec3> = with.iter().map(|m| m.place).collect();
        let certainty = consensus::certainty(&agreed.camera, &agreed.lens, &with, reach);
        let off_px = certainty.map_or(f64::INFINITY, |c| c.median_px(&agreed.camera, &places));
        Self { camera: agreed.camera, lens: agreed.lens, places, off_px }
    }
}

/// The picture's keypoints, px of the picture.
fn found_in(picture: &Picture) -> Vec<Keypoint> {
    let small = smaller(picture, PHOTOGRAPHED_PX);
    let ratio = ratio([picture.width(), picture.height()], [small.width(), small.height()]);
    let mut found = keypoints(&small, KEYPOINTS);
    for keypoint in &mut found {
        keypoint.at *= ratio;
        keypoint.scale *= ratio.x as f32;
    }
    found
}

/// The picture at the size that it is compared at, in [0, 1]; `None` where it is smaller than [`MIN_SIDE`].
fn bounded(picture: &Picture) -> Option<Picture> {
    let mut picture = smaller(picture, LONGEST_PX);
    if picture.width().min(picture.height()) < MIN_SIDE {
        return None;
    }
    picture.rgb_mut().iter_mut().for_each(|v| *v = if v.is_finite() { v.clamp(0.0, 1.0) } else { 0.0 });
    Some(picture)
}
