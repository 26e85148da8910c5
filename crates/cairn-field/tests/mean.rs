//! The mean of a training's last states: what it is worth on views that were not trained on.

use crate::common::{Numbers, ball_box, camera, photograph, rms, tiny, views};
use crate::common::{Photo, named};
use cairn_field::{BaseTrainer, Field, FieldConfig};
use cairn_scene::{Camera, Picture};
use glam::DVec3;

/// The view with a photograph as of a small sensor at night: grain of up to 0.2.
fn grainy(view: Photo) -> Photo {
    let mut numbers = Numbers(view.name.bytes().map(u64::from).sum());
    let (width, height) = (view.picture.width(), view.picture.height());
    let rgb = view.picture.rgb().iter().map(|v| (v + numbers.within(-0.2, 0.2) as f32).clamp(0.0, 1.0)).collect();
    Photo { picture: Picture::new(width, height, rgb).expect("as large"), ..view }
}

fn trained(mean_of_last: f64, seed: u64) -> Field {
    let config = FieldConfig { mean_of_last, ..tiny(600) };
    let photographs = views(9, 32, 1.0, DVec3::ZERO).into_iter().map(grainy).collect();
    let mut trainer = BaseTrainer::new(named(photographs), ball_box(), None, config, seed).expect("sound settings");
    while trainer.steps_done() < trainer.steps_total() {
        trainer.step().expect("finite numbers");
    }
    trainer.finish()
}

/// Root mean square error on cameras between those of the ring that was trained on.
fn error(field: &Field) -> f64 {
    let between: Vec<Camera> = (0..4)
        .map(|k| {
            let turn = 0.35 + 1.57 * f64::from(k);
            camera(DVec3::new(3.0 * turn.cos(), 0.9, 3.0 * turn.sin()), DVec3::ZERO, 32)
        })
        .collect();
    let off = |camera: &Camera| {
        let shown = field.render(camera, field.canonical_appearance());
        rms(shown.rgb(), photograph(camera, 1.0, DVec3::ZERO).rgb())
    };
    between.iter().map(off).sum::<f64>() / between.len() as f64
}

#[test]
fn the_last_state_is_kept_where_the_mean_lags_behind() {
    // Few steps on photographs without grain: each still brings it nearer.
    let end = |mean_of_last: f64| {
        let config = FieldConfig { mean_of_last, ..tiny(60) };
        let mut trainer =
            BaseTrainer::new(named(views(9, 32, 1.0, DVec3::ZERO)), ball_box(), None, config, 1).expect("settings");
        while trainer.steps_done() < trainer.steps_total() {
            trainer.step().expect("finite numbers");
        }
        trainer.finish().to_bytes().expect("a field")
    };
    assert!(end(0.2) == end(0.0));
}

#[test]
fn grain_is_averaged_out() {
    for seed in 1..3 {
        let (last, mean) = (error(&trained(0.0, seed)), error(&trained(0.2, seed)));
        println!("seed {seed}: {mean:.4} for {last:.4}");
        assert!(mean < 0.99 * last, "seed {seed}: {mean} for {last}");
    }
}
