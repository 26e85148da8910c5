//! What is done to renders before the detector reads them: the two sets that are
//! reported, changes of the field's weights, and another view's appearance.

use cairn_mark::{Distortion, MarkedField};

/// How much is asked after it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Set {
    /// What happens to pictures every day.
    Mild,
    /// The set that watermarks of fields are usually tried with.
    Hard,
    /// All of the hard set's distortions of pictures, one after another.
    Combined,
}

/// Something done to renders.
#[derive(Clone, Debug)]
pub struct Attack {
    /// As it stands in tables.
    pub name: &'static str,
    /// Its set.
    pub set: Set,
    /// Done to the picture, in this order. Each list is one try.
    pub tries: Vec<Vec<Distortion>>,
}

/// Where parts are cut out: two corners and the middle.
const PLACES: [[f32; 2]; 3] = [[0.0, 0.0], [0.5, 0.5], [1.0, 0.8]];

/// Both sets' distortions of pictures.
pub fn of_pictures() -> Vec<Attack> {
    use Distortion::{Blur, EightBits, Jpeg, Light, Noise, Rotate, Scale};
    let one = |name, set, distortion| Attack { name, set, tries: vec![vec![distortion]] };
    // What is drawn is drawn three times, and what has two sides comes from both.
    let drawn = |name, set, distortion| Attack { name, set, tries: vec![vec![distortion]; 3] };
    let both = |name, set, degrees: f32| Attack {
        name,
        set,
        tries: [degrees, -degrees].map(|degrees| vec![Rotate { degrees }]).to_vec(),
    };
    let crop = |name, set, kept: f32| Attack { name, set, tries: PLACES.map(|at| vec![cut(kept, at)]).to_vec() };
    let light = |brightness, contrast| Light { brightness, contrast };
    let combined = PLACES.iter().zip([30.0, -30.0, 15.0]).map(|(at, degrees)| {
        let smaller = Scale { factor: 0.75 };
        vec![Rotate { degrees }, cut(SIXTY_PERCENT, *at), smaller, Noise { sigma: 0.1 }, Jpeg { quality: 50 }]
    });
    vec![
        one("8-bit PNG", Set::Mild, EightBits),
        one("JPEG 90", Set::Mild, Jpeg { quality: 90 }),
        one("JPEG 75", Set::Mild, Jpeg { quality: 75 }),
        one("JPEG 50", Set::Mild, Jpeg { quality: 50 }),
        one("JPEG 30", Set::Mild, Jpeg { quality: 30 }),
        one("blur 0.5 px", Set::Mild, Blur { sigma_px: 0.5 }),
        one("blur 1 px", Set::Mild, Blur { sigma_px: 1.0 }),
        one("blur 2 px", Set::Mild, Blur { sigma_px: 2.0 }),
        drawn("noise 0.02", Set::Mild, Noise { sigma: 0.02 }),
        drawn("noise 0.05", Set::Mild, Noise { sigma: 0.05 }),
        one("brightness + 20 %", Set::Mild, light(1.2, 1.0)),
        one("brightness - 20 %", Set::Mild, light(0.8, 1.0)),
        one("contrast + 20 %", Set::Mild, light(1.0, 1.2)),
        one("contrast - 20 %", Set::Mild, light(1.0, 0.8)),
        crop("crop to 90 %", Set::Mild, 0.9),
        crop("crop to 75 %", Set::Mild, 0.75),
        both("rotation 2 deg", Set::Mild, 2.0),
        both("rotation 5 deg", Set::Mild, 5.0),
        drawn("noise 0.1", Set::Hard, Noise { sigma: 0.1 }),
        both("rotation 15 deg", Set::Hard, 15.0),
        both("rotation 30 deg", Set::Hard, 30.0),
        one("scale 75 %", Set::Hard, Scale { factor: 0.75 }),
        crop("crop 40 % away", Set::Hard, SIXTY_PERCENT),
        Attack { name: "all combined", set: Set::Combined, tries: combined.collect() },
    ]
}

/// The side of a part that has 60 % of the area.
const SIXTY_PERCENT: f32 = 0.774_6;

fn cut(kept: f32, [across, down]: [f32; 2]) -> Distortion {
    Distortion::Crop { kept, across, down }
}

/// Fields whose weights were changed, each with its name and set.
pub fn of_weights(marked: &MarkedField) -> Vec<(&'static str, Set, MarkedField)> {
    vec![
        ("weights: float16", Set::Mild, marked.in_half_precision()),
        ("weights: 10 % smallest removed", Set::Mild, marked.pruned(0.1)),
        ("weights: 20 % smallest removed", Set::Hard, marked.pruned(0.2)),
        ("weights: noise of 0.1 RMS", Set::Hard, marked.noisy(0.1, 1)),
    ]
}
