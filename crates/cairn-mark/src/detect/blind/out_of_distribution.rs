//! Whether a picture looks like what a class was learnt from.
//!
//! A classifier has to answer, and on pictures unlike any it has seen (another place's
//! photographs, strokes of strong colour) it answers with the nearest class, as surely as on
//! a marked render. What it works its answer out from does say that it is lost: such
//! pictures lie far from wherever a class's renders lie. That is measured by the distance to the
//! nearest of some renders, as they are and after what happens to pictures (deep
//! nearest neighbours: Sun et al. 2022, arXiv 2204.06507), in units of each feature's
//! spread over renders that nothing happened to. One Gaussian for all renders was tried first (Lee
//! et al. 2018): wide enough for a rotated render, it took in other places' photographs.

use crate::error::MarkError;
use crate::marked::stored;
use safetensors::tensor::SafeTensors;

/// Added to each feature's variance, in mean variances: one that never moved has a spread too.
const FLOOR: f64 = 1e-6;
/// Share of a class's own renders that lie nearer to those of other views than its reach, and of its unseen ones that
/// lie nearer to any.
const REACHED: f64 = 0.95;
/// How sharply trust falls about the limit: at four fifths of it, the reach by default, it is
/// 0.86, at a half 0.996, at one and a half 0.04.
const SHARPNESS: i32 = 8;

/// A marked render's features.
#[derive(Clone, Debug)]
pub(crate) struct RenderFeatures {
    /// The view it is of.
    pub(crate) view: usize,
    /// Whether something happened to it.
    pub(crate) distorted: bool,
    /// Whether it is of a view that no step saw.
    pub(crate) unseen: bool,
    pub(crate) features: Vec<f32>,
}

/// Where each class's renders lie.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct OutOfDistribution {
    /// Each feature's spread.
    spreads: Vec<f32>,
    /// Each class's renders, in units of the spreads.
    renders: Vec<Vec<f32>>,
    /// Distance at which each class is trusted half, M.
    limits: Vec<f32>,
}

impl OutOfDistribution {
    /// From each class's renders; limits are `beyond` times a class's reach. `None` where a class has fewer than
    /// two, all of its renders are the same, or a number is not finite.
    pub(crate) fn fit(classes: &[Vec<RenderFeatures>], beyond: f64) -> Option<Self> {
        let features = classes.first()?.first()?.features.len();
        let mut variances = vec![0.0f64; features];
        let count = classes.iter().flatten().filter(|r| !r.distorted).count() as f64;
        for class in classes {
            let plain: Vec<&[f32]> = class.iter().filter(|r| !r.distorted).map(|r| r.features.as_slice()).collect();
            for (f, variance) in variances.iter_mut().enumerate() {
                let mean = plain.iter().map(|r| f64::from(r[f])).sum::<f64>() / plain.len() as f64;
                *variance += plain.iter().map(|r| (f64::from(r[f]) - mean).powi(2)).sum::<f64>() / count;
            }
        }
        let floor = FLOOR * variances.iter().sum::<f64>() / features as f64;
        let mut fitted = Self {
            spreads: variances.iter().map(|v| (v + floor).sqrt() as f32).collect(),
            renders: Vec::with_capacity(classes.len()),
            limits: Vec::with_capacity(classes.len()),
        };
        for class in classes {
            let all: Vec<Vec<f32>> = class.iter().map(|r| fitted.scaled(&r.features)).collect();
            // Of another view, where there is one: a new one has no unmarked pair among them. Networks know the views that they
            // were trained on better than those between, so that unseen ones are measured from the others.
            let trained: Vec<usize> = (0..class.len()).filter(|at| !class[*at].unseen).collect();
            let one_view = trained.iter().all(|at| class[*at].view == class[trained[0]].view);
            let counts = |at: usize, other: usize| {
                let another = if one_view { other != at } else { class[other].view != class[at].view };
                !class[other].unseen && (class[at].unseen || another)
            };
            let nearest = |at: usize| {
                let others = (0..all.len()).filter(|other| counts(at, *other));
                others.map(|other| apart(&all[other], &all[at])).fold(f64::INFINITY, f64::min)
            };
            let reach = |of: Vec<usize>| {
                let mut apart: Vec<f64> = of.into_iter().map(nearest).collect();
                apart.sort_by(f64::total_cmp);
                apart.get(((apart.len() as f64 * REACHED) as usize).min(apart.len().checked_sub(1)?)).copied()
            };
            let unseen = reach((0..class.len()).filter(|at| class[*at].unseen).collect());
            let reach = reach(trained.clone())?.max(unseen.unwrap_or(0.0));
            fitted.limits.push((beyond * reach) as f32);
            fitted.renders.push(all.concat());
        }
        fitted.is_sound().then_some(fitted)
    }

    fn scaled(&self, picture: &[f32]) -> Vec<f32> {
        picture.iter().zip(&self.spreads).map(|(v, spread)| v / spread).collect()
    }

    /// How far a picture lies from the nearest render of class `class` (from 0), root mean square over the features, in spreads.
    fn distance(&self, class: usize, picture: &[f32]) -> f64 {
        let picture = self.scaled(picture);
        let renders = self.renders[class].chunks_exact(self.spreads.len());
        renders.map(|render| apart(render, &picture)).fold(f64::INFINITY, f64::min)
    }

    /// Class probabilities (M + 1) of a picture with these features, those of owners less what is
    /// doubted of them, which is `unmarked`'s.
    pub(crate) fn doubt(&self, probabilities: &mut [f32], picture: &[f32]) {
        for class in 0..self.limits.len() {
            let beyond = self.distance(class, picture) / f64::from(self.limits[class]);
            // Not a number where a picture's features are infinite: then nothing is trusted.
            let trusted = 1.0 / (1.0 + beyond.powi(SHARPNESS));
            let trusted = if trusted.is_finite() { trusted as f32 } else { 0.0 };
            let doubted = probabilities[class + 1] * (1.0 - trusted);
            probabilities[class + 1] -= doubted;
            probabilities[0] += doubted;
        }
    }

    fn is_sound(&self) -> bool {
        let mut numbers = self.renders.iter().flatten().chain(&self.limits).chain(&self.spreads);
        let positive = self.limits.iter().chain(&self.spreads).all(|v| *v > 0.0);
        positive && numbers.all(|v| v.is_finite()) && self.renders.iter().all(|renders| !renders.is_empty())
    }

    /// Named parts for a file, f32 little-endian.
    pub(crate) fn parts(&self) -> Vec<(String, Vec<u8>)> {
        let bytes = |v: &[f32]| v.iter().flat_map(|v| v.to_le_bytes()).collect();
        let mut parts = vec![(SPREADS.into(), bytes(&self.spreads)), (LIMITS.into(), bytes(&self.limits))];
        parts.extend((1..).zip(&self.renders).map(|(class, renders)| (renders_of(class), bytes(renders))));
        parts
    }

    /// Reads back what [`OutOfDistribution::parts`] gave, for `classes` = M + 1 classes; `None` where there is nothing.
    ///
    /// # Errors
    /// [`MarkError::Stored`] for sizes that do not fit, and numbers that no fit makes.
    pub(crate) fn from_file(
        file: &SafeTensors<'_>,
        classes: usize,
        features: usize,
    ) -> Result<Option<Self>, MarkError> {
        if !file.names().contains(&LIMITS) {
            return Ok(None);
        }
        let part = |name: &str, each: usize, some: bool| {
            let tensor = file.tensor(name).map_err(|e| stored("detector", format!("`{name}`: {e}")))?;
            let (got, size) = (tensor.data().len(), each * 4);
            if if some { !got.is_multiple_of(size) } else { got != size } {
                return Err(stored("detector", format!("`{name}` has {got} bytes, which are not {each} numbers each")));
            }
            Ok(tensor.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
        };
        let read = Self {
            spreads: part(SPREADS, features, false)?,
            limits: part(LIMITS, classes - 1, false)?,
            renders: (1..classes).map(|class| part(&renders_of(class), features, true)).collect::<Result<_, _>>()?,
        };
        match read.is_sound() {
            true => Ok(Some(read)),
            false => Err(stored("detector", "`out_of_distribution` holds numbers that no training makes".into())),
        }
    }
}

const SPREADS: &str = "out_of_distribution.spreads";
const LIMITS: &str = "out_of_distribution.limits";

fn renders_of(class: usize) -> String {
    format!("out_of_distribution.renders{class}")
}

/// Root mean square of the difference.
fn apart(a: &[f32], b: &[f32]) -> f64 {
    let square: f64 = a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum();
    (square / a.len() as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attack::Gaussian;

    fn plain(features: &[&[f32]]) -> Vec<RenderFeatures> {
        let shown = |(view, f): (usize, &&[f32])| RenderFeatures {
            view,
            distorted: false,
            unseen: false,
            features: f.to_vec(),
        };
        features.iter().enumerate().map(shown).collect()
    }

    /// Two classes of renders with four features, distorted ones elsewhere in one of them.
    fn renders() -> Vec<Vec<RenderFeatures>> {
        let mut noise = Gaussian::new(3);
        let mut one = |middle: f32, view: usize| {
            let ([a, b, c], distorted) = ([noise.draw(), noise.draw(), noise.draw()], view % 2 == 1);
            let shift = if distorted { 4.0 } else { 0.0 };
            RenderFeatures {
                view,
                distorted,
                unseen: false,
                features: vec![middle + a, shift + 0.1 * b, 5.0 + 0.01 * c, middle - b],
            }
        };
        [0.0, 3.0].map(|middle| (0..400).map(|view| one(middle, view)).collect()).to_vec()
    }

    #[test]
    fn what_lies_where_a_class_lies_is_trusted_and_what_lies_elsewhere_is_unmarked() {
        let classes = renders();
        let known = OutOfDistribution::fit(&classes, 1.25).unwrap();
        let trusted = |class: usize, picture: &[f32]| {
            let mut p = [0.1, 0.0, 0.0];
            p[class + 1] = 0.9;
            known.doubt(&mut p, picture);
            assert!((p.iter().sum::<f32>() - 1.0).abs() < 1e-6, "{p:?}");
            p[class + 1] / 0.9
        };
        for (class, renders) in classes.iter().enumerate() {
            for render in renders {
                assert!(trusted(class, &render.features) > 0.99);
            }
        }
        // Like others of the class, but none that it was fitted to.
        assert!(trusted(0, &[0.2, 0.03, 5.003, -0.1]) > 0.9 && trusted(1, &[2.9, 4.02, 5.001, 3.2]) > 0.9);
        // The second feature is there without harm or with it, not between; the third never moves; far out is far out.
        for stranger in
            [[0.0, 2.0, 5.0, 0.0], [0.0, 0.0, 6.0, 0.0], [40.0, 0.0, 5.0, 0.0], [f32::INFINITY, 0.0, 5.0, 0.0]]
        {
            assert!(trusted(0, &stranger) < 0.01, "{stranger:?}: {}", trusted(0, &stranger));
        }
    }

    #[test]
    fn distances_are_in_spreads_from_the_nearest_render() {
        // Variances 2 and 0.5 about (1, 2).
        let ring = plain(&[&[3.0, 2.0], &[-1.0, 2.0], &[1.0, 3.0], &[1.0, 1.0]]);
        let known = OutOfDistribution::fit(std::slice::from_ref(&ring), 1.0).unwrap();
        let expected = |dx: f64, dy: f64| ((dx * dx / 2.0 + dy * dy / 0.5) / 2.0).sqrt();
        assert!((known.distance(0, &[3.0, 2.5]) - expected(0.0, 0.5)).abs() < 1e-4);
        assert!((known.distance(0, &[-3.0, 2.0]) - expected(2.0, 0.0)).abs() < 1e-4);
        // From each corner to the next: the reach.
        assert!((f64::from(known.limits[0]) - expected(2.0, 1.0)).abs() < 1e-4);
    }

    #[test]
    fn what_cannot_be_fitted_is_not() {
        assert!(OutOfDistribution::fit(&[], 1.25).is_none());
        assert!(OutOfDistribution::fit(&[plain(&[&[1.0, 2.0], &[2.0, 1.0]]), Vec::new()], 1.25).is_none());
        assert!(OutOfDistribution::fit(&[plain(&[&[1.0, 2.0]])], 1.25).is_none());
        assert!(OutOfDistribution::fit(&[plain(&[&[1.0, f32::NAN], &[2.0, 1.0]])], 1.25).is_none());
        // Renders that are all the same have no spread to measure by.
        assert!(OutOfDistribution::fit(&[plain(&[&[1.0, 2.0][..]; 5])], 1.25).is_none());
    }

    #[test]
    fn views_that_no_step_saw_say_how_far_such_lie() {
        let square = plain(&[&[0.0, 0.0], &[0.0, 1.0], &[1.0, 0.0], &[1.0, 1.0]]);
        // Numbers of unseen views are not those of the others: this one is not the third's.
        let unseen = |features: [f32; 2]| RenderFeatures {
            view: 2,
            distorted: false,
            unseen: true,
            features: features.to_vec(),
        };
        // Where the limit lies and how far `to` is from `from`, in the same spreads.
        let measured = |more: &[[f32; 2]], from: [f32; 2], to: [f32; 2]| {
            let class: Vec<RenderFeatures> = square.iter().cloned().chain(more.iter().copied().map(unseen)).collect();
            let known = OutOfDistribution::fit(&[class], 1.0).unwrap();
            assert!(known.distance(0, &to) < 1e-6, "{to:?} is among the renders");
            (f64::from(known.limits[0]), apart(&known.scaled(&from), &known.scaled(&to)))
        };
        let same = |(limit, distance): (f64, f64)| assert!((limit - distance).abs() < 1e-4, "{limit} for {distance}");
        // From each corner to the next, also where a unseen one lies nearer.
        same(measured(&[], [0.0, 0.0], [0.0, 1.0]));
        same(measured(&[[0.9, 0.1]], [0.0, 0.0], [0.0, 1.0]));
        // Two that lie together lie far from what was trained on all the same.
        same(measured(&[[4.0, 0.0], [4.0, 0.1]], [1.0, 0.0], [4.0, 0.1]));
    }

    #[test]
    fn a_class_of_one_view_is_measured_by_itself() {
        let mut one = plain(&[&[1.0, 2.0], &[2.0, 1.0], &[1.5, 1.0]]);
        let apart = |renders: &[RenderFeatures]| OutOfDistribution::fit(&[renders.to_vec()], 1.0).unwrap().limits[0];
        let views = apart(&one);
        one.iter_mut().for_each(|r| r.view = 0);
        assert_eq!(apart(&one), views);
        // Of two views, the nearest of the same does not count.
        one[0].view = 1;
        assert!(apart(&one) > views);
    }
}
