//! All that this suite asks of a field beyond rendering it as shipped: other
//! limits, an exact picture in f64, other precisions of storage.

use cairn_field::appearance::code::features;
use cairn_field::grid::sh;
use cairn_field::render::composite::gather;
use cairn_field::render::patch::Patch;
use cairn_field::{Appearance, Field, Thresholds};
use cairn_scene::Camera;

/// What a pixel leaves out as shipped.
pub const SHIPPED: Thresholds = Thresholds::SHOWN;
/// How colours are stored as shipped.
pub const STORED: Storage = Storage::F16;

/// What a field's colours are kept in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Storage {
    /// 16 bits, floating point.
    F16,
    /// 8 bits.
    U8,
}

impl Storage {
    /// All of them, finest first. Fields are trained in f32 and rounded when they are
    /// finished, so that one in memory and one read back are the same.
    pub const ALL: [Self; 2] = [Self::F16, Self::U8];

    /// As it stands in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::F16 => "f16",
            Self::U8 => "u8",
        }
    }

    /// Bits of a colour coefficient.
    pub fn bits(self) -> f64 {
        match self {
            Self::F16 => 16.0,
            Self::U8 => 8.0,
        }
    }
}

/// The picture in f64 with nothing left out, samples `step_voxels` apart:
/// `height * width * 3` numbers, row-major, not clamped.
pub fn render_exact(field: &Field, camera: &Camera, appearance: &Appearance, step_voxels: f64) -> Vec<f64> {
    let mut grid = field.grid().cast::<f64>();
    grid.refresh_occupancy(0.0);
    let limits = Thresholds { step: step_voxels, ..Thresholds::EXACT };
    let (w, h) = (camera.intrinsics.width, camera.intrinsics.height);
    let (mut tape, mut patch) = (Vec::new(), Patch::default());
    let mut pixel = |at: usize| {
        let (origin, direction) = camera.ray((at % w) as f64 + 0.5, (at / w) as f64 + 0.5);
        let harmonics = sh::basis(direction.to_array());
        patch.begin(harmonics);
        let gathered = gather(&grid, &mut patch, &field.frame().path(origin, direction), 0.5, limits, &mut tape);
        appearance.shade(&features(&gathered, &harmonics))
    };
    (0..w * h).flat_map(&mut pixel).collect()
}

/// The field as it is when stored so; `None` where this release cannot.
pub fn stored_as(field: &Field, storage: Storage) -> Option<Field> {
    match storage {
        Storage::F16 => Some(field.clone()),
        Storage::U8 => Some(field.with_colours_of_8_bits()),
    }
}
