//! Small symmetric linear systems, by Cholesky's factors.

/// Cholesky's factor of a positive definite matrix, `n x n`, in place; only the
/// lower triangle is read and written. `None` when it is not positive definite.
pub fn factor(m: &mut [f64], n: usize) -> Option<()> {
    for j in 0..n {
        for k in 0..j {
            let v = m[j * n + k];
            for i in j..n {
                m[i * n + j] -= m[i * n + k] * v;
            }
        }
        let pivot = m[j * n + j];
        if !(pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        for i in j..n {
            m[i * n + j] /= pivot.sqrt();
        }
    }
    Some(())
}

/// Solves `L L^T x = b` in place, as many equations as `x` has numbers.
pub fn solve(l: &[f64], x: &mut [f64]) {
    let n = x.len();
    for i in 0..n {
        for k in 0..i {
            x[i] -= l[i * n + k] * x[k];
        }
        x[i] /= l[i * n + i];
    }
    for i in (0..n).rev() {
        for k in i + 1..n {
            x[i] -= l[k * n + i] * x[k];
        }
        x[i] /= l[i * n + i];
    }
}
