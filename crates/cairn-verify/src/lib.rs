//! Verifies owner records, without trusting whoever kept them.
//!
//! Reads and never writes; shares with the registry only the formats, not a line of
//! what admits or stores records. [`audit`] takes what is in hand, an
//! envelope at least, and answers with a [`Report`]: findings with stable codes, each naming the
//! thing, what was expected, what was found and what to do, and one of three outcomes.
//! [`audit_store`] and [`audit_folders`] do the same for a whole data folder, [`follow`] for a log
//! that is reached over any [`Fetch`], [`audit_answer`] for a complete answer of the registry's.
//! Never a bare yes or no: "the signature is good" and "this is who you think it is"
//! are different answers.

mod answer;
mod bounded;
mod check;
mod code;
mod evidence;
mod folders;
mod follow;
mod heirs;
mod later;
mod policy;
mod report;
mod state;
mod store;

pub use answer::{
    AnswerReport, Question, RecordWorth, SharesReport, Standing, audit_answer, audit_answer_to, audit_shares,
    audit_shares_to,
};
pub use check::audit;
pub use code::{Code, Severity};
pub use evidence::{Bundle, Evidence, EvidenceError, FileInHand, LogView, RecordInHand};
pub use folders::audit_folders;
pub use follow::{
    CONTRADICTION, Contradiction, EvidenceReport, Fetch, FollowError, FollowOptions, FollowReport, Followed,
    MAX_NEW_ENTRIES, audit_evidence, follow,
};
pub use report::{Finding, Freshness, Outcome, Report};
pub use store::{Class, Stock, StoreError, StoreOptions, StoreReport, audit_store};
