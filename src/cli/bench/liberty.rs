//! Suite `liberty`: a real landmark through the services, both stages.

use std::path::Path;

use anyhow::Context as _;

use super::super::connect::{Connection, Where};
use super::super::{evaluate, scene, train};
use super::Args;
use super::rows::Rows;

/// Trains and scores it, and adds its rows.
pub async fn measure(place: &Where, args: &Args, rows: &mut Rows) -> anyhow::Result<()> {
    let from = args.captures()?.join("liberty");
    std::fs::create_dir(&args.out)
        .with_context(|| format!("cannot make the folder {}; choose a new one (--out)", args.out.display()))?;
    let line = Connection::open(&Where { connect: None, data: args.out.join("data"), ..place.clone() }).await?;
    let done = train_and_score(&line, args, &from, rows).await;
    line.close().await;
    done
}

async fn train_and_score(line: &Connection, args: &Args, from: &Path, rows: &mut Rows) -> anyhow::Result<()> {
    let import = scene::ImportArgs {
        name: "liberty".into(),
        from: from.to_path_buf(),
        contributors: Some(from.join("contributors.csv")),
        kind: None,
        hold_every: 8,
        images: None,
        skip_missing: false,
        width: None,
        height: None,
        scale: (args.scale < 1.0).then_some(args.scale),
    };
    scene::import(line, &import).await?;
    let train = train::Args {
        name: "liberty".into(),
        anchors: args.anchors.unwrap_or(3),
        neighbours: if args.anchors.is_some() { args.neighbours } else { Some(20) },
        by_contributor: false,
        min_views: 2,
        seed: args.seed,
        signals: args.signals.clone(),
        options: train::Options { quality: args.quick.then_some(train::Quality::Draft), ..train::Options::default() },
        base_only: args.base_only,
        with: Vec::new(),
        grow: false,
        resume: None,
        detach: false,
        keys: None,
    };
    let job = train::run_to_end(line, &train).await?;
    let of = args.neighbours.map_or(String::new(), |k| format!(" of {k} views"));
    let clusters = args.anchors.map_or(String::new(), |m| format!(", {m} anchors{of}"));
    let case = args.case_name(&format!("liberty{clusters}"));
    for stage in &job.stages {
        rows.add(&case, &stage.stage, stage.seconds, "s", None);
    }
    let report = evaluate::report(line, "liberty", None, Some(&args.out.join("contact-sheet.png"))).await?;
    rows.of_report(&case, &report);
    Ok(())
}
