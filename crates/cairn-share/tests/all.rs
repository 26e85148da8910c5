//! Shares of a ball that twelve photographers stand around.

use cairn_field::{
    Appearance, AppearanceMode, BaseTrainer, Field, FieldConfig, MarkableField, NamedView, OfPixel, SceneFrame,
    VisibleField,
};
use cairn_scene::{Camera, Distortion, Intrinsics, Mask, Picture, Picture8, Pose, TrainView};
use cairn_share::{
    Builder, Lesson, Necessity, Photograph, SAMPLED_PIXELS, SeenFrom, ShareError, ShareTable, Shares, Sharpness, taught,
};
use glam::DVec3;
use std::sync::OnceLock;

const PHOTOGRAPHS: usize = 12;

/// A camera somewhere on the ring, in twelfths of it.
fn camera(twelfths: f64, scale: usize) -> Camera {
    let intrinsics = Intrinsics {
        width: 40 * scale,
        height: 36 * scale,
        fx: 48.0 * scale as f64,
        fy: 48.0 * scale as f64,
        cx: 20.0 * scale as f64,
        cy: 18.0 * scale as f64,
        distortion: Distortion::default(),
    };
    let angle = twelfths * std::f64::consts::TAU / PHOTOGRAPHS as f64;
    let position = DVec3::new(3.0 * angle.cos(), 3.0 * angle.sin(), 0.6);
    Camera { intrinsics, pose: Pose::look_at(position, DVec3::ZERO, DVec3::Z).unwrap() }
}

/// A ball of radius 1, coloured by its normal.
fn photograph(camera: &Camera) -> Picture {
    let (w, h) = (camera.intrinsics.width, camera.intrinsics.height);
    let mut rgb = Vec::new();
    for at in 0..w * h {
        let (o, d) = camera.ray((at % w) as f64 + 0.5, (at / w) as f64 + 0.5);
        let b = o.dot(d);
        let root = b * b - (o.length_squared() - 1.0);
        let colour = if root > 0.0 { (o + d * (-b - root.sqrt())) * 0.4 + 0.5 } else { DVec3::splat(0.8) };
        rgb.extend(colour.to_array().map(|v| v as f32));
    }
    Picture::new(w, h, rgb).unwrap()
}

fn name(k: usize) -> String {
    format!("view{k}")
}

fn field() -> &'static Field {
    static FIELD: OnceLock<Field> = OnceLock::new();
    FIELD.get_or_init(|| {
        let view = |k: usize| NamedView::new(name(k), camera(k as f64, 1), &photograph(&camera(k as f64, 1)));
        let frame = SceneFrame::Bounded { centre: DVec3::ZERO, half: DVec3::splat(1.2) };
        let appearance = AppearanceMode::Off;
        let config = FieldConfig {
            steps: 120,
            rays_per_step: 1024,
            voxels: 8000,
            levels: 1,
            appearance,
            ..FieldConfig::default()
        };
        let views = (0..PHOTOGRAPHS).map(view).collect();
        let mut trainer = BaseTrainer::new(views, frame, Some([0.8; 3]), config, 3).unwrap();
        while trainer.steps_done() < trainer.steps_total() {
            trainer.step().unwrap();
        }
        trainer.finish()
    })
}

/// The table of photographs of that scale.
fn table(scale: usize) -> ShareTable {
    let mut builder = Builder::new(VisibleField::rows(field()));
    for k in 0..PHOTOGRAPHS {
        let camera = camera(k as f64, scale);
        let photograph = Photograph { name: name(k), position: camera.pose.position };
        builder.add(photograph, &field().row_weights(&camera, OfPixel::All)).unwrap();
    }
    builder.finish().unwrap()
}

fn shares(table: &ShareTable, from: &Camera, sharpness: Sharpness) -> Shares {
    let seen = field().row_weights(from, OfPixel::All);
    SeenFrom::new(table, field(), from.pose.position, sharpness).shares(&seen)
}

#[test]
fn who_stands_nearest_has_the_largest_share_and_who_stands_behind_none() {
    let table = table(1);
    for sharpness in [Sharpness::new(0), Sharpness::default()] {
        let Shares { of_photographs, unseen, behind } = shares(&table, &camera(4.2, 1), sharpness);
        let sum = of_photographs.iter().sum::<f64>() + unseen + behind;
        assert!((sum - 1.0).abs() < 1e-3, "all parts together are {sum}");
        assert!(unseen < 0.02, "every part of the ball was photographed, {unseen} was not");
        assert!(behind > 0.3, "the sky lies behind the ball: {behind}");
        let first = (0..PHOTOGRAPHS).max_by(|a, b| of_photographs[*a].total_cmp(&of_photographs[*b])).unwrap();
        assert_eq!(first, 4, "{sharpness:?}: {of_photographs:?}");
        assert!(of_photographs[10] < 0.01, "{sharpness:?}: from behind {}", of_photographs[10]);
        assert!(of_photographs[4] > of_photographs[5] && of_photographs[5] > of_photographs[6]);
    }
    let sharp = shares(&table, &camera(4.2, 1), Sharpness::new(32)).of_photographs[4];
    assert!(sharp > shares(&table, &camera(4.2, 1), Sharpness::new(0)).of_photographs[4] * 1.3, "{sharp}");
}

#[test]
fn a_quarter_of_the_pixels_says_the_same_to_a_hundredth() {
    let (all, some) = (table(2), table(1));
    for twelfths in [0.0, 2.5, 7.3] {
        let [of_all, of_some] = [&all, &some].map(|t| shares(t, &camera(twelfths, 2), Sharpness::default()));
        for (k, (a, b)) in of_all.of_photographs.iter().zip(&of_some.of_photographs).enumerate() {
            assert!((a - b).abs() < 0.01, "photograph {k}: {a} by all pixels, {b} by a quarter");
        }
    }
}

#[test]
fn a_map_s_pixels_add_up_to_the_view_s_shares() {
    let (table, camera) = (table(1), camera(1.4, 1));
    let seen = field().row_weights(&camera, OfPixel::All);
    let from = SeenFrom::new(&table, field(), camera.pose.position, Sharpness::default());
    let whole = from.shares(&seen);
    let group_of: Vec<usize> = (0..PHOTOGRAPHS).map(|k| k / 2).collect();
    let map = from.map(&camera, &seen, &group_of);
    assert_eq!(map.len(), 40 * 36);
    for group in 0..PHOTOGRAPHS / 2 {
        let of_pixels = map.iter().map(|pixel| f64::from(pixel.channels[group])).sum::<f64>() / map.len() as f64;
        let of_view = whole.of_photographs[2 * group] + whole.of_photographs[2 * group + 1];
        assert!((of_pixels - of_view).abs() < 1e-4, "group {group}: {of_pixels}, the view has {of_view}");
    }
    let behind = map.iter().map(|pixel| f64::from(pixel.behind)).sum::<f64>() / map.len() as f64;
    assert!((behind - whole.behind).abs() < 1e-5);
    // A part of the picture has shares of its own: the left edge sees only sky.
    let edge = field().row_weights(&camera, OfPixel::ByPlace(&|at| f32::from(u8::from(at % 40 < 3))));
    let sky = from.shares(&edge).behind;
    assert!(sky > 0.9 && sky > 1.5 * whole.behind && edge.pixels == 3.0 * 36.0, "{sky}");
}

#[test]
fn a_table_of_another_field_is_refused() {
    let other = Builder::new(VisibleField::rows(field()) + 1).finish().unwrap();
    let refused = other.must_be_of(field()).expect_err("other rows");
    assert!(matches!(refused, ShareError::OtherField { .. }) && refused.to_string().contains("train the scene again"));
}

#[test]
fn what_taught_nothing_counts_for_nothing() {
    let camera = camera(2.0, 1);
    let view = |picture: &Picture, mask: Option<Mask>| TrainView { camera, rgb8: Picture8::from(picture), mask };
    let (clear, pixels) = (photograph(&camera), 40.0 * 36.0);
    let whole = taught(field(), &name(2), &view(&clear, None), 0.0);
    assert_eq!(whole, field().row_weights(&camera, OfPixel::All));
    // A mask that leaves the right half out.
    let mask = Mask::from_fn(40, 36, |x, _| x < 20).unwrap();
    let left = taught(field(), &name(2), &view(&clear, Some(mask)), 0.0);
    assert_eq!(left, field().row_weights(&camera, OfPixel::ByPlace(&|at| f32::from(u8::from(at % 40 < 20)))));
    // Of a large photograph every second column is used: each pixel of the smaller one counts half.
    let large = self::camera(2.0, 14);
    let mask = Mask::from_fn(560, 504, |x, _| x.is_multiple_of(2)).unwrap();
    let striped = TrainView { camera: large, rgb8: Picture8::from(&photograph(&large)), mask: Some(mask) };
    let striped = taught(field(), &name(2), &striped, 0.0).pixels;
    assert!((striped / (560.0 * 504.0) - 0.5).abs() < 0.02, "{striped} px count");
    // A passer-by in white over the middle: what stands there teaches less, the rest as much as before.
    let mut hidden = clear.clone();
    for (x, y) in (12..36).flat_map(|y| (16..24).map(move |x| (x, y))) {
        hidden.rgb_mut()[3 * (y * 40 + x)..3 * (y * 40 + x) + 3].fill(1.0);
    }
    let [of_clear, of_hidden] = [&clear, &hidden].map(|p| taught(field(), &name(2), &view(p, None), 0.1).pixels);
    assert!(of_clear > 0.95 * pixels, "{of_clear} of {pixels} px count without a passer-by");
    assert!(of_clear - of_hidden > 0.4 * 24.0 * 8.0, "{of_hidden} px count with a passer-by, {of_clear} without");
}

#[test]
fn a_large_photograph_is_sampled_and_counts_for_all_its_pixels() {
    let camera = camera(2.0, 14);
    let pixels = camera.intrinsics.width * camera.intrinsics.height;
    assert!(pixels > 4 * SAMPLED_PIXELS);
    let view = TrainView { camera, rgb8: Picture8::from(&photograph(&camera)), mask: None };
    let (some, all) = (taught(field(), &name(2), &view, 0.0), field().row_weights(&camera, OfPixel::All));
    assert!((some.pixels - pixels as f64).abs() < 1e-3 * pixels as f64 && some.rows.len() <= all.rows.len());
    let sum = |seen: &cairn_field::RowWeights| seen.rows.iter().map(|(_, weight)| f64::from(*weight)).sum::<f64>();
    assert!((sum(&some) / sum(&all) - 1.0).abs() < 0.01, "{} px, not {}", sum(&some), sum(&all));
}

/// A light for each photograph, which dims its colours and mixes them.
fn light(k: usize) -> Appearance {
    let mut code = field().canonical_appearance().code().to_vec();
    let features = code.len() / 3;
    for c in 0..3 {
        code[c * features + c] *= 1.0 - 0.05 * (k % 5) as f32;
        code[c * features + (c + 1) % 3] += 0.02 * (k % 3) as f32;
    }
    Appearance::from_code(code).unwrap()
}

fn lessons() -> Vec<Lesson> {
    let lesson = |k: usize| {
        let camera = camera(k as f64, 1);
        let view = field().view(&camera, 1e-4, 1);
        let shown = view.base(field().canonical_appearance());
        let residual = photograph(&camera).rgb().iter().zip(&shown).map(|(y, c)| y - c).collect();
        Lesson { view, light: light(k), residual, weights: vec![1.0; 40 * 36] }
    };
    (0..PHOTOGRAPHS).map(lesson).collect()
}

/// What the solution makes as small as it can be.
fn price(lessons: &[Lesson], off: &[f32], pull: f32, moved: &[f32]) -> f64 {
    let mut price = 0.0;
    for lesson in lessons {
        let mut shown = vec![0.0; lesson.residual.len()];
        lesson.view.apply_lit(moved, &lesson.light, &mut shown);
        price += lesson.residual.iter().zip(&shown).map(|(r, s)| f64::from(r - s).powi(2)).sum::<f64>();
    }
    price + f64::from(pull) * moved.iter().zip(off).map(|(m, o)| f64::from(m + o).powi(2)).sum::<f64>()
}

#[test]
fn colours_are_solved_for_as_far_as_they_go() {
    let (lessons, pull) = (lessons(), 0.5);
    let off: Vec<f32> = field().constant_colours().iter().flat_map(|c| c.map(|v| v - 0.5)).collect();
    let solved = Necessity::new(&lessons, MarkableField::rows(field()), off.clone(), pull, 60).solve(|_| true);
    let least = price(&lessons, &off, pull, &solved);
    assert!(least < 0.9 * price(&lessons, &off, pull, &vec![0.0; solved.len()]));
    for n in 1..6u32 {
        let mut state = n;
        let aside: Vec<f32> = solved
            .iter()
            .map(|v| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                v + 0.02 * ((state >> 8) as f32 / (1 << 24) as f32 - 0.5)
            })
            .collect();
        let other = price(&lessons, &off, pull, &aside);
        assert!(least < other, "{least} is not the least: {other}");
    }
}

#[test]
fn what_only_one_side_shows_needs_that_side() {
    let lessons = lessons();
    let off: Vec<f32> = field().constant_colours().iter().flat_map(|c| c.map(|v| v - 0.5)).collect();
    let problem = Necessity::new(&lessons, MarkableField::rows(field()), off, 1.0, 8);
    let all = problem.solve(|_| true);
    let camera = camera(3.0, 1);
    let view = field().view(&camera, 1e-4, 1);
    let change = |without: std::ops::RangeInclusive<usize>| {
        let solved = problem.solve(|photograph| !without.contains(&photograph));
        let moved: Vec<f32> = solved.iter().zip(&all).map(|(a, b)| a - b).collect();
        let mut shown = vec![0.0; 3 * 40 * 36];
        view.apply_lit(&moved, field().canonical_appearance(), &mut shown);
        (shown.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() / shown.len() as f64).sqrt()
    };
    let (before, one, behind) = (change(1..=5), change(3..=3), change(7..=11));
    assert!(before > 5.0 * one && one > 2.0 * behind, "{before} without all that stand before it, {one}, {behind}");
}
