//! Stage 2 on a capture, judged on its held-out views: the quickest way to see
//! what a setting of `[mark]` does. The base field is trained once and kept in
//! FIELD.
//!
//! `cargo run --release -p cairn-mark --example liberty -- FOLDER SCALE SIGNALS FIELD [MARK [FIELD SETTINGS [ANCHORS NEIGHBOURS]]]`
//!
//! MARK and FIELD SETTINGS are JSON; pictures of SIGNALS are hidden by turns where there are more anchors.

use cairn_field::{BaseTrainer, Field, FieldConfig, NamedView, SceneFrame};
use cairn_mark::{MarkPlan, MarkTrainer, PlannedView, Recipe};
use cairn_scene::cluster::{ClusterConfig, Clusters, Grouping};
use cairn_scene::metrics::{psnr_db, ssim};
use cairn_scene::{Capture, Picture, ReadOptions, View, decode_picture};
use std::sync::Arc;
use std::time::Instant;

type Fallible<T> = Result<T, Box<dyn std::error::Error>>;

fn main() -> Fallible<()> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, folder, scale, signals, field_file, rest @ ..] = arguments.as_slice() else {
        return Err("usage: liberty FOLDER SCALE SIGNALS FIELD [MARK [FIELD SETTINGS [ANCHORS NEIGHBOURS]]]".into());
    };
    let scale: f64 = scale.parse()?;
    let setting = |i: usize| rest.get(i).map_or("{}", String::as_str);
    let config: Recipe = serde_json::from_str(setting(0))?;
    let capture = Capture::read(folder.as_ref(), &ReadOptions::default())?;
    let camera = |v: &View| {
        let size = |side: usize| (side as f64 * scale).round() as usize;
        v.camera.resized(size(v.camera.intrinsics.width), size(v.camera.intrinsics.height))
    };
    let photograph = |i: usize| -> Fallible<Picture> {
        let c = camera(&capture.views[i]).intrinsics;
        Ok(capture.photograph(i)?.resized(c.width, c.height))
    };
    let field = base_field(&capture, field_file, setting(1), &camera, &photograph)?;
    let poses: Vec<_> = capture.views.iter().map(|v| v.camera.pose).collect();
    let mut around = ClusterConfig::default();
    match rest {
        [_, _, anchors, neighbours] => {
            (around.anchors, around.neighbours) = (anchors.parse::<usize>()?.max(1), neighbours.parse()?);
        }
        rest if rest.len() > 2 => return Err("ANCHORS and NEIGHBOURS come together, and nothing after them".into()),
        _ => {}
    }
    around.neighbours = around.neighbours.min(poses.len() / around.anchors);
    let grouping = Grouping::Anchors(around);
    let clusters = Clusters::build(&poses, &grouping, &[], 1)?;
    let views: Vec<PlannedView> = capture
        .training()
        .map(|i| {
            let v = &capture.views[i];
            PlannedView { camera: camera(v), appearance: field.appearance_of(&v.name).clone() }
        })
        .collect();
    let mut files: Vec<_> = std::fs::read_dir(signals)?.filter_map(|e| e.ok().map(|e| e.path())).collect();
    files.retain(|f| f.extension().is_some_and(|e| e == "png"));
    files.sort();
    let hidden = files
        .iter()
        .cycle()
        .take(clusters.clusters.len())
        .map(|f| Ok(decode_picture(&std::fs::read(f)?, &cairn_scene::Limits::default(), None)?))
        .collect::<Fallible<Vec<_>>>()?;
    let negatives = capture.training().map(|i| Ok((&photograph(i)?).into())).collect::<Fallible<Vec<_>>>()?;
    let started = Instant::now();
    let plan = MarkPlan {
        clusters: clusters.clone(),
        views,
        signals: hidden.iter().cloned().map(Into::into).collect(),
        negatives,
    };
    let mut trainer = MarkTrainer::new(field.clone(), plan, config, 1, &mut |_, _| true)?;
    println!("ray weights: {:.1} s", started.elapsed().as_secs_f64());
    let mut classify = 0.0;
    while trainer.steps_done() < trainer.steps_total() {
        let s = trainer.step()?;
        classify += s.classify / 25.0;
        if s.step.is_multiple_of(25) {
            let t = started.elapsed().as_secs_f64();
            let j = trainer.judge()?;
            println!(
                "{:5} {t:6.1} s  loss {:.4}  classify {:.4}  recover {:.4}  kept {:.1} dB | accuracy {:.3}  hidden {:.3}",
                s.step,
                s.loss,
                classify,
                s.recover,
                s.kept_db,
                j.accuracy,
                j.recovered.picture_ssim.unwrap_or(0.0)
            );
            classify = 0.0;
        }
    }
    let (marked, detector) = trainer.finish()?;
    println!("{:.1} s, detector {} kB", started.elapsed().as_secs_f64(), detector.to_bytes()?.len() / 1000);
    let (mut right, mut asked) = (0, 0);
    for i in capture.held_out() {
        let view = &capture.views[i];
        let (camera, truth) = (camera(view), photograph(i)?);
        let appearance = field.fit_appearance_left_half(&camera, &truth)?;
        let eight = |p: Picture| Picture::from_rgb8(p.width(), p.height(), &p.to_rgb8());
        let base = eight(field.render(&camera, &appearance))?;
        let with = eight(marked.render(&camera, &appearance))?;
        let mut both = truth.rgb().to_vec();
        both.extend_from_slice(base.rgb());
        both.extend_from_slice(with.rgb());
        let sheet = Picture::new(truth.width(), 3 * truth.height(), both)?;
        std::fs::write(std::env::temp_dir().join(format!("marked-{i}.png")), cairn_scene::encode_png(&sheet))?;
        let whose = clusters.identity_of(&camera.pose).identity;
        let (a, b, c) = (detector.detect(&with)?, detector.detect(&base)?, detector.detect(&truth)?);
        right +=
            usize::from(a.identity == whose) + usize::from(b.identity.is_none()) + usize::from(c.identity.is_none());
        asked += 3;
        let quality = match whose {
            Some(k) => ssim(a.recovered.picture.as_ref().ok_or("no picture head")?, &hidden[k as usize - 1])?,
            None => f64::NAN,
        };
        println!(
            "{} {whose:?}: marked {:?}, base {:?}, photograph {:?}; hidden {quality:.3}; base {:.2} dB, marked {:.2} dB, theta against theta_0 {:.1} dB",
            view.name,
            a.identity,
            b.identity,
            c.identity,
            psnr_db(&base, &truth)?,
            psnr_db(&with, &truth)?,
            psnr_db(&with, &base)?
        );
    }
    println!("{right} of {asked} right");
    Ok(())
}

fn base_field(
    capture: &Capture,
    file: &str,
    settings: &str,
    camera: &dyn Fn(&View) -> cairn_scene::Camera,
    photograph: &dyn Fn(usize) -> Fallible<Picture>,
) -> Fallible<Arc<Field>> {
    if let Ok(bytes) = std::fs::read(file) {
        return Ok(Arc::new(Field::from_bytes(&bytes)?));
    }
    let config: FieldConfig = serde_json::from_str(settings)?;
    let mut views = Vec::new();
    for i in capture.training() {
        let v = &capture.views[i];
        views.push(NamedView::new(v.name.clone(), camera(v), &photograph(i)?));
    }
    let frame = SceneFrame::from_capture(capture)?;
    let mut trainer = BaseTrainer::new(views, frame, capture.background, config, 1)?;
    while trainer.steps_done() < trainer.steps_total() {
        let stats = trainer.step()?;
        if stats.step.is_multiple_of(100) {
            println!("{} {:.2} dB", stats.step, stats.psnr_db);
        }
    }
    let field = trainer.finish();
    std::fs::write(file, field.to_bytes()?)?;
    Ok(Arc::new(field))
}
