//! Sounds to hide where nobody recorded one: syllables of a made-up voice, different
//! for each contributor. A tone alone would be no test: speech moves through pitches,
//! has vowels and hisses, and pauses.

use std::f64::consts::TAU;

use cairn_scene::Sound;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

/// Two resonances of some vowels, Hz (Peterson and Barney 1952, men's means).
const VOWELS: [[f64; 2]; 5] = [[730.0, 1090.0], [530.0, 1840.0], [270.0, 2290.0], [570.0, 840.0], [300.0, 870.0]];

/// What contributor `index` (from 0) says: `seconds` of made-up speech, mono at
/// `sample_rate_hz`, its peak at half of full scale. `seed` varies the words.
///
/// # Panics
/// When there would be no sample, or the rate is out of range.
pub fn credit(index: usize, seconds: f64, sample_rate_hz: u32, seed: u64) -> Sound {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(index as u64);
    let rate = f64::from(sample_rate_hz);
    let count = (seconds * rate).round() as usize;
    let mut samples = vec![0.0f64; count];
    let pitch = 95.0 + 30.0 * (index % 5) as f64;
    let mut at = 0.03;
    while at < seconds {
        let (hiss, length) = (rng.random_range(0.02..0.07), rng.random_range(0.10..0.22));
        let (vowel, bend) = (VOWELS[rng.random_range(0..VOWELS.len())], rng.random_range(-0.25..0.25));
        let start = (at * rate) as usize;
        for (i, sample) in samples.iter_mut().enumerate().skip(start).take(((hiss + length) * rate) as usize) {
            let t = (i - start) as f64 / rate;
            *sample = if t < hiss {
                0.12 * rng.random_range(-1.0..1.0) * (TAU * t / hiss / 2.0).sin()
            } else {
                let share = (t - hiss) / length;
                voiced(t - hiss, pitch * (1.0 + bend * share), vowel) * (TAU * share / 2.0).sin()
            };
        }
        at += hiss + length + rng.random_range(0.02..0.09);
    }
    let peak = samples.iter().fold(1e-9f64, |most, v| most.max(v.abs()));
    let samples = samples.iter().map(|v| (0.5 * v / peak) as f32).collect();
    Sound::new(samples, sample_rate_hz).expect("some seconds of finite samples")
}

/// Harmonics of `pitch` Hz, as loud as the vowel's resonances let them be.
fn voiced(t: f64, pitch: f64, vowel: [f64; 2]) -> f64 {
    let harmonic = |k: usize| {
        let hz = pitch * k as f64;
        let loud: f64 = vowel.iter().map(|f| 1.0 / (1.0 + ((hz - f) / 120.0).powi(2))).sum();
        (loud + 0.02) / (k as f64).sqrt() * (TAU * hz * t).sin()
    };
    // Up to 3.5 kHz: any rate that is taken for speech holds that.
    (1..).map_while(|k| (pitch * (k as f64) < 3500.0).then(|| harmonic(k))).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn credits_are_loud_varied_and_the_same_every_time() {
        let sounds: Vec<Sound> = (0..3).map(|i| credit(i, 1.0, 16_000, 7)).collect();
        for sound in &sounds {
            assert_eq!((sound.samples().len(), sound.sample_rate_hz()), (16_000, 16_000));
            assert!((sound.peak_db() + 6.02).abs() < 0.01, "{}", sound.peak_db());
            let power = sound.samples().iter().map(|v| v * v).sum::<f32>() / 16_000.0;
            assert!(power.sqrt() > 0.05, "{}", power.sqrt());
        }
        assert!(sounds[0] != sounds[1] && sounds[1] != sounds[2]);
        assert_eq!(sounds[0], credit(0, 1.0, 16_000, 7));
        assert_ne!(sounds[0], credit(0, 1.0, 16_000, 8));
    }
}
