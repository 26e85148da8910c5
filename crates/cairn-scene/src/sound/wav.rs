//! Sounds in memory and as WAV files: mono, decoded under limits that are checked
//! on the header before a sample is allocated.
//!
//! People bring what their recorder made: any rate, one channel or more, 8 to 32
//! bits. It is mixed down to one channel (the mean of all), and
//! [`Sound::resampled`] brings it to the rate that is wanted.

use std::io::Cursor;

use hound::{SampleFormat, WavReader, WavSpec, WavWriter};

use crate::error::CaptureError;

/// Sample rates that are taken, Hz: from telephones' half to studios' highest.
pub const SAMPLE_RATES_HZ: std::ops::RangeInclusive<u32> = 1000..=384_000;
/// Most channels that are mixed down.
const MAX_CHANNELS: u16 = 32;
/// 16-bit samples a full scale: the same both ways, so that a file read and
/// written again has the same bytes.
const FULL_SCALE: f32 = 32_768.0;
/// Channels of which less than this share is left in their mean are one turned against the other.
const CANCELLED: f64 = 1e-3;

/// A mono sound: samples with full scale at -1 and 1, all finite, at least one.
#[derive(Clone, Debug, PartialEq)]
pub struct Sound {
    samples: Vec<f32>,
    sample_rate_hz: u32,
}

/// The most that is accepted of a sound.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SoundLimits {
    /// Largest file, bytes.
    pub max_file_bytes: u64,
    /// Longest sound, seconds.
    pub longest_s: f64,
}

impl Sound {
    /// Wraps mono `samples` at `sample_rate_hz`.
    ///
    /// # Errors
    /// [`CaptureError::NotASound`] for no samples, one that is not finite, or a rate
    /// outside of [`SAMPLE_RATES_HZ`].
    pub fn new(samples: Vec<f32>, sample_rate_hz: u32) -> Result<Self, CaptureError> {
        Self::checked("the sound", samples, sample_rate_hz)
    }

    fn checked(name: &str, samples: Vec<f32>, sample_rate_hz: u32) -> Result<Self, CaptureError> {
        check_rate(name, sample_rate_hz)?;
        if samples.is_empty() {
            return Err(refused(name, "it has no samples"));
        }
        match samples.iter().position(|v| !v.is_finite()) {
            Some(at) => Err(refused(name, format!("sample {at} is {}, which is no level", samples[at]))),
            None => Ok(Self { samples, sample_rate_hz }),
        }
    }

    /// The samples.
    pub fn samples(&self) -> &[f32] {
        &self.samples
    }

    /// Samples a second.
    pub fn sample_rate_hz(&self) -> u32 {
        self.sample_rate_hz
    }

    /// How long it lasts, seconds.
    pub fn seconds(&self) -> f64 {
        self.samples.len() as f64 / f64::from(self.sample_rate_hz)
    }

    /// The largest level, dB below full scale; minus infinity for digital silence.
    pub fn peak_db(&self) -> f64 {
        20.0 * f64::from(self.samples.iter().fold(0.0f32, |most, v| most.max(v.abs()))).log10()
    }

    /// The root mean square of the levels, dB below full scale; minus infinity for digital silence.
    pub fn rms_db(&self) -> f64 {
        let squares: f64 = self.samples.iter().map(|v| f64::from(*v).powi(2)).sum();
        10.0 * (squares / self.samples.len() as f64).log10()
    }

    /// The sound as it is once it was kept as a WAV file ([`encode_wav`]): clamped to full scale, on 16-bit levels.
    #[must_use]
    pub fn in_16_bits(&self) -> Self {
        let samples = self.to_pcm16().into_iter().map(|level| f32::from(level) / FULL_SCALE).collect();
        Self { samples, sample_rate_hz: self.sample_rate_hz }
    }

    /// As 16-bit samples, rounded to nearest and clamped to full scale.
    pub fn to_pcm16(&self) -> Vec<i16> {
        let level = |v: &f32| (v * FULL_SCALE).round().clamp(f32::from(i16::MIN), f32::from(i16::MAX)) as i16;
        self.samples.iter().map(level).collect()
    }

    /// The same sound at `sample_rate_hz`, band-limited: what the new rate cannot
    /// hold is left out and not folded back. The last sample may lie up to a period
    /// behind the old end.
    ///
    /// # Errors
    /// [`CaptureError::NotASound`] for a rate outside of [`SAMPLE_RATES_HZ`].
    pub fn resampled(&self, sample_rate_hz: u32) -> Result<Self, CaptureError> {
        check_rate("the sound", sample_rate_hz)?;
        if sample_rate_hz == self.sample_rate_hz {
            return Ok(self.clone());
        }
        let samples = crate::sound::resample::resample(&self.samples, self.sample_rate_hz, sample_rate_hz);
        Self::new(samples, sample_rate_hz)
    }
}

/// Decodes a WAV file (PCM of 8 to 32 bits, or 32-bit float) that errors call
/// `name`, mixed down to one channel, at its own rate.
///
/// # Errors
/// [`CaptureError::TooLarge`] and [`CaptureError::SoundTooLong`] over the limits
/// (found on the header, before any sample is allocated); [`CaptureError::NotASound`]
/// for anything else.
pub fn decode_wav(name: &str, bytes: &[u8], limits: &SoundLimits) -> Result<Sound, CaptureError> {
    let got = bytes.len() as u64;
    if got > limits.max_file_bytes {
        let (file, what, limit) = (name.to_owned(), "file size in bytes", limits.max_file_bytes);
        return Err(CaptureError::TooLarge { file, what, limit, got });
    }
    let reader = WavReader::new(Cursor::new(bytes)).map_err(|e| refused(name, e))?;
    let spec = reader.spec();
    check_rate(name, spec.sample_rate)?;
    if spec.channels > MAX_CHANNELS {
        return Err(refused(name, format!("{} channels, at most {MAX_CHANNELS} are mixed down", spec.channels)));
    }
    let frames = reader.duration() as usize;
    let seconds = frames as f64 / f64::from(spec.sample_rate);
    if seconds > limits.longest_s {
        return Err(CaptureError::SoundTooLong { file: name.to_owned(), seconds, longest_s: limits.longest_s });
    }
    // A header may say anything: no room is made for samples that the file has no bytes for.
    let stated = u64::from(reader.len()) * u64::from(spec.bits_per_sample) / 8;
    if stated > got {
        return Err(refused(name, format!("its header says {stated} bytes of samples, the file has {got} in all")));
    }
    Sound::checked(name, mixed_down(name, reader, spec, frames)?, spec.sample_rate)
}

/// The mean of the channels, frame after frame.
fn mixed_down(
    name: &str,
    mut reader: WavReader<Cursor<&[u8]>>,
    spec: WavSpec,
    frames: usize,
) -> Result<Vec<f32>, CaptureError> {
    let mut mono = Vec::with_capacity(frames);
    let (channels, mut sum, mut count) = (usize::from(spec.channels), 0.0f64, 0);
    let mut loudest = 0.0f64;
    let mut take = |level: Result<f64, hound::Error>| -> Result<(), CaptureError> {
        let level = level.map_err(|e| refused(name, e))?;
        loudest = loudest.max(level.abs());
        sum += level;
        count += 1;
        if count == channels {
            mono.push((sum / channels as f64) as f32);
            (sum, count) = (0.0, 0);
        }
        Ok(())
    };
    match spec.sample_format {
        SampleFormat::Float => reader.samples::<f32>().try_for_each(|v| take(v.map(f64::from)))?,
        SampleFormat::Int => {
            let full = f64::from(1u32 << (spec.bits_per_sample - 1).min(31));
            reader.samples::<i32>().try_for_each(|v| take(v.map(|v| f64::from(v) / full)))?;
        }
    }
    let left = mono.iter().fold(0.0f32, |most, v| most.max(v.abs()));
    if f64::from(left) < CANCELLED * loudest {
        return Err(refused(
            name,
            "its channels cancel each other where they are mixed down to one; bring one of them",
        ));
    }
    Ok(mono)
}

/// `sound` as a WAV file: mono, 16-bit PCM. The same sound gives the same bytes.
///
/// # Panics
/// When the file would be over 4 GiB, which the format cannot hold.
pub fn encode_wav(sound: &Sound) -> Vec<u8> {
    let spec = WavSpec {
        channels: 1,
        sample_rate: sound.sample_rate_hz,
        bits_per_sample: 16,
        sample_format: SampleFormat::Int,
    };
    let mut bytes = Cursor::new(Vec::new());
    let written = WavWriter::new(&mut bytes, spec).and_then(|mut writer| {
        sound.to_pcm16().into_iter().try_for_each(|level| writer.write_sample(level))?;
        writer.finalize()
    });
    written.expect("writing to memory does not fail below 4 GiB");
    bytes.into_inner()
}

fn check_rate(name: &str, sample_rate_hz: u32) -> Result<(), CaptureError> {
    if SAMPLE_RATES_HZ.contains(&sample_rate_hz) {
        return Ok(());
    }
    let (low, high) = (SAMPLE_RATES_HZ.start(), SAMPLE_RATES_HZ.end());
    Err(refused(name, format!("{sample_rate_hz} samples a second, {low} to {high} are taken")))
}

fn refused(name: &str, reason: impl ToString) -> CaptureError {
    CaptureError::NotASound { file: name.to_owned(), reason: reason.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROOM: SoundLimits = SoundLimits { max_file_bytes: 1 << 20, longest_s: 10.0 };

    /// A WAV of `frames` frames; every channel of frame `i` says what `level` does.
    fn wav(spec: WavSpec, frames: usize, level: impl Fn(usize, u16) -> f64) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        let mut writer = WavWriter::new(&mut bytes, spec).unwrap();
        for i in 0..frames {
            for c in 0..spec.channels {
                match spec.sample_format {
                    SampleFormat::Float => writer.write_sample(level(i, c) as f32).unwrap(),
                    SampleFormat::Int => {
                        let full = f64::from(1u32 << (spec.bits_per_sample - 1));
                        writer.write_sample((level(i, c) * full).round() as i32).unwrap();
                    }
                }
            }
        }
        writer.finalize().unwrap();
        bytes.into_inner()
    }

    fn spec(channels: u16, bits_per_sample: u16, sample_format: SampleFormat) -> WavSpec {
        WavSpec { channels, sample_rate: 8000, bits_per_sample, sample_format }
    }

    #[test]
    fn all_depths_are_read_and_channels_are_averaged() {
        let level = |i: usize, c: u16| 0.5 * (i as f64 * 0.1).sin() * if c == 0 { 1.0 } else { 0.5 };
        for (bits, format) in [
            (8, SampleFormat::Int),
            (16, SampleFormat::Int),
            (24, SampleFormat::Int),
            (32, SampleFormat::Int),
            (32, SampleFormat::Float),
        ] {
            let sound = decode_wav("a", &wav(spec(2, bits, format), 100, level), &ROOM).unwrap();
            assert_eq!((sound.samples().len(), sound.sample_rate_hz()), (100, 8000));
            for (i, v) in sound.samples().iter().enumerate() {
                let expected = 0.375 * (i as f64 * 0.1).sin();
                assert!((f64::from(*v) - expected).abs() < 1.1 / 128.0, "{bits} bits: {v} for {expected}");
                assert!(bits == 8 || (f64::from(*v) - expected).abs() < 1e-4, "{bits} bits: {v} for {expected}");
            }
        }
    }

    #[test]
    fn written_and_read_again_it_is_the_same() {
        let samples = vec![-1.0, 1.0, 0.25, -0.75, 1.0 / 32768.0, 3.0];
        let file = encode_wav(&Sound::new(samples, 16_000).unwrap());
        let read = decode_wav("a", &file, &ROOM).unwrap();
        assert_eq!(read.samples()[..4], [-1.0, 32767.0 / 32768.0, 0.25, -0.75]);
        assert_eq!(encode_wav(&read), file);
        assert!((read.seconds() - 6.0 / 16_000.0).abs() < 1e-12 && read.peak_db() == 0.0);
    }

    #[test]
    fn levels_are_told_and_a_sound_is_what_its_file_will_say() {
        let sound = Sound::new(vec![0.5, -0.5, 0.5, -0.5], 16_000).unwrap();
        assert!((sound.rms_db() + 6.0206).abs() < 1e-3 && (sound.peak_db() + 6.0206).abs() < 1e-3);
        assert_eq!(sound.in_16_bits(), sound);
        let odd = Sound::new(vec![1.7, -1.7, 1e-6, 0.3], 16_000).unwrap();
        assert!(odd.peak_db() > 4.6);
        assert_eq!(odd.in_16_bits(), decode_wav("a", &encode_wav(&odd), &ROOM).unwrap());
        assert_eq!(odd.in_16_bits().samples()[2], 0.0);
        assert_eq!(Sound::new(vec![0.0; 3], 16_000).unwrap().rms_db(), f64::NEG_INFINITY);
    }

    #[test]
    fn channels_that_cancel_each_other_are_not_called_silence() {
        let against = |i: usize, c: u16| 0.5 * (i as f64 * 0.1).sin() * if c == 0 { 1.0 } else { -1.0 };
        for (bits, format) in [(16, SampleFormat::Int), (32, SampleFormat::Float)] {
            let error = decode_wav("b.wav", &wav(spec(2, bits, format), 100, against), &ROOM).unwrap_err().to_string();
            assert!(error.contains("b.wav") && error.contains("cancel each other"), "{error}");
        }
        // Silence in all channels is silence, and one channel of two is a sound.
        assert!(decode_wav("a", &wav(spec(2, 16, SampleFormat::Int), 100, |_, _| 0.0), &ROOM).is_ok());
        let one = |i: usize, c: u16| if c == 0 { 0.5 * (i as f64 * 0.1).sin() } else { 0.0 };
        assert!(decode_wav("a", &wav(spec(2, 16, SampleFormat::Int), 100, one), &ROOM).is_ok());
    }

    #[test]
    fn what_cannot_be_is_refused_by_name() {
        let says = |bytes: &[u8], limits: SoundLimits, expected: &[&str]| {
            let error = decode_wav("credit.wav", bytes, &limits).unwrap_err().to_string();
            assert!(expected.iter().all(|part| error.contains(part)), "{error}");
        };
        let good = wav(spec(1, 16, SampleFormat::Int), 16_000, |_, _| 0.1);
        says(&good, SoundLimits { longest_s: 1.5, ..ROOM }, &["credit.wav", "2.00 s", "1.5 s"]);
        says(&good, SoundLimits { max_file_bytes: 99, ..ROOM }, &["credit.wav", "file size in bytes", "99"]);
        says(&good[..400], ROOM, &["credit.wav", "32000 bytes of samples", "400"]);
        says(b"RIFFnonsense", ROOM, &["credit.wav", "WAV"]);
        says(&wav(spec(1, 16, SampleFormat::Int), 0, |_, _| 0.0), ROOM, &["no samples"]);
        says(&wav(spec(1, 32, SampleFormat::Float), 3, |i, _| [0.0, f64::NAN, 0.0][i]), ROOM, &["sample 1 is NaN"]);
        let slow = WavSpec { sample_rate: 100, ..spec(1, 16, SampleFormat::Int) };
        says(&wav(slow, 3, |_, _| 0.0), ROOM, &["100 samples a second", "1000 to 384000"]);
    }
}
