//! The one-dimensional heads: shapes, gradients against finite differences, what
//! each memory holds, and learning.
use cairn_nn::*;
use candle_core::{DType, Device, Tensor, Var};

fn wave(shape: &[usize], phase: f64) -> Tensor {
    let n: usize = shape.iter().product();
    let data: Vec<f32> = (0..n).map(|i| (i as f64 * 0.7391 + phase * 1.3).sin() as f32).collect();
    Tensor::from_vec(data, shape, &Device::Cpu).unwrap()
}

/// A detector of 32 x 32 pictures: its coarsest level is 12 x 8 x 8.
fn encoder() -> UNetConfig {
    UNetConfig { size: [32, 32], channels: vec![4, 8, 12], ..UNetConfig::default() }
}

fn told() -> Tensor {
    Tensor::from_vec(vec![0.2f32, 0.5, 0.3, 0.1, 0.2, 0.7], (2, 3), &Device::Cpu).unwrap()
}

fn one_hot(class: usize) -> Tensor {
    Tensor::from_vec((0..3).map(|k| f32::from(u8::from(k == class))).collect(), (1, 3), &Device::Cpu).unwrap()
}

fn audio(memory: Memory, params: &mut Params) -> Result<AudioHead> {
    let config = AudioConfig { channels: vec![8, 4], memory, ..AudioConfig::default() };
    AudioHead::new(&config, config.samples(300), &encoder(), 3, params.scope("audio"))
}

fn text(memory: Memory, params: &mut Params) -> Result<TextHead> {
    let config = TextConfig { channels: vec![8], memory, ..TextConfig::default() };
    TextHead::new(&config, 5, &encoder(), 3, params.scope("text"))
}

#[test]
fn heads_have_the_shapes_they_say() -> Result<()> {
    let config = AudioConfig::default();
    assert_eq!([1, 256, 257, 48_000].map(|n| config.samples(n)), [256, 256, 512, 48_128]);
    for memory in [Memory::None, Memory::Coarsest, Memory::PerClass] {
        let mut params = Params::new(1);
        let (audio, text) = (audio(memory, &mut params)?, text(memory, &mut params)?);
        let features = wave(&[2, 12, 8, 8], 0.3);
        assert_eq!(audio.forward(&features, &told())?.dims(), [2, 512]);
        assert_eq!(text.forward(&features, &told())?.dims(), [2, 40]);
        assert_eq!((audio.samples(), text.bytes()), (512, 5));
        let kept = |name: &str| params.get(name).map(|v| v.dims().to_vec());
        assert_eq!(kept("audio.memory").is_some(), memory == Memory::PerClass);
        assert_eq!(kept("audio.positional").is_some(), memory == Memory::Coarsest);
        if memory == Memory::PerClass {
            assert_eq!((kept("audio.memory"), kept("text.memory")), (Some(vec![2, 512]), Some(vec![2, 40])));
        }
        let wrong = audio.forward(&wave(&[2, 12, 4, 16], 0.0), &told()).unwrap_err().to_string();
        assert!(wrong.contains("the audio head") && wrong.contains("12 x 8 x 8"), "{wrong}");
        assert!(text.forward(&features, &one_hot(1)).is_err(), "one row of classes for two pictures");
    }
    let mut params = Params::new(1);
    for samples in [0, 255, 300] {
        let config = AudioConfig::default();
        let error = AudioHead::new(&config, samples, &encoder(), 3, params.scope("a")).unwrap_err();
        assert!(error.to_string().contains("audio.samples"), "{error}");
    }
    Ok(())
}

#[test]
fn an_encoder_alone_sees_what_the_whole_detector_sees() -> Result<()> {
    let (mut whole, mut part) = (Params::new(5), Params::new(5));
    let whole_net = UNet::new(&encoder(), 3, whole.scope("d"))?;
    let part_net = UNet::encoder(&encoder(), 3, part.scope("d"))?;
    let images = wave(&[2, 3, 32, 32], 0.1);
    let [a, b] = [&whole_net, &part_net].map(|net| net.features(&images, &told()).unwrap());
    let numbers = |f: &Features| f.coarsest().flatten_all().unwrap().to_vec1::<f32>().unwrap();
    assert_eq!(numbers(&a), numbers(&b));
    assert_eq!(a.coarsest().dims(), [2, 12, 8, 8]);
    assert!(part.numbers() < whole.numbers(), "what draws the picture was built all the same");
    assert!(part_net.draw(&b, &told()).unwrap_err().to_string().contains("encoder alone"));
    let both = whole_net.draw(&a, &told())?.flatten_all()?.to_vec1::<f32>()?;
    assert_eq!(both, whole_net.forward(&images, &told())?.flatten_all()?.to_vec1::<f32>()?);
    Ok(())
}

/// Compares `df/dx` with central differences along the gradient and another direction.
fn check_gradient(name: &str, x: &Var, f: &dyn Fn() -> Result<Tensor>) -> Result<()> {
    let gradient = f()?.backward()?.get(x).expect(name).flatten_all()?.to_vec1::<f32>()?;
    let start = x.flatten_all()?.to_vec1::<f32>()?;
    let norm = |v: &[f32]| v.iter().map(|v| v * v).sum::<f32>().sqrt();
    let size = norm(&gradient);
    assert!(size > 0.0, "{name}: no gradient at all");
    let other: Vec<f32> = (0..start.len()).map(|i| (i as f32 * 1.7 + 1.0).sin()).collect();
    for direction in [&gradient, &other] {
        let direction: Vec<f32> = direction.iter().map(|d| d / norm(direction)).collect();
        let eval = |by: f32| -> Result<f64> {
            let moved: Vec<f32> = start.iter().zip(&direction).map(|(v, d)| v + by * d).collect();
            x.set(&Tensor::from_vec(moved, x.shape(), &Device::Cpu)?)?;
            Ok(f()?.to_scalar::<f64>()?)
        };
        let analytic: f32 = gradient.iter().zip(&direction).map(|(g, d)| g * d).sum();
        let numeric = ((eval(2e-4)? - eval(-2e-4)?) / 4e-4) as f32;
        assert!((numeric - analytic).abs() <= 0.02 * size, "{name}: {numeric} by differences, {analytic} analytic");
    }
    x.set(&Tensor::from_vec(start, x.shape(), &Device::Cpu)?)?;
    Ok(())
}

#[test]
fn gradients_are_right_through_the_heads() -> Result<()> {
    for memory in [Memory::PerClass, Memory::Coarsest] {
        let mut params = Params::new(4);
        let (audio, text) = (audio(memory, &mut params)?, text(memory, &mut params)?);
        let x = Var::from_tensor(&wave(&[2, 12, 8, 8], 0.1))?;
        let p = Var::from_tensor(&told())?;
        let f64s = |t: Tensor| t.to_dtype(DType::F64);
        let sound = wave(&[2, 512], 0.9).to_dtype(DType::F64)?;
        let heard = || mean_squared(&f64s(audio.forward(&x, &p)?)?, &sound);
        let bits = Tensor::from_vec((0..80).map(|i| (i % 3 / 2) as f32).collect(), (2, 40), &Device::Cpu)?;
        let read = || Ok(f64s(binary_cross_entropy(&text.forward(&x, &p)?, &bits)?)?.mean_all()?);
        for (name, f) in [("sound", &heard as &dyn Fn() -> Result<Tensor>), ("text", &read)] {
            check_gradient(name, &x, f)?;
            check_gradient(name, &p, f)?;
        }
        for (name, var) in params.iter() {
            if name.starts_with("audio") {
                check_gradient(name, var, &heard)?
            } else {
                check_gradient(name, var, &read)?
            }
        }
    }
    Ok(())
}

#[test]
fn told_unmarked_they_are_silent_and_told_a_class_they_say_its_memory() -> Result<()> {
    let mut params = Params::new(2);
    let (audio, text) = (audio(Memory::PerClass, &mut params)?, text(Memory::PerClass, &mut params)?);
    let features = wave(&[1, 12, 8, 8], 0.3);
    let heard = |class| audio.forward(&features, &one_hot(class)).unwrap().flatten_all().unwrap().to_vec1::<f32>();
    let read = |class| text.forward(&features, &one_hot(class)).unwrap().flatten_all().unwrap().to_vec1::<f32>();
    assert!(heard(0)?.iter().all(|v| *v == 0.0));
    assert!(read(0)?.iter().all(|v| *v == -8.0) && text_bytes(&read(0)?).is_empty());
    let before = (heard(1)?, read(2)?);
    params.get("audio.memory").unwrap().set(&wave(&[2, 512], 0.5))?;
    params.get("text.memory").unwrap().set(&wave(&[2, 40], 0.7))?;
    // In the memories' units.
    let own = |t: Tensor, row: usize| t.get(row).unwrap().to_vec1::<f32>().unwrap();
    for (i, (a, b)) in before.0.iter().zip(heard(1)?).enumerate() {
        assert!((b - a - 8.0 * own(wave(&[2, 512], 0.5), 0)[i]).abs() < 1e-4);
    }
    for (i, (a, b)) in before.1.iter().zip(read(2)?).enumerate() {
        assert!((b - a - 32.0 * own(wave(&[2, 40], 0.7), 1)[i]).abs() < 1e-4);
    }
    Ok(())
}

#[test]
fn without_memory_a_sound_and_a_text_are_learnt_from_what_is_seen() -> Result<()> {
    let mut params = Params::new(9);
    let (audio, text) = (audio(Memory::None, &mut params)?, text(Memory::None, &mut params)?);
    let mut adam = Adam::new(AdamConfig::default(), Rate::falling(1e-2, 1e-3, 300))?;
    // The class is told to be the same: only the features say which of the two it is.
    let features = Tensor::cat(&[wave(&[1, 12, 8, 8], 0.1), wave(&[1, 12, 8, 8], 2.0)], 0)?;
    let told = Tensor::cat(&[one_hot(1), one_hot(1)], 0)?;
    let tone = |k: f32| (0..512).map(move |i| 0.5 * (i as f32 * k).sin());
    let sounds = Tensor::from_vec(tone(0.11).chain(tone(0.05)).collect(), (2, 512), &Device::Cpu)?;
    let bits = Tensor::from_vec([text_bits("cairn", 5), text_bits("Ada", 5)].concat(), (2, 40), &Device::Cpu)?;
    let mut apart = f32::INFINITY;
    for _ in 0..300 {
        let heard = mean_squared(&audio.forward(&features, &told)?, &sounds)?;
        let read = binary_cross_entropy(&text.forward(&features, &told)?, &bits)?.mean_all()?;
        apart = heard.to_scalar()?;
        adam.step(&params, &(heard + read)?.backward()?)?;
    }
    let read = text.forward(&features, &told)?.to_vec2::<f32>()?;
    assert_eq!([text_bytes(&read[0]), text_bytes(&read[1])], [b"cairn".to_vec(), b"Ada".to_vec()]);
    // Silence would be 0.125.
    assert!(apart < 0.0125, "mean square {apart}");
    Ok(())
}
