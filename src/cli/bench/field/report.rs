//! A capture's rows for the ledger.

use cairn_eval::Target;

use super::case::{Case, SERVING_MIB, TRAINING_MIB};
use super::outcome::{Budget, Outcome, Share};
use super::tradeoff::{Error, FINE_STEP, Tradeoff, Varied};
use crate::cli::bench::rows::Rows;

/// Points of the rays-against-error curves that are worth a row each.
const KEY_POINTS: [(Varied, f64); 6] = [
    (Varied::Nothing, 0.0),
    (Varied::Step, 0.25),
    (Varied::Step, 1.0),
    (Varied::Transmittance, 1e-2),
    (Varied::Alpha, 1e-3),
    (Varied::Storage, 8.0),
];

/// Adds the rows of `outcome` as case `name`.
pub fn rows(rows: &mut Rows, name: &str, case: &Case, outcome: &Outcome) {
    let Some(whole) = outcome.whole() else { return };
    quality(rows, name, case, whole);
    let (trained, served) = (&whole.trained, &outcome.served);
    rows.add(name, "training", trained.seconds, "s", Some(Target::at_most(case.seconds)));
    rows.add(name, "training steps", trained.steps as f64, "", None);
    rows.add(name, "training rays/s", trained.rays_per_s, "rays/s", None);
    rows.add(name, "rows of the grid", trained.rows as f64, "", None);
    rows.add(name, "stored field", trained.stored_mib, "MiB", None);
    if let Some(error) = trained.stored_error {
        errors(rows, name, ("stored in half precision", " against f32"), error);
    }
    let wanted = case.rays_per_s.map(Target::at_least);
    rows.add(name, "rendering rays/s", served.rays_per_s, "rays/s", wanted);
    memory(rows, name, "peak memory, training", trained.peak_mib, TRAINING_MIB);
    memory(rows, name, "peak memory, serving", served.peak_mib, SERVING_MIB);
    for budget in outcome.budgets.iter().filter(|b| b.share != Share::WHOLE) {
        let share = budget.share.of_the_steps();
        rows.add(name, &format!("{}, {share}", psnr(budget)), budget.scored.psnr_db, "dB", None);
        rows.add(name, &format!("training, {share}"), budget.trained.seconds, "s", None);
    }
    for found in outcome.tradeoffs.iter().filter(|t| is_key(t)) {
        tradeoff(rows, name, found);
    }
}

fn quality(rows: &mut Rows, name: &str, case: &Case, whole: &Budget) {
    let scored = &whole.scored;
    let half = if scored.right_half { ", right half" } else { "" };
    rows.add(name, psnr(whole), scored.psnr_db, "dB", Some(Target::at_least(case.psnr_db)));
    rows.add(name, &format!("SSIM{half}"), scored.ssim, "", None);
    match (&scored.mask, case.mask_psnr_db) {
        (Some(mask), wanted) => {
            if mask.views < scored.views {
                println!(
                    "{name}: {} of {} views have none of their mask in the part that is scored",
                    scored.views - mask.views,
                    scored.views
                );
            }
            rows.add(name, &format!("PSNR on the mask{half}"), mask.psnr_db, "dB", wanted.map(Target::at_least));
        }
        (None, Some(_)) => println!("{name}: SKIPPED PSNR on the mask: the capture has no folder `masks`"),
        (None, None) => {}
    }
}

/// What a budget's PSNR is called: halves of pictures are not compared with whole ones.
fn psnr(budget: &Budget) -> &'static str {
    if budget.scored.right_half { "PSNR, right half" } else { "PSNR" }
}

fn memory(rows: &mut Rows, name: &str, metric: &str, mib: Option<f64>, most: f64) {
    match mib {
        Some(mib) => rows.add(name, metric, mib, "MiB", Some(Target::at_most(most))),
        None => println!("{name}: SKIPPED {metric}: this system has no VmHWM in /proc/self/status"),
    }
}

fn is_key(found: &Tradeoff) -> bool {
    let shipped = found.shipped && found.varied == Varied::Step;
    shipped || (!found.shipped && KEY_POINTS.contains(&(found.varied, found.value)))
}

fn tradeoff(rows: &mut Rows, name: &str, found: &Tradeoff) {
    let what = match found.varied {
        _ if found.shipped => "limits as shipped".to_owned(),
        Varied::Nothing => "nothing left out".to_owned(),
        Varied::Step => format!("step {} voxels", found.label),
        Varied::Transmittance => format!("stop at {}", found.label),
        Varied::Alpha => format!("alpha from {}", found.label),
        Varied::Storage => format!("stored as {}", found.label),
    };
    // What is left out shows at the same step; a step's own error against a much finer one.
    let finer = format!(" against {FINE_STEP} voxels");
    if found.varied != Varied::Step || found.shipped {
        errors(rows, name, (&what, ""), found.own);
    }
    if found.varied == Varied::Step {
        errors(rows, name, (&what, &finer), found.fine);
    }
    rows.add(name, &format!("{what}: rendering"), found.rays_per_s, "rays/s", None);
}

/// Rows of how far pictures are off, 8-bit levels: of `what`, `against` what.
fn errors(rows: &mut Rows, name: &str, (what, against): (&str, &str), error: Error) {
    rows.add(name, &format!("{what}: max error{against}"), error.max, "levels", None);
    rows.add(name, &format!("{what}: RMS error{against}"), error.rms, "levels", None);
}
