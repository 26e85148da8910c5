//! What training skips, against the same not skipped: the time that saves and the error it adds, as rows of
//! their own. Both are among the rows of suite `ablation`, trained in one run.

use super::Outcome;
use crate::cli::bench::rows::Rows;

/// What is skipped, the row that trains with it and the one that trains without.
const SKIPS: [(&str, &str, &str); 5] = [
    ("settled views come up less often", "full", "settled views as often"),
    ("training ends when recovery has converged", "full", "to the last step"),
    ("only heads that somebody uses are built", "full", "heads that nobody uses"),
    ("an owner who comes later is added to what is trained", "two owners, one of them later", "two owners"),
    // Another model as well: what densities would have learnt is not learnt.
    ("densities stay, so that ray weights are worked out once", "harmonics", "harmonics, free density"),
];

/// Adds, under case `name`, what each skip saves and costs that the last of `outcomes` is about, where the row that it
/// is compared with is among them.
pub fn rows(rows: &mut Rows, name: &str, outcomes: &[(&str, &Outcome)]) {
    let last = outcomes.last().map(|(row, _)| *row);
    let of = |row: &str| outcomes.iter().find(|(other, _)| *other == row).and_then(|(_, outcome)| figures(outcome));
    for (what, with, without) in
        SKIPS.into_iter().filter(|(_, with, without)| [Some(*with), Some(*without)].contains(&last))
    {
        let (Some(with), Some(without)) = (of(with), of(without)) else { continue };
        rows.add(name, &format!("{what}: saves"), without.seconds - with.seconds, "s", None);
        rows.add(name, &format!("{what}: share of the time saved"), 1.0 - with.seconds / without.seconds, "", None);
        if let Some((with, without)) = with.processor_s.zip(without.processor_s) {
            rows.add(name, &format!("{what}: saves processor time"), without - with, "s", None);
        }
        rows.add(name, &format!("{what}: adds to PSNR change"), with.change_db - without.change_db, "dB", None);
        rows.add(name, &format!("{what}: adds to accuracy"), with.accuracy - without.accuracy, "", None);
        if let Some((with, without)) = with.hidden_ssim.zip(without.hidden_ssim) {
            rows.add(name, &format!("{what}: adds to hidden SSIM"), with - without, "", None);
        }
    }
}

/// What two trainings are compared by.
struct Figures {
    seconds: f64,
    processor_s: Option<f64>,
    change_db: f64,
    accuracy: f64,
    hidden_ssim: Option<f64>,
}

/// Those of an outcome's only training.
fn figures(outcome: &Outcome) -> Option<Figures> {
    let (trained, judged) = outcome.runs.first()?;
    let found: Vec<f64> =
        judged.identities.iter().filter_map(|of| of.picture_ssim).filter_map(|measured| measured.recovered).collect();
    Some(Figures {
        seconds: trained.seconds,
        processor_s: trained.processor_s,
        change_db: judged.marked_psnr_db - judged.base_psnr_db,
        accuracy: judged.classes.right as f64 / judged.classes.asked.max(1) as f64,
        hidden_ssim: (!found.is_empty()).then(|| found.iter().sum::<f64>() / found.len() as f64),
    })
}
