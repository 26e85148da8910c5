//! Convolutions against candle's own, against finite differences, and with what
//! they must refuse.

use cairn_nn::{Window, conv_transpose1d, conv_transpose2d, conv1d, conv2d};
use candle_core::{DType, Device, Result, Tensor, Var};

/// Numbers below `n`, the same ones every time.
struct Draw(u64);

impl Draw {
    fn below(&mut self, n: u64) -> usize {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        ((self.0 >> 33) % n) as usize
    }
}

#[test]
fn convolution_agrees_with_candle() -> Result<()> {
    let mut draw = Draw(3);
    for case in 0..60 {
        let [n, ci, co] = [3, 12, 20].map(|most| 1 + draw.below(most));
        let [h, w] = [(); 2].map(|_| 5 + draw.below(30));
        let [k, stride, padding, dilation] = [5, 3, 3, 2].map(|most| 1 + draw.below(most));
        let padding = padding - 1;
        if h.min(w) + 2 * padding <= (k - 1) * dilation {
            continue;
        }
        let x = Var::from_tensor(&wave((n, ci, h, w), case as f64)?)?;
        let kernel = Var::from_tensor(&wave((co, ci, k, k), 0.5 + case as f64)?)?;
        let ours = conv2d(&x, &kernel, None, Window { dilation: [dilation; 2], ..Window::square(stride, padding) })?;
        let theirs = x.conv2d(&kernel, padding, stride, dilation, 1)?;
        close(&ours, &theirs, case)?;
        // candle's own backward pass knows no dilation, and one remainder for rows and columns.
        if dilation == 1 && h.abs_diff(w).is_multiple_of(stride) {
            let weight = wave(ours.dims(), 0.2)?;
            let a = (&ours * &weight)?.sum_all()?.backward()?;
            let b = (&theirs * &weight)?.sum_all()?.backward()?;
            for v in [&x, &kernel] {
                close(a.get(v).expect("ours"), b.get(v).expect("theirs"), case)?;
            }
        }
    }
    Ok(())
}

#[test]
fn transposed_convolution_agrees_with_candle() -> Result<()> {
    let mut draw = Draw(4);
    for case in 0..40 {
        let [n, ci, co, h, w] = [3, 9, 9, 12, 14].map(|most| 1 + draw.below(most));
        let [k, stride] = [5, 3].map(|most| 1 + draw.below(most));
        let (padding, extra) = (draw.below(k as u64), draw.below(stride as u64));
        // candle works the length out in an order that goes below zero on the way.
        if (h.min(w) - 1) * stride < 2 * padding {
            continue;
        }
        let x = wave((n, ci, h, w), case as f64)?;
        let kernel = wave((ci, co, k, k), 0.5 + case as f64)?;
        let window = Window::square(stride, padding);
        let ours = conv_transpose2d(&x, &kernel, None, window, [extra; 2])?;
        close(&ours, &x.conv_transpose2d(&kernel, padding, extra, stride, 1)?, case)?;
        if padding + extra == 0 {
            // candle's way of its own for these sizes gives other numbers than its
            // general one for several images; PyTorch's are in `reference.rs`.
            continue;
        }
        let (row, line) = (x.narrow(2, 0, 1)?.squeeze(2)?.contiguous()?, kernel.narrow(2, 0, 1)?.squeeze(2)?);
        let ours = conv_transpose1d(&row, &line, None, window, extra)?;
        close(&ours, &row.conv_transpose1d(&line.contiguous()?, padding, extra, stride, 1, 1)?, case)?;
    }
    Ok(())
}

/// All of these are linear in input, weight and bias: differences along any
/// direction are exact, and `f64` sums of the outputs keep them so.
#[test]
fn gradients_are_what_small_changes_do() -> Result<()> {
    type Apply = fn(&Tensor, &Tensor, &Tensor) -> Result<Tensor>;
    type Case<'a> = (&'a str, Apply, &'a [usize], &'a [usize], usize);
    let cases: [Case<'_>; 4] = [
        ("conv2d", |x, w, b| conv2d(x, w, Some(b), Window::square(2, 1)), &[2, 3, 9, 8], &[17, 3, 3, 3], 17),
        ("conv1d", |x, w, b| conv1d(x, w, Some(b), Window::line(4, 4)), &[2, 2, 41], &[5, 2, 9], 5),
        (
            "conv_transpose2d",
            |x, w, b| conv_transpose2d(x, w, Some(b), Window::square(2, 1), [1, 1]),
            &[2, 3, 5, 4],
            &[3, 4, 3, 3],
            4,
        ),
        ("conv1d", |x, w, b| conv1d(x, w, Some(b), Window::line(1, 4)), &[2, 3, 10], &[2, 3, 9], 2),
    ];
    for (name, apply, x, w, b) in cases {
        let inputs = [wave(x, 0.1)?, wave(w, 0.7)?, wave(b, 1.9)?];
        let vars = inputs.each_ref().map(Var::from_tensor);
        let [x, w, b] = vars;
        let vars = [x?, w?, b?];
        let value = |vars: &[Var; 3]| -> Result<Tensor> {
            let out = apply(&vars[0], &vars[1], &vars[2])?.to_dtype(DType::F64)?;
            (&out * wave(out.dims(), 2.5)?.to_dtype(DType::F64)?)?.sum_all()
        };
        let grads = value(&vars)?.backward()?;
        for (i, (var, start)) in vars.iter().zip(&inputs).enumerate() {
            let direction = wave(start.dims(), 4.0 + i as f64)?;
            let slope = (grads.get(var).expect("a gradient") * &direction)?.to_dtype(DType::F64)?.sum_all()?;
            let mut ends = [0.0; 2];
            for (end, sign) in ends.iter_mut().zip([1.0, -1.0]) {
                var.set(&(start + (&direction * sign)?)?)?;
                *end = value(&vars)?.to_scalar::<f64>()?;
            }
            var.set(start)?;
            let (slope, found) = (slope.to_scalar::<f64>()?, (ends[0] - ends[1]) / 2.0);
            assert!((slope - found).abs() <= 1e-4 * found.abs().max(1.0), "{name}, input {i}: {slope}, not {found}");
        }
    }
    Ok(())
}

#[test]
fn what_is_not_a_number_shows_where_the_window_holds_it() -> Result<()> {
    let mut numbers = vec![1.0_f32; 2 * 3 * 8 * 8];
    for (bad, word) in [(f32::NAN, "NaN"), (f32::INFINITY, "infinity")] {
        // Image 1, channel 2, row 4, column 7.
        numbers[64 * 5 + 4 * 8 + 7] = bad;
        let x = Tensor::from_vec(numbers.clone(), (2, 3, 8, 8), &Device::Cpu)?;
        let out = conv2d(&x, &wave((4, 3, 3, 3), 0.0)?, None, Window::square(1, 1))?.flatten_all()?.to_vec1::<f32>()?;
        for (i, v) in out.iter().enumerate() {
            let (image, y, column) = (i / 256, i / 8 % 8, i % 8);
            let held = image == 1 && (3..=5).contains(&y) && column >= 6;
            assert_eq!(held, !v.is_finite(), "{word}: {v} in image {image}, row {y}, column {column}");
        }
    }
    Ok(())
}

#[test]
fn what_does_not_fit_is_refused_with_a_remedy() -> Result<()> {
    let refused = |x: &[usize], w: &[usize], window, words: [&str; 2]| -> Result<()> {
        let error = conv2d(&zeros(x)?, &zeros(w)?, None, window).expect_err("must be refused").to_string();
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
        Ok(())
    };
    let plain = Window::square(1, 1);
    refused(&[0, 3, 8, 8], &[4, 3, 3, 3], plain, ["[0, 3, 8, 8]", "leave empty batches out"])?;
    refused(&[1, 4, 8, 8], &[4, 2, 3, 3], plain, ["takes 2 input channels", "groups are not supported: narrow"])?;
    refused(&[1, 3, 2, 2], &[4, 3, 5, 5], plain, ["larger than the padded input", "pad more"])?;
    refused(&[1, 3, 8, 8], &[4, 3, 3, 3], Window::square(0, 1), ["strides", "at least 1"])?;
    refused(&[3, 8, 8], &[4, 3, 3, 3], plain, ["N x C x H x W", "[3, 8, 8]"])?;
    let error = conv2d(&zeros(&[1, 3, 8, 8])?, &zeros(&[4, 3, 3, 3])?, Some(&zeros(&[3])?), plain);
    let error = error.expect_err("three biases for four outputs").to_string();
    assert!(error.contains("4 outputs") && error.contains("got 3"), "{error}");
    let double = zeros(&[1, 3, 8, 8])?.to_dtype(DType::F64)?;
    let error = conv2d(&double, &zeros(&[4, 3, 3, 3])?, None, plain).expect_err("f64").to_string();
    assert!(error.contains("F64") || error.contains("F32"), "{error}");
    let transposed = |padding, extra| {
        conv_transpose2d(&zeros(&[1, 3, 2, 2])?, &zeros(&[3, 4, 3, 3])?, None, Window::square(2, padding), [extra; 2])
    };
    let error = transposed(1, 2).expect_err("extra at the stride").to_string();
    assert!(error.contains("output padding") && error.contains("below the stride"), "{error}");
    let error = transposed(4, 0).expect_err("nothing left").to_string();
    assert!(error.contains("nothing is left") && error.contains("pad less"), "{error}");
    Ok(())
}

fn zeros(shape: &[usize]) -> Result<Tensor> {
    Tensor::zeros(shape, DType::F32, &Device::Cpu)
}

fn wave(shape: impl Into<candle_core::Shape>, phase: f64) -> Result<Tensor> {
    let shape = shape.into();
    let n = shape.elem_count();
    let data: Vec<f32> = (0..n).map(|i| ((i as f64) * 0.7391 + phase * 1.3).sin() as f32).collect();
    Tensor::from_vec(data, shape, &Device::Cpu)
}

fn close(a: &Tensor, b: &Tensor, case: usize) -> Result<()> {
    assert_eq!(a.dims(), b.dims(), "case {case}");
    let scale = b.abs()?.flatten_all()?.max(0)?.to_scalar::<f32>()?.max(1.0);
    let d = (a - b)?.abs()?.flatten_all()?.max(0)?.to_scalar::<f32>()?;
    assert!(d <= 2e-5 * scale, "case {case}: off by {d} of {scale}");
    Ok(())
}
