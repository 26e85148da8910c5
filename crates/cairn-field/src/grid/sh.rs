//! Real spherical harmonics of degree 2: how a voxel's colour depends on the
//! direction it is seen from. Nine coefficients a channel, as in Plenoxels.

use super::real::Real;

/// Coefficients a colour channel (degree 2: `(2 + 1)^2`).
pub const SH: usize = 9;

/// The nine real basis functions at `direction` (unit length), in the usual
/// order l = 0; l = 1 (m = -1, 0, 1); l = 2 (m = -2 .. 2), with the
/// Condon-Shortley phase (Sloan, "Stupid Spherical Harmonics Tricks", 2008, appendix A2).
pub fn basis<T: Real>(direction: [T; 3]) -> [T; SH] {
    let [x, y, z] = direction;
    let c = T::of;
    [
        c(0.282_094_791_773_878_14),
        c(-0.488_602_511_902_919_9) * y,
        c(0.488_602_511_902_919_9) * z,
        c(-0.488_602_511_902_919_9) * x,
        c(1.092_548_430_592_079_2) * x * y,
        c(-1.092_548_430_592_079_2) * y * z,
        c(0.315_391_565_252_520_05) * (c(3.0) * z * z - c(1.0)),
        c(-1.092_548_430_592_079_2) * x * z,
        c(0.546_274_215_296_039_6) * (x * x - y * y),
    ]
}

/// Value of the constant basis function; a coefficient of `1 / SH_DC` is colour 1.
pub const SH_DC: f64 = 0.282_094_791_773_878_14;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_basis_is_orthonormal_on_the_sphere() {
        // The midpoint rule's error falls with the square of the rows: 2e-5 here.
        let (rows, columns) = (500, 64);
        let mut gram = [[0.0f64; SH]; SH];
        for i in 0..rows {
            let z: f64 = -1.0 + (i as f64 + 0.5) * 2.0 / rows as f64;
            for j in 0..columns {
                let phi = (j as f64 + 0.5) * std::f64::consts::TAU / columns as f64;
                let r = (1.0 - z * z).sqrt();
                let y = basis([r * phi.cos(), r * phi.sin(), z]);
                let area = 4.0 * std::f64::consts::PI / (rows * columns) as f64;
                for a in 0..SH {
                    for b in 0..SH {
                        gram[a][b] += y[a] * y[b] * area;
                    }
                }
            }
        }
        for (a, row) in gram.iter().enumerate() {
            for (b, v) in row.iter().enumerate() {
                assert!((v - f64::from(a == b)).abs() < 1e-4, "<{a}, {b}> = {v}");
            }
        }
    }
}
