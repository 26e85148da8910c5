//! The trained detector and classifier: what a picture says of its owner.

use crate::config::{CarrierKind, MarkConfig, MaskKind};
use crate::distort::Distortion;
use crate::error::MarkError;
use crate::familiar::Familiar;
use crate::judge::winner;
use crate::marked::{read_header, stored};
use crate::negatives::shrunk;
use crate::networks::{Networks, to_tensor};
use crate::signal::{HeadSizes, Signal};
use cairn_capture::Picture;
use cairn_nn::Params;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;

/// Format of a stored detector: 4 since it knows where its owners' renders lie, 5 since its settings say how finely its
/// classifier looks and which views came and went. Another number is refused by name, but for 3 and 4.
pub const DETECTOR_FORMAT: &str = "cairn.detector/5";
/// Those that are read.
const DETECTOR_FORMATS: [&str; 3] = ["cairn.detector/3", "cairn.detector/4", DETECTOR_FORMAT];

/// How much of each side the middles keep that a closer look is at, one after another. Training shows parts of
/// three fifths of a side and more (`window.rs`).
const MIDDLES: [f32; 2] = [0.75, 0.6];

/// F_psi and Fc_psi after training.
pub struct Detector {
    config: MarkConfig,
    networks: Networks,
}

/// What a picture says.
#[derive(Clone, Debug)]
pub struct Detection {
    /// The identity with the largest probability; `None` for unmarked.
    pub identity: Option<u32>,
    /// Probability of each class; class 0 is `unmarked`.
    pub probabilities: Vec<f32>,
    /// Whether only a closer look found the owner ([`MarkConfig::closer_look`]): all else said here is then of the picture's middle.
    pub is_closer: bool,
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
    config: MarkConfig,
}

impl Detector {
    pub(crate) fn new(config: MarkConfig, networks: Networks) -> Self {
        Self { config, networks }
    }

    /// How it was trained.
    pub(crate) fn config(&self) -> &MarkConfig {
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

    /// Classifies `picture` (any size) and recovers what it hides. What says nothing as a whole is looked at
    /// more closely ([`MarkConfig::closer_look`]).
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
        let shown = self.config.shown_px();
        let read = |seen| {
            let answer = self.networks.read(&[seen], shown, forced)?.pop();
            answer.ok_or_else(|| MarkError::Plan("no answer".into()))
        };
        let mut answer = read(shrunk(picture, shown))?;
        let is_silent = forced.is_none() && winner(&answer.0) == 0;
        let closer = if is_silent { self.closer(picture)? } else { None };
        let is_closer = closer.is_some();
        if let Some(middle) = closer {
            answer = read(middle)?;
        }
        let (probabilities, hidden) = answer;
        let text_bytes = hidden.text.as_deref().map(cairn_nn::text_bytes);
        let recovered = hidden.signal(self.side_px(), self.config.audio.sample_rate_hz)?;
        let class = winner(&probabilities);
        Ok(Detection { identity: (class > 0).then_some(class as u32), probabilities, is_closer, recovered, text_bytes })
    }

    /// The largest middle of `picture` in which an owner is told surely enough, as the networks are shown it. From afar, or beside much
    /// that bears no mark, a mark is too little of a picture to be told from the whole of it.
    fn closer(&self, picture: &Picture) -> Result<Option<Vec<f32>>, MarkError> {
        let (least, shown) = (self.config.closer_look as f32, self.config.shown_px());
        if least >= 1.0 || !self.config.has_classifier() {
            return Ok(None);
        }
        let middle = |kept| Distortion::Crop { kept, across: 0.5, down: 0.5 }.apply(picture, 0);
        let middles = MIDDLES.map(|kept| shrunk(&middle(kept), shown));
        let odds = self.networks.odds(&to_tensor(&middles, shown)?)?;
        let is_told = |odds: &Vec<f32>| winner(odds) > 0 && odds[winner(odds)] >= least;
        Ok(middles.into_iter().zip(&odds).find_map(|(middle, odds)| is_told(odds).then_some(middle)))
    }

    /// As safetensors. Equal detectors give equal bytes.
    ///
    /// # Errors
    /// [`MarkError::Stored`] when it cannot be written out.
    pub fn to_bytes(&self) -> Result<Vec<u8>, MarkError> {
        let header = Header {
            format: DETECTOR_FORMAT.into(),
            classes: self.classes(),
            heads: *self.heads(),
            config: self.config.clone(),
        };
        let bad = |e: safetensors::SafeTensorError| stored("detector", e.to_string());
        let params = self.networks.params.to_bytes()?;
        let mut parts = vec![("parameters".to_owned(), params)];
        parts.extend(self.networks.familiar.iter().flat_map(|familiar| familiar.parts()));
        let mut tensors = Vec::with_capacity(parts.len());
        for (name, bytes) in &parts {
            tensors.push((name.as_str(), TensorView::new(Dtype::U8, vec![bytes.len()], bytes).map_err(bad)?));
        }
        let json = serde_json::to_string(&header).map_err(|e| stored("detector", e.to_string()))?;
        safetensors::serialize(tensors, Some(HashMap::from([("cairn".to_owned(), json)]))).map_err(bad)
    }

    /// Reads what [`Detector::to_bytes`] wrote.
    ///
    /// # Errors
    /// [`MarkError::Stored`] for an unknown format or a damaged file.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, MarkError> {
        let mut header: Header = read_header(bytes, "detector")?;
        if !DETECTOR_FORMATS.contains(&header.format.as_str()) {
            let why = format!("format `{}`, this program reads `{DETECTOR_FORMAT}`", header.format);
            return Err(stored("detector", why));
        }
        // Refused of late: it was no mask, and marks that were trained so are out in the world.
        if header.config.mask == MaskKind::PerCoefficientGroup && header.config.carrier == CarrierKind::PerCluster {
            header.config.mask = MaskKind::None;
        }
        header.config.validate()?;
        header.heads.check(&header.config)?;
        let bad = |e: safetensors::SafeTensorError| stored("detector", e.to_string());
        let file = SafeTensors::deserialize(bytes).map_err(bad)?;
        let params = Params::from_bytes(file.tensor("parameters").map_err(bad)?.data())?;
        let mut networks = Networks::with(&header.config, header.classes, header.heads, params)?;
        networks.familiar = Familiar::from_file(&file, header.classes, networks.classifier.feature_count())?;
        Ok(Self { config: header.config, networks })
    }
}
