//! The paper's recipe on a tiny scene: it trains with every part of it in place, and ends as it says.

use crate::common::{SIDE, cameras, field, photograph, plan_of, start};
use cairn_mark::{
    CarrierKind, DensityKind, Detector, Guidance, LossKind, MarkStats, MarkTrainer, MarkedField, MaskKind, Recipe,
};
use cairn_nn::Memory;

/// The paper's recipe with networks and pictures of tiny sizes.
fn paper(steps: u64) -> Recipe {
    let mut mark = Recipe::paper();
    mark.steps = steps;
    mark.classifier.channels = vec![8, 16];
    mark.detector.size = [SIDE, SIDE];
    mark.detector.channels = vec![8, 12, 16];
    mark.validate().unwrap();
    mark
}

#[test]
fn the_papers_recipe_is_what_the_paper_says() {
    let mark = paper(20);
    assert_eq!(
        [mark.weight_classify, mark.weight_recover, mark.weight_empty, mark.weight_picture],
        [0.05, 1.0, 1.0, 1.0]
    );
    assert!(mark.loss_per_render, "a step of several renders is none of equation 5");
    assert_eq!((mark.loss, mark.picture_loss), (LossKind::Absolute, LossKind::Absolute));
    assert_eq!(
        (mark.carrier, mark.density, mark.recover_moves_marks),
        (CarrierKind::Harmonics, DensityKind::Frozen, true)
    );
    assert_eq!((mark.mask, mark.mask_alpha, mark.min_mask), (MaskKind::PerWeight, 3.0, 0.0));
    assert_eq!((mark.guidance, mark.budget, mark.pull, mark.average), (Guidance::Guided, false, 0.0, 0.0));
    assert_eq!((mark.others_cutout_share, mark.min_confidence), (0.0, 0.0));
    assert_eq!(
        (mark.easy_view_share, mark.max_feature_distance, mark.noisy_share, mark.center_crop_confidence),
        (1.0, 0.0, 0.0, 1.0)
    );
    assert_eq!(
        (mark.virtual_views, mark.view_refresh_steps, mark.others, mark.finer, mark.robust.enabled),
        (0, 0, 0, 1, false)
    );
    assert_eq!([mark.detector.memory, mark.audio.memory, mark.text.memory], [Memory::None; 3]);
    assert_eq!((mark.detector.high_pass_gain, mark.classifier.high_pass_gain, mark.detector.gated), (0.0, 0.0, false));
}

/// The first step of three identities with these settings, and how many renders of theta it shows.
fn first_of_three(change: impl FnOnce(&mut Recipe)) -> (MarkStats, f64) {
    let mut config = paper(20);
    change(&mut config);
    let plan = plan_of(&field(), 3, photograph);
    let outside = cameras().iter().any(|camera| plan.clusters.identity_of(&camera.pose).identity.is_none());
    let mut trainer = MarkTrainer::new(field(), plan, config, 7, &mut |_, _| true).unwrap();
    (trainer.step().unwrap(), if outside { 4.0 } else { 3.0 })
}

/// Equation 5 is of one render; a step shows a render of each of three identities, and one of no cluster where there is one.
#[test]
fn a_step_of_three_identities_is_the_mean_of_equation_5_over_its_renders() {
    let near = |got: f64, expected: f64| assert!((got / expected - 1.0).abs() < 1e-5, "{got} for {expected}");
    // Without a classifier to wait for, every loss is there in the first step, of the same pictures under any weights.
    let of = |per_render: bool, weights: [f64; 4]| {
        first_of_three(|mark| {
            (mark.guidance, mark.loss_per_render) = (Guidance::NoClassifier, per_render);
            [mark.weight_classify, mark.weight_recover, mark.weight_empty, mark.weight_picture] = weights;
        })
    };
    let ((render, renders), (step, _)) = (of(true, [0.05, 1.0, 1.0, 1.0]), of(false, [0.05, 1.0, 1.0, 1.0]));
    // l3: the mean over the renders instead of their sum.
    near(step.picture, renders * render.picture);
    // l1: three of the renders hide something.
    near(render.recover, step.recover * 3.0 / renders);
    // The loss is those means by their weights, and nothing else is in it.
    near(render.loss, render.recover + render.empty + render.picture);
    let (heavy, _) = of(true, [0.05, 3.0, 5.0, 7.0]);
    near(heavy.loss, 3.0 * render.recover + 5.0 * render.empty + 7.0 * render.picture);
    // l0: theta's renders and theta_0's are two means. Nothing is learnt yet, and four classes are a guess each.
    let (taught, _) = first_of_three(|_| ());
    assert!((taught.classify / (2.0 * 4.0f64.ln()) - 1.0).abs() < 0.2, "{taught:?}");
    near(taught.loss, 0.05 * taught.classify + taught.picture);
    near(taught.picture, render.picture);
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
