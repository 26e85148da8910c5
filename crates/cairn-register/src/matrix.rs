//! The small linear system of a step: eleven numbers.

use cairn_field::appearance::cholesky::{factor, solve};

/// Numbers that say where a picture was taken: rotation, translation, focal length, principal point, radial
/// distortion, and how high pixels are for their width.
pub(super) const NUMBERS: usize = 11;

/// The last of them say the lens's shape: radial distortion, and how high pixels are.
pub(super) const SHAPE: usize = 2;

/// `J^T W J` and `J^T W r`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Normal {
    pub(super) matrix: [[f64; NUMBERS]; NUMBERS],
    pub(super) right: [f64; NUMBERS],
}

impl Normal {
    /// Adds one residual `r` with slopes `j` and weight `w`.
    #[inline]
    pub(super) fn add(&mut self, j: &[f64; NUMBERS], r: f64, w: f64) {
        for (row, (right, a)) in self.matrix.iter_mut().zip(self.right.iter_mut().zip(j)) {
            *right += w * a * r;
            for (m, b) in row.iter_mut().zip(j) {
                *m += w * a * b;
            }
        }
    }

    /// The step that solves `(M + damping diag(M)) x = right` (Levenberg and Marquardt's), by Cholesky's
    /// factors; `None` where there is none.
    pub(super) fn step(&self, damping: f64) -> Option<[f64; NUMBERS]> {
        let mut m = self.matrix;
        let largest = (0..NUMBERS).map(|k| m[k][k]).fold(0.0, f64::max);
        for (k, row) in m.iter_mut().enumerate() {
            // What a number does not change at all stays as it is.
            row[k] = row[k] * (1.0 + damping) + 1e-9 * largest;
        }
        let (m, mut x) = (m.as_flattened_mut(), self.right);
        factor(m, NUMBERS)?;
        solve(m, &mut x);
        x.iter().all(|v| v.is_finite()).then_some(x)
    }

    /// The matrix's inverse, with what no number changes held fast; `None` where there is none.
    pub(super) fn inverse(&self) -> Option<[[f64; NUMBERS]; NUMBERS]> {
        let mut m = self.matrix;
        let largest = (0..NUMBERS).map(|k| m[k][k]).fold(0.0, f64::max);
        for (k, row) in m.iter_mut().enumerate() {
            row[k] += 1e-9 * largest;
        }
        let m = m.as_flattened_mut();
        factor(m, NUMBERS)?;
        let column = |k: usize| {
            let mut x: [f64; NUMBERS] = std::array::from_fn(|n| if n == k { 1.0 } else { 0.0 });
            solve(m, &mut x);
            x
        };
        // Symmetric: columns are rows.
        let all = std::array::from_fn(column);
        all.as_flattened().iter().all(|v: &f64| v.is_finite()).then_some(all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_solves_the_least_squares_that_it_was_given() {
        let truth: [f64; NUMBERS] = std::array::from_fn(|k| 0.3 * k as f64 - 1.0);
        let mut normal = Normal::default();
        for n in 0..40 {
            let j: [f64; NUMBERS] = std::array::from_fn(|k| (f64::from(n) * (0.37 + 0.21 * k as f64)).sin());
            normal.add(&j, j.iter().zip(&truth).map(|(a, b)| a * b).sum(), 1.0 + f64::from(n % 3));
        }
        let found = normal.step(0.0).unwrap();
        assert!(found.iter().zip(&truth).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?}");
        // Damped, it goes less far; without slopes nowhere.
        let less = normal.step(10.0).unwrap();
        assert!(less.iter().map(|v| v * v).sum::<f64>() < 0.5 * found.iter().map(|v| v * v).sum::<f64>());
        assert_eq!(Normal::default().step(1.0), None);
    }
}
