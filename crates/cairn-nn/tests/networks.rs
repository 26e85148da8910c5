//! The networks: gradients against finite differences, learning, and seeds.
use cairn_nn::*;
use candle_core::{Device, Tensor, Var};

fn wave(shape: &[usize], phase: f64) -> Tensor {
    let n: usize = shape.iter().product();
    let data: Vec<f32> = (0..n).map(|i| 0.5 + 0.4 * ((i as f64) * 0.7391 + phase * 1.3).sin() as f32).collect();
    Tensor::from_vec(data, shape, &Device::Cpu).unwrap()
}

/// Compares `dloss/dx` at some entries with central differences.
fn check_gradient(x: &Var, entries: &[usize], step: f32, f: &dyn Fn() -> Result<Tensor>) -> Result<()> {
    let analytic = f()?.backward()?.get(x).expect("a gradient").flatten_all()?.to_vec1::<f32>()?;
    let start = x.flatten_all()?.to_vec1::<f32>()?;
    let scale = analytic.iter().fold(0.0_f32, |a, b| a.max(b.abs()));
    assert!(scale > 0.0, "no gradient at all");
    let eval = |entry: usize, by: f32| -> Result<f64> {
        let mut moved = start.clone();
        moved[entry] += by;
        x.set(&Tensor::from_vec(moved, x.shape(), &Device::Cpu)?)?;
        Ok(f()?.to_scalar::<f32>()? as f64)
    };
    for &entry in entries {
        let numeric = ((eval(entry, step)? - eval(entry, -step)?) / (2.0 * step as f64)) as f32;
        let off = (numeric - analytic[entry]).abs();
        assert!(
            off <= 0.03 * scale,
            "entry {entry}: {numeric} by differences, {} analytic, scale {scale}",
            analytic[entry]
        );
    }
    x.set(&Tensor::from_vec(start, x.shape(), &Device::Cpu)?)?;
    Ok(())
}

#[test]
fn classifier_gradient_is_right_through_everything() -> Result<()> {
    for groups in [0, 2] {
        let mut params = Params::new(3);
        let config = ClassifierConfig { channels: vec![4, 6], groups, ..ClassifierConfig::default() };
        let net = Classifier::new(&config, 3, params.scope("c"))?;
        let x = Var::from_tensor(&wave(&[2, 3, 16, 16], 0.1))?;
        let f = || cross_entropy(&(net.forward(&x)? * 20.0)?, &[1, 2]);
        check_gradient(&x, &[0, 17, 130, 255, 700, 1535], 2e-3, &f)?;
        for name in ["c.block0.weight", "c.block1.weight", "c.head.weight"] {
            check_gradient(params.get(name).unwrap(), &[0, 5, 11], 2e-3, &f)?;
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
    let target = wave(&[2, 3, 16, 16], 0.9);
    let f = || mean_squared(&net.forward(&x, &p)?, &target);
    check_gradient(&x, &[0, 17, 130, 255, 700, 1535], 2e-3, &f)?;
    check_gradient(&p, &[0, 1, 2, 3, 4, 5], 2e-3, &f)?;
    for (_, var) in params.iter() {
        check_gradient(var, &[0, 1, 2], 1e-3, &f)?;
    }
    Ok(())
}
