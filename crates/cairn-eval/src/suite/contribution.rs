//! Suite `contribution`: what shares say of held-out views, against what leaving contributors out of the training changes.
//! For each capture a field of all photographs and one without each of eight groups of contributors are trained, with two
//! seeds; a capture's trainings are kept among the work, and a run that was stopped goes on with those that are missing.

use std::path::Path;

use anyhow::Context as _;
use cairn_service::config::{Chosen, Quality};
use sha2::{Digest as _, Sha256};

use crate::args::Args;
use crate::captures::Name;
use crate::children::Children;
use crate::contribution::foreseen::Foresight;
use crate::contribution::groups::{Deal, GROUPS, groups};
use crate::contribution::rank::{Agreement, Table, agreement, interval};
use crate::contribution::truth::{Trainings, Truth};
use crate::file;
use crate::origin::commit;
use crate::results::Target;
use crate::rows::Rows;
use crate::settings::QUICK_SIDE_PX;
use crate::source::Source;

/// Trainings of the same photographs: how well they agree is the most that can be foreseen.
const SEEDS: u64 = 2;
/// Views to train on, and to score on, at most, in a quick run.
const QUICK_VIEWS: usize = 24;

/// A capture, and at which size.
struct Case {
    name: Name,
    longest_side_px: usize,
    deal: Deal,
}

/// The captures. Ways of foreseeing are chosen on the first.
const CASES: [Case; 4] = [
    Case { name: Name::Lego, longest_side_px: 200, deal: Deal::Neighbours(4) },
    Case { name: Name::Flower, longest_side_px: 252, deal: Deal::Neighbours(1) },
    Case { name: Name::Fern, longest_side_px: 252, deal: Deal::Neighbours(1) },
    Case { name: Name::Liberty, longest_side_px: 150, deal: Deal::Table },
];

/// Measures the captures that were asked for (all where none was).
///
/// # Errors
/// For captures that are not there, and whatever goes wrong in a training.
pub async fn measure(args: &Args, rows: &mut Rows) -> anyhow::Result<()> {
    let wanted = |case: &&Case| args.cases.is_empty() || args.cases.contains(&case.name);
    let cases: Vec<&'static Case> = CASES.iter().filter(wanted).collect();
    let captures = args.captures_with(&cases.iter().map(|case| case.name).collect::<Vec<_>>())?;
    file::make_folder(&args.out)?;
    let trainings = cases.len() as u64 * SEEDS * (1 + GROUPS as u64);
    println!("{trainings} trainings, less those in {}", args.out.display());
    let children = Children::default();
    for case in cases {
        let (folder, out) = (captures.join(case.name.as_str()), args.out.join(case.name.as_str()));
        let (seed, quick) = (args.seed, args.quick);
        let found = children.unless_stopped(move |children| found(children, case, &folder, &out, seed, quick)).await?;
        add(rows, &args.case_name(case.name.as_str()), &found, seed);
        rows.save(args)?;
    }
    Ok(())
}

/// What was found of a capture.
struct Found {
    truth: Truth,
    foreseen: Vec<(String, Table)>,
    table_seconds: f64,
}

fn found(children: &Children, case: &Case, folder: &Path, out: &Path, seed: u64, quick: bool) -> anyhow::Result<Found> {
    let folder = folder.canonicalize().with_context(|| format!("cannot find {}", folder.display()))?;
    let side = if quick { QUICK_SIDE_PX } else { case.longest_side_px };
    let source = Source { folder, longest_side_px: Some(side), max_views: quick.then_some(QUICK_VIEWS) };
    let opened = source.open()?;
    let quality = if quick { Quality::Smoke } else { Quality::Draft };
    let settings =
        cairn_service::config::preset::settings(Chosen { preset: opened.kind().into(), quality, robust: false });
    let groups = groups(&opened, case.deal);
    // Other programs, settings or groups make other fields.
    let what = serde_json::to_vec(&(commit(Path::new(".")), &source, &settings.field, &groups))?;
    let digest = Sha256::digest(what);
    let out = out.join(digest[..4].iter().map(|byte| format!("{byte:02x}")).collect::<String>());
    std::fs::create_dir_all(&out).with_context(|| format!("cannot make the folder {}", out.display()))?;
    let trainings = Trainings { source: &source, config: &settings.field, groups: &groups, out: &out };
    let seeds: Vec<u64> = (seed..seed + SEEDS).collect();
    trainings.run(children, &seeds)?;
    let truth = trainings.truth(&opened, &seeds)?;
    let field = trainings.field(seed, None)?;
    let foresight = Foresight::new(&opened, &field, &groups, settings.field.huber)?;
    Ok(Found { truth, foreseen: foresight.all()?, table_seconds: foresight.table_seconds })
}

/// Adds the rows: each way against the mean of the seeds, the seeds against one another, and each way against what two
/// seeds have in common.
fn add(rows: &mut Rows, case: &str, found: &Found, seed: u64) {
    let Truth { change, growth, shared } = &found.truth;
    rows.add(case, "share table", found.table_seconds, "s", None);
    rows.add(case, "views", shared.len() as f64, "", None);
    for (name, of) in [("change", change), ("growth", growth)] {
        add_agreement(rows, case, &format!("{name} by one seed by the other"), [&of[0], &of[1]], seed);
    }
    let mean = |of: &[Table]| -> Table {
        let row = |(a, b): (&Vec<f64>, &Vec<f64>)| a.iter().zip(b).map(|(a, b)| (a + b) / 2.0).collect();
        of[0].iter().zip(&of[1]).map(row).collect()
    };
    let truths = [("change", mean(change)), ("growth", mean(growth)), ("shared change", shared.clone())];
    for (name, truth) in &truths {
        for (way, table) in &found.foreseen {
            add_agreement(rows, case, &format!("{name} by {way}"), [table, truth], seed);
        }
    }
}

/// What the default ways are to reach where the prototype was measured, on liberty.
fn target(case: &str, metric: &str) -> Option<Target> {
    let at_least = match metric {
        "change by coverage, power 8, all pairs" => 0.70,
        "change by coverage, power 8, within views" => 0.80,
        "change by coverage, power 8, within groups" => 0.55,
        "change by necessity, rho 0.01, all pairs" | "change by necessity, rho 0.01, within views" => 0.88,
        "change by necessity, rho 0.01, within groups" => 0.85,
        _ => return None,
    };
    (case == Name::Liberty.as_str()).then(|| Target::at_least(at_least))
}

/// Adds how two tables agree, and the limits between which 95 % of draws of the views lie.
fn add_agreement(rows: &mut Rows, case: &str, what: &str, [a, b]: [&Table; 2], seed: u64) {
    type Kind = (&'static str, fn(&Agreement) -> f64);
    const KINDS: [Kind; 4] = [
        ("all pairs", |a| a.all),
        ("within views", |a| a.within_views),
        ("within groups", |a| a.within_groups),
        ("same first", |a| a.same_first),
    ];
    let (rho, (low, high)) = (agreement(a, b), interval(a, b, seed));
    for (kind, value) in KINDS {
        let metric = format!("{what}, {kind}");
        rows.add(case, &metric, value(&rho), "", target(case, &metric));
        for (end, limit) in [("low", &low), ("high", &high)] {
            rows.add(case, &format!("{metric}, {end}"), value(limit), "", None);
        }
    }
}
