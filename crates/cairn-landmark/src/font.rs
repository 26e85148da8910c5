//! The initials on emblems: capital letters of five by seven dots. Owners' emblems are what trained marks hide, so that
//! their dots stay as they are.

/// Dots down.
pub const LINE: usize = 7;

/// Rows from the top; in each the highest of five bits is the left dot.
const LETTERS: [(char, [u8; 7]); 26] = [
    ('A', [14, 17, 17, 31, 17, 17, 17]),
    ('B', [30, 17, 17, 30, 17, 17, 30]),
    ('C', [14, 17, 16, 16, 16, 17, 14]),
    ('D', [30, 17, 17, 17, 17, 17, 30]),
    ('E', [31, 16, 16, 30, 16, 16, 31]),
    ('F', [31, 16, 16, 30, 16, 16, 16]),
    ('G', [14, 17, 16, 23, 17, 17, 15]),
    ('H', [17, 17, 17, 31, 17, 17, 17]),
    ('I', [14, 4, 4, 4, 4, 4, 14]),
    ('J', [7, 2, 2, 2, 2, 18, 12]),
    ('K', [17, 18, 20, 24, 20, 18, 17]),
    ('L', [16, 16, 16, 16, 16, 16, 31]),
    ('M', [17, 27, 21, 21, 17, 17, 17]),
    ('N', [17, 25, 21, 19, 17, 17, 17]),
    ('O', [14, 17, 17, 17, 17, 17, 14]),
    ('P', [30, 17, 17, 30, 16, 16, 16]),
    ('Q', [14, 17, 17, 17, 21, 18, 13]),
    ('R', [30, 17, 17, 30, 20, 18, 17]),
    ('S', [15, 16, 16, 14, 1, 1, 30]),
    ('T', [31, 4, 4, 4, 4, 4, 4]),
    ('U', [17, 17, 17, 17, 17, 17, 14]),
    ('V', [17, 17, 17, 17, 17, 10, 4]),
    ('W', [17, 17, 17, 21, 21, 27, 17]),
    ('X', [17, 17, 10, 4, 10, 17, 17]),
    ('Y', [17, 17, 10, 4, 4, 4, 4]),
    ('Z', [31, 1, 2, 4, 8, 16, 31]),
];

/// Whether dot (`x`, `y`) of a capital letter, from its top left, is inked; outside of the five by seven dots nothing is.
pub fn inked(letter: char, x: usize, y: usize) -> bool {
    let rows = LETTERS.iter().find(|(other, _)| *other == letter).map(|(_, rows)| *rows);
    x < 5 && y < LINE && rows.is_some_and(|rows| rows[y] >> (4 - x) & 1 == 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_are_distinct_and_fit() {
        for (i, (a, rows)) in LETTERS.iter().enumerate() {
            assert!(rows.iter().all(|r| *r < 32), "{a} is wider than five dots");
            for (b, others) in &LETTERS[i + 1..] {
                assert!(a != b && rows != others, "{a} and {b} look the same");
            }
        }
        assert!(inked('L', 0, 0) && !inked('L', 1, 0) && inked('L', 4, 6) && !inked('L', 5, 6));
    }
}
