//! Informed detection: a mark is read by registration of the picture with the field. The classifier has the
//! picture alone, and must tell a mark of half a grey level from whatever else a picture may show. The field
//! knows more. Once it is known from where the picture was taken ([`Registrar`]), the field's render without a mark is
//! subtracted, and the residual is compared with what each identity's mark would add. That is detection of a known signal by
//! correlation (Cox, Kilian, Leighton and Shamoon 1997; detection with the original at hand is
//! *informed*, chapter 2 of Cox et al., Digital Watermarking and Steganography, 2008): a quarter of a
//! million pixels together tell what no one of them shows.
//!
//! How sure it is follows from the picture itself. The correlation is summed over small blocks; where there is no
//! mark their sums are as often above zero as below, whatever the residual is like, and the
//! self-normalised sum of all (Student's t without its mean) is a standard normal number to a good
//! approximation (de la Pena, Lai and Shao 2009). So one limit holds for every scene and picture, and
//! nothing is learnt.

use super::opponent::{opponent, size_of};
use crate::attack::Blur;
use crate::marked::MarkedField;
use crate::stega::recipe::{CarrierKind, DensityKind};
use cairn_field::Appearance;
use cairn_register::{Index, NotLocated, Registered, Registrar};
use cairn_scene::{Camera, Picture};
use std::sync::Arc;
use thiserror::Error;

/// From here on a mark is believed. A standard normal number does not come so far; renders without a mark that were
/// registered a little amiss have come to 4.8. No number of blocks can come beyond its own root, so that a picture needs 64.
pub const BELIEVED: f64 = 8.0;
/// Side of a block, px.
const BLOCK: usize = 8;
/// What is finer than this is compared, standard deviation, px.
const FINE_PX: f32 = 2.0;
/// How far around a pixel its residual's size is looked at, standard deviation, px.
const AROUND_PX: f32 = 3.0;
/// Mean square of what eight bits leave of a number, colours in [0, 1].
const ROUNDING: f32 = 1.0 / (12.0 * 255.0 * 255.0);

/// Reads pictures against one marked field.
#[derive(Debug)]
pub struct RegisteredReader {
    registrar: Registrar,
}

/// Why a picture was not registered with the field.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum NotRegistered {
    /// The camera was known, and the field is unlike the picture there.
    #[error("no light makes the field look like the picture from the camera that was given")]
    Unlike,
    /// The camera was not known, and not found.
    #[error(transparent)]
    NotLocated(#[from] NotLocated),
}

/// What registration of a picture with the field says.
#[derive(Clone, Debug)]
pub struct RegisteredReading {
    /// Where the picture was taken, and in which light.
    pub registered: Registered,
    /// How far each identity's mark stands out, identity 1 first, in standard deviations of what it
    /// would be without a mark.
    pub scores: Vec<f64>,
}

impl RegisteredReading {
    /// The identity whose mark is believed, from 1 on; `None` where none stands out.
    pub fn identity(&self) -> Option<u32> {
        let best = (0..self.scores.len()).max_by(|a, b| self.scores[*a].total_cmp(&self.scores[*b]))?;
        (self.scores[best] >= BELIEVED).then_some(best as u32 + 1)
    }

    /// Probabilities of `unmarked` and of each identity, if a mark is as likely as none and one as likely as another: by the
    /// likelihood of the largest score, which is normal about 0 without a mark and about twice the limit with one.
    pub fn probabilities(&self) -> Vec<f32> {
        let logits: Vec<f64> = std::iter::once(0.0)
            .chain(self.scores.iter().map(|z| (2.0 * BELIEVED * (z - BELIEVED)).clamp(-300.0, 300.0)))
            .collect();
        let most = logits.iter().copied().fold(0.0, f64::max);
        let odds: Vec<f64> = logits.iter().map(|l| (l - most).exp()).collect();
        let all: f64 = odds.iter().sum();
        odds.iter().map(|o| (o / all) as f32).collect()
    }
}

impl RegisteredReader {
    /// Whether there is enough to see in a picture of so many pixels for a mark to be believed: of some 64 x 64 px on.
    pub fn can_tell(width: usize, height: usize) -> bool {
        (width.div_ceil(BLOCK) * height.div_ceil(BLOCK)) as f64 >= BELIEVED * BELIEVED
    }

    /// Prepares to read against `marked`; without the `index` of its places pictures whose cameras are known alone. `None`
    /// where densities moved with the mark, so that it is no change of colours.
    pub fn new(marked: &MarkedField, index: Option<Arc<Index>>) -> Option<Self> {
        if marked.density_kind() == DensityKind::Free {
            return None;
        }
        Some(Self { registrar: Registrar::new(marked.base().clone(), index) })
    }

    /// Registers `picture` with the field and looks for each identity's mark of `marked`, the field that it was made for. `from`
    /// is the camera that it was rendered with, where that is known; otherwise it is looked for, for as long as
    /// `wanted` says so.
    ///
    /// # Errors
    /// [`NotRegistered`], with the reason.
    pub fn read(
        &self,
        marked: &MarkedField,
        picture: &Picture,
        from: Option<&Camera>,
        wanted: &dyn Fn() -> bool,
    ) -> Result<RegisteredReading, NotRegistered> {
        let registered = match from {
            Some(camera) => self.registrar.register_at(picture, camera).ok_or(NotRegistered::Unlike)?,
            None => self.registrar.locate(picture, wanted)?.registered,
        };
        let identities = marked.clusters().clusters.len() as u32;
        let (camera, light) = (&registered.camera, &registered.appearance);
        let base = marked.base().render(camera, light).clamped();
        let left = Left::of(&registered.picture, &base);
        let of = |identity: u32| left.score(added(marked, camera, light, identity, &base));
        let scores = match marked.carrier_kind() {
            CarrierKind::PerCluster => (1..=identities).map(of).collect(),
            // One mark for all: whose it is, the pose says.
            CarrierKind::Harmonics => {
                let owner = marked.clusters().identity_of(&camera.pose).identity;
                (1..=identities).map(|i| if owner == Some(i) { of(i) } else { 0.0 }).collect()
            }
        };
        Ok(RegisteredReading { registered, scores })
    }
}

/// What the mark of `identity` adds to the base render: fine detail in opponent colours.
fn added(marked: &MarkedField, camera: &Camera, light: &Appearance, identity: u32, base: &Picture) -> Vec<f32> {
    fine(&difference(&marked.render_as(camera, light, Some(identity)).clamped(), base), size_of(base))
}

/// What a picture has that the base render has not, and how far each number of it is to be trusted.
struct Left {
    size: [usize; 2],
    fine: Vec<f32>,
    trust: Vec<f32>,
    /// What harm leaves of the base render itself ([`remains`]), orthogonal to one another under `trust`.
    remains: Vec<Vec<f32>>,
}

impl Left {
    fn of(picture: &Picture, base: &Picture) -> Self {
        let size = size_of(picture);
        let fine = fine(&difference(picture, base), size);
        let squares: Vec<f32> = fine.iter().map(|v| v * v).collect();
        let mut trust = Blur::new(AROUND_PX).apply(&squares, size);
        trust.iter_mut().for_each(|v| *v = 1.0 / (*v + ROUNDING));
        let mut left = Self { size, fine, trust, remains: Vec::new() };
        for mut other in remains(base) {
            left.clear_of_remains(&mut other);
            left.remains.push(other);
        }
        left
    }

    /// Takes from `other` what the remains explain of it.
    fn clear_of_remains(&self, other: &mut [f32]) {
        for known in &self.remains {
            let (mut both, mut own) = (0.0f64, 0.0f64);
            for ((k, o), t) in known.iter().zip(other.iter()).zip(&self.trust) {
                both += f64::from(t * k * o);
                own += f64::from(t * k * k);
            }
            if own > 0.0 {
                let share = (both / own) as f32;
                other.iter_mut().zip(known).for_each(|(o, k)| *o -= share * k);
            }
        }
    }

    /// How far `mark` stands out: of it counts what no harm to the base render would look like.
    fn score(&self, mut mark: Vec<f32>) -> f64 {
        self.clear_of_remains(&mut mark);
        let [w, h] = self.size;
        let across = w.div_ceil(BLOCK);
        let mut sums = vec![0.0f64; across * h.div_ceil(BLOCK)];
        for (i, ((left, trust), mark)) in self.fine.iter().zip(&self.trust).zip(mark).enumerate() {
            let (x, y) = (i / 3 % w, i / 3 / w);
            sums[y / BLOCK * across + x / BLOCK] += f64::from(left * trust * mark);
        }
        let squares: f64 = sums.iter().map(|s| s * s).sum();
        if squares > 0.0 { sums.iter().sum::<f64>() / squares.sqrt() } else { 0.0 }
    }
}

/// What is left of a base render where it was softened or laid on a little beside: its fine detail, its
/// detail finer still, and its slopes across and down, each of the three colours by itself.
fn remains(base: &Picture) -> Vec<Vec<f32>> {
    let size @ [w, h] = size_of(base);
    let whole: Vec<f32> = base.rgb().chunks_exact(3).flat_map(opponent).collect();
    let detail = fine(&whole, size);
    let finer: Vec<f32> = detail.iter().zip(Blur::new(0.7).apply(&detail, size)).map(|(v, soft)| v - soft).collect();
    let slope = |by: usize, is_last: &dyn Fn(usize) -> bool| -> Vec<f32> {
        let of = |i: usize| if is_last(i / 3) { 0.0 } else { whole[i + 3 * by] - whole[i] };
        (0..whole.len()).map(of).collect()
    };
    let (across, down) = (slope(1, &|at| at % w + 1 == w), slope(w, &|at| at / w + 1 == h));
    [detail, finer, across, down].iter().flat_map(|all| [0, 1, 2].map(|c| of_colour(all, c))).collect()
}

/// The numbers of one colour; the others' are 0.
fn of_colour(all: &[f32], c: usize) -> Vec<f32> {
    all.iter().enumerate().map(|(i, v)| if i % 3 == c { *v } else { 0.0 }).collect()
}

/// `a - b` in opponent colours.
fn difference(a: &Picture, b: &Picture) -> Vec<f32> {
    let pairs = a.rgb().chunks_exact(3).zip(b.rgb().chunks_exact(3));
    pairs.flat_map(|(a, b)| opponent(&[a[0] - b[0], a[1] - b[1], a[2] - b[2]])).collect()
}

/// Three numbers a pixel, less their own blur.
fn fine(of: &[f32], size: [usize; 2]) -> Vec<f32> {
    of.iter().zip(Blur::new(FINE_PX).apply(of, size)).map(|(v, coarse)| v - coarse).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attack::Gaussian;

    const SIDE: usize = 96;

    /// A smooth render with some edges, and a mark of `strength` (RMS) in one hue.
    fn base_and_mark(strength: f32, seed: u64) -> (Picture, Vec<f32>) {
        let at = |i: usize| {
            let (x, y) = ((i % SIDE) as f32 / SIDE as f32, (i / SIDE) as f32 / SIDE as f32);
            let edge = if (x * 5.0) as usize % 2 == (y * 3.0) as usize % 2 { 0.2 } else { 0.0 };
            [0.3 + 0.4 * x + edge, 0.4 + 0.2 * y + edge, 0.5 - 0.2 * x]
        };
        let rgb = (0..SIDE * SIDE).flat_map(at).collect();
        let mut noise = Gaussian::new(seed);
        let mark = (0..SIDE * SIDE).flat_map(|_| [1.0, -1.0, 0.0].map(|hue| hue * strength)).collect::<Vec<f32>>();
        let mark = mark
            .chunks_exact(3)
            .flat_map(|rgb| {
                let by = noise.draw();
                [rgb[0] * by, rgb[1] * by, 0.0]
            })
            .collect();
        (Picture::new(SIDE, SIDE, rgb).unwrap(), mark)
    }

    fn with(picture: &Picture, mark: &[f32]) -> Picture {
        let rgb = picture.rgb().iter().zip(mark).map(|(v, m)| v + m).collect();
        Picture::new(SIDE, SIDE, rgb).unwrap().clamped()
    }

    fn eight_bits(picture: &Picture) -> Picture {
        Picture::from_rgb8(SIDE, SIDE, &picture.to_rgb8()).unwrap()
    }

    /// How far `mark` stands out of `picture`.
    fn score(picture: &Picture, base: &Picture, mark: &[f32]) -> f64 {
        Left::of(picture, base).score(fine(&difference(&with(base, mark), base), [SIDE; 2]))
    }

    #[test]
    fn a_mark_of_half_a_grey_level_stands_out_and_another_does_not() {
        let (base, mark) = base_and_mark(0.5 / 255.0, 1);
        let (_, other) = base_and_mark(0.5 / 255.0, 2);
        let marked = eight_bits(&with(&base, &mark));
        assert!(score(&marked, &base, &mark) > BELIEVED, "{}", score(&marked, &base, &mark));
        assert!(score(&marked, &base, &other).abs() < 4.0);
        assert!(score(&eight_bits(&base), &base, &mark).abs() < 4.0);
    }

    #[test]
    fn without_a_mark_scores_are_normal_numbers_whatever_is_left() {
        // Noise of ten grey levels, of other strength here than there.
        let (base, mark) = base_and_mark(1.0 / 255.0, 3);
        let mut scores = Vec::new();
        for seed in 0..60 {
            let mut noise = Gaussian::new(100 + seed);
            let rough = |i: usize| if i % (SIDE * 3) < SIDE { 0.08 } else { 0.01 };
            let rgb = base.rgb().iter().enumerate().map(|(i, v)| v + rough(i) * noise.draw()).collect();
            scores.push(score(&Picture::new(SIDE, SIDE, rgb).unwrap(), &base, &mark));
        }
        let square = scores.iter().map(|z| z * z).sum::<f64>() / 60.0;
        assert!((0.6..1.6).contains(&square), "mean square {square}");
        assert!(scores.iter().all(|z| z.abs() < 4.0), "{scores:?}");
    }

    #[test]
    fn a_softened_or_displaced_render_is_no_mark() {
        // A mark that looks like the render's own detail, in part.
        let (base, noise) = base_and_mark(1.0 / 255.0, 5);
        let detail = fine(base.rgb(), [SIDE; 2]);
        let mark: Vec<f32> = detail.iter().zip(&noise).map(|(d, n)| 0.05 * d + n).collect();
        let soft = Picture::new(SIDE, SIDE, Blur::new(0.8).apply(base.rgb(), [SIDE; 2])).unwrap();
        let beside = (0..SIDE * SIDE).flat_map(|i| base.pixel((i % SIDE + 1).min(SIDE - 1), i / SIDE)).collect();
        let beside = with(&base, &vec![0.0; SIDE * SIDE * 3])
            .rgb()
            .iter()
            .zip::<Vec<f32>>(beside)
            .map(|(a, b)| 0.8 * a + 0.2 * b)
            .collect();
        for harmed in [soft, Picture::new(SIDE, SIDE, beside).unwrap()] {
            let z = score(&eight_bits(&harmed), &base, &mark);
            assert!(z.abs() < BELIEVED, "{z}");
        }
    }

    #[test]
    fn answers_and_odds_follow_the_largest_score() {
        let camera = Camera {
            intrinsics: cairn_scene::Intrinsics {
                width: 1,
                height: 1,
                fx: 1.0,
                fy: 1.0,
                cx: 0.5,
                cy: 0.5,
                distortion: cairn_scene::Distortion::default(),
            },
            pose: cairn_scene::Pose::look_at(glam::DVec3::X, glam::DVec3::ZERO, glam::DVec3::Z).unwrap(),
        };
        let of = |scores: &[f64]| RegisteredReading {
            registered: Registered {
                camera,
                appearance: Appearance::neutral([0.0; 3]),
                picture: Picture::constant(1, 1, [0.0; 3]),
                explained: 0.9,
            },
            scores: scores.to_vec(),
        };
        assert_eq!(of(&[1.0, 14.0, -2.0]).identity(), Some(2));
        assert!(of(&[1.0, 14.0, -2.0]).probabilities()[2] > 0.999);
        assert_eq!(of(&[1.0, 7.9]).identity(), None);
        let odds = of(&[1.0, 7.9]).probabilities();
        assert!((odds.iter().sum::<f32>() - 1.0).abs() < 1e-6 && odds[0] > 0.5, "{odds:?}");
        // Sure of nobody, and no overflow far out.
        assert!(of(&[-40.0, 0.0]).probabilities()[0] > 0.999);
        assert!(of(&[1e6, 1e5]).probabilities().iter().all(|p| p.is_finite()));
    }
}
