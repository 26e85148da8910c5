//! Finding where a picture was taken: the camera (and the light) from which a field looks
//! most like it. Whoever knows that can compare the picture with what the field shows
//! there, pixel by pixel, and need not guess from the picture alone.
//!
//! A picture may have been turned, cut and made smaller on its way. All of that is a change of
//! camera (roll, principal point, focal length), so that nine numbers say it: six of the pose,
//! three of the lens. First it is laid over small renders of the training views, turned and cut in
//! many ways (`search`); the best places are then refined by Levenberg and Marquardt's steps on the
//! photometric error (direct alignment, Lucas and Kanade 1981; on radiance fields iNeRF,
//! Yen-Chen et al. 2021), from coarse to the picture's own pixels (`refine`). The light is a
//! linear regression at every step (`prior`).

mod matrix;
mod refine;
mod search;
mod windows;

use crate::appearance::code::Appearance;
use crate::appearance::prior::Prior;
use crate::field::model::Field;
use crate::rays::frame::SceneFrame;
use crate::stats::median;
use cairn_scene::{Camera, Picture};
use matrix::NUMBERS;
use refine::{Against, Pass, Refined};
use search::Thumbnail;
use std::sync::{Arc, OnceLock};
use windows::Level;

/// Places that are refined, at most.
const CANDIDATES: usize = 4;
/// Steps for each place on the coarsest level, and for those that are followed.
const FIRST: usize = 8;
/// Places that are followed further, at most.
const FOLLOWED: usize = 2;
/// How each level is gone through: the pose first, and where it nearly is the lens as well, since a longer
/// lens further off shows nearly the same; and what stands a pixel aside is no outlier before it can have
/// been moved.
const PASSES: [Pass; 5] = [
    Pass { steps: 16, free: POSE, min_spread: 0.2 },
    Pass { steps: 4, free: POSE, min_spread: 0.1 },
    Pass { steps: 6, free: NUMBERS, min_spread: 0.03 },
    Pass { steps: 8, free: NUMBERS, min_spread: 0.03 },
    Pass { steps: 12, free: NUMBERS, min_spread: MIN_SPREAD },
];
/// What eight bits leave of a number, about.
const MIN_SPREAD: f64 = 0.5 / 255.0;
/// The numbers of a pose.
const POSE: usize = 6;
/// A place that explains less of a picture on the coarsest level is left there.
const HOPELESS: f64 = 0.5;
/// One that explains so much of it there is taken before others are looked at,
const SURELY: f64 = 0.97;
/// and one that explains so much of it at its own size is taken without following the others.
const PLAINLY: f64 = 0.75;
/// Longest sides of the levels before the picture's own size, px.
const SIDES: [usize; 3] = [32, 64, 160];
/// Pictures are compared at most this large, longest side, px: a larger one is made smaller.
pub const LONGEST_PX: usize = 800;

/// Registers pictures to one field; see the module's text.
#[derive(Debug)]
pub struct Registrar {
    field: Arc<Field>,
    prior: Prior,
    /// How far cameras stand from what they see, in capture units.
    reach: f64,
    /// The views' cameras and appearances,
    views: Vec<(Camera, Appearance)>,
    /// and their small renders, made when a picture's camera is first searched for.
    thumbnails: OnceLock<Vec<Thumbnail>>,
}

/// Where a picture was taken.
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

impl Registrar {
    /// Prepares registration to `field`, of pictures taken from about where `views` were (cameras and names, by
    /// which their appearances are known). `None` without views.
    pub fn new(field: Arc<Field>, views: &[(Camera, &str)]) -> Option<Self> {
        if views.is_empty() {
            return None;
        }
        let seen: Vec<&Appearance> = field.appearances.iter().map(|(_, code)| code).collect();
        let around = || Prior::around(field.canonical.clone());
        let prior = if seen.is_empty() { around() } else { Prior::of(&seen).unwrap_or_else(around) };
        let reach = reach(field.frame(), views);
        let views = views.iter().map(|(camera, name)| (*camera, field.appearance_of(name).clone())).collect();
        Some(Self { prior, reach, views, thumbnails: OnceLock::new(), field })
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
        let level = Level::of_parts(&picture, LONGEST_PX);
        let pass = Pass { steps: 0, free: POSE, min_spread: MIN_SPREAD };
        let found = self.refined(&level, camera, pass, &|| true).filter(|found| found.explained > 0.0)?;
        Some(Registered { camera, appearance: found.appearance, picture, explained: found.explained })
    }

    /// The camera and light from which the field looks most like `picture` (any size; a number that is not finite
    /// counts as 0); `None` where it looks like it from nowhere that was tried, or is too small to tell.
    pub fn register(&self, picture: &Picture) -> Option<Registered> {
        self.register_while(picture, &|| true)
    }

    /// As [`Registrar::register`], for as long as `wanted` says so: it is asked before every step, of which
    /// there are up to hundreds. `None` once it says no.
    pub fn register_while(&self, picture: &Picture, wanted: &dyn Fn() -> bool) -> Option<Registered> {
        let picture = bounded(picture)?;
        let levels = [
            Level::whole(&picture, SIDES[0]),
            Level::whole(&picture, SIDES[1]),
            Level::of_parts(&picture, SIDES[2]),
            Level::of_parts(&picture, LONGEST_PX),
        ];
        // The last one twice: first what is far off has a say there, then only what fits.
        let levels: Vec<&Level> = levels.iter().chain(levels.last()).collect();
        let mut places: Vec<Refined> = Vec::new();
        let thumbnail = |(camera, light): &(Camera, Appearance)| Thumbnail::of(&self.field, camera, light);
        let thumbnails = self.thumbnails.get_or_init(|| self.views.iter().map(thumbnail).collect());
        for candidate in search::candidates(thumbnails, &picture, CANDIDATES) {
            if !wanted() {
                return None;
            }
            places.extend(self.refined(levels[0], candidate.camera, Pass { steps: FIRST, ..PASSES[0] }, wanted));
            if places.last().is_some_and(|place| place.explained > SURELY) {
                break;
            }
        }
        places.retain(|place| place.explained > HOPELESS);
        places.sort_by(|a, b| b.explained.total_cmp(&a.explained));
        let mut best: Option<Refined> = None;
        for place in places.into_iter().take(FOLLOWED) {
            let refined = |at: Refined, (level, pass): (&&Level, Pass)| self.refined(level, at.camera, pass, wanted);
            let found = levels.iter().zip(PASSES).try_fold(place, refined);
            if found.as_ref().is_some_and(|f| best.as_ref().is_none_or(|b| f.explained > b.explained)) {
                best = found;
            }
            if best.as_ref().is_some_and(|b| b.explained > PLAINLY) {
                break;
            }
        }
        let Refined { camera, appearance, explained } = best.filter(|_| wanted())?;
        Some(Registered { camera, appearance, picture, explained })
    }

    fn refined(&self, level: &Level, camera: Camera, pass: Pass, wanted: &dyn Fn() -> bool) -> Option<Refined> {
        let against = Against { field: &self.field, prior: &self.prior, reach: self.reach };
        refine::refine(&against, level, camera, pass, wanted)
    }
}

/// Middling distance from the cameras to what they look at, capture units.
fn reach(frame: &SceneFrame, views: &[(Camera, &str)]) -> f64 {
    let of = |camera: &Camera| match frame {
        SceneFrame::ForwardFacing { near, .. } => 2.0 * near,
        SceneFrame::Bounded { centre, half } | SceneFrame::Unbounded { centre, half } => {
            (camera.pose.position - centre).length().max(0.1 * half.max_element())
        }
    };
    median(views.iter().map(|(camera, _)| of(camera)).collect())
}

/// The picture at the size that it is compared at, in [0, 1]; `None` where it is smaller than a thumbnail.
fn bounded(picture: &Picture) -> Option<Picture> {
    let (w, h) = (picture.width(), picture.height());
    if w.min(h) < search::SIDE {
        return None;
    }
    let mut picture = picture.clone();
    picture.rgb_mut().iter_mut().for_each(|v| *v = if v.is_finite() { v.clamp(0.0, 1.0) } else { 0.0 });
    let longest = w.max(h);
    if longest <= LONGEST_PX {
        return Some(picture);
    }
    let side = |s: usize| (s * LONGEST_PX / longest).max(1);
    Some(picture.resized(side(w), side(h)))
}
