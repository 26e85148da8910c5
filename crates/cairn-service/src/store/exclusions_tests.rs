//! A made-up landmark with photographs that are none: scored, excluded where structure from motion does not support
//! them either, included again, credited to nobody meanwhile.

use cairn_landmark::{Landmark, LandmarkConfig};
use cairn_scene::cluster::Grouping;
use cairn_scene::{Capture, Picture, ReadOptions, Support};

use super::*;
use crate::config::{Chosen, Config, Preset, Quality, TrainingSettings, preset};
use crate::engine::{Engine, Opening};
use crate::query::check::{CheckedView, Looks, Whereabouts};
use crate::query::coverage::Asked;
use crate::query::viewpoint::Viewpoint;
use crate::records::owners::{About, AskedView};
use crate::store::test_folder::TestFolder;
use crate::train::job::{Job, JobState};
use crate::train::request::{Plan, TrainingRequest};

/// Enough rays for scouts to tell, and a field of a moment.
fn quick() -> TrainingSettings {
    let mut quick = preset::settings(Chosen { preset: Preset::Outdoor, quality: Quality::Balanced, robust: false });
    let field = &mut quick.field;
    (field.steps, field.rays_per_step, field.voxels, field.levels) = (60, 4096, 30_000, 2);
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
    Engine::open(data, &Config::from_toml("", "test").unwrap(), Opening::Serve).unwrap()
}

impl World {
    /// The scene `town`, with `bad` photographs of noise; structure from motion says `support` of those, and much of
    /// the others, where it says something.
    fn new(bad: &[&str], support: Option<Support>) -> Self {
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
        let options = ReadOptions { contributors, hold_out: Some(8), ..ReadOptions::default() };
        let mut capture = Capture::read(&source, &options).unwrap();
        for (n, view) in capture.views.iter_mut().enumerate() {
            let well = Support { points: 400, reprojection_error_px: 0.5 + 0.01 * n as f64 };
            view.support = support.map(|poor| if bad.contains(&view.name.as_str()) { poor } else { well });
        }
        let engine = open(dir.path());
        SceneFolder::create(&dir.path().join("scenes"), "town", &capture).unwrap();
        Self { dir, engine }
    }

    fn train(&self) -> (Job, ModelInfo) {
        let request = TrainingRequest {
            scene: "town".into(),
            grouping: Grouping::ByContributor { min_views: 2, direction_weight: 1.0 },
            also: Vec::new(),
            grow: false,
            seed: 7,
            plan: Plan::Given(Box::new(quick())),
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

    fn excluded(&self) -> Vec<String> {
        self.engine.exclusions.of("town").unwrap().excluded().into_iter().collect()
    }

    fn decide(&self, state: State, views: &[&str]) -> Result<usize, EngineError> {
        let views: Vec<String> = views.iter().map(|v| (*v).to_owned()).collect();
        let decision = Decision { state, why: "for the test".into(), by: Some(Digest::of("cara")) };
        self.engine.decide("town", &views, &decision)
    }

    fn who(&self, view: &str) -> crate::query::look::Who {
        self.engine.contributors("town", &Asked::about(Viewpoint::View(view.into()))).unwrap().0
    }
}

fn names(info: &ModelInfo, label: &str) -> Vec<String> {
    info.identities.iter().find(|i| i.label == label).unwrap().views.clone()
}

#[test]
fn what_is_doubly_doubted_is_excluded_until_a_person_includes_it() {
    let world = World::new(&BAD, Some(Support { points: 5, reprojection_error_px: 0.5 }));
    let (job, first) = world.train();
    assert_eq!(world.excluded(), BAD);
    let entries = world.engine.exclusions.of("town").unwrap();
    assert!(entries.views.iter().all(|e| e.automatic && e.contributor == "ada" && e.why.contains("5 reconstructed")));
    let note = job.notes.iter().find(|n| n.contains("excluded")).unwrap();
    assert!(note.contains(BAD[0]) && note.contains("by ada"), "{note}");
    assert!(!names(&first, "ada").iter().any(|view| BAD.contains(&view.as_str())), "left out of clusters");
    let field = world.engine.model("town").unwrap();
    assert!(!field.base.appearances().iter().any(|(view, _)| BAD.contains(&view.as_str())), "and of the field");

    // The same again: they are not judged anew.
    let (_, second) = world.train();
    assert_eq!(second.base_field, first.base_field);

    // Included: trained on, whatever the figures say.
    assert_eq!(world.decide(State::Included, &BAD).unwrap(), 0);
    let (_, included) = world.train();
    assert_eq!(world.excluded(), [""; 0], "figures do not bring them back");
    assert!(BAD.iter().all(|view| names(&included, "ada").contains(&(*view).to_owned())));
    assert_ne!(included.base_field, first.base_field);
    world.engine.delete_scene("town").unwrap();
    assert_eq!(world.engine.exclusions.of("town").unwrap(), Entries::default(), "gone with its scene");
}

#[test]
fn a_residual_alone_excludes_nobody_and_a_person_does() {
    // Nothing from structure from motion: scored, and never excluded by a training.
    let world = World::new(&BAD, None);
    let (job, whole) = world.train();
    assert_eq!(world.excluded(), [""; 0]);
    let measured = world.engine.exclusions.of("town").unwrap().measured.unwrap();
    let outliers = measured.scores.iter().filter(|s| s.is_outlier).map(|s| s.view.as_str());
    assert_eq!(outliers.collect::<Vec<_>>(), BAD);
    assert_eq!(measured.job, job.id);
    let checked = world.engine.check("town", false, Looks { picture: true, places: true }, &|| true).unwrap();
    let scene = world.engine.scene("town").unwrap();
    let worst = checked.views[..2].iter().map(|v| scene.capture().views[v.index].name.as_str());
    assert!(worst.eq(BAD) || checked.views[..2].iter().rev().map(|v| &scene.capture().views[v.index].name).eq(BAD));
    assert!(checked.picture.is_some());
    let found = |view: &CheckedView| matches!(view.found, Some(Whereabouts::Found { .. }));
    assert!(!checked.views[..2].iter().any(found) && checked.views[..8].iter().all(|v| v.found.is_some()));
    let held_out = |v: &&CheckedView| scene.capture().views[v.index].held_out;
    assert!(checked.views.iter().filter(held_out).all(|v| v.found.is_none()), "what was not judged is not looked for");
    assert!(job.notes.iter().any(|n| n.contains("scene check town")), "{:?}", job.notes);
    assert!(names(&whole, "ada").contains(&BAD[0].to_owned()));

    assert_eq!(world.decide(State::Excluded, &BAD).unwrap(), 2);
    let (_, without) = world.train();
    assert!(!names(&without, "ada").contains(&BAD[0].to_owned()));
    assert_ne!(without.base_field, whole.base_field);
    let World { dir, engine } = world;
    drop(engine);
    let world = World { engine: open(dir.path()), dir };
    assert_eq!(world.excluded(), BAD, "durable");
    // Another version is refused by its number.
    let file = world.dir.path().join("exclusions/town.json");
    let text = std::fs::read_to_string(&file).unwrap().replace("\"format_version\": 1", "\"format_version\": 9");
    let World { dir, engine } = world;
    drop(engine);
    std::fs::write(&file, text).unwrap();
    let error = Engine::open(dir.path(), &Config::from_toml("", "test").unwrap(), Opening::Serve)
        .map(drop)
        .unwrap_err()
        .to_string();
    assert!(error.contains("format version 9"), "{error}");
}

#[test]
fn nobody_is_credited_with_what_was_excluded_since_a_model() {
    let world = World::new(&[], None);
    let (job, info) = world.train();
    assert!(!job.notes.iter().any(|n| n.contains("scene check")), "an honest capture: {:?}", job.notes);
    let whole = world.who("images/ada_004.png");
    let (number, count) = (whole.identity.clone().unwrap().0, names(&info, "ada").len());
    assert_eq!(whole.contributors, [("ada".to_owned(), count)]);
    assert!(world.who(BAD[0]).identity.is_some());
    world.engine.material("town", &About::Identity(number)).unwrap();

    world.decide(State::Excluded, &BAD[..1]).unwrap();
    assert_eq!(world.who(BAD[0]).identity, None, "nobody is credited with it");
    let short = BAD[0].trim_start_matches("images/");
    assert_eq!(world.who(short).identity, None, "nor by a name without its folder");
    assert_eq!(world.who("images/ada_004.png").contributors, [("ada".to_owned(), count - 1)]);
    let refused = world.engine.material("town", &About::Identity(number)).map(drop).unwrap_err().to_string();
    assert!(refused.contains(BAD[0]) && refused.contains("train the scene again"), "{refused}");
    for name in [BAD[0], short] {
        let named = Some(AskedView::Named(name.into()));
        let refused = world.engine.complete_answer("town", named, None, 1 << 20).unwrap_err().to_string();
        assert!(refused.contains("excluded") && refused.contains("SHA-256"), "{refused}");
    }
    let asked = Asked::about(Viewpoint::View(short.into()));
    let shares = world.engine.contributors("town", &asked).unwrap().1;
    assert!(shares.photographed_by.is_none() && shares.excluded > 0.0, "{:?}", shares.shares);

    // A contributor all of whose views are out is named no more.
    let all = names(&info, "ada");
    world.decide(State::Excluded, &all.iter().map(String::as_str).collect::<Vec<_>>()).unwrap();
    let scene = world.engine.scene("town").unwrap();
    let view = scenes::view_index(scene.capture(), "images/ada_004.png").unwrap();
    let camera = scene.capture().views[view].camera;
    let (mark, who) = world.engine.contributors("town", &Asked::about(Viewpoint::Camera(camera))).unwrap();
    assert!(mark.identity.is_none_or(|(_, label)| label != "ada"), "{:?}", mark.contributors);
    assert!(who.shares.iter().all(|share| share.name != "ada") && who.excluded > 0.1, "{:?}", who.shares);
}

#[test]
fn bad_requests_are_refused_by_name_and_change_nothing() {
    let world = World::new(&[], None);
    let error = world.decide(State::Excluded, &["images/ada_004.png", "x"]).unwrap_err().to_string();
    assert!(error.contains("no view \"x\""), "{error}");
    let nowhere = world.engine.snapshot("nowhere").err().unwrap().to_string();
    assert!(nowhere.contains("no scene \"nowhere\""), "{nowhere}");
    let scene = world.engine.scene("town").unwrap();
    let all: Vec<&str> = scene.capture().views.iter().map(|v| v.name.as_str()).collect();
    let error = world.decide(State::Excluded, &all).unwrap_err().to_string();
    assert!(error.contains("delete the scene instead"), "{error}");
    assert_eq!(world.excluded(), [""; 0]);
}
