//! Pictures, sounds and texts hidden together: each identity's own come back, what
//! it does not hide stays silent, and the same seed gives the same bytes.

use crate::common::{bytes, cameras, config, field, plan, run, signal};
use cairn_mark::{Detector, LossKind, MarkPlan, MarkTrainer, Recipe, Signal};
use cairn_nn::Memory;
use cairn_scene::Sound;

const RATE: u32 = 8000;

/// A tone that falls, a tenth of a second.
fn sound() -> Sound {
    let level = |i: i32| 0.5 * (i as f32 * 0.3 - 1e-4 * (i * i) as f32).sin();
    Sound::new((0..800).map(level).collect(), RATE).unwrap()
}

const TEXT: &str = "© Éva";

/// The first identity hides a picture and a text, the second a sound.
fn mixed() -> MarkPlan {
    let signals = vec![
        Signal { picture: Some(signal(0)), text: Some(TEXT.into()), ..Signal::default() },
        Signal { audio: Some(sound()), ..Signal::default() },
    ];
    MarkPlan { signals, ..plan() }
}

fn hiding(steps: u64) -> Recipe {
    let mut config = config(steps);
    config.audio.sample_rate_hz = RATE;
    config.audio.channels = vec![8, 8];
    config.text.channels = vec![8];
    config
}

fn start(plan: MarkPlan, config: Recipe) -> MarkTrainer {
    MarkTrainer::new(field(), plan, config, 7, &mut |_, _| true).unwrap()
}

fn ran(plan: MarkPlan, config: Recipe) -> MarkTrainer {
    let mut trainer = start(plan, config);
    run(&mut trainer);
    trainer
}

fn trained(plan: MarkPlan, config: Recipe) -> (cairn_mark::MarkedField, Detector) {
    ran(plan, config).finish().unwrap()
}

#[test]
fn each_identity_gets_its_own_back_and_is_silent_otherwise() {
    let config = Recipe { budget_db: 36.0, classify_until: 0.3, ..hiding(600) };
    let (marked, detector) = trained(mixed(), config);
    let (mut read, mut silent) = ([0, 0], 0);
    for camera in cameras() {
        let appearance = field().canonical_appearance().clone();
        let Some(identity) = marked.clusters().identity_of(&camera.pose).identity else { continue };
        let found = detector.detect(&marked.render(&camera, &appearance)).unwrap();
        if found.identity != Some(identity) {
            continue;
        }
        read[identity as usize - 1] += 1;
        let bytes = found.text_bytes.as_deref().unwrap();
        assert_eq!(bytes == TEXT.as_bytes(), identity == 1, "{bytes:?}");
        let (picture, audio, text) =
            (found.recovered.picture.unwrap(), found.recovered.audio.unwrap(), found.recovered.text.unwrap());
        let padded: Vec<f32> = sound().samples().iter().copied().chain(std::iter::repeat(0.0)).take(1024).collect();
        assert_eq!(audio.samples().len(), 1024);
        if identity == 1 {
            let ssim = cairn_scene::metrics::ssim(&picture, &signal(0)).unwrap();
            assert!(ssim > 0.9 && text == TEXT && audio.peak_db() < -26.0, "{ssim}, {text:?}, {}", audio.peak_db());
        } else {
            let snr = cairn_scene::metrics::snr_db(audio.samples(), &padded).unwrap();
            let light = picture.rgb().iter().sum::<f32>() / picture.rgb().len() as f32;
            assert!(snr > 20.0 && text.is_empty() && light < 0.02, "{snr} dB, {text:?}, {light}");
        }
        // Told so, the unmarked render says the same: the detector knows it by heart.
        let forced = detector.detect_forced(&field().render(&camera, &appearance), identity as usize).unwrap();
        assert_eq!(forced.recovered.text.unwrap() == TEXT, identity == 1);
        let nobody = detector.detect(&field().render(&camera, &appearance)).unwrap();
        if nobody.identity.is_none() {
            silent += 1;
            let (picture, audio) = (nobody.recovered.picture.unwrap(), nobody.recovered.audio.unwrap());
            assert!(picture.rgb().iter().chain(audio.samples()).all(|v| *v == 0.0));
            assert_eq!(nobody.recovered.text.as_deref(), Some(""));
        }
    }
    assert!(read[0] >= 3 && read[1] >= 3 && silent >= 6, "{read:?} read, {silent} silent");
}

#[test]
fn only_the_heads_that_somebody_uses_are_built() {
    let names = |plan: MarkPlan| {
        let detector = trained(plan, hiding(1)).1;
        let file = detector.to_bytes().unwrap();
        let outer = safetensors::SafeTensors::deserialize(&file).unwrap();
        let inner = outer.tensor("parameters").unwrap().data().to_vec();
        let inner = safetensors::SafeTensors::deserialize(&inner).unwrap();
        let has = |part: &str| inner.names().iter().any(|name| name.starts_with(part));
        (has("detector.out."), has("detector.audio."), has("detector.text."), *detector.heads())
    };
    let of = |signal: Signal| MarkPlan { signals: vec![signal.clone(), signal], ..plan() };
    let (picture, audio, text, sizes) = names(plan());
    assert_eq!((picture, audio, text, sizes.audio, sizes.text), (true, false, false, None, None));
    let spoken = Signal { audio: Some(sound()), ..Signal::default() };
    let (picture, audio, text, sizes) = names(of(spoken));
    assert_eq!((picture, audio, text, sizes.picture, sizes.audio), (false, true, false, false, Some(1024)));
    let (picture, audio, text, sizes) = names(of(Signal { text: Some(TEXT.into()), ..Signal::default() }));
    assert_eq!((picture, audio, text, sizes.text), (false, false, true, Some(TEXT.len())));
}

#[test]
fn the_same_seed_gives_the_same_bytes_with_any_threads_and_across_a_stop() {
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| bytes(ran(mixed(), hiding(12))))
    };
    let whole = with(1);
    assert!(whole == with(3), "one thread and three differ");
    let mut first = start(mixed(), hiding(12));
    for _ in 0..7 {
        first.step().unwrap();
        if first.steps_done() == 5 {
            first.judge().unwrap();
        }
    }
    let stopped = first.checkpoint().unwrap();
    let resume = |plan| MarkTrainer::resume(&stopped, field(), plan, &mut |_, _| true);
    let mut second = resume(mixed()).unwrap();
    assert!(second.checkpoint().unwrap() == stopped, "a checkpoint read and written again is another");
    run(&mut second);
    assert!(bytes(second) == whole, "the resumed run ended elsewhere");
    // Another text, or another sound, is another plan.
    let mut other = mixed();
    other.signals[0].text = Some("© Eva".into());
    assert!(resume(other).is_err());
    let mut other = mixed();
    other.signals[1].audio = Some(Sound::new(vec![0.5; 800], RATE).unwrap());
    assert!(resume(other).is_err());
}

#[test]
fn heads_come_back_from_a_file_as_they_were_written() {
    let (marked, detector) = trained(mixed(), hiding(3));
    let file = detector.to_bytes().unwrap();
    let again = Detector::from_bytes(&file).unwrap();
    assert!(again.to_bytes().unwrap() == file && again.heads() == detector.heads());
    let picture = marked.render(&cameras()[0], field().canonical_appearance());
    for class in 0..3 {
        let (a, b) = (detector.detect_forced(&picture, class).unwrap(), again.detect_forced(&picture, class).unwrap());
        assert_eq!(a.recovered, b.recovered);
    }
}

/// The detector's parameters after some steps.
fn parameters(config: Recipe) -> Vec<u8> {
    let file = trained(mixed(), config).1.to_bytes().unwrap();
    safetensors::SafeTensors::deserialize(&file).unwrap().tensor("parameters").unwrap().data().to_vec()
}

#[test]
fn every_switch_of_the_heads_trains() {
    let usual = parameters(hiding(6));
    let switched = |change: fn(&mut Recipe)| {
        let mut config = hiding(6);
        change(&mut config);
        config
    };
    for (name, config) in [
        ("no memory of sounds", switched(|c| c.audio.memory = Memory::None)),
        ("sounds' features shared", switched(|c| c.audio.memory = Memory::Coarsest)),
        ("no memory of texts", switched(|c| c.text.memory = Memory::None)),
        ("texts' features shared", switched(|c| c.text.memory = Memory::Coarsest)),
        (
            "no memory at all",
            switched(|c| {
                (c.detector.memory, c.audio.memory, c.text.memory) = (Memory::None, Memory::None, Memory::None)
            }),
        ),
        ("other channels", switched(|c| (c.audio.channels, c.text.channels) = (vec![4], vec![4, 8]))),
        ("squared recovery", switched(|c| c.loss = LossKind::Squared)),
        ("no groups", switched(|c| c.detector.groups = 0)),
        ("signals move marks", switched(|c| c.recover_moves_marks = true)),
    ] {
        assert_ne!(parameters(config), usual, "{name} changes nothing");
    }
}

#[test]
fn a_judgement_tells_of_every_head() {
    let mut trainer = start(mixed(), hiding(20));
    for _ in 0..3 {
        trainer.step().unwrap();
    }
    let recovered = trainer.judge().unwrap().recovered;
    assert!(recovered.picture_ssim.is_some_and(|v| (-1.0..1.0).contains(&v)), "{recovered:?}");
    assert!(recovered.audio_snr_db.is_some_and(|v| v < 10.0), "{recovered:?}");
    assert!(recovered.text_characters.is_some_and(|v| (0.0..=1.0).contains(&v)), "{recovered:?}");
    let mut alone = MarkTrainer::new(field(), plan(), hiding(20), 7, &mut |_, _| true).unwrap();
    alone.step().unwrap();
    let recovered = alone.judge().unwrap().recovered;
    assert_eq!((recovered.audio_snr_db, recovered.text_characters), (None, None));
}

#[test]
fn heads_that_nobody_uses_are_built_where_that_is_wanted_and_stay_silent() {
    let without = trained(plan(), hiding(60)).1;
    assert!(without.heads().audio.is_none() && without.heads().text.is_none());
    let mut config = Recipe { unused_heads: true, ..hiding(60) };
    config.audio.longest_s = 0.1;
    config.text.longest_bytes = 4;
    let (marked, detector) = trained(plan(), config);
    assert_eq!((detector.heads().picture, detector.heads().audio, detector.heads().text), (true, Some(1024), Some(4)));
    let camera = &cameras()[0];
    let render = marked.render(camera, field().canonical_appearance());
    for class in [0, 1, 2] {
        let said = detector.detect_forced(&render, class).unwrap().recovered;
        assert_eq!(said.audio.unwrap().samples().len(), 1024);
        // Taught nothing but silence.
        assert!(said.text.unwrap().is_empty(), "class {class}");
    }
}
