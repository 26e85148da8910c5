//! Sounds: WAV files in and out, and resampling.

mod resample;
mod wav;

pub use wav::{SAMPLE_RATES_HZ, Sound, SoundLimits, decode_wav, encode_wav};
