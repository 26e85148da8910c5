//! Sounds at another rate: interpolation by a windowed sinc (Smith and Gossett
//! 1984, "A flexible sampling-rate conversion method"), with a Kaiser window.

use std::f64::consts::PI;

/// Zero crossings of the sinc on each side.
const CROSSINGS: f64 = 32.0;
/// Kaiser's beta: side lobes 90 dB down.
const BETA: f64 = 9.0;
/// The pass band's end, as a share of the lower rate's half; the rest is for the filter to fall in.
const PASS: f64 = 0.93;

/// `samples` at rate `from` brought to rate `to`, both Hz; outside there is silence.
pub(crate) fn resample(samples: &[f32], from: u32, to: u32) -> Vec<f32> {
    let common = divisor(from, to);
    // Output n lies at input n * down / up; its fraction comes again every `up` outputs.
    let (up, down) = (u64::from(to / common), u64::from(from / common));
    let cut = PASS * (f64::from(to) / f64::from(from)).min(1.0);
    let reach = (CROSSINGS / cut).ceil() as i64;
    let len = (samples.len() as u64 * up).div_ceil(down);
    let mut phases: Vec<Vec<f64>> = Vec::new();
    let mut out = Vec::with_capacity(len as usize);
    for n in 0..len {
        let (at, phase) = ((n * down / up) as i64, (n % up) as usize);
        if phase == phases.len() {
            let fraction = (n * down % up) as f64 / up as f64;
            phases.push(kernel(fraction, cut, reach));
        }
        let first = at - reach + 1;
        let taps = phases[phase].iter().enumerate();
        let sum: f64 = taps
            .map(|(k, tap)| {
                let index = usize::try_from(first + k as i64).ok();
                tap * f64::from(index.and_then(|i| samples.get(i)).copied().unwrap_or(0.0))
            })
            .sum();
        out.push(sum as f32);
    }
    out
}

/// Weights of the `2 * reach` samples around a place `fraction` of a period behind
/// the sample at index `reach - 1`; they sum to one.
fn kernel(fraction: f64, cut: f64, reach: i64) -> Vec<f64> {
    let weight = |k: i64| {
        let x = fraction + (reach - 1 - k) as f64;
        let edge = x / reach as f64;
        let sinc = if x == 0.0 { 1.0 } else { (PI * cut * x).sin() / (PI * cut * x) };
        sinc * bessel(BETA * (1.0 - edge * edge).max(0.0).sqrt())
    };
    let mut taps: Vec<f64> = (0..2 * reach).map(weight).collect();
    let sum: f64 = taps.iter().sum();
    taps.iter_mut().for_each(|t| *t /= sum);
    taps
}

/// The modified Bessel function of the first kind and order zero, by its series.
fn bessel(x: f64) -> f64 {
    let (mut term, mut sum, mut k) = (1.0, 1.0, 1.0);
    while term > 1e-12 * sum {
        term *= (x / (2.0 * k)).powi(2);
        sum += term;
        k += 1.0;
    }
    sum
}

fn divisor(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { divisor(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tone(hz: f64, rate: u32, seconds: f64) -> Vec<f32> {
        let count = (seconds * f64::from(rate)) as usize;
        (0..count).map(|i| (2.0 * PI * hz * i as f64 / f64::from(rate)).sin() as f32).collect()
    }

    /// Mean power in the middle of a sound, where no edge is felt.
    fn power(samples: impl Iterator<Item = f64> + Clone) -> f64 {
        samples.clone().map(|v| v * v).sum::<f64>() / samples.count() as f64
    }

    #[test]
    fn a_tone_stays_the_tone_at_any_rate() {
        for (from, to) in [(44_100, 16_000), (48_000, 16_000), (8_000, 16_000), (22_050, 16_000), (11_025, 8_000)] {
            let (made, ideal) = (resample(&tone(440.0, from, 0.5), from, to), tone(440.0, to, 0.5));
            assert!(made.len().abs_diff(ideal.len()) <= 1, "{from} to {to}: {} samples", made.len());
            let middle = to as usize / 10..to as usize * 4 / 10;
            let pairs = middle.map(|i| f64::from(made[i]) - f64::from(ideal[i]));
            let noise_db = 10.0 * (power(pairs) / 0.5).log10();
            assert!(noise_db < -80.0, "{from} to {to}: {noise_db:.1} dB");
        }
    }

    #[test]
    fn what_the_lower_rate_cannot_hold_is_not_folded_back() {
        let made = resample(&tone(11_000.0, 44_100, 0.5), 44_100, 16_000);
        let left = 10.0 * (power(made[1000..7000].iter().map(|v| f64::from(*v))) / 0.5).log10();
        assert!(left < -80.0, "{left:.1} dB of a tone above half the rate are left");
    }

    #[test]
    fn a_level_stays_a_level() {
        let made = resample(&[0.5; 1000], 1000, 1733);
        assert!(made[300..1400].iter().all(|v| (v - 0.5).abs() < 1e-6));
    }
}
