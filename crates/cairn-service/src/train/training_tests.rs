//! One job on a made-up landmark: cut off after its model was published, and
//! stopped while a stage is being prepared.

use cairn_scene::SceneFolder;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicU8;

use cairn_landmark::{Landmark, LandmarkConfig};
use cairn_mark::Signal;
use cairn_scene::cluster::Grouping;
use cairn_scene::{Capture, ReadOptions};
use tokio::sync::watch;

use super::*;
use crate::config::{Chosen, Config, Preset, Quality, TrainingSettings, preset};
use crate::engine::{Engine, Opening};
use crate::store::given::Given;
use crate::store::hidden::Parts;
use crate::store::model;
use crate::store::model::ModelInfo;
use crate::store::scenes;
use crate::store::test_folder::TestFolder;
use crate::train::clusters::{clusters, identities};
use crate::train::job::JobState;
use crate::train::request::{Plan, TrainingRequest};
use crate::train::stages::Stage as _;

#[path = "training_asked_tests.rs"]
mod asked;
#[path = "training_failed_tests.rs"]
mod failed;

/// Both stages in a moment, with screening, and the light to be found out.
fn tiny() -> TrainingSettings {
    let mut tiny = preset::settings(Chosen { preset: Preset::Outdoor, quality: Quality::Smoke, robust: false });
    tiny.screened = true;
    (tiny.field.steps, tiny.field.rays_per_step, tiny.mark.steps) = (10, 128, 4);
    tiny
}

/// These settings, as a program's own.
fn given(settings: TrainingSettings) -> Plan {
    Plan::Given(Box::new(settings))
}

/// A data folder with the scene `town`, trained.
struct Trained {
    dir: TestFolder,
    job: Job,
}

fn open(data: &Path) -> Engine {
    Engine::open(data, &Config::from_toml("", "test").unwrap(), Opening::Serve).unwrap()
}

fn end_of(engine: &Engine, id: &str) -> Job {
    let job = ended(engine, id);
    assert_eq!(job.state, JobState::Done, "{}", job.error);
    job
}

/// The job as it ended, well or not.
fn ended(engine: &Engine, id: &str) -> Job {
    let mut watch = engine.jobs().watch(id).unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
    runtime.block_on(async { watch.wait_for(|job| job.state.has_ended()).await.unwrap().clone() })
}

/// Puts a made-up landmark into the data folder as `name`.
fn import(data: &Path, name: &str, seed: u64) {
    let config = LandmarkConfig { contributors: 2, photographs: 4, width: 32, height: 32, ..LandmarkConfig::default() };
    let folder = data.join(format!("capture-{name}"));
    Landmark::generate(&config, seed).unwrap().write(&folder).unwrap();
    let options = ReadOptions { hold_out: Some(8), ..ReadOptions::default() };
    let capture = Capture::read(&folder, &options).unwrap();
    SceneFolder::create(&data.join("scenes"), name, &capture).unwrap();
}

/// A training of `town` with as many identities.
fn request(anchors: usize) -> TrainingRequest {
    let sizes = cairn_scene::cluster::ClusterConfig {
        anchors,
        neighbours: 2,
        ..cairn_scene::cluster::ClusterConfig::default()
    };
    TrainingRequest {
        scene: "town".into(),
        also: Vec::new(),
        grow: false,
        grouping: Grouping::Anchors(sizes),
        seed: 7,
        plan: given(tiny()),
        signals: Vec::new(),
        base_only: false,
        owner: None,
    }
}

impl Trained {
    fn new() -> Self {
        let dir = TestFolder::new();
        let engine = open(dir.path());
        import(dir.path(), "town", 3);
        let id = engine.train(request(2)).unwrap().id;
        let job = end_of(&engine, &id);
        Self { dir, job }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// The job's folder.
    fn folder(&self) -> PathBuf {
        self.path("jobs").join(&self.job.id)
    }

    /// The job's model's folder.
    fn model(&self) -> PathBuf {
        self.path("models/town").join(&self.job.id)
    }

    /// As the process leaves things when it dies between publishing and the job's
    /// end, and what the next one makes of them.
    fn killed_after_publishing(&self, change: impl Fn(&mut Job)) -> Job {
        let mut running = self.job.clone();
        (running.state, running.ended_unix_s) = (JobState::Running, 0);
        change(&mut running);
        crate::store::folder::write_json(&self.folder().join("job.json"), &running).unwrap();
        end_of(&open(self.dir.path()), &self.job.id)
    }
}

#[test]
fn clusters_without_a_size_take_as_many_views_as_there_are() {
    let dir = TestFolder::new();
    import(dir.path(), "town", 3);
    let scene = SceneFolder::open(&dir.path().join("scenes"), "town").unwrap();
    let sizes = |neighbours| cairn_scene::cluster::ClusterConfig { anchors: 3, neighbours, ..Default::default() };
    let views = scene.training().count();
    let open = clusters(&scene, &Grouping::Anchors(sizes(0)), 7).unwrap();
    assert_eq!(open, clusters(&scene, &Grouping::Anchors(sizes(views / 3)), 7).unwrap(), "of {views} views");
    // Who asks for more than there are hears that.
    let asked = clusters(&scene, &Grouping::Anchors(sizes(views / 3 + 1)), 7).unwrap_err().to_string();
    assert!(asked.contains("lower anchors (M) or neighbours (K)"), "{asked}");
}

#[test]
fn a_published_model_is_not_trained_again() {
    let trained = Trained::new();
    // Publishing puts a new folder in the place of the old one: a file in it tells them apart.
    let witness = trained.model().join("witness");
    std::fs::write(&witness, "").unwrap();
    std::fs::copy(trained.model().join("base.field"), trained.folder().join("base.field")).unwrap();
    std::fs::write(trained.folder().join("base.shares"), "left").unwrap();
    std::fs::write(trained.folder().join("base.places"), "left").unwrap();
    std::fs::write(trained.folder().join("mark.checkpoint"), "left").unwrap();
    let job = trained.killed_after_publishing(|_| ());
    assert!(witness.exists(), "the model was published again");
    assert_eq!(job.stages, trained.job.stages, "something was trained");
    // What was found out about the photographs is said once, and outlives the daemon.
    let [spacing, light, weak] = &job.notes[..] else { panic!("{:?}", job.notes) };
    assert!(spacing.contains("degrees apart") && light.contains("light"), "{:?}", job.notes);
    // So few steps teach nothing, and nobody is left to find that out.
    assert!(weak.contains("answers right:") && weak.contains("--quality"), "{:?}", job.notes);
    for left in ["base.field", "base.shares", "base.places", "mark.checkpoint"] {
        assert!(!trained.folder().join(left).exists(), "{left} was left behind");
    }
    // Another training under the same number is another one.
    let job = trained.killed_after_publishing(|job| job.spec.seed = 8);
    assert!(!witness.exists(), "the old model was taken for the new one's");
    assert_ne!(job.stages, trained.job.stages);
}

#[test]
fn marks_are_fainter_where_photographs_are_explained_better_and_the_job_says_so() {
    let trained = Trained::new();
    let scene = scenes::open(&trained.path("scenes"), "town").unwrap();
    let clusters = clusters(&scene, &trained.job.spec.grouping, 7).unwrap();
    let begin = |budget_db: f64, max_cost_db: f64, checkpoint: Option<&[u8]>| {
        let config = cairn_mark::Recipe { budget_db, max_cost_db, ..trained.job.spec.settings.mark.clone() };
        let config = cairn_mark::Recipe { budget_start_db: budget_db.min(config.budget_start_db), ..config };
        let emblem = |i| Signal::from(cairn_mark::emblem(i, config.side_px(), 7));
        let signals = (0..clusters.clusters.len()).map(emblem).collect();
        let base = Field::from_bytes(&std::fs::read(trained.model().join("base.field")).unwrap()).unwrap();
        let photographs = stages::Photographs::default();
        let scenes = vec![ToMark {
            name: "town",
            scene: &scene,
            photographs: &photographs,
            base,
            clusters: &clusters,
            signals,
            settings: &config,
        }];
        Marking::start(scenes, None, &config, 7, checkpoint, &mut |_, _, _| true).unwrap().unwrap()
    };
    let notes = |budget_db, max_cost_db| begin(budget_db, max_cost_db, None).notes();
    let [note] = &notes(20.0, 0.1)[..] else { panic!("marks of 20 dB cost nothing?") };
    let number = |after: &str| -> f64 {
        let rest = note.split(after).nth(1).unwrap();
        rest.split_whitespace().next().unwrap().parse().unwrap()
    };
    // A tenth of a dB is a mark 16.3 dB below what the field leaves.
    let (kept, explained) = (number("marks are kept "), number("explains photographs to "));
    assert!((10.0..40.0).contains(&explained) && (kept - explained - 16.3).abs() < 0.11, "{note}");
    assert_eq!(notes(60.0, 0.1), Vec::<String>::new());
    assert_eq!(notes(20.0, 0.0), Vec::<String>::new());
    // What goes on keeps the budget that it was begun with, and says that one.
    let resumed =
        |begun_with: f64| begin(20.0, 0.1, Some(&begin(20.0, begun_with, None).checkpoint().unwrap())).notes();
    let [again] = &resumed(0.1)[..] else { panic!("it was told before") };
    assert!(again.contains(&format!("marks are kept {kept:.1} dB")), "{again}");
    assert_eq!(resumed(0.0), Vec::<String>::new(), "an earlier release's job");
}

#[test]
fn a_job_that_grows_says_which_head_had_to_start_afresh() {
    let dir = TestFolder::new();
    let engine = open(dir.path());
    import(dir.path(), "town", 3);
    let hidden = |text: &&str| Given {
        parts: Parts { text: Some(text.as_bytes().to_vec()), ..Parts::default() },
        ..Given::default()
    };
    let hiding = |texts: &[&str]| texts.iter().map(hidden).collect::<Vec<_>>();
    let first = TrainingRequest { signals: hiding(&["Ada", "Bo"]), ..request(2) };
    let first = end_of(&engine, &engine.train(first).unwrap().id);
    let later = TrainingRequest { grow: true, signals: hiding(&["Cleo, who came later"]), ..request(3) };
    let later = end_of(&engine, &engine.train(later).unwrap().id);
    let of_heads = |job: &Job| job.notes.iter().filter(|note| note.contains("the head for hidden texts")).count();
    assert_eq!((of_heads(&first), of_heads(&later)), (0, 1), "{:?}", later.notes);
    assert!(later.notes.iter().any(|note| note.contains("20 bytes where it was 3")), "{:?}", later.notes);
}

#[test]
fn a_stop_is_heard_before_the_next_photograph_and_view() {
    let trained = Trained::new();
    let scene = scenes::open(&trained.path("scenes"), "town").unwrap();
    let (settings, seed) = (&trained.job.spec.settings, trained.job.spec.seed);
    let mut heard = Vec::new();
    let made = stages::base_trainer(&scene, &Default::default(), settings, seed, None, &mut |stage, done, total| {
        heard.push((stage, done, total));
        done < 2
    });
    assert!(made.unwrap().is_none());
    let total = scene.capture().training().count();
    assert_eq!(heard, [0, 1, 2].map(|done| (stages::PHOTOGRAPHS, done, total)));
    // What is left out is not even decoded: for neither stage, and for no mark's negatives.
    let out = scene.capture().training().take(2).collect();
    let fewer = scenes::open(&trained.path("scenes"), "town").unwrap().leaving_out(out);
    heard.clear();
    stages::Photographs::default()
        .views(&fewer, &mut |stage, done, total| {
            heard.push((stage, done, total));
            true
        })
        .unwrap();
    assert_eq!(heard.last(), Some(&(stages::PHOTOGRAPHS, total - 3, total - 2)));

    let clusters = clusters(&scene, &trained.job.spec.grouping, seed).unwrap();
    let emblem = |i| Signal::from(cairn_mark::emblem(i, settings.mark.side_px(), seed));
    let signals = (0..clusters.clusters.len()).map(emblem).collect();
    let base = Field::from_bytes(&std::fs::read(trained.model().join("base.field")).unwrap()).unwrap();
    heard.clear();
    let photographs = stages::Photographs::default();
    let scenes = vec![ToMark {
        name: "town",
        scene: &scene,
        photographs: &photographs,
        base,
        clusters: &clusters,
        signals,
        settings: &settings.mark,
    }];
    let made = Marking::start(scenes, None, &settings.mark, seed, None, &mut |stage, done, total| {
        heard.push((stage, done, total));
        stage != stages::RAY_WEIGHTS || done < 3
    });
    assert!(made.unwrap().is_none());
    let (stage, done, total) = *heard.last().unwrap();
    assert_eq!((stage, done), (stages::RAY_WEIGHTS, 3));
    assert!(total > 8, "{total} views to prepare for two clusters of two");
}

#[test]
fn a_stop_after_the_last_step_is_heard_and_the_checkpoint_finishes_another_time() {
    let trained = Trained::new();
    let scene = scenes::open(&trained.path("scenes"), "town").unwrap();
    let (settings, seed) = (&trained.job.spec.settings, trained.job.spec.seed);
    let clusters = clusters(&scene, &trained.job.spec.grouping, seed).unwrap();
    let begin = |checkpoint: Option<&[u8]>| {
        let base = Field::from_bytes(&std::fs::read(trained.model().join("base.field")).unwrap()).unwrap();
        let emblem = |i| Signal::from(cairn_mark::emblem(i, settings.mark.side_px(), seed));
        let signals = (0..clusters.clusters.len()).map(emblem).collect();
        let photographs = stages::Photographs::default();
        let scenes = vec![ToMark {
            name: "town",
            scene: &scene,
            photographs: &photographs,
            base,
            clusters: &clusters,
            signals,
            settings: &settings.mark,
        }];
        Marking::start(scenes, None, &settings.mark, seed, checkpoint, &mut |_, _, _| true).unwrap().unwrap()
    };
    let trained = || {
        let mut marking = begin(None);
        while marking.steps().0 < marking.steps().1 {
            marking.step().unwrap();
        }
        marking
    };
    let marking = trained();
    let checkpoint = marking.checkpoint().unwrap();
    let mut heard = Vec::new();
    let stopped = marking.finish(&mut |stage, done, total| {
        heard.push((stage, done, total));
        done < 3
    });
    assert!(stopped.unwrap().is_none());
    let total = heard[0].2;
    assert_eq!(heard, [0, 1, 2, 3].map(|done| (stages::MARKED_RENDERS, done, total)));
    heard.clear();
    let finished = begin(Some(&checkpoint)).finish(&mut |stage, done, total| {
        heard.push((stage, done, total));
        true
    });
    assert!(finished.unwrap() == trained().finish(&mut |_, _, _| true).unwrap(), "it finished elsewhere");
    assert!(heard.iter().all(|(_, done, of)| done <= of && *of == total) && heard.len() > total / 2, "{total}");
}

#[test]
fn a_job_stopped_in_preparation_keeps_its_base_field_and_its_seconds() {
    let trained = Trained::new();
    for (there, stopped_in) in [
        (&["base.field"][..], stages::SHARE_TABLE),
        (&["base.field", "base.shares"], stages::PLACES),
        (&["base.field", "base.shares", "base.places"], stages::MARK),
    ] {
        let mut job = trained.job.clone();
        (job.id, job.spec.seed) = (format!("job-00000{}", 7 + there.len()), 9);
        job.stages.clear();
        let folder = trained.path("jobs").join(&job.id);
        std::fs::create_dir(&folder).unwrap();
        for file in there {
            std::fs::copy(trained.model().join(file), folder.join(file)).unwrap();
        }
        let (stop, sender) = (Arc::new(AtomicU8::new(0)), watch::Sender::new(job.clone()));
        let control = Control::stopping(&stop, &sender, folder.join("job.json"));
        let mut training = Training {
            scenes: trained.path("scenes"),
            models: trained.path("models"),
            jobs: trained.path("jobs"),
            exclusions: Arc::new(Exclusions::open(trained.path("exclusions"), &trained.path("scenes")).unwrap()),
            checkpoint_every: Duration::from_secs(30),
        };
        assert_eq!(training.run(&job, &control).unwrap(), Outcome::Stopped);
        let version = crate::train::job::VERSION;
        let written: Job = crate::store::folder::read_json(&folder.join("job.json"), version).unwrap();
        assert_eq!(written.stages.iter().map(|s| s.stage.as_str()).collect::<Vec<_>>(), [stopped_in]);
        assert_eq!(sender.borrow().progress.stage, stages::PHOTOGRAPHS);
        assert!(there.iter().all(|file| folder.join(file).exists()) && !folder.join("mark.checkpoint").exists());
    }
}

/// The labels of a model's identities.
fn labels(info: &ModelInfo) -> Vec<&str> {
    info.identities.iter().map(|i| i.label.as_str()).collect()
}

#[test]
fn scenes_that_are_marked_together_share_a_detector_and_say_whose_mark_it_is() {
    let dir = TestFolder::new();
    let engine = open(dir.path());
    for (name, seed) in [("town", 3), ("mill", 4)] {
        import(dir.path(), name, seed);
    }
    let wanted = TrainingRequest { also: vec!["mill".into()], ..request(2) };
    let job = end_of(&engine, &engine.train(wanted.clone()).unwrap().id);
    assert!(job.spec.is_of("mill") && job.spec.is_of("town") && !job.spec.is_of("well"));
    let [town, mill] = ["town", "mill"].map(|name| engine.newest_model(name).unwrap().unwrap());
    let (a, b) = (town.mark.as_ref().unwrap(), mill.mark.as_ref().unwrap());
    assert_eq!((a.detector, &a.shared), (b.detector, &b.shared));
    assert_ne!(a.marked_field, b.marked_field);
    let (of_town, of_mill) = (town.classes().unwrap(), mill.classes().unwrap());
    assert_eq!((of_town.of(1), of_mill.of(1), of_mill.count()), (1, 3, 5));
    assert_eq!(a.shared[1].labels, labels(&mill));
    // Both are there and can be asked.
    for name in ["town", "mill"] {
        let model = engine.model(name).unwrap();
        let mark = model.mark().unwrap();
        let grey = mark.detect(&cairn_scene::Picture::constant(40, 40, [0.5; 3])).unwrap();
        assert_eq!(grey.detection.probabilities.len(), 3);
    }
    // Everything of the second scene is cleared from the job's folder as well.
    let part = dir.path().join("jobs").join(&job.id).join("scene-2");
    assert!(part.join("views.json").exists() && !part.join("base.field").exists());

    for (also, expected) in [(vec!["town".to_owned()], "each scene once"), (vec!["well".to_owned()], "well")] {
        let error = engine.train(TrainingRequest { also, ..wanted.clone() }).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    let error = engine.train(TrainingRequest { base_only: true, ..wanted.clone() }).unwrap_err().to_string();
    assert!(error.contains("base field only"), "{error}");

    // Each is marked as strongly as its photographs ask for, and goes on so where identities come later.
    let mut faint = tiny();
    (faint.mark.budget_db, faint.mark.budget_start_db) = (20.0, 20.0);
    let job = end_of(&engine, &engine.train(TrainingRequest { plan: given(faint), ..wanted.clone() }).unwrap().id);
    for name in ["town", "mill"] {
        let about = format!("marks of scene {name:?} are kept");
        assert_eq!(job.notes.iter().filter(|note| note.starts_with(&about)).count(), 1, "{:?}", job.notes);
    }
    let more = TrainingRequest { grow: true, plan: Plan::default(), also: wanted.also, ..request(3) };
    let grown = end_of(&engine, &engine.train(more).unwrap().id);
    assert_eq!(grown.spec.marks, job.spec.marks);
    assert_eq!(labels(&engine.newest_model("mill").unwrap().unwrap()).len(), 3);
}

#[test]
fn a_scene_that_grows_keeps_its_field_and_its_marks() {
    let trained = Trained::new();
    let engine = open(trained.dir.path());
    let before = engine.newest_model("town").unwrap().unwrap();
    let more = TrainingRequest { grow: true, plan: Plan::default(), ..request(3) };
    let job = end_of(&engine, &engine.train(more.clone()).unwrap().id);
    let after = engine.newest_model("town").unwrap().unwrap();
    assert_eq!((&after.job, after.base_field), (&job.id, before.base_field), "the field was trained again");
    assert_eq!((after.share_table, after.places), (before.share_table, before.places), "made again");
    assert!(job.stages.iter().all(|s| s.stage == stages::MARK), "{:?}", job.stages);
    assert_eq!(after.identities.len(), 3);
    let models = trained.path("models");
    let [old, new] = [before, after].map(|info| model::Model::load(&models, info).unwrap());
    assert_eq!(old.places().unwrap(), new.places().unwrap());
    let (old_mark, new_mark) = (old.mark().unwrap(), new.mark().unwrap());
    for (number, label) in (1..).zip(labels(&old.info)) {
        let now = 1 + labels(&new.info).iter().position(|l| *l == label).expect("a label that was there") as u32;
        assert_eq!(old_mark.field.carrier(number), new_mark.field.carrier(now), "the mark of {label} moved");
        let at = |number: u32| number as usize - 1;
        assert_eq!(old_mark.signals[at(number)], new_mark.signals[at(now)], "{label} hides something else");
    }
    // What is added hides something of its own.
    let signals = &new_mark.signals;
    assert!(signals[0] != signals[1] && signals[1] != signals[2] && signals[0] != signals[2]);

    let says = |request: TrainingRequest, expected: &str| {
        let error = engine.train(request).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    };
    says(more.clone(), "all 3 identities are marked");
    import(trained.dir.path(), "mill", 4);
    says(TrainingRequest { scene: "mill".into(), ..more }, "no marks yet");
}

#[test]
fn a_search_for_a_camera_is_given_up_when_nobody_waits_for_it() {
    let trained = Trained::new();
    let engine = open(trained.dir.path());
    let photograph = engine.scene("town").unwrap().photograph(0).unwrap();
    let bytes = cairn_scene::encode_png(&photograph);
    let locate = |wanted: bool| engine.locate("town", &bytes, false, &|| wanted).unwrap().unwrap_err();
    assert_eq!(locate(false), cairn_register::NotLocated::GivenUp);
    // So short a training knows no place again.
    assert!(matches!(locate(true), cairn_register::NotLocated::NoAgreement { .. }), "{}", locate(true));
}

#[test]
fn clusters_stay_as_large_where_a_scene_grows() {
    let dir = TestFolder::new();
    let engine = open(dir.path());
    import(dir.path(), "town", 3);
    let of = |anchors, neighbours| {
        let sizes = cairn_scene::cluster::ClusterConfig { anchors, neighbours, ..Default::default() };
        TrainingRequest { grouping: Grouping::Anchors(sizes), ..request(anchors) }
    };
    end_of(&engine, &engine.train(of(2, 1)).unwrap().id);
    // There would be two views for each of three.
    let more = TrainingRequest { grow: true, plan: Plan::default(), ..of(3, 0) };
    end_of(&engine, &engine.train(more).unwrap().id);
    let grown = engine.newest_model("town").unwrap().unwrap();
    assert_eq!(grown.clusters.grouping(), &of(3, 1).grouping);
}
