//! The settings that captures are trained with: the product's preset for the kind of the scene.

use cairn_scene::SceneKind;
use cairn_service::config::preset::settings;
use cairn_service::config::{Chosen, Quality, TrainingSettings};

/// Pictures' longest side of a quick run, px.
pub const QUICK_SIDE_PX: usize = 64;

/// Settings of both stages for scenes of this `kind`. A `quick` run ends within seconds: everything runs, nothing is good.
/// With `robust`, marks outlast distortions.
pub fn of(kind: SceneKind, quick: bool, robust: bool) -> TrainingSettings {
    let quality = if quick { Quality::Smoke } else { Quality::Balanced };
    settings(Chosen { preset: kind.into(), quality, robust })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_has_settings_that_are_accepted() {
        for kind in [SceneKind::ForwardFacing, SceneKind::Bounded, SceneKind::Unbounded] {
            for [quick, robust] in [[false, false], [false, true], [true, false], [true, true]] {
                of(kind, quick, robust).check().unwrap();
            }
        }
    }
}
