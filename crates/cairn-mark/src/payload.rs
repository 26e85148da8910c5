//! What an identity hides, and the numbers that the heads make of it.

use crate::error::MarkError;
use crate::stega::recipe::Recipe;
use crate::tensors::shrunk;
use cairn_nn::{text_bits, text_bytes};
use cairn_scene::{Picture, Sound};
use serde::{Deserialize, Serialize};

/// Pictures whose pixels are closer to one colour than this (root mean square, of the range) are nothing to see: a black one is
/// what a detector shows where nothing is hidden, and any other says no more than its colour.
const MIN_SPREAD: f64 = 0.01;

/// A hidden signal: a picture, a sound, a text, or some of them together. Also what
/// a detector recovers; it then has what the detector has heads for.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Signal {
    /// Any size; brought to the detector's.
    pub picture: Option<Picture>,
    /// At the audio head's rate ([`Sound::resampled`]).
    pub audio: Option<Sound>,
    /// Without zero bytes.
    pub text: Option<String>,
}

impl From<Picture> for Signal {
    fn from(picture: Picture) -> Self {
        Self { picture: Some(picture), ..Self::default() }
    }
}

impl Signal {
    /// Checks that identity `number` can hide this with `config`.
    ///
    /// # Errors
    /// [`MarkError::Signal`] naming identity, modality and what is allowed.
    pub fn check(&self, number: usize, config: &Recipe) -> Result<(), MarkError> {
        let refuse = |problem: String| Err(MarkError::Signal { identity: number, problem });
        if *self == Self::default() {
            return refuse("nothing to hide; bring a picture, a sound or a text".into());
        }
        if let Some(picture) = &self.picture
            && picture.spread() < MIN_SPREAD
        {
            let [r, g, b] = picture.pixel(picture.width() / 2, picture.height() / 2).map(|v| (255.0 * v).round());
            return refuse(format!(
                "a picture of nearly one colour (RGB {r}, {g}, {b}), on which nothing is seen; bring one that shows something, or leave it out"
            ));
        }
        if let Some(audio) = &self.audio {
            let (got, rate) = (audio.sample_rate_hz(), config.audio.sample_rate_hz);
            if got != rate {
                return refuse(format!("a sound of {got} Hz; bring it to `training.payload_sound_hz` = {rate}"));
            }
            if audio.samples().iter().all(|v| *v == 0.0) {
                return refuse("a sound of silence; bring one that is heard, or leave it out".into());
            }
            // The one sample more is what resampling may add.
            let most = config.max_samples();
            if audio.samples().len() > most + 1 {
                let (got, longest) = (audio.seconds(), config.audio.longest_s);
                return refuse(format!(
                    "a sound of {got:.2} s; at most `training.payload_sound_s` = {longest} s are hidden: cut it, or raise that"
                ));
            }
        }
        if let Some(text) = &self.text {
            let longest = config.text.longest_bytes;
            if text.is_empty() {
                return refuse("an empty text; leave it out".into());
            }
            if text.len() > longest {
                return refuse(format!(
                    "a text of {} bytes of UTF-8; at most `training.payload_text_bytes` = {longest} are hidden: shorten it, or raise that",
                    text.len()
                ));
            }
            if let Some(at) = text.find('\0') {
                return refuse(format!("a text with a zero byte at {at}, which would end it; take that out"));
            }
        }
        Ok(())
    }
}

/// Which heads a detector has, and how long they are: those that some identity uses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeadSizes {
    /// Whether pictures are drawn.
    pub picture: bool,
    /// Samples of the audio head.
    pub audio: Option<usize>,
    /// Bytes of the text head.
    pub text: Option<usize>,
}

impl HeadSizes {
    /// What `signals` need, the longest sound's and the longest text's room; and what else there is where `mark.unused_heads`
    /// says so.
    pub(crate) fn of(signals: &[Signal], config: &Recipe) -> Self {
        let audio = signals.iter().filter_map(|s| s.audio.as_ref()).map(|a| a.samples().len()).max();
        let text = signals.iter().filter_map(|s| s.text.as_ref()).map(String::len).max();
        let all = config.unused_heads;
        Self {
            picture: all || signals.iter().any(|s| s.picture.is_some()),
            audio: audio.or(all.then(|| config.max_samples())).map(|longest| config.audio.samples(longest)),
            text: text.or(all.then_some(config.text.longest_bytes)),
        }
    }

    /// How many heads there are.
    pub(crate) fn count(&self) -> usize {
        usize::from(self.picture) + usize::from(self.audio.is_some()) + usize::from(self.text.is_some())
    }

    /// Refuses sizes that no training makes, before anything is allocated for them.
    pub(crate) fn check(&self, config: &Recipe) -> Result<(), MarkError> {
        let most = config.audio.samples(config.max_samples() + 1);
        let ok = self.count() > 0
            && self.audio.is_none_or(|samples| (1..=most).contains(&samples))
            && self.text.is_none_or(|bytes| (1..=config.text.longest_bytes).contains(&bytes));
        if ok { Ok(()) } else { Err(MarkError::Plan(format!("heads {self:?} do not fit the settings"))) }
    }
}

/// A signal as numbers, one list a head: what a head is to say, or what it said.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Numbers {
    /// `side x side x 3`.
    pub(crate) picture: Option<Vec<f32>>,
    /// Samples.
    pub(crate) audio: Option<Vec<f32>>,
    /// Bits, 0 or 1, or their logits.
    pub(crate) text: Option<Vec<f32>>,
}

impl Numbers {
    /// What the heads are to say of `signal`; nothing where it has nothing for one.
    pub(crate) fn of(signal: &Signal, sizes: &HeadSizes, side: usize) -> Self {
        let padded = |(sound, samples): (&Sound, usize)| {
            let mut all = sound.samples().to_vec();
            all.resize(samples, 0.0);
            all
        };
        Self {
            picture: signal.picture.as_ref().map(|p| shrunk(p, side)),
            audio: signal.audio.as_ref().zip(sizes.audio).map(padded),
            text: signal.text.as_ref().zip(sizes.text).map(|(text, bytes)| text_bits(text, bytes)),
        }
    }

    /// What the heads said, as people see, hear and read it.
    pub(crate) fn signal(self, side: usize, sample_rate_hz: u32) -> Result<Signal, MarkError> {
        let plan = |e: &dyn std::fmt::Display| MarkError::Plan(e.to_string());
        let picture = self.picture.map(|rgb| Picture::new(side, side, rgb).map(Picture::clamped));
        let audio = self.audio.map(|mut samples| {
            samples.iter_mut().for_each(|v| *v = v.clamp(-1.0, 1.0));
            Sound::new(samples, sample_rate_hz)
        });
        Ok(Signal {
            picture: picture.transpose().map_err(|e| plan(&e))?,
            audio: audio.transpose().map_err(|e| plan(&e))?,
            // Broken bytes show as U+FFFD and do not hide the whole ones beside them.
            text: self.text.map(|bits| String::from_utf8_lossy(&text_bytes(&bits)).into_owned()),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sound(samples: usize) -> Sound {
        Sound::new(vec![0.25; samples], 16_000).unwrap()
    }

    #[test]
    fn heads_are_as_long_as_the_longest_signal_and_no_more_than_are_used() {
        let config = Recipe::default();
        let picture = Signal::from(Picture::constant(4, 4, [0.5; 3]));
        assert_eq!(HeadSizes::of(&[picture], &config), HeadSizes { picture: true, ..HeadSizes::default() });
        let spoken = |n| Signal { audio: Some(sound(n)), ..Signal::default() };
        let written = Signal { text: Some("Éva".into()), ..Signal::default() };
        let sizes = HeadSizes::of(&[spoken(200), spoken(300), written.clone()], &config);
        assert_eq!(sizes, HeadSizes { picture: false, audio: Some(512), text: Some(4) });
        assert_eq!(sizes.count(), 2);
        // Ready for anything: what nobody hides has room for the longest.
        let ready = Recipe { unused_heads: true, ..config.clone() };
        let sizes_of_all = HeadSizes::of(&[spoken(300)], &ready);
        let text = Some(config.text.longest_bytes);
        assert_eq!(sizes_of_all, HeadSizes { picture: true, audio: Some(512), text });
        assert_eq!(
            HeadSizes::of(std::slice::from_ref(&written), &ready).audio,
            Some(64_000usize.next_multiple_of(256))
        );
        sizes_of_all.check(&ready).unwrap();
        let numbers = Numbers::of(&spoken(200), &sizes, 32);
        let audio = numbers.audio.as_ref().unwrap();
        assert_eq!((audio.len(), audio[199], audio[200], numbers.text.is_none()), (512, 0.25, 0.0, true));
        let said = Numbers {
            text: Numbers::of(&written, &sizes, 32).text.map(|b| b.iter().map(|v| v - 0.5).collect()),
            ..numbers
        };
        let said = said.signal(32, 16_000).unwrap();
        assert_eq!((said.text.as_deref(), said.audio.unwrap().samples().len()), (Some("Éva"), 512));
    }

    #[test]
    fn pictures_on_which_nothing_is_seen_are_refused() {
        let config = Recipe::default();
        let check = |picture: Picture| Signal::from(picture).check(3, &config).map_err(|e| e.to_string());
        for (colour, named) in [([0.0; 3], "0, 0, 0"), ([1.0; 3], "255, 255, 255"), ([1.0, 0.0, 0.4], "255, 0, 102")] {
            let error = check(Picture::constant(40, 40, colour)).unwrap_err();
            assert!(["identity 3", "nearly one colour", named].iter().all(|part| error.contains(part)), "{error}");
        }
        // A black dot of a few pixels on white is seen.
        let mut dot = Picture::constant(128, 128, [1.0; 3]);
        dot.rgb_mut()[..3 * 8].fill(0.0);
        check(dot).unwrap();
    }

    #[test]
    fn what_cannot_be_hidden_is_refused_by_name() {
        let config = Recipe::default();
        let says = |signal: Signal, expected: &[&str]| {
            let error = signal.check(2, &config).unwrap_err().to_string();
            assert!(error.contains("identity 2") && expected.iter().all(|part| error.contains(part)), "{error}");
        };
        let text = |text: &str| Signal { text: Some(text.into()), ..Signal::default() };
        says(Signal::default(), &["picture, a sound or a text"]);
        says(text(&"x".repeat(257)), &["257 bytes", "training.payload_text_bytes", "256"]);
        says(text(""), &["empty text"]);
        says(text("a\0b"), &["zero byte at 1"]);
        let long = Signal { audio: Some(sound(5 * 16_000)), ..Signal::default() };
        says(long, &["5.00 s", "training.payload_sound_s", "4 s"]);
        let silent = Sound::new(vec![0.0; 9], 16_000).unwrap();
        says(Signal { audio: Some(silent), ..Signal::default() }, &["silence"]);
        let other = Signal { audio: Some(Sound::new(vec![0.5], 8000).unwrap()), ..Signal::default() };
        says(other, &["8000 Hz", "training.payload_sound_hz", "16000"]);
        assert!(text("ok").check(1, &config).is_ok());
    }
}
