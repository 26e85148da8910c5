//! Settings that no default uses: each does what it says, and what it says only.

use crate::common::{SIDE, bytes, cameras, config, field, photograph, plan, plan_of, start};
use cairn_mark::{CarrierKind, Detector, Guidance, LossKind, MarkPlan, MarkTrainer, MarkedField, MaskKind, Recipe};
use cairn_nn::Memory;
use cairn_scene::Picture;
use cairn_scene::cluster::{ClusterConfig, Clusters, Grouping};
use safetensors::tensor::SafeTensors;

/// Bytes of one part of a file.
fn part(bytes: &[u8], name: &str) -> Vec<u8> {
    SafeTensors::deserialize(bytes).unwrap().tensor(name).unwrap().data().to_vec()
}

/// All steps, never judged: which state is best is no business of these switches.
fn unjudged(plan: MarkPlan, config: Recipe) -> [Vec<u8>; 2] {
    let mut trainer = MarkTrainer::new(field(), plan, config, 7, &mut |_, _| true).unwrap();
    while trainer.steps_done() < trainer.steps_total() {
        trainer.step().unwrap();
    }
    bytes(trainer)
}

#[test]
fn every_switch_trains_and_changes_its_own_part() {
    let memory = |memory| {
        let mut config = config(6);
        config.detector.memory = memory;
        config
    };
    let usual = unjudged(plan(), config(6));
    // Whether marks come out otherwise than by default; networks always do.
    for (name, config, marks) in [
        ("memory none", memory(Memory::None), false),
        ("memory coarsest", memory(Memory::Coarsest), false),
        ("recovery moves marks", Recipe { recover_moves_marks: true, ..config(6) }, true),
        ("squared recovery", Recipe { loss: LossKind::Squared, ..config(6) }, false),
        ("absolute picture loss", Recipe { picture_loss: LossKind::Absolute, ..config(6) }, true),
        ("no mask", Recipe { mask: MaskKind::None, ..config(6) }, true),
        ("no budget", Recipe { budget: false, ..config(6) }, true),
        ("binary mask", Recipe { mask: MaskKind::Binary, ..config(6) }, true),
        ("classifier not guiding", Recipe { guidance: Guidance::Unguided, ..config(6) }, false),
        ("no classifier", Recipe { guidance: Guidance::NoClassifier, recover_moves_marks: true, ..config(6) }, true),
        ("alpha", Recipe { mask_alpha: 1.0, ..config(6) }, true),
        ("the mask's least", Recipe { min_mask: 0.9, ..config(6) }, true),
        ("l0", Recipe { weight_classify: 0.3, ..config(6) }, true),
        ("l1", Recipe { weight_recover: 0.3, ..config(6) }, false),
        ("l2", Recipe { weight_empty: 0.3, ..config(6) }, false),
        ("l3", Recipe { weight_picture: 100.0, ..config(6) }, true),
        ("noise", Recipe { noisy_share: 0.5, ..config(6) }, true),
        ("nothing else", Recipe { others: 0, ..config(6) }, true),
        ("equation 5 a render", Recipe { loss_per_render: true, ..config(6) }, true),
    ] {
        trains_otherwise(name, &usual, config, marks);
    }
}

/// That all steps with `config` end in other networks than `usual`, and in other `marks` or the same, and that what
/// comes of them answers.
fn trains_otherwise(name: &str, usual: &[Vec<u8>; 2], config: Recipe, marks: bool) {
    let [marked, detector] = unjudged(plan(), config);
    assert_eq!(part(&marked, "carriers") != part(&usual[0], "carriers"), marks, "{name}: the marks");
    assert_ne!(part(&detector, "parameters"), part(&usual[1], "parameters"), "{name}: the networks");
    let (marked, detector) = (MarkedField::from_bytes(&marked).unwrap(), Detector::from_bytes(&detector).unwrap());
    let found = detector.detect(&marked.render(&cameras()[0], field().canonical_appearance())).unwrap();
    assert!((found.probabilities.iter().sum::<f32>() - 1.0).abs() < 1e-4, "{name}");
}

#[test]
fn switches_that_count_beside_another_do_so_beside_it() {
    let binary = Recipe { mask: MaskKind::Binary, ..config(6) };
    let usual = unjudged(plan(), binary.clone());
    trains_otherwise("the share that is locked", &usual, Recipe { mask_share: 0.9, ..binary.clone() }, true);
    // What a binary mask locks is locked whatever the paper's mask would be.
    let [marked, detector] = unjudged(plan(), Recipe { mask_alpha: 1.0, min_mask: 0.0, ..binary });
    assert!(part(&marked, "carriers") == part(&usual[0], "carriers"), "alpha counts in a binary mask");
    assert!(part(&detector, "parameters") == part(&usual[1], "parameters"), "alpha counts in a binary mask");

    let harmonics = Recipe { carrier: CarrierKind::Harmonics, ..config(6) };
    let usual = unjudged(plan(), harmonics.clone());
    let grouped = Recipe { mask: MaskKind::PerCoefficientGroup, ..harmonics.clone() };
    trains_otherwise("a mask by groups", &usual, grouped.clone(), true);
    let usual = unjudged(plan(), grouped.clone());
    trains_otherwise("no mask instead of groups", &usual, Recipe { mask: MaskKind::None, ..harmonics }, true);
    trains_otherwise("alpha of groups", &usual, Recipe { mask_alpha: 0.5, ..grouped }, true);
}

#[test]
fn the_loss_of_a_step_is_the_weighted_sum_of_what_it_says() {
    let weighted =
        Recipe { weight_classify: 0.3, weight_recover: 0.7, weight_empty: 0.2, weight_picture: 50.0, ..config(4) };
    let picture_loss = LossKind::Absolute;
    for (name, config, budget) in [
        ("under a budget", weighted.clone(), true),
        ("without one", Recipe { budget: false, picture_loss, ..weighted.clone() }, false),
        ("harmonics", Recipe { carrier: CarrierKind::Harmonics, loss: LossKind::Squared, ..weighted.clone() }, true),
        ("equation 5 a render", Recipe { loss_per_render: true, ..weighted }, true),
    ] {
        let mut trainer = start(config.clone());
        for step in 1..=config.steps {
            let s = trainer.step().unwrap();
            let sum = [
                config.weight_classify * s.classify,
                config.weight_recover * s.recover,
                config.weight_empty * s.empty,
                config.weight_picture * s.picture,
            ];
            let expected: f64 = sum.iter().sum();
            assert!((s.loss / expected - 1.0).abs() < 1e-5, "{name}, step {step}: {} for {sum:?}", s.loss);
            // The detector joins after the first step, and under a budget so does the picture.
            assert_eq!((s.recover > 0.0, s.empty > 0.0), (step > 1, step > 1), "{name}, step {step}: {s:?}");
            assert_eq!(s.picture > 0.0, step > 1 || !budget, "{name}, step {step}: {s:?}");
        }
    }
}

#[test]
fn the_same_pictures_have_the_same_losses_whatever_their_weights() {
    // Without a classifier to wait for, all four are there in the first step; without a budget, the picture in full.
    let all = Recipe { guidance: Guidance::NoClassifier, recover_moves_marks: true, budget: false, ..config(2) };
    let first = |config: Recipe| start(config).step().unwrap();
    let one = first(all.clone());
    let other = first(Recipe { weight_recover: 3.0, weight_empty: 5.0, weight_picture: 7.0, ..all.clone() });
    assert_eq!((one.classify, one.recover), (other.classify, other.recover));
    assert_eq!((one.empty, one.picture), (other.empty, other.picture));
    let more = 2.0 * one.recover + 4.0 * one.empty + 6.0 * one.picture;
    assert!((other.loss - one.loss - more).abs() < 1e-5, "{other:?} after {one:?}");
    // The classification counts where it is trained only.
    let deaf = first(Recipe { weight_classify: 9.0, ..all });
    assert_eq!((deaf.loss, deaf.classify), (one.loss, one.classify));
}

/// An untrained classifier's cross-entropy stays near ln 2: told by that, nothing would ever be read with ease.
#[test]
fn without_a_classifier_ease_comes_from_recovery_and_the_picture_counts() {
    let guidance = Guidance::NoClassifier;
    let mut config = Recipe { guidance, recover_moves_marks: true, classify_until: 0.3, ..config(400) };
    (config.budget_db, config.budget_start_db) = (28.0, 25.0);
    config.detector.memory = Memory::Coarsest;
    let mut trainer = MarkTrainer::new(field(), plan_of(&field(), 1, photograph), config, 7, &mut |_, _| true).unwrap();
    let picture: Vec<f64> = (0..160).map(|_| trainer.step().unwrap().picture).collect();
    assert_eq!(picture[0], 0.0, "nothing is read yet");
    assert!(picture[140..].iter().all(|picture| *picture > 0.0), "{:?}", &picture[140..]);
}

#[test]
fn a_detector_that_is_told_nothing_cannot_be_forced() {
    for (guidance, heeds) in [(Guidance::Guided, true), (Guidance::Unguided, false), (Guidance::NoClassifier, false)] {
        // Judged nowhere, so that what comes out is what training ended with.
        let [marked, detector] = unjudged(plan(), Recipe { guidance, recover_moves_marks: true, ..config(8) });
        let (marked, detector) = (MarkedField::from_bytes(&marked).unwrap(), Detector::from_bytes(&detector).unwrap());
        let render = marked.render(&cameras()[0], field().canonical_appearance());
        let [one, two] = [1, 2].map(|class| detector.detect_forced(&render, class).unwrap().recovered);
        assert_eq!(one != two, heeds, "{guidance:?}");
    }
}

#[test]
fn a_classifier_may_see_finer_pictures_than_the_detector() {
    // Whatever looks unlike its few renders would be doubted, and the classifier not heard.
    let heard = Recipe { finer: 2, max_feature_distance: 0.0, ..config(6) };
    let [marked, detector] = unjudged(plan(), heard);
    assert_ne!(part(&marked, "carriers"), part(&unjudged(plan(), config(6))[0], "carriers"));
    let detector = Detector::from_bytes(&detector).unwrap();
    // Detail that the mean over two pixels each way does not see.
    let checked = |depth: f32| {
        let level = |i: usize| 0.5 + if (i % (2 * SIDE) + i / (2 * SIDE)).is_multiple_of(2) { depth } else { -depth };
        Picture::new(2 * SIDE, 2 * SIDE, (0..4 * SIDE * SIDE).flat_map(|i| [level(i); 3]).collect()).unwrap()
    };
    let [plain, fine] = [0.0, 0.125].map(|depth| detector.detect_forced(&checked(depth), 1).unwrap());
    assert_ne!(plain.probabilities, fine.probabilities, "the classifier is blind to it");
    let (plain, fine) = (plain.recovered.picture.unwrap(), fine.recovered.picture.unwrap());
    assert_eq!((plain.width(), plain.height()), (SIDE, SIDE));
    assert_eq!(plain.rgb(), fine.rgb(), "the detector sees it");
}

#[test]
fn without_a_classifier_it_stays_as_it_was_drawn() {
    let classifier = |guidance, steps| {
        let config = Recipe { guidance, recover_moves_marks: true, ..config(steps) };
        let mut trainer = MarkTrainer::new(field(), plan(), config, 7, &mut |_, _| true).unwrap();
        for _ in 0..steps {
            trainer.step().unwrap();
        }
        let networks = part(&trainer.checkpoint().unwrap(), "networks");
        part(&networks, "classifier.head.weight")
    };
    assert!(classifier(Guidance::NoClassifier, 1) == classifier(Guidance::NoClassifier, 5));
    assert!(classifier(Guidance::Guided, 1) != classifier(Guidance::Guided, 5));
    let idle = Recipe { guidance: Guidance::NoClassifier, ..config(5) };
    assert!(idle.validate().unwrap_err().to_string().contains("mark.recover_moves_marks"));
}

#[test]
fn signals_move_marks_only_where_they_are_told_to() {
    let mut other = plan();
    other.signals.swap(0, 1);
    for (recover_moves_marks, memory) in
        [(false, Memory::PerClass), (true, Memory::PerClass), (false, Memory::None), (true, Memory::None)]
    {
        let mut config = Recipe { recover_moves_marks, ..config(6) };
        config.detector.memory = memory;
        let (one, two) = (unjudged(plan(), config.clone()), unjudged(other.clone(), config));
        let told = format!("recover_moves_marks = {recover_moves_marks}, {memory:?}");
        assert_eq!(part(&one[0], "carriers") != part(&two[0], "carriers"), recover_moves_marks, "{told}");
        assert_ne!(part(&one[1], "parameters"), part(&two[1], "parameters"), "{told}: the detector");
    }
}

#[test]
fn a_budget_is_spent_however_much_the_picture_loss_asks() {
    // Read with ease from the first step, so that the picture loss counts in full.
    let wanted = Recipe { weight_picture: 1e6, budget_ramp: 0.2, budget_db: 36.0, ..config(30) };
    let kept = |config: Recipe| {
        let mut trainer = start(config);
        let mut kept = 0.0;
        while trainer.steps_done() < trainer.steps_total() {
            kept = trainer.step().unwrap().kept_db;
        }
        kept
    };
    // The furthest of a step's renders lies at the budget, the mean a little nearer.
    let held = kept(wanted.clone());
    assert!((35.0..39.0).contains(&held), "{held} dB");
    let free = kept(Recipe { budget: false, ..wanted });
    assert!(free > held + 3.0, "{free} dB without a budget, {held} with it");
}

#[test]
fn without_a_budget_nothing_scales_a_mark() {
    // Neither a picture loss nor a gradient worth the name: only the budget is left to move marks.
    let still = Recipe { learning_rate_carrier: 1e-9, pull: 0.0, ..config(4) };
    let strength = |config: &Recipe| {
        let values = part(&unjudged(plan(), config.clone())[0], "carriers");
        let values = values.chunks_exact(2).map(|b| half::f16::from_le_bytes([b[0], b[1]]).to_f64().abs());
        values.fold(0.0, f64::max)
    };
    for start_db in [32.0, 26.0] {
        let first = 10f64.powf(-start_db / 20.0) * 0.95;
        let free = strength(&Recipe { budget: false, budget_start_db: start_db, ..still.clone() });
        let held = strength(&Recipe { budget_start_db: start_db, ..still.clone() });
        assert!(free >= first * 0.8 && free <= first * 1.1, "{start_db} dB: {free} for a pattern of {first}");
        assert!((held / free - 1.0).abs() > 0.2, "{start_db} dB: {held} with the budget, {free} without");
    }
    // The picture loss is there from the first step: it alone pulls the mark to nothing.
    let pulled = Recipe { budget: false, weight_picture: 1e6, classify_until: 0.001, ..config(4) };
    let renders = |config: &Recipe| {
        let mut trainer = start(config.clone());
        let mut kept = Vec::new();
        while trainer.steps_done() < trainer.steps_total() {
            kept.push(trainer.step().unwrap().kept_db);
        }
        kept
    };
    let kept = renders(&pulled);
    assert!(kept[3] > kept[0] + 0.1, "{kept:?}");
}

/// Rows of the one carrier that training moved; the state is judged on the way.
fn rows_moved(plan: MarkPlan) -> usize {
    let config = Recipe { carrier: CarrierKind::Harmonics, budget: false, pull: 0.0, ..config(12) };
    let mut trainer = MarkTrainer::new(field(), plan, config, 7, &mut |_, _| true).unwrap();
    let before = part(&trainer.checkpoint().unwrap(), "carrier0.values");
    while trainer.steps_done() < trainer.steps_total() {
        trainer.step().unwrap();
    }
    let judged = trainer.judge().unwrap();
    assert!((0.0..=1.0).contains(&judged.accuracy), "{judged:?}");
    let after = part(&trainer.checkpoint().unwrap(), "carrier0.values");
    before.chunks_exact(27 * 4).zip(after.chunks_exact(27 * 4)).filter(|(a, b)| a != b).count()
}

#[test]
fn one_carrier_for_all_is_trained_where_it_must_be_silent() {
    let mut all = plan();
    let poses: Vec<_> = all.views.iter().map(|v| v.camera.pose).collect();
    // One small cluster: much of the ball is seen from outside it only.
    let small = ClusterConfig { anchors: 1, neighbours: 2, ..ClusterConfig::default() };
    all.signals.pop();
    all.clusters = Clusters::build(&poses, &Grouping::Anchors(small), &[], 5).unwrap();
    let mut inside = all.clone();
    inside.views.retain(|v| inside.clusters.identity_of(&v.camera.pose).identity.is_some());
    let outside = all.views.len() - inside.views.len();
    assert!(outside >= 5, "{outside} views outside: too few for one of them to judge");
    let (with, without) = (rows_moved(all), rows_moved(inside));
    assert!(with > without + 100, "{with} rows with views outside, {without} without");
}
