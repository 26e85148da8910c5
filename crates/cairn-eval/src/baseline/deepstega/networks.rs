//! The three networks: one prepares what is hidden, one hides it in a photograph, one
//! reveals it. Convolutions of 3 x 3 at full resolution, so that pictures may have any
//! size. Where Baluja's hiding network draws the whole picture, this one draws the change,
//! and both it and the revealing one know odd rows and columns from even ones.

use super::planes::{interleaved, planar};
use anyhow::Context as _;
use cairn_nn::{ConvBlock, Init, Params, Scope, Window, conv2d, front_end};
use cairn_scene::Picture;
use candle_core::{Device, Tensor};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;

/// Format of stored networks; another number is refused by name.
const FORMAT: &str = "cairn.deepstega/1";
/// Blocks of each network before its last convolution.
const PREPARING: usize = 2;
const HIDING: usize = 4;
const REVEALING: usize = 4;
/// Rows that are worked on at a time, and what the deepest way through the networks sees
/// around a pixel: large photographs need no more memory than small ones. Both even, so that
/// every band begins at the same place of the lattice.
const BAND: usize = 64;
const AROUND: usize = PREPARING + HIDING + 2;
/// Channels that alternate from pixel to pixel, along rows, columns and both: what sees the
/// same everywhere cannot lay a pattern on a flat wall, nor read one.
const LATTICE: usize = 3;
/// Amplification of the high-pass channels that the revealing network sees beside the picture.
const GAIN: f32 = 3.0;
/// The change begins as small as this, so that the photograph is kept from the start.
const FIRST_CHANGE: f32 = 0.01;

/// Hides pictures in photographs and reveals them again.
pub struct DeepStega {
    channels: usize,
    params: Params,
    prepare: Vec<ConvBlock>,
    hide: Stack,
    reveal: Stack,
}

/// Blocks, then a convolution to three channels.
struct Stack {
    blocks: Vec<ConvBlock>,
    weight: Tensor,
    bias: Tensor,
}

#[derive(Serialize, Deserialize)]
struct Header {
    format: String,
    channels: usize,
}

impl DeepStega {
    /// Untrained networks.
    pub(super) fn fresh(channels: usize, seed: u64) -> anyhow::Result<Self> {
        Self::over(channels, Params::new(seed))
    }

    fn over(channels: usize, mut params: Params) -> anyhow::Result<Self> {
        let prepare = blocks(&mut params.scope("prepare"), 3, channels, PREPARING)?;
        let first = Init::Uniform(FIRST_CHANGE);
        let hide = Stack::new(params.scope("hide"), channels + 3 + LATTICE, channels, HIDING, first)?;
        let last = Init::He { fan_in: channels * 9 * 4 };
        let reveal = Stack::new(params.scope("reveal"), 2 * 3 + LATTICE, channels, REVEALING, last)?;
        Ok(Self { channels, params, prepare, hide, reveal })
    }

    pub(super) fn params(&self) -> &Params {
        &self.params
    }

    /// `cover` with `secret` in it, in [0, 1], all N x 3 x H x W.
    pub(super) fn hidden_in(&self, cover: &Tensor, secret: &Tensor) -> anyhow::Result<Tensor> {
        let mut prepared = secret.clone();
        for block in &self.prepare {
            prepared = block.forward(&prepared)?;
        }
        let change = self.hide.forward(&latticed(&[cover, &prepared])?)?;
        Ok((cover + change)?.clamp(0f32, 1f32)?)
    }

    /// What `marked` hides, N x 3 x H x W both.
    pub(super) fn revealed(&self, marked: &Tensor) -> anyhow::Result<Tensor> {
        self.reveal.forward(&latticed(&[&front_end(&marked.affine(1.0, -0.5)?, GAIN, None)?])?)
    }

    /// `photograph` with `hidden` in it, enlarged to its size; in 8 bits, as a file has it.
    ///
    /// # Errors
    /// An error and An error for numbers that went wrong.
    pub fn hide(&self, photograph: &Picture, hidden: &Picture) -> anyhow::Result<Picture> {
        let (w, h) = (photograph.width(), photograph.height());
        let (cover, secret) = (photograph.clone().clamped(), hidden.resized(w, h).clamped());
        let marked = in_bands(&[&cover, &secret], |bands| self.hidden_in(&bands[0], &bands[1]))?;
        Picture::from_rgb8(w, h, &marked.to_rgb8()).map_err(anyhow::Error::from)
    }

    /// What [`DeepStega::hide`] hid in `picture`, made `[width, height]` pixels large.
    ///
    /// # Errors
    /// As [`DeepStega::hide`].
    pub fn reveal(&self, picture: &Picture, [width, height]: [usize; 2]) -> anyhow::Result<Picture> {
        let seen = in_bands(&[&picture.clone().clamped()], |bands| self.revealed(&bands[0]))?;
        Ok(seen.clamped().resized(width, height))
    }

    /// As safetensors. Equal networks give equal bytes.
    ///
    /// # Errors
    /// For numbers that cannot be written out.
    pub fn to_bytes(&self) -> anyhow::Result<Vec<u8>> {
        let params = self.params.to_bytes()?;
        let tensors = [("parameters", TensorView::new(Dtype::U8, vec![params.len()], &params)?)];
        let json = serde_json::to_string(&Header { format: FORMAT.into(), channels: self.channels })?;
        Ok(safetensors::serialize(tensors, Some(HashMap::from([("cairn".to_owned(), json)])))?)
    }

    /// Reads what [`DeepStega::to_bytes`] wrote.
    ///
    /// # Errors
    /// For an unknown format or a damaged file.
    pub fn from_bytes(bytes: &[u8]) -> anyhow::Result<Self> {
        let (_, metadata) = SafeTensors::read_metadata(bytes)?;
        let json = metadata.metadata().as_ref().and_then(|m| m.get("cairn"));
        let header: Header = serde_json::from_str(json.context("the networks' file has no Cairn header")?)?;
        let format = &header.format;
        anyhow::ensure!(format == FORMAT, "DeepStega's networks: format `{format}`, this program reads `{FORMAT}`");
        let file = SafeTensors::deserialize(bytes)?;
        Self::over(header.channels, Params::from_bytes(file.tensor("parameters")?.data())?)
    }
}

impl Stack {
    fn new(mut scope: Scope<'_>, inputs: usize, channels: usize, count: usize, last: Init) -> anyhow::Result<Self> {
        let blocks = blocks(&mut scope, inputs, channels, count)?;
        let weight = scope.get("out.weight", &[3, channels, 3, 3], last)?;
        Ok(Self { blocks, weight, bias: scope.get("out.bias", &[3], Init::Constant(0.0))? })
    }

    fn forward(&self, x: &Tensor) -> anyhow::Result<Tensor> {
        let mut x = x.clone();
        for block in &self.blocks {
            x = block.forward(&x)?;
        }
        Ok(conv2d(&x, &self.weight, Some(&self.bias), Window::square(1, 1))?)
    }
}

/// `parts` beside one another as channels, and alternating ones behind them.
fn latticed(parts: &[&Tensor]) -> anyhow::Result<Tensor> {
    let (n, _, h, w) = parts[0].dims4()?;
    let sign = |odd: usize| if odd.is_multiple_of(2) { 0.5f32 } else { -0.5 };
    let planes = [|x: usize, _: usize| x, |_: usize, y: usize| y, |x: usize, y: usize| x + y];
    let plane = |of: &fn(usize, usize) -> usize| (0..h * w).map(|i| sign(of(i % w, i / w))).collect::<Vec<f32>>();
    let planes: Vec<f32> = planes.map(|of| of as fn(usize, usize) -> usize).iter().flat_map(plane).collect();
    let lattice = Tensor::from_vec(planes, (1, LATTICE, h, w), &Device::Cpu)?.repeat((n, 1, 1, 1))?;
    let mut all = parts.to_vec();
    all.push(&lattice);
    Ok(Tensor::cat(&all, 1)?)
}

/// Without normalisation: what a patch gives must not depend on what is elsewhere in it.
fn blocks(scope: &mut Scope<'_>, inputs: usize, channels: usize, count: usize) -> anyhow::Result<Vec<ConvBlock>> {
    let block = |i: usize| {
        let from = if i == 0 { inputs } else { channels };
        Ok(ConvBlock::new(&mut scope.sub(&i.to_string()), from, channels, 1, 0)?)
    };
    (0..count).map(block).collect()
}

/// What `network` makes of pictures of one size, a band of rows at a time.
fn in_bands(pictures: &[&Picture], network: impl Fn(&[Tensor]) -> anyhow::Result<Tensor>) -> anyhow::Result<Picture> {
    let (w, h) = (pictures[0].width(), pictures[0].height());
    let mut rgb = Vec::with_capacity(w * h * 3);
    for top in (0..h).step_by(BAND) {
        let bottom = (top + BAND).min(h);
        let (from, to) = (top.saturating_sub(AROUND), (bottom + AROUND).min(h));
        let band = |picture: &&Picture| {
            let rows = picture.rgb()[from * w * 3..to * w * 3].to_vec();
            Ok(Tensor::from_vec(planar(&[rows]), (1, 3, to - from, w), &Device::Cpu)?)
        };
        let bands = pictures.iter().map(band).collect::<anyhow::Result<Vec<_>>>()?;
        let out = interleaved(&network(&bands)?.flatten_all()?.to_vec1::<f32>()?);
        rgb.extend_from_slice(&out[(top - from) * w * 3..(bottom - from) * w * 3]);
    }
    anyhow::ensure!(rgb.iter().all(|v| v.is_finite()), "a picture of DeepStega's has a number that is not finite");
    Picture::new(w, h, rgb).map_err(anyhow::Error::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn waves(width: usize, height: usize) -> Picture {
        let rgb = (0..width * height * 3).map(|i| 0.5 + 0.4 * (i as f32 * 0.37).sin()).collect();
        Picture::new(width, height, rgb).unwrap()
    }

    #[test]
    fn bands_do_not_show() {
        let stega = DeepStega::fresh(4, 5).unwrap();
        let picture = waves(20, 2 * BAND + 9);
        let banded = in_bands(&[&picture], |bands| stega.revealed(&bands[0])).unwrap();
        let whole = Tensor::from_vec(planar(&[picture.rgb().to_vec()]), (1, 3, 2 * BAND + 9, 20), &Device::Cpu);
        let whole = stega.revealed(&whole.unwrap()).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap();
        let off = banded.rgb().iter().zip(interleaved(&whole)).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
        assert!(off < 1e-5, "{off}");
    }

    #[test]
    fn an_unknown_format_is_refused_by_name() {
        let mut other = DeepStega::fresh(2, 1).unwrap().to_bytes().unwrap();
        let at = other.windows(FORMAT.len()).position(|w| w == FORMAT.as_bytes()).unwrap();
        other[at + FORMAT.len() - 1] = b'9';
        let error = DeepStega::from_bytes(&other).err().unwrap().to_string();
        assert!(error.contains("cairn.deepstega/9") && error.contains("cairn.deepstega/1"), "{error}");
    }
}
