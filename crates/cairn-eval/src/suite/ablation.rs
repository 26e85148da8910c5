//! Suite `ablation`: fern, or the captures that are named, marked with a part of the method switched off or replaced at a
//! time. What training skips is compared with the same not skipped, trained in one run.

use cairn_mark::{CarrierKind, DensityKind, Guidance, LossKind, MaskKind, Recipe};
use cairn_nn::Memory;

use crate::args::Args;
use crate::captures::Name;
use crate::children::Children;
use crate::file;
use crate::marks::report;
use crate::marks::run::{Outcome, Owners, Run, Variant, cases};
use crate::rows::Rows;

/// The whole recipe of the paper, the rows of its table of ablations, three values of alpha, the other losses, the paper's
/// carrier with its densities as they are and free and with the mask of the authors' code, what the paper does without,
/// and what training skips, not skipped. Without a classifier nothing but recovery can move marks, so that *recovery moves
/// marks* is what that row is to be compared with.
const ABLATIONS: [Variant; 25] = [
    row("full", |_| ()),
    row("the paper's recipe", |m| *m = Recipe::paper()),
    row("no classifier", |m| (m.guidance, m.recover_moves_marks) = (Guidance::NoClassifier, true)),
    row("recovery moves marks", |m| m.recover_moves_marks = true),
    row("classifier not guiding", |m| m.guidance = Guidance::Unguided),
    row("no mask", |m| m.mask = MaskKind::None),
    row("binary mask at 0.5", |m| (m.mask, m.mask_share) = (MaskKind::Binary, 0.5)),
    row("binary mask at 0.9", |m| (m.mask, m.mask_share) = (MaskKind::Binary, 0.9)),
    row("alpha 0", |m| m.mask_alpha = 0.0),
    row("alpha 1", |m| m.mask_alpha = 1.0),
    row("alpha 5", |m| m.mask_alpha = 5.0),
    row("squared recovery", |m| m.loss = LossKind::Squared),
    row("absolute picture loss", |m| m.picture_loss = LossKind::Absolute),
    row("no budget", |m| m.budget = false),
    row("no memory", no_memory),
    row("no noise", |m| m.noisy_share = 0.0),
    row("settled views as often", |m| m.easy_view_share = 1.0),
    row("to the last step", |m| m.enough_ssim = 10.0),
    row("two dozen views", |m| m.views_apart_deg = 180.0),
    row("unused heads", |m| m.unused_heads = true),
    Variant { name: "two owners", change: |_| (), owners: Owners::Two },
    Variant { name: "two owners, one of them later", change: |_| (), owners: Owners::OneAndAnother },
    row("harmonics", |m| m.carrier = CarrierKind::Harmonics),
    row("harmonics, free density", |m| (m.carrier, m.density) = (CarrierKind::Harmonics, DensityKind::Free)),
    row("group mask, harmonics", |m| (m.carrier, m.mask) = (CarrierKind::Harmonics, MaskKind::PerCoefficientGroup)),
];

/// The case's owners under other settings.
const fn row(name: &'static str, change: fn(&mut Recipe)) -> Variant {
    Variant { name, change, owners: Owners::Case }
}

fn no_memory(mark: &mut Recipe) {
    (mark.detector.memory, mark.audio.memory, mark.text.memory) = (Memory::None, Memory::None, Memory::None);
}

/// Measures the captures that were asked for (fern where none was), each row of the ablations.
///
/// # Errors
/// For captures and rows that are not there, and whatever goes wrong in a training.
pub async fn measure(args: &Args, rows: &mut Rows) -> anyhow::Result<()> {
    let wanted = wanted(&args.rows)?;
    let cases = cases(if args.cases.is_empty() { &[Name::Fern] } else { &args.cases });
    let captures = args.captures_with(&cases.iter().map(|case| case.name).collect::<Vec<_>>())?;
    let pictures = args.pictures()?;
    file::make_folder(&args.out)?;
    let children = Children::default();
    for case in cases {
        let mut outcomes: Vec<(&str, Outcome)> = Vec::new();
        for variant in &wanted {
            let mut run = Run::new(args, case, &captures, &pictures, variant)?;
            run.thorough = false;
            let name = run.name.clone();
            let work = move |children: &Children| {
                let base = run.base(children)?;
                run.outcome(base, children)
            };
            let outcome = children.unless_stopped(work).await?;
            report::add_renders(rows, &name, &outcome);
            outcomes.push((variant.name, outcome));
            add_skips(rows, &format!("{}, skips", args.case_name(case.name.as_str())), &outcomes);
            rows.save(args)?;
        }
    }
    println!("contact sheets and reliability tables in {}", args.out.display());
    Ok(())
}

/// The ablations that `rows` names, all where it is empty.
fn wanted(rows: &[String]) -> anyhow::Result<Vec<Variant>> {
    let names = ABLATIONS.map(|variant| variant.name);
    if let Some(other) = rows.iter().find(|row| !names.contains(&row.as_str())) {
        anyhow::bail!("suite `ablation` has no row `{other}`; its rows are {}", names.join(", "));
    }
    let is_wanted = |variant: &Variant| rows.is_empty() || rows.iter().any(|row| row == variant.name);
    Ok(ABLATIONS.into_iter().filter(is_wanted).collect())
}

/// What is skipped, the row that trains with it and the one that trains without.
const SKIPS: [(&str, &str, &str); 5] = [
    ("settled views come up less often", "full", "settled views as often"),
    ("training ends when recovery has converged", "full", "to the last step"),
    ("only used heads are built", "full", "unused heads"),
    ("an owner who comes later is added to what is trained", "two owners, one of them later", "two owners"),
    // Another model as well: what densities would have learnt is not learnt.
    ("densities stay, so that ray weights are worked out once", "harmonics", "harmonics, free density"),
];

/// Adds, under case `name`, what each skip saves and costs that the last of `outcomes` is about, where the row that it
/// is compared with is among them.
fn add_skips(rows: &mut Rows, name: &str, outcomes: &[(&str, Outcome)]) {
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

#[cfg(test)]
mod tests {
    use cairn_scene::SceneKind;

    use super::*;
    use crate::settings;

    #[test]
    fn rows_are_chosen_by_name_in_their_order_and_a_wrong_name_says_which_there_are() {
        let named = |rows: &[&str]| {
            wanted(&rows.iter().map(|row| (*row).to_owned()).collect::<Vec<_>>())
                .map(|all| all.into_iter().map(|variant| variant.name).collect::<Vec<_>>())
        };
        assert_eq!(named(&[]).unwrap(), ABLATIONS.map(|variant| variant.name));
        assert_eq!(named(&["two dozen views", "full"]).unwrap(), ["full", "two dozen views"]);
        let error = named(&["full", "no masc"]).unwrap_err().to_string();
        assert!(error.contains("`no masc`") && error.contains("no mask, binary mask at 0.5"), "{error}");
    }

    #[test]
    fn what_the_classifier_is_for_is_all_that_its_rows_switch() {
        let mark = |name| {
            let mut mark = Recipe::default();
            (ABLATIONS.into_iter().find(|variant| variant.name == name).unwrap().change)(&mut mark);
            mark
        };
        let guided = |mark: Recipe| Recipe { guidance: Guidance::Guided, ..mark };
        assert_eq!(guided(mark("classifier not guiding")), mark("full"));
        assert_eq!(guided(mark("no classifier")), mark("recovery moves marks"));
    }

    #[test]
    fn every_row_is_accepted_over_every_kind_of_scene_and_is_another() {
        for kind in [SceneKind::ForwardFacing, SceneKind::Bounded, SceneKind::Unbounded] {
            for quick in [false, true] {
                let mut seen: Vec<(&str, Owners, Recipe)> = Vec::new();
                for Variant { name, change, owners } in ABLATIONS {
                    let mut mark = settings::of(kind, quick, false).mark;
                    change(&mut mark);
                    mark.validate().unwrap_or_else(|e| panic!("{name}, {kind:?}: {e}"));
                    let same = seen.iter().find(|(_, whose, other)| (*whose, other) == (owners, &mark));
                    assert!(same.is_none(), "{name} is the same as {same:?}");
                    seen.push((name, owners, mark));
                }
            }
        }
    }
}
