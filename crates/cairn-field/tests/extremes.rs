//! Training on photographs that leave little or nothing to learn: it stays finite
//! and shows what there is, or it says what is wrong.

use crate::common::{Photo, named};
use crate::common::{ball_box, ball_in_the_open, camera, capture, facing, photographs, ring, rms, tiny, views};
use cairn_field::{AppearanceMode, BaseTrainer, Field, FieldConfig, SceneFrame};
use cairn_scene::{Picture, SceneKind};
use glam::DVec3;

/// Trains to the end; every step is finite, and any checkpoint can be read.
fn train(views: Vec<Photo>, frame: &SceneFrame, background: Option<[f32; 3]>, config: FieldConfig) -> Field {
    let mut trainer =
        BaseTrainer::new(named(views.clone()), frame.clone(), background, config, 2).expect("sound settings");
    while trainer.steps_done() < trainer.steps_total() {
        assert!(trainer.step().expect("finite numbers").loss.is_finite());
    }
    BaseTrainer::resume(&trainer.checkpoint().expect("a checkpoint"), named(views)).expect("finite numbers in it");
    trainer.finish()
}

/// How far the field's renders of its own views are off, root mean square.
fn off(field: &Field, views: &[Photo]) -> f64 {
    let one = |v: &Photo| {
        let shown = field.render(&v.camera, field.appearance_of(&v.name));
        assert!(shown.rgb().iter().all(|v| v.is_finite()), "{}", v.name);
        rms(shown.rgb(), v.picture.rgb())
    };
    views.iter().map(one).fold(0.0, f64::max)
}

fn of_colour(colour: [f32; 3]) -> Vec<Photo> {
    let mut views = views(5, 20, 1.0, DVec3::ZERO);
    for view in &mut views {
        view.picture = Picture::constant(20, 20, colour);
    }
    views
}

/// Views that look ahead, and the frame around them.
fn ahead(n: usize, size: usize) -> (Vec<Photo>, SceneFrame) {
    let cameras = facing(n, size, 1.0, DVec3::ZERO);
    let views = photographs(&cameras, 1.0, DVec3::ZERO);
    let frame = SceneFrame::from_capture(&capture(SceneKind::ForwardFacing, cameras, 1.0, DVec3::ZERO));
    (views, frame.expect("a near plane"))
}

#[test]
fn looking_ahead_constant_and_saturated_photographs_are_reproduced() {
    for colour in [[0.0; 3], [1.0; 3], [0.0, 1.0, 0.5], [7.0, -3.0, 0.5]] {
        let (mut views, frame) = ahead(5, 20);
        for view in &mut views {
            view.picture = Picture::constant(20, 20, colour);
        }
        let field = train(views.clone(), &frame, None, tiny(80));
        // Beyond the range they are saturated.
        for view in &mut views {
            view.picture = Picture::constant(20, 20, colour.map(|v: f32| v.clamp(0.0, 1.0)));
        }
        assert!(off(&field, &views) < 0.01, "{colour:?}: {}", off(&field, &views));
        let field = train(views.clone(), &frame, Some([0.5; 3]), tiny(200));
        assert!(off(&field, &views) < 0.03, "{colour:?} before grey: {}", off(&field, &views));
    }
}

#[test]
fn looking_ahead_a_single_view_is_learnt() {
    let (views, frame) = ahead(1, 24);
    let field = train(views.clone(), &frame, None, tiny(150));
    assert!(off(&field, &views) < 0.03, "{}", off(&field, &views));
}

#[test]
fn constant_and_saturated_photographs_are_reproduced() {
    for colour in [[0.0; 3], [1.0; 3], [0.0, 1.0, 0.5]] {
        let views = of_colour(colour);
        // The background is their mean, and is all that is needed.
        let field = train(views.clone(), &ball_box(), None, tiny(80));
        assert!(off(&field, &views) < 0.02, "{colour:?}: {}", off(&field, &views));
        // A wrong background has to be covered, or learnt to be another.
        let field = train(views.clone(), &ball_in_the_open(), Some([0.5; 3]), tiny(200));
        assert!(off(&field, &views) < 0.05, "{colour:?} in the open: {}", off(&field, &views));
    }
}

#[test]
fn colours_beyond_the_range_are_saturated() {
    let views = of_colour([7.0, -3.0, 0.5]);
    let field = train(views, &ball_box(), None, tiny(80));
    let expected = of_colour([1.0, 0.0, 0.5]);
    assert!(off(&field, &expected) < 0.02, "{}", off(&field, &expected));
}

#[test]
fn a_single_view_is_learnt() {
    for frame in [ball_box(), ball_in_the_open()] {
        let views = views(1, 24, 1.0, DVec3::ZERO);
        let field = train(views.clone(), &frame, None, tiny(150));
        assert!(off(&field, &views) < 0.08, "{frame:?}: {}", off(&field, &views));
    }
}

#[test]
fn two_cameras_on_top_of_one_another_are_learnt() {
    let place = camera(DVec3::new(0.5, 0.8, 4.0), DVec3::ZERO, 24);
    for frame in [ball_box(), ball_in_the_open()] {
        let mut views = photographs(&[place, place], 1.0, DVec3::ZERO);
        let field = train(views.clone(), &frame, None, tiny(150));
        assert!(off(&field, &views) < 0.08, "{frame:?}: {}", off(&field, &views));
        // One place and two stories: something between them, and finite.
        views[1].picture = Picture::constant(24, 24, [0.5; 3]);
        let field = train(views.clone(), &frame, None, tiny(80));
        assert!(off(&field, &views) < 0.4);
    }
}

#[test]
fn cameras_inside_the_grid_are_learnt_from() {
    let cameras: Vec<_> = (0..6)
        .map(|i| {
            let a = f64::from(i) * 1.1;
            camera(DVec3::new(0.2 * a.cos(), 0.1, 0.2 * a.sin()), 9.0 * DVec3::new(a.sin(), 0.2, a.cos()), 20)
        })
        .collect();
    for frame in [ball_box(), ball_in_the_open()] {
        let mut views = photographs(&cameras, 1.0, DVec3::ZERO);
        for view in &mut views {
            view.picture = Picture::constant(20, 20, [0.8, 0.3, 0.1]);
        }
        let field = train(views.clone(), &frame, Some([0.5; 3]), tiny(150));
        assert!(off(&field, &views) < 0.08, "{frame:?}: {}", off(&field, &views));
    }
}

#[test]
fn cameras_that_look_away_teach_nothing() {
    let away: Vec<_> =
        ring(4, 16, 1.0, DVec3::ZERO).into_iter().map(|c| camera(c.pose.position, 2.0 * c.pose.position, 16)).collect();
    let views = photographs(&away, 1.0, DVec3::ZERO);
    let sky = [0.5, 0.25, 0.125];
    let config = FieldConfig { appearance: AppearanceMode::Off, ..tiny(60) };
    let field = train(views.clone(), &ball_box(), Some(sky), config);
    for view in &views {
        let shown = field.render(&view.camera, field.canonical_appearance());
        assert!(shown.rgb().chunks_exact(3).all(|p| crate::common::apart(p, &sky) < 1e-6), "the background");
    }
    // In the open there is something in every direction.
    let field = train(views.clone(), &ball_in_the_open(), Some(sky), tiny(150));
    assert!(off(&field, &views) < 0.08, "{}", off(&field, &views));
}
