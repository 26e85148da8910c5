//! The trained detector and classifier: what a picture says of its owner.

use crate::attack::Distortion;
use crate::detect::blind::networks::Networks;
use crate::detect::blind::out_of_distribution::OutOfDistribution;
use crate::error::MarkError;
use crate::marked::stored;
use crate::payload::{HeadSizes, Signal};
use crate::stega::recipe::Recipe;
use crate::stega::window::LEAST;
use crate::tensors::{shrunk, to_tensor, winner};
use cairn_field::{Part, packed, read_header};
use cairn_nn::Params;
use cairn_scene::Picture;
use safetensors::tensor::{Dtype, SafeTensors};
use serde::{Deserialize, Serialize};

/// Format of a stored detector; another version is refused by name.
pub const DETECTOR_FORMAT: &str = "cairn.detector/8";

/// How much of each side the center crops keep, tried one after another; none keeps less than the parts that training shows.
const MIDDLES: [f32; 2] = [0.75, 0.6];
const _: () = assert!(MIDDLES[1] as f64 >= LEAST - 1e-6);

/// F_psi and Fc_psi after training.
pub struct Detector {
    config: Recipe,
    networks: Networks,
}

/// What a picture says.
#[derive(Clone, Debug)]
pub struct Detection {
    /// The identity with the largest probability; `None` for unmarked, and where it is not as sure as has to be ([`Recipe::min_confidence`]).
    pub identity: Option<u32>,
    /// Probability of each class; class 0 is `unmarked`.
    pub probabilities: Vec<f32>,
    /// Whether a center crop gave the identity ([`Recipe::center_crop_confidence`]): all else here is then of that crop.
    pub is_center_crop: bool,
    /// The recovered signal, of all that the detector has heads for: a picture,
    /// side x side in [0, 1]; a sound of the head's length; a text. Where nothing is
    /// hidden they are black, silent and empty.
    pub recovered: Signal,
    /// The recovered text's bytes as they were read, which need not be UTF-8: in the
    /// signal each broken one shows as U+FFFD, which is three bytes long.
    pub text_bytes: Option<Vec<u8>>,
}

#[derive(Serialize, Deserialize)]
struct Header {
    format: String,
    classes: usize,
    heads: HeadSizes,
    config: Recipe,
}

impl Detector {
    pub(crate) fn new(config: Recipe, networks: Networks) -> Self {
        Self { config, networks }
    }

    /// How it was trained.
    pub(crate) fn config(&self) -> &Recipe {
        &self.config
    }

    /// What it has learnt.
    pub(crate) fn params(&self) -> &Params {
        &self.networks.params
    }

    /// M + 1.
    pub fn classes(&self) -> usize {
        self.networks.classifier.classes()
    }

    /// Which heads it has, and how long they are.
    pub fn heads(&self) -> &HeadSizes {
        self.networks.detector.sizes()
    }

    /// Side of recovered pictures, px.
    pub fn side_px(&self) -> usize {
        self.config.side_px()
    }

    /// Classifies `picture` (any size) and recovers what it hides. What says nothing surely as a whole is looked at
    /// more closely ([`Recipe::center_crop_confidence`]).
    ///
    /// # Errors
    /// [`MarkError::Plan`] when a number of the picture is not finite,
    /// [`MarkError::NotFinite`] when one of the answer is not.
    pub fn detect(&self, picture: &Picture) -> Result<Detection, MarkError> {
        self.read(picture, None)
    }

    /// As [`Detector::detect`], with `class` told to the detector in place of the
    /// classifier's answer. On pictures without a mark this shows what the
    /// detector knows by heart.
    ///
    /// # Errors
    /// As [`Detector::detect`]; [`MarkError::Plan`] for a class there is not.
    pub fn detect_forced(&self, picture: &Picture, class: usize) -> Result<Detection, MarkError> {
        if class >= self.classes() {
            return Err(MarkError::Plan(format!("class {class} of {}; give one below", self.classes())));
        }
        self.read(picture, Some(class))
    }

    fn read(&self, picture: &Picture, forced: Option<usize>) -> Result<Detection, MarkError> {
        if let Some(at) = picture.rgb().iter().position(|v| !v.is_finite()) {
            let (x, y) = (at / 3 % picture.width(), at / 3 / picture.width());
            return Err(MarkError::Plan(format!("pixel ({x}, {y}) is not finite; send another picture")));
        }
        let Seen { shown: seen, probabilities, class, is_center_crop } = self.seen(picture, forced.is_none())?;
        let images = to_tensor(&[seen], self.config.shown_px())?;
        let hidden = self.networks.hidden(&images, &[forced.unwrap_or(class)])?.pop();
        let hidden = hidden.ok_or_else(|| MarkError::Plan("no answer".into()))?;
        let text_bytes = hidden.text.as_deref().map(cairn_nn::text_bytes);
        let recovered = hidden.signal(self.side_px(), self.config.audio.sample_rate_hz)?;
        Ok(Detection {
            identity: (class > 0).then_some(class as u32),
            probabilities,
            is_center_crop,
            recovered,
            text_bytes,
        })
    }

    /// Whether a picture that says nothing surely is looked at more closely: where nothing doubts the classifier, each further look is a
    /// further chance of its being surely wrong.
    fn looks_closer(&self) -> bool {
        self.config.center_crop_confidence < 1.0
            && self.config.has_classifier()
            && self.networks.out_of_distribution.is_some()
    }

    /// What of `picture` is read, and what class it is told to be of: the whole, or where that says nothing surely and
    /// a closer look is asked for, the middle that an owner is told in. From afar, or beside much that bears no mark, a
    /// mark is too little of a picture to be told from the whole of it.
    fn seen(&self, picture: &Picture, may_look_closer: bool) -> Result<Seen, MarkError> {
        let (closer, shown) = (self.config.center_crop_confidence as f32, self.config.shown_px());
        let odds = |seen: &[Vec<f32>]| self.networks.odds(&to_tensor(seen, shown)?);
        let whole = shrunk(picture, shown);
        let of_whole = odds(std::slice::from_ref(&whole))?.pop().ok_or_else(|| MarkError::Plan("no answer".into()))?;
        let likeliest = winner(&of_whole);
        let seen = |class| Seen { shown: whole, probabilities: of_whole.clone(), class, is_center_crop: false };
        let is_sure = likeliest > 0 && of_whole[likeliest] >= self.config.min_confidence as f32;
        if is_sure || !self.looks_closer() {
            return Ok(seen(likeliest));
        }
        if !may_look_closer {
            return Ok(seen(0));
        }
        let middle = |kept| shrunk(&Distortion::Crop { kept, across: 0.5, down: 0.5 }.apply(picture, 0), shown);
        let mut middles = MIDDLES.map(middle);
        let mut of_middles = odds(&middles)?;
        Ok(match told_in(&of_middles, closer, likeliest) {
            Some((at, class)) => Seen {
                shown: std::mem::take(&mut middles[at]),
                probabilities: of_middles.swap_remove(at),
                class,
                is_center_crop: true,
            },
            None => seen(0),
        })
    }

    /// As safetensors. Equal detectors give equal bytes.
    ///
    /// # Errors
    /// [`MarkError::Field`] when it cannot be written out.
    pub fn to_bytes(&self) -> Result<Vec<u8>, MarkError> {
        let header = Header {
            format: DETECTOR_FORMAT.into(),
            classes: self.classes(),
            heads: *self.heads(),
            config: self.config.clone(),
        };
        let mut parts = vec![("parameters".to_owned(), self.networks.params.to_bytes()?)];
        parts.extend(self.networks.out_of_distribution.iter().flat_map(OutOfDistribution::parts));
        Ok(packed("detector", &header, parts.iter().map(|(name, bytes)| Part::row(name, Dtype::U8, bytes)))?)
    }

    /// Reads what [`Detector::to_bytes`] wrote.
    ///
    /// # Errors
    /// [`MarkError::Field`] for an unknown format, [`MarkError::Stored`] for a damaged file.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, MarkError> {
        let header: Header = read_header(bytes, "detector", DETECTOR_FORMAT)?;
        header.config.validate()?;
        header.heads.check(&header.config)?;
        let bad = |e: safetensors::SafeTensorError| stored("detector", e.to_string());
        let file = SafeTensors::deserialize(bytes).map_err(bad)?;
        let params = Params::from_bytes(file.tensor("parameters").map_err(bad)?.data())?;
        let mut networks = Networks::with(&header.config, header.classes, header.heads, params)?;
        networks.out_of_distribution =
            OutOfDistribution::from_file(&file, header.classes, networks.classifier.feature_count())?;
        Ok(Self { config: header.config, networks })
    }
}

/// What was looked at of a picture.
struct Seen {
    /// As the networks are shown it.
    shown: Vec<f32>,
    probabilities: Vec<f32>,
    /// The class it is told to be of.
    class: usize,
    /// Whether it is a middle.
    is_center_crop: bool,
}

/// The first of some parts' class probabilities in which an owner is told, with `least` at least, and the owner: the one that is
/// the `likeliest` of the whole, where that is any. Who is told by the one and not by the other is not named.
fn told_in(parts: &[Vec<f32>], least: f32, likeliest: usize) -> Option<(usize, usize)> {
    let told = parts.iter().map(|odds| (winner(odds), odds[winner(odds)]));
    let mut told = told.enumerate().filter(|(_, (class, odds))| *class > 0 && *odds >= least);
    told.next().map(|(at, (class, _))| (at, class)).filter(|(_, class)| likeliest == 0 || *class == likeliest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_owner_is_named_who_is_told_surely_enough_in_the_larger_middle_first() {
        let told = |parts: [[f32; 3]; 2], likeliest| told_in(&parts.map(|odds| odds.to_vec()), 0.9, likeliest);
        let (nobody, one, other) = ([0.95, 0.03, 0.02], [0.05, 0.92, 0.03], [0.01, 0.01, 0.98]);
        assert_eq!(told([one, other], 0), Some((0, 1)), "the larger one, if less sure");
        assert_eq!(told([nobody, other], 0), Some((1, 2)));
        assert_eq!(told([[0.1, 0.9, 0.0], nobody], 0), Some((0, 1)), "as sure as is asked for");
        assert_eq!(told([[0.12, 0.88, 0.0], [0.2, 0.0, 0.8]], 0), None, "surer than anything else is not enough");
        assert_eq!(told([nobody, nobody], 0), None, "sure that there is none");
        assert_eq!((told([one, nobody], 1), told([nobody, other], 2)), (Some((0, 1)), Some((1, 2))));
        assert_eq!((told([one, nobody], 2), told([one, other], 2)), (None, None), "another than the whole tells");
    }
}
