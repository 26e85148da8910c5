//! A capture's rows for the ledger: means over its trainings, and the worst where a
//! mean could hide it.

use cairn_eval::Target;

use super::super::field::SERVING_MIB;
use super::case::{AUDIO_SNR_DB, COMBINED, Case, HARD, MILD, TEXT_CHARACTERS, UNMARKED};
use super::harm::Set;
use super::laid::{Laid, Told};
use super::permuted::Followed;
use super::scored::{Band, Harmed, Judged, Silent};
use super::{Marked, Outcome, What};
use crate::cli::bench::rows::Rows;
use cairn_service::query::report::{Measured, Recovery, Right};

/// Adds the rows of `outcome` as case `name`. What is asked depends on whether marks
/// were trained to last.
pub fn rows(rows: &mut Rows, name: &str, (case, what): (&Case, What), outcome: &Outcome) {
    let robust = outcome.robust;
    let Some(first) = outcome.runs.first().map(|run| &run.1) else { return };
    let judged = || outcome.runs.iter().map(|run| &run.1);
    let of = |f: &dyn Fn(&Judged) -> f64| mean(judged().map(f));
    // A mark that is to last is stronger; what it costs is shown, and asked of the other.
    let asked = |target: Target| (!robust && what == What::Marks).then_some(target);
    rows.add(name, "trainings", outcome.runs.len() as f64, "", None);
    rows.add(name, "held-out views", first.views as f64, "", None);
    rows.add(name, "base field PSNR", of(&|j| j.base_psnr_db), "dB", None);
    let change = of(&|j| j.marked_psnr_db - j.base_psnr_db);
    rows.add(name, "PSNR change by the mark", change, "dB", asked(Target::at_least(case.change_db)));
    // Views of nobody's cluster carry no mark, and would hide what one costs.
    let changes: Vec<f64> = judged().filter_map(|j| j.marked_change_db).collect();
    if !changes.is_empty() {
        let change = mean(changes.into_iter());
        rows.add(name, "PSNR change by the mark, marked views", change, "dB", asked(Target::at_least(case.change_db)));
    }
    rows.add(name, "SSIM change by the mark", of(&|j| j.marked_ssim - j.base_ssim), "", None);
    rows.add(name, "marked against base PSNR", of(&|j| j.kept_db), "dB", None);
    share(rows, name, "accuracy", judged().map(|j| j.classes), asked(Target::at_least(case.accuracy)));
    share(rows, name, "marks read", judged().map(|j| j.marks), None);
    hidden(rows, name, asked(Target::at_least(case.hidden_ssim)), (what, outcome));
    let trained = || outcome.runs.iter().map(|run| &run.0).collect();
    if what == What::Ablation {
        cost(rows, name, None, trained());
        return;
    }
    followed(rows, name, "a stranger's mark", judged().map(|j| j.followed));
    if let Some((_, judged)) = &outcome.permuted {
        share(rows, name, "permuted identities, trained anew: accuracy", std::iter::once(judged.classes), None);
        followed(rows, name, "permuted identities, trained anew", std::iter::once(judged.followed));
    }
    unmarked(rows, name, &judged().collect::<Vec<_>>());
    twins(rows, name, &judged().collect::<Vec<_>>());
    rows.add(name, "expected calibration error", of(&|j| j.calibration_error), "", None);
    let unharmed = of(&|j| j.calibration_error_unharmed);
    rows.add(name, "expected calibration error, renders not harmed", unharmed, "", None);
    bands(rows, name, "answers", judged().map(|j| &j.bands));
    bands(rows, name, "renders not harmed, answers", judged().map(|j| &j.bands_unharmed));
    by_closer_look(rows, name, "answers", judged().map(|j| j.by_closer_look));
    by_closer_look(rows, name, "renders not harmed, answers", judged().map(|j| j.by_closer_look_unharmed));
    if what == What::Honesty {
        cost(rows, name, None, trained());
        return;
    }
    laid(rows, name, &outcome.runs.iter().filter_map(|run| run.1.laid.as_ref()).collect::<Vec<_>>());
    for at in 0..first.harms.len() {
        let all: Vec<&Harmed> = judged().filter_map(|j| j.harms.get(at)).collect();
        harm(rows, name, robust, &all);
    }
    if let Some(base) = &outcome.base {
        rows.add(name, "base field, training", base.seconds, "s", None);
    }
    cost(rows, name, asked(Target::at_most(case.seconds)), trained());
    if let Some(served) = &outcome.served {
        rows.add(name, "rendering with marks", served.rays_per_s, "rays/s", None);
        rows.add(name, "reading a picture", served.reading_s, "s", None);
        rows.add(name, "reading a picture without a mark", served.reading_unmarked_s, "s", None);
        if let Some(peak) = served.peak_mib {
            rows.add(name, "peak memory, serving with marks", peak, "MiB", Some(Target::at_most(SERVING_MIB)));
        }
    }
}

/// The reliability table: how many answers there are of each confidence, and how often they are right.
fn bands<'a>(rows: &mut Rows, name: &str, what: &str, of: impl Iterator<Item = &'a Vec<Band>> + Clone) {
    let froms: Vec<f64> = of.clone().next().into_iter().flatten().map(|band| band.from).collect();
    for (at, from) in froms.iter().enumerate() {
        let right = of.clone().filter_map(|bands| bands.get(at)).map(|band| band.right);
        let to = froms.get(at + 1).unwrap_or(&1.0);
        let how = format!("{what} with a confidence of {from} to {to}");
        rows.add(name, &how, right.clone().map(|right| right.asked as f64).sum(), "", None);
        share(rows, name, &format!("{how}: right"), right, None);
    }
}

/// How many answers only a closer look gave, and how often they are right: owners, all of them.
fn by_closer_look(rows: &mut Rows, name: &str, what: &str, of: impl Iterator<Item = Right> + Clone) {
    rows.add(name, &format!("{what} by a closer look"), of.clone().map(|right| right.asked as f64).sum(), "", None);
    share(rows, name, &format!("{what} by a closer look: right"), of, None);
}

/// Pictures without a mark that are called so, of each kind, and those of all kinds that are not. Every detector is asked about
/// the same pictures, each in several forms.
fn unmarked(rows: &mut Rows, name: &str, judged: &[&Judged]) {
    let kinds = judged.first().map_or(0, |first| first.unmarked.len());
    for at in 0..kinds {
        let silent = judged.iter().filter_map(|j| j.unmarked.get(at)).map(|s| s.silent);
        let Silent { what, pictures, .. } = &judged[0].unmarked[at];
        rows.add(name, &format!("distinct pictures: {what}"), *pictures as f64, "", None);
        rows.add(name, &format!("answers: {what}"), silent.clone().map(|s| s.asked as f64).sum(), "", None);
        share(rows, name, &format!("unmarked: {what}"), silent, Some(Target::at_least(1.0)));
    }
    let all = || judged.iter().flat_map(|j| &j.unmarked).map(|s| s.silent);
    let made_up = all().map(|s| Right { right: s.asked - s.right, asked: s.asked });
    let pictures = judged.iter().map(|j| j.unmarked_pictures).min().unwrap_or(0) as f64;
    let target = Some(Target::at_least(UNMARKED));
    rows.add(name, "distinct pictures without a mark, each training", pictures, "", target);
    let answers = all().map(|s| s.asked as f64).sum();
    rows.add(name, "answers on pictures without a mark, all trainings", answers, "", None);
    share(rows, name, "false owners among pictures without a mark", made_up, Some(Target::at_most(0.0)));
    let empty = judged.iter().flat_map(|j| &j.unmarked).map(|s| s.empty);
    share(rows, name, "nothing recovered from pictures without a mark", empty, Some(Target::at_least(1.0)));
}

/// What is said of theta_0's renders after each distortion, in all its forms: an owner of one of them is made up.
fn twins(rows: &mut Rows, name: &str, judged: &[&Judged]) {
    let harms = judged.first().map_or(0, |first| first.harms.len());
    let all = || judged.iter().flat_map(|j| &j.harms).map(|h| h.twins);
    for at in 0..harms {
        let how = format!("{}: the same views without a mark are unmarked", judged[0].harms[at].name);
        let of = judged.iter().filter_map(|j| j.harms.get(at)).map(|h| h.twins);
        share(rows, name, &how, of, Some(Target::at_least(1.0)));
    }
    if harms > 0 {
        let made_up = all().map(|twins| (twins.asked - twins.right) as f64).sum();
        let answers = all().map(|twins| twins.asked as f64).sum();
        rows.add(name, "answers on harmed views without a mark", answers, "", None);
        rows.add(name, "false owners, harmed views without a mark", made_up, "", Some(Target::at_most(0.0)));
    }
}

/// Whose identity is told where mark and view speak for different ones; nothing with one identity.
fn followed(rows: &mut Rows, name: &str, how: &str, of: impl Iterator<Item = Followed> + Clone) {
    type Share = fn(Followed) -> Right;
    let shares: [(&str, Share); 5] = [
        ("the mark decides", |f| f.mark),
        ("the view decides", |f| f.view),
        ("the hidden picture is the mark's", |f| f.hidden_mark),
        ("the hidden picture is the view's", |f| f.hidden_view),
        ("the same views without a mark are unmarked", |f| f.unmarked),
    ];
    for (what, of_one) in shares {
        share(rows, name, &format!("{how}: {what}"), of.clone().map(of_one), None);
    }
}

/// What was recovered, of every kind that is hidden, and what the detector says when told the class.
fn hidden(rows: &mut Rows, name: &str, target: Option<Target>, (suite, outcome): (What, &Outcome)) {
    type Measure = fn(&Recovery) -> Option<Measured>;
    let asked = |target: Target| (!outcome.robust && suite == What::Marks).then_some(target);
    // Of several identities it is asked of each.
    let identities = outcome.runs.iter().map(|run| run.1.identities.len()).max().unwrap_or(0);
    let of_all = target.filter(|_| identities <= 1);
    let measures: [(&str, &str, Measure, Option<Target>); 5] = [
        ("hidden SSIM", "", |r| r.picture_ssim, of_all),
        ("hidden sound, SNR", "dB", |r| r.audio_snr_db, asked(Target::at_least(AUDIO_SNR_DB))),
        ("hidden sound, log-spectral distance", "dB", |r| r.audio_lsd_db, None),
        ("hidden text, characters", "", |r| r.text_characters, asked(Target::at_least(TEXT_CHARACTERS))),
        ("hidden text, bits", "", |r| r.text_bits, None),
    ];
    for (what, unit, measure, least) in measures {
        let all: Vec<Measured> = outcome.runs.iter().flat_map(|run| &run.1.identities).filter_map(measure).collect();
        let found: Vec<f64> = all.iter().filter_map(|m| m.recovered).collect();
        if found.is_empty() {
            continue;
        }
        rows.add(name, what, mean(found.iter().copied()), unit, least);
        if what == "hidden SSIM" {
            let worst = found.iter().copied().fold(f64::INFINITY, f64::min);
            rows.add(name, "hidden SSIM, worst identity", worst, unit, None);
            each_identity(rows, name, target, outcome);
        }
        let base = mean(all.iter().filter_map(|m| m.forced_base));
        rows.add(name, &format!("{what}, forced on base renders"), base, unit, None);
        rows.add(name, &format!("{what}, forced on grey"), mean(all.iter().map(|m| m.forced_grey)), unit, None);
        rows.add(name, &format!("{what}, forced on noise"), mean(all.iter().map(|m| m.forced_noise)), unit, None);
    }
}

/// Each identity's hidden SSIM, its mean over the trainings; nothing where there is but one.
fn each_identity(rows: &mut Rows, name: &str, target: Option<Target>, outcome: &Outcome) {
    let identities = outcome.runs.iter().map(|run| run.1.identities.len()).max().unwrap_or(0);
    for at in (0..identities).filter(|_| identities > 1) {
        let of = outcome.runs.iter().filter_map(|run| run.1.identities.get(at));
        let found: Vec<f64> = of.filter_map(|r| r.picture_ssim).filter_map(|m| m.recovered).collect();
        if !found.is_empty() {
            rows.add(name, &format!("hidden SSIM, identity {}", at + 1), mean(found.into_iter()), "", target);
        }
    }
}

/// What comes of laying pictures over the field.
fn laid(rows: &mut Rows, name: &str, all: &[&Laid]) {
    type Part = fn(&Laid) -> Told;
    let parts: [(&str, Part); 2] = [("where it was rendered", |l| l.known), ("camera searched for", |l| l.searched)];
    for (how, part) in parts {
        let told = || all.iter().map(|laid| part(laid));
        let how = format!("laid over the field, {how}");
        share(rows, name, &format!("{how}: accuracy"), told().map(|t| t.classes), None);
        share(rows, name, &format!("{how}: marks stand out"), told().map(|t| t.found), None);
        share(rows, name, &format!("{how}: nothing stands out where no mark is"), told().map(|t| t.silent), None);
        let pictures: usize = told().map(|t| t.pictures).sum();
        if pictures > 0 {
            let seconds: f64 = told().map(|t| t.seconds).sum();
            rows.add(name, &format!("{how}: a picture"), seconds / pictures as f64, "s", None);
        }
    }
    for (at, (harm, _)) in all.first().iter().flat_map(|laid| laid.harmed.iter().enumerate()) {
        let told = || all.iter().filter_map(|laid| laid.harmed.get(at)).map(|(_, told)| told);
        let how = format!("laid over the field after {harm}");
        share(rows, name, &format!("{how}: accuracy"), told().map(|t| t.classes), None);
        share(rows, name, &format!("{how}: marks stand out"), told().map(|t| t.found), None);
        share(rows, name, &format!("{how}: nothing stands out where no mark is"), told().map(|t| t.silent), None);
    }
}

fn harm(rows: &mut Rows, name: &str, robust: bool, all: &[&Harmed]) {
    let Some(first) = all.first() else { return };
    let (accuracy, ssim) = match first.set {
        Set::Mild => (MILD.0, Some(MILD.1)),
        Set::Hard => (HARD, None),
        Set::Combined => (COMBINED, None),
    };
    let asked = |least| robust.then(|| Target::at_least(least));
    share(rows, name, &format!("{}: accuracy", first.name), all.iter().map(|h| h.classes), asked(accuracy));
    // Accuracy counts renders without a mark as well: where few views have one, it says little of what is lost.
    share(rows, name, &format!("{}: marks read", first.name), all.iter().map(|h| h.marks), None);
    let found: Vec<f64> = all.iter().filter_map(|h| h.ssim).collect();
    if !found.is_empty() {
        let target = ssim.and_then(asked);
        rows.add(name, &format!("{}: hidden SSIM", first.name), mean(found.into_iter()), "", target);
    }
}

fn cost(rows: &mut Rows, name: &str, target: Option<Target>, runs: Vec<&Marked>) {
    rows.add(name, "stage 2", mean(runs.iter().map(|r| r.seconds)), "s", target);
    let processor: Vec<f64> = runs.iter().filter_map(|r| r.processor_s).collect();
    if !processor.is_empty() {
        rows.add(name, "stage 2, processor time", mean(processor.into_iter()), "s", None);
    }
    rows.add(name, "stage 2, of it ray weights", mean(runs.iter().map(|r| r.prepared_s)), "s", None);
    rows.add(name, "stage 2, steps", mean(runs.iter().map(|r| r.steps as f64)), "", None);
    let budgets: Vec<f64> = runs.iter().filter_map(|r| r.budget_db).collect();
    if !budgets.is_empty() {
        rows.add(name, "stage 2, marks kept below renders of the base field", mean(budgets.into_iter()), "dB", None);
    }
    // The latest tells what the budget waited for.
    if let Some(joined) = runs.iter().filter_map(|r| r.joined_at).max() {
        rows.add(name, "stage 2, steps until the detector joined, most", joined as f64, "", None);
    }
    let peak = runs.iter().filter_map(|r| r.peak_mib).fold(0.0, f64::max);
    if peak > 0.0 {
        rows.add(name, "stage 2, peak memory", peak, "MiB", None);
    }
}

/// The share of right answers over all trainings; nothing where none was asked for.
fn share(rows: &mut Rows, name: &str, metric: &str, of: impl Iterator<Item = Right>, target: Option<Target>) {
    let (right, asked) = of.fold((0, 0), |(r, a), of| (r + of.right, a + of.asked));
    if asked > 0 {
        rows.add(name, metric, right as f64 / asked as f64, "", target);
    }
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = values.fold((0.0, 0u32), |(s, n), v| (s + v, n + 1));
    sum / f64::from(n.max(1))
}

#[cfg(test)]
mod tests {
    use super::super::case;
    use super::*;
    use crate::cli::bench::Args;
    use crate::cli::bench::field::Name;
    use clap::Parser as _;
    use serde_json::Value;

    #[derive(clap::Parser)]
    struct Given {
        #[command(flatten)]
        args: Args,
    }

    /// The ledger's rows of what `runs` found, as the first case of `name` has them.
    fn ledger(name: Name, runs: Vec<Judged>) -> Vec<Value> {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("ledger.json");
        let args = Given::parse_from(["bench", "mark", "--ledger", path.to_str().unwrap()]).args;
        let runs = runs.into_iter().map(|judged| (Marked::default(), judged)).collect();
        let mut all = Rows::new(&args);
        rows(&mut all, "case", (case::wanted(&[name])[0], What::Marks), &Outcome { runs, ..Outcome::default() });
        all.save(&args).unwrap();
        serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap()
    }

    /// A figure and what it was to reach.
    fn figure(rows: &[Value], metric: &str) -> (f64, Option<f64>) {
        let row = rows.iter().find(|row| row["metric"] == metric).unwrap_or_else(|| panic!("no row {metric}"));
        (row["value"].as_f64().unwrap(), row["target"]["value"].as_f64())
    }

    #[test]
    fn an_owner_of_a_harmed_view_without_a_mark_is_counted_apart_from_accuracy() {
        let harmed = |name: &str, [classes, twins]: [[usize; 2]; 2]| {
            let [classes, twins] = [classes, twins].map(|[right, asked]| Right { right, asked });
            let marks = Right { right: classes.right - twins.right, asked: classes.asked - twins.asked };
            Harmed { name: name.into(), set: Set::Mild, classes, marks, twins, ssim: None }
        };
        // All marks are read, and three of ten views without one are somebody's as well; then five of six.
        let judged = |noise, jpeg| Judged {
            harms: vec![harmed("noise 0.02", noise), harmed("JPEG 50", jpeg)],
            ..Judged::default()
        };
        let rows = ledger(
            Name::Lego,
            vec![judged([[17, 20], [7, 10]], [[20, 20], [10, 10]]), judged([[7, 12], [1, 6]], [[12, 12], [6, 6]])],
        );
        let unmarked = |harm: &str| figure(&rows, &format!("{harm}: the same views without a mark are unmarked"));
        assert_eq!(figure(&rows, "noise 0.02: accuracy").0, 24.0 / 32.0);
        assert_eq!(figure(&rows, "noise 0.02: marks read").0, 1.0);
        assert_eq!([unmarked("noise 0.02"), unmarked("JPEG 50")], [(0.5, Some(1.0)), (1.0, Some(1.0))]);
        assert_eq!(figure(&rows, "answers on harmed views without a mark").0, 32.0);
        assert_eq!(figure(&rows, "false owners, harmed views without a mark"), (8.0, Some(0.0)));
    }

    #[test]
    fn pictures_are_counted_once_and_answers_each_time() {
        let silent = |what: &str, pictures, right, asked| {
            let right = Right { right, asked };
            Silent { what: what.into(), pictures, silent: right, empty: right }
        };
        // A picture that is of both kinds is one.
        let unmarked = vec![silent("photographs", 400, 1200, 1200), silent("renders", 500, 1485, 1500)];
        let judged = Judged { unmarked, unmarked_pictures: 899, ..Judged::default() };
        let rows = ledger(Name::Lego, vec![judged.clone(), judged]);
        let target = Some(UNMARKED);
        assert_eq!(figure(&rows, "distinct pictures without a mark, each training"), (899.0, target));
        assert_eq!(figure(&rows, "answers on pictures without a mark, all trainings"), (5400.0, None));
        assert_eq!(figure(&rows, "distinct pictures: renders").0, 500.0);
        assert_eq!(figure(&rows, "answers: renders").0, 3000.0);
        assert_eq!(figure(&rows, "unmarked: renders"), (0.99, Some(1.0)));
        assert_eq!(figure(&rows, "false owners among pictures without a mark"), (30.0 / 5400.0, Some(0.0)));
    }

    #[test]
    fn confidence_is_told_of_all_answers_and_of_those_on_renders_that_were_not_harmed() {
        let bands = |rights: [[usize; 2]; 2]| -> Vec<Band> {
            let of = [0.0, 0.99].into_iter().zip(rights);
            of.map(|(from, [right, asked])| Band { from, right: Right { right, asked } }).collect()
        };
        let judged = Judged {
            bands: bands([[3, 10], [80, 100]]),
            bands_unharmed: bands([[0, 0], [50, 50]]),
            calibration_error: 0.125,
            by_closer_look: Right { right: 3, asked: 4 },
            by_closer_look_unharmed: Right { right: 2, asked: 2 },
            ..Judged::default()
        };
        let rows = ledger(Name::Lego, vec![judged]);
        let told = |what: &str| figure(&rows, what).0;
        assert_eq!(told("answers with a confidence of 0 to 0.99: right"), 0.3);
        assert_eq!(told("answers with a confidence of 0.99 to 1: right"), 0.8);
        assert_eq!(told("renders not harmed, answers with a confidence of 0 to 0.99"), 0.0);
        assert_eq!(told("renders not harmed, answers with a confidence of 0.99 to 1"), 50.0);
        assert_eq!(told("renders not harmed, answers with a confidence of 0.99 to 1: right"), 1.0);
        assert_eq!(told("expected calibration error"), 0.125);
        assert_eq!((told("answers by a closer look"), told("answers by a closer look: right")), (4.0, 0.75));
        assert_eq!(told("renders not harmed, answers by a closer look: right"), 1.0);
    }

    #[test]
    fn a_hidden_picture_is_asked_of_each_identity_and_not_of_their_mean() {
        let recovery = |ssim: f64| {
            let measured = Measured { recovered: Some(ssim), forced_base: None, forced_grey: 0.0, forced_noise: 0.0 };
            let (picture_ssim, none) = (Some(measured), None);
            let (number, label, views) = (0, String::new(), 1);
            let (audio_snr_db, audio_lsd_db, text_characters, text_bits) = (none, none, none, none);
            Recovery { number, label, views, picture_ssim, audio_snr_db, audio_lsd_db, text_characters, text_bits }
        };
        let judged =
            |all: &[f64]| Judged { identities: all.iter().copied().map(recovery).collect(), ..Judged::default() };
        let rows = ledger(Name::Liberty, vec![judged(&[1.0, 0.75]), judged(&[1.0, 0.25])]);
        let least = Some(0.97);
        assert_eq!(figure(&rows, "hidden SSIM"), (0.75, None));
        assert_eq!(figure(&rows, "hidden SSIM, identity 1"), (1.0, least));
        assert_eq!(figure(&rows, "hidden SSIM, identity 2"), (0.5, least));
        let alone = ledger(Name::Lego, vec![judged(&[1.0])]);
        assert_eq!(figure(&alone, "hidden SSIM"), (1.0, Some(0.985)));
    }
}
