//! How long a job still takes, with the phases that have not begun.
//!
//! A phase that runs says itself how long it still takes. What comes after it is estimated: from seconds that were measured
//! on two cores, times how much slower or faster than those the newest phase runs here. The estimate is rough. A ray of
//! stage 1 took 2.8 to 7.0 microseconds on four captures, a configured step of stage 2, brought to one size of picture,
//! 0.054 to 0.20 seconds. The constants are their geometric means (`bench/results`, field and mark). Stage 2 ends early
//! where marks can be read, so not all configured steps are taken.

use crate::train::job::{Job, Progress};
use crate::train::stages::{BASE, MARK};

/// Seconds a ray of stage 1.
const RAY_S: f64 = 4.8e-6;
/// Seconds a step of stage 2 of three renders, on pictures of [`STEP_PX`] px.
const STEP_S: f64 = 0.093;
/// Side of the pictures that the networks see, px, for which [`STEP_S`] is.
const STEP_PX: f64 = 128.0;
/// Renders of a step for which [`STEP_S`] is.
const STEP_RENDERS: f64 = 3.0;

/// A phase that takes long.
struct Phase {
    stage: &'static str,
    /// Seconds on two cores.
    seconds: f64,
}

/// The phases of a job, and how far it is in them.
pub(crate) struct Ahead {
    phases: Vec<Phase>,
    /// Phases that have begun.
    begun: usize,
    /// The last step of the phase that runs: a smaller one belongs to the next of the same name.
    step: u64,
    /// Seconds here for one on two cores, of the newest phase that says.
    slower: f64,
}

impl Ahead {
    /// All phases of `job`.
    pub(crate) fn of(job: &Job) -> Self {
        let scenes = job.spec.scenes().count();
        let own = |at: usize| job.of_scene(at);
        let grown = |at: usize| job.spec.grow_from.get(at).is_some_and(Option::is_some);
        let mut phases = Vec::new();
        for at in (0..scenes).filter(|at| !grown(*at)) {
            let field = own(at).spec.settings.field;
            phases.push(Phase { stage: BASE, seconds: (field.steps * field.rays_per_step as u64) as f64 * RAY_S });
        }
        if !job.spec.base_only {
            let mark = &job.spec.settings.mark;
            let share = if (0..scenes).any(grown) { mark.grow_share } else { 1.0 };
            let of_step = (mark.batch as f64 / STEP_RENDERS) * (mark.shown_px() as f64 / STEP_PX).powi(2);
            phases.push(Phase { stage: MARK, seconds: mark.steps as f64 * share * of_step * scenes as f64 * STEP_S });
        }
        Self { phases, begun: 0, step: 0, slower: 1.0 }
    }

    /// `progress` of the phase that runs, with the seconds of those after it. Negative stays negative: not known.
    pub(crate) fn with_later(&mut self, progress: Progress) -> Progress {
        let is_next = |phase: &&Phase| phase.stage == progress.stage;
        let running = self.begun.checked_sub(1).and_then(|at| self.phases.get(at));
        if running.is_none_or(|phase| phase.stage != progress.stage || progress.step < self.step)
            && let Some(further) = self.phases[self.begun..].iter().position(|phase| is_next(&phase))
        {
            self.begun += further + 1;
        }
        let running = self.begun.checked_sub(1).and_then(|at| self.phases.get(at)).filter(is_next);
        if let Some(phase) = running {
            self.step = progress.step;
            let left = progress.total.saturating_sub(progress.step) as f64 / progress.total.max(1) as f64;
            if progress.seconds_left > 0.0 && left > 0.0 && phase.seconds > 0.0 {
                self.slower = progress.seconds_left / (left * phase.seconds);
            }
        }
        if progress.seconds_left < 0.0 {
            return progress;
        }
        let later: f64 = self.phases[self.begun..].iter().map(|phase| phase.seconds).sum();
        Progress { seconds_left: progress.seconds_left + later * self.slower, ..progress }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ahead(phases: &[(&'static str, f64)]) -> Ahead {
        let phases = phases.iter().map(|&(stage, seconds)| Phase { stage, seconds }).collect();
        Ahead { phases, begun: 0, step: 0, slower: 1.0 }
    }

    fn at(stage: &str, step: u64, seconds_left: f64) -> Progress {
        Progress { stage: stage.into(), step, total: 100, seconds_left, ..Progress::default() }
    }

    #[test]
    fn what_has_not_begun_counts_and_at_the_speed_of_what_runs() {
        let mut ahead = ahead(&[(BASE, 10.0), (MARK, 30.0)]);
        // Before any phase: as measured.
        assert_eq!(ahead.with_later(at("screening", 50, 2.0)).seconds_left, 42.0);
        // Half of stage 1 takes 10 s for 5: everything takes twice as long here.
        assert_eq!(ahead.with_later(at(BASE, 50, 10.0)).seconds_left, 70.0);
        // What is prepared between has no speed of its own.
        assert_eq!(ahead.with_later(at("ray weights", 0, 4.0)).seconds_left, 64.0);
        assert_eq!(ahead.with_later(at(MARK, 50, 20.0)).seconds_left, 20.0);
        assert_eq!(ahead.with_later(at("marked renders", 1, 3.0)).seconds_left, 3.0);
    }

    #[test]
    fn phases_of_one_name_follow_one_another() {
        let mut ahead = ahead(&[(BASE, 10.0), (BASE, 20.0), (MARK, 30.0)]);
        assert_eq!(ahead.with_later(at(BASE, 0, 10.0)).seconds_left, 60.0);
        assert_eq!(ahead.with_later(at(BASE, 90, 1.0)).seconds_left, 51.0);
        assert_eq!(ahead.with_later(at(BASE, 10, 18.0)).seconds_left, 48.0);
        assert_eq!(ahead.with_later(at(MARK, 10, 27.0)).seconds_left, 27.0);
    }

    #[test]
    fn what_is_not_known_stays_so() {
        let mut ahead = ahead(&[(BASE, 10.0)]);
        assert_eq!(ahead.with_later(at("photographs", 0, -1.0)).seconds_left, -1.0);
    }
}
