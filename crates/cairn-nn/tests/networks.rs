//! The networks: gradients against finite differences, learning, and seeds.
use cairn_nn::*;
use candle_core::{DType, Device, Tensor, Var};

fn wave(shape: &[usize], phase: f64) -> Tensor {
    let n: usize = shape.iter().product();
    let data: Vec<f32> = (0..n).map(|i| 0.5 + 0.4 * ((i as f64) * 0.7391 + phase * 1.3).sin() as f32).collect();
    Tensor::from_vec(data, shape, &Device::Cpu).unwrap()
}

/// Compares `df/dx` with central differences along the gradient itself and
/// along fixed other directions. Whole directions, because the rectifiers' kinks
/// and f32 rounding drown single entries.
fn check_gradient(x: &Var, step: f32, f: &dyn Fn() -> Result<Tensor>) -> Result<()> {
    let gradient = f()?.backward()?.get(x).expect("a gradient").flatten_all()?.to_vec1::<f32>()?;
    let start = x.flatten_all()?.to_vec1::<f32>()?;
    let size = norm(&gradient);
    assert!(size > 0.0, "no gradient at all");
    let eval = |direction: &[f32], by: f32| -> Result<f64> {
        let moved: Vec<f32> = start.iter().zip(direction).map(|(v, d)| v + by * d).collect();
        x.set(&Tensor::from_vec(moved, x.shape(), &Device::Cpu)?)?;
        Ok(f()?.to_dtype(DType::F64)?.to_scalar::<f64>()?)
    };
    for kind in 0..3 {
        let direction: Vec<f32> = match kind {
            0 => gradient.clone(),
            k => (0..start.len()).map(|i| (i as f32 * 1.7 + k as f32).sin()).collect(),
        };
        let direction: Vec<f32> = direction.iter().map(|d| d / norm(&direction)).collect();
        let analytic: f32 = gradient.iter().zip(&direction).map(|(g, d)| g * d).sum();
        let numeric = ((eval(&direction, step)? - eval(&direction, -step)?) / (2.0 * f64::from(step))) as f32;
        let off = (numeric - analytic).abs();
        assert!(off <= 0.02 * size, "direction {kind}: {numeric} by differences, {analytic} analytic, norm {size}");
    }
    x.set(&Tensor::from_vec(start, x.shape(), &Device::Cpu)?)?;
    Ok(())
}

fn norm(v: &[f32]) -> f32 {
    v.iter().map(|v| v * v).sum::<f32>().sqrt()
}

#[test]
fn classifier_gradient_is_right_through_everything() -> Result<()> {
    for groups in [0, 2] {
        let mut params = Params::new(3);
        let config = ClassifierConfig { channels: vec![4, 6], groups, ..ClassifierConfig::default() };
        let net = Classifier::new(&config, 3, params.scope("c"))?;
        let x = Var::from_tensor(&wave(&[2, 3, 16, 16], 0.1))?;
        let f = || cross_entropy(&(net.forward(&x)? * 20.0)?, &[1, 2]);
        check_gradient(&x, 5e-4, &f)?;
        for name in ["c.block0.weight", "c.block1.weight", "c.head.weight"] {
            check_gradient(params.get(name).unwrap(), 5e-4, &f)?;
        }
    }
    Ok(())
}

#[test]
fn detector_gradient_is_right_through_everything() -> Result<()> {
    let mut params = Params::new(4);
    let config = UNetConfig { channels: vec![4, 6, 8], groups: 2, size: [16, 16], ..UNetConfig::default() };
    let net = UNet::new(&config, 3, params.scope("d"))?;
    let x = Var::from_tensor(&wave(&[2, 3, 16, 16], 0.1))?;
    let p = Var::from_vec(vec![0.2f32, 0.5, 0.3, 0.1, 0.2, 0.7], (2, 3), &Device::Cpu)?;
    // In f64, so that the mean's rounding does not drown the differences.
    let target = wave(&[2, 3, 16, 16], 0.9).to_dtype(DType::F64)?;
    let f = || mean_squared(&net.forward(&x, &p)?.to_dtype(DType::F64)?, &target);
    check_gradient(&x, 1e-4, &f)?;
    check_gradient(&p, 1e-4, &f)?;
    for (_, var) in params.iter() {
        check_gradient(var, 1e-4, &f)?;
    }
    Ok(())
}

/// A classifier and a detector.
struct Networks {
    classifier: Classifier,
    detector: UNet,
}

fn small_networks(params: &mut Params) -> Result<Networks> {
    let config = ClassifierConfig { channels: vec![8, 8], ..ClassifierConfig::default() };
    let classifier = Classifier::new(&config, 2, params.scope("classifier"))?;
    let config = UNetConfig { channels: vec![8, 12], size: [32, 32], ..UNetConfig::default() };
    Ok(Networks { classifier, detector: UNet::new(&config, 2, params.scope("detector"))? })
}

/// One step of both networks on a smooth picture (as renders are) and the same
/// with a faint pattern.
fn train_step(nets: &Networks, params: &Params, adam: &mut Adam) -> Result<[f32; 2]> {
    let smooth = (0..3072).map(|i| (i % 32 + i / 32 % 32) as f32 / 64.0).collect();
    let plain = Tensor::from_vec(smooth, (1, 3, 32, 32), &Device::Cpu)?;
    let pattern: Vec<f32> = (0..3072).map(|i| if (i + i / 32) % 2 == 0 { 0.005 } else { -0.005 }).collect();
    let marked = (&plain + Tensor::from_vec(pattern, (1, 3, 32, 32), &Device::Cpu)?)?;
    let images = Tensor::cat(&[&plain, &marked], 0)?;
    let target = Tensor::cat(&[&plain.zeros_like()?, &wave(&[1, 3, 32, 32], 2.0)], 0)?;
    let logits = nets.classifier.forward(&images)?;
    let class = cross_entropy(&logits, &[0, 1])?;
    let recover = mean_absolute(&nets.detector.forward(&images, &softmax(&logits)?.detach())?, &target)?;
    adam.step(params, &(&class + &recover)?.backward()?)?;
    Ok([class.to_scalar()?, recover.to_scalar()?])
}

#[test]
fn training_learns_and_a_resumed_run_gives_the_same_bytes() -> Result<()> {
    let mut params = Params::new(11);
    let nets = small_networks(&mut params)?;
    let mut adam = Adam::new(AdamConfig::default(), Rate::falling(1e-2, 2e-3, 60))?;
    let first = train_step(&nets, &params, &mut adam)?;
    for _ in 1..40 {
        train_step(&nets, &params, &mut adam)?;
    }
    let (half, state) = (params.to_bytes()?, adam.to_bytes()?);
    let mut last = first;
    for _ in 0..20 {
        last = train_step(&nets, &params, &mut adam)?;
    }
    assert!(last[0] < 0.1 && first[0] > 0.5, "cross-entropy {first:?} to {last:?}");
    assert!(last[1] < 0.5 * first[1], "recovery {first:?} to {last:?}");

    let mut resumed = Params::from_bytes(&half)?;
    let nets = small_networks(&mut resumed)?;
    let mut adam_resumed = Adam::new(AdamConfig::default(), Rate::falling(1e-2, 2e-3, 60))?;
    adam_resumed.load(&resumed, &state)?;
    for _ in 0..20 {
        train_step(&nets, &resumed, &mut adam_resumed)?;
    }
    assert_eq!(params.to_bytes()?, resumed.to_bytes()?, "parameters differ after resuming");
    assert_eq!(adam.to_bytes()?, adam_resumed.to_bytes()?, "optimiser states differ after resuming");
    Ok(())
}

#[test]
fn the_number_of_threads_does_not_change_the_bytes() -> Result<()> {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| -> Result<Vec<u8>> {
            let mut params = Params::new(5);
            let nets = small_networks(&mut params)?;
            let mut adam = Adam::new(AdamConfig::default(), Rate::constant(1e-2))?;
            for _ in 0..3 {
                train_step(&nets, &params, &mut adam)?;
            }
            params.to_bytes()
        })
    };
    let one = run(1)?;
    assert_eq!(one, run(2)?, "two threads");
    assert_eq!(one, run(5)?, "five threads");
    Ok(())
}

#[test]
fn an_unmarked_picture_is_gated_to_nothing() -> Result<()> {
    let mut params = Params::new(1);
    let net =
        UNet::new(&UNetConfig { channels: vec![4, 4], size: [16, 16], ..Default::default() }, 3, params.scope("d"))?;
    let p = Tensor::new(&[[1.0f32, 0.0, 0.0], [0.0, 1.0, 0.0]], &Device::Cpu)?;
    let out = net.forward(&wave(&[2, 3, 16, 16], 0.0), &p)?.abs()?.flatten_from(1)?.max(1)?.to_vec1::<f32>()?;
    assert!(out[0] == 0.0 && out[1] > 0.0, "{out:?}");
    Ok(())
}

#[test]
fn the_detector_sees_the_class_and_not_a_number_shows() -> Result<()> {
    let mut params = Params::new(1);
    let net =
        UNet::new(&UNetConfig { channels: vec![4, 4], size: [16, 16], ..Default::default() }, 3, params.scope("d"))?;
    let x = wave(&[1, 3, 16, 16], 0.0);
    let [a, b] = [[0.0f32, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|p| {
        net.forward(&x, &Tensor::new(&[p], &Device::Cpu)?)?.flatten_all()?.to_vec1::<f32>().map_err(NnError::from)
    });
    let (a, b) = (a?, b?);
    assert!(a.iter().zip(&b).any(|(a, b)| (a - b).abs() > 1e-3), "the class changes nothing");
    let mut numbers = x.flatten_all()?.to_vec1::<f32>()?;
    numbers[5] = f32::NAN;
    let x = Tensor::from_vec(numbers, x.shape(), &Device::Cpu)?;
    let out = net.forward(&x, &Tensor::new(&[[0.0f32, 1.0, 0.0]], &Device::Cpu)?)?.flatten_all()?.to_vec1::<f32>()?;
    assert!(out.iter().any(|v| v.is_nan()), "a NaN was swept away");
    Ok(())
}

#[test]
fn a_blank_ground_counts_for_little_where_statistics_are_of_what_is_textured() -> Result<()> {
    let features = |textured_only: bool, width: usize| -> Result<Vec<f32>> {
        let mut params = Params::new(5);
        let config = ClassifierConfig { channels: vec![8, 8], textured_only, ..ClassifierConfig::default() };
        let classifier = Classifier::new(&config, 2, params.scope("classifier"))?;
        // Texture on the left, the ground white beside it.
        let texture = |i: usize| 0.5 + 0.1 * ((i * 2_654_435_761) >> 7 & 1023) as f32 / 1023.0;
        let value =
            |i: usize| if i % width < 32 { texture(i / width * 32 + i % width + i / (32 * width) * 1024) } else { 1.0 };
        let image =
            Tensor::from_vec((0..3 * 32 * width).map(value).collect::<Vec<_>>(), (1, 3, 32, width), &Device::Cpu)?;
        Ok(classifier.features(&image)?.flatten_all()?.to_vec1::<f32>()?)
    };
    let apart = |textured_only: bool| -> Result<f32> {
        let (a, b): (Vec<f32>, Vec<f32>) = (features(textured_only, 64)?, features(textured_only, 160)?);
        let size = a.iter().map(|v| v * v).sum::<f32>();
        Ok((a.iter().zip(&b).map(|(a, b)| (a - b).powi(2)).sum::<f32>() / size).sqrt())
    };
    let (whole, textured) = (apart(false)?, apart(true)?);
    assert!(whole > 0.4 && textured < 0.25 * whole, "{whole} and {textured}");
    // Where all is textured it is as without.
    let (a, b) = (features(false, 32)?, features(true, 32)?);
    assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 0.02 * (1.0 + a.abs())), "{a:?} and {b:?}");
    Ok(())
}

#[test]
fn wrong_settings_and_shapes_are_refused_by_name() -> Result<()> {
    let mut params = Params::new(1);
    let bad = UNetConfig { size: [100, 128], ..Default::default() };
    let error = UNet::new(&bad, 2, params.scope("d")).expect_err("100 is no multiple of 8").to_string();
    assert!(error.contains("size") && error.contains("100"), "{error}");
    let bad = ClassifierConfig { high_pass_gain: f32::NAN, ..Default::default() };
    let error = Classifier::new(&bad, 2, params.scope("c")).expect_err("NaN").to_string();
    assert!(error.contains("high_pass_gain"), "{error}");
    let bad = ClassifierConfig { high_pass_gain: 0.0, textured_only: true, ..Default::default() };
    let error = Classifier::new(&bad, 2, params.scope("c")).expect_err("no residual").to_string();
    assert!(error.contains("textured_only") && error.contains("high_pass_gain is 0"), "{error}");
    let nets = small_networks(&mut params)?;
    let error = nets.classifier.forward(&wave(&[1, 3, 30, 32], 0.0)).expect_err("30 rows").to_string();
    assert!(error.contains("multiples of 4"), "{error}");
    let p = Tensor::new(&[[1.0f32, 0.0, 0.0]], &Device::Cpu)?;
    let error = nets.detector.forward(&wave(&[1, 3, 32, 32], 0.0), &p).expect_err("three classes").to_string();
    assert!(error.contains("1 x 2 class probabilities"), "{error}");
    Ok(())
}
