//! Judging a state on poses it was not trained on. The last state is not the
//! best: training can have learnt its own views by heart. Judging uses virtual
//! poses and base renders only; held-out photographs stay out of it.

use crate::attack::{Attack, RobustConfig};
use crate::detect::blind::networks::Reading;
use crate::error::MarkError;
use crate::payload::Numbers;
use crate::stega::bank::BankView;
use crate::stega::judgement::{Best, Judgement, Recovered, Weakest};
use crate::stega::sample::seen;
use crate::stega::site::Site;
use crate::stega::state::State;
use crate::tensors::winner;
use cairn_nn::text_bytes;
use cairn_scene::Picture;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;

/// Training may end early once marks are read with more ease than this: the running
/// cross-entropy is then below a fifth of `classify_until` (without a classifier, recovery's error below a fifth of
/// silence's), over renders cut, tinted and noisy as no judged one is.
const EASE_TO_END: f32 = 0.8;

/// Training may end early once every answer on judged pictures is right with this probability or
/// more: a right answer on a few of them may be luck, one without doubt is less likely to.
const SURE_TO_END: f32 = 0.9;

/// Share of attacked pictures that must be answered right, where marks are trained to
/// outlast attacks, and the same of those that everything was done to; the worst attacks leave nothing to read.
const ROBUST_TO_END: f64 = 0.9;
/// Attacks on each judged picture, where there are any: as training draws them, and of all distortions at once.
const ATTACKS: [u64; 2] = [4, 8];
/// Streams of the judge's draws, apart from those of steps.
const STREAM: u64 = 1 << 33;

/// What [`Recovered`] and [`Weakest`] are the means of; each number with its identity, from 0.
#[derive(Default)]
struct Tally {
    /// 1 where a marked picture is told as its own identity's, else 0.
    told: Vec<(usize, f64)>,
    ssim: Vec<(usize, f64)>,
    /// Noise power over signal power.
    noise: Vec<(usize, f64)>,
    characters: Vec<(usize, f64)>,
}

impl Tally {
    /// Counts what `said` of identity `i`, which hides `truth`.
    fn count(&mut self, i: usize, said: &Numbers, truth: &Numbers, side: usize) -> Result<(), MarkError> {
        let picture = |rgb: &[f32]| {
            Picture::new(side, side, rgb.to_vec()).map_err(|e| MarkError::Plan(format!("a hidden picture: {e}")))
        };
        if let Some((said, truth)) = said.picture.as_ref().zip(truth.picture.as_ref()) {
            self.ssim.push((i, cairn_scene::metrics::ssim(&picture(said)?.clamped(), &picture(truth)?)?));
        }
        if let Some((said, truth)) = said.audio.as_ref().zip(truth.audio.as_ref()) {
            self.noise.push((i, 10f64.powf(-cairn_scene::metrics::snr_db(said, truth)? / 10.0)));
        }
        if let Some((said, truth)) = said.text.as_ref().zip(truth.text.as_ref()) {
            let bits: Vec<f32> = truth.iter().map(|bit| bit - 0.5).collect();
            let right = cairn_scene::metrics::text_accuracy(&text_bytes(said), &text_bytes(&bits))?;
            self.characters.push((i, right.characters));
        }
        Ok(())
    }

    /// Over all identities, or those of one.
    fn recovered(&self, of: Option<usize>) -> Recovered {
        Recovered {
            picture_ssim: mean(&self.ssim, of),
            audio_snr_db: mean(&self.noise, of).map(|ratio| -10.0 * ratio.log10()),
            text_characters: mean(&self.characters, of),
        }
    }

    fn weakest(&self) -> Option<Weakest> {
        let identities: BTreeSet<usize> = self.told.iter().map(|(i, _)| *i).collect();
        let each = identities.iter().filter_map(|i| {
            let told = mean(&self.told, Some(*i))?;
            Some(Weakest { identity: i + 1, told, recovered: self.recovered(Some(*i)) })
        });
        let least = |w: &Weakest| w.recovered.shares().iter().flatten().copied().fold(w.told, f64::min);
        each.min_by(|a, b| least(a).total_cmp(&least(b))).filter(|_| identities.len() > 1)
    }
}

/// The mean over all identities, or of one's; `None` of nothing.
fn mean(numbers: &[(usize, f64)], of: Option<usize>) -> Option<f64> {
    let of = numbers.iter().filter(|(i, _)| of.is_none_or(|of| of == *i)).map(|(_, number)| number);
    let all = of.clone().count();
    (all > 0).then(|| of.sum::<f64>() / all as f64)
}

/// How each of [`ATTACKS`] is drawn.
const DRAWN: [fn(&RobustConfig, &mut ChaCha8Rng) -> Attack; 2] = [Attack::always, Attack::everything];

/// Whether answers on attacked pictures were right, for each kind of [`ATTACKS`].
#[derive(Default)]
struct Outlasted([Vec<bool>; 2]);

impl Outlasted {
    /// Of all kinds; `None` where nothing was attacked.
    fn share(&self) -> Option<f64> {
        share(self.0.iter().flatten())
    }

    /// Whether of each kind, or of none, as many are as have to be.
    fn is_enough(&self) -> bool {
        self.0.iter().all(|right| share(right.iter()).is_none_or(|share| share >= ROBUST_TO_END))
    }
}

/// The share of what is true; `None` of nothing.
fn share<'a>(of: impl Iterator<Item = &'a bool> + Clone) -> Option<f64> {
    let all = of.clone().count();
    (all > 0).then(|| of.filter(|right| **right).count() as f64 / all as f64)
}

/// Judges the present marks with the networks' mean over the last steps, and keeps them if
/// they are the best so far. The caller decides when; a run that judges at the same steps gives the same
/// bytes. Training counts as converged once everything is answered right twice in a row, with
/// ease in training too (the few judged poses alone flatter), and the hidden
/// signals are all good enough (`enough_ssim`, `enough_snr_db`, `enough_characters`). Without a classifier
/// (`mark.guidance`) that and ease are all that is asked, and the best state is the one that recovers most.
///
/// # Errors
/// [`MarkError::NotFinite`] when an answer is not finite; [`MarkError`] when the
/// networks fail. The best state so far is then what it was.
pub(crate) fn judge(state: &mut State) -> Result<Judgement, MarkError> {
    state.average.swap(&state.networks.params)?;
    let judged = judge_present(state);
    state.average.swap(&state.networks.params)?;
    judged
}

fn judge_present(state: &mut State) -> Result<Judgement, MarkError> {
    let (side, hidden_side) = (state.config.shown_px(), state.config.side_px());
    // Of unmarked pictures and of marked ones: right answers, and all.
    let (mut told, mut sure) = ([(0usize, 0usize); 2], true);
    let mut count = |probabilities: &[f32], class: usize| {
        let (right, asked) = &mut told[usize::from(class > 0)];
        *right += usize::from(winner(probabilities) == class);
        *asked += 1;
        sure &= probabilities[class] >= SURE_TO_END;
    };
    let mut outlasted = Outlasted::default();
    let mut tally = Tally::default();
    let judged = state.sites.iter().flat_map(|site| site.bank.judged.iter().map(move |(own, view)| (site, *own, view)));
    for (at, (site, own, view)) in judged.enumerate() {
        let identity = site.identities.start + own;
        let read = read(state, &pair(state, site, identity, view, &Attack::none()))?;
        count(&read[0].0, identity + 1);
        count(&read[1].0, 0);
        tally.told.push((identity, f64::from(u8::from(winner(&read[0].0) == identity + 1))));
        attacked(state, at as u64, site, identity, view, &mut outlasted)?;
        // Before the detector has joined it says nothing, and is asked nothing.
        if state.joined.is_some() {
            tally.count(identity, &read[0].1, &state.signals[identity], hidden_side)?;
        }
    }
    for site in &state.sites {
        // What one carrier for all shows where it must say nothing.
        let carrier = state.carriers.get(site.carriers.start);
        let (field, none) = (&site.scene.field, Attack::none());
        let outside: Vec<_> =
            site.bank.judged_outside.iter().map(|view| seen(field, view, carrier, &none, side)).collect();
        for chunk in site.bank.judged_unmarked.chunks(4).chain(outside.chunks(4)) {
            for (probabilities, _) in read(state, chunk)? {
                count(&probabilities, 0);
            }
        }
    }
    let accuracy = balanced(told);
    let judgement = Judgement {
        step: state.step,
        accuracy,
        attacked: outlasted.share().unwrap_or(accuracy),
        recovered: tally.recovered(None),
        weakest: tally.weakest(),
    };
    // Before the budget has tightened marks are easier to read than they may be.
    let fair = state.tightened_last() >= 1.0;
    let named = state.config.has_classifier();
    if fair && state.best.as_ref().is_none_or(|b| judgement.score(named) >= b.judgement.score(named)) {
        state.best = Some(Best {
            judgement,
            params: state.networks.params.to_bytes()?,
            carriers: state.carriers.iter().map(|c| c.values.clone()).collect(),
        });
    }
    // What only keeps silent has shown nothing.
    let easy = state.ease() > EASE_TO_END && told[1].1 > 0;
    let right = !named || (sure && judgement.accuracy == 1.0 && outlasted.is_enough());
    let enough = fair && easy && right && judgement.recovered.is_enough(&state.config);
    // Twice in a row: once may be luck.
    state.converged |= enough && state.enough;
    state.enough = enough;
    Ok(judgement)
}

/// Counts whether each of a judged view's attacked renders, marked and not, is answered
/// right; none where marks are not trained for attacks. The same attacks every time.
fn attacked(
    state: &State,
    at: u64,
    site: &Site,
    identity: usize,
    view: &BankView,
    outlasted: &mut Outlasted,
) -> Result<(), MarkError> {
    let robust = &state.config.robust;
    if !robust.enabled {
        return Ok(());
    }
    let mut rng = ChaCha8Rng::seed_from_u64(state.seed);
    rng.set_stream(STREAM + at);
    for (right, (attacks, draw)) in outlasted.0.iter_mut().zip(ATTACKS.into_iter().zip(DRAWN)) {
        for _ in 0..attacks {
            let pair = pair(state, site, identity, view, &draw(robust, &mut rng));
            let said = state.networks.classes(&pair, state.config.shown_px()).map_err(|e| at_step(state, e))?;
            right.extend(said.iter().zip([identity + 1, 0]).map(|(said, true_class)| *said == true_class));
        }
    }
    Ok(())
}

/// A judged view with the mark of `identity` and without it, `attack` done to both.
fn pair(state: &State, site: &Site, identity: usize, view: &BankView, attack: &Attack) -> [Vec<f32>; 2] {
    let carrier = &state.carriers[site.carrier_of(identity)];
    [Some(carrier), None].map(|c| seen(&site.scene.field, view, c, attack, state.config.shown_px()))
}

fn read(state: &State, pictures: &[Vec<f32>]) -> Result<Vec<Reading>, MarkError> {
    state.networks.read(pictures, state.config.shown_px()).map_err(|error| at_step(state, error))
}

/// What is not finite is so at this step.
fn at_step(state: &State, error: MarkError) -> MarkError {
    match error {
        MarkError::NotFinite { place, .. } => MarkError::NotFinite { step: Some(state.step), place },
        error => error,
    }
}

/// The mean of the shares of right answers over those kinds of pictures of which any was asked about.
fn balanced(told: [(usize, usize); 2]) -> f64 {
    let shares = told.iter().filter(|(_, asked)| *asked > 0).map(|(right, asked)| *right as f64 / *asked as f64);
    let (sum, kinds) = shares.fold((0.0, 0u32), |(sum, kinds), share| (sum + share, kinds + 1));
    sum / f64::from(kinds.max(1))
}

#[cfg(test)]
mod tests {
    use super::{Outlasted, Tally, balanced};

    #[test]
    fn who_does_worst_is_known_though_the_mean_is_good() {
        let mut tally = Tally::default();
        for i in 0..10 {
            for _ in 0..3 {
                tally.told.push((i, if i == 6 { 0.0 } else { 1.0 }));
                tally.ssim.push((i, if i == 6 { 0.1 } else { 1.0 }));
            }
        }
        assert!((tally.recovered(None).picture_ssim.unwrap() - 0.91).abs() < 1e-12);
        let worst = tally.weakest().unwrap();
        assert_eq!((worst.identity, worst.told), (7, 0.0));
        assert!((worst.recovered.picture_ssim.unwrap() - 0.1).abs() < 1e-12);
        assert_eq!(worst.recovered.audio_snr_db, None);
        // Right as often as can be and hardly recovered is worse than middling in both.
        let text = Tally {
            told: vec![(0, 1.0), (1, 0.67)],
            ssim: vec![(1, 0.67)],
            characters: vec![(0, 0.4)],
            ..Tally::default()
        };
        assert_eq!(text.weakest().unwrap().identity, 1);
        // One alone is the mean.
        let alone = Tally { told: vec![(0, 1.0)], ..Tally::default() };
        assert_eq!(alone.weakest(), None);
        assert_eq!(Tally::default().weakest(), None);
    }

    #[test]
    fn few_marked_pictures_count_as_much_as_many_unmarked_ones() {
        assert_eq!(balanced([(30, 40), (1, 4)]), 0.5);
        assert_eq!(balanced([(31, 31), (9, 9)]), 1.0);
        // Where no cluster has a virtual pose, what was asked counts alone.
        assert_eq!(balanced([(3, 4), (0, 0)]), 0.75);
        assert_eq!(balanced([(0, 0), (0, 0)]), 0.0);
    }

    #[test]
    fn what_has_everything_done_to_it_must_be_outlasted_by_itself() {
        let of = |right: usize, all: usize| (0..all).map(|i| i < right).collect::<Vec<_>>();
        assert_eq!(Outlasted::default().share(), None);
        assert!(Outlasted::default().is_enough());
        let mostly = Outlasted([of(36, 36), of(60, 72)]);
        assert!(mostly.share().unwrap() > 0.88 && !mostly.is_enough());
        assert!(Outlasted([of(33, 36), of(65, 72)]).is_enough());
        assert!(!Outlasted([of(32, 36), of(72, 72)]).is_enough());
    }
}
