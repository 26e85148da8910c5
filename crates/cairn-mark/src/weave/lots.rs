//! Lots: each cell of a field belongs to one contributor, drawn with the probability of their share of it. Together a
//! contributor's cells are as strong a mark as the sum of all contributors' signs in every cell would be, claims do not
//! overlap, and a cell costs one keyed call. Who has not the weaving secret cannot tell whose a cell is.

use super::keys::Lottery;
use cairn_field::MarkableField;
use cairn_share::ShareTable;
use rayon::prelude::*;

/// The owner of a cell that no photograph shows.
pub const UNOWNED: u16 = u16::MAX;
/// Rows that a task goes through.
const ROWS_A_TASK: usize = 4096;

/// The cells of a field and whose they are.
#[derive(PartialEq)]
pub struct Lots {
    /// Vertices on a side of a cell.
    pub side: u32,
    /// The cell of each row, by its place in `numbers`; row 0's means nothing.
    pub of_row: Vec<u32>,
    /// Each cell's number: where it lies on the lattice of cells, x fastest.
    pub numbers: Vec<u64>,
    /// Each cell's owner, by their number; [`UNOWNED`] where no photograph shows it.
    pub owners: Vec<u16>,
    /// Which part of its owner's cells each is.
    pub parts: Vec<u8>,
}

impl Lots {
    /// Draws the owners of the cells of `field`, `side` vertices a side, by `table`. `owner_of` has the owner's number of
    /// each photograph of the table.
    ///
    /// # Panics
    /// When `side` is 0, the table is of another field, or `owner_of` has not a number below [`UNOWNED`] for each photograph.
    pub fn draw(field: &dyn MarkableField, table: &ShareTable, owner_of: &[u16], lottery: &Lottery, side: u32) -> Self {
        assert!(side > 0, "a cell has a vertex");
        assert_eq!(table.rows(), field.rows(), "a table of this field");
        assert_eq!(table.photographs().len(), owner_of.len(), "an owner for each photograph");
        let owners = owner_of.iter().max().map_or(0, |last| usize::from(*last) + 1);
        assert!(owners <= usize::from(UNOWNED), "fewer owners than {UNOWNED}");
        let lattice = field.lattice();
        let max = lattice.iter().fold([0; 3], |max, at| [0, 1, 2].map(|k| at[k].max(max[k])));
        let across = max.map(|v| u64::from(v / side) + 1);
        let number = |at: &[u32; 3]| {
            let [x, y, z] = at.map(|v| u64::from(v / side));
            x + across[0] * (y + across[1] * z)
        };
        let of_rows: Vec<u64> = lattice.par_iter().map(number).collect();
        let mut numbers = of_rows[1.min(of_rows.len())..].to_vec();
        numbers.par_sort_unstable();
        numbers.dedup();
        let place = |number: &u64| numbers.binary_search(number).map_or(0, |at| at as u32);
        let of_row: Vec<u32> = of_rows.par_iter().map(place).collect();
        // The rows of each cell, one cell after another.
        let mut rows: Vec<u32> = (1..of_row.len() as u32).collect();
        rows.par_sort_by_key(|row| (of_row[*row as usize], *row));
        let drawn: Vec<(u16, u8)> = rows
            .chunk_by(|a, b| of_row[*a as usize] == of_row[*b as usize])
            .collect::<Vec<_>>()
            .par_iter()
            .with_min_len(ROWS_A_TASK)
            .map_init(
                || vec![0f64; owners],
                |sums, rows| {
                    sums.fill(0.0);
                    for (photograph, shown) in rows.iter().flat_map(|row| table.shown_of(*row as usize)) {
                        sums[usize::from(owner_of[photograph])] += f64::from(shown);
                    }
                    let lot = lottery.draw(numbers[of_row[rows[0] as usize] as usize]);
                    (drawn(sums, lot.share), lot.part)
                },
            )
            .collect();
        let (owners, parts) = drawn.into_iter().unzip();
        Self { side, of_row, numbers, owners, parts }
    }
}

/// The number at which `shares`, added up, pass `lot` of their sum.
fn drawn(shares: &[f64], lot: f64) -> u16 {
    let all: f64 = shares.iter().sum();
    let mut sum = 0.0;
    let passed = |share: &f64| {
        sum += share;
        sum > lot * all
    };
    shares.iter().position(passed).map_or(UNOWNED, |owner| owner as u16)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::weave::keys::WeavingSecret;
    use cairn_field::{LinearView, RowWeights};
    use cairn_scene::Camera;
    use cairn_share::{Builder, Photograph};

    /// A lattice of 40 x 40 x 1 vertices.
    struct Sheet;

    impl MarkableField for Sheet {
        fn rows(&self) -> usize {
            1601
        }
        fn lattice(&self) -> Vec<[u32; 3]> {
            std::iter::once([0; 3]).chain((0..1600).map(|k| [k % 40, k / 40, 0])).collect()
        }
        fn row_magnitudes(&self) -> Vec<f32> {
            unreachable!("no colours are asked for")
        }
        fn coefficient_magnitudes(&self) -> Vec<f32> {
            unreachable!("no colours are asked for")
        }
        fn densities(&self) -> Vec<f32> {
            unreachable!("no densities are asked for")
        }
        fn view(&self, _: &Camera, _: f32, _: usize) -> LinearView {
            unreachable!("no view is asked for")
        }
    }

    /// Three photographs: the first two, one contributor's, show all rows but the last; the third three times as much of
    /// those below 800.
    fn table() -> ShareTable {
        let mut builder = Builder::new(1601);
        let mut add = |name: &str, rows: std::ops::Range<u32>, shown: f32| {
            let photograph = Photograph { name: name.into(), position: glam::DVec3::ZERO };
            let weights = RowWeights { rows: rows.map(|row| (row, shown)).collect(), behind: 0.0, pixels: 1.0 };
            builder.add(photograph, &weights).expect("few photographs");
        };
        add("a", 1..1600, 1.0);
        add("b", 1..1600, 1.0);
        add("c", 1..801, 6.0);
        builder.finish().expect("few entries")
    }

    #[test]
    fn cells_are_drawn_by_shares_and_their_rows_stay_together() {
        let lottery = WeavingSecret::new([3; 32]).lottery();
        let lots = Lots::draw(&Sheet, &table(), &[0, 0, 1], &lottery, 1);
        assert_eq!((lots.numbers.len(), lots.owners.len()), (1600, 1600));
        let count = |rows: std::ops::Range<usize>, owner: u16| {
            rows.filter(|row| lots.owners[lots.of_row[*row] as usize] == owner).count()
        };
        // Three quarters of 800 with a deviation of 12; the others are all the first one's.
        assert!(count(1..801, 1).abs_diff(600) < 60, "{}", count(1..801, 1));
        assert_eq!([count(801..1600, 0), count(801..1600, 1), count(1600..1601, UNOWNED)], [799, 0, 1]);

        let lots = Lots::draw(&Sheet, &table(), &[0, 0, 1], &lottery, 4);
        assert_eq!(lots.numbers.len(), 100);
        let cell = |x: usize, y: usize| lots.of_row[1 + x + 40 * y];
        assert_eq!(cell(4, 8), cell(7, 11));
        assert!(cell(4, 8) != cell(8, 8) && cell(4, 8) != cell(4, 7));
    }

    #[test]
    fn a_lot_falls_by_its_share() {
        let shares = [1.0, 0.0, 3.0];
        assert_eq!([0.0, 0.24, 0.26, 0.999].map(|lot| drawn(&shares, lot)), [0, 0, 2, 2]);
        assert_eq!(drawn(&[0.0, 0.0], 0.3), UNOWNED);
    }
}
