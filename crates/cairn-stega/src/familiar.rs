//! Whether a picture looks like what a class was learnt from.
//!
//! A classifier has to answer, and on pictures unlike any it has seen (another place's
//! photographs, strokes of strong colour) it answers with the nearest class, as surely as on
//! a marked render. What it works its answer out from does say that it is lost: such
//! pictures lie far from where a class's renders lie. That is measured by the Mahalanobis
//! distance in the classifier's features, with one covariance for all classes (Lee et al.
//! 2018, arXiv 1807.03888), shrunk half way to its diagonal, because a few hundred renders
//! say little about a hundred features' covariances.

use crate::error::MarkError;
use crate::marked::stored;
use safetensors::tensor::SafeTensors;

/// Share of the covariance that its diagonal makes up.
const SHRINKAGE: f64 = 0.5;
/// Added to each variance, in mean variances: a feature that never moved has one too.
const FLOOR: f64 = 1e-6;
/// How sharply trust falls about the limit: at two thirds of it, where the furthest render of
/// training lies by default, it is 0.96, at one and a half of it 0.04.
const SHARPNESS: i32 = 8;

/// Where each class's renders lie.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Familiar {
    /// Features of a picture.
    features: usize,
    /// The middle of each class's renders, M x features.
    means: Vec<f32>,
    /// Lower triangle of the covariance's Cholesky factor, row after row, features x features.
    factor: Vec<f32>,
    /// Distance at which each class is trusted half, M.
    limits: Vec<f32>,
}

impl Familiar {
    /// From each class's renders' features; limits are `beyond` times the furthest render's
    /// distance. `None` where a class has none, or a number is not finite.
    pub(crate) fn fit(classes: &[Vec<Vec<f32>>], beyond: f64) -> Option<Self> {
        let features = classes.first()?.first()?.len();
        let mut means = Vec::with_capacity(classes.len() * features);
        for renders in classes {
            let count = (!renders.is_empty()).then_some(renders.len() as f64)?;
            means.extend((0..features).map(|f| (renders.iter().map(|r| f64::from(r[f])).sum::<f64>() / count) as f32));
        }
        let mut covariance = vec![0.0f64; features * features];
        let count = classes.iter().map(Vec::len).sum::<usize>().max(2) as f64;
        for (renders, mean) in classes.iter().zip(means.chunks_exact(features)) {
            for render in renders {
                let apart: Vec<f64> = render.iter().zip(mean).map(|(r, m)| f64::from(*r) - f64::from(*m)).collect();
                for (row, a) in covariance.chunks_exact_mut(features).zip(&apart) {
                    row.iter_mut().zip(&apart).for_each(|(c, b)| *c += a * b / (count - 1.0));
                }
            }
        }
        let mean_variance = (0..features).map(|f| covariance[f * features + f]).sum::<f64>() / features as f64;
        for (at, c) in covariance.iter_mut().enumerate() {
            let diagonal = at / features == at % features;
            *c = if diagonal { *c + FLOOR * mean_variance.max(f64::MIN_POSITIVE) } else { *c * (1.0 - SHRINKAGE) };
        }
        let factor = cholesky(covariance, features)?;
        let mut fitted = Self { features, means, factor, limits: vec![1.0; classes.len()] };
        for (class, renders) in classes.iter().enumerate() {
            let furthest = renders.iter().map(|r| fitted.distance(class, r)).fold(0.0f64, f64::max);
            fitted.limits[class] = (beyond * furthest) as f32;
        }
        fitted.is_sound().then_some(fitted)
    }

    /// Mahalanobis distance of a picture from class `class` (from 0), over the root of the number of features:
    /// about 1 for a render like those that it was fitted to.
    fn distance(&self, class: usize, picture: &[f32]) -> f64 {
        let mean = &self.means[class * self.features..];
        let mut solved = Vec::<f64>::with_capacity(self.features);
        // Forward substitution: the distance's square is that of the solution.
        for (i, row) in self.factor.chunks_exact(self.features).enumerate() {
            let known: f64 = row[..i].iter().zip(&solved).map(|(l, y)| f64::from(*l) * y).sum();
            solved.push((f64::from(picture[i]) - f64::from(mean[i]) - known) / f64::from(row[i]));
        }
        (solved.iter().map(|y| y * y).sum::<f64>() / self.features as f64).sqrt()
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
        let finite = [&self.means, &self.factor, &self.limits].iter().all(|v| v.iter().all(|v| v.is_finite()));
        let positive = self.limits.iter().all(|l| *l > 0.0)
            && (0..self.features).all(|i| self.factor[i * self.features + i] > 0.0);
        finite && positive
    }

    /// Named parts for a file, f32 little-endian.
    pub(crate) fn parts(&self) -> [(&'static str, Vec<u8>); 3] {
        let bytes = |v: &[f32]| v.iter().flat_map(|v| v.to_le_bytes()).collect();
        [
            ("familiar.means", bytes(&self.means)),
            ("familiar.factor", bytes(&self.factor)),
            ("familiar.limits", bytes(&self.limits)),
        ]
    }

    /// Reads back what [`Familiar::parts`] gave, for `classes` = M + 1 classes; `None` where there is nothing.
    ///
    /// # Errors
    /// [`MarkError::Stored`] for sizes that do not fit, and numbers that no fit makes.
    pub(crate) fn from_file(
        file: &SafeTensors<'_>,
        classes: usize,
        features: usize,
    ) -> Result<Option<Self>, MarkError> {
        let part = |name: &str, len: usize| {
            let tensor = file.tensor(name).map_err(|e| stored("detector", format!("`{name}`: {e}")))?;
            if tensor.data().len() != len * 4 {
                let got = tensor.data().len();
                return Err(stored("detector", format!("`{name}` has {got} bytes, {len} numbers take {}", len * 4)));
            }
            Ok(tensor.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
        };
        if !file.names().iter().any(|name| name.starts_with("familiar.")) {
            return Ok(None);
        }
        let owners = classes - 1;
        let read = Self {
            features,
            means: part("familiar.means", owners * features)?,
            factor: part("familiar.factor", features * features)?,
            limits: part("familiar.limits", owners)?,
        };
        match read.is_sound() {
            true => Ok(Some(read)),
            false => Err(stored("detector", "`familiar` holds numbers that no training makes".into())),
        }
    }
}

/// The lower triangle L of A = L L^T, row after row, in place of A's; `None` where A, n x n, is not positive definite.
fn cholesky(mut a: Vec<f64>, n: usize) -> Option<Vec<f32>> {
    for i in 0..n {
        for j in 0..=i {
            let known: f64 = (0..j).map(|k| a[i * n + k] * a[j * n + k]).sum();
            let rest = a[i * n + j] - known;
            a[i * n + j] = match i == j {
                true if rest > 0.0 => rest.sqrt(),
                true => return None,
                false => rest / a[j * n + j],
            };
        }
        a[i * n + i + 1..(i + 1) * n].fill(0.0);
    }
    Some(a.into_iter().map(|v| v as f32).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::distort::Gaussian;

    #[test]
    fn a_factor_times_itself_is_the_matrix() {
        let a = vec![4.0, 2.0, -1.0, 2.0, 5.0, 0.5, -1.0, 0.5, 3.0];
        let l = cholesky(a.clone(), 3).unwrap();
        for (at, expected) in a.iter().enumerate() {
            let (i, j) = (at / 3, at % 3);
            let got: f32 = (0..3).map(|k| l[i * 3 + k] * l[j * 3 + k]).sum();
            assert!((f64::from(got) - expected).abs() < 1e-5, "({i}, {j}): {got} for {expected}");
        }
        assert!(cholesky(vec![1.0, 2.0, 2.0, 1.0], 2).is_none());
    }

    /// Two classes of renders with four features, of which one goes with another.
    fn renders() -> Vec<Vec<Vec<f32>>> {
        let mut noise = Gaussian::new(3);
        let mut render = |middle: f32| {
            let [a, b, c] = [noise.draw(), noise.draw(), noise.draw()];
            vec![middle + a, a + 0.1 * b, 5.0 + 0.01 * c, middle - b]
        };
        [0.0, 3.0].map(|middle| (0..200).map(|_| render(middle)).collect()).to_vec()
    }

    #[test]
    fn what_lies_where_a_class_lies_is_trusted_and_what_lies_elsewhere_is_unmarked() {
        let classes = renders();
        let familiar = Familiar::fit(&classes, 1.5).unwrap();
        for (class, renders) in classes.iter().enumerate() {
            for render in renders {
                let mut p = [0.1, 0.0, 0.0];
                p[class + 1] = 0.9;
                familiar.doubt(&mut p, render);
                assert!(p[class + 1] > 0.85 && (p.iter().sum::<f32>() - 1.0).abs() < 1e-6, "{p:?}");
            }
        }
        // Every feature alone may be that large; the third never is, and what is far out is far out.
        for stranger in [[0.0, 0.0, 6.0, 0.0], [40.0, 0.0, 5.0, 0.0], [f32::INFINITY, 0.0, 5.0, 0.0]] {
            let mut p = [0.0, 1.0, 0.0];
            familiar.doubt(&mut p, &stranger);
            assert!(p[0] > 0.99, "{stranger:?}: {p:?}");
        }
    }

    #[test]
    fn distances_follow_the_covariance() {
        // Variances 4 and 1 without covariance, about (1, 2): the mean square of the two z-scores.
        let ring = [[3.0, 2.0], [-1.0, 2.0], [1.0, 3.0], [1.0, 1.0]];
        let class = ring.iter().map(|r| r.to_vec()).collect();
        let familiar = Familiar::fit(&[class], 1.0).unwrap();
        // Sums over n - 1: 8 / 3 and 2 / 3.
        let expected = ((4.0f64 / (8.0 / 3.0)) / 2.0).sqrt();
        assert!((familiar.distance(0, &[3.0, 2.0]) - expected).abs() < 1e-4);
        assert!((familiar.distance(0, &[1.0, 3.0]) - (1.0f64 / (2.0 / 3.0) / 2.0).sqrt()).abs() < 1e-4);
        assert!(familiar.distance(0, &[1.0, 2.0]) < 1e-9);
    }

    #[test]
    fn what_cannot_be_fitted_is_not() {
        assert!(Familiar::fit(&[], 1.5).is_none());
        assert!(Familiar::fit(&[vec![vec![1.0, 2.0]], Vec::new()], 1.5).is_none());
        assert!(Familiar::fit(&[vec![vec![1.0, f32::NAN], vec![2.0, 1.0]]], 1.5).is_none());
        // Renders that are all the same have no spread to measure by.
        assert!(Familiar::fit(&[vec![vec![1.0, 2.0]; 5]], 1.5).is_none());
    }
}
