//! Every operation and its gradients against PyTorch in f64, as written by
//! `reference/make_conv.py`.

use cairn_nn::{
    LEAKY_SLOPE, Window, avg_pool, conv_transpose1d, conv_transpose2d, conv1d, conv2d, front_end, group_norm_leaky,
    leaky_relu, pool_moments, upsample_add,
};
use candle_core::{Device, Result, Tensor, Var};
use serde::Deserialize;

#[derive(Deserialize)]
struct Case {
    kind: String,
    settings: Vec<usize>,
    shapes: Vec<Vec<usize>>,
    shape: Vec<usize>,
    out: Vec<f32>,
    grads: Vec<Vec<f32>>,
}

fn wave(shape: &[usize], phase: f64) -> Result<Tensor> {
    let count: usize = shape.iter().product();
    let data: Vec<f32> = (0..count).map(|i| (i as f64 * 0.7391 + phase).sin() as f32).collect();
    Tensor::from_vec(data, shape, &Device::Cpu)
}

/// From a case's stride, padding and dilation.
fn window(s: &[usize]) -> Window {
    Window { dilation: [s[2]; 2], ..Window::square(s[0], s[1]) }
}

fn apply(case: &Case, x: &[Var]) -> Result<Tensor> {
    let s = &case.settings;
    match case.kind.as_str() {
        "conv2d" => conv2d(&x[0], &x[1], Some(&x[2]), window(s)),
        "conv1d" => conv1d(&x[0], &x[1], Some(&x[2]), window(s)),
        "conv_transpose2d" => conv_transpose2d(&x[0], &x[1], Some(&x[2]), window(s), [s[3]; 2]),
        "conv_transpose1d" => conv_transpose1d(&x[0], &x[1], Some(&x[2]), window(s), s[3]),
        "group_norm_leaky" => group_norm_leaky(&x[0], &x[1], &x[2], s[0], LEAKY_SLOPE),
        "leaky_relu" => leaky_relu(&x[0], LEAKY_SLOPE),
        "upsample_add" => upsample_add(&x[0], &x[1]),
        "avg_pool" => avg_pool(&x[0], [s[0], s[1]]),
        "pool_moments" => pool_moments(&x[0]),
        "front_end" => front_end(&x[0], s[0] as f32, Some(&x[1])),
        other => panic!("the reference has a kind `{other}` that this test does not know"),
    }
}

fn close(what: &str, got: &Tensor, expected: &[f32]) -> Result<()> {
    let got = got.flatten_all()?.to_vec1::<f32>()?;
    assert_eq!(got.len(), expected.len(), "{what}: length");
    for (i, (g, e)) in got.iter().zip(expected).enumerate() {
        assert!((g - e).abs() <= 2e-5 * e.abs().max(1.0), "{what}: entry {i} is {g}, PyTorch says {e}");
    }
    Ok(())
}

#[test]
fn operations_and_gradients_agree_with_pytorch() -> Result<()> {
    let cases: Vec<Case> = serde_json::from_str(include_str!("reference/conv.json")).expect("conv.json");
    assert!(cases.len() >= 25, "the reference is not whole: {} cases", cases.len());
    for case in &cases {
        let what = format!("{} {:?} {:?}", case.kind, case.shapes, case.settings);
        let inputs = case.shapes.iter().enumerate();
        let inputs = inputs.map(|(i, s)| Var::from_tensor(&wave(s, 1.3 * i as f64)?)).collect::<Result<Vec<_>>>()?;
        let out = apply(case, &inputs)?;
        assert_eq!(out.dims(), case.shape, "{what}");
        close(&what, &out, &case.out)?;
        let grads = (&out * wave(&case.shape, 9.0)?)?.sum_all()?.backward()?;
        for (i, (input, expected)) in inputs.iter().zip(&case.grads).enumerate() {
            close(&format!("{what}, gradient {i}"), grads.get(input).expect("a gradient"), expected)?;
        }
    }
    Ok(())
}
