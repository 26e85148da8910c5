//! A capture's rows: means over its trainings, and the worst where a mean could hide it.

use cairn_service::query::report::{Measured, Recovery, Right};

use super::attack::Set;
use super::judged::{Answers, Attacked, Band, Followed, Judged, Registered};
use super::run::{Case, Outcome};
use crate::marked::Marked;
use crate::results::Target;
use crate::rows::Rows;

/// Least accuracy and hidden SSIM under each mild attack, with robust training.
const MIN_MILD: (f64, f64) = (0.98, 0.90);
/// Least accuracy under each hard attack, with robust training.
const MIN_HARD: f64 = 0.92;
/// Least accuracy under all hard attacks together, with robust training.
const MIN_COMBINED: f64 = 0.90;
/// Least SNR of recovered sounds, dB.
const MIN_AUDIO_SNR_DB: f64 = 25.0;
/// Least share of recovered texts' characters.
const MIN_TEXT_CHARACTERS: f64 = 1.0;
/// Least different pictures without a mark that each detector is asked about.
const MIN_UNMARKED: f64 = 1000.0;
/// Most memory that serving a marked field may take, MiB.
const MAX_SERVING_MIB: f64 = 500.0;

/// What a case's rows are to reach, as far as it is not the same for all.
struct Wanted<'a> {
    /// `None` where nothing is asked: marks that are to last are stronger, and an ablation only shows.
    case: Option<&'a Case>,
}

impl Wanted<'_> {
    fn at_least(&self, of: impl Fn(&Case) -> f64) -> Option<Target> {
        self.case.map(|case| Target::at_least(of(case)))
    }
}

/// Adds the rows of `outcome` as case `name`.
pub fn add(rows: &mut Rows, name: &str, case: &Case, outcome: &Outcome) {
    let wanted = Wanted { case: (!outcome.robust).then_some(case) };
    renders(rows, name, &wanted, outcome);
    let judged: Vec<&Judged> = outcome.runs.iter().map(|run| &run.1).collect();
    let of = |f: &dyn Fn(&Judged) -> f64| mean(judged.iter().map(|j| f(j)));
    followed(rows, name, judged.iter().map(|j| j.followed));
    unmarked(rows, name, &judged);
    unmarked_pairs(rows, name, &judged);
    rows.add(name, "expected calibration error", of(&|j| j.calibration_error), "", None);
    let unattacked = of(&|j| j.calibration_error_unattacked);
    rows.add(name, "expected calibration error, renders not attacked", unattacked, "", None);
    bands(rows, name, "answers", judged.iter().map(|j| &j.bands));
    bands(rows, name, "renders not attacked, answers", judged.iter().map(|j| &j.bands_unattacked));
    by_center_crop(rows, name, "answers", judged.iter().map(|j| j.by_center_crop));
    by_center_crop(rows, name, "renders not attacked, answers", judged.iter().map(|j| j.by_center_crop_unattacked));
    registered(rows, name, &judged.iter().filter_map(|j| j.registered.as_ref()).collect::<Vec<_>>());
    for at in 0..judged.first().map_or(0, |first| first.attacks.len()) {
        let all: Vec<&Attacked> = judged.iter().filter_map(|j| j.attacks.get(at)).collect();
        attack(rows, name, outcome.robust, &all);
    }
    if let Some(base) = &outcome.base {
        rows.add(name, "base field, training", base.seconds, "s", None);
    }
    let max_seconds = wanted.case.map(|case| Target::at_most(case.max_seconds));
    cost(rows, name, max_seconds, outcome.runs.iter().map(|run| &run.0).collect());
    if let Some(served) = &outcome.served {
        rows.add(name, "rendering with marks", served.rays_per_s, "rays/s", None);
        rows.add(name, "reading a picture", served.reading_s, "s", None);
        rows.add(name, "reading a picture without a mark", served.reading_unmarked_s, "s", None);
        if let Some(peak) = served.peak_mib {
            rows.add(name, "peak memory, serving with marks", peak, "MiB", Some(Target::at_most(MAX_SERVING_MIB)));
        }
    }
}

/// Adds, as case `name`, what `outcome` says of renders as they are, without targets.
pub fn add_renders(rows: &mut Rows, name: &str, outcome: &Outcome) {
    renders(rows, name, &Wanted { case: None }, outcome);
    cost(rows, name, None, outcome.runs.iter().map(|run| &run.0).collect());
}

fn renders(rows: &mut Rows, name: &str, wanted: &Wanted<'_>, outcome: &Outcome) {
    let judged = || outcome.runs.iter().map(|run| &run.1);
    let of = |f: &dyn Fn(&Judged) -> f64| mean(judged().map(f));
    rows.add(name, "trainings", outcome.runs.len() as f64, "", None);
    rows.add(name, "held-out views", judged().map(|j| j.views as f64).fold(0.0, f64::max), "", None);
    rows.add(name, "base field PSNR", of(&|j| j.base_psnr_db), "dB", None);
    let min_change = wanted.at_least(|case| case.min_change_db);
    rows.add(name, "PSNR change by the mark", of(&|j| j.marked_psnr_db - j.base_psnr_db), "dB", min_change);
    // Views of nobody's cluster carry no mark, and would hide what one costs.
    let changes: Vec<f64> = judged().filter_map(|j| j.marked_change_db).collect();
    if !changes.is_empty() {
        rows.add(name, "PSNR change by the mark, marked views", mean(changes.into_iter()), "dB", min_change);
    }
    rows.add(name, "SSIM change by the mark", of(&|j| j.marked_ssim - j.base_ssim), "", None);
    rows.add(name, "marked against base PSNR", of(&|j| j.kept_db), "dB", None);
    share(rows, name, "accuracy", judged().map(|j| j.classes), wanted.at_least(|case| case.min_accuracy));
    share(rows, name, "marks read", judged().map(|j| j.marks), None);
    hidden(rows, name, wanted, outcome);
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

/// How many answers only a center crop gave, and how often they are right: owners, all of them.
fn by_center_crop(rows: &mut Rows, name: &str, what: &str, of: impl Iterator<Item = Right> + Clone) {
    rows.add(name, &format!("{what} by a center crop"), of.clone().map(|right| right.asked as f64).sum(), "", None);
    share(rows, name, &format!("{what} by a center crop: right"), of, None);
}

/// Pictures without a mark that are called so, of each kind, and those of all kinds that are not. Every detector is asked
/// about the same pictures, each in several forms.
fn unmarked(rows: &mut Rows, name: &str, judged: &[&Judged]) {
    for (at, first) in judged.first().iter().flat_map(|first| first.unmarked.iter().enumerate()) {
        let silent = judged.iter().filter_map(|j| j.unmarked.get(at)).map(|s| s.silent);
        rows.add(name, &format!("distinct pictures: {}", first.what), first.pictures as f64, "", None);
        rows.add(name, &format!("answers: {}", first.what), silent.clone().map(|s| s.asked as f64).sum(), "", None);
        share(rows, name, &format!("unmarked: {}", first.what), silent, None);
    }
    let all = || judged.iter().flat_map(|j| &j.unmarked).map(|s| s.silent);
    let made_up = all().map(|s| Right { right: s.asked - s.right, asked: s.asked });
    let pictures = judged.iter().map(|j| j.unmarked_pictures).min().unwrap_or(0) as f64;
    let target = Some(Target::at_least(MIN_UNMARKED));
    rows.add(name, "distinct pictures without a mark, each training", pictures, "", target);
    let answers = all().map(|s| s.asked as f64).sum();
    rows.add(name, "answers on pictures without a mark, all trainings", answers, "", None);
    share(rows, name, "false owners among pictures without a mark", made_up, Some(Target::at_most(0.0)));
    let empty = judged.iter().flat_map(|j| &j.unmarked).map(|s| s.empty);
    share(rows, name, "nothing recovered from pictures without a mark", empty, Some(Target::at_least(1.0)));
}

/// What is predicted of theta_0's renders after each attack, in all its forms: an owner of one of them is made up.
fn unmarked_pairs(rows: &mut Rows, name: &str, judged: &[&Judged]) {
    let all = || judged.iter().flat_map(|j| &j.attacks).map(|a| a.unmarked_pairs);
    for (at, first) in judged.first().iter().flat_map(|first| first.attacks.iter().enumerate()) {
        let of = judged.iter().filter_map(|j| j.attacks.get(at)).map(|a| a.unmarked_pairs);
        share(rows, name, &format!("{}: unmarked pairs are unmarked", first.name), of, None);
    }
    if all().next().is_some() {
        let made_up = all().map(|pairs| (pairs.asked - pairs.right) as f64).sum();
        let answers = all().map(|pairs| pairs.asked as f64).sum();
        rows.add(name, "answers on attacked views without a mark", answers, "", None);
        rows.add(name, "false owners, attacked views without a mark", made_up, "", Some(Target::at_most(0.0)));
    }
}

/// Whose identity is predicted where mark and view speak for different ones; nothing with one identity.
fn followed(rows: &mut Rows, name: &str, of: impl Iterator<Item = Followed> + Clone) {
    type Share = fn(Followed) -> Right;
    let shares: [(&str, Share); 5] = [
        ("the mark decides", |f| f.mark),
        ("the view decides", |f| f.view),
        ("the hidden picture is the mark's", |f| f.hidden_mark),
        ("the hidden picture is the view's", |f| f.hidden_view),
        ("unmarked pairs are unmarked", |f| f.unmarked),
    ];
    for (what, of_one) in shares {
        share(rows, name, &format!("a stranger's mark: {what}"), of.clone().map(of_one), None);
    }
}

/// What was recovered, of every kind that is hidden, and what the detector recovers when the class is given.
fn hidden(rows: &mut Rows, name: &str, wanted: &Wanted<'_>, outcome: &Outcome) {
    type Measure = fn(&Recovery) -> Option<Measured>;
    let target = wanted.at_least(|case| case.min_hidden_ssim);
    // Of several identities it is asked of each.
    let identities = outcome.runs.iter().map(|run| run.1.identities.len()).max().unwrap_or(0);
    let of_all = target.filter(|_| identities <= 1);
    let measures: [(&str, &str, Measure, Option<Target>); 5] = [
        ("hidden SSIM", "", |r| r.picture_ssim, of_all),
        ("hidden sound, SNR", "dB", |r| r.audio_snr_db, wanted.at_least(|_| MIN_AUDIO_SNR_DB)),
        ("hidden sound, log-spectral distance", "dB", |r| r.audio_lsd_db, None),
        ("hidden text, characters", "", |r| r.text_characters, wanted.at_least(|_| MIN_TEXT_CHARACTERS)),
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

/// What comes of registration.
fn registered(rows: &mut Rows, name: &str, all: &[&Registered]) {
    type Part = fn(&Registered) -> Answers;
    let parts: [(&str, Part); 2] = [("where it was rendered", |r| r.known), ("camera searched for", |r| r.searched)];
    for (how, part) in parts {
        let how = format!("registration, {how}");
        let answers: Vec<Answers> = all.iter().map(|registered| part(registered)).collect();
        stand_out(rows, name, &how, &answers);
        let pictures: usize = answers.iter().map(|a| a.pictures).sum();
        if pictures > 0 {
            let seconds: f64 = answers.iter().map(|a| a.seconds).sum();
            rows.add(name, &format!("{how}: a picture"), seconds / pictures as f64, "s", None);
        }
    }
    for (at, (attack, _)) in all.first().iter().flat_map(|registered| registered.attacked.iter().enumerate()) {
        let answers: Vec<Answers> =
            all.iter().filter_map(|r| r.attacked.get(at)).map(|(_, answers)| *answers).collect();
        stand_out(rows, name, &format!("registration after {attack}"), &answers);
    }
}

fn stand_out(rows: &mut Rows, name: &str, how: &str, answers: &[Answers]) {
    share(rows, name, &format!("{how}: accuracy"), answers.iter().map(|a| a.classes), None);
    share(rows, name, &format!("{how}: marks stand out"), answers.iter().map(|a| a.found), None);
    share(rows, name, &format!("{how}: nothing stands out where no mark is"), answers.iter().map(|a| a.silent), None);
}

fn attack(rows: &mut Rows, name: &str, robust: bool, all: &[&Attacked]) {
    let Some(first) = all.first() else { return };
    let (accuracy, ssim) = match first.set {
        Set::Mild => (MIN_MILD.0, Some(MIN_MILD.1)),
        Set::Hard => (MIN_HARD, None),
        Set::Combined => (MIN_COMBINED, None),
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
    use clap::Parser as _;

    use super::super::judged::Silent;
    use super::super::run::cases;
    use super::*;
    use crate::args::Args;
    use crate::captures::Name;
    use crate::results::{Results, Row};

    #[derive(clap::Parser)]
    struct Given {
        #[command(flatten)]
        args: Args,
    }

    /// The rows of what `runs` found, as the case of `name` has them.
    fn found(name: Name, runs: Vec<Judged>) -> Vec<Row> {
        let place = tempfile::tempdir().unwrap();
        let path = |name: &str| place.path().join(name).display().to_string();
        let folders = ["--results", &path("r"), "--page", &path("p.md"), "--out", &path("out")];
        let args = Given::parse_from([&["cairn-eval", "mark"], &folders[..]].concat()).args;
        let runs = runs.into_iter().map(|judged| (Marked::default(), judged)).collect();
        let mut all = Rows::new(&args);
        add(&mut all, "case", cases(&[name])[0], &Outcome { runs, ..Outcome::default() });
        all.save(&args).unwrap();
        Results::load(&place.path().join("out/rows")).unwrap().rows().to_vec()
    }

    /// A figure and what it was to reach.
    fn figure(rows: &[Row], metric: &str) -> (f64, Option<f64>) {
        let row = rows.iter().find(|row| row.metric == metric).unwrap_or_else(|| panic!("no row {metric}"));
        (row.value, row.target.map(|target| target.value))
    }

    #[test]
    fn an_owner_of_an_attacked_view_without_a_mark_is_counted_apart_from_accuracy() {
        let attacked = |name: &str, [classes, pairs]: [[usize; 2]; 2]| {
            let [classes, unmarked_pairs] = [classes, pairs].map(|[right, asked]| Right { right, asked });
            let marks =
                Right { right: classes.right - unmarked_pairs.right, asked: classes.asked - unmarked_pairs.asked };
            Attacked { name: name.into(), set: Set::Mild, classes, marks, unmarked_pairs, ssim: None }
        };
        // All marks are read, and three of ten views without one get an owner as well; then five of six.
        let judged = |noise, jpeg| Judged {
            attacks: vec![attacked("noise 0.02", noise), attacked("JPEG 50", jpeg)],
            ..Judged::default()
        };
        let rows = found(
            Name::Lego,
            vec![judged([[17, 20], [7, 10]], [[20, 20], [10, 10]]), judged([[7, 12], [1, 6]], [[12, 12], [6, 6]])],
        );
        let unmarked = |attack: &str| figure(&rows, &format!("{attack}: unmarked pairs are unmarked"));
        assert_eq!(figure(&rows, "noise 0.02: accuracy").0, 24.0 / 32.0);
        assert_eq!(figure(&rows, "noise 0.02: marks read").0, 1.0);
        assert_eq!([unmarked("noise 0.02"), unmarked("JPEG 50")], [(0.5, None), (1.0, None)]);
        assert_eq!(figure(&rows, "answers on attacked views without a mark").0, 32.0);
        assert_eq!(figure(&rows, "false owners, attacked views without a mark"), (8.0, Some(0.0)));
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
        let rows = found(Name::Lego, vec![judged.clone(), judged]);
        let target = Some(MIN_UNMARKED);
        assert_eq!(figure(&rows, "distinct pictures without a mark, each training"), (899.0, target));
        assert_eq!(figure(&rows, "answers on pictures without a mark, all trainings"), (5400.0, None));
        assert_eq!(figure(&rows, "distinct pictures: renders").0, 500.0);
        assert_eq!(figure(&rows, "answers: renders").0, 3000.0);
        assert_eq!(figure(&rows, "unmarked: renders"), (0.99, None));
        assert_eq!(figure(&rows, "false owners among pictures without a mark"), (30.0 / 5400.0, Some(0.0)));
    }

    #[test]
    fn confidence_is_reported_of_all_answers_and_of_those_on_renders_that_were_not_attacked() {
        let bands = |rights: [[usize; 2]; 2]| -> Vec<Band> {
            let of = [0.0, 0.99].into_iter().zip(rights);
            of.map(|(from, [right, asked])| Band { from, right: Right { right, asked } }).collect()
        };
        let judged = Judged {
            bands: bands([[3, 10], [80, 100]]),
            bands_unattacked: bands([[0, 0], [50, 50]]),
            calibration_error: 0.125,
            by_center_crop: Right { right: 3, asked: 4 },
            by_center_crop_unattacked: Right { right: 2, asked: 2 },
            ..Judged::default()
        };
        let rows = found(Name::Lego, vec![judged]);
        let value = |what: &str| figure(&rows, what).0;
        assert_eq!(value("answers with a confidence of 0 to 0.99: right"), 0.3);
        assert_eq!(value("answers with a confidence of 0.99 to 1: right"), 0.8);
        assert_eq!(value("renders not attacked, answers with a confidence of 0 to 0.99"), 0.0);
        assert_eq!(value("renders not attacked, answers with a confidence of 0.99 to 1"), 50.0);
        assert_eq!(value("renders not attacked, answers with a confidence of 0.99 to 1: right"), 1.0);
        assert_eq!(value("expected calibration error"), 0.125);
        assert_eq!((value("answers by a center crop"), value("answers by a center crop: right")), (4.0, 0.75));
        assert_eq!(value("renders not attacked, answers by a center crop: right"), 1.0);
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
        let rows = found(Name::Liberty, vec![judged(&[1.0, 0.75]), judged(&[1.0, 0.25])]);
        let least = Some(0.97);
        assert_eq!(figure(&rows, "hidden SSIM"), (0.75, None));
        assert_eq!(figure(&rows, "hidden SSIM, identity 1"), (1.0, least));
        assert_eq!(figure(&rows, "hidden SSIM, identity 2"), (0.5, least));
        let alone = found(Name::Lego, vec![judged(&[1.0])]);
        assert_eq!(figure(&alone, "hidden SSIM"), (1.0, Some(0.985)));
    }
}
