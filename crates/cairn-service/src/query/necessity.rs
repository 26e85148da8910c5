//! Necessity: how much a view would change without each of the contributors who show most of it. It takes long, so that
//! what it takes is said first.

use std::time::Instant;

use cairn_field::{Appearance, Field, LinearView, MarkableField as _};
use cairn_share::{Lesson, Necessity, PULL, STEPS};

use crate::config::Limits;
use crate::error::EngineError;
use crate::query::coverage::{Asked, Contributors, contributors, sampled};
use crate::query::viewpoint::{Viewpoint, camera_of};
use crate::store::model::Model;
use crate::store::snapshot::SceneSnapshot;

/// Contributors that are looked at, at most.
pub const MAX_CONTRIBUTORS: usize = 20;
/// As many where a caller does not say.
const CONTRIBUTORS: usize = 5;
/// Pixels of photographs that are looked at, in all: what the field makes of them takes about half a gigabyte.
pub const MAX_PIXELS: usize = 400_000;
/// The photographs that show least of the view are passed over, as long as they show no more of it together.
const PASSED_OVER: f64 = 0.02;
/// Bytes of a pixel's linear map, about.
const PIXEL_BYTES: u64 = 1300;
/// Bytes of a row: nine vectors of three numbers while colours are solved for.
const ROW_BYTES: u64 = 108;
/// Passes over all linear maps to solve once, where the way back counts as two: of each step, and to begin.
const PASSES: f64 = 3.0 * STEPS as f64 + 5.0;
/// Entries of the view's linear map that weigh less are left out, pixels.
const CUTOFF: f32 = 1e-3;

/// What is asked.
#[derive(Clone, Debug)]
pub struct Question {
    /// From where.
    pub viewpoint: Viewpoint,
    /// Contributors that are looked at, those who show most: 1 to [`MAX_CONTRIBUTORS`]; 0 is five.
    pub contributors: usize,
}

/// What an answer takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// Contributors that are looked at.
    pub contributors: usize,
    /// Photographs whose colours are solved for.
    pub photographs: usize,
    /// Memory, bytes, about.
    pub bytes: u64,
    /// Seconds, about.
    pub seconds: f64,
}

/// A contributor's necessity.
#[derive(Clone, Debug, PartialEq)]
pub struct Needed {
    /// Their name.
    pub name: String,
    /// Their coverage, above 0, to 1.
    pub share: f64,
    /// How far the view's colours would move without their photographs: RMS over its pixels and channels, of colours in
    /// [0, 1]. Geometry stays as it is.
    pub change: f64,
}

/// What is said while an answer is worked out, in this order: the cost, then now and then how far it is, then the answer.
#[derive(Clone, Debug, PartialEq)]
pub enum Said {
    /// What it takes.
    Cost(Cost),
    /// How far it is.
    Progress {
        /// 0 to 1.
        done: f64,
        /// Seconds that are left, about.
        seconds_left: f64,
    },
    /// The answer, largest change first.
    Answer(Vec<Needed>),
}

/// What is to be done, and what it takes.
pub struct Plan {
    /// What it takes.
    pub cost: Cost,
    /// The part of the seconds that the photographs' maps take, 0 to 1; the rest is for solving.
    maps_part: f64,
    /// What the asked view makes of colours, and in which light.
    seen: LinearView,
    light: Appearance,
    /// Those who are looked at, and their coverage.
    asked: Vec<(String, f64)>,
    /// The photographs that are looked at: their places among the scene's views, and whose they are, as far as they are
    /// of those who are asked about.
    photographs: Vec<(usize, Option<usize>)>,
}

impl Question {
    /// Finds out what an answer takes: who shows most of what is seen, and which photographs show any of it.
    ///
    /// # Errors
    /// As [`contributors`]; [`EngineError::Invalid`] for too many contributors; [`EngineError::WrongState`] where no
    /// photograph shows any of it.
    pub fn plan(&self, model: &Model, snapshot: &SceneSnapshot, limits: &Limits) -> Result<Plan, EngineError> {
        if self.contributors > MAX_CONTRIBUTORS {
            let allowed = format!("1 to {MAX_CONTRIBUTORS}");
            return Err(EngineError::invalid("the number of contributors", self.contributors, allowed));
        }
        let found = contributors(model, snapshot, &Asked::about(self.viewpoint.clone()), limits)?;
        let camera = sampled(&camera_of("the view", snapshot, &self.viewpoint, limits)?);
        // What the view's own map takes, and a pass over it, is what those of the photographs take, pixel for pixel.
        let begun = Instant::now();
        let seen = model.base.view(&camera, CUTOFF, 1);
        let map_seconds = begun.elapsed().as_secs_f64();
        let plan = Plan::of(model, snapshot, self, found, seen)?;
        let begun = Instant::now();
        plan.shown(&vec![0.0; 3 * model.base.rows()]);
        let pass_seconds = begun.elapsed().as_secs_f64();
        let pixels = plan.pixels_of_each(snapshot) * plan.photographs.len();
        let views = pixels as f64 / (plan.seen.width() * plan.seen.height()) as f64;
        let solve_seconds = PASSES * (plan.asked.len() + 1) as f64 * pass_seconds;
        let seconds = views * (map_seconds + solve_seconds);
        let maps_part = map_seconds / (map_seconds + solve_seconds);
        let bytes = pixels as u64 * PIXEL_BYTES + model.base.rows() as u64 * ROW_BYTES;
        let cost = Cost { bytes, seconds, ..plan.cost };
        Ok(Plan { cost, maps_part, ..plan })
    }
}

impl Plan {
    fn of(
        model: &Model,
        snapshot: &SceneSnapshot,
        question: &Question,
        found: Contributors,
        seen: LinearView,
    ) -> Result<Self, EngineError> {
        let views = &snapshot.scene.capture().views;
        let wanted = if question.contributors == 0 { CONTRIBUTORS } else { question.contributors };
        let min_share = passed_over(found.shares.iter().flat_map(|of| &of.photographs).map(|(_, share)| *share));
        let (mut asked, mut photographs) = (Vec::new(), Vec::new());
        for of in found.shares {
            let who = (asked.len() < wanted).then_some(asked.len());
            // Of those who are asked about all count.
            let shows = of.photographs.iter().filter(|(_, share)| who.is_some() || *share >= min_share);
            let places = shows.filter_map(|(name, _)| views.binary_search_by(|view| view.name.cmp(name)).ok());
            photographs.extend(places.map(|place| (place, who)));
            if who.is_some() {
                asked.push((of.name, of.share));
            }
        }
        if photographs.is_empty() {
            let what = format!("the view of scene {:?}", snapshot.name);
            return Err(EngineError::wrong_state(
                what,
                "asked about",
                "no photograph shows any of it; ask about another",
            ));
        }
        // The same sums in any order of shares.
        photographs.sort_unstable();
        let light = match &question.viewpoint {
            Viewpoint::View(name) => model.base.appearance_of(snapshot.full_name(name)?).clone(),
            Viewpoint::Camera(_) => model.base.canonical_appearance().clone(),
        };
        let cost = Cost { contributors: asked.len(), photographs: photographs.len(), bytes: 0, seconds: 0.0 };
        Ok(Self { cost, maps_part: 0.0, seen, light, asked, photographs })
    }

    /// What a change of constant colours (`rows x 3`) changes in the view, RMS.
    fn shown(&self, moved: &[f32]) -> f64 {
        let mut picture = vec![0.0; 3 * self.seen.width() * self.seen.height()];
        self.seen.apply_lit(moved, &self.light, &mut picture);
        (picture.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() / picture.len() as f64).sqrt()
    }

    /// Pixels of each photograph that are looked at, at most.
    fn pixels_of_each(&self, snapshot: &SceneSnapshot) -> usize {
        let views = &snapshot.scene.capture().views;
        let size = |(place, _): &(usize, Option<usize>)| {
            let intrinsics = &views[*place].camera.intrinsics;
            intrinsics.width * intrinsics.height
        };
        let largest = self.photographs.iter().map(size).max().unwrap_or(0);
        (MAX_PIXELS / self.photographs.len()).clamp(1, largest.max(1))
    }

    /// Works it out, largest change first. `goes_on` hears after each part how much is done, 0 to 1, and says whether to
    /// go on; `None` where it did not.
    ///
    /// # Errors
    /// For photographs that were altered.
    pub fn work_out(
        &self,
        model: &Model,
        snapshot: &SceneSnapshot,
        huber: f64,
        goes_on: &mut dyn FnMut(f64) -> bool,
    ) -> Result<Option<Vec<Needed>>, EngineError> {
        let field: &Field = &model.base;
        let (pixels, views) = (self.pixels_of_each(snapshot), &snapshot.scene.capture().views);
        let mut lessons = Vec::new();
        for (place, _) in &self.photographs {
            let view = snapshot.scene.train_view(*place)?;
            lessons.push(Lesson::of(field, &views[*place].name, &view, huber, pixels));
            if !goes_on(self.maps_part * lessons.len() as f64 / self.photographs.len() as f64) {
                return Ok(None);
            }
        }
        let off: Vec<f32> = field.constant_colours().iter().flat_map(|c| c.map(|v| v - 0.5)).collect();
        let problem = Necessity::new(&lessons, field.rows(), off, PULL, STEPS);
        let all = problem.solve(|_| true);
        let mut needed = Vec::new();
        for (who, (name, share)) in self.asked.iter().enumerate() {
            let solved = (who + 1) as f64 / (self.asked.len() + 1) as f64;
            if !goes_on(self.maps_part + (1.0 - self.maps_part) * solved) {
                return Ok(None);
            }
            let without = problem.solve(|at| self.photographs[at].1 != Some(who));
            let moved: Vec<f32> = without.iter().zip(&all).map(|(a, b)| a - b).collect();
            needed.push(Needed { name: name.clone(), share: *share, change: self.shown(&moved) });
        }
        needed.sort_by(|a, b| b.change.total_cmp(&a.change).then_with(|| a.name.cmp(&b.name)));
        Ok(Some(needed))
    }
}

/// The share below which photographs are [`PASSED_OVER`].
fn passed_over(shares: impl Iterator<Item = f64>) -> f64 {
    let mut shares: Vec<f64> = shares.collect();
    shares.sort_by(f64::total_cmp);
    let mut left = PASSED_OVER * shares.iter().sum::<f64>();
    let kept = shares.into_iter().find(|share| {
        left -= share;
        left < 0.0
    });
    kept.unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photographs_are_passed_over_by_what_they_show_together() {
        assert_eq!(passed_over([0.5, 0.004, 0.49, 0.006].into_iter()), 0.49, "0.010 of 1 are less than a fiftieth");
        // A thousand that show alike are all kept.
        assert_eq!(passed_over((0..1000).map(|_| 0.001)), 0.001);
        assert_eq!(passed_over(std::iter::empty()), 0.0);
    }
}
