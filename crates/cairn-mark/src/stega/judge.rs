//! Judging a state on poses it was not trained on. The last state is not the
//! best: training can have learnt its own views by heart. Judging uses virtual
//! poses and base renders only; held-out photographs stay out of it.

use crate::attack::{Attack, Attacked, RobustConfig};
use crate::detect::blind::networks::Reading;
use crate::error::MarkError;
use crate::payload::Numbers;
use crate::stega::bank::BankView;
use crate::stega::carrier::Carrier;
use crate::stega::recipe::Recipe;
use crate::stega::site::Site;
use crate::stega::trainer::MarkTrainer;
use crate::stega::window::Window;
use cairn_field::Field;
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

/// How a state did on virtual poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Judgement {
    /// After this many steps.
    pub step: u64,
    /// Right answers of the classifier, the mean of the shares of marked and of unmarked pictures (of one kind where
    /// there is none of the other), [0, 1].
    pub accuracy: f64,
    /// The share of right answers after attacks (`[mark.robust]`), two in three of them all at once; as `accuracy` where there
    /// are none.
    pub attacked: f64,
    /// How near the recovered signals come to the true ones.
    pub recovered: Recovered,
    /// Who does worst, which a mean over many identities does not show; `None` where marks of fewer than two were judged.
    pub weakest: Option<Weakest>,
}

/// The identity of which something comes back worst, over the poses that it is judged by: its least figure is the least of all.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weakest {
    /// Its class, from 1.
    pub identity: usize,
    /// The share of its marked pictures that are told as its own, [0, 1].
    pub told: f64,
    /// What comes back of its signals.
    pub recovered: Recovered,
}

/// How near recovered signals come to the true ones, each the mean over the poses
/// of identities that hide such a thing; `None` where nobody does.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Recovered {
    /// SSIM of the pictures.
    pub picture_ssim: Option<f64>,
    /// SNR of the sounds, dB: of the mean ratio of noise to signal, so that one lost
    /// sound is not outweighed by another that is perfect.
    pub audio_snr_db: Option<f64>,
    /// Share of the texts' characters (bytes), 0 to 1.
    pub text_characters: Option<f64>,
}

impl Recovered {
    /// All three, for a file.
    pub(crate) fn parts(&self) -> [Option<f64>; 3] {
        [self.picture_ssim, self.audio_snr_db, self.text_characters]
    }

    pub(crate) fn from_parts([picture_ssim, audio_snr_db, text_characters]: [Option<f64>; 3]) -> Self {
        Self { picture_ssim, audio_snr_db, text_characters }
    }

    /// The mean over the heads, each 0 (nothing, or silence) to 1: SSIM, one less the
    /// ratio of noise to signal in amplitude, and characters.
    fn score(&self) -> f64 {
        let all = self.shares();
        all.iter().flatten().sum::<f64>() / all.iter().flatten().count().max(1) as f64
    }

    /// Each head, 0 (nothing, or silence) to 1.
    fn shares(&self) -> [Option<f64>; 3] {
        let sound = self.audio_snr_db.map(|db| (1.0 - 10f64.powf(-db / 20.0)).max(0.0));
        [self.picture_ssim, sound, self.text_characters]
    }

    /// Whether each is good enough to end training.
    fn is_enough(&self, config: &Recipe) -> bool {
        self.picture_ssim.is_none_or(|ssim| ssim >= config.enough_ssim)
            && self.audio_snr_db.is_none_or(|db| db >= config.enough_snr_db)
            && self.text_characters.is_none_or(|share| share >= config.enough_characters)
    }
}

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
            self.characters.push((i, right.characters.share().unwrap_or(0.0)));
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

/// What is kept of the best state.
#[derive(Clone)]
pub(crate) struct State {
    pub(crate) judgement: Judgement,
    pub(crate) params: Vec<u8>,
    pub(crate) carriers: Vec<Vec<f32>>,
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

impl Judgement {
    /// What states are ranked by; without a classifier its answers are those of an untrained one, and recovery is all there is.
    fn score(&self, has_classifier: bool) -> f64 {
        // An owner missed or made up is worse than a blurred signal.
        let answers = if has_classifier { self.accuracy + self.attacked } else { 0.0 };
        answers + self.recovered.score()
    }
}

impl MarkTrainer {
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
    pub fn judge(&mut self) -> Result<Judgement, MarkError> {
        self.average.swap(&self.networks.params)?;
        let judged = self.judge_present();
        self.average.swap(&self.networks.params)?;
        judged
    }

    fn judge_present(&mut self) -> Result<Judgement, MarkError> {
        let (side, hidden_side) = (self.config.shown_px(), self.config.side_px());
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
        for (at, (site, own, view)) in self.judged().enumerate() {
            let identity = site.identities.start + own;
            let read = self.read(&self.pair(site, identity, view, &Attack::none()))?;
            count(&read[0].0, identity + 1);
            count(&read[1].0, 0);
            tally.told.push((identity, f64::from(u8::from(winner(&read[0].0) == identity + 1))));
            self.attacked(at as u64, (site, identity), view, &mut outlasted)?;
            // Before the detector has joined it says nothing, and is asked nothing.
            if self.joined.is_some() {
                tally.count(identity, &read[0].1, &self.signals[identity], hidden_side)?;
            }
        }
        for site in &self.sites {
            // What one carrier for all shows where it must say nothing.
            let carrier = self.carriers.get(site.carriers.start);
            let (field, none) = (&site.scene.field, Attack::none());
            let outside: Vec<_> =
                site.bank.judged_outside.iter().map(|view| seen(field, view, carrier, &none, side)).collect();
            for chunk in site.bank.judged_unmarked.chunks(4).chain(outside.chunks(4)) {
                for (probabilities, _) in self.read(chunk)? {
                    count(&probabilities, 0);
                }
            }
        }
        let accuracy = balanced(told);
        let judgement = Judgement {
            step: self.step,
            accuracy,
            attacked: outlasted.share().unwrap_or(accuracy),
            recovered: tally.recovered(None),
            weakest: tally.weakest(),
        };
        // Before the budget has tightened marks are easier to read than they may be.
        let fair = self.tightened_last() >= 1.0;
        let named = self.config.has_classifier();
        if fair && self.best.as_ref().is_none_or(|b| judgement.score(named) >= b.judgement.score(named)) {
            self.best = Some(State {
                judgement,
                params: self.networks.params.to_bytes()?,
                carriers: self.carriers.iter().map(|c| c.values.clone()).collect(),
            });
        }
        // What only keeps silent has shown nothing.
        let easy = self.ease() > EASE_TO_END && told[1].1 > 0;
        let right = !named || (sure && judgement.accuracy == 1.0 && outlasted.is_enough());
        let enough = fair && easy && right && judgement.recovered.is_enough(&self.config);
        // Twice in a row: once may be luck.
        self.converged |= enough && self.enough;
        self.enough = enough;
        Ok(judgement)
    }

    /// The virtual views to judge by: each one's scene, and its identity in that, from 0.
    fn judged(&self) -> impl Iterator<Item = (&Site, usize, &BankView)> {
        self.sites.iter().flat_map(|site| site.bank.judged.iter().map(move |(own, view)| (site, *own, view)))
    }

    /// Counts whether each of a judged view's attacked renders, marked and not, is answered
    /// right; none where marks are not trained for attacks. The same attacks every time.
    fn attacked(
        &self,
        at: u64,
        (site, identity): (&Site, usize),
        view: &BankView,
        outlasted: &mut Outlasted,
    ) -> Result<(), MarkError> {
        let robust = &self.config.robust;
        if !robust.enabled {
            return Ok(());
        }
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(STREAM + at);
        for (right, (attacks, draw)) in outlasted.0.iter_mut().zip(ATTACKS.into_iter().zip(DRAWN)) {
            for _ in 0..attacks {
                let pair = self.pair(site, identity, view, &draw(robust, &mut rng));
                let said = self.networks.classes(&pair, self.config.shown_px()).map_err(|e| self.at_step(e))?;
                right.extend(said.iter().zip([identity + 1, 0]).map(|(said, true_class)| *said == true_class));
            }
        }
        Ok(())
    }

    /// A judged view with the mark of `identity` and without it, `attack` done to both.
    fn pair(&self, site: &Site, identity: usize, view: &BankView, attack: &Attack) -> [Vec<f32>; 2] {
        let carrier = &self.carriers[site.carrier_of(identity)];
        [Some(carrier), None].map(|c| seen(&site.scene.field, view, c, attack, self.config.shown_px()))
    }

    fn read(&self, pictures: &[Vec<f32>]) -> Result<Vec<Reading>, MarkError> {
        self.networks.read(pictures, self.config.shown_px()).map_err(|error| self.at_step(error))
    }

    /// What is not finite is so at this step.
    fn at_step(&self, error: MarkError) -> MarkError {
        match error {
            MarkError::NotFinite { place, .. } => MarkError::NotFinite { step: Some(self.step), place },
            error => error,
        }
    }
}

/// The mean of the shares of right answers over those kinds of pictures of which any was asked about.
fn balanced(told: [(usize, usize); 2]) -> f64 {
    let shares = told.iter().filter(|(_, asked)| *asked > 0).map(|(right, asked)| *right as f64 / *asked as f64);
    let (sum, kinds) = shares.fold((0.0, 0u32), |(sum, kinds), share| (sum + share, kinds + 1));
    sum / f64::from(kinds.max(1))
}

/// A view as the networks read it from a file, `side x side x 3`.
fn seen(field: &Field, view: &BankView, carrier: Option<&Carrier>, attack: &Attack, side: usize) -> Vec<f32> {
    let file = file(field, view, carrier, attack);
    Window::whole(file.size[0], file.size[1], side).apply(&file.rgb)
}

/// A view in its own light as it is in a file of 8 bits, with a mark or without, `attack` done to it.
pub(crate) fn file(field: &Field, view: &BankView, carrier: Option<&Carrier>, attack: &Attack) -> Attacked {
    let mut rgb = view.linear.base(&view.appearance);
    if let Some(carrier) = carrier {
        carrier.after(attack).show(field, view, &view.appearance, &mut rgb);
    }
    attack.apply(eight_bits(rgb), [view.linear.width(), view.linear.height()])
}

/// What remains of a render in an 8-bit file.
fn eight_bits(mut rgb: Vec<f32>) -> Vec<f32> {
    rgb.iter_mut().for_each(|v| *v = (v.clamp(0.0, 1.0) * 255.0).round() / 255.0);
    rgb
}

/// The class with the largest probability.
pub(crate) fn winner(probabilities: &[f32]) -> usize {
    (0..probabilities.len()).max_by(|a, b| probabilities[*a].total_cmp(&probabilities[*b])).unwrap_or(0)
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
