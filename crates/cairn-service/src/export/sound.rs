//! A sound to look at: its waveform and its spectrogram, the true one above and the
//! recovered one below on the same axes. A sound cannot be listened to on a page of
//! figures, and its ratio of signal to noise alone says nothing about where the noise is.

use cairn_scene::metrics::{LSD_FLOOR_DB, LSD_FRAME, log_spectrum_db};
use cairn_scene::{Picture, Sound};

use crate::export::words::{self, Label};

const PAPER: [f32; 3] = [0.97, 0.97, 0.95];
const INK: words::Colour = [30, 30, 36];
/// Height of a line of words, px.
const LINE_PX: usize = 12;
/// The waveform.
const WAVE: [f32; 3] = [0.16, 0.33, 0.60];
/// Between the parts, px.
const GAP: usize = 3;
/// Colours of a spectrogram from the floor to full scale, evenly spaced: lightness
/// rises all the way, so that it reads the same without colour.
const LEVELS: [[f32; 3]; 5] =
    [[0.02, 0.01, 0.06], [0.32, 0.07, 0.42], [0.72, 0.21, 0.36], [0.98, 0.56, 0.20], [0.99, 0.99, 0.75]];

/// `truth` above, `recovered` below, on `width` x `height` px (at least 32 x 64 are
/// used): for each a waveform (full scale from top to bottom) and a spectrogram (0
/// to half the sample rate from the bottom, -80 dB to full scale from dark to light).
/// The time axis is as long as the longer one.
pub fn sounds(truth: &Sound, recovered: &Sound, width: usize, height: usize) -> Picture {
    let (width, height) = (width.max(32), height.max(64));
    let mut sheet = Picture::constant(width, height, PAPER);
    let each = (height - GAP) / 2;
    let seconds = truth.seconds().max(recovered.seconds());
    for (name, sound, top) in [("True", truth, 0), ("Recovered", recovered, each + GAP)] {
        let wave = LINE_PX + 2..each * 2 / 5;
        waveform(&mut sheet, sound, seconds, top + wave.start..top + wave.end);
        spectrogram(&mut sheet, sound, seconds, top + wave.end + 1..top + each);
        let text = format!("{name}, {:.1} s", sound.seconds());
        let label = Label { text, left: 1.0, top: top as f64, height_px: LINE_PX as f64, colour: INK };
        words::write(&mut sheet, &label);
    }
    sheet
}

/// The samples that column `x` of `width` shows, of an axis of `seconds`.
fn column(sound: &Sound, seconds: f64, x: usize, width: usize) -> std::ops::Range<usize> {
    let at = |x: usize| (x as f64 / width as f64 * seconds * f64::from(sound.sample_rate_hz())) as usize;
    let len = sound.samples().len();
    at(x).min(len)..at(x + 1).max(at(x) + 1).min(len)
}

/// From the lowest to the highest sample of each column.
fn waveform(sheet: &mut Picture, sound: &Sound, seconds: f64, rows: std::ops::Range<usize>) {
    let (width, tall) = (sheet.width(), rows.len().max(1));
    let row = |level: f32| {
        let down = (0.5 - 0.5 * level.clamp(-1.0, 1.0)) * (tall - 1) as f32;
        rows.start + down.round() as usize
    };
    for x in 0..width {
        let samples = &sound.samples()[column(sound, seconds, x, width)];
        if samples.is_empty() {
            continue;
        }
        let (low, high) = samples.iter().fold((1.0f32, -1.0f32), |(l, h), v| (l.min(*v), h.max(*v)));
        for y in row(high)..=row(low) {
            sheet.rgb_mut()[(y * width + x) * 3..][..3].copy_from_slice(&WAVE);
        }
    }
}

fn spectrogram(sheet: &mut Picture, sound: &Sound, seconds: f64, rows: std::ops::Range<usize>) {
    let (width, tall, bins) = (sheet.width(), rows.len(), LSD_FRAME / 2);
    for x in 0..width {
        let samples = column(sound, seconds, x, width);
        if samples.is_empty() {
            continue;
        }
        // The frame around the column's middle.
        let spectrum = log_spectrum_db(sound.samples(), (samples.start + samples.end).saturating_sub(LSD_FRAME) / 2);
        for (i, y) in rows.clone().rev().enumerate() {
            let bin = i * bins / tall..((i + 1) * bins).div_ceil(tall);
            let loudest = spectrum[bin].iter().copied().fold(LSD_FLOOR_DB, f64::max);
            let colour = shade(1.0 - loudest / LSD_FLOOR_DB);
            sheet.rgb_mut()[(y * width + x) * 3..][..3].copy_from_slice(&colour);
        }
    }
}

/// The colour of a level from 0 (the floor) to 1 (full scale).
fn shade(level: f64) -> [f32; 3] {
    let at = level.clamp(0.0, 1.0) * (LEVELS.len() - 1) as f64;
    let below = (at as usize).min(LEVELS.len() - 2);
    let share = (at - below as f64) as f32;
    [0, 1, 2].map(|c| LEVELS[below][c] + share * (LEVELS[below + 1][c] - LEVELS[below][c]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tone_is_a_line_at_its_height_and_silence_is_dark() {
        let tone = (0..8000).map(|i| 0.8 * (std::f32::consts::TAU * 2000.0 * i as f32 / 16_000.0).sin()).collect();
        let (tone, silence) = (Sound::new(tone, 16_000).unwrap(), Sound::new(vec![0.0; 16_000], 16_000).unwrap());
        let picture = sounds(&tone, &silence, 100, 203);
        assert_eq!((picture.width(), picture.height()), (100, 203));
        let light = |x: usize, y: usize| picture.pixel(x, y).iter().sum::<f32>();
        // The spectrogram's rows are 41 to 99; 2 kHz of 8 is a quarter from below.
        let brightest = (41..100).max_by(|a, b| light(20, *a).total_cmp(&light(20, *b))).unwrap();
        assert!((84..=86).contains(&brightest), "row {brightest}");
        assert_eq!(picture.pixel(20, 45), LEVELS[0]);
        // The tone is half as long as the silence: nothing stands behind it.
        assert_eq!(picture.pixel(80, 90), PAPER);
        assert_eq!(picture.pixel(80, 190), LEVELS[0]);
        // Waveforms: one fills its strip, the other is a line.
        let inked = |rows: std::ops::Range<usize>| rows.filter(|y| picture.pixel(20, *y) == WAVE).count();
        assert!(inked(14..40) > 20 && inked(117..143) == 1, "{} and {}", inked(14..40), inked(117..143));
    }
}
