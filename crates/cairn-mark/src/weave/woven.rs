//! The woven field, which is published, and what reading its marks takes, which is not.
//!
//! To the constant coefficients of each row comes `a(v) M s(cell(v))`: `M` the opponent colours lightness, red-green and
//! yellow-blue, weighted 1, 1/2, 1/2, s the signs of the cell's owner, a what the eye lets pass. Densities stay.

use super::eye::allowed;
use super::keys::{PARTS, Signs, WeavingSecret};
use super::lots::{Lots, NOBODY};
use crate::attack::Blur;
use cairn_field::stats::median;
use cairn_field::{Appearance, CarrierBasis, Field, LinearView, MarkableField, OfPixel, VisibleField};
use cairn_scene::{Camera, Picture};
use cairn_share::ShareTable;
use rayon::prelude::*;

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
/// The largest change of a colour, levels of 255: of a pixel of the views that are looked at, and of a row that they do not
/// see, where it is seen alone.
const MAX_LEVELS: f32 = 8.0;
/// Times that the strength is corrected by what the views show.
const CORRECTIONS: usize = 4;
/// A row's strength changes by this factor at most each time.
const MAX_CORRECTION: f32 = 2.0;
/// How far around a pixel its change is looked at, standard deviation, px.
const AROUND_PX: f32 = 3.0;
/// Mean squared change below which a pixel shows no mark, colours in [0, 1].
const NO_MARK: f32 = 1e-10;

/// A view that a weaving is judged by.
pub struct Looked {
    /// The camera.
    pub camera: Camera,
    /// The light.
    pub light: Appearance,
}

/// What reading takes besides the base field and the weaving secret. It is sealed with them.
#[derive(Clone, Debug, PartialEq)]
pub struct Weave {
    /// Whose each cell is.
    pub lots: Lots,
    /// How strong the mark is in each row, colours in [0, 1]; 0 where it is nobody's.
    pub amplitudes: Vec<f32>,
    /// The contributors, by their numbers.
    pub contributors: Vec<String>,
}

/// A weaving's outcome.
#[derive(Clone, Debug)]
pub struct Woven {
    /// The field that is published, rounded as files hold it.
    pub field: Field,
    /// What reading it takes.
    pub weave: Weave,
    /// PSNR of its renders against the base's over the views that were looked at, dB.
    pub psnr_db: f64,
}

/// Weaves the contributors' marks into `base`. `owner_of` has the contributor's number of each photograph of `table`.
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
) -> Woven {
    assert!(!views.is_empty(), "a weaving is judged by a view");
    assert!(owner_of.iter().all(|owner| usize::from(*owner) < contributors.len()), "an owner is a contributor");
    let lots = Lots::draw(base, table, owner_of, &secret.lottery(), side(base, views));
    let colours = Colours::of(base, views);
    let signs = signs(&lots, secret, &contributors);
    let wanted = 10f64.powf(-psnr_db / 10.0);
    let is_somebodys = |cell: &u32| lots.owners[*cell as usize] != NOBODY;
    let mut amplitudes: Vec<f32> = lots.of_row.iter().map(|cell| f32::from(u8::from(is_somebodys(cell)))).collect();
    amplitudes[0] = 0.0;
    for _ in 0..CORRECTIONS {
        colours.even_out(&colours.changed(&residual(&lots, &signs, &amplitudes)), &mut amplitudes);
        let change = mean_square(&colours.changed(&residual(&lots, &signs, &amplitudes)));
        let gain = if change > 0.0 { (wanted / change).sqrt() } else { 0.0 };
        amplitudes.iter_mut().for_each(|a| *a *= gain as f32);
        colours.cap(&colours.changed(&residual(&lots, &signs, &amplitudes)), &mut amplitudes);
    }
    let change = mean_square(&colours.changed(&residual(&lots, &signs, &amplitudes)));
    let field = base.with_colours_added(&residual(&lots, &signs, &amplitudes)).with_stored_colours();
    Woven { field, weave: Weave { lots, amplitudes, contributors }, psnr_db: -10.0 * change.log10() }
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

/// Each cell's signs; zeros of nobody's.
fn signs(lots: &Lots, secret: &WeavingSecret, contributors: &[String]) -> Vec<[f32; 3]> {
    let of_parts = all_signs(secret, contributors);
    let of = |cell: usize| match lots.owners[cell] {
        NOBODY => [0.0; 3],
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

/// The views as linear maps.
struct Colours<'a> {
    views: Vec<(LinearView, &'a Appearance)>,
    /// What the eye lets pass in each.
    allowed: Vec<Vec<f32>>,
    rows: usize,
}

impl<'a> Colours<'a> {
    fn of(base: &Field, views: &'a [Looked]) -> Self {
        let linear: Vec<_> = views.iter().map(|view| (base.view(&view.camera, CUTOFF, 1), &view.light)).collect();
        let allowed = linear.iter().map(|(view, light)| {
            let picture = Picture::new(view.width(), view.height(), view.base(light)).expect("a colour a pixel");
            allowed(&picture.clamped())
        });
        Self { allowed: allowed.collect(), views: linear, rows: base.grid().rows() }
    }

    /// Brings each row's strength nearer to what the pixels that see it bear: `shown` is what they show now. What lies deep
    /// or beside others shows less of its mark, and what stands alone more. A row that no view sees keeps its strength.
    fn even_out(&self, shown: &[Vec<f32>], amplitudes: &mut [f32]) {
        let mut sums = vec![0.0; 3 * self.rows];
        let mut touched = vec![false; self.rows];
        for (((view, light), allowed), shown) in self.views.iter().zip(&self.allowed).zip(shown) {
            let squares: Vec<f32> = shown.iter().map(|v| v * v).collect();
            let around = Blur::new(AROUND_PX).apply(&squares, [view.width(), view.height()]);
            let slope = |(allowed, around): (&f32, &[f32])| {
                let square = around.iter().sum::<f32>();
                if square > NO_MARK { [allowed / square.sqrt(), 1.0, 0.0] } else { [0.0; 3] }
            };
            let slope: Vec<f32> = allowed.iter().zip(around.chunks_exact(3)).flat_map(slope).collect();
            view.push_back(&slope, CarrierBasis::Constant, light, &mut sums, &mut touched);
        }
        let factors: Vec<f32> =
            sums.chunks_exact(3).map(|sum| if sum[1] > 0.0 { sum[0] / sum[1] } else { 0.0 }).collect();
        let seen: Vec<f64> = factors.iter().filter(|f| **f > 0.0).map(|f| f64::from(*f)).collect();
        let typical = median(seen) as f32;
        for (amplitude, factor) in amplitudes.iter_mut().zip(factors).filter(|(_, factor)| *factor > 0.0) {
            *amplitude *= (factor / typical).clamp(1.0 / MAX_CORRECTION, MAX_CORRECTION);
        }
    }

    /// Makes rows fainter that pixels see which change too much, by `shown`; and rows that no view sees, if need be.
    fn cap(&self, shown: &[Vec<f32>], amplitudes: &mut [f32]) {
        let max = MAX_LEVELS / 255.0;
        let mut sums = vec![0.0; 3 * self.rows];
        let mut touched = vec![false; self.rows];
        for ((view, light), shown) in self.views.iter().zip(shown) {
            let slope = |change: &[f32]| {
                let largest = change.iter().fold(0.0, |m: f32, v| m.max(v.abs()));
                if largest > max { [largest - max, largest, 0.0] } else { [0.0; 3] }
            };
            let slope: Vec<f32> = shown.chunks_exact(3).flat_map(slope).collect();
            view.push_back(&slope, CarrierBasis::Constant, light, &mut sums, &mut touched);
        }
        // A mark of strength 1 changes a channel by that at most.
        let channel = |c: usize| (0..3).map(|k| (WEIGHTS[k] * OPPONENT[k][c]).abs()).sum::<f32>();
        let alone = max / (0..3).map(channel).fold(0.0, f32::max);
        for ((amplitude, sum), touched) in amplitudes.iter_mut().zip(sums.chunks_exact(3)).zip(touched) {
            match (touched, sum) {
                (false, _) => *amplitude = amplitude.min(alone),
                (true, [too_much, of, _]) if *of > 0.0 => *amplitude *= 1.0 - too_much / of,
                _ => {}
            }
        }
    }

    /// What the views' colours change by where rows change by `residual`.
    fn changed(&self, residual: &[f32]) -> Vec<Vec<f32>> {
        let of = |(view, light): &(LinearView, &Appearance)| {
            let mut picture = vec![0.0; 3 * view.width() * view.height()];
            view.apply_lit(residual, light, &mut picture);
            picture
        };
        self.views.iter().map(of).collect()
    }
}

/// The mean square of pictures' numbers.
fn mean_square(pictures: &[Vec<f32>]) -> f64 {
    let count: usize = pictures.iter().map(Vec::len).sum();
    let squares = pictures.iter().flatten().map(|v| f64::from(*v).powi(2));
    squares.sum::<f64>() / count.max(1) as f64
}
