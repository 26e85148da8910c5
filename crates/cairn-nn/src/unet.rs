//! The detector: a U-Net that draws the hidden picture. Its coarsest features serve
//! the other heads ([`crate::AudioHead`], [`crate::TextHead`]) as well.
//!
//! The class prediction enters twice (classifier-guided recovery): as flat
//! input channels, and as scale and shift of the coarsest features (FiLM, Perez
//! et al. 2018). Skip connections are added, not concatenated: at full
//! resolution that halves the costliest convolution.

use candle_core::{D, Tensor};
use serde::{Deserialize, Serialize};

use crate::classifier::check_sizes;
use crate::conv::{Window, conv2d};
use crate::error::{NnError, Result};
use crate::front::{front_channels, front_end};
use crate::layers::{ConvBlock, Linear, check_image};
use crate::params::{Init, Scope};
use crate::resample::upsample_add;

/// How a [`UNet`] is built.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UNetConfig {
    /// Channels of the input pictures.
    pub inputs: usize,
    /// Channels of the hidden pictures.
    pub outputs: usize,
    /// Rows and columns of the pictures; the memory is made for this size. Multiples of two to the power of levels - 1.
    pub size: [usize; 2],
    /// Channels of each level, finest first.
    pub channels: Vec<usize>,
    /// Groups of the normalisation, 0 for none.
    pub groups: usize,
    /// Amplification of the high-pass channels, 0 for none (see [`front_end`]).
    pub high_pass_gain: f32,
    /// What it may know of the hidden pictures by heart.
    pub memory: Memory,
    /// Multiplies the output by 1 - p(unmarked), so that unmarked means empty.
    pub gated: bool,
}

impl Default for UNetConfig {
    fn default() -> Self {
        Self {
            inputs: 3,
            outputs: 3,
            size: [128, 128],
            channels: vec![8, 16, 32, 48],
            groups: 4,
            high_pass_gain: 30.0,
            memory: Memory::PerClass,
            gated: true,
        }
    }
}

impl UNetConfig {
    /// Channels of the coarsest level, and its rows and columns.
    pub(crate) fn coarsest(&self) -> (usize, [usize; 2]) {
        let factor = 1 << (self.channels.len() - 1);
        (self.channels[self.channels.len() - 1], self.size.map(|s| s / factor))
    }
}

/// Unit of the memory of pictures, in levels of full scale 1: Adam moves every number by
/// about the learning rate, so that this is how much faster a memory is learnt than by itself.
const UNIT: f64 = 4.0;

/// What a detector may know of the hidden pictures by heart, in learned features
/// of its own that depend on the place in the picture. A faint mark on a scene
/// seen from anywhere carries tens of bits (method papers of 2023 to 2025 report
/// 32 to 48), a picture of 128 x 128 some hundred thousand: whatever the network,
/// most of a recovered picture comes out of it, and the render's part is to say
/// whose it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Memory {
    /// Nothing: all of it must come from the render.
    None,
    /// Features at the coarsest level, shared by all classes.
    Coarsest,
    /// A picture a class, which what is seen in the render is added to.
    #[default]
    PerClass,
}

/// Pictures and class probabilities to hidden pictures.
#[derive(Debug, Clone)]
pub struct UNet {
    config: UNetConfig,
    classes: usize,
    /// Finest first: what enters a level, and what works in it.
    down: Vec<Vec<ConvBlock>>,
    film: Linear,
    /// 1 x C x H x W at the coarsest level ([`Memory::Coarsest`]).
    positional: Option<Tensor>,
    decoder: Option<Decoder>,
}

/// What draws the picture.
#[derive(Debug, Clone)]
struct Decoder {
    /// M x (outputs H W) ([`Memory::PerClass`]).
    memory: Option<Tensor>,
    /// Coarsest first: to the next finer level's channels, and after the skip.
    up: Vec<[ConvBlock; 2]>,
    out: (Tensor, Tensor),
}

/// What a detector sees in pictures: what [`UNet::draw`] and the one-dimensional heads work on.
#[derive(Debug, Clone)]
pub struct Features {
    /// Finest first, without the coarsest.
    skips: Vec<Tensor>,
    coarsest: Tensor,
}

impl Features {
    /// Those of the coarsest level, N x C x h x w.
    pub fn coarsest(&self) -> &Tensor {
        &self.coarsest
    }
}

impl UNet {
    /// A detector told of `classes` = M + 1 classes, class 0 unmarked, with its
    /// parameters in `scope`.
    ///
    /// # Errors
    /// [`NnError::Setting`] for sizes out of range; when parameters of these
    /// names exist with other shapes.
    pub fn new(config: &UNetConfig, classes: usize, scope: Scope<'_>) -> Result<Self> {
        Self::build(config, classes, true, scope)
    }

    /// As [`UNet::new`], but without what draws pictures: [`UNet::features`] alone,
    /// for the other heads.
    ///
    /// # Errors
    /// As [`UNet::new`].
    pub fn encoder(config: &UNetConfig, classes: usize, scope: Scope<'_>) -> Result<Self> {
        Self::build(config, classes, false, scope)
    }

    fn build(config: &UNetConfig, classes: usize, draws: bool, mut scope: Scope<'_>) -> Result<Self> {
        check_sizes(config.inputs.min(config.outputs), &config.channels, classes, config.high_pass_gain)?;
        let factor = 1 << (config.channels.len() - 1);
        if config.size.iter().any(|s| *s == 0 || !s.is_multiple_of(factor)) {
            let allowed = "multiples of two to the power of levels - 1";
            return Err(NnError::Setting { key: "size", got: format!("{:?}", config.size), allowed });
        }
        let down = down_blocks(config, classes, &mut scope)?;
        let (coarsest, [h, w]) = config.coarsest();
        let film = Linear::new(&mut scope.sub("film"), classes, 2 * coarsest, Init::Uniform(0.1))?;
        scope.by_class("film.weight", 1, 0);
        let positional = match config.memory {
            Memory::Coarsest => Some(scope.get("positional", &[1, coarsest, h, w], Init::Uniform(0.1))?),
            Memory::None | Memory::PerClass => None,
        };
        let decoder = if draws { Some(Decoder::new(config, classes, &mut scope)?) } else { None };
        Ok(Self { config: config.clone(), classes, down, film, positional, decoder })
    }

    /// M + 1.
    pub fn classes(&self) -> usize {
        self.classes
    }

    /// [`UNet::draw`] of [`UNet::features`]: hidden pictures, N x outputs x H x W,
    /// neither squashed nor clamped, from `images`, N x inputs x H x W in [0, 1],
    /// and `probabilities`, N x (M + 1): softmax of the classifier's logits, or
    /// one-hot.
    ///
    /// # Errors
    /// [`NnError::Input`] for other shapes, and for an encoder alone.
    pub fn forward(&self, images: &Tensor, probabilities: &Tensor) -> Result<Tensor> {
        self.draw(&self.features(images, probabilities)?, probabilities)
    }

    /// What is seen in `images`, guided by `probabilities`, as [`UNet::forward`] takes them.
    ///
    /// # Errors
    /// [`NnError::Input`] for other shapes.
    pub fn features(&self, images: &Tensor, probabilities: &Tensor) -> Result<Features> {
        self.check_inputs(images, probabilities)?;
        let mut x = front_end(images, self.config.high_pass_gain, Some(probabilities))?;
        let mut skips = Vec::with_capacity(self.down.len());
        for (level, blocks) in self.down.iter().enumerate() {
            if level > 0 {
                skips.push(x.clone());
            }
            for (i, block) in blocks.iter().enumerate() {
                x = block.forward(&x)?;
                if level + 1 == self.down.len() && i == 0 {
                    x = self.guide(&x, probabilities)?;
                }
            }
        }
        Ok(Features { skips, coarsest: x })
    }

    /// The hidden pictures that `features` show, with the `probabilities` that they
    /// were made with.
    ///
    /// # Errors
    /// [`NnError::Input`] for other shapes, and for an encoder alone.
    pub fn draw(&self, features: &Features, probabilities: &Tensor) -> Result<Tensor> {
        let Some(decoder) = &self.decoder else {
            let (network, expected) = ("the detector", "nothing to draw: it was built as an encoder alone".into());
            return Err(NnError::Input { network, expected, got: features.coarsest.dims().to_vec() });
        };
        let raw = decoder.forward(features, probabilities)?;
        if !self.config.gated {
            return Ok(raw);
        }
        let gate = probabilities.narrow(D::Minus1, 0, 1)?.affine(-1.0, 1.0)?;
        Ok(raw.broadcast_mul(&gate.reshape((raw.dim(0)?, 1, 1, 1))?)?)
    }

    /// Scales, shifts and places the coarsest features.
    fn guide(&self, x: &Tensor, probabilities: &Tensor) -> Result<Tensor> {
        let (n, c, _, _) = x.dims4()?;
        let film = self.film.forward(probabilities)?.reshape((n, 2 * c, 1, 1))?;
        let scale = film.narrow(1, 0, c)?.affine(1.0, 1.0)?;
        let x = x.broadcast_mul(&scale)?.broadcast_add(&film.narrow(1, c, c)?)?;
        Ok(match &self.positional {
            Some(place) => x.broadcast_add(place)?,
            None => x,
        })
    }

    fn check_inputs(&self, images: &Tensor, probabilities: &Tensor) -> Result<()> {
        let network = "the detector";
        check_image(network, images, self.config.inputs, 1 << (self.down.len() - 1))?;
        let remembers = self.positional.is_some() || self.decoder.as_ref().is_some_and(|d| d.memory.is_some());
        if remembers && images.dims()[2..] != self.config.size {
            let expected = format!("pictures of {:?} pixels, the size of its memory", self.config.size);
            return Err(NnError::Input { network, expected, got: images.dims().to_vec() });
        }
        if probabilities.dims() != [images.dims()[0], self.classes] {
            let expected = format!("{} x {} class probabilities", images.dims()[0], self.classes);
            return Err(NnError::Input { network, expected, got: probabilities.dims().to_vec() });
        }
        Ok(())
    }
}

impl Decoder {
    fn new(config: &UNetConfig, classes: usize, scope: &mut Scope<'_>) -> Result<Self> {
        let (finest, [h, w]) = (config.channels[0], config.size);
        scope.by_class("memory", 0, -1);
        let memory = match config.memory {
            Memory::PerClass if classes > 1 => {
                Some(scope.get("memory", &[classes - 1, config.outputs * h * w], Init::Constant(0.0))?)
            }
            Memory::None | Memory::Coarsest | Memory::PerClass => None,
        };
        let up = up_blocks(config, scope)?;
        let weight = scope.get("out.weight", &[config.outputs, finest, 3, 3], Init::He { fan_in: finest * 9 * 4 })?;
        let out = (weight, scope.get("out.bias", &[config.outputs], Init::Constant(0.0))?);
        Ok(Self { memory, up, out })
    }

    fn forward(&self, features: &Features, probabilities: &Tensor) -> Result<Tensor> {
        let (mut x, mut skips) = (features.coarsest.clone(), features.skips.iter().rev());
        for [narrow, merge] in &self.up {
            x = narrow.forward(&x)?;
            if let Some(skip) = skips.next() {
                x = upsample_add(&x, skip)?;
            }
            x = merge.forward(&x)?;
        }
        let raw = conv2d(&x, &self.out.0, Some(&self.out.1), Window::square(1, 1))?;
        let Some(memory) = &self.memory else { return Ok(raw) };
        let told = (probabilities.narrow(1, 1, memory.dim(0)?)?.contiguous()? * UNIT)?;
        let known = told.matmul(memory)?;
        Ok((known.reshape(raw.shape())? + raw)?)
    }
}

/// One block at the finest level; below, one that halves the resolution and one more.
fn down_blocks(config: &UNetConfig, classes: usize, scope: &mut Scope<'_>) -> Result<Vec<Vec<ConvBlock>>> {
    let mut inputs = front_channels(config.inputs, config.high_pass_gain, classes);
    // The front end puts the classes behind the picture.
    scope.by_class("down0.0.weight", 1, (inputs - classes) as isize);
    let mut levels = Vec::with_capacity(config.channels.len());
    for (level, &c) in config.channels.iter().enumerate() {
        let (count, stride) = if level == 0 { (1, 1) } else { (2, 2) };
        let mut blocks = Vec::with_capacity(count);
        for i in 0..count {
            let mut scope = scope.sub(&format!("down{level}.{i}"));
            blocks.push(ConvBlock::new(&mut scope, inputs, c, if i == 0 { stride } else { 1 }, config.groups)?);
            inputs = c;
        }
        levels.push(blocks);
    }
    Ok(levels)
}

fn up_blocks(config: &UNetConfig, scope: &mut Scope<'_>) -> Result<Vec<[ConvBlock; 2]>> {
    let mut levels = Vec::with_capacity(config.channels.len() - 1);
    for level in (1..config.channels.len()).rev() {
        let (from, to) = (config.channels[level], config.channels[level - 1]);
        let narrow = ConvBlock::new(&mut scope.sub(&format!("up{level}.narrow")), from, to, 1, config.groups)?;
        let merge = ConvBlock::new(&mut scope.sub(&format!("up{level}.merge")), to, to, 1, config.groups)?;
        levels.push([narrow, merge]);
    }
    Ok(levels)
}
