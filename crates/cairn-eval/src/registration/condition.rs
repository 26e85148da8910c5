//! What is done to a picture before its camera is looked for.

use cairn_mark::Distortion::{self, Blur, Crop, EightBits, Jpeg, Light, Noise, Rotate, Scale};

/// What a picture is, before anything is done to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shown {
    /// A render in the light of the place's photograph.
    Render,
    /// A render in the light of another photograph; there is none where the field knows one light only.
    AnotherLight,
    /// A render by another lens, whose k1 is less by [`BENT`].
    AnotherLens,
    /// The photograph.
    Photograph,
}

/// Which figures a condition counts in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// One thing is done to a render, and it stays sharp.
    Single,
    /// A render is blurred.
    Blurred,
    /// All together.
    Together,
    /// A photograph.
    Photographs,
}

/// A condition.
#[derive(Clone, Copy, Debug)]
pub struct Condition {
    /// What rows call it.
    pub name: &'static str,
    /// Its group.
    pub group: Group,
    /// Of what.
    pub shown: Shown,
    /// What is done, in this order.
    pub chain: &'static [Distortion],
    /// Whether a placement of it is on the sheet.
    pub on_sheet: bool,
}

/// By how much k1 of another lens is less: a barrel, as wide lenses of telephones have.
pub const BENT: f64 = 0.1;

/// 60 % of the area.
const CROP: Distortion = Crop { kept: 0.774_6, across: 0.2, down: 0.7 };

const fn single(name: &'static str, chain: &'static [Distortion]) -> Condition {
    Condition { name, group: Group::Single, shown: Shown::Render, chain, on_sheet: false }
}

const fn on_sheet(condition: Condition) -> Condition {
    Condition { on_sheet: true, ..condition }
}

const fn photograph(name: &'static str, chain: &'static [Distortion]) -> Condition {
    Condition { group: Group::Photographs, shown: Shown::Photograph, ..single(name, chain) }
}

/// The conditions, in the order of the rows.
pub const CONDITIONS: [Condition; 18] = [
    single("clean", &[EightBits]),
    on_sheet(single("JPEG 50", &[Jpeg { quality: 50 }])),
    on_sheet(single("noise 0.05", &[Noise { sigma: 0.05 }, EightBits])),
    single("brightness + 20 %", &[Light { brightness: 1.2, contrast: 1.0 }, EightBits]),
    single("brightness - 20 %", &[Light { brightness: 0.8, contrast: 1.0 }, EightBits]),
    Condition { shown: Shown::AnotherLight, ..single("another view's light", &[EightBits]) },
    Condition { shown: Shown::AnotherLens, ..single("another lens", &[EightBits]) },
    on_sheet(single("crop 60 %", &[CROP, EightBits])),
    single("turn 5 deg", &[Rotate { degrees: 5.0 }, EightBits]),
    single("turn 15 deg", &[Rotate { degrees: -15.0 }, EightBits]),
    on_sheet(single("turn 30 deg", &[Rotate { degrees: 30.0 }, EightBits])),
    on_sheet(single("turn 45 deg", &[Rotate { degrees: -45.0 }, EightBits])),
    single("scale 75 %", &[Scale { factor: 0.75 }, EightBits]),
    on_sheet(single("scale 50 %", &[Scale { factor: 0.5 }, EightBits])),
    Condition { group: Group::Blurred, ..on_sheet(single("blur 2 px", &[Blur { sigma_px: 2.0 }, EightBits])) },
    Condition {
        group: Group::Together,
        ..on_sheet(single(
            "all together",
            &[Rotate { degrees: 30.0 }, CROP, Scale { factor: 0.75 }, Noise { sigma: 0.1 }, Jpeg { quality: 50 }],
        ))
    },
    on_sheet(photograph("photograph", &[EightBits])),
    on_sheet(photograph("photograph, turn 30 deg", &[Rotate { degrees: 30.0 }, EightBits])),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_conditions_are_on_the_sheet_and_names_differ() {
        assert_eq!(CONDITIONS.iter().filter(|condition| condition.on_sheet).count(), 10);
        let names: std::collections::BTreeSet<&str> = CONDITIONS.iter().map(|condition| condition.name).collect();
        assert_eq!(names.len(), CONDITIONS.len());
        assert!((0.774_6f32.powi(2) - 0.6).abs() < 1e-3, "of the area");
    }
}
