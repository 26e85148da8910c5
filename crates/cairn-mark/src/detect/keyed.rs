//! Keyed detection: whose woven marks a picture shows, with a proven probability of a wrong name.
//!
//! The picture is registered with the base field, whose render is subtracted. What a distortion makes of the render is
//! regressed out, and what is left is brought back to the cells of the field, as evidence `B` of each cell's sign in each
//! opponent colour. A contributor's score is
//!
//! ```text
//! z = sum s m B / sqrt(sum (m B)^2)      over their cells: s the signs, m the mark's strength there
//! ```
//!
//! The signs are independent of a picture that was made without the woven field. For such a picture z is a normalised sum
//! of random signs, whatever the picture shows and whatever the steps before do, as long as they do not look at keys: see
//! [`chance`]. Nothing is trained, and no threshold is chosen on pictures.

use super::opponent::Planes;
use crate::attack::Blur;
use crate::weave::keys::WeavingSecret;
use crate::weave::lots::UNOWNED;
use crate::weave::woven::{OPPONENT, WEIGHTS, Weave, all_signs};
use cairn_field::{Field, MarkableField};
use cairn_register::Registered;
use cairn_scene::Picture;
use rayon::prelude::*;
use std::fmt;

/// Ways of weighing pixels: by the trust in each colour, by their mean, and by lightness alone. The best counts.
pub const WAYS: usize = 3;
/// How far around a pixel the size of what is left is looked at, standard deviation, px.
const AROUND_PX: f32 = 3.0;
/// Mean square of what eight bits leave of a number, colours in [0, 1].
const ROUNDING: f32 = 1.0 / (12.0 * 255.0 * 255.0);
/// Blurs between the bands of detail, standard deviation, px; the last is the one that detail is finer than.
const BANDS_PX: [f32; 3] = [0.7, 1.4, 2.0];
/// Side of a tile whose distortion is one, px.
const TILE: usize = 50;
/// What is regressed on, for each opponent colour: the bands, and the slopes across and down.
const REGRESSORS: usize = BANDS_PX.len() + 2;
/// Share of the mean diagonal that is added to it, so that flat tiles have a solution.
const RIDGE: f64 = 1e-3;
/// Times that distortions are fitted, each by the trust that the one before left.
const FITS: usize = 2;
/// An entry of the view that weighs less does not count.
const CUTOFF: f32 = 1e-3;
/// Cells that a task goes through.
const CELLS_A_TASK: usize = 8192;

/// What some pictures tell of each cell's signs: `m B` by way and opponent colour. That of several pictures of one scene adds
/// up ([`Evidence::add`]).
/// It is as secret as the keys: on a marked picture its signs are estimates of theirs.
#[derive(Clone, PartialEq)]
pub struct Evidence {
    of_cells: Vec<[[f32; 3]; WAYS]>,
}

impl Evidence {
    /// Adds what another picture of the same scene tells.
    ///
    /// # Panics
    /// When it is of another weaving.
    pub fn add(&mut self, other: &Self) {
        assert_eq!(self.of_cells.len(), other.of_cells.len(), "one weaving");
        let pairs = self.of_cells.as_flattened_mut().iter_mut().zip(other.of_cells.as_flattened());
        pairs.for_each(|(a, b)| a.iter_mut().zip(b).for_each(|(a, b)| *a += b));
    }

    /// What a `registered` picture tells of the cells of `weave`, woven into `base`. Keys are not looked at.
    pub fn of(base: &Field, weave: &Weave, registered: &Registered) -> Self {
        let Registered { camera, appearance, picture, .. } = registered;
        let view = base.view(camera, CUTOFF, 1);
        let render = Picture::new(view.width(), view.height(), view.base(appearance)).expect("a colour a pixel");
        let render = render.clamped();
        let slopes = Left::of(Planes::of(picture).less(&Planes::of(&render)), &render).slopes();
        let mut of_cells = vec![[[0.0; 3]; WAYS]; weave.lots.numbers.len()];
        let mut colours = vec![0.0; 3 * base.grid().rows()];
        for (way, slope) in slopes.iter().enumerate() {
            colours.fill(0.0);
            view.push_back_lit(slope, appearance, &mut colours);
            let rows = colours.chunks_exact(3).zip(&weave.lots.of_row).zip(&weave.amplitudes).skip(1);
            for ((owed, cell), amplitude) in rows.filter(|(_, amplitude)| **amplitude > 0.0) {
                let own = &mut of_cells[*cell as usize][way];
                for k in 0..3 {
                    let along: f32 = (0..3).map(|c| OPPONENT[k][c] * owed[c]).sum();
                    own[k] += amplitude * WEIGHTS[k] * along;
                }
            }
        }
        Self { of_cells }
    }

    /// The scores of the contributors of `weave`, each by every way, under the keys of `secret`; 0 where there is no evidence.
    pub fn scores(&self, weave: &Weave, secret: &WeavingSecret) -> Vec<[f64; WAYS]> {
        let signs = all_signs(secret, &weave.contributors);
        let lots = &weave.lots;
        let of_task = |(task, cells): (usize, &[[[f32; 3]; WAYS]])| {
            let mut sums = vec![[[0.0f64; 2]; WAYS]; weave.contributors.len()];
            for (k, evidence) in cells.iter().enumerate() {
                let cell = task * CELLS_A_TASK + k;
                if lots.owners[cell] == UNOWNED || evidence.as_flattened().iter().all(|v| *v == 0.0) {
                    continue;
                }
                let owner = usize::from(lots.owners[cell]);
                let own = signs[owner][usize::from(lots.parts[cell])].of(lots.numbers[cell]);
                for (sum, evidence) in sums[owner].iter_mut().zip(evidence) {
                    for (sign, value) in own.iter().zip(evidence) {
                        sum[0] += f64::from(sign * value);
                        sum[1] += f64::from(*value).powi(2);
                    }
                }
            }
            sums
        };
        // Collected in order: the sums come out the same with any number of threads.
        let tasks: Vec<_> = self.of_cells.par_chunks(CELLS_A_TASK).enumerate().map(of_task).collect();
        let of = |owner: usize| {
            std::array::from_fn(|way| {
                let sum = |k: usize| tasks.iter().map(|task| task[owner][way][k]).sum::<f64>();
                if sum(1) > 0.0 { sum(0) / sum(1).sqrt() } else { 0.0 }
            })
        };
        (0..weave.contributors.len()).map(of).collect()
    }
}

impl fmt::Debug for Evidence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Evidence(..)")
    }
}

/// An upper bound of the probability that a normalised sum of independent random signs exceeds `z`, whatever its weights:
/// the smaller of Hoeffding's (1963) `exp(-z^2 / 2)` and Bentkus and Dzindzalieta's (2015) `P(N > z) / (4 P(N > sqrt 2))`, N
/// standard normal. 1 where z is not positive.
pub fn chance(z: f64) -> f64 {
    if z.is_nan() || z <= 0.0 {
        return 1.0;
    }
    let beyond = |z: f64| libm::erfc(z / 2f64.sqrt()) / 2.0;
    (-z * z / 2.0).exp().min(beyond(z) / (4.0 * beyond(2f64.sqrt()))).min(1.0)
}

/// The score from which on a contributor is named, where one of `scores` looked at may be wrong with `probability` at most
/// (union bound).
///
/// # Panics
/// When no score is looked at, or the probability is not in (0, 1).
pub fn threshold(scores: usize, probability: f64) -> f64 {
    assert!(scores > 0 && probability > 0.0 && probability < 1.0, "some scores, and a probability");
    let each = probability / scores as f64;
    // `chance` falls from 1 to less than any f64 before 40.
    let (mut low, mut high) = (0.0, 40.0);
    for _ in 0..80 {
        let middle = (low + high) / 2.0;
        if chance(middle) > each { low = middle } else { high = middle }
    }
    high
}

/// What the picture has that the base render has not, less what a distortion makes of the render.
struct Left {
    planes: Planes,
    /// How far each number is to be trusted.
    trust: Vec<f32>,
    /// How much of each band, by opponent colour, came through.
    survived: [[f32; 3]; BANDS_PX.len()],
}

impl Left {
    fn of(difference: Planes, render: &Picture) -> Self {
        let size = difference.size;
        let all = Planes { size, values: sum(&bands(&difference)) };
        let regressors = regressors(&Planes::of(render));
        let (whole, tiles) = (Part { left: 0, right: size[0], top: 0, bottom: size[1] }, Part::tiles(size));
        let mut survived = [[1.0; 3]; BANDS_PX.len()];
        let mut planes = all.clone();
        let mut trust = trust(&planes);
        // Once more by what was left: at first detail that a distortion took makes its own pixels look untrustworthy.
        for _ in 0..FITS {
            for c in 0..3 {
                let shares = whole.fitted(&regressors, &all, &trust, c);
                // A band of which the render has none says nothing of what came through.
                survived.iter_mut().zip(shares).for_each(|(band, share)| band[c] = (1.0 + share).clamp(0.0, 1.0));
            }
            let of = |part: &Part| [0, 1, 2].map(|c| part.fitted(&regressors, &all, &trust, c));
            let shares: Vec<_> = tiles.par_iter().map(of).collect();
            for (part, shares) in tiles.iter().zip(shares) {
                for at in part.pixels(size[0]) {
                    for (c, shares) in shares.iter().enumerate() {
                        let known = regressors.iter().zip(shares).map(|(r, share)| share * r[3 * at + c]);
                        planes.values[3 * at + c] = all.values[3 * at + c] - known.sum::<f32>();
                    }
                }
            }
            trust = self::trust(&planes);
        }
        Self { planes, trust, survived }
    }

    /// By each way, what is owed to the render's colours (RGB): trusted, and filtered by what came through.
    fn slopes(&self) -> [Vec<f32>; WAYS] {
        let weigh = |weight: &dyn Fn(usize, usize) -> f32| {
            let at = |i: usize| self.planes.values[i] * weight(i / 3, i % 3);
            let weighed = Planes { size: self.planes.size, values: (0..self.planes.values.len()).map(at).collect() };
            let bands = bands(&weighed);
            let pixel = |p: usize| {
                let own: [f32; 3] = std::array::from_fn(|c| {
                    bands.iter().zip(&self.survived).map(|(band, share)| share[c] * band[3 * p + c]).sum()
                });
                [0, 1, 2].map(|c| (0..3).map(|k| own[k] * OPPONENT[k][c]).sum::<f32>())
            };
            (0..weighed.values.len() / 3).flat_map(pixel).collect()
        };
        let shared = |p: usize| 3.0 / (0..3).map(|c| 1.0 / self.trust[3 * p + c]).sum::<f32>();
        [
            weigh(&|p, c| self.trust[3 * p + c]),
            weigh(&|p, _| shared(p)),
            weigh(&|p, c| if c == 0 { self.trust[3 * p] } else { 0.0 }),
        ]
    }
}

/// One over the mean square around each number.
fn trust(planes: &Planes) -> Vec<f32> {
    let squares: Vec<f32> = planes.values.iter().map(|v| v * v).collect();
    let mut around = Blur::new(AROUND_PX).apply(&squares, planes.size);
    around.iter_mut().for_each(|v| *v = 1.0 / (v.max(0.0) + ROUNDING));
    around
}

/// Bands of detail, the finest first; what is coarser than the last is left out.
fn bands(of: &Planes) -> [Vec<f32>; BANDS_PX.len()] {
    let mut finer = of.values.clone();
    BANDS_PX.map(|sigma| {
        let coarser = Blur::new(sigma).apply(&of.values, of.size);
        let band = finer.iter().zip(&coarser).map(|(a, b)| a - b).collect();
        finer.clone_from(&coarser);
        band
    })
}

fn sum(bands: &[Vec<f32>; BANDS_PX.len()]) -> Vec<f32> {
    (0..bands[0].len()).map(|at| bands.iter().map(|band| band[at]).sum()).collect()
}

/// What distortions make of a render's detail: each of its bands weaker or stronger, and moved a little aside.
fn regressors(whole: &Planes) -> [Vec<f32>; REGRESSORS] {
    let [w, h] = whole.size;
    let bands = bands(whole);
    let detail = sum(&bands);
    let slope = |before: &dyn Fn(usize, usize) -> usize, behind: &dyn Fn(usize, usize) -> usize| -> Vec<f32> {
        let of = |i: usize| {
            let (x, y, c) = (i / 3 % w, i / 3 / w, i % 3);
            (detail[3 * behind(x, y) + c] - detail[3 * before(x, y) + c]) / 2.0
        };
        (0..detail.len()).map(of).collect()
    };
    let across = slope(&|x, y| y * w + x.saturating_sub(1), &|x, y| y * w + (x + 1).min(w - 1));
    let down = slope(&|x, y| y.saturating_sub(1) * w + x, &|x, y| (y + 1).min(h - 1) * w + x);
    let [fine, middle, coarse] = bands;
    [fine, middle, coarse, across, down]
}

/// A part of a picture, px.
struct Part {
    left: usize,
    right: usize,
    top: usize,
    bottom: usize,
}

impl Part {
    /// The tiles of a picture.
    fn tiles([w, h]: [usize; 2]) -> Vec<Self> {
        let tile =
            |left: usize, top: usize| Self { left, right: (left + TILE).min(w), top, bottom: (top + TILE).min(h) };
        (0..h).step_by(TILE).flat_map(|top| (0..w).step_by(TILE).map(move |left| tile(left, top))).collect()
    }

    /// Its pixels' numbers, in a picture of that width.
    fn pixels(&self, width: usize) -> impl Iterator<Item = usize> + use<> {
        let (left, right) = (self.left, self.right);
        (self.top..self.bottom).flat_map(move |y| (left..right).map(move |x| y * width + x))
    }

    /// How much of each regressor is in opponent colour `c` of `planes`: a ridge regression, weighted by `trust`.
    fn fitted(
        &self,
        regressors: &[Vec<f32>; REGRESSORS],
        planes: &Planes,
        trust: &[f32],
        c: usize,
    ) -> [f32; REGRESSORS] {
        let (mut a, mut b) = ([[0.0f64; REGRESSORS]; REGRESSORS], [0.0f64; REGRESSORS]);
        for at in self.pixels(planes.size[0]).map(|pixel| 3 * pixel + c) {
            let weight = f64::from(trust[at]);
            let x: [f64; REGRESSORS] = std::array::from_fn(|k| f64::from(regressors[k][at]));
            for i in 0..REGRESSORS {
                for j in 0..=i {
                    a[i][j] += weight * x[i] * x[j];
                }
                b[i] += weight * x[i] * f64::from(planes.values[at]);
            }
        }
        let ridge = RIDGE * (0..REGRESSORS).map(|k| a[k][k]).sum::<f64>() / REGRESSORS as f64;
        (0..REGRESSORS).for_each(|k| a[k][k] += ridge);
        solved(a, b).map(|v| v as f32)
    }
}

/// `x` of `a x = b`, of a symmetric `a` of which the lower half is given (Cholesky); zeros where it has no solution.
fn solved(mut a: [[f64; REGRESSORS]; REGRESSORS], mut b: [f64; REGRESSORS]) -> [f64; REGRESSORS] {
    for i in 0..REGRESSORS {
        for j in 0..=i {
            let known: f64 = (0..j).map(|k| a[i][k] * a[j][k]).sum();
            let left = a[i][j] - known;
            if i == j && !(left > 0.0 && left.is_finite()) {
                return [0.0; REGRESSORS];
            }
            a[i][j] = if i == j { left.sqrt() } else { left / a[j][j] };
        }
        b[i] = (b[i] - (0..i).map(|k| a[i][k] * b[k]).sum::<f64>()) / a[i][i];
    }
    for i in (0..REGRESSORS).rev() {
        b[i] = (b[i] - (i + 1..REGRESSORS).map(|k| a[k][i] * b[k]).sum::<f64>()) / a[i][i];
    }
    b
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::weave::lots::Lots;

    #[test]
    fn the_bound_is_the_published_one_and_its_threshold_turns_it_round() {
        assert_eq!((chance(0.0), chance(-3.0), chance(f64::NAN)), (1.0, 1.0, 1.0));
        // P(N > 2) = 0.02275; 1 / (4 P(N > sqrt 2)) = 3.1787.
        assert!((chance(2.0) - 3.1787 * 0.022_750_1).abs() < 1e-4);
        assert!((chance(0.5) - (-0.125f64).exp()).abs() < 1e-12, "Hoeffding's is the smaller");
        let t = threshold(309, 1e-6);
        assert!((t - 5.98).abs() < 0.03, "{t}");
        assert!(309.0 * chance(t) <= 1e-6 && 309.0 * chance(t - 1e-6) > 1e-6 * (1.0 - 1e-4));
    }

    /// Of up to twelve signs all sums are there.
    #[test]
    fn sums_of_few_signs_stay_below_the_bound() {
        let shapes: [&dyn Fn(usize) -> f64; 3] =
            [&|_| 1.0, &|k| 0.7f64.powi(k as i32), &|k| if k == 0 { 3.0 } else { 1.0 }];
        for (n, shape) in (1..=12).flat_map(|n| shapes.map(|shape| (n, shape))) {
            let length = (0..n).map(|k| shape(k).powi(2)).sum::<f64>().sqrt();
            let sign = |signs: usize, k: usize| if signs >> k & 1 == 0 { 1.0 } else { -1.0 };
            let of = |signs: usize| (0..n).map(|k| sign(signs, k) * shape(k)).sum::<f64>() / length;
            let mut all: Vec<f64> = (0..1 << n).map(of).collect();
            all.sort_by(f64::total_cmp);
            for (k, z) in all.iter().enumerate() {
                let share = (all.len() - k) as f64 / all.len() as f64;
                assert!(share <= chance(*z - 1e-9) + 1e-12, "{n} signs: {share} reach {z}");
            }
        }
    }

    /// A weaving of 6,000 cells of two contributors, a vertex each.
    fn weave() -> Weave {
        let lots = Lots {
            side: 1,
            of_row: (0..6000).collect(),
            numbers: (0..6000).map(|k| k * 7 + 3).collect(),
            owners: (0..6000).map(|k| if k % 10 == 9 { UNOWNED } else { (k % 2) as u16 }).collect(),
            parts: (0..6000).map(|k| (k % 3) as u8).collect(),
        };
        Weave { lots, amplitudes: vec![0.01; 6000], contributors: vec!["ann".into(), "ben".into()] }
    }

    #[test]
    fn a_score_is_the_agreement_with_the_owners_signs() {
        let (weave, secret) = (weave(), WeavingSecret::new([5; 32]));
        let signs = all_signs(&secret, &weave.contributors);
        // Of ann's cells all agree, of ben's a half; unowned ones do not matter.
        let told = |cell: usize| {
            let own = match weave.lots.owners[cell] {
                0 => signs[0][usize::from(weave.lots.parts[cell])].of(weave.lots.numbers[cell]),
                _ => {
                    if cell % 4 < 2 {
                        [0.4; 3]
                    } else {
                        [-0.4; 3]
                    }
                }
            };
            [own, own, [own[0], 0.0, 0.0]]
        };
        let mut evidence = Evidence { of_cells: (0..6000).map(told).collect() };
        let scores = evidence.scores(&weave, &secret);
        // 3,000 cells, no unowned one among the even ones.
        assert!(
            (scores[0][0] - 9000f64.sqrt()).abs() < 1e-6 && (scores[0][2] - 3000f64.sqrt()).abs() < 1e-6,
            "{scores:?}"
        );
        assert!(scores[1].iter().all(|z| z.abs() < 4.5), "{scores:?}");
        let others = evidence.scores(&weave, &WeavingSecret::new([6; 32]));
        assert!(others.as_flattened().iter().all(|z| z.abs() < 4.5), "{others:?}");
        let once = evidence.clone();
        evidence.add(&once);
        assert_eq!(evidence.scores(&weave, &secret), scores, "twice the same says no more by this measure");
    }

    /// Evidence of any kind, strong in few cells or the same in all, under many secrets: a standard deviation of 1.
    #[test]
    fn scores_without_a_mark_have_a_variance_of_one() {
        let weave = weave();
        let shapes: [&dyn Fn(usize) -> f32; 3] =
            [&|_| 1.0, &|k| ((k * 37) % 101) as f32 - 50.0, &|k| if k % 500 < 3 { 9.0 } else { 0.01 }];
        for shape in shapes {
            let evidence = Evidence { of_cells: (0..6000).map(|k| [[shape(k); 3]; WAYS]).collect() };
            let of = |k: u8| evidence.scores(&weave, &WeavingSecret::new([k; 32])).concat();
            let all: Vec<f64> = (0..=255).flat_map(of).collect();
            // Three ways of the same weights are one score: 512 of them, whose mean square has a deviation of 0.0625.
            let square = all.iter().map(|z| z * z).sum::<f64>() / all.len() as f64;
            assert!((square - 1.0).abs() < 0.25, "{square}");
            assert!(all.iter().all(|z| *z < threshold(all.len(), 1e-3)));
        }
    }

    #[test]
    fn what_a_distortion_makes_of_the_render_is_regressed_out() {
        let side = 120;
        let at = |i: usize| {
            let (x, y) = ((i % side) as f32, (i / side) as f32);
            let wave = (x * 0.9).sin() * (y * 0.7).cos() + 0.5 * (x * 0.31 + y * 0.43).sin();
            [0.5 + 0.2 * wave, 0.45 + 0.15 * wave, 0.4 + 0.1 * wave * wave]
        };
        let rgb: Vec<f32> = (0..side * side).flat_map(at).collect();
        let render = Picture::new(side, side, rgb).unwrap();
        let soft = Blur::new(0.8).apply(render.rgb(), [side, side]);
        let soft = Picture::new(side, side, soft).unwrap();
        let difference = Planes::of(&soft).less(&Planes::of(&render));
        let before: f32 = sum(&bands(&difference)).iter().map(|v| v * v).sum();
        let left = Left::of(difference, &render);
        let after: f32 = left.planes.values.iter().map(|v| v * v).sum();
        assert!(after < 0.05 * before, "{after} of {before}");
        assert!(left.survived[0][0] < 0.7, "{:?}", left.survived);
        let same = Left::of(Planes::of(&render).less(&Planes::of(&render)), &render);
        assert_eq!(same.survived, [[1.0; 3]; 3]);
    }
}
