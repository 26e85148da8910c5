//! What becomes of a request before anything is trained: whose settings hold, who hides what, and what is refused.

use cairn_scene::SceneFolder;
use cairn_scene::SceneKind;
use cairn_scene::cluster::{ClusterConfig, Grouping};

use super::*;
use crate::config::{PresetChoice, TrainingOptions};
use crate::engine::Opening;
use crate::error::EngineError;
use crate::store::given::Given;
use crate::store::hidden::Parts;

fn hiding(name: &str) -> Given {
    let parts = Parts { text: Some(format!("by {name}").into_bytes()), ..Parts::default() };
    Given { name: name.into(), parts }
}

/// A data folder with the scene `town`, whose contributors are known, and a daemon with these settings.
fn untrained(settings: &str) -> (TestFolder, Engine) {
    let dir = TestFolder::new();
    let engine = Engine::open(dir.path(), &Config::from_toml(settings, "test").unwrap(), Opening::Serve).unwrap();
    put(&dir, "town", None);
    (dir, engine)
}

/// Puts a scene into a data folder, of its own kind or of that one.
fn put(dir: &TestFolder, name: &str, kind: Option<SceneKind>) {
    let config = LandmarkConfig { contributors: 2, photographs: 4, width: 32, height: 32, ..LandmarkConfig::default() };
    let folder = dir.path().join(format!("capture-{name}"));
    Landmark::generate(&config, 3).unwrap().write(&folder).unwrap();
    let contributors = Some(folder.join("contributors.csv"));
    let table = ReadOptions { contributors, hold_out: Some(8), ..ReadOptions::default() };
    let mut capture = Capture::read(&folder, &table).unwrap();
    capture.kind = kind.unwrap_or(capture.kind);
    if kind == Some(SceneKind::ForwardFacing) {
        capture.views.iter_mut().for_each(|view| view.bounds = Some((0.5, 20.0)));
    }
    SceneFolder::create(&dir.path().join("scenes"), name, &capture).unwrap();
}

/// A training of `town` by contributor.
fn by_contributor(signals: &[&str]) -> TrainingRequest {
    let grouping = Grouping::ByContributor { min_views: 2, direction_weight: 1.0 };
    TrainingRequest { grouping, signals: signals.iter().map(|name| hiding(name)).collect(), ..request(2) }
}

/// The job as it was accepted; it is not run to its end.
fn accepted(engine: &Engine, request: TrainingRequest) -> Job {
    let job = engine.train(request).unwrap();
    engine.jobs().cancel(&job.id).unwrap();
    job
}

#[test]
fn the_request_counts_first_then_the_daemons_file_then_the_preset() {
    let (_dir, engine) = untrained("[training]\nquality = \"draft\"\nrobust = true\nmax_voxels = 5000\n");
    let asked =
        |options| accepted(&engine, TrainingRequest { plan: Plan::Options(options), ..request(2) }).spec.settings;
    let chosen = |preset, quality, robust| preset::settings(Chosen { preset, quality, robust });
    let file = asked(TrainingOptions::default());
    let expected = chosen(Preset::Outdoor, Quality::Draft, true);
    assert_eq!((&file.mark, file.chosen), (&expected.mark, expected.chosen));
    assert_eq!((file.field.voxels, file.field.max_voxels, file.field.steps), (5000, 5000, expected.field.steps));
    let own = asked(TrainingOptions {
        preset: Some(PresetChoice::Object),
        quality: Some(Quality::Balanced),
        robust: Some(false),
        max_voxels: Some(0),
        payload_text_bytes: Some(300),
        ..TrainingOptions::default()
    });
    let mut expected = chosen(Preset::Object, Quality::Balanced, false);
    expected.mark.text.longest_bytes = 300;
    assert_eq!(own, expected);
}

#[test]
fn options_out_of_range_are_refused_by_name_and_a_training_that_goes_on_takes_none() {
    let (_dir, engine) = untrained("");
    let odd = TrainingOptions { payload_picture_px: Some(40), ..TrainingOptions::default() };
    let says = |request: TrainingRequest, parts: &[&str]| {
        let error = engine.train(request).unwrap_err().to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{error}");
    };
    let parts = ["training.payload_picture_px", "40", "a multiple of 16 from 32 to 512"];
    says(TrainingRequest { plan: Plan::Options(odd.clone()), ..request(2) }, &parts);
    says(
        TrainingRequest { grow: true, plan: Plan::Options(odd), ..request(2) },
        &["options", "the earlier one's settings"],
    );
}

#[test]
fn each_of_several_scenes_is_marked_by_the_settings_of_its_kind_with_the_finest_ones_networks() {
    let (dir, engine) = untrained("");
    put(&dir, "mill", Some(SceneKind::Bounded));
    put(&dir, "gate", Some(SceneKind::Unbounded));
    let of = |preset| preset::settings(Chosen { preset, quality: Quality::Balanced, robust: false });
    let [object, front] = [Preset::Object, Preset::Outdoor].map(of);
    assert!(object.mark.finer > front.mark.finer && object.mark.budget_db != front.mark.budget_db);
    // Whose marks are told less surely must not lose them by another's settings.
    assert!(object.mark.min_confidence > front.mark.min_confidence);
    let shared = cairn_mark::Recipe { min_confidence: front.mark.min_confidence, ..object.mark.clone() };
    let wanted = |scene: &str, also: &str| TrainingRequest {
        scene: scene.into(),
        also: vec![also.into()],
        plan: Plan::default(),
        ..request(2)
    };
    for (scene, also, first, second) in [("gate", "mill", &front, &object), ("mill", "gate", &object, &front)] {
        let job = accepted(&engine, wanted(scene, also));
        assert_eq!(job.spec.settings.mark, shared, "{scene} and {also}");
        assert_eq!(job.spec.settings.field, first.field);
        for (at, own) in [first, second].into_iter().enumerate() {
            let settings = job.of_scene(at).spec.settings;
            assert_eq!(settings.field, own.field);
            assert_eq!(settings.mark, shared.for_scene(&own.mark), "{scene} and {also}, {at}");
        }
        let said = job
            .notes
            .iter()
            .filter(|note| note.contains("\"mill\"") && note.contains("looks at marks most finely"))
            .count();
        assert_eq!(said, usize::from(scene == "gate"), "{:?}", job.notes);
    }
    // What all of them want stays.
    put(&dir, "yard", Some(SceneKind::ForwardFacing));
    for (scene, also, least) in [("gate", "yard", 0.0), ("yard", "gate", 0.0), ("yard", "mill", 0.8)] {
        assert_eq!(
            accepted(&engine, wanted(scene, also)).spec.settings.mark.min_confidence,
            least,
            "{scene} and {also}"
        );
    }
    // One alone is as ever.
    let job = accepted(&engine, TrainingRequest { also: Vec::new(), ..wanted("yard", "gate") });
    assert_eq!(job.spec.settings.mark.min_confidence, 0.8);
    let job = accepted(&engine, TrainingRequest { also: Vec::new(), ..wanted("gate", "mill") });
    assert_eq!((&job.spec.settings.mark, &job.of_scene(0).spec.settings.mark), (&front.mark, &front.mark));
    assert!(job.spec.marks.is_empty());
}

#[test]
fn marks_that_want_a_finer_look_than_the_detector_gone_on_from_has_are_told_so() {
    let trained = Trained::new();
    let engine = open(trained.dir.path());
    put(&trained.dir, "mill", Some(SceneKind::Bounded));
    put(&trained.dir, "gate", Some(SceneKind::Unbounded));
    for (also, told) in [("mill", true), ("gate", false)] {
        let more = TrainingRequest { also: vec![also.into()], grow: true, plan: Plan::default(), ..request(2) };
        let job = accepted(&engine, more);
        let (town, other) = (&trained.job.spec.settings.mark, &job.of_scene(1).spec.settings.mark);
        assert_eq!((&job.spec.settings.mark, &job.of_scene(0).spec.settings.mark), (town, town));
        assert_eq!((other.finer, &other.classifier, other.steps), (town.finer, &town.classifier, town.steps));
        let said = job.notes.iter().any(|note| note.contains(also) && note.contains("more finely"));
        assert_eq!(said, told, "{:?}", job.notes);
    }
}

#[test]
fn who_hides_what_goes_by_labels_and_is_told_before_training_begins() {
    let (dir, engine) = untrained("");
    let scene = engine.scene("town").unwrap();
    let clusters = clusters(&scene, &by_contributor(&[]).grouping, 7).unwrap();
    let labels: Vec<String> = identities(&scene, &clusters).into_iter().map(|i| i.label).collect();
    let [one, two] = &labels[..] else { panic!("two contributors: {labels:?}") };
    let kept = |job: &Job, number: usize| {
        let file = dir.path().join("jobs").join(&job.id).join(format!("signal-{number}.txt"));
        std::fs::read_to_string(file).unwrap()
    };
    let job = accepted(&engine, by_contributor(&[two, one]));
    assert_eq!((kept(&job, 1), kept(&job, 2)), (format!("by {one}"), format!("by {two}")));
    let said = |number: usize, label: &str, name: &str| format!("identity {number} ({label}) hides {name} (text)");
    assert_eq!(job.notes, [said(1, one, one), said(2, two, two)]);
    // Names that are nobody's go by their order.
    let job = accepted(&engine, by_contributor(&["logo-1", "logo-2"]));
    assert_eq!(job.notes, [said(1, one, "logo-1"), said(2, two, "logo-2")]);
    // And those beyond the last identity are nobody's.
    let job = accepted(&engine, by_contributor(&["logo-1", "logo-2", "logo-3"]));
    assert!(job.notes.last().is_some_and(|note| note.starts_with("nobody hides \"logo-3\"")), "{:?}", job.notes);

    let says = |request: TrainingRequest, expected: &[&str]| {
        let error = engine.train(request).unwrap_err();
        assert!(matches!(error, EngineError::Invalid { .. }), "{error:?}");
        let error = error.to_string();
        assert!(expected.iter().all(|part| error.contains(part)), "{error}");
    };
    says(by_contributor(&[one, "nobody"]), &["\"nobody\"", one]);
    says(TrainingRequest { base_only: true, ..by_contributor(&[one, two]) }, &["signals to hide", "no marks"]);
}

#[test]
fn a_scene_does_not_grow_out_of_an_identity_that_it_has() {
    let (_dir, engine) = untrained("");
    let scene = engine.scene("town").unwrap();
    let of = |anchors, seed| TrainingRequest { seed, ..request(anchors) };
    let labels_of = |request: &TrainingRequest| -> Vec<String> {
        let clusters = clusters(&scene, &request.grouping, request.seed).unwrap();
        identities(&scene, &clusters).into_iter().map(|i| i.label).collect()
    };
    // Another seed's anchors are one of the earlier two and others: some to add, and one lost.
    let seeds = (1..40).flat_map(|first| (1..40).map(move |next| (first, next)));
    let both = seeds.flat_map(|(first, next)| [2, 3].map(|anchors| (of(2, first), of(anchors, next))));
    let lost = |(first, next): &(TrainingRequest, TrainingRequest)| {
        let now = labels_of(next);
        labels_of(first).into_iter().filter(|label| !now.contains(label)).collect::<Vec<String>>()
    };
    let (first, next) = both.into_iter().find(|pair| lost(pair).len() == 1).expect("seeds that lose one of two");
    let missing = lost(&(first.clone(), next.clone())).remove(0);
    end_of(&engine, &engine.train(first.clone()).unwrap().id);
    let before = engine.newest_model("town").unwrap().unwrap();

    let growing = |request: TrainingRequest| TrainingRequest { grow: true, plan: Plan::default(), ..request };
    let error = engine.train(growing(next)).unwrap_err().to_string();
    let seed = format!("seed {}", first.seed);
    for part in [missing.as_str(), "nobody would read", &seed, "scene check town", &before.job] {
        assert!(error.contains(part), "{part:?} is not in: {error}");
    }
    let kept = labels(&before).into_iter().find(|label| *label != missing).unwrap();
    assert!(!error.contains(kept), "{kept} is there: {error}");
    // All of them gone is refused alike.
    let error = engine.train(growing(by_contributor(&[]))).unwrap_err().to_string();
    assert!(labels(&before).into_iter().all(|label| error.contains(label)), "{error}");
    // Who names no seed goes on with the one there was.
    let job = accepted(&engine, growing(of(3, 0)));
    assert_eq!((job.spec.seed, job.spec.grow_from), (first.seed, vec![Some(before.job.clone())]));
}

#[test]
fn views_that_went_since_a_job_was_accepted_do_not_cost_an_identity_its_mark() {
    let trained = Trained::new();
    let engine = open(trained.dir.path());
    let info = engine.newest_model("town").unwrap().unwrap();
    let training = Training {
        scenes: trained.path("scenes"),
        models: trained.path("models"),
        jobs: trained.path("jobs"),
        exclusions: Arc::new(Exclusions::open(trained.path("exclusions"), &trained.path("scenes")).unwrap()),
        checkpoint_every: Duration::from_secs(30),
    };
    let part = |anchors: usize| {
        let sizes = ClusterConfig { anchors, neighbours: 2, ..ClusterConfig::default() };
        let scene = engine.scene("town").unwrap();
        let clusters = clusters(&scene, &Grouping::Anchors(sizes), 7).unwrap();
        Part {
            job: trained.job.clone(),
            folder: trained.folder(),
            scene,
            photographs: Default::default(),
            clusters,
            earlier: Some(info.clone()),
        }
    };
    assert!(joint::grown(&training.models, &[part(3)]).unwrap().is_some());
    // With one anchor the second identity is gone.
    let error = joint::grown(&training.models, &[part(1)]).map(|_| ()).unwrap_err().to_string();
    assert!(error.contains(labels(&info)[1]) && error.contains("nobody would read"), "{error}");
}
