//! Parameters and the optimiser: seeds, files, refusals, and Adam's numbers.

use cairn_nn::{Adam, AdamConfig, Init, NnError, Params, Rate, Result};
use candle_core::{Device, Tensor};

fn two(seed: u64) -> Result<Params> {
    let mut params = Params::new(seed);
    params.scope("b").get("weight", &[4, 3], Init::He { fan_in: 3 })?;
    params.scope("a").sub("deep").get("weight", &[5], Init::Uniform(0.5))?;
    Ok(params)
}

fn numbers(params: &Params, name: &str) -> Vec<f32> {
    params.get(name).and_then(|v| v.flatten_all().ok()?.to_vec1().ok()).expect("a parameter")
}

#[test]
fn a_parameter_starts_from_the_seed_and_its_name_alone() -> Result<()> {
    let (params, mut other) = (two(9)?, Params::new(9));
    other.scope("first").get("weight", &[100], Init::Uniform(1.0))?;
    other.scope("b").get("weight", &[4, 3], Init::He { fan_in: 3 })?;
    assert_eq!(numbers(&params, "b.weight"), numbers(&other, "b.weight"), "another layer changed this one's start");
    assert_ne!(numbers(&params, "b.weight"), numbers(&two(10)?, "b.weight"), "the seed changes nothing");
    assert_eq!(params.iter().map(|(name, _)| name).collect::<Vec<_>>(), ["a.deep.weight", "b.weight"]);
    assert_eq!((params.len(), params.numbers()), (2, 17));
    Ok(())
}

#[test]
fn uniform_starts_fill_their_range_evenly() -> Result<()> {
    let mut params = Params::new(0);
    params.scope("x").get("w", &[20_000], Init::He { fan_in: 24 })?;
    let v = numbers(&params, "x.w");
    let mean = v.iter().sum::<f32>() / v.len() as f32;
    let variance = v.iter().map(|v| v * v).sum::<f32>() / v.len() as f32;
    assert!(v.iter().all(|v| v.abs() <= 0.5) && v.iter().any(|v| *v > 0.499) && v.iter().any(|v| *v < -0.499));
    assert!(mean.abs() < 0.01, "mean {mean}");
    assert!((variance - 2.0 / 24.0).abs() < 0.002, "variance {variance}, He's is 2 / fan_in");
    Ok(())
}

#[test]
fn files_come_back_and_are_the_same_bytes_every_time() -> Result<()> {
    let params = two(3)?;
    let bytes = params.to_bytes()?;
    assert_eq!(bytes, two(3)?.to_bytes()?);
    let back = Params::from_bytes(&bytes)?;
    assert_eq!(back.seed(), 3);
    assert_eq!(bytes, back.to_bytes()?);
    let mut other = two(4)?;
    let var = other.get("b.weight").expect("made above").clone();
    other.load(&bytes)?;
    assert_eq!(
        var.flatten_all()?.to_vec1::<f32>()?,
        numbers(&params, "b.weight"),
        "a network's own tensor was not set"
    );
    Ok(())
}

#[test]
fn foreign_files_are_refused_and_change_nothing() -> Result<()> {
    let mut params = two(3)?;
    let before = params.to_bytes()?;
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(text(&before).contains("version\\\":1"), "the header says the version");
    let at = before.windows(11).position(|w| w == b"version\\\":1").expect("as asserted") + 10;
    let mut later = before.clone();
    later[at] = b'7';
    let error = params.load(&later).expect_err("version 7").to_string();
    assert!(error.contains("version 7") && error.contains("version 1"), "{error}");
    for cut in [0, 5, 40, before.len() - 1] {
        assert!(matches!(params.load(&before[..cut]), Err(NnError::Container { .. })), "cut at {cut}");
    }
    let mut more = two(5)?;
    more.scope("c").get("weight", &[1], Init::Constant(0.0))?;
    let error = params.load(&more.to_bytes()?).expect_err("one too many").to_string();
    assert!(error.contains("`c.weight`"), "{error}");
    let error = more.load(&before).expect_err("one too few").to_string();
    assert!(error.contains("`c.weight`"), "{error}");
    let error = params.scope("b").get("weight", &[3, 4], Init::Constant(0.0)).expect_err("another shape").to_string();
    assert!(error.contains("`b.weight`") && error.contains("[3, 4]"), "{error}");
    assert_eq!(params.to_bytes()?, before);
    Ok(())
}

#[test]
fn adam_takes_the_steps_of_the_paper() -> Result<()> {
    let mut params = Params::new(0);
    let w = params.scope("x").get("w", &[2], Init::Constant(1.0))?;
    let mut adam = Adam::new(AdamConfig::default(), Rate { initial: 0.1, decay: 0.5 })?;
    let (mut p, mut m, mut v) = ([1.0_f64; 2], [0.0; 2], [0.0; 2]);
    let scale = Tensor::new(&[3.0f32, -0.01], &Device::Cpu)?;
    for t in 1..=4 {
        adam.step(&params, &(w.sqr()? * &scale)?.sum_all()?.backward()?)?;
        for i in 0..2 {
            let g = 2.0 * p[i] * [3.0, -0.01][i];
            m[i] = 0.9 * m[i] + 0.1 * g;
            v[i] = 0.999 * v[i] + 0.001 * g * g;
            let (mean, square) = (m[i] / (1.0 - 0.9_f64.powi(t)), v[i] / (1.0 - 0.999_f64.powi(t)));
            p[i] -= 0.1 * 0.5_f64.powi(t - 1) * mean / (square.sqrt() + 1e-8);
        }
        for (got, expected) in numbers(&params, "x.w").iter().zip(p) {
            assert!((f64::from(*got) - expected).abs() < 1e-5, "step {t}: {got}, expected {expected}");
        }
    }
    Ok(())
}

#[test]
fn rates_fall_and_those_out_of_range_are_refused() {
    let rate = Rate::falling(1e-3, 1e-4, 10);
    assert!((rate.at(10) - 1e-4).abs() < 1e-12 && (rate.at(5) - 1e-3 * 0.1_f64.sqrt()).abs() < 1e-12);
    assert!(Adam::new(AdamConfig::default(), Rate { initial: f64::NAN, decay: 1.0 }).is_err());
    assert!(Adam::new(AdamConfig { beta1: 1.0, ..Default::default() }, Rate::constant(1.0)).is_err());
}

#[test]
fn a_gradient_that_is_not_finite_is_named_and_changes_nothing() -> Result<()> {
    for (poison, word) in [(f32::NAN, "NaN"), (f32::INFINITY, "inf"), (1e30, "1")] {
        let mut params = Params::new(0);
        let good = params.scope("a").get("good", &[2], Init::Constant(1.0))?;
        let bad = params.scope("b").get("bad", &[3], Init::Constant(1.0))?;
        let mut adam = Adam::new(AdamConfig::default(), Rate::constant(0.1))?;
        adam.step(&params, &(good.sum_all()? + bad.sum_all()?)?.backward()?)?;
        let before = (params.to_bytes()?, adam.to_bytes()?);
        let scale = Tensor::new(&[1.0f32, poison, 1.0], &Device::Cpu)?;
        let loss = (good.sum_all()? + (&bad * &scale)?.sum_all()?)?;
        let error = adam.step(&params, &loss.backward()?).expect_err("a poisoned gradient").to_string();
        assert!(error.contains("`b.bad`") && error.contains(word) && error.contains("entry 1"), "{error}");
        assert_eq!(before, (params.to_bytes()?, adam.to_bytes()?), "the refused step changed something");
    }
    Ok(())
}

#[test]
fn a_parameter_without_a_gradient_stays() -> Result<()> {
    let mut params = two(2)?;
    let before = numbers(&params, "a.deep.weight");
    let b = params.scope("b").get("weight", &[4, 3], Init::Constant(0.0))?;
    let mut adam = Adam::new(AdamConfig::default(), Rate::constant(0.1))?;
    adam.step(&params, &b.sum_all()?.backward()?)?;
    assert_eq!(before, numbers(&params, "a.deep.weight"));
    let error = adam.load(&Params::new(0), &adam.to_bytes()?).expect_err("no such parameter").to_string();
    assert!(error.contains("`b.weight`"), "{error}");
    Ok(())
}
