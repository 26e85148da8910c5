//! Several scenes with one detector (the paper's case II), and identities that come
//! later: whose mark is whose across scenes, what stays as it is, and the same bytes
//! from the same seed.

use crate::common::{cameras, config, field, photograph, plan, plan_of, run, trained};
use cairn_field::Field;
use cairn_mark::{
    Detector, Earlier, Known, MarkError, MarkPlan, MarkScene, MarkTrainer, MarkedField, Recipe, Restarted, Signal,
};
use cairn_scene::{Camera, Picture};
use std::sync::{Arc, OnceLock};

/// The ball in other colours: another scene.
fn negative(camera: &Camera) -> Picture {
    let mut picture = photograph(camera);
    picture.rgb_mut().iter_mut().for_each(|v| *v = 0.9 - 0.8 * *v);
    picture
}

fn other_field() -> Arc<Field> {
    static FIELD: OnceLock<Arc<Field>> = OnceLock::new();
    FIELD.get_or_init(|| crate::common::train_field_of(60, negative)).clone()
}

fn scenes() -> Vec<MarkScene> {
    let other = plan_of(&other_field(), 1, negative);
    vec![MarkScene::new(field(), plan()), MarkScene::new(other_field(), other)]
}

/// Marks that are learnt in few steps.
fn strong(steps: u64) -> Recipe {
    Recipe { budget_db: 36.0, classify_until: 0.3, ..config(steps) }
}

/// Right answers and questions over a field's views: its marks are classes `first + 1` and up, its base is silent.
fn right(marked: &MarkedField, detector: &Detector, first: u32) -> (usize, usize) {
    let (mut right, mut asked) = (0, 0);
    let appearance = marked.base().canonical_appearance();
    for camera in cameras() {
        let Some(identity) = marked.clusters().identity_of(&camera.pose).identity else { continue };
        let with = detector.detect(&marked.render(&camera, appearance)).unwrap();
        let without = detector.detect(&marked.base().render(&camera, appearance)).unwrap();
        right += usize::from(with.identity == Some(first + identity)) + usize::from(without.identity.is_none());
        asked += 2;
    }
    (right, asked)
}

#[test]
fn scenes_share_a_detector_that_tells_their_owners_apart() {
    let mut trainer = MarkTrainer::joint(scenes(), strong(500), 7, &mut |_, _| true).unwrap();
    run(&mut trainer);
    let (fields, detector) = trainer.finish_joint(&mut |_, _| true).unwrap();
    assert_eq!((fields.len(), detector.classes()), (2, 4));
    let (one, two) = (right(&fields[0], &detector, 0), right(&fields[1], &detector, 2));
    let (right, asked) = (one.0 + two.0, one.1 + two.1);
    assert!(asked >= 20, "{asked} questions are too few to mean anything");
    assert!(right as f64 >= 0.9 * asked as f64, "{one:?} and {two:?} right");
}

#[test]
fn a_joint_training_is_resumed_to_the_same_bytes_and_on_the_same_scenes_only() {
    let bytes = |trainer: MarkTrainer| {
        let (fields, detector) = trainer.finish_joint(&mut |_, _| true).unwrap();
        (fields.iter().map(|f| f.to_bytes().unwrap()).collect::<Vec<_>>(), detector.to_bytes().unwrap())
    };
    // The second has its own settings: what it is taken up with does not count.
    let own = |view_refresh_steps| {
        let mut scenes = scenes();
        scenes[1].settings = Some(Recipe { view_refresh_steps, budget_db: 40.0, ..config(10) });
        scenes
    };
    let mut whole =
        MarkTrainer::joint(own(3), Recipe { view_refresh_steps: 2, ..config(10) }, 7, &mut |_, _| true).unwrap();
    for _ in 0..5 {
        whole.step().unwrap();
    }
    let stopped = whole.checkpoint().unwrap();
    let mut again = MarkTrainer::resume_joint(&stopped, own(0), &mut |_, _| true).unwrap();
    assert_eq!([0, 1].map(|at| again.config_of(at).view_refresh_steps), [2, 3]);
    assert_eq!([0, 1].map(|at| again.config_of(at).budget_db), [config(10).budget_db, 40.0]);
    for trainer in [&mut whole, &mut again] {
        run(trainer);
    }
    assert!(bytes(whole) == bytes(again), "the resumed run ended elsewhere");

    let mut turned = scenes();
    turned.reverse();
    for others in [turned, scenes()[..1].to_vec()] {
        let error = MarkTrainer::resume_joint(&stopped, others, &mut |_, _| true).err().unwrap();
        assert!(matches!(error, MarkError::Stored { what: "checkpoint", .. }), "{error}");
    }
    let none = MarkTrainer::joint(Vec::new(), config(3), 7, &mut |_, _| true).err().unwrap();
    assert!(none.to_string().contains("no scene"), "{none}");
}

/// PSNR of a field's marked renders against its base renders, dB, of the view whose mark is strongest.
fn kept_db(marked: &MarkedField) -> f64 {
    let appearance = marked.base().canonical_appearance();
    let of = |camera: &Camera| {
        let (with, without) = (marked.render(camera, appearance), marked.base().render(camera, appearance));
        let square: f64 = with.rgb().iter().zip(without.rgb()).map(|(a, b)| f64::from(a - b).powi(2)).sum();
        -10.0 * (square / with.rgb().len() as f64).max(1e-12).log10()
    };
    cameras().iter().map(of).fold(f64::INFINITY, f64::min)
}

#[test]
fn each_scene_is_marked_as_strongly_as_its_own_settings_say() {
    let kept = |budgets: [Option<f64>; 2]| {
        let mut scenes = scenes();
        for (scene, budget_db) in scenes.iter_mut().zip(budgets) {
            scene.settings = budget_db.map(|budget_db| Recipe { budget_db, ..strong(300) });
        }
        let mut trainer = MarkTrainer::joint(scenes, strong(300), 7, &mut |_, _| true).unwrap();
        run(&mut trainer);
        let (fields, _) = trainer.finish_joint(&mut |_, _| true).unwrap();
        [&fields[0], &fields[1]].map(kept_db)
    };
    let [one, two] = kept([None, Some(42.0)]);
    assert!((one - 36.0).abs() < 2.0 && (two - 42.0).abs() < 2.0, "{one} dB for 36 and {two} for 42");
    let [one, two] = kept([Some(42.0), None]);
    assert!((one - 42.0).abs() < 2.0 && (two - 36.0).abs() < 2.0, "{one} dB for 42 and {two} for 36");

    let mut wrong = scenes();
    wrong[1].settings = Some(Recipe { others: 99, ..strong(3) });
    let error = MarkTrainer::joint(wrong, strong(3), 7, &mut |_, _| true).err().unwrap();
    assert!(matches!(error, MarkError::Setting { key: "mark.others", .. }), "{error}");
}

/// The plan of one owner, and what was one identity of it of the plan of two.
fn alone() -> (MarkPlan, usize) {
    let (one, two) = (plan_of(&field(), 1, photograph), plan());
    let anchor = one.clusters.clusters[0].anchor;
    let same = two.clusters.clusters.iter().position(|c| c.anchor == anchor).expect("the anchor is one of two");
    (one, same)
}

fn earlier<'a>(marked: &'a MarkedField, detector: &'a Detector, same: usize) -> Earlier<'a> {
    let mut identities = vec![None; 2];
    identities[same] = Some(Known { class: 1, carrier: marked.carrier(1).unwrap() });
    Earlier { detector, identities }
}

fn grow(earlier: &Earlier<'_>, config: Recipe) -> Result<MarkTrainer, MarkError> {
    MarkTrainer::growing(vec![MarkScene::new(field(), plan())], earlier, config, 8, &mut |_, _| true)
}

#[test]
fn an_identity_that_comes_later_leaves_the_marks_that_are_there() {
    let (one, same) = alone();
    let mut first = MarkTrainer::new(field(), one, strong(400), 7, &mut |_, _| true).unwrap();
    run(&mut first);
    let before = first.finish().unwrap();
    // 320 steps: learnt from each of six seeds.
    let mut trainer = grow(&earlier(&before.0, &before.1, same), strong(800)).unwrap();
    assert_eq!(trainer.steps_total(), 320);
    run(&mut trainer);
    let (marked, detector) = trainer.finish().unwrap();
    assert_eq!(marked.carrier(same as u32 + 1), before.0.carrier(1), "a mark that was there moved");
    let (right, asked) = right(&marked, &detector, 0);
    assert!(right as f64 >= 0.9 * asked as f64, "{right} of {asked} right");
}

#[test]
fn growing_is_resumed_to_the_same_bytes() {
    let (one, same) = alone();
    let mut first = MarkTrainer::new(field(), one, config(5), 7, &mut |_, _| true).unwrap();
    run(&mut first);
    let before = first.finish().unwrap();
    let mut whole = grow(&earlier(&before.0, &before.1, same), Recipe { view_refresh_steps: 4, ..config(30) }).unwrap();
    for _ in 0..4 {
        whole.step().unwrap();
    }
    let stopped = whole.checkpoint().unwrap();
    let mut again = MarkTrainer::resume(&stopped, field(), plan(), &mut |_, _| true).unwrap();
    for trainer in [&mut whole, &mut again] {
        run(trainer);
    }
    assert!(crate::common::bytes(whole) == crate::common::bytes(again));
}

#[test]
fn a_head_that_has_to_be_longer_for_who_comes_later_starts_afresh_and_says_so() {
    let says = |text: &str| Signal { text: Some(text.to_owned()), ..Signal::default() };
    let (mut one, same) = alone();
    one.signals = vec![says("Ada")];
    let mut first = MarkTrainer::new(field(), one, config(5), 7, &mut |_, _| true).unwrap();
    run(&mut first);
    let before = first.finish().unwrap();
    let plan_with = |new: &str| {
        let mut plan = plan();
        plan.signals = vec![says(new); 2];
        plan.signals[same] = says("Ada");
        plan
    };
    let grow = |new: &str| {
        let scenes = vec![MarkScene::new(field(), plan_with(new))];
        MarkTrainer::growing(scenes, &earlier(&before.0, &before.1, same), config(30), 8, &mut |_, _| true).unwrap()
    };
    assert_eq!(grow("Bo").restarted(), [], "what is no longer fits");
    let mut longer = grow("Bo, the builder");
    let expected = [Restarted::Text { before: 3, now: 15 }];
    assert_eq!(longer.restarted(), expected);
    longer.step().unwrap();
    let again =
        MarkTrainer::resume(&longer.checkpoint().unwrap(), field(), plan_with("Bo, the builder"), &mut |_, _| true);
    assert_eq!(again.unwrap().restarted(), expected, "forgotten by the checkpoint");
}

#[test]
fn what_cannot_be_grown_is_refused() {
    let before = trained(config(3));
    let known = |class, carrier| Some(Known { class, carrier });
    let (a, b) = (before.0.carrier(1).unwrap(), before.0.carrier(2).unwrap());
    let says = |identities: Vec<Option<Known<'_>>>, config: Recipe, expected: &str| {
        let error = grow(&Earlier { detector: &before.1, identities }, config).err().unwrap().to_string();
        assert!(error.contains(expected), "{error}");
    };
    says(vec![known(1, a), known(2, b)], config(3), "nothing to add");
    says(vec![None, None], config(3), "no identity of the plan was trained before");
    says(vec![known(3, a), None], config(3), "class 3 of an earlier detector of 3");
    says(vec![known(1, &a[3..]), None], config(3), "another base field");
    says(vec![known(1, a)], config(3), "1 identities to go on with for 2");
    let mut wider = config(3);
    wider.classifier.channels = vec![8, 24];
    says(vec![known(1, a), None], wider, "`mark.classifier`");
    let harmonics = Recipe { carrier: cairn_mark::CarrierKind::Harmonics, ..config(3) };
    says(vec![known(1, a), None], harmonics, "`mark.carrier`");
}
