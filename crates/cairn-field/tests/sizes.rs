//! Photographs of different sizes and focal lengths in one training: each view's rays are its own camera's.

use crate::common::{Photo, named};
use crate::common::{ball_box, camera, photograph, photographs, ring, rms, tiny};
use cairn_field::{BaseTrainer, Field};
use cairn_scene::{Camera, Picture};
use glam::DVec3;

/// The ring at 32 x 32 px, at 48 x 40 px through a longer lens, and both in turns.
fn rings() -> [Vec<Camera>; 3] {
    let small = ring(12, 32, 1.0, DVec3::ZERO);
    let mut large = small.clone();
    for camera in &mut large {
        let lens = &mut camera.intrinsics;
        (lens.width, lens.height) = (48, 40);
        (lens.fx, lens.fy, lens.cx, lens.cy) = (74.0, 71.0, 23.0, 21.0);
    }
    let turns = (0..12).map(|i| if i % 2 == 0 { small[i] } else { large[i] }).collect();
    [small, large, turns]
}

fn train(views: Vec<Photo>) -> Field {
    let mut trainer = BaseTrainer::new(named(views), ball_box(), None, tiny(200), 5).expect("sound settings");
    while trainer.steps_done() < trainer.steps_total() {
        trainer.step().expect("finite numbers");
    }
    trainer.finish()
}

fn db(field: &Field, camera: &Camera, truth: &Picture) -> f64 {
    let shown = field.render(camera, field.canonical_appearance()).clamped();
    -20.0 * rms(shown.rgb(), truth.rgb()).log10()
}

/// How well views that nobody trained on are shown, of both sizes: their mean, dB.
fn held_out_db(field: &Field) -> f64 {
    let places = [DVec3::new(1.1, 1.6, 3.4), DVec3::new(-3.0, -0.4, 2.4)];
    let [small, large, _] = rings();
    let new = places
        .iter()
        .flat_map(|place| [small[0], large[0]].map(|c| Camera { pose: camera(*place, DVec3::ZERO, 32).pose, ..c }));
    let each: Vec<f64> = new.map(|c| db(field, &c, &photograph(&c, 1.0, DVec3::ZERO))).collect();
    each.iter().sum::<f64>() / each.len() as f64
}

#[test]
fn photographs_of_two_sizes_teach_as_much_as_those_of_one() {
    let [small, large, turns] = rings().map(|cameras| photographs(&cameras, 1.0, DVec3::ZERO));
    let [of_small, of_large, of_turns] = [&small, &large, &turns].map(|views| train(views.clone()));
    // The longer lens alone sees little beside the ball.
    let one_size = held_out_db(&of_small);
    let new = held_out_db(&of_turns);
    assert!(one_size > 22.0 && new > one_size - 1.0, "new views: {new:.2} dB of two sizes, {one_size:.2} dB of one");
    // What these bounds are worth: of the right size and along rays of another lens, they are missed by far.
    let mut mistaken = turns.clone();
    for view in mistaken.iter_mut().skip(1).step_by(2) {
        view.camera.intrinsics = small[0].camera.intrinsics.resized(48, 40);
    }
    let of_mistaken = train(mistaken);
    assert!(held_out_db(&of_mistaken) < one_size - 3.0, "{:.2} dB", held_out_db(&of_mistaken));
    for (n, view) in turns.iter().enumerate() {
        let same_size = if n % 2 == 0 { &of_small } else { &of_large };
        let [one, two, wrong] = [same_size, &of_turns, &of_mistaken].map(|f| db(f, &view.camera, &view.picture));
        assert!(two > one - 3.0, "view {n}: {two:.2} dB of two sizes, {one:.2} dB of one");
        assert!(wrong < one - 3.0, "view {n}: {wrong:.2} dB along another lens's rays");
    }
}

#[test]
fn a_photograph_of_another_views_size_is_refused_by_name() {
    let [_, _, mut two] = rings().map(|cameras| photographs(&cameras, 1.0, DVec3::ZERO));
    two[3].picture = Picture::constant(32, 32, [0.5; 3]);
    let error = BaseTrainer::new(named(two), ball_box(), None, tiny(10), 5).err().expect("another size").to_string();
    assert!(error.contains("003.png") && error.contains("48 x 40") && error.contains("32 x 32"), "{error}");
}
