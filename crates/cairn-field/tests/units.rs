//! A capture's unit and origin are its own affair: microns, megametres and a
//! place a million units off give the same picture. And it is the right one.

mod common;

use cairn_capture::{Picture, SceneKind};
use cairn_field::{BaseTrainer, SceneFrame};
use common::{camera, capture, facing, photograph, photographs, ring, rms, tiny};
use glam::DVec3;

const NEW: DVec3 = DVec3::new(1.1, 1.6, 3.4);

/// Trains on the ball of radius `unit` around `at` and renders a new view of it.
fn picture(kind: SceneKind, unit: f64, at: DVec3) -> (Picture, Picture) {
    let ahead = kind == SceneKind::ForwardFacing;
    let cameras = if ahead { facing(10, 32, unit, at) } else { ring(10, 32, unit, at) };
    let views = photographs(&cameras, unit, at);
    let frame = SceneFrame::from_capture(&capture(kind, cameras, unit, at)).expect("a box");
    let mut trainer = BaseTrainer::new(views, frame, None, tiny(80), 5).expect("sound settings");
    while trainer.steps_done() < trainer.steps_total() {
        trainer.step().expect("finite numbers");
    }
    let field = trainer.finish();
    let place = if ahead { DVec3::new(0.2, -0.3, -4.0) } else { NEW };
    let camera = camera(at + place * unit, at, 32);
    (field.render(&camera, field.canonical_appearance()).clamped(), photograph(&camera, unit, at))
}

#[test]
fn scale_and_place_do_not_matter() {
    for kind in [SceneKind::Bounded, SceneKind::Unbounded, SceneKind::ForwardFacing] {
        let (plain, truth) = picture(kind, 1.0, DVec3::ZERO);
        let db = -20.0 * rms(plain.rgb(), truth.rgb()).log10();
        assert!(db > 20.0, "{kind:?}: a new view of the ball is {db:.2} dB right");
        let far = DVec3::new(1.0, -2.0, 3.0) * 1e6;
        for (unit, at) in [(1e-6, DVec3::ZERO), (1e6, DVec3::ZERO), (1.0, far), (1e6, far)] {
            // Training multiplies the last bits' differences; 80 steps of it stay
            // far below what an 8-bit picture shows.
            let (other, _) = picture(kind, unit, at);
            let off = rms(plain.rgb(), other.rgb());
            assert!(off < 2e-3, "{kind:?}, unit {unit}, at {at}: {off}");
        }
    }
}
