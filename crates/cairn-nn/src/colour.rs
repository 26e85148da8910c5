//! How a residual's energy lies in colour: what the classifier knows beside its convolutions.
//!
//! The covariance is one operation of candle's graph: of its parts (transposing, two products) candle's backward pass makes six
//! tensors as large as the pictures.

use candle_core::{CpuStorage, CustomOp1, Layout, Shape, Tensor};

use crate::error::Result;

/// Colour directions whose energies are measured: lightness and six hues.
pub(crate) const DIRECTIONS: usize = 7;

/// Logarithms of the residual's energy along [`DIRECTIONS`] colour directions,
/// N x 7, from `x`, N x 3 x H x W in opponent colours: colour statistics of
/// residuals tell a hidden texture from a natural one (Goljan, Fridrich and
/// Cogranne 2014), and marks differ by their colour direction by design.
///
/// # Errors
/// When `x` has another shape or is not f32 on the CPU.
pub(crate) fn colour_energies(x: &Tensor) -> Result<Tensor> {
    let covariance = covariance(x)?;
    let mut weights = Vec::with_capacity(9 * DIRECTIONS);
    let directions: Vec<[f32; 3]> = (0..DIRECTIONS).map(direction).collect();
    for a in 0..3 {
        for b in 0..3 {
            weights.extend(directions.iter().map(|d| d[a] * d[b]));
        }
    }
    let weights = Tensor::from_vec(weights, (9, DIRECTIONS), x.device())?;
    // The floor is the energy of eight bits' rounding after amplification.
    Ok(covariance.reshape((x.dim(0)?, 9))?.matmul(&weights)?.affine(1.0, 1e-3)?.log()?)
}

/// Unit directions in opponent colours: the last is lightness, the others hues 30 degrees apart.
fn direction(which: usize) -> [f32; 3] {
    if which + 1 == DIRECTIONS {
        return [1.0, 0.0, 0.0];
    }
    let (sin, cos) = (std::f32::consts::PI * which as f32 / (DIRECTIONS - 1) as f32).sin_cos();
    [0.0, cos, sin]
}

/// Mean products of each two channels over all pixels, N x C x C, of `x`, N x C x H x W.
fn covariance(x: &Tensor) -> Result<Tensor> {
    let flat = x.detach().flatten_from(2)?;
    let products = (flat.matmul(&flat.transpose(1, 2)?.contiguous()?)? / flat.dim(2)? as f64)?;
    Ok(x.apply_op1(Covariance { shape: products.shape().clone(), of: products.flatten_all()?.to_vec1()? })?)
}

/// What [`covariance`] worked out, and its gradient.
struct Covariance {
    of: Vec<f32>,
    shape: Shape,
}

impl CustomOp1 for Covariance {
    fn name(&self) -> &'static str {
        "cairn-covariance"
    }

    fn cpu_fwd(&self, _: &CpuStorage, _: &Layout) -> candle_core::Result<(CpuStorage, Shape)> {
        Ok((CpuStorage::F32(self.of.clone()), self.shape.clone()))
    }

    /// Of the sum of G_ab x_a x_b over pixels: (G + G^T) x.
    fn bwd(&self, x: &Tensor, _: &Tensor, grad: &Tensor) -> candle_core::Result<Option<Tensor>> {
        let flat = x.detach().flatten_from(2)?;
        let grad = (grad / flat.dim(2)? as f64)?;
        let both = (&grad + grad.transpose(1, 2)?)?;
        both.matmul(&flat)?.reshape(x.shape()).map(Some)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raw::bits;
    use candle_core::{Device, Var};

    #[test]
    fn the_covariance_and_its_gradient_are_those_of_its_parts() -> Result<()> {
        let (n, c, h, w) = (2, 3, 48, 40);
        let data = (0..n * c * h * w).map(|i| (i as f32 * 0.739).sin()).collect::<Vec<_>>();
        let x = Var::from_tensor(&Tensor::from_vec(data, (n, c, h, w), &Device::Cpu)?)?;
        let flat = x.reshape((n, c, h * w))?;
        let parts = (flat.matmul(&flat.transpose(1, 2)?.contiguous()?)? / (h * w) as f64)?;
        let whole = covariance(&x)?;
        assert_eq!(bits(&parts)?, bits(&whole)?);
        // As from energies: alike for both orders of two channels.
        let along = Tensor::new(&[[0.3f32, 0.7, -1.1], [0.7, 0.2, 0.5], [-1.1, 0.5, 0.9]], &Device::Cpu)?;
        let [a, b] = [parts, whole].map(|t| {
            let grads = t.broadcast_mul(&along)?.backward()?;
            bits(grads.get(&x).expect("a gradient"))
        });
        assert_eq!(a?, b?);
        // Not alike: the sum of both.
        let uneven = Tensor::new(&[[0.0f32, 1.0, 0.0], [0.0; 3], [0.0; 3]], &Device::Cpu)?;
        let grads = covariance(&x)?.broadcast_mul(&uneven)?.backward()?;
        let got = grads.get(&x).expect("a gradient").flatten_from(2)?.get(0)?;
        let expected = (x.flatten_from(2)?.get(0)? / (h * w) as f64)?;
        for (channel, from) in [(0, Some(1)), (1, Some(0)), (2, None)] {
            let got = got.get(channel)?.to_vec1::<f32>()?;
            let expected = from.map(|from| expected.get(from)?.to_vec1::<f32>()).transpose()?;
            let off = |(i, v): (usize, &f32)| (v - expected.as_ref().map_or(0.0, |e| e[i])).abs();
            assert!(got.iter().enumerate().map(off).fold(0.0, f32::max) < 1e-9, "channel {channel}");
        }
        Ok(())
    }
}
