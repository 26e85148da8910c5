//! What was measured on a capture.

use std::fmt;

use super::score::Scored;
use super::serve::Served;
use super::tradeoff::Tradeoff;
use super::train::Trained;

/// A share of the configured steps: `2^eighths / 8` of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Share {
    eighths: u64,
}

impl Share {
    /// All of the configured steps.
    pub const WHOLE: Self = Self { eighths: 8 };

    /// An eighth, a quarter, half, all, and twice as many where asked for.
    pub fn budgets(long: bool) -> Vec<Self> {
        [1, 2, 4, 8, 16].into_iter().filter(|e| long || *e <= 8).map(|eighths| Self { eighths }).collect()
    }

    /// That share of `steps`, one at least.
    pub fn of(self, steps: u64) -> u64 {
        (steps * self.eighths).div_ceil(8).max(1)
    }

    /// As it is said of a training.
    pub fn of_the_steps(self) -> String {
        match self.eighths {
            8 => "all steps".to_owned(),
            16 => "twice the steps".to_owned(),
            _ => format!("{self} of the steps"),
        }
    }
}

impl fmt::Display for Share {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.eighths {
            whole if whole % 8 == 0 => write!(f, "{}", whole / 8),
            part => write!(f, "1/{}", 8 / part),
        }
    }
}

/// A training and its score.
pub struct Budget {
    /// Of the configured steps.
    pub share: Share,
    /// How it went.
    pub trained: Trained,
    /// What its renders are worth.
    pub scored: Scored,
}

/// Everything about a capture.
pub struct Outcome {
    /// One training each, fewest steps first.
    pub budgets: Vec<Budget>,
    /// The field of all the steps, served.
    pub served: Served,
    /// The same, under other limits; none where they were not asked for.
    pub tradeoffs: Vec<Tradeoff>,
}

impl Outcome {
    /// The training with all the configured steps.
    pub fn whole(&self) -> Option<&Budget> {
        self.budgets.iter().find(|b| b.share == Share::WHOLE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_said_and_taken() {
        let said: Vec<String> = Share::budgets(true).iter().map(Share::to_string).collect();
        assert_eq!(said, ["1/8", "1/4", "1/2", "1", "2"]);
        let of: Vec<String> = Share::budgets(true).iter().map(|s| s.of_the_steps()).collect();
        assert_eq!(of[2..], ["1/2 of the steps", "all steps", "twice the steps"]);
        let taken: Vec<u64> = Share::budgets(true).iter().map(|s| s.of(1000)).collect();
        assert_eq!(taken, [125, 250, 500, 1000, 2000]);
        assert_eq!(Share::budgets(false)[0].of(1), 1);
        assert_eq!(Share::budgets(false).last(), Some(&Share::WHOLE));
    }
}
