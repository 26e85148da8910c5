//! Chance that hangs on a seed and a place alone: no generator whose state has to be kept.

/// SplitMix64's finaliser: every bit of the result hangs on every bit of `x`.
pub fn mixed(x: u64) -> u64 {
    let mut z = x.wrapping_add(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

/// About `wanted` of view `n`'s `pixels`, spread evenly: each anywhere in its stretch, since an even lattice would
/// fall into a few of the photograph's columns. With each comes a bit of chance.
pub(crate) fn spread(seed: u64, n: usize, pixels: usize, wanted: usize) -> impl Iterator<Item = (usize, bool)> {
    let every = (pixels / wanted).max(1);
    (0..pixels / every).map(move |k| {
        let chance = mixed(seed ^ mixed((n as u64) << 32 | k as u64));
        (k * every + (chance >> 1) as usize % every, chance & 1 == 1)
    })
}
