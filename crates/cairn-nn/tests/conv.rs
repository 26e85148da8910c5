//! Convolution against candle's own.
use cairn_nn::{Window, conv2d};
use candle_core::{Device, Result, Tensor, Var};

#[test]
fn convolution_agrees_with_candle() -> Result<()> {
    for (i, &[n, ci, co, h, w, k, s, p]) in CASES.iter().enumerate() {
        let x = Var::from_tensor(&wave((n, ci, h, w), i as f64)?)?;
        let k = Var::from_tensor(&wave((co, ci, k, k), 0.5 + i as f64)?)?;
        let ours = conv2d(&x, &k, None, Window::square(s, p))?;
        let theirs = x.conv2d(&k, p, s, 1, 1)?;
        close(&ours, &theirs, 1e-5, i)?;
        let weight = wave(ours.dims(), 0.2)?;
        let a = (&ours * &weight)?.sum_all()?.backward()?;
        let b = (&theirs * &weight)?.sum_all()?.backward()?;
        for v in [&x, &k] {
            close(a.get(v).unwrap(), b.get(v).unwrap(), 1e-5, i)?;
        }
    }
    Ok(())
}

/// Batch, input and output channels, rows, columns, kernel, stride, padding.
const CASES: &[[usize; 8]] = &[
    [2, 3, 5, 9, 7, 3, 1, 1],
    [1, 8, 4, 16, 16, 3, 1, 1],
    [3, 5, 9, 12, 10, 3, 2, 1],
    [2, 4, 3, 11, 13, 1, 1, 0],
    [2, 4, 6, 11, 13, 1, 2, 0],
    [1, 2, 7, 10, 8, 5, 1, 2],
    [2, 2, 2, 14, 14, 5, 2, 2],
    [1, 3, 4, 8, 8, 3, 1, 0],
    [1, 3, 4, 9, 9, 3, 3, 1],
    [1, 1, 1, 3, 3, 3, 1, 1],
    [1, 6, 2, 40, 40, 3, 1, 1],
];

fn wave(shape: impl Into<candle_core::Shape>, phase: f64) -> Result<Tensor> {
    let shape = shape.into();
    let n = shape.elem_count();
    let data: Vec<f32> = (0..n).map(|i| ((i as f64) * 0.7391 + phase * 1.3).sin() as f32).collect();
    Tensor::from_vec(data, shape, &Device::Cpu)
}

fn close(a: &Tensor, b: &Tensor, tol: f32, case: usize) -> Result<()> {
    assert_eq!(a.dims(), b.dims(), "case {case}");
    let scale = b.abs()?.flatten_all()?.max(0)?.to_scalar::<f32>()?.max(1.0);
    let d = (a - b)?.abs()?.flatten_all()?.max(0)?.to_scalar::<f32>()?;
    assert!(d <= tol * scale, "case {case}: off by {d} of {scale}");
    Ok(())
}
