//! Shares against what retraining shows: who is left out, what that changes, what was foreseen, and how well the two agree.

pub mod foreseen;
pub mod groups;
pub mod rank;
pub mod truth;
