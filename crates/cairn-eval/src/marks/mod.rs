//! Marks of captures: trained, judged on views that no training saw, and reported.

pub mod attack;
pub mod exchange;
pub mod judge;
pub mod judged;
pub mod kept;
pub mod registered;
pub mod report;
pub mod run;
pub mod unmarked;
