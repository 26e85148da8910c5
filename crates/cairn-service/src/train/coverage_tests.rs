//! Who gets nothing of a share table, and what is said of views that taught nothing.

use cairn_landmark::{Landmark, LandmarkConfig};
use cairn_scene::cluster::Grouping;
use cairn_scene::{Picture, ReadOptions, SceneFolder, save_png};

use super::*;
use crate::config::{Chosen, Config, Preset, Quality, preset};
use crate::engine::{Engine, Opening};
use crate::query::coverage::Asked;
use crate::query::viewpoint::Viewpoint;
use crate::store::exclusions::{Decision, State};
use crate::store::test_folder::TestFolder;
use crate::train::job::{Job, JobState};
use crate::train::request::{Plan, TrainingRequest};

/// The photographs of a made-up landmark, eight of them, none held out.
fn capture(dir: &TestFolder) -> Capture {
    let config = LandmarkConfig { contributors: 2, photographs: 4, width: 32, height: 32, ..LandmarkConfig::default() };
    let folder = dir.path().join("capture");
    Landmark::generate(&config, 3).unwrap().write(&folder).unwrap();
    let contributors = Some(folder.join("contributors.csv"));
    Capture::read(&folder, &ReadOptions { contributors, ..ReadOptions::default() }).unwrap()
}

/// A training of `scene` to its end: a base field of a moment.
fn trained(engine: &Engine, scene: &str) -> Job {
    let mut settings = preset::settings(Chosen { preset: Preset::Outdoor, quality: Quality::Smoke, robust: false });
    settings.screened = false;
    (settings.field.steps, settings.field.rays_per_step) = (10, 128);
    let request = TrainingRequest {
        scene: scene.into(),
        also: Vec::new(),
        grow: false,
        grouping: Grouping::ByContributor { min_views: 2, direction_weight: 1.0 },
        seed: 7,
        plan: Plan::Given(Box::new(settings)),
        signals: Vec::new(),
        base_only: true,
        owner: None,
    };
    let id = engine.train(request).unwrap().id;
    let mut watch = engine.jobs().watch(&id).unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
    let job = runtime.block_on(async { watch.wait_for(|job| job.state.has_ended()).await.unwrap().clone() });
    assert_eq!(job.state, JobState::Done, "{}", job.error);
    job
}

#[test]
fn every_contributor_without_a_share_is_named_with_the_reason() {
    let dir = TestFolder::new();
    let engine = Engine::open(dir.path(), &Config::from_toml("", "test").unwrap(), Opening::Serve).unwrap();
    let mut capture = capture(&dir);
    for (at, contributor) in ["eve", "fay", "gus", "hal", "hal"].into_iter().enumerate() {
        contributor.clone_into(&mut capture.views[at].contributor);
    }
    (capture.views[0].held_out, capture.views[4].held_out) = (true, true);
    let mask = dir.path().join("black.png");
    save_png(&mask, &Picture::constant(32, 32, [0.0; 3])).unwrap();
    capture.views[2].mask = Some(mask);
    let row = |contributor: &str, why| UnusedPhotographs { contributor: contributor.into(), why, photographs: 1 };
    let imported = engine.import_capture("town", &capture).unwrap();
    assert_eq!(imported.without_share, [row("eve", Unused::HeldOut)]);
    let names: Vec<String> = capture.views.iter().map(|view| view.name.clone()).collect();
    let decision = Decision { state: State::Excluded, why: String::new(), by: None };
    engine.decide("town", &[names[1].clone(), names[3].clone()], &decision).unwrap();

    let job = trained(&engine, "town");
    let info = engine.newest_model("town").unwrap().unwrap();
    let wanted = [
        row("eve", Unused::HeldOut),
        row("fay", Unused::Excluded),
        row("gus", Unused::Masked),
        row("hal", Unused::HeldOut),
        row("hal", Unused::Excluded),
    ];
    assert_eq!(info.without_share, wanted);
    let said = "town: no share for eve (1 photograph held out); fay (1 photograph excluded); gus (1 photograph masked or \
                beside the scene); hal (2 photographs: 1 held out, 1 excluded)";
    assert!(job.notes.iter().any(|note| note == said), "{:?}", job.notes);

    // A view that taught nothing says so; who took one that is held out is named all the same.
    let who = |view: &String| engine.contributors("town", &Asked::about(Viewpoint::View(view.clone()))).unwrap().1;
    let [held_out, excluded, used] = [0, 1, 7].map(|at| who(&names[at]));
    assert_eq!((held_out.view_unused, held_out.photographed_by.as_deref()), (Some(Unused::HeldOut), Some("eve")));
    assert!(held_out.shares.iter().all(|of| of.name != "eve"), "{:?}", held_out.shares);
    assert_eq!((excluded.view_unused, excluded.photographed_by), (Some(Unused::Excluded), None));
    assert_eq!((used.view_unused, used.photographed_by.is_some()), (None, true));
}

#[test]
fn a_scene_without_held_out_views_gives_all_a_share_and_says_how_it_is_scored() {
    let dir = TestFolder::new();
    let engine = Engine::open(dir.path(), &Config::from_toml("", "test").unwrap(), Opening::Serve).unwrap();
    SceneFolder::create(&dir.path().join("scenes"), "town", &capture(&dir)).unwrap();
    let job = trained(&engine, "town");
    assert_eq!(engine.newest_model("town").unwrap().unwrap().without_share, []);
    assert!(!job.notes.iter().any(|note| note.contains("no share")), "{:?}", job.notes);
    let refused = engine.evaluate("town", false).unwrap_err().to_string();
    assert!(refused.contains("\"town\"") && refused.contains("import NAME --hold-out 8"), "{refused}");
}
