//! The ledger of measurements: what was measured, against which target, by
//! which command, from which seed and commit, on what machine.
//!
//! Reports are generated from the ledger and never written by hand, so a figure
//! without its origin cannot get into them, and a missed target stays visible.

pub mod chart;
mod ledger;
mod markdown;
mod notes;
mod origin;
pub mod sheet;
pub mod sound;
pub mod table;
mod timing;

pub use ledger::{Ledger, LedgerError, Row, Target, TargetOp};
pub use notes::Notes;
pub use origin::{commit, machine, today};
pub use timing::{Stopwatch, median};
