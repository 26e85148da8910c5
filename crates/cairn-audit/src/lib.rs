//! Verifies owner records, without trusting whoever kept them.
//!
//! Reads and never writes; shares with the registry only the formats, not a line of
//! what admits or stores records. [`audit`] takes what is in hand, an
//! envelope at least, and answers with a [`Report`]: findings with stable codes, each naming the
//! thing, what was expected, what was found and what to do, and one of three outcomes.
//! [`audit_answer`] does the same for a complete answer of the registry's.
//! Never a bare yes or no: "the signature is good" and "this is who you think it is"
//! are different answers.

mod answer;
mod check;
mod code;
mod evidence;
mod later;
mod report;

pub use answer::{AnswerReport, RecordWorth, Standing, audit_answer};
pub use check::audit;
pub use code::Code;
pub use evidence::{
    Bundle, Evidence, EvidenceError, FileInHand, HiddenSignalInHand, LogView, PhotographsInHand, RecordInHand,
};
pub use report::{Finding, Freshness, Outcome, Report, Severity};
