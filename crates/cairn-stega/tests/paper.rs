//! configs/paper.toml, the paper's recipe as far as it is a setting, on a tiny scene: it trains with every part of it in
//! place, and ends as it says.

mod common;

use cairn_nn::Memory;
use cairn_stega::{CarrierKind, DensityKind, Detector, Guidance, LossKind, MarkConfig, MarkedField, MaskKind};
use common::{SIDE, cameras, field, start};
use serde::Deserialize;

/// A settings file of stage 2 alone.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Settings {
    mark: MarkConfig,
}

/// The shipped file over the defaults, with networks and pictures of tiny sizes, and nothing else, laid over it.
fn paper(steps: u64) -> MarkConfig {
    let Settings { mut mark } = toml::from_str(include_str!("../../../configs/paper.toml")).unwrap();
    mark.steps = steps;
    mark.classifier.channels = vec![8, 16];
    mark.detector.size = [SIDE, SIDE];
    mark.detector.channels = vec![8, 12, 16];
    mark.validate().unwrap();
    mark
}

#[test]
fn the_papers_recipe_is_what_the_file_says() {
    let mark = paper(20);
    assert_eq!(
        [mark.weight_classify, mark.weight_recover, mark.weight_empty, mark.weight_picture],
        [0.05, 1.0, 1.0, 1.0]
    );
    assert_eq!((mark.loss, mark.picture_loss), (LossKind::Absolute, LossKind::Absolute));
    assert_eq!(
        (mark.carrier, mark.density, mark.recover_moves_marks),
        (CarrierKind::Harmonics, DensityKind::Frozen, true)
    );
    assert_eq!((mark.mask, mark.mask_alpha, mark.mask_least), (MaskKind::PerWeight, 3.0, 0.0));
    assert_eq!((mark.guidance, mark.budget, mark.pull, mark.average), (Guidance::Told, false, 0.0, 0.0));
    assert_eq!((mark.settled_share, mark.unfamiliar_beyond), (1.0, 0.0));
    assert_eq!(
        (mark.virtual_views, mark.fresh_every, mark.others, mark.finer, mark.robust.enabled),
        (0, 0, 0, 1, false)
    );
    assert_eq!([mark.detector.memory, mark.audio.memory, mark.text.memory], [Memory::None; 3]);
    assert_eq!((mark.detector.high_pass_gain, mark.classifier.high_pass_gain, mark.detector.gated), (0.0, 0.0, false));
}

#[test]
fn the_papers_recipe_trains_and_ends_with_every_loss_in_place() {
    let config = paper(20);
    let mut trainer = start(config.clone());
    let mut last = None;
    while trainer.steps_done() < trainer.steps_total() {
        let stats = trainer.step().unwrap();
        // The picture is kept from the first step, the detector is there from the second.
        assert!(stats.picture > 0.0 && stats.classify > 0.0, "{stats:?}");
        assert_eq!((stats.recover > 0.0, stats.empty > 0.0), (stats.step > 1, stats.step > 1), "{stats:?}");
        let expected = config.weight_classify * stats.classify
            + config.weight_recover * stats.recover
            + config.weight_empty * stats.empty
            + config.weight_picture * stats.picture;
        assert!((stats.loss / expected - 1.0).abs() < 1e-5, "{stats:?}: {expected}");
        last = Some(stats);
    }
    // Not one step less: nothing ends it early. Nothing waits, so that it cannot end in `NotLearnt`.
    assert_eq!((last.unwrap().step, trainer.joined_at()), (20, Some(1)));
    let judged = trainer.judge().unwrap();
    assert!((0.0..=1.0).contains(&judged.accuracy) && judged.recovered.picture_ssim.is_some(), "{judged:?}");
    let (marked, detector) = trainer.finish().unwrap();
    let marked = MarkedField::from_bytes(&marked.to_bytes().unwrap()).unwrap();
    let detector = Detector::from_bytes(&detector.to_bytes().unwrap()).unwrap();
    let (camera, appearance) = (cameras()[0], field().canonical_appearance().clone());
    let render = marked.render(&camera, &appearance);
    assert!(render != field().render(&camera, &appearance), "nothing shows");
    // Without a gate an unmarked picture is not silent by construction, but for what was learnt.
    let silent = detector.detect_forced(&render, 0).unwrap().recovered.picture.unwrap();
    assert!(silent.rgb().iter().any(|v| *v != 0.0), "the gate is there");
}
