//! What must not go wrong on bad input: one clear error, never a panic, and the
//! last good state.

use crate::common::{Photo, named};
use crate::common::{
    ball_box, ball_in_the_open, camera, field_of, random_grid, stored_field, stored_with, tiny, views,
};
use cairn_field::grid::lattice::{Grid, ROW};
use cairn_field::{Appearance, AppearanceMode, BaseTrainer, Field, FieldConfig, FieldError};
use cairn_scene::{Mask, Picture};
use glam::DVec3;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use sha2::{Digest, Sha256};
use std::collections::HashMap;

fn start(views: Vec<Photo>) -> Result<BaseTrainer, FieldError> {
    BaseTrainer::new(named(views), ball_box(), None, tiny(20), 1)
}

fn refused(views: Vec<Photo>) -> String {
    start(views).err().expect("an error").to_string()
}

#[test]
fn bad_views_are_refused_by_name() {
    assert!(refused(Vec::new()).contains("none to train on"));
    let mut masked = views(3, 16, 1.0, DVec3::ZERO);
    masked[1].mask = Some(Mask::from_fn(15, 16, |_, _| true).expect("pixels"));
    let text = refused(masked);
    assert!(text.contains("001.png") && text.contains("mask 15 x 16"), "{text}");
    let mut hidden = views(3, 16, 1.0, DVec3::ZERO);
    hidden.iter_mut().for_each(|view| view.mask = Some(Mask::from_fn(16, 16, |_, _| false).expect("pixels")));
    assert!(refused(hidden).contains("no pixel to learn from"));
    let mut other = views(3, 16, 1.0, DVec3::ZERO);
    other[2].picture = Picture::constant(16, 15, [0.5; 3]);
    let text = refused(other);
    assert!(text.contains("002.png") && text.contains("16 x 16") && text.contains("16 x 15"), "{text}");
}

#[test]
fn settings_out_of_range_are_refused_by_key() {
    let sound = FieldConfig::default;
    for (config, key) in [
        (FieldConfig { steps: 0, ..sound() }, "field.steps"),
        (FieldConfig { rays_per_step: 3, ..sound() }, "field.rays_per_step"),
        (FieldConfig { voxels: 7, ..sound() }, "field.voxels"),
        (FieldConfig { levels: 9, ..sound() }, "field.levels"),
        (FieldConfig { voxel_px: 0.1, ..sound() }, "field.voxel_px"),
        (FieldConfig { voxel_px: f64::NAN, ..sound() }, "field.voxel_px"),
        (FieldConfig { max_voxels: 600_000_000, ..sound() }, "field.max_voxels"),
        (FieldConfig { smooth_in_one_light: 0.0, ..sound() }, "field.smooth_in_one_light"),
        (FieldConfig { smooth_in_one_light: 1.5, ..sound() }, "field.smooth_in_one_light"),
        (FieldConfig { learning_rate_density: f64::NAN, ..sound() }, "field.learning_rate_density"),
        (FieldConfig { learning_rate_density: 1e39, ..sound() }, "field.learning_rate_density"),
        (FieldConfig { distortion: -1.0, ..sound() }, "field.distortion"),
        (FieldConfig { prune_weight: 2.0, ..sound() }, "field.prune_weight"),
        (FieldConfig { initial_opacity: 1.0, ..sound() }, "field.initial_opacity"),
    ] {
        let text = config.validate().expect_err("out of range").to_string();
        assert!(text.contains(key) && text.contains("allowed"), "{text}");
    }
    let unknown = serde_json::from_str::<FieldConfig>(r#"{"stepz": 3}"#).expect_err("an unknown key").to_string();
    assert!(unknown.contains("stepz"), "{unknown}");
}

#[test]
fn one_view_and_a_lone_pixel_train() {
    for size in [1, 16] {
        let mut trainer = start(views(1, size, 1.0, DVec3::ZERO)).expect("one view is enough");
        while trainer.steps_done() < trainer.steps_total() {
            assert!(trainer.step().expect("finite numbers").loss.is_finite());
        }
        // After the last step there is nothing more to do.
        assert_eq!(trainer.step().expect("a report").step, 20);
        trainer.finish().to_bytes().expect("a field");
    }
}

#[test]
fn cameras_inside_and_looking_away_render() {
    let look = Appearance::neutral([0.1, 0.2, 0.3]);
    for frame in [ball_box(), ball_in_the_open()] {
        let field = field_of(&frame, &random_grid([12, 12, 12], 1.0, -3.0..0.0, 2), &look);
        let inside = field.render_maps(&camera(DVec3::new(0.1, 0.2, 0.0), DVec3::ONE, 8), &look);
        let away = field.render_maps(&camera(DVec3::new(0.0, 0.0, 3.0), DVec3::new(0.0, 0.5, 9.0), 8), &look);
        for maps in [&inside, &away] {
            assert!(maps.picture.rgb().iter().chain(&maps.accumulation).chain(&maps.depth).all(|v| v.is_finite()));
        }
        assert!(inside.accumulation.iter().all(|a| *a > 0.1));
        if !frame.is_unbounded() {
            assert!(away.accumulation.iter().all(|a| *a == 0.0));
            assert!(crate::common::apart(&away.picture.rgb()[..3], &[0.1, 0.2, 0.3]) < 1e-6, "the background");
        }
    }
}

#[test]
fn walls_and_nothing_are_exact() {
    let look = Appearance::neutral([0.1, 0.2, 0.3]);
    let view = camera(DVec3::new(0.3, 0.1, 3.0), DVec3::ZERO, 8);
    for raw in [100.0f32, 1e4, 1e8, f32::MAX] {
        let mut grid: Grid<f32> = Grid::full([8, 8, 8], f64::from(raw), 0.6);
        grid.set_raw_rows(&vec![raw; grid.rows() - 1]);
        let maps = field_of(&ball_box(), &grid, &look).render_maps(&view, &look);
        let middle = 4 * 8 + 4;
        assert_eq!(maps.accumulation[middle], 1.0, "raw density {raw}");
        assert!(crate::common::apart(&maps.picture.pixel(4, 4), &[0.6; 3]) < 1e-3, "{:?}", maps.picture.pixel(4, 4));
    }
    let nothing = Grid::with_vertices([8, 8, 8], Vec::new());
    let maps = field_of(&ball_box(), &nothing, &look).render_maps(&view, &look);
    assert!(maps.accumulation.iter().all(|a| *a == 0.0) && maps.depth.iter().all(|d| *d == 0.0));
}

#[test]
fn unknown_formats_are_refused_by_name() {
    let look = Appearance::neutral([0.0; 3]);
    let grid = random_grid([4, 5, 6], 0.5, -1.0..0.0, 1);
    let header = |change: &dyn Fn(&mut serde_json::Value)| {
        let mut header = serde_json::json!({
            "format": "cairn.field/3", "frame": ball_box(), "dims": [4, 5, 6], "canonical": look, "appearances": [],
        });
        change(&mut header);
        Field::from_bytes(&stored_with(&header, &grid)).err().map(|e| e.to_string())
    };
    assert_eq!(header(&|_| ()), None);
    let text = header(&|h| h["format"] = "cairn.field/2".into()).expect("an error");
    assert!(text.contains("cairn.field/3") && text.contains("cairn.field/2"), "{text}");
    for dims in [[0u64, 5, 6], [1, 5, 6], [4, 5, 5], [1 << 40, 1 << 40, 1 << 40], [4_000_000_000, 2, 2]] {
        let text = header(&|h| h["dims"] = dims.to_vec().into()).expect("an error");
        assert!(text.contains("field"), "{dims:?}: {text}");
    }
    let text = header(&|h| h["canonical"]["code"] = vec![1.0; 5].into()).expect("an error");
    assert!(text.contains("51 finite") && text.contains("got 5"), "{text}");
}

#[test]
fn damaged_files_are_errors() {
    let look = Appearance::neutral([0.0; 3]);
    let field = stored_field(&ball_box(), &random_grid([4, 5, 6], 0.5, -1.0..0.0, 1), &look);
    let mut trainer = start(views(2, 12, 1.0, DVec3::ZERO)).expect("sound settings");
    trainer.step().expect("finite numbers");
    let checkpoint = trainer.checkpoint().expect("a checkpoint");
    for n in (0..field.len()).step_by(97) {
        assert!(matches!(Field::from_bytes(&field[..n]), Err(FieldError::Stored { .. })), "cut at {n}");
    }
    for n in (0..checkpoint.len()).step_by(checkpoint.len() / 60) {
        let resumed = BaseTrainer::resume(&checkpoint[..n], named(views(2, 12, 1.0, DVec3::ZERO)));
        assert!(matches!(resumed, Err(FieldError::Stored { .. })), "cut at {n}");
    }
    let resumed = BaseTrainer::resume(&checkpoint, named(views(3, 12, 1.0, DVec3::ZERO)));
    assert!(matches!(resumed, Err(FieldError::Views(_))), "other views");
    assert!(matches!(Field::from_bytes(&checkpoint), Err(FieldError::Stored { .. })), "a checkpoint is no field");
    // A flipped byte may go unnoticed in a number, but must never panic.
    for n in (0..field.len()).step_by(7) {
        let mut flipped = field.clone();
        flipped[n] ^= 0x51;
        if let Ok(field) = Field::from_bytes(&flipped) {
            field.render(&camera(DVec3::new(0.3, 0.1, 3.0), DVec3::ZERO, 3), &look);
        }
    }
}

#[test]
fn tensors_of_a_field_that_do_not_go_together_are_refused() {
    let look = Appearance::neutral([0.0; 3]);
    let stored = stored_field(&ball_box(), &random_grid([4, 5, 6], 0.5, -1.0..0.0, 1), &look);
    let (_, metadata) = SafeTensors::read_metadata(&stored).expect("a field");
    let file = SafeTensors::deserialize(&stored).expect("a field");
    let parts = file.tensors();
    // One tensor with some of its numbers missing, or of another kind.
    let with = |name: &str, dtype: Dtype, missing: usize| {
        let tensors = parts.iter().map(|(n, t)| {
            let kept = if n == name { &t.data()[missing..] } else { t.data() };
            let dtype = if n == name { dtype } else { t.dtype() };
            (n.as_str(), TensorView::new(dtype, vec![kept.len() * 8 / dtype.bitsize()], kept).expect("fits"))
        });
        let bytes = safetensors::serialize(tensors, metadata.metadata().clone()).expect("plain tensors");
        Field::from_bytes(&bytes).err().map(|e| e.to_string())
    };
    assert_eq!(with("colour", Dtype::F16, 0), None);
    for (name, dtype, missing) in
        [("colour", Dtype::F16, 54), ("colour", Dtype::F16, 2), ("density", Dtype::F32, 4), ("vertex", Dtype::U32, 4)]
    {
        let text = with(name, dtype, missing).expect("an error");
        assert!(text.contains("of different lengths"), "{name} without {missing} bytes: {text}");
    }
    for (name, dtype) in [("colour", Dtype::BF16), ("density", Dtype::I32), ("vertex", Dtype::F32)] {
        let text = with(name, dtype, 0).expect("an error");
        assert!(text.contains(name) && text.contains(&format!("{dtype:?}")), "{text}");
    }
}

/// A checkpoint with its header or a tensor's f32 changed.
fn altered(bytes: &[u8], change: impl Fn(&mut serde_json::Value), tensor: &str, fill: Option<f32>) -> Vec<u8> {
    let (_, metadata) = SafeTensors::read_metadata(bytes).expect("a checkpoint");
    let text = &metadata.metadata().as_ref().expect("a header")["cairn"];
    let mut header: serde_json::Value = serde_json::from_str(text).expect("a header");
    change(&mut header);
    let file = SafeTensors::deserialize(bytes).expect("a checkpoint");
    let data: Vec<(String, safetensors::Dtype, Vec<usize>, Vec<u8>)> = file
        .tensors()
        .into_iter()
        .map(|(name, t)| {
            let mut data = t.data().to_vec();
            if let (true, Some(v)) = (name == tensor, fill) {
                // Row 0 is nobody's; the rest gets the number.
                let first = if name == "colour" { ROW * 4 } else { 4 };
                data[first..].chunks_exact_mut(4).for_each(|b| b.copy_from_slice(&v.to_le_bytes()));
            }
            (name, t.dtype(), t.shape().to_vec(), data)
        })
        .collect();
    let views = data.iter().map(|(n, t, s, d)| (n.as_str(), TensorView::new(*t, s.clone(), d).expect("as before")));
    sealed(&safetensors::serialize(views, Some(metadata_of(&header))).expect("plain tensors"))
}

fn metadata_of(header: &serde_json::Value) -> HashMap<String, String> {
    HashMap::from([("cairn".to_owned(), header.to_string())])
}

/// A checkpoint that says the SHA-256 it has: a forger would see to that. Each part
/// comes with its name's and its own length; first the header without its digest.
fn sealed(bytes: &[u8]) -> Vec<u8> {
    let (_, metadata) = SafeTensors::read_metadata(bytes).expect("a checkpoint");
    let text = &metadata.metadata().as_ref().expect("a header")["cairn"];
    let mut header: serde_json::Value = serde_json::from_str(text).expect("a header");
    header["digest"] = "".into();
    let file = SafeTensors::deserialize(bytes).expect("a checkpoint");
    let mut tensors = file.tensors();
    tensors.sort_by(|a, b| a.0.cmp(&b.0));
    let mut all = Vec::new();
    let mut put = |name: &str, data: &[u8]| {
        all.extend((name.len() as u64).to_le_bytes());
        all.extend(name.as_bytes());
        all.extend((data.len() as u64).to_le_bytes());
        all.extend(data);
    };
    put("", header.to_string().as_bytes());
    tensors.iter().for_each(|(name, tensor)| put(name, tensor.data()));
    let digest: Vec<String> = Sha256::digest(&all).iter().map(|b| format!("{b:02x}")).collect();
    header["digest"] = digest.concat().into();
    safetensors::serialize(tensors, Some(metadata_of(&header))).expect("plain tensors")
}

/// A file with one tensor's bytes replaced.
fn with_tensor(bytes: &[u8], name: &str, data: &[u8]) -> Vec<u8> {
    let (_, metadata) = SafeTensors::read_metadata(bytes).expect("a checkpoint");
    let file = SafeTensors::deserialize(bytes).expect("a checkpoint");
    let views: Vec<_> = file
        .tensors()
        .into_iter()
        .map(|(n, t)| {
            let data = if n == name { data } else { t.data() };
            (n, TensorView::new(t.dtype(), t.shape().to_vec(), data).expect("as before"))
        })
        .collect();
    sealed(&safetensors::serialize(views, metadata.metadata().clone()).expect("plain tensors"))
}

#[test]
fn checkpoints_that_do_not_fit_are_refused() {
    let mut trainer = start(views(2, 12, 1.0, DVec3::ZERO)).expect("sound settings");
    trainer.step().expect("finite numbers");
    let bytes = trainer.checkpoint().expect("a checkpoint");
    let resume =
        |bytes: &[u8]| BaseTrainer::resume(bytes, named(views(2, 12, 1.0, DVec3::ZERO))).err().map(|e| e.to_string());
    assert_eq!(resume(&altered(&bytes, |_| (), "", None)), None);
    let text =
        resume(&altered(&bytes, |h| h["format"] = "cairn.field.checkpoint/11".into(), "", None)).expect("an error");
    assert!(text.contains("checkpoint/11"), "{text}");
    // An older one has another header, too.
    let older = |h: &mut serde_json::Value| {
        h["format"] = "cairn.field.checkpoint/6".into();
        h.as_object_mut().expect("a header").remove("averaged");
    };
    let text = resume(&altered(&bytes, older, "", None)).expect("an error");
    assert!(text.contains("checkpoint/6") && text.contains("train the scene again"), "{text}");
    for dims in [[0u64, 0, 0], [4, 4, 4], [1 << 40, 1 << 40, 1 << 40], [1 << 30, 2, 2]] {
        assert!(resume(&altered(&bytes, |h| h["dims"] = dims.to_vec().into(), "", None)).is_some(), "{dims:?}");
    }
    assert!(resume(&altered(&bytes, |h| h["level"] = 7.into(), "", None)).is_some(), "a level beyond the last");
    assert!(
        resume(&altered(&bytes, |h| h["config"]["steps"] = 0.into(), "", None)).is_some(),
        "a setting out of range"
    );
    assert!(resume(&altered(&bytes, |h| h["appearances"] = 1.into(), "", None)).is_some(), "an appearance too few");
    let settled = altered(&bytes, |h| h["light"] = "settled".into(), "", None);
    assert!(resume(&settled).expect("an error").contains("light"), "these settings leave it to be found out");
    let config = FieldConfig { appearance: AppearanceMode::Off, ..tiny(20) };
    let off =
        BaseTrainer::new(named(views(2, 12, 1.0, DVec3::ZERO)), ball_box(), None, config, 1).expect("sound settings");
    let bytes_of_off = off.checkpoint().expect("a checkpoint");
    assert_eq!(resume(&bytes_of_off), None);
    let open = altered(&bytes_of_off, |h| h["light"] = "open".into(), "", None);
    assert!(resume(&open).expect("an error").contains("light"), "these settle it");
    for key in ["step", "adam_steps", "appearance_steps", "drawn"] {
        let text = resume(&altered(&bytes, |h| h[key] = u64::MAX.into(), "", None)).expect("an error");
        assert!(text.contains("steps"), "{key}: {text}");
    }
    let mut late = start(views(2, 12, 1.0, DVec3::ZERO)).expect("sound settings");
    while late.steps_done() < late.steps_total() {
        late.step().expect("finite numbers");
    }
    let late = late.checkpoint().expect("a checkpoint");
    for name in ["mean_raw", "mean_colour", "mean_codes"] {
        let text = resume(&altered(&late, |_| (), name, Some(f32::NAN))).expect("an error");
        assert!(text.contains(name) && text.contains("finite"), "{text}");
    }
    let text = resume(&altered(&late, |h| h["averaged"] = 9.into(), "", None)).expect("an error");
    assert!(text.contains("mean of more states"), "{text}");
    let text = resume(&altered(&bytes, |h| h["averaged"] = 1.into(), "", None)).expect("an error");
    assert!(text.contains("mean_raw"), "a mean of one state has numbers: {text}");
    for name in ["raw", "colour", "first", "second", "square", "seen"] {
        let text = resume(&altered(&bytes, |_| (), name, Some(f32::NAN))).expect("an error");
        assert!(text.contains(name) && text.contains("finite"), "{text}");
    }
}

/// Steps to the end and gives the field's bytes.
fn end(mut trainer: BaseTrainer) -> Vec<u8> {
    while trainer.steps_done() < trainer.steps_total() {
        trainer.step().expect("finite numbers");
    }
    trainer.finish().to_bytes().expect("a field")
}

/// A training of two small views after three steps, as bytes.
fn begun() -> Vec<u8> {
    let mut trainer = start(views(2, 12, 1.0, DVec3::ZERO)).expect("sound settings");
    (0..3).for_each(|_| {
        trainer.step().expect("finite numbers");
    });
    trainer.checkpoint().expect("a checkpoint")
}

fn resume(bytes: &[u8]) -> BaseTrainer {
    BaseTrainer::resume(bytes, named(views(2, 12, 1.0, DVec3::ZERO))).expect("finite numbers")
}

/// The bytes of one tensor of a checkpoint.
fn tensor(bytes: &[u8], name: &str) -> Vec<u8> {
    SafeTensors::deserialize(bytes).expect("a checkpoint").tensor(name).expect("a tensor").data().to_vec()
}

#[test]
fn a_state_that_is_not_finite_is_no_checkpoint() {
    // Two steps of this size leave what single precision holds.
    let config = FieldConfig { learning_rate_density: 3e38, ..tiny(20) };
    let mut trainer =
        BaseTrainer::new(named(views(2, 12, 1.0, DVec3::ZERO)), ball_box(), None, config, 1).expect("settings");
    assert!(trainer.checkpoint().is_ok());
    let refused = (0..9).find_map(|_| {
        let failed = trainer.step().err();
        assert!(failed.iter().all(|error| matches!(error, FieldError::NotFinite { .. })), "{failed:?}");
        trainer.checkpoint().err()
    });
    let refused = refused.map(|error| error.to_string()).unwrap_or_default();
    assert!(refused.contains("not finite") && refused.contains('`'), "{refused:?}");
}

#[test]
fn a_poisoned_step_is_not_taken() {
    let bytes = begun();
    let undisturbed = end(resume(&bytes));
    // Squares overflow at the first; the last leave a loss, and gradients beyond all measure.
    let mut places = Vec::new();
    for poison in [3e38f32, 1e20, 1e17, 1e15] {
        let poisoned = altered(&bytes, |_| (), "colour", Some(poison));
        let mut trainer = resume(&poisoned);
        let before = trainer.checkpoint().expect("a checkpoint");
        for _ in 0..2 {
            match trainer.step() {
                Err(FieldError::NotFinite { step: 3, place }) => places.push(place),
                other => panic!("colours of {poison}: {other:?}"),
            }
            assert!(trainer.checkpoint().expect("a checkpoint") == before, "{poison}: the state is as before");
        }
        // With the poison taken out of what it left, nothing has happened.
        let after = trainer.checkpoint().expect("a checkpoint");
        for name in SafeTensors::deserialize(&bytes).expect("a checkpoint").names().iter().filter(|n| **n != "colour") {
            assert!(tensor(&after, name) == tensor(&bytes, name), "{poison}: {name}");
        }
        let healed = with_tensor(&after, "colour", &tensor(&bytes, "colour"));
        assert!(end(resume(&healed)) == undisturbed, "{poison}: training goes on as if there had been none");
    }
    assert!(places[0] == "the loss" && places.iter().any(|p| p.contains("gradient")), "{places:?}");
}

#[test]
fn a_step_refused_when_something_is_due_changes_nothing() {
    // The look at the light (step 5 of 20), the coarse level's half (4) and end (8), the
    // fine one's half (14).
    for at in 1..20 {
        let mut trainer = start(views(2, 12, 1.0, DVec3::ZERO)).expect("sound settings");
        (0..at).for_each(|_| {
            trainer.step().expect("finite numbers");
        });
        let bytes = trainer.checkpoint().expect("a checkpoint");
        let undisturbed = end(trainer);
        let mut trainer = resume(&altered(&bytes, |_| (), "colour", Some(3e38)));
        let before = trainer.checkpoint().expect("a checkpoint");
        for _ in 0..2 {
            assert!(matches!(trainer.step(), Err(FieldError::NotFinite { .. })), "step {at}");
            assert!(trainer.checkpoint().expect("a checkpoint") == before, "step {at}: the state is as before");
        }
        let healed = with_tensor(&before, "colour", &tensor(&bytes, "colour"));
        assert!(end(resume(&healed)) == undisturbed, "step {at}: training goes on as if there had been none");
    }
}

#[test]
fn numbers_of_any_size_are_refused_or_survived() {
    let bytes = begun();
    for name in ["colour", "raw"] {
        for power in (-38..=38).step_by(2).chain([17, 19, 21]) {
            for sign in [1.0f32, -1.0] {
                let poison = sign * 10f32.powi(power);
                let mut trainer = resume(&altered(&bytes, |_| (), name, Some(poison)));
                let mut before = trainer.checkpoint().expect("a checkpoint");
                for _ in 0..3 {
                    let outcome = trainer.step();
                    let after = trainer.checkpoint().expect("a checkpoint");
                    match outcome {
                        Ok(stats) => {
                            assert!(stats.loss.is_finite());
                            let read = BaseTrainer::resume(&after, named(views(2, 12, 1.0, DVec3::ZERO))).err();
                            assert!(read.is_none(), "{name} of {poison}: {}", read.expect("an error"));
                        }
                        Err(FieldError::NotFinite { .. }) => {
                            assert!(after == before, "{name} of {poison}: the state is as before");
                        }
                        Err(other) => panic!("{name} of {poison}: {other}"),
                    }
                    before = after;
                }
            }
        }
    }
}
