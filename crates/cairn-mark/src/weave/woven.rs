//! The woven field, which is published, and what reading its marks takes, which is not.
//!
//! To the constant coefficients of each row comes `a(v) M s(cell(v))`: `M` the opponent colours lightness, red-green and
//! yellow-blue, weighted 1, 1/2, 1/2, s the signs of the cell's owner, a what the eye lets pass. Densities stay.

use super::eye::allowed;
use super::keys::{PARTS, Signs, WeavingSecret};
use super::lots::{Lots, UNOWNED};
use cairn_field::stats::median;
use cairn_field::{Appearance, CarrierBasis, Field, LinearView, MarkableField, OfPixel, VisibleField};
use cairn_scene::{Camera, Picture};
use cairn_share::ShareTable;
use rayon::prelude::*;
use std::fmt;

/// Opponent colours: lightness, red-green, yellow-blue, a row each, orthonormal.
pub const OPPONENT: [[f32; 3]; 3] = [
    [0.577_350_3, 0.577_350_3, 0.577_350_3],
    [std::f32::consts::FRAC_1_SQRT_2, -std::f32::consts::FRAC_1_SQRT_2, 0.0],
    [0.408_248_3, 0.408_248_3, -0.816_496_6],
];
/// How much of a mark is in each of them.
pub const WEIGHTS: [f32; 3] = [1.0, 0.5, 0.5];
/// A cell is about this wide in the typical view, px: what is finer does not survive, and coarser cells are fewer signs.
const CELL_PX: f64 = 2.0;
/// Rows of a view by which the width of a cell is found.
const SAMPLED_ROWS: usize = 2000;
/// An entry of a view that weighs less does not count.
const CUTOFF: f32 = 1e-3;
/// Views that a weaving is judged by are made so small, longest side, px. A pixel is one ray at any size, so that the rays of
/// many small views tell more of a field's rows than those of a few large ones.
const SMALL_PX: usize = 100;
/// Of what the pixels that see a row change by, the mean of that power counts: nearly the largest.
const POWER: i32 = 8;
/// The largest change of a colour, levels of 255,
const MAX_LEVELS: f32 = 8.0;
/// which lies so many standard deviations of the pixel's change out: of a normal number one in 150,000 lies beyond.
const DEVIATIONS: f32 = 4.5;
/// Times that the strength is brought nearer to the budget.
const CORRECTIONS: usize = 6;

/// A view that a weaving is judged by.
pub struct Looked {
    /// The camera.
    pub camera: Camera,
    /// The light.
    pub light: Appearance,
}

/// What reading takes besides the base field and the weaving secret. It is sealed with them.
#[derive(PartialEq)]
pub struct Weave {
    /// Whose each cell is.
    pub lots: Lots,
    /// How strong the mark is in each row, colours in [0, 1]; 0 where it is unowned.
    pub amplitudes: Vec<f32>,
    /// The contributors, by their numbers.
    pub contributors: Vec<String>,
}

/// A weaving's outcome.
#[derive(Debug)]
pub struct Woven {
    /// The field that is published, rounded as files hold it.
    pub field: Field,
    /// What reading it takes.
    pub weave: Weave,
    /// PSNR of its renders against the base's over the views that were looked at, dB.
    pub psnr_db: f64,
}

impl fmt::Debug for Weave {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Weave(..)")
    }
}

/// Weaves the contributors' marks into `base`, as strong as `psnr_db` (renders of the woven field against the base's, over the
/// `views`) and the eye allow. `owner_of` has the contributor's number of each photograph of `table`. `None` where the views
/// see nothing that a contributor's photographs taught.
///
/// # Panics
/// When the table is of another field, there is no view, or `owner_of` has not a contributor's number for each photograph.
pub fn weave(
    base: &Field,
    table: &ShareTable,
    contributors: Vec<String>,
    owner_of: &[u16],
    secret: &WeavingSecret,
    views: &[Looked],
    psnr_db: f64,
) -> Option<Woven> {
    assert!(!views.is_empty(), "a weaving is judged by a view");
    assert!(owner_of.iter().all(|owner| usize::from(*owner) < contributors.len()), "an owner is a contributor");
    let lots = Lots::draw(base, table, owner_of, &secret.lottery(), side(base, views));
    let views = Views::of(base, views);
    let amplitudes = views.amplitudes(&lots, psnr_db)?;
    let residual = residual(&lots, &signs(&lots, secret, &contributors), &amplitudes);
    let change = views.mean_square(&residual);
    let field = base.with_colours_added(&residual).with_stored_colours();
    Some(Woven { field, weave: Weave { lots, amplitudes, contributors }, psnr_db: -10.0 * change.log10() })
}

/// What each row's colour changes by (`rows x 3`, RGB).
fn residual(lots: &Lots, signs: &[[f32; 3]], amplitudes: &[f32]) -> Vec<f32> {
    let of = |(cell, amplitude): (&u32, &f32)| -> [f32; 3] {
        let signs = signs[*cell as usize];
        let along: [f32; 3] = std::array::from_fn(|k| amplitude * WEIGHTS[k] * signs[k]);
        std::array::from_fn(|c| (0..3).map(|k| along[k] * OPPONENT[k][c]).sum())
    };
    let each: Vec<[f32; 3]> = lots.of_row.par_iter().zip(amplitudes).map(of).collect();
    each.into_flattened()
}

/// Each cell's signs; zeros of unowned ones.
fn signs(lots: &Lots, secret: &WeavingSecret, contributors: &[String]) -> Vec<[f32; 3]> {
    let of_parts = all_signs(secret, contributors);
    let of = |cell: usize| match lots.owners[cell] {
        UNOWNED => [0.0; 3],
        owner => of_parts[usize::from(owner)][usize::from(lots.parts[cell])].of(lots.numbers[cell]),
    };
    (0..lots.numbers.len()).into_par_iter().map(of).collect()
}

/// What gives the signs of each part of each contributor's cells.
pub fn all_signs(secret: &WeavingSecret, contributors: &[String]) -> Vec<[Signs; PARTS]> {
    let of = |contributor: &String| {
        let key = secret.mark_key(contributor);
        std::array::from_fn(|part| key.part(part).signs())
    };
    contributors.par_iter().map(of).collect()
}

/// Vertices on a side of a cell, so that it is about [`CELL_PX`] wide in the typical view.
fn side(base: &Field, views: &[Looked]) -> u32 {
    let of = |view: &Looked| {
        let rows = base.row_weights(&view.camera, OfPixel::All).rows;
        let step = rows.len().div_ceil(SAMPLED_ROWS).max(1);
        rows.iter().step_by(step).filter_map(|(row, _)| base.spacing_px(*row as usize, &view.camera)).collect()
    };
    let all: Vec<f64> = views.iter().map(of).collect::<Vec<Vec<f64>>>().concat();
    let typical = if all.is_empty() { CELL_PX } else { median(all) };
    ((CELL_PX / typical).round() as u32).max(1)
}

/// The views that a weaving is judged by, as linear maps.
struct Views<'a> {
    views: Vec<(LinearView, &'a Appearance)>,
    rows: usize,
}

impl<'a> Views<'a> {
    fn of(base: &Field, views: &'a [Looked]) -> Self {
        let of = |view: &'a Looked| {
            let i = &view.camera.intrinsics;
            let longest = i.width.max(i.height).max(1);
            let side = |side: usize| if longest > SMALL_PX { (side * SMALL_PX / longest).max(1) } else { side };
            (base.view(&view.camera.resized(side(i.width), side(i.height)), CUTOFF, 1), &view.light)
        };
        Self { views: views.iter().map(of).collect(), rows: base.grid().rows() }
    }

    /// How strong the mark of each row is; none of unowned ones, and `None` where that is all. **It does not look at signs**: the
    /// bound of what readers say holds for strengths that signs are independent of.
    ///
    /// What lies deep shows less of its mark than what is seen alone. So a row's strength is the inverse of what the pixels
    /// that see it would change by if all rows were alike, times what the eye lets pass there.
    fn amplitudes(&self, lots: &Lots, psnr_db: f64) -> Option<Vec<f32>> {
        let is_owned = |row: usize| row != 0 && lots.owners[lots.of_row[row] as usize] != UNOWNED;
        let alike: Vec<f32> = (0..self.rows).map(|row| f32::from(u8::from(is_owned(row)))).collect();
        let (mut sums, mut touched) = (vec![0.0; 3 * self.rows], vec![false; self.rows]);
        for (view, light) in &self.views {
            let picture = Picture::new(view.width(), view.height(), view.base(light)).expect("a colour a pixel");
            let spreads = view.spreads(&alike, &lots.of_row, light);
            let of = |(spread, allowed): (&f32, f32)| [spread.powi(POWER), allowed, 1.0];
            let slope: Vec<f32> = spreads.iter().zip(allowed(&picture.clamped())).flat_map(of).collect();
            view.push_back(&slope, CarrierBasis::Constant, light, &mut sums, &mut touched);
        }
        // Of a row that no view sees it is taken that a pixel shows it alone, on a plain surface.
        let of = |sum: &[f32]| match sum {
            [spread, allowed, seen] if *spread > 0.0 => ((seen / spread).powf(1.0 / POWER as f32), allowed / seen),
            _ => (1.0, 1.0),
        };
        let bearable: Vec<(f32, f32)> = sums.chunks_exact(3).map(of).collect();
        // A strength of 1 changes a channel by that, root mean square over channels.
        let channel = (WEIGHTS.iter().map(|w| w * w).sum::<f32>() / 3.0).sqrt();
        let max = MAX_LEVELS / 255.0 / DEVIATIONS / channel;
        let strong = |gain: f32| -> Vec<f32> {
            let of = |(alike, (even, allowed)): (&f32, &(f32, f32))| alike * even * (gain * allowed).min(max);
            alike.iter().zip(&bearable).map(of).collect()
        };
        let wanted = 10f64.powf(-psnr_db / 10.0);
        let (mut gain, mut found) = (max, strong(max));
        for _ in 0..CORRECTIONS {
            let change = f64::from(channel).powi(2) * self.expected_square(lots, &found);
            if !(change.is_finite() && change > 0.0) {
                return None;
            }
            // Where all rows are as strong as they may be, more gain changes nothing.
            gain *= (wanted / change).sqrt().min(4.0) as f32;
            found = strong(gain);
        }
        Some(found)
    }

    /// The mean square over the views' pixels of what they change by where each row is so strong, by [`LinearView::spreads`].
    fn expected_square(&self, lots: &Lots, strengths: &[f32]) -> f64 {
        let of = |(view, light): &(LinearView, &Appearance)| view.spreads(strengths, &lots.of_row, light);
        mean_square(&self.views.iter().map(of).collect::<Vec<_>>())
    }

    /// The mean squared change of the views' colours where rows change by `residual`.
    fn mean_square(&self, residual: &[f32]) -> f64 {
        let of = |(view, light): &(LinearView, &Appearance)| {
            let mut picture = vec![0.0; 3 * view.width() * view.height()];
            view.apply_lit(residual, light, &mut picture);
            picture
        };
        mean_square(&self.views.iter().map(of).collect::<Vec<_>>())
    }
}

/// The mean square of all numbers.
fn mean_square(all: &[Vec<f32>]) -> f64 {
    let count: usize = all.iter().map(Vec::len).sum();
    all.iter().flatten().map(|v| f64::from(*v).powi(2)).sum::<f64>() / count.max(1) as f64
}
