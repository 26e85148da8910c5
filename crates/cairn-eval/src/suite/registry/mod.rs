//! Suite `registry`: what the log of owner records costs, and whether any is lost.

pub mod grown;
pub mod load;
pub mod made;
mod suite;
pub mod victim;

pub use suite::measure;
