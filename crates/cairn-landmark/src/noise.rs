//! Repeatable noise from integer hashes: the same on every machine and thread,
//! with no table to carry.

use glam::Vec2;

/// Well-mixed bits of three integers (finaliser of MurmurHash3).
fn hash(x: i32, y: i32, salt: u32) -> u32 {
    let mut h =
        (x as u32).wrapping_mul(0x8da6_b343) ^ (y as u32).wrapping_mul(0xd816_3841) ^ salt.wrapping_mul(0xcb1a_b31f);
    h = (h ^ (h >> 16)).wrapping_mul(0x85eb_ca6b);
    h = (h ^ (h >> 13)).wrapping_mul(0xc2b2_ae35);
    h ^ (h >> 16)
}

/// A number in [0, 1) for an integer cell.
pub(crate) fn cell(x: i32, y: i32, salt: u32) -> f32 {
    (hash(x, y, salt) >> 8) as f32 / (1 << 24) as f32
}

/// Smooth noise in [0, 1) with one feature a unit.
pub(crate) fn value(p: Vec2, salt: u32) -> f32 {
    let base = p.floor();
    let f = p - base;
    let u = f * f * (Vec2::splat(3.0) - 2.0 * f);
    let (x, y) = (base.x as i32, base.y as i32);
    let low = cell(x, y, salt) * (1.0 - u.x) + cell(x + 1, y, salt) * u.x;
    let high = cell(x, y + 1, salt) * (1.0 - u.x) + cell(x + 1, y + 1, salt) * u.x;
    low * (1.0 - u.y) + high * u.y
}

/// Four octaves of [`value`], in [0, 1), mean one half.
pub(crate) fn fractal(p: Vec2, salt: u32) -> f32 {
    // Each octave is turned, so that the lattices do not line up.
    let turn = |v: Vec2| Vec2::new(1.6 * v.x + 1.2 * v.y, -1.2 * v.x + 1.6 * v.y);
    let (mut sum, mut weight, mut at) = (0.0, 0.533_333_3, p);
    for octave in 0..4 {
        sum += weight * value(at, salt.wrapping_add(octave));
        weight *= 0.5;
        at = turn(at);
    }
    sum
}

/// 0 below `low`, 1 above `high`, smooth between.
pub(crate) fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_bounded_continuous_and_centred() {
        let mut sum = 0.0;
        for i in 0..4000 {
            let p = Vec2::new(i as f32 * 0.37, i as f32 * -0.11);
            let v = fractal(p, 3);
            assert!((0.0..1.0).contains(&v));
            assert!((fractal(p + Vec2::splat(1e-3), 3) - v).abs() < 0.05);
            sum += v;
        }
        assert!((sum / 4000.0 - 0.5).abs() < 0.05, "mean {}", sum / 4000.0);
    }
}
