//! A landmark project's own program: it opens a data folder, imports a capture, trains with a preset, and asks who
//! contributed to a view. `cargo run --release -p cairn-service --example embed`

use std::error::Error;
use std::time::Duration;

use cairn_landmark::{Landmark, LandmarkConfig};
use cairn_scene::cluster::Grouping;
use cairn_scene::{Capture, ReadOptions};
use cairn_service::config::preset::settings;
use cairn_service::config::{Chosen, Config, Preset, Quality};
use cairn_service::engine::{Engine, Opening};
use cairn_service::query::coverage::Asked;
use cairn_service::query::viewpoint::Viewpoint;
use cairn_service::train::request::{Plan, TrainingRequest};

fn main() -> Result<(), Box<dyn Error>> {
    // A made-up landmark stands for the photographs of a real one.
    let place = tempfile::tempdir()?;
    let photographs = place.path().join("photographs");
    let size = LandmarkConfig { contributors: 2, photographs: 4, width: 32, height: 32, ..LandmarkConfig::default() };
    Landmark::generate(&size, 3)?.write(&photographs)?;
    let table = ReadOptions { contributors: Some(photographs.join("contributors.csv")), ..ReadOptions::default() };

    let engine = Engine::open(&place.path().join("data"), &Config::from_toml("", "the defaults")?, Opening::Serve)?;
    engine.import_capture("tower", &Capture::read(&photographs, &table)?)?;
    let chosen = Chosen { preset: Preset::Outdoor, quality: Quality::Smoke, robust: false };
    let job = engine.train(TrainingRequest {
        scene: "tower".into(),
        also: Vec::new(),
        grow: false,
        grouping: Grouping::ByContributor { min_views: 2, direction_weight: 1.0 },
        seed: 7,
        plan: Plan::Given(Box::new(settings(chosen))),
        signals: Vec::new(),
        base_only: false,
        owner: None,
    })?;
    while !engine.jobs().get(&job.id)?.state.has_ended() {
        std::thread::sleep(Duration::from_millis(100));
    }
    let view = engine.scene("tower")?.capture().views[0].name.clone();
    let (_, who) = engine.contributors("tower", &Asked::about(Viewpoint::View(view.clone())))?;
    for contributor in who.shares {
        println!("{view}: {:.1} % {}", 100.0 * contributor.share, contributor.name);
    }
    engine.shut_down();
    engine.close();
    Ok(())
}
