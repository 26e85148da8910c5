//! The light of a photograph that the field was not trained with, and what no light changes.

use crate::common::named;
use crate::common::{Numbers, ball_box, ball_in_the_open, random_grid, ring, rms, stored_with, tiny, views};
use cairn_field::appearance::code::CODE;
use cairn_field::{Appearance, AppearanceMode, BaseTrainer, Field, FieldConfig, FieldError, SceneFrame};
use cairn_scene::Picture;
use glam::DVec3;

/// All numbers of an appearance, by `1 + more`.
fn lit(more: f32) -> Appearance {
    let code = Appearance::neutral([0.3, 0.5, 0.7]).code().iter().map(|v| v * (1.0 + more)).collect();
    Appearance::from_code(code).expect("finite numbers")
}

/// A field in a box, whose views were brighter and darker in everything at once.
fn field(views: usize) -> Field {
    field_lit((0..views).map(|n| lit((n as f32 + 0.5) / views as f32 - 0.5)))
}

/// The field whose views had these appearances.
fn field_lit(views: impl Iterator<Item = Appearance>) -> Field {
    let appearances: Vec<(String, Appearance)> = views.enumerate().map(|(n, a)| (format!("{n:03}.png"), a)).collect();
    let grid = random_grid([12; 3], 0.6, -6.0..0.0, 7);
    let header = serde_json::json!({
        "format": cairn_field::FIELD_FORMAT, "frame": ball_box(), "dims": grid.dims, "canonical": lit(0.0),
        "appearances": appearances,
    });
    Field::from_bytes(&stored_with(&header, &grid)).expect("a sound field")
}

#[test]
fn what_does_not_show_is_lit_like_what_does() {
    let camera = ring(5, 32, 1.0, DVec3::ZERO)[0];
    // A box has no surroundings: their colours are open to anything.
    let far = 4;
    for (views, expected) in [(40, 1.4), (0, 1.0)] {
        let field = field(views);
        let photograph = field.render(&camera, &lit(0.4));
        let found = field.fit_appearance_left_half(&camera, &photograph).expect("a sound photograph");
        assert!((found.code()[0] - 1.4).abs() < 0.15, "{} after {views} views", found.code()[0]);
        assert!((found.code()[far] - expected).abs() < 0.03, "{} after {views} views", found.code()[far]);
    }
}

#[test]
fn the_right_half_has_no_say() {
    let camera = ring(5, 32, 1.0, DVec3::ZERO)[0];
    let field = field(10);
    let photograph = field.render(&camera, &lit(0.2));
    let mut numbers = Numbers(3);
    let mut changed = |half: fn(usize) -> bool| {
        let pixel = |(i, v): (usize, &f32)| if half(i / 3 % 32) { numbers.share() as f32 } else { *v };
        Picture::new(32, 32, photograph.rgb().iter().enumerate().map(pixel).collect()).expect("three numbers a pixel")
    };
    let fit = |picture: &Picture| field.fit_appearance_left_half(&camera, picture).expect("a sound photograph");
    assert_eq!(fit(&photograph), fit(&changed(|x| x >= 16)));
    assert_ne!(fit(&photograph), fit(&changed(|x| x < 16)));
}

/// What each half of a photograph alone would have told counts.
#[test]
fn both_halves_of_a_whole_photograph_have_a_say() {
    let camera = ring(5, 32, 1.0, DVec3::ZERO)[0];
    let field = field(10);
    let (dim, bright) = (field.render(&camera, &lit(-0.3)), field.render(&camera, &lit(0.3)));
    let half = |(i, (a, b)): (usize, (&f32, &f32))| if i / 3 % 32 < 16 { *a } else { *b };
    let rgb = dim.rgb().iter().zip(bright.rgb()).enumerate().map(half).collect();
    let torn = Picture::new(32, 32, rgb).expect("three numbers a pixel");
    let fit = |picture: &Picture| field.fit_appearance(&camera, picture).expect("a sound photograph").code()[0];
    let (dim, torn, bright) = (fit(&dim), fit(&torn), fit(&bright));
    assert!((dim - 0.7).abs() < 0.1 && (bright - 1.3).abs() < 0.1, "{dim} and {bright}");
    assert!(dim + 0.1 < torn && torn + 0.1 < bright, "{dim}, {torn}, {bright}");
    let small = Picture::constant(31, 32, [0.5; 3]);
    let error = field.fit_appearance(&camera, &small).expect_err("another size");
    assert!(error.to_string().contains("31 x 32 px for a camera of 32 x 32"), "{error}");
}

#[test]
fn a_photograph_that_no_light_explains_is_refused() {
    let camera = ring(5, 32, 1.0, DVec3::ZERO)[0];
    for broken in [f32::NAN, f32::INFINITY] {
        // In either half.
        for at in [300, 300 + 3 * 16] {
            let mut photograph = field(3).render(&camera, &lit(0.0));
            photograph.rgb_mut()[at] = broken;
            let error = field(3).fit_appearance(&camera, &photograph).expect_err("not finite");
            assert!(matches!(&error, FieldError::Views(why) if why.contains("photograph")), "{error}");
        }
        let mut photograph = field(3).render(&camera, &lit(0.0));
        photograph.rgb_mut()[300] = broken;
        let error = field(3).fit_appearance_left_half(&camera, &photograph).expect_err("not finite");
        assert!(matches!(&error, FieldError::Views(why) if why.contains("photograph")), "{error}");
    }
}

#[test]
fn the_way_from_one_light_to_another_ends_in_both_exactly() {
    let (from, to) = (lit(0.1), lit(-0.37));
    assert_eq!(from.mixed(&to, 0.0), from);
    assert_eq!(from.mixed(&to, 1.0), to);
    let half = from.mixed(&to, 0.5);
    let ends = from.code().iter().zip(to.code());
    assert!(half.code().iter().zip(ends).all(|(h, (a, b))| (h - 0.5 * (a + b)).abs() < 1e-6));
}

#[test]
fn a_field_with_lights_beyond_all_bounds_says_so() {
    let camera = ring(5, 32, 1.0, DVec3::ZERO)[0];
    let vast = |n: usize| Appearance::from_code(vec![if n == 0 { 3e38 } else { 0.1 }; CODE]).expect("finite numbers");
    let field = field_lit((0..3).map(vast));
    let photograph = field.render(&camera, &lit(0.0));
    let error = field.fit_appearance_left_half(&camera, &photograph).expect_err("nobody's light");
    assert!(matches!(&error, FieldError::Stored { what: "field", .. }), "{error}");
}

/// A field trained on photographs of the ball, each in a light of its own: channels by other factors, and
/// more or less haze.
fn trained_in_many_lights(frame: &SceneFrame) -> Field {
    let mut numbers = Numbers(11);
    let mut views = views(12, 24, 1.0, DVec3::ZERO);
    for view in &mut views {
        let gain: [f64; 3] = std::array::from_fn(|_| numbers.within(0.4, 0.9));
        let haze: [f64; 3] = std::array::from_fn(|_| numbers.within(0.0, 0.1));
        let lit = |(i, v): (usize, &f32)| (f64::from(*v) * gain[i % 3] + haze[i % 3]) as f32;
        let rgb = view.picture.rgb().iter().enumerate().map(lit).collect();
        view.picture = Picture::new(24, 24, rgb).expect("three numbers a pixel");
    }
    let config = FieldConfig { appearance: AppearanceMode::On, ..tiny(200) };
    let mut trainer = BaseTrainer::new(named(views), frame.clone(), Some([0.5; 3]), config, 3).expect("sound settings");
    while trainer.steps_done() < trainer.steps_total() {
        trainer.step().expect("finite numbers");
    }
    trainer.finish()
}

#[test]
fn an_appearance_changes_colours_and_leaves_geometry_to_the_bit() {
    let camera = ring(5, 32, 1.0, DVec3::ZERO)[2];
    let bits = |map: &[f32]| map.iter().map(|v| v.to_bits()).collect::<Vec<u32>>();
    for frame in [ball_box(), ball_in_the_open()] {
        let field = trained_in_many_lights(&frame);
        let lights: Vec<&Appearance> = field.appearances().iter().map(|(_, look)| look).collect();
        assert_eq!(lights.len(), 12);
        let first = field.render_maps(&camera, lights[0]);
        assert!(first.accumulation.iter().any(|a| *a > 0.9) && first.depth.iter().any(|d| *d > 0.1), "there is a ball");
        for (n, look) in lights.iter().enumerate().skip(1) {
            let other = field.render_maps(&camera, look);
            assert_eq!(bits(&other.depth), bits(&first.depth), "{frame:?}: depth in light {n}");
            assert_eq!(bits(&other.accumulation), bits(&first.accumulation), "{frame:?}: accumulation in light {n}");
            let apart = rms(other.picture.rgb(), first.picture.rgb());
            assert!(apart > 0.02, "{frame:?}: light {n} is {apart} from the first");
        }
    }
}
