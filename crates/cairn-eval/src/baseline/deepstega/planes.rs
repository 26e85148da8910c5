//! Interleaved pictures as planes of numbers, and back.

use candle_core::{Device, Tensor};

/// N x 3 x side x side from interleaved pictures.
pub(super) fn to_tensor(pictures: &[Vec<f32>], side: usize) -> anyhow::Result<Tensor> {
    Ok(Tensor::from_vec(planar(pictures), (pictures.len(), 3, side, side), &Device::Cpu)?)
}

/// Interleaved pictures as planes, one after another.
pub(super) fn planar(pictures: &[Vec<f32>]) -> Vec<f32> {
    let mut out = Vec::with_capacity(pictures.iter().map(Vec::len).sum());
    for picture in pictures {
        for c in 0..3 {
            out.extend(picture.iter().skip(c).step_by(3));
        }
    }
    out
}

/// Three planes as an interleaved picture.
pub(super) fn interleaved(planes: &[f32]) -> Vec<f32> {
    let n = planes.len() / 3;
    (0..n * 3).map(|i| planes[(i % 3) * n + i / 3]).collect()
}
