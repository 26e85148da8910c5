//! Pictures as the networks take them, and what is read from their answers.

use crate::error::MarkError;
use cairn_scene::Picture;
use candle_core::{Device, Tensor};

/// Refuses numbers that would otherwise be ranked or clamped into an answer.
pub(crate) fn finite(values: &[f32], place: &str) -> Result<(), MarkError> {
    match values.iter().all(|v| v.is_finite()) {
        true => Ok(()),
        false => Err(MarkError::NotFinite { step: None, place: place.into() }),
    }
}

/// N x 3 x side x side from interleaved pictures.
pub(crate) fn to_tensor(pictures: &[Vec<f32>], side: usize) -> Result<Tensor, MarkError> {
    Ok(Tensor::from_vec(planar(pictures), (pictures.len(), 3, side, side), &Device::Cpu)?)
}

/// Interleaved pictures as planes, one after another.
pub(crate) fn planar(pictures: &[Vec<f32>]) -> Vec<f32> {
    let mut out = Vec::with_capacity(pictures.iter().map(Vec::len).sum());
    for picture in pictures {
        for c in 0..3 {
            out.extend(picture.iter().skip(c).step_by(3));
        }
    }
    out
}

/// Three planes as an interleaved picture.
pub(crate) fn interleaved(planes: &[f32]) -> Vec<f32> {
    let n = planes.len() / 3;
    (0..n * 3).map(|i| planes[(i % 3) * n + i / 3]).collect()
}

/// A picture at the networks' size, clamped to what a file can hold.
pub(crate) fn shrunk(picture: &Picture, side: usize) -> Vec<f32> {
    picture.clone().clamped().resized(side, side).into_rgb()
}

/// The class with the largest probability.
pub(crate) fn winner(probabilities: &[f32]) -> usize {
    (0..probabilities.len()).max_by(|a, b| probabilities[*a].total_cmp(&probabilities[*b])).unwrap_or(0)
}

/// f32 little-endian, for a file.
pub(crate) fn f32_bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}
