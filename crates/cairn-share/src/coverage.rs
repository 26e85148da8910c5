//! Coverage: whose photographs show what is seen from a place.
//!
//! Photograph i's share of pixel p is `S[p,i] = sum_v W[p,v] a[v,i]`, where `a[v,i] = A[v,i] c / sum_j A[v,j] c_j` and
//! `c = cos^k` of the angle at v between the ways to the photograph's camera and to the eye: what was seen from beside
//! the eye says more of what the eye sees. What no photograph showed, and what lies behind the field, is no photograph's.

use cairn_field::{CHANNELS, Mixed, RowWeights, VisibleField};
use cairn_scene::Camera;
use glam::DVec3;
use rayon::prelude::*;

use crate::table::{ShareTable, weights};

/// The smallest square of a cosine that counts: photographs from farther aside share what no photograph shows from nearer by.
const MIN_COSINE_SQUARED: f32 = 0.01;
/// Rows that a task goes through.
const ROWS_A_TASK: usize = 4096;

/// How sharply coverage goes by the angle: the power of its cosine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sharpness {
    power: u32,
}

impl Sharpness {
    /// Of a power, 0 (all photographs of a place count alike) or 2, 4, 8, 16 or 32.
    ///
    /// # Panics
    /// For another power.
    pub fn new(power: u32) -> Self {
        assert!(
            power == 0 || (power.is_power_of_two() && (2..=32).contains(&power)),
            "0, or a power of two from 2 to 32"
        );
        Self { power }
    }

    /// What a cosine counts whose square this is.
    #[inline(always)]
    fn of(self, squared: f32) -> f32 {
        (1..self.power.trailing_zeros()).fold(squared, |power, _| power * power)
    }

    /// The power.
    pub const fn power(self) -> u32 {
        self.power
    }
}

impl Default for Sharpness {
    fn default() -> Self {
        Self::new(8)
    }
}

/// Whose photographs show some pixels. All parts together are 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Shares {
    /// Each photograph's share, in the table's order, 0 to 1.
    pub of_photographs: Vec<f64>,
    /// What no photograph showed.
    pub unseen: f64,
    /// What lies behind the field: a sky, a background.
    pub behind: f64,
}

/// A table as one eye sees its rows.
pub struct SeenFrom<'a> {
    table: &'a ShareTable,
    field: &'a dyn VisibleField,
    eye: [f32; 4],
    cameras: Vec<[f32; 4]>,
    weights: [f32; 256],
    sharpness: Sharpness,
}

impl<'a> SeenFrom<'a> {
    /// Of an `eye` somewhere in the world.
    ///
    /// # Panics
    /// When the table is of another field ([`ShareTable::must_be_of`]).
    pub fn new(table: &'a ShareTable, field: &'a dyn VisibleField, eye: DVec3, sharpness: Sharpness) -> Self {
        assert_eq!(table.rows(), field.rows(), "a table of this field");
        let cameras = table.photographs().iter().map(|photograph| field.place_of(photograph.position)).collect();
        Self { table, field, eye: field.place_of(eye), cameras, weights: weights(), sharpness }
    }

    /// Puts what each entry of `row` counts in `out`, in the table's order, and gives the photographs of those entries and
    /// one over the sum of what they count.
    #[inline(always)]
    fn row(&self, row: usize, out: &mut Vec<f32>) -> (&[u16], f32) {
        let (photographs, codes) = self.table.of_row(row);
        out.clear();
        let weights = codes.iter().map(|code| self.weights[usize::from(*code)]);
        if self.sharpness.power == 0 {
            out.extend(weights);
        } else {
            let place = self.field.place(row);
            let to_eye = way(place, self.eye);
            let length = dot(to_eye, to_eye);
            let angle = |photograph: &u16| {
                let to_camera = way(place, self.cameras[usize::from(*photograph)]);
                let (along, lengths) = (dot(to_eye, to_camera), length * dot(to_camera, to_camera));
                let squared = if along > 0.0 { along * along / lengths } else { 0.0 };
                self.sharpness.of(squared.max(MIN_COSINE_SQUARED))
            };
            out.extend(photographs.iter().zip(weights).map(|(photograph, weight)| weight * angle(photograph)));
        }
        (photographs, 1.0 / out.iter().sum::<f32>())
    }

    /// Whose photographs show what `seen` says that some pixels see.
    pub fn shares(&self, seen: &RowWeights) -> Shares {
        let photographs = self.table.photographs().len();
        let of_task = |rows: &[(u32, f32)]| {
            let (mut sums, mut counts) = (vec![0f64; photographs], Vec::new());
            for (row, weight) in rows {
                let (own, share) = self.row(*row as usize, &mut counts);
                for (photograph, count) in own.iter().zip(&counts) {
                    sums[usize::from(*photograph)] += f64::from(weight * (count * share));
                }
            }
            sums
        };
        // Collected in order: the sums come out the same with any number of threads.
        let tasks: Vec<Vec<f64>> = seen.rows.par_chunks(ROWS_A_TASK).map(of_task).collect();
        let pixels = if seen.pixels > 0.0 { seen.pixels } else { 1.0 };
        let mut of_photographs = vec![0.0; photographs];
        for task in tasks {
            of_photographs.iter_mut().zip(task).for_each(|(sum, share)| *sum += share / pixels);
        }
        let behind = seen.behind / pixels;
        let unseen = (1.0 - behind - of_photographs.iter().sum::<f64>()).max(0.0);
        Shares { of_photographs, unseen, behind }
    }

    /// What each pixel of `camera` shows of groups of photographs, row-major: `group_of` has each photograph's,
    /// below [`CHANNELS`]; a channel is its group's share of the pixel, 0 to 1. `seen` is what all those pixels see.
    ///
    /// # Panics
    /// When `group_of` has not a group for each photograph.
    pub fn map(&self, camera: &Camera, seen: &RowWeights, group_of: &[usize]) -> Vec<Mixed> {
        assert_eq!(group_of.len(), self.cameras.len(), "a group for each photograph");
        let mut numbers = vec![[0.0; CHANNELS]; seen.rows.len() + 1];
        numbers[1..].par_chunks_mut(ROWS_A_TASK).zip(seen.rows.par_chunks(ROWS_A_TASK)).for_each(|(numbers, rows)| {
            let mut counts = Vec::new();
            for (numbers, (row, _)) in numbers.iter_mut().zip(rows) {
                let (own, share) = self.row(*row as usize, &mut counts);
                let of = own.iter().zip(&counts);
                of.for_each(|(photograph, count)| numbers[group_of[usize::from(*photograph)]] += count * share);
            }
        });
        let mut slot_of = vec![0; self.field.rows()];
        for (slot, (row, _)) in seen.rows.iter().enumerate() {
            slot_of[*row as usize] = slot as u32 + 1;
        }
        self.field.mixed(camera, &slot_of, &numbers)
    }
}

/// The way from a place to a camera, of any length; from infinity it is the same to all.
fn way(from: [f32; 4], to: [f32; 4]) -> [f32; 3] {
    [0, 1, 2].map(|k| to[k] * from[3] - from[k])
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::{Builder, Photograph};
    use cairn_field::OfPixel;

    /// Rows of which the second lies to the right of the first, and the third infinitely far ahead.
    struct Rows;

    impl VisibleField for Rows {
        fn rows(&self) -> usize {
            5
        }

        fn place(&self, row: usize) -> [f32; 4] {
            [[0.0; 4], [0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0], [0.0, 9.0, 0.0, 1.0]][row]
        }

        fn place_of(&self, point: DVec3) -> [f32; 4] {
            [point.x as f32, point.y as f32, point.z as f32, 1.0]
        }

        fn row_weights(&self, _: &Camera, _: OfPixel<'_>) -> RowWeights {
            unreachable!("pixels are given")
        }

        fn mixed(&self, _: &Camera, _: &[u32], _: &[[f32; CHANNELS]]) -> Vec<Mixed> {
            unreachable!("pixels are given")
        }
    }

    fn table() -> ShareTable {
        let mut builder = Builder::new(5);
        let mut add = |name: &str, position: DVec3, rows: &[(u32, f32)]| {
            let weights = RowWeights { rows: rows.to_vec(), behind: 0.0, pixels: 1.0 };
            builder.add(Photograph { name: name.into(), position }, &weights).expect("few photographs");
        };
        add("before", DVec3::new(0.0, 0.0, -1.0), &[(1, 2.0), (3, 1.0)]);
        add("beside", DVec3::new(-1.0, 0.0, -1.0), &[(1, 4.0), (2, 8.0), (3, 1.0)]);
        builder.finish().expect("few entries")
    }

    #[test]
    fn shares_are_what_photographs_showed_of_each_row_by_angle() {
        let (table, eye) = (table(), DVec3::new(0.0, 0.0, -3.0));
        let of = |power, rows: &[(u32, f32)]| {
            let seen = RowWeights { rows: rows.to_vec(), behind: 1.0, pixels: 4.0 };
            SeenFrom::new(&table, &Rows, eye, Sharpness::new(power)).shares(&seen)
        };
        let near = |got: Shares, want: [f64; 4]| {
            let got = [got.of_photographs[0], got.of_photographs[1], got.unseen, got.behind];
            assert!(got.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-6), "{got:?} is not {want:?}");
        };
        // Two thirds of the first row are `beside`'s; no photograph shows the fourth row.
        near(of(0, &[(1, 1.0)]), [1.0 / 12.0, 2.0 / 12.0, 0.5, 0.25]);
        near(of(0, &[(1, 1.0), (2, 1.0), (4, 1.0)]), [1.0 / 12.0, 5.0 / 12.0, 0.25, 0.25]);
        // From the eye `beside` lies 45 degrees aside: 4 cos^2 = 2, as much as `before`.
        near(of(2, &[(1, 1.0)]), [1.0 / 8.0, 1.0 / 8.0, 0.5, 0.25]);
        // What is infinitely far is seen by all alike, however sharply.
        near(of(32, &[(3, 2.0)]), [0.25, 0.25, 0.25, 0.25]);
    }

    #[test]
    fn no_pixels_have_no_shares() {
        let table = table();
        let shares = SeenFrom::new(&table, &Rows, DVec3::ZERO, Sharpness::default()).shares(&RowWeights::default());
        assert_eq!(shares, Shares { of_photographs: vec![0.0; 2], unseen: 1.0, behind: 0.0 });
    }
}
