//! Basis lights: what they owe, that every way of rendering knows them, and what they are worth where the sun
//! comes from another side in every photograph.

use crate::common::{
    Numbers, apart, ball_box, ball_in_the_open, camera, random_appearance, random_grid, ring, rms, stored_with, tiny,
};
use cairn_field::appearance::{CODE, FEATURES, features};
use cairn_field::composite::{Regularise, Thresholds, gather, push_back, see};
use cairn_field::grid::{Grid, ROW};
use cairn_field::lights::{Colours, LIGHTS};
use cairn_field::marched::{CHANGE, MarchedView};
use cairn_field::operator::{CarrierBasis, MarkableField};
use cairn_field::patch::Patch;
use cairn_field::rays::Lens;
use cairn_field::sh::{SH, basis};
use cairn_field::{Appearance, AppearanceMode, BaseTrainer, Field, FieldConfig, FieldError, SceneFrame, TrainingView};
use cairn_scene::{Camera, Picture};
use glam::DVec3;
use std::sync::Arc;

/// A field whose last coefficients are basis lights'.
fn lit(frame: &SceneFrame, grid: &Grid<f32>, canonical: &Appearance) -> Field {
    let header = serde_json::json!({
        "format": cairn_field::LIT_FIELD_FORMAT, "frame": frame, "dims": grid.dims, "colours": "lit",
        "canonical": canonical, "appearances": [],
    });
    Field::from_bytes(&stored_with(&header, grid)).expect("a sound field")
}

/// `of` under other lights.
fn under(of: &Appearance, lights: [f32; LIGHTS]) -> Appearance {
    let mut code = of.code().to_vec();
    code[3 * FEATURES..].copy_from_slice(&lights);
    Appearance::from_code(code).expect("finite numbers")
}

fn from_the_side() -> Camera {
    camera(DVec3::new(-3.0, 0.7, 2.0), DVec3::ZERO, 24)
}

#[test]
fn what_lights_owe_is_the_slope_of_the_loss() {
    let grid: Grid<f64> = random_grid([6, 5, 7], 0.8, (-4.5, -1.5), 11);
    let target = [0.2, 0.9, 0.4];
    for frame in [ball_box(), ball_in_the_open()] {
        let origin = DVec3::new(-3.0, 0.7, 2.0);
        let d = (DVec3::new(0.3, -0.2, 0.1) - origin).normalize();
        let (path, harmonics) = (frame.path(origin, d), basis(d.to_array()));
        // Loss and what is owed, of a tile of one ray.
        let tell = |look: &Appearance| {
            let (mut tape, mut patch) = (Vec::new(), Patch::default());
            patch.begin(Colours::Lit.weights(&harmonics, &look.lights()));
            let gathered = gather(&grid, &mut patch, &path, 0.37, Thresholds::EXACT, &mut tape);
            let shade = look.shade(&features(&gathered, &harmonics));
            let off: [f64; 3] = std::array::from_fn(|c| shade[c] - target[c]);
            let slope = look.pull(off.map(|v| 2.0 * v), &harmonics);
            push_back(&mut patch, &tape, gathered.end, &slope, &Regularise::default());
            (off.iter().map(|v| v * v).sum::<f64>(), patch.owed_lights(&grid))
        };
        let look = random_appearance(9);
        let (_, found) = tell(&look);
        // A power of two, so that f32 takes the step exactly.
        let h = 2.0f32.powi(-12);
        for k in 0..LIGHTS {
            let at = |step: f32| {
                let mut lights = look.lights();
                lights[k] += step;
                (tell(&under(&look, lights)).0, f64::from(lights[k] - look.lights()[k]))
            };
            let ((up, a), (down, b)) = (at(h), at(-h));
            let expected = (up - down) / (a - b);
            assert!((found[k] - expected).abs() < 1e-6 * (1.0 + expected.abs()), "{k}: {} for {expected}", found[k]);
            assert!(expected.abs() > 1e-4, "light {k} shows");
        }
    }
}

#[test]
fn every_way_of_rendering_knows_the_lights() {
    let grid: Grid<f32> = random_grid([16, 14, 18], 0.7, (-5.0, 0.0), 31);
    for frame in [ball_box(), ball_in_the_open()] {
        let (field, camera) = (lit(&frame, &grid, &random_appearance(6)), from_the_side());
        let look = under(&random_appearance(12), [0.5, -0.3, 0.2, 0.4, -0.6]);
        let (lens, mut tape) = (Lens::new(&camera), Vec::new());
        let pixel = |at| {
            let (path, harmonics) = lens.ray(&camera, &frame, at);
            let weights = Colours::Lit.weights(&harmonics, &look.lights());
            let gathered = see(field.grid(), &path, &weights, Thresholds::SHOWN, &mut tape);
            look.shade(&features(&gathered, &harmonics))
        };
        let alone: Vec<f32> = (0..lens.pixels()).flat_map(pixel).collect();
        let shown = field.render(&camera, &look);
        assert!(apart(shown.rgb(), &alone) < 0.05 / 255.0, "{frame:?}: {}", apart(shown.rgb(), &alone));
        let dark = field.render(&camera, &under(&look, [0.0; LIGHTS]));
        assert!(apart(shown.rgb(), dark.rgb()) > 0.05, "lights show");
        let maps = field.render_maps(&camera, &look);
        assert_eq!(maps.picture.rgb(), shown.rgb());
        let linear = field.view(&camera, 0.0, 1);
        assert!(
            apart(&linear.base(&look), shown.rgb()) < 1e-5,
            "ray weights: {}",
            apart(&linear.base(&look), shown.rgb())
        );
        let fine = camera.resized(72, 72);
        let mean = cairn_scene::AreaFilter::new([72, 72], [24, 24]).apply(field.render(&fine, &look).rgb());
        let several = field.view(&camera, 0.0, 3).base(&look);
        assert!(apart(&several, &mean) < 1e-4, "several rays a pixel: {}", apart(&several, &mean));
        let marched = MarchedView::new(&camera, 1).render(&field, &look);
        assert!(apart(&marched, shown.rgb()) < 1e-5, "marched");
        let again = Field::from_bytes(&field.to_bytes().expect("bytes")).expect("a sound field");
        assert_eq!(again.render(&camera, &look).rgb(), shown.rgb(), "stored and read");
    }
}

/// The paper's carrier goes over the field's own coefficients, whatever they stand for.
#[test]
fn a_carrier_of_nine_coefficients_is_lit_as_the_field_is() {
    let grid: Grid<f32> = random_grid([16, 14, 18], 0.7, (-5.0, 0.0), 31);
    let before = lit(&ball_in_the_open(), &grid, &random_appearance(6));
    let mut numbers = Numbers(77);
    let mut changed = grid.clone();
    for row in 1..grid.rows() {
        for v in &mut changed.colour[row * ROW..][..3 * SH] {
            *v += numbers.within(-0.5, 0.5) as f32;
        }
    }
    let after = lit(&ball_in_the_open(), &changed, &random_appearance(6));
    let mut carrier = vec![0.0; grid.rows() * 3 * SH];
    for (i, v) in carrier.iter_mut().enumerate().skip(3 * SH) {
        let (row, c, k) = (i / (3 * SH), i / SH % 3, i % SH);
        let at = row * ROW + 3 * k + c;
        *v = after.grid().colour[at] - before.grid().colour[at];
    }
    let look = under(&random_appearance(12), [0.5, -0.3, 0.2, 0.4, -0.6]);
    let camera = from_the_side();
    let expected = after.render(&camera, &look);
    let drawn = before.render_with(&camera, &look, &carrier, CarrierBasis::Harmonics);
    assert!(apart(drawn.rgb(), expected.rgb()) < 1e-3, "{}", apart(drawn.rgb(), expected.rgb()));
    let linear = before.view(&camera, 0.0, 1);
    let mut picture = linear.base(&look);
    linear.apply(&carrier, CarrierBasis::Harmonics, &look, &mut picture);
    assert!(apart(&picture, drawn.rgb()) < 2e-5, "{}", apart(&picture, drawn.rgb()));
    let y: Vec<f32> = picture.iter().map(|_| numbers.within(-1.0, 1.0) as f32).collect();
    let (mut ax, mut aty) = (vec![0.0; y.len()], vec![0.0; carrier.len()]);
    linear.apply(&carrier, CarrierBasis::Harmonics, &look, &mut ax);
    linear.push_back(&y, CarrierBasis::Harmonics, &look, &mut aty, &mut vec![false; grid.rows()]);
    let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
    assert!((dot(&ax, &y) - dot(&carrier, &aty)).abs() < 1e-6 * dot(&ax, &ax).sqrt() * dot(&y, &y).sqrt());
}

#[test]
fn the_lights_of_half_a_photograph_are_found() {
    let grid: Grid<f32> = random_grid([16, 14, 18], 0.7, (-5.0, 0.0), 31);
    let truth = under(&Appearance::neutral([0.3; 3]), [0.3, -0.2, 0.1, 0.2, -0.25]);
    let field = lit(&ball_box(), &grid, &Appearance::neutral([0.3; 3]));
    let camera = camera(DVec3::new(-3.0, 0.7, 2.0), DVec3::ZERO, 64);
    let photograph = field.render(&camera, &truth);
    let found = field.fit_appearance_left_half(&camera, &photograph).expect("a sound photograph");
    let off: f32 = found.lights().iter().zip(truth.lights()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(off < 0.05, "{:?}", found.lights());
    assert!(rms(field.render(&camera, &found).rgb(), photograph.rgb()) < 0.01);
    // A whole one tells more.
    let whole = field.fit_appearance(&camera, &photograph).expect("a sound photograph");
    assert_ne!(whole, found);
    assert!(rms(field.render(&camera, &whole).rgb(), photograph.rgb()) < 0.01);
    let mut rgb = photograph.rgb().to_vec();
    rgb[5] = f32::NAN;
    let bad = Picture::new(64, 64, rgb).expect("three numbers a pixel");
    assert!(matches!(field.fit_appearance_left_half(&camera, &bad), Err(FieldError::Views(_))));
}

#[test]
fn a_field_without_lights_is_stored_as_it_always_was() {
    let grid: Grid<f32> = random_grid([12; 3], 0.6, (-6.0, 0.0), 7);
    let plain = crate::common::field_of(&ball_box(), &grid, &Appearance::neutral([0.3, 0.5, 0.7]));
    let told = |field: &Field| {
        let bytes = field.to_bytes().expect("bytes");
        let (_, metadata) = safetensors::SafeTensors::read_metadata(&bytes).expect("safetensors");
        let json = metadata.metadata().as_ref().expect("a header")["cairn"].clone();
        serde_json::from_str::<serde_json::Value>(&json).expect("JSON")
    };
    let header = told(&plain);
    assert_eq!(header["format"], "cairn.field/3");
    assert!(header.get("colours").is_none());
    assert_eq!(header["canonical"]["code"].as_array().expect("a code").len(), 3 * FEATURES);
    let header = told(&lit(&ball_box(), &grid, &random_appearance(6)));
    assert_eq!((&header["format"], &header["colours"]), (&"cairn.field/4".into(), &"lit".into()));
    assert_eq!(header["canonical"]["code"].as_array().expect("a code").len(), CODE);
}

/// Densities and colours of a lit field, walked back as they are marched.
#[test]
fn a_marched_view_walks_back_under_the_lights() {
    let grid: Grid<f32> = random_grid([10, 9, 11], 0.8, (-4.5, -1.5), 31);
    let field = lit(&ball_box(), &grid, &random_appearance(6));
    let look = under(&random_appearance(12), [0.5, -0.3, 0.2, 0.4, -0.6]);
    let view = MarchedView::new(&camera(DVec3::new(-3.0, 0.7, 2.0), DVec3::ZERO, 16), 1);
    let mut numbers = Numbers(4);
    let slope: Vec<f32> = (0..16 * 16 * 3).map(|_| numbers.within(-1.0, 1.0) as f32).collect();
    let (mut gradient, mut touched) = (vec![0.0; grid.rows() * CHANGE], vec![false; grid.rows()]);
    view.push_back(&field, &slope, &look, &mut gradient, &mut touched);
    // The coefficients of basis lights alone.
    let lights = |(i, v): (usize, &f32)| if i % CHANGE < 3 * SH && i % CHANGE % SH >= SH - LIGHTS { *v } else { 0.0 };
    let along: Vec<f32> = gradient.iter().enumerate().map(lights).collect();
    let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
    let step = 0.02 / along.iter().fold(0.0f32, |m, v| m.max(v.abs()));
    let loss = |sign: f32| {
        let moved: Vec<f32> = along.iter().map(|v| sign * step * v).collect();
        dot(&slope, &view.render(&field.changed_by(&moved), &look))
    };
    let expected = (loss(1.0) - loss(-1.0)) / (2.0 * f64::from(step));
    let square = dot(&along, &along);
    assert!(square > 0.05 && (square / expected - 1.0).abs() < 0.02, "{square} for {expected}");
}

/// The ball under a sun that stands elsewhere for each camera.
fn under_suns(cameras: &[Camera], seed: u64) -> Vec<TrainingView> {
    let mut numbers = Numbers(seed);
    let shaded = |(i, camera): (usize, &Camera)| {
        let (around, up) = (numbers.within(0.0, std::f64::consts::TAU), numbers.within(0.2, 0.9f64));
        let sun = DVec3::new(around.cos() * up.cos(), up.sin(), around.sin() * up.cos());
        let (w, plain) = (camera.intrinsics.width, crate::common::photograph(camera, 1.0, DVec3::ZERO));
        let mut rgb = plain.rgb().to_vec();
        for (at, pixel) in rgb.chunks_exact_mut(3).enumerate() {
            let (o, d) = camera.ray((at % w) as f64 + 0.5, (at / w) as f64 + 0.5);
            let nearest = -o.dot(d);
            let off = 1.0 - (o + d * nearest).length_squared();
            if off > 0.0 {
                let n = o + d * (nearest - off.sqrt());
                let light = 0.35 + 0.65 * n.dot(sun).max(0.0);
                pixel.iter_mut().for_each(|v| *v *= light as f32);
            }
        }
        let picture = Arc::new(Picture::new(w, camera.intrinsics.height, rgb).expect("three numbers a pixel"));
        TrainingView { name: format!("{i:03}.png"), contributor: "ada".into(), camera: *camera, picture }
    };
    cameras.iter().enumerate().map(shaded).collect()
}

/// RMS error of the photographs in their own light, and of the right halves of others in that of their left halves.
fn errors(basis_lights: bool, seed: u64) -> (f64, f64) {
    let all = under_suns(&ring(36, 32, 1.0, DVec3::ZERO), seed);
    let (held, learnt): (Vec<_>, Vec<_>) = all.into_iter().enumerate().partition(|(i, _)| i % 6 == 3);
    let learnt: Vec<TrainingView> = learnt.into_iter().map(|(_, view)| view).collect();
    let config = FieldConfig { basis_lights, ..tiny(1200) };
    let mut trainer =
        BaseTrainer::new(learnt.clone(), ball_box(), Some([0.5; 3]), config, seed).expect("sound settings");
    while trainer.steps_done() < trainer.steps_total() {
        trainer.step().expect("finite numbers");
    }
    let field = trainer.finish();
    let right = |picture: &Picture| -> Vec<f32> {
        picture
            .rgb()
            .chunks_exact(3)
            .enumerate()
            .filter(|(at, _)| at % 32 >= 16)
            .flat_map(|(_, v)| v.to_vec())
            .collect()
    };
    let mean = |errors: Vec<f64>| (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
    let own = |v: &TrainingView| rms(field.render(&v.camera, field.appearance_of(&v.name)).rgb(), v.picture.rgb());
    let other = |v: &TrainingView| {
        let look = field.fit_appearance_left_half(&v.camera, &v.picture).expect("a sound photograph");
        rms(&right(&field.render(&v.camera, &look)), &right(&v.picture))
    };
    (mean(learnt.iter().map(own).collect()), mean(held.iter().map(|(_, v)| other(v)).collect()))
}

#[test]
fn suns_from_all_sides_need_basis_lights() {
    for seed in 1..=3 {
        let (with, without) = (errors(true, seed), errors(false, seed));
        println!("seed {seed}: {with:?} with basis lights, {without:?} without");
        assert!(with.0 < 0.8 * without.0 && with.1 < 0.9 * without.1, "seed {seed}: {with:?} for {without:?}");
    }
}

#[test]
fn few_views_keep_their_harmonics() {
    // Five views differ in four ways at most.
    let learnt = under_suns(&ring(5, 24, 1.0, DVec3::ZERO), 1);
    let config = FieldConfig { basis_lights: true, appearance: AppearanceMode::On, ..tiny(60) };
    let mut trainer = BaseTrainer::new(learnt, ball_box(), None, config, 1).expect("sound settings");
    while trainer.steps_done() < trainer.steps_total() {
        trainer.step().expect("finite numbers");
    }
    assert!(trainer.has_appearance() && !trainer.has_basis_lights());
}

#[test]
fn lights_begin_and_go_on_the_same_however_often_training_stops() {
    let learnt = || under_suns(&ring(8, 24, 1.0, DVec3::ZERO), 1);
    let config = FieldConfig { basis_lights: true, appearance: AppearanceMode::On, ..tiny(60) };
    let trained = |threads: usize, stops: bool| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| {
            let mut trainer =
                BaseTrainer::new(learnt(), ball_in_the_open(), None, config.clone(), 3).expect("sound settings");
            let mut begun = Vec::new();
            for _ in 0..config.steps {
                if stops {
                    let bytes = trainer.checkpoint().expect("a checkpoint");
                    trainer = BaseTrainer::resume(&bytes, learnt()).expect("a sound checkpoint");
                }
                begun.push(trainer.has_basis_lights());
                trainer.step().expect("finite numbers");
            }
            assert!(!begun[0] && begun[59], "they begin on the way");
            trainer.finish().to_bytes().expect("a field")
        })
    };
    let expected = trained(1, false);
    assert!(trained(3, false) == expected, "three threads");
    assert!(trained(2, true) == expected, "stopped before every step");
}
