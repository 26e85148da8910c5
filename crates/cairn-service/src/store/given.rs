//! What people bring to hide: made ready as it will be hidden, before anything is trained, and told whose it is.

use std::collections::BTreeSet;

use cairn_mark::{Recipe, Signal};
use cairn_scene::{Ground, ImageFormat, SoundLimits, decode_emblem, decode_wav};

use crate::config::Limits;
use crate::error::EngineError;
use crate::store::hidden::{Kinds, Parts, kinds_of};

/// Sounds quieter than this are likely to come back below 25 dB of signal to noise: trex's spoken credit, of -20.6 dB, came
/// back at 45 (docs/design/limits.md), so that what its detector added lay some 66 dB below full scale. RMS, dB of full scale.
pub const QUIET_DB: f64 = -41.0;
/// How far over full scale a peak may be before people are told that it is cut, dB.
const CUT_DB: f64 = 0.1;

/// What somebody gives to hide: a picture of any [`ImageFormat`], a WAV, a text.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Given {
    /// What it is called, as its files are without their endings; empty where nobody says.
    pub name: String,
    /// The files' bytes.
    pub parts: Parts<Vec<u8>>,
}

/// An identity that is to be marked.
#[derive(Clone, Debug)]
pub struct Added {
    /// What people call it: its number, label and, where there are several scenes, scene.
    pub called: String,
    /// Its number in its scene.
    pub number: usize,
    /// Its label, as trainings name it.
    pub label: String,
}

impl Given {
    /// The signal of identity `number`, as it is kept: pictures at the detector's size in 8 bits, sounds at the rate
    /// that `mark` asks for in 16; and what there is to say of it.
    ///
    /// # Errors
    /// For what does not decode, is over the limits, or cannot be hidden; each names the identity and the file.
    pub fn signal(&self, number: usize, mark: &Recipe, limits: &Limits) -> Result<(Signal, Vec<String>), EngineError> {
        let whose = match self.name.as_str() {
            "" => format!("of identity {number}"),
            name => format!("of identity {number} ({name})"),
        };
        let mut notes = Vec::new();
        let picture = match &self.parts.picture {
            None => None,
            Some(bytes) => {
                let what = format!("the picture {whose}");
                let (picture, ground) = picture(&what, bytes, mark.side_px(), limits)?;
                notes.extend(ground.map(|ground| format!("{what} is transparent in places and is hidden on {ground}")));
                Some(picture)
            }
        };
        let audio = match &self.parts.audio {
            None => None,
            Some(bytes) => {
                let what = format!("the sound {whose}");
                let (max_file_bytes, longest_s) = (limits.max_photograph_bytes, mark.audio.longest_s);
                let sound = decode_wav(&what, bytes, &SoundLimits { max_file_bytes, longest_s })?;
                let sound = sound.resampled(mark.audio.sample_rate_hz)?;
                notes.extend(level_note(&what, sound.peak_db(), sound.rms_db()));
                Some(sound.in_16_bits())
            }
        };
        let text = match &self.parts.text {
            None => None,
            Some(bytes) => Some(String::from_utf8(bytes.clone()).map_err(|e| {
                let got = format!("no UTF-8 from byte {}", e.utf8_error().valid_up_to());
                EngineError::invalid(format!("the text {whose}"), got, "UTF-8")
            })?),
        };
        let signal = Signal { picture, audio, text };
        signal.check(number, mark)?;
        Ok((signal, notes))
    }
}

/// The picture that errors call `what`, and what is behind what is transparent of it, if anything is.
fn picture(
    what: &str,
    bytes: &[u8],
    side: usize,
    limits: &Limits,
) -> Result<(cairn_scene::Picture, Option<&'static str>), EngineError> {
    let (key, most) = ("limits.max_photograph_bytes", limits.max_photograph_bytes);
    EngineError::within(format!("{what} in bytes"), key, most, bytes.len() as u64)?;
    let (picture, ground) = decode_emblem(bytes, &limits.of_pictures(), side).map_err(|e| {
        let expected = format!("a picture ({}) within the limits", ImageFormat::names());
        EngineError::invalid(what, format!("not read ({e})"), expected)
    })?;
    let ground = match ground {
        Ground::None => None,
        Ground::White => Some("white"),
        Ground::Black => Some("black, since too little of it would show on white"),
    };
    Ok((picture, ground))
}

/// What to say of a sound's level, which people hear only once it is recovered.
fn level_note(what: &str, peak_db: f64, rms_db: f64) -> Option<String> {
    if peak_db > CUT_DB {
        return Some(format!(
            "{what} goes {peak_db:.1} dB over full scale and is cut off there, which is heard: bring it quieter by that much"
        ));
    }
    (rms_db < QUIET_DB && rms_db.is_finite()).then(|| {
        format!(
            "{what} is quiet ({rms_db:.0} dB of full scale, RMS): below {QUIET_DB:.0} dB it is not likely to come back 25 dB above what \
             is added to it: bring it louder"
        )
    })
}

/// Which of `given` each identity of `added` hides, as places in `given`: nothing where nothing is given. Those that are all
/// called as identities are labelled go by that, otherwise all go by their order, and those beyond the last identity are
/// nobody's ([`left_over_note`]). `marked` are the labels of identities that keep what they hide.
///
/// # Errors
/// [`EngineError::Invalid`] for fewer than there are identities, and for names of which only some are labels; each names
/// what does not fit and what would do.
pub fn assigned(given: &[Given], added: &[Added], marked: &BTreeSet<String>) -> Result<Vec<usize>, EngineError> {
    if given.is_empty() {
        return Ok(Vec::new());
    }
    let labels: BTreeSet<&str> = added.iter().map(|a| a.label.as_str()).collect();
    let (fitting, other): (Vec<&Given>, Vec<&Given>) = given.iter().partition(|g| labels.contains(g.name.as_str()));
    let is_marked = |g: &&Given| marked.contains(&g.name);
    if fitting.is_empty() && !other.iter().any(is_marked) {
        return by_order(given, added);
    }
    if !other.is_empty() {
        let said = |g: &&Given| match is_marked(g) {
            true => format!("{:?} (marked already, and keeps what it hides)", g.name),
            false => format!("{:?}", g.name),
        };
        let others = other.iter().map(said).collect::<Vec<_>>().join(", ");
        let (what, none) = match other.len() {
            1 => ("the name of a signal", "no identity has this name"),
            _ => ("the names of signals", "no identity has these names"),
        };
        let all = added.iter().map(|a| a.label.as_str()).collect::<Vec<_>>().join(", ");
        let expected = format!("one file named after each of {all}, or no file named after any of them");
        return Err(EngineError::invalid(what, format!("{others} ({none})"), expected));
    }
    let mut at = Vec::with_capacity(added.len());
    for identity in added {
        let mut places = (0..given.len()).filter(|at| given[*at].name == identity.label);
        match (places.next(), places.next()) {
            (Some(place), None) => at.push(place),
            (None, _) => {
                let got = format!("{}, and none for {}", names(&fitting), identity.called);
                let expected = format!("one for each of {}", called(added));
                return Err(EngineError::invalid("the names of the signals", got, expected));
            }
            (Some(_), Some(_)) => {
                let got = format!("{:?} twice", identity.label);
                return Err(EngineError::invalid("the names of the signals", got, "each name once"));
            }
        }
    }
    Ok(at)
}

/// [`assigned`], where no name is an identity's.
fn by_order(given: &[Given], added: &[Added]) -> Result<Vec<usize>, EngineError> {
    if given.len() < added.len() {
        let expected = format!("none, or one for each of the {} identities to mark: {}", added.len(), called(added));
        return Err(EngineError::invalid("the number of signals", given.len(), expected));
    }
    Ok((0..added.len()).collect())
}

/// What to say of those of `given` that nobody hides where identities hide those at the places `taken`; `None` where all are hidden.
pub fn left_over_note(given: &[Given], taken: &[usize]) -> Option<String> {
    let rest: Vec<&Given> = (0..given.len()).filter(|at| !taken.contains(at)).map(|at| &given[at]).collect();
    (!rest.is_empty()).then(|| format!("nobody hides {}: there are more signals than identities to mark", names(&rest)))
}

/// What to say of who hides what: `given` named, with its kinds.
pub fn hides_note(identity: &Added, given: &Given, signal: &Signal) -> String {
    let Kinds { picture, audio, text } = kinds_of(signal);
    let kinds = [(picture, "picture"), (audio, "sound"), (text, "text")];
    let kinds: Vec<&str> = kinds.into_iter().filter(|(there, _)| *there).map(|(_, kind)| kind).collect();
    match given.name.as_str() {
        "" => format!("{} hides a {}", identity.called, kinds.join(" and a ")),
        name => format!("{} hides {name} ({})", identity.called, kinds.join(" and ")),
    }
}

fn names(given: &[&Given]) -> String {
    let name = |g: &&Given| if g.name.is_empty() { "one without a name".into() } else { format!("{:?}", g.name) };
    given.iter().map(name).collect::<Vec<_>>().join(", ")
}

fn called(added: &[Added]) -> String {
    added.iter().map(|a| a.called.as_str()).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
#[path = "given_tests.rs"]
mod tests;
