//! A made-up landmark with photographs that are none: found, left out, credited to nobody,
//! released, removed, and removals that were cut off.

use cairn_landmark::{Landmark, LandmarkConfig};
use cairn_scene::cluster::Grouping;
use cairn_scene::{Capture, Picture, ReadOptions};

use super::*;
use crate::config::{Chosen, Config, Preset, Quality, TrainingSettings, preset};
use crate::engine::Engine;
use crate::query::viewpoint::Viewpoint;
use crate::records::owners::AskedView;
use crate::records::published::tests::TestFolder;
use crate::train::job::{Job, JobState};
use crate::train::request::{Plan, TrainingRequest};

/// Enough rays for scouts to tell, and a field of a moment.
fn quick(screened: bool) -> TrainingSettings {
    let mut quick = preset::settings(Chosen { preset: Preset::Outdoor, quality: Quality::Balanced, robust: false });
    let field = &mut quick.field;
    (field.steps, field.rays_per_step, field.voxels, field.levels) = (60, 4096, 30_000, 2);
    quick.screened = screened;
    quick
}

/// What is noise.
const BAD: [&str; 2] = ["images/ada_005.png", "images/ada_008.png"];

struct World {
    dir: TestFolder,
    engine: Engine,
}

fn noise(width: usize, height: usize, mut state: u64) -> Picture {
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1u64 << 24) as f32
    };
    Picture::new(width, height, (0..3 * width * height).map(|_| next()).collect()).unwrap()
}

fn open(data: &Path) -> Engine {
    Engine::open(data, &Config::from_toml("", "test").unwrap()).unwrap()
}

impl World {
    /// The scene `town`, with `bad` photographs of noise.
    fn new(bad: &[&str]) -> Self {
        let dir = TestFolder::new();
        let config = LandmarkConfig {
            photographs: 10,
            width: 40,
            height: 48,
            passers_by: false,
            light_variation: 0.0,
            ..LandmarkConfig::default()
        };
        let mut capture = Landmark::generate(&config, 3).unwrap();
        for (n, view) in capture.views.iter_mut().enumerate().filter(|(_, v)| bad.contains(&v.name.as_str())) {
            view.picture = noise(40, 48, n as u64);
        }
        let source = dir.path().join("capture");
        capture.write(&source).unwrap();
        let contributors = Some(source.join("contributors.csv"));
        let capture = Capture::read(&source, &ReadOptions { contributors, ..ReadOptions::default() }).unwrap();
        let engine = open(dir.path());
        SceneFolder::create(&dir.path().join("scenes"), "town", &capture).unwrap();
        Self { dir, engine }
    }

    fn train(&self, screened: bool) -> (Job, ModelInfo) {
        let request = TrainingRequest {
            scene: "town".into(),
            grouping: Grouping::ByContributor { min_views: 2, direction_weight: 1.0 },
            also: Vec::new(),
            grow: false,
            seed: 7,
            plan: Plan::Given(Box::new(quick(screened))),
            signals: Vec::new(),
            base_only: true,
            owner: None,
        };
        let id = self.engine.train(request).unwrap().id;
        let mut watch = self.engine.jobs().watch(&id).unwrap();
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        let job = runtime.block_on(async { watch.wait_for(|job| job.state.has_ended()).await.unwrap().clone() });
        assert_eq!(job.state, JobState::Done, "{}", job.error);
        (job, self.engine.newest_model("town").unwrap().unwrap())
    }

    fn standings(&self) -> Vec<(String, Standing)> {
        self.engine.quarantined("town").unwrap().into_iter().map(|e| (e.view, e.standing)).collect()
    }

    fn who(&self, view: &str) -> crate::query::look::Who {
        self.engine.contributors("town", &Viewpoint::View(view.into())).unwrap()
    }

    fn photographs(&self) -> usize {
        std::fs::read_dir(self.dir.path().join("scenes/town/photographs")).unwrap().count()
    }

    /// Whether every file of the scene is as its manifest says.
    fn is_sound(&self) -> bool {
        let (findings, _) = cairn_verify::audit_folders(self.dir.path()).unwrap();
        let of_scene = |f: &&cairn_verify::Finding| f.place.starts_with("scenes/town");
        findings.iter().filter(of_scene).all(|f| f.code == cairn_verify::Code::FolderVerified)
    }
}

fn names(info: &ModelInfo, label: &str) -> Vec<String> {
    info.identities.iter().find(|i| i.label == label).unwrap().views.clone()
}

fn both(standing: Standing) -> Vec<(String, Standing)> {
    BAD.map(|view| (view.to_owned(), standing)).to_vec()
}

#[test]
fn what_is_found_is_left_out_until_it_is_released_or_removed() {
    let world = World::new(&BAD);
    let (job, first) = world.train(true);
    assert_eq!(world.standings(), both(Standing::Quarantined));
    let entry = &world.engine.quarantined("town").unwrap()[0];
    let found = entry.found.as_ref().unwrap();
    assert!(entry.contributor == "ada" && found.job == job.id && found.fit_db < found.limit_db, "{entry:?}");
    let note = job.notes.iter().find(|n| n.contains("in quarantine")).unwrap();
    assert!(BAD.iter().all(|view| note.contains(view)) && note.contains("by ada"), "{note}");
    assert!(!names(&first, "ada").iter().any(|view| BAD.contains(&view.as_str())), "left out of clusters");
    let field = world.engine.model("town").unwrap();
    assert!(!field.base.appearances().iter().any(|(view, _)| BAD.contains(&view.as_str())), "and of the field");

    // The same again: they are not judged anew.
    let (again, second) = world.train(true);
    assert_eq!(second.base_field, first.base_field);
    assert!(again.notes.iter().any(|n| n.contains("2 views that were in quarantine")), "{:?}", again.notes);
    assert_eq!(world.engine.quarantined("town").unwrap()[0].found.as_ref().unwrap().job, job.id);

    // Released: trained on, whatever the figures say.
    let by = Some(Digest::of("cara"));
    world.engine.release_views("town", &BAD.map(str::to_owned), by).unwrap();
    assert_eq!(world.standings(), both(Standing::Released));
    let (_, released) = world.train(true);
    assert_eq!(world.standings(), both(Standing::Released), "figures do not bring them back");
    assert!(BAD.iter().all(|view| names(&released, "ada").contains(&(*view).to_owned())));
    assert_ne!(released.base_field, first.base_field);

    // Removed: the field is that of a scene which never had them, to the byte.
    let before = world.photographs();
    world.engine.remove_views("town", &BAD.map(str::to_owned), by).unwrap();
    assert_eq!(world.standings(), both(Standing::Removed));
    assert_eq!(world.engine.quarantined("town").unwrap()[0].decided.as_ref().unwrap().by, by);
    assert_eq!(world.photographs(), before - 2);
    assert!(world.is_sound(), "the scene's manifest is true again");
    let (_, removed) = world.train(true);
    assert_eq!(removed.base_field, first.base_field);
    world.engine.delete_scene("town").unwrap();
    assert!(world.engine.quarantine.of("town").unwrap().0.is_empty(), "gone with its scene");
}

#[test]
fn an_honest_capture_loses_nobody() {
    let world = World::new(&[]);
    let (job, _) = world.train(true);
    assert_eq!(world.standings(), []);
    assert!(!job.notes.iter().any(|n| n.contains("quarantine")), "{:?}", job.notes);
}

#[test]
fn nobody_is_credited_with_what_was_found_or_removed_since_a_model() {
    let world = World::new(&BAD);
    let (_, info) = world.train(false);
    assert_eq!(world.standings(), [], "not screened");
    let whole = world.who("images/ada_004.png");
    let (number, count) = (whole.identity.clone().unwrap().0, names(&info, "ada").len());
    assert_eq!(whole.contributors, [("ada".to_owned(), count)]);
    assert!(world.who(BAD[0]).identity.is_some());
    world.engine.material("town", number).unwrap();

    let entry = |view: &str| {
        let scene = world.engine.scene("town").unwrap();
        let index = crate::store::scenes::view_index(scene.capture(), view).unwrap();
        let found = Found { job: "x".into(), fit_db: 0.0, deviations: 0.0, median_db: 3.0, limit_db: 0.1, unix_s: 1 };
        Entry {
            view: view.into(),
            contributor: "ada".into(),
            photograph: Digest::from_bytes(scene.photograph_digest(index)),
            standing: Standing::Quarantined,
            found: Some(found),
            decided: None,
        }
    };
    world.engine.quarantine.put("town", vec![entry(BAD[0])]).unwrap();
    assert_eq!(world.who(BAD[0]).identity, None, "nobody is credited with it");
    assert_eq!(world.who("images/ada_004.png").contributors, [("ada".to_owned(), count - 1)]);
    let refused = world.engine.material("town", number).map(drop).unwrap_err().to_string();
    assert!(refused.contains(BAD[0]) && refused.contains("train the scene again"), "{refused}");
    let named = Some(AskedView::Named(BAD[0].into()));
    let refused = world.engine.complete_answer("town", named, None, 1 << 20).unwrap_err().to_string();
    assert!(refused.contains("in quarantine") && refused.contains("SHA-256"), "{refused}");

    // A contributor all of whose views are out is named no more.
    let all = names(&info, "ada").iter().map(|view| entry(view)).collect();
    world.engine.quarantine.put("town", all).unwrap();
    let camera = world.engine.camera("town", &Viewpoint::View("images/ada_004.png".into())).unwrap();
    let who = world.engine.contributors("town", &Viewpoint::Camera(camera)).unwrap();
    assert!(who.identity.is_none_or(|(_, label)| label != "ada"), "{:?}", who.contributors);
}

#[test]
fn a_removal_that_was_cut_off_is_finished_at_the_next_start() {
    let world = World::new(&BAD);
    let before = world.photographs();
    let file = world.dir.path().join("quarantine/town.json");
    world.engine.remove_views("town", &[BAD[0].to_owned()], None).unwrap();
    let World { dir, engine } = world;
    drop(engine);
    // As it is when the process dies before anything was done, and after the table was replaced.
    let mut text = std::fs::read_to_string(&file).unwrap().replace("\"removed\"", "\"removing\"");
    std::fs::write(&file, &text).unwrap();
    std::fs::write(dir.path().join("scenes/town/photographs/000004.png"), "left").unwrap();
    std::fs::remove_file(dir.path().join("scenes/town/manifest.json")).unwrap();
    let world = World { engine: open(dir.path()), dir };
    assert_eq!(world.standings(), [(BAD[0].to_owned(), Standing::Removed)]);
    assert!(world.is_sound() && world.photographs() == before - 1);
    // Another version is refused by its number.
    let World { dir, engine } = world;
    drop(engine);
    text = text.replace("\"format_version\": 1", "\"format_version\": 9");
    std::fs::write(&file, text).unwrap();
    let error = Engine::open(dir.path(), &Config::from_toml("", "test").unwrap()).map(drop).unwrap_err().to_string();
    assert!(error.contains("format version 9"), "{error}");
}

#[test]
fn what_a_removed_view_took_is_given_back_to_its_scenes_owner() {
    let World { dir, engine } = World::new(&[]);
    let takes = |engine: &Engine| scenes::takes(&engine.scene("town").unwrap()).unwrap();
    let whole = takes(&engine);
    drop(engine);
    let (ada, file) = (Digest::of("ada"), dir.path().join("owners/town.json"));
    let owned =
        format!(r#"{{"format_version": 1, "owner": "{ada}", "bytes": {}, "views": {}}}"#, whole.bytes, whole.views);
    std::fs::write(&file, &owned).unwrap();
    let used = |engine: &Engine| (engine.access().usage(&ada).bytes, engine.access().usage(&ada).views);
    let engine = open(dir.path());
    assert_eq!(used(&engine), (whole.bytes, whole.views));
    let photograph = dir.path().join("scenes/town").join(&engine.scene("town").unwrap().capture().views[4].photograph);
    let view = engine.scene("town").unwrap().capture().views[4].name.clone();
    let bytes = photograph.metadata().unwrap().len();
    engine.remove_views("town", &[view], None).unwrap();
    let left = (whole.bytes - bytes, whole.views - 1);
    assert!(!photograph.exists() && used(&engine) == left, "{:?}, {left:?} expected", used(&engine));
    drop(engine);
    let engine = open(dir.path());
    assert_eq!(used(&engine), left, "written down");
    drop(engine);
    // As it is where the process died before it was.
    std::fs::write(&file, &owned).unwrap();
    assert_eq!(used(&open(dir.path())), left);
}

#[test]
fn bad_requests_are_refused_by_name_and_change_nothing() {
    let world = World::new(&[]);
    let engine = &world.engine;
    let views = |names: &[&str]| names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
    let error = engine.release_views("town", &views(&["images/ada_004.png"]), None).unwrap_err().to_string();
    assert!(error.contains("no view in quarantine \"images/ada_004.png\"") && error.contains("none"), "{error}");
    let error = engine.remove_views("town", &views(&["images/ada_004.png", "x"]), None).unwrap_err().to_string();
    assert!(error.contains("no view \"x\""), "{error}");
    assert!(engine.quarantined("nowhere").unwrap_err().to_string().contains("no scene \"nowhere\""));
    let scene = engine.scene("town").unwrap();
    let all: Vec<String> = scene.capture().views.iter().map(|v| v.name.clone()).collect();
    let error = engine.remove_views("town", &all, None).unwrap_err().to_string();
    assert!(error.contains("delete the scene instead"), "{error}");
    assert_eq!(engine.scene("town").unwrap().capture().views.len(), all.len());
    assert_eq!(world.standings(), []);
}
