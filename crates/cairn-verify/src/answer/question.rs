//! What was asked, for who holds an answer to it.

use cairn_log::format::{Answer, Digest};

use crate::{code::Code, report::Findings};

/// What was asked: an answer says itself what it answers, and whoever asked knows better.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Question {
    /// The scene's name.
    pub scene: String,
    /// SHA-256 of the photograph asked about; none for the whole scene.
    pub view: Option<Digest>,
}

/// Whether an answer is to what was asked.
pub(super) fn check(answer: &Answer, asked: &Question, findings: &mut Findings) {
    let said = |scene: &str, view: Option<&Digest>| match view {
        Some(view) => format!("view {view} of scene {scene:?}"),
        None => format!("scene {scene:?}"),
    };
    let (expected, got) = (said(&asked.scene, asked.view.as_ref()), said(&answer.scene, answer.view.as_ref()));
    if expected == got {
        findings.add(Code::AnswerQuestionMatch, "answer, fields scene and view", "", got);
    } else {
        findings.add(Code::AnswerQuestionMismatch, "answer, fields scene and view", expected, got);
    }
}
