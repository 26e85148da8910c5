//! Plain slices out of candle's tensors and back.

use std::mem::MaybeUninit;

use candle_core::{CpuStorage, Device, Layout, Result, Shape, Storage, Tensor};

/// The f32 numbers of a contiguous CPU storage.
pub(crate) fn floats<'a>(op: &str, storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [f32]> {
    let Some((start, end)) = layout.contiguous_offsets() else {
        candle_core::bail!("{op}: the operand of shape {:?} must be contiguous", layout.shape());
    };
    Ok(&storage.as_slice::<f32>()?[start..end])
}

/// Calls `f` with the f32 numbers of a contiguous CPU tensor.
pub(crate) fn with_floats<R>(op: &str, t: &Tensor, f: impl FnOnce(&[f32]) -> R) -> Result<R> {
    let (storage, layout) = t.storage_and_layout();
    let Storage::Cpu(storage) = &*storage else {
        candle_core::bail!("{op}: the operand of shape {:?} must lie on the CPU", t.shape());
    };
    Ok(f(floats(op, storage, layout)?))
}

/// The numbers' bytes, to compare two ways to the same.
#[cfg(test)]
pub(crate) fn bits(t: &Tensor) -> Result<Vec<u32>> {
    Ok(t.flatten_all()?.to_vec1::<f32>()?.iter().map(|v| v.to_bits()).collect())
}

/// A CPU tensor of `data`.
pub(crate) fn tensor(data: Vec<f32>, shape: &Shape) -> Result<Tensor> {
    Tensor::from_vec(data, shape, &Device::Cpu)
}

/// `len` numbers written by `fill`, whose answer is returned as well: large
/// results are not written twice, first with zeros.
///
/// # Safety
/// `fill` MUST write every number.
pub(crate) unsafe fn written<R>(len: usize, fill: impl FnOnce(&mut [MaybeUninit<f32>]) -> R) -> (Vec<f32>, R) {
    let mut out = Vec::with_capacity(len);
    let answer = fill(&mut out.spare_capacity_mut()[..len]);
    // SAFETY: the capacity is there, and `fill` wrote all of it.
    unsafe { out.set_len(len) };
    (out, answer)
}
