//! What identities hide, as files: as people give it, as it is kept beside a job,
//! and as it is published with a model. A signal's parts lie side by side, as
//! `signal-<n>.png`, `.wav` and `.txt`; most signals have one of them.

use std::path::Path;

use cairn_durable::{read_limited, write_atomic};
use cairn_log::Digest;
use cairn_mark::{Recipe, Signal};
use cairn_scene::{SoundLimits, decode_wav, encode_png, encode_wav, save_png};
use serde::{Deserialize, Serialize};

use crate::error::EngineError;
use crate::store::checked::read_checked;

/// Largest file of a published signal's part, bytes.
const MAX_PART_BYTES: u64 = 16 << 20;
/// Largest file of a part beside a job, bytes.
const MAX_GIVEN_BYTES: u64 = 1 << 30;

/// One of each for a signal's picture, sound and text, where it has them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Parts<T> {
    /// The picture's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub picture: Option<T>,
    /// The sound's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub audio: Option<T>,
    /// The text's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub text: Option<T>,
}

// Derived, it would ask `T` for a default.
impl<T> Default for Parts<T> {
    fn default() -> Self {
        Self { picture: None, audio: None, text: None }
    }
}

impl<T> Parts<T> {
    /// Each that is there, made into something else.
    pub fn map<U>(&self, f: impl Fn(&T) -> U) -> Parts<U> {
        Parts {
            picture: self.picture.as_ref().map(&f),
            audio: self.audio.as_ref().map(&f),
            text: self.text.as_ref().map(&f),
        }
    }

    /// What `of` makes of each that is there and the name of its file, as signal `number`'s.
    fn files<U, E>(&self, number: usize, of: impl Fn(&str, &T) -> Result<U, E>) -> Result<Parts<U>, E> {
        let file = |ending: &str, part: &Option<T>| {
            part.as_ref().map(|part| of(&format!("signal-{number}.{ending}"), part)).transpose()
        };
        Ok(Parts {
            picture: file("png", &self.picture)?,
            audio: file("wav", &self.audio)?,
            text: file("txt", &self.text)?,
        })
    }
}

/// Which parts a job's signal has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Kinds {
    /// A picture.
    pub picture: bool,
    /// A sound.
    pub audio: bool,
    /// A text.
    pub text: bool,
}

/// Which parts `signal` has.
pub fn kinds_of(signal: &Signal) -> Kinds {
    Kinds { picture: signal.picture.is_some(), audio: signal.audio.is_some(), text: signal.text.is_some() }
}

/// The files of `signal`'s parts: an 8-bit PNG, a 16-bit mono WAV, UTF-8.
pub fn encoded(signal: &Signal) -> Parts<Vec<u8>> {
    Parts {
        picture: signal.picture.as_ref().map(encode_png),
        audio: signal.audio.as_ref().map(encode_wav),
        text: signal.text.as_ref().map(|t| t.as_bytes().to_vec()),
    }
}

/// Writes signal `number` beside a job.
///
/// # Errors
/// The file system's; [`EngineError::Stored`] for a file that is not as it was written.
pub fn keep(folder: &Path, number: usize, signal: &Signal) -> Result<(), EngineError> {
    // Refuses a picture that is not finite.
    if let Some(picture) = &signal.picture {
        save_png(&folder.join(format!("signal-{number}.png")), picture)?;
    }
    write(folder, number, &Parts { picture: None, ..encoded(signal) })
}

/// Reads back what [`keep`] wrote, as it is to be hidden.
///
/// # Errors
/// The file system's; [`EngineError::Stored`] for a file that is not as it was written.
pub fn kept(folder: &Path, number: usize, kinds: Kinds, mark: &Recipe) -> Result<Signal, EngineError> {
    let wanted = Parts {
        picture: kinds.picture.then_some(()),
        audio: kinds.audio.then_some(()),
        text: kinds.text.then_some(()),
    };
    let files = wanted.files(number, |name, ()| read_limited(&folder.join(name), MAX_GIVEN_BYTES))?;
    let mut signal = decoded_within(&files, MAX_GIVEN_BYTES)?;
    let side = mark.side_px();
    signal.picture = signal.picture.map(|p| p.resized(side, side));
    Ok(signal)
}

/// Writes the files of signal `number` into a model's folder.
///
/// # Errors
/// The file system's; [`EngineError::Stored`] for a file that is not as it was written.
pub fn write(folder: &Path, number: usize, files: &Parts<Vec<u8>>) -> Result<(), EngineError> {
    files.files(number, |name, bytes| write_atomic(&folder.join(name), bytes))?;
    Ok(())
}

/// The files of signal `number` in a model's folder, each held to its digest.
///
/// # Errors
/// [`EngineError::Stored`] for one that was altered.
pub fn read(folder: &Path, number: usize, digests: &Parts<Digest>) -> Result<Parts<Vec<u8>>, EngineError> {
    digests.files(number, |name, digest| read_checked(&folder.join(name), digest, MAX_PART_BYTES))
}

/// What published files hold.
///
/// # Errors
/// For one that does not decode.
pub fn decoded(files: &Parts<Vec<u8>>) -> Result<Signal, EngineError> {
    decoded_within(files, MAX_PART_BYTES)
}

/// As [`decoded`], of files of `max_file_bytes` at most.
fn decoded_within(files: &Parts<Vec<u8>>, max_file_bytes: u64) -> Result<Signal, EngineError> {
    let limits = SoundLimits { max_file_bytes, longest_s: f64::INFINITY };
    // Files that the daemon wrote itself, some under larger limits than it has now.
    let pictures =
        cairn_scene::Limits { max_file_bytes, max_pixels: 1_000_000_000, max_side_px: 65_536, ..Default::default() };
    let picture = |bytes: &Vec<u8>| cairn_scene::decode_picture(bytes, &pictures, None);
    let text = |bytes: &Vec<u8>| {
        String::from_utf8(bytes.clone()).map_err(|e| EngineError::Internal(format!("a hidden text is no UTF-8: {e}")))
    };
    Ok(Signal {
        picture: files.picture.as_ref().map(picture).transpose()?,
        audio: files.audio.as_ref().map(|bytes| decode_wav("the hidden sound", bytes, &limits)).transpose()?,
        text: files.text.as_ref().map(text).transpose()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_scene::{Picture, Sound};

    fn signal() -> Signal {
        Signal {
            picture: Some(Picture::constant(40, 40, [1.0, 0.0, 0.4])),
            audio: Some(Sound::new((0..800).map(|i| (i % 50) as f32 / 64.0).collect(), 16_000).unwrap()),
            text: Some("photographed by Éva".into()),
        }
    }

    #[test]
    fn a_signal_kept_is_the_signal() {
        let dir = tempfile::tempdir().unwrap();
        let (mark, signal) = (Recipe::default(), signal());
        keep(dir.path(), 3, &signal).unwrap();
        let again = kept(dir.path(), 3, kinds_of(&signal), &mark).unwrap();
        assert_eq!((&again.audio, &again.text), (&signal.audio, &signal.text));
        assert_eq!(again.picture.unwrap().width(), mark.side_px());
        let text = Signal { text: signal.text.clone(), ..Signal::default() };
        assert_eq!(kept(dir.path(), 3, kinds_of(&text), &mark).unwrap(), text);
        // One that is to be there and is not.
        std::fs::remove_file(dir.path().join("signal-3.wav")).unwrap();
        assert!(kept(dir.path(), 3, kinds_of(&signal), &mark).is_err());
    }

    #[test]
    fn published_parts_are_held_to_their_digests() {
        let dir = tempfile::tempdir().unwrap();
        let files = encoded(&signal());
        let digests = files.map(|bytes| Digest::of(bytes));
        write(dir.path(), 1, &files).unwrap();
        assert_eq!(read(dir.path(), 1, &digests).unwrap(), files);
        std::fs::write(dir.path().join("signal-1.txt"), "photographed by somebody else").unwrap();
        let error = read(dir.path(), 1, &digests).unwrap_err().to_string();
        assert!(error.contains("signal-1.txt") && error.contains("altered"), "{error}");
    }
}
