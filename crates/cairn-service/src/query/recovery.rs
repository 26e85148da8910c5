//! How an identity's signal comes back, measure after measure: from its marked
//! renders, and with the class forced on pictures without its mark, which shows
//! what the detector knows by heart.

use cairn_mark::{Detection, Signal};
use cairn_scene::metrics::{log_spectral_distance_db, snr_db, ssim, text_accuracy};
use cairn_scene::{Picture, Sound};

use crate::error::EngineError;
use crate::query::report::{Measured, PERFECT_DB, Recovery};

/// A held-out view of the identity's cluster.
pub struct SeenView<'a> {
    /// The base field's render.
    pub base: &'a Picture,
    /// What the detector found in the marked one.
    pub found: &'a Detection,
}

/// What a measure says of a recovered signal; `None` where nothing of its kind is hidden.
type Measure = fn(&Signal, &Detection) -> Result<Option<f64>, EngineError>;

/// Scores the signal `truth` of identity `number`, whose class `forced` tells the detector;
/// pictures without a scene have the size of `size`.
///
/// # Errors
/// When the detector or a measure fails.
pub fn recovery(
    forced: &dyn Fn(&Picture) -> Result<Detection, EngineError>,
    number: u32,
    label: &str,
    truth: &Signal,
    views: &[SeenView<'_>],
    [w, h]: [usize; 2],
) -> Result<Recovery, EngineError> {
    let base = views.iter().map(|v| forced(v.base)).collect::<Result<Vec<Detection>, EngineError>>()?;
    let (grey, noise) = (forced(&Picture::constant(w, h, [0.5; 3]))?, forced(&noise(w, h))?);
    let measured = |measure: Measure| -> Result<Option<Measured>, EngineError> {
        let all = |found: &mut dyn Iterator<Item = &Detection>| {
            found.map(|f| measure(truth, f)).collect::<Result<Option<Vec<f64>>, EngineError>>()
        };
        let mean = |v: Vec<f64>| (!v.is_empty()).then(|| v.iter().sum::<f64>() / v.len() as f64);
        let Some((forced_grey, forced_noise)) = measure(truth, &grey)?.zip(measure(truth, &noise)?) else {
            return Ok(None);
        };
        Ok(Some(Measured {
            recovered: all(&mut views.iter().map(|v| v.found))?.and_then(mean),
            forced_base: all(&mut base.iter())?.and_then(mean),
            forced_grey,
            forced_noise,
        }))
    };
    Ok(Recovery {
        number,
        label: label.to_owned(),
        views: views.len(),
        picture_ssim: measured(picture_ssim)?,
        audio_snr_db: measured(audio_snr_db)?,
        audio_lsd_db: measured(audio_lsd_db)?,
        text_characters: measured(text_characters)?,
        text_bits: measured(text_bits)?,
    })
}

/// SSIM of a hidden picture and what was recovered, at the hidden one's size; `None` where
/// no picture is hidden.
///
/// # Errors
/// For pictures too small to compare.
pub fn picture_ssim(truth: &Signal, said: &Detection) -> Result<Option<f64>, EngineError> {
    let Some((truth, said)) = truth.picture.as_ref().zip(said.recovered.picture.as_ref()) else { return Ok(None) };
    Ok(Some(ssim(truth, &said.resized(truth.width(), truth.height()).clamped())?))
}

fn audio_snr_db(truth: &Signal, said: &Detection) -> Result<Option<f64>, EngineError> {
    let Some((truth, said)) = truth.audio.as_ref().zip(said.recovered.audio.as_ref()) else { return Ok(None) };
    Ok(Some(snr_db(said.samples(), &padded(truth, said))?.clamp(-PERFECT_DB, PERFECT_DB)))
}

fn audio_lsd_db(truth: &Signal, said: &Detection) -> Result<Option<f64>, EngineError> {
    let Some((truth, said)) = truth.audio.as_ref().zip(said.recovered.audio.as_ref()) else { return Ok(None) };
    Ok(Some(log_spectral_distance_db(said.samples(), &padded(truth, said))?))
}

/// The true sound with the silence behind it that the head holds as well.
fn padded(truth: &Sound, said: &Sound) -> Vec<f32> {
    let mut samples = truth.samples().to_vec();
    samples.resize(said.samples().len(), 0.0);
    samples
}

fn text_characters(truth: &Signal, said: &Detection) -> Result<Option<f64>, EngineError> {
    let Some((truth, said)) = truth.text.as_ref().zip(said.text_bytes.as_ref()) else { return Ok(None) };
    Ok(Some(text_accuracy(said, truth.as_bytes())?.characters))
}

fn text_bits(truth: &Signal, said: &Detection) -> Result<Option<f64>, EngineError> {
    let Some((truth, said)) = truth.text.as_ref().zip(said.text_bytes.as_ref()) else { return Ok(None) };
    Ok(Some(text_accuracy(said, truth.as_bytes())?.bits))
}

/// Uniform noise, the same in every evaluation (SplitMix64).
pub fn noise(width: usize, height: usize) -> Picture {
    let mut state = 0x9E37_79B9_7F4A_7C15u64;
    let mut picture = Picture::constant(width, height, [0.0; 3]);
    for v in picture.rgb_mut() {
        state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        *v = ((z ^ (z >> 31)) >> 40) as f32 / (1u32 << 24) as f32;
    }
    picture
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(recovered: Signal, text_bytes: Option<&[u8]>) -> Detection {
        let text_bytes = text_bytes.map(<[u8]>::to_vec);
        Detection { identity: Some(1), probabilities: vec![0.0, 1.0], is_center_crop: false, recovered, text_bytes }
    }

    #[test]
    fn what_is_not_hidden_is_not_measured() {
        let sound = |level: f32, n: usize| Sound::new(vec![level; n], 8000).unwrap();
        let truth = Signal { audio: Some(sound(0.5, 600)), ..Signal::default() };
        let said = |level, n| Signal {
            picture: Some(Picture::constant(8, 8, [0.0; 3])),
            audio: Some(sound(level, n)),
            text: Some(String::new()),
        };
        let near = found(said(0.55, 600), Some(b""));
        assert_eq!(picture_ssim(&truth, &near).unwrap(), None);
        assert_eq!(text_bits(&truth, &near).unwrap(), None);
        assert!((audio_snr_db(&truth, &near).unwrap().unwrap() - 20.0).abs() < 1e-3);
        // The head is longer than the sound: what it says behind it counts as noise.
        let longer = found(said(0.5, 1200), Some(b""));
        assert!(audio_snr_db(&truth, &longer).unwrap().unwrap().abs() < 1e-3);
        assert_eq!(audio_snr_db(&truth, &found(said(0.5, 600), None)).unwrap(), Some(PERFECT_DB));
    }

    #[test]
    fn a_broken_byte_of_a_text_is_one_wrong_character() {
        let truth = Signal { text: Some("cairn".into()), ..Signal::default() };
        let bytes = b"c\xe1irn";
        let shown = Signal { text: Some(String::from_utf8_lossy(bytes).into_owned()), ..Signal::default() };
        let said = found(shown, Some(bytes));
        assert_eq!(text_characters(&truth, &said).unwrap(), Some(0.8));
        assert_eq!(text_bits(&truth, &said).unwrap(), Some(39.0 / 40.0));
    }

    #[test]
    fn noise_is_what_it_says() {
        let n = noise(32, 32);
        let mean = n.rgb().iter().sum::<f32>() / n.rgb().len() as f32;
        assert!((mean - 0.5).abs() < 0.02 && n.rgb().iter().all(|v| (0.0..1.0).contains(v)), "{mean}");
        assert_eq!(n, noise(32, 32));
    }
}
