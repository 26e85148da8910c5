//! A capture's unit and origin are its own affair: microns, megametres and a
//! place a million units off give the same picture. And it is the right one. Where
//! numbers cannot say any more where the cameras were, the capture is refused.

use crate::common::named;
use crate::common::{camera, capture, facing, photograph, photographs, ring, rms, tiny};
use cairn_field::{BaseTrainer, SceneFrame};
use cairn_scene::{Camera, Capture, Picture, SceneKind};
use glam::DVec3;

const NEW: DVec3 = DVec3::new(1.1, 1.6, 3.4);

/// Cameras around the ball of radius `unit` around `at`, and their capture.
fn scene(kind: SceneKind, unit: f64, at: DVec3) -> (Vec<Camera>, Capture) {
    let ahead = kind == SceneKind::ForwardFacing;
    let cameras = if ahead { facing(10, 32, unit, at) } else { ring(10, 32, unit, at) };
    (cameras.clone(), capture(kind, cameras, unit, at))
}

/// Trains on the ball of radius `unit` around `at` and renders a new view of it. Photographs are taken where the
/// cameras really stood: at the origin, where numbers are fine, whatever `unit` and `at` make of them in the file.
fn picture(kind: SceneKind, unit: f64, at: DVec3) -> (Picture, Picture) {
    let (cameras, capture) = scene(kind, unit, at);
    let mut views = photographs(&scene(kind, 1.0, DVec3::ZERO).0, 1.0, DVec3::ZERO);
    views.iter_mut().zip(cameras).for_each(|(view, camera)| view.camera = camera);
    let frame = SceneFrame::from_capture(&capture).expect("a box");
    let mut trainer = BaseTrainer::new(named(views), frame, None, tiny(80), 5).expect("sound settings");
    while trainer.steps_done() < trainer.steps_total() {
        trainer.step().expect("finite numbers");
    }
    let field = trainer.finish();
    let place = if kind == SceneKind::ForwardFacing { DVec3::new(0.2, -0.3, -4.0) } else { NEW };
    let [given, real] = [(unit, at), (1.0, DVec3::ZERO)].map(|(unit, at)| camera(at + place * unit, at, 32));
    (field.render(&given, field.canonical_appearance()).clamped(), photograph(&real, 1.0, DVec3::ZERO))
}

const KINDS: [SceneKind; 3] = [SceneKind::Bounded, SceneKind::Unbounded, SceneKind::ForwardFacing];
/// A million units and more from the origin along each axis.
const FAR: DVec3 = DVec3::new(1e6, -2e6, 3e6);

#[test]
fn scale_and_place_do_not_matter() {
    for kind in KINDS {
        let (plain, truth) = picture(kind, 1.0, DVec3::ZERO);
        let db = -20.0 * rms(plain.rgb(), truth.rgb()).log10();
        assert!(db > 20.0, "{kind:?}: a new view of the ball is {db:.2} dB right");
        // Training multiplies the last bits' differences; 80 steps of it came to 1.3e-6. What is small and far has lost
        // more than bits: its cameras are some ten-thousandths of it off, and its pictures half an 8-bit level.
        for (unit, at, most) in
            [(1e-6, DVec3::ZERO, 1e-4), (1e6, DVec3::ZERO, 1e-4), (1.0, FAR, 1e-4), (1e6, FAR, 1e-4), (1e-6, FAR, 4e-3)]
        {
            let (other, _) = picture(kind, unit, at);
            let off = rms(plain.rgb(), other.rgb());
            assert!(off < most, "{kind:?}, unit {unit}, at {at}: {off}");
        }
    }
}

#[test]
fn what_is_too_far_for_its_size_is_refused_with_the_remedy() {
    for kind in KINDS {
        for (unit, at) in [(1e-6, 8.0 * FAR), (1e-9, FAR), (1.0, 1e9 * FAR)] {
            let error = SceneFrame::from_capture(&scene(kind, unit, at).1).expect_err("too coarse").to_string();
            assert!(error.contains("from the origin") && error.contains("Subtract"), "{kind:?}, {unit}, {at}: {error}");
        }
        // One in metres at the earth's surface, from its middle, is far from that.
        SceneFrame::from_capture(&scene(kind, 1.0, DVec3::splat(6.4e6)).1).expect("fine enough");
    }
}
