//! Suite `registration`: whether the camera of a picture is found. Renders of held-out views are distorted, as are their
//! photographs, and looked for among the places of the training views; pictures of other scenes are not to be found.
//!
//! A capture's field is kept among the work, with all tries as JSON and a sheet of ten placements.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_service::config::{Chosen, Quality};
use cairn_service::query::report::Right;

use crate::args::Args;
use crate::bootstrap;
use crate::captures::Name;
use crate::children::Children;
use crate::file;
use crate::origin::trees;
use crate::registration::condition::{CONDITIONS, Group};
use crate::registration::trial::{Fix, Trial};
use crate::registration::work::{Found, Register};
use crate::results::Target;
use crate::rows::Rows;
use crate::settings::QUICK_SIDE_PX;
use crate::source::Source;
use crate::timing::median;
use crate::trained::Train;

/// Held-out views at most.
const MAX_PLACES: usize = 10;
/// Pictures of other scenes at most, a capture: those of all four captures exceed 1,000.
const MAX_STRANGERS: usize = 300;
/// Views to train on, and to take places from, at most, in a quick run.
const QUICK_VIEWS: usize = 24;
/// Places, and pictures of other scenes, of a quick run.
const QUICK: [usize; 2] = [2, 4];

/// How large a capture's pictures are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Size {
    /// As small as thumbnails are; pictures of other scenes are looked for at this size.
    Small,
    /// As large as the capture's, 600 px at most; a search is timed at this size.
    Large,
}

/// A capture, and at which size.
#[derive(Clone, Copy, Debug)]
struct Case {
    name: Name,
    size: Size,
    longest_side_px: usize,
}

const fn small(name: Name) -> Case {
    Case { name, size: Size::Small, longest_side_px: 300 }
}

const fn large(name: Name, longest_side_px: usize) -> Case {
    Case { name, size: Size::Large, longest_side_px }
}

/// The captures, in the order they are measured.
const CASES: [Case; 8] = [
    small(Name::Liberty),
    small(Name::Flower),
    small(Name::Fern),
    small(Name::Lego),
    large(Name::Liberty, 600),
    large(Name::Flower, 504),
    large(Name::Fern, 504),
    large(Name::Lego, 400),
];

/// Measures the captures that were asked for (all where none was) and keeps each one's rows when it is whole.
///
/// # Errors
/// For captures that are not there, and whatever goes wrong in a training.
pub async fn measure(args: &Args, rows: &mut Rows) -> anyhow::Result<()> {
    let wanted = |case: &&Case| args.cases.is_empty() || args.cases.contains(&case.name);
    let cases: Vec<&'static Case> = CASES.iter().filter(wanted).collect();
    let captures = args.captures_with(&cases.iter().map(|case| case.name).collect::<Vec<_>>())?;
    file::make_folder(&args.out)?;
    let children = Children::default();
    for (done, case) in cases.iter().enumerate() {
        println!("{}, {} of {} cases", case.row_name(), done + 1, cases.len());
        let run = Run { case, captures: captures.clone(), out: args.out.clone(), seed: args.seed, quick: args.quick };
        let found = children.unless_stopped(move |children| run.found(children)).await?;
        add(rows, &args.case_name(&case.row_name()), case, &found, args.seed);
        rows.save(args)?;
    }
    Ok(())
}

impl Case {
    fn row_name(&self) -> String {
        format!("{}, {} px", self.name.as_str(), self.longest_side_px)
    }
}

/// A case's measurement.
struct Run {
    case: &'static Case,
    captures: PathBuf,
    out: PathBuf,
    seed: u64,
    quick: bool,
}

impl Run {
    fn found(&self, children: &Children) -> anyhow::Result<Found> {
        let case = self.case;
        let longest_side_px = match (self.quick, case.size) {
            (false, _) => case.longest_side_px,
            (true, Size::Small) => QUICK_SIDE_PX,
            (true, Size::Large) => QUICK_SIDE_PX * 2,
        };
        let source = Source { longest_side_px: Some(longest_side_px), ..self.whole(case.name)? };
        let [max_places, max_strangers] = if self.quick { QUICK } else { [MAX_PLACES, MAX_STRANGERS] };
        let others = Name::ALL.into_iter().filter(|name| *name != case.name && case.size == Size::Small);
        let others = others.filter(|name| self.captures.join(name.as_str()).is_dir());
        let file = format!("registration-{}-{}", case.name.as_str(), case.longest_side_px);
        let work = Register {
            field: self.field(children, &source)?,
            source,
            max_places,
            strangers: others.map(|name| self.whole(name)).collect::<anyhow::Result<_>>()?,
            max_strangers,
            longest_side_px,
            seed: self.seed,
            sheet: self.out.join(format!("{file}.png")),
            label: case.row_name(),
        };
        let found = children.run(&work)?;
        file::write(&self.out.join(format!("{file}.json")), &serde_json::to_vec_pretty(&found)?)?;
        Ok(found)
    }

    /// A capture at its own size.
    fn whole(&self, name: Name) -> anyhow::Result<Source> {
        let folder = self.captures.join(name.as_str());
        let folder = folder.canonicalize().with_context(|| format!("cannot find {}", folder.display()))?;
        Ok(Source { folder, longest_side_px: None, max_views: self.quick.then_some(QUICK_VIEWS) })
    }

    /// The file of the capture's field, which is trained where it is not kept from another run.
    fn field(&self, children: &Children, source: &Source) -> anyhow::Result<PathBuf> {
        let quality = if self.quick { Quality::Smoke } else { Quality::Draft };
        let preset = source.open()?.kind().into();
        let config = cairn_service::config::preset::settings(Chosen { preset, quality, robust: false }).field;
        // Another trainer or other settings make another field.
        let trainer = trees(Path::new("."), &["crates/cairn-field", "crates/cairn-scene"]);
        let out = file::folder_of(&self.out.join(self.case.name.as_str()), &(trainer, source, &config))?;
        let (seed, field) = (self.seed, out.join(format!("seed-{}.field", self.seed)));
        let label = format!("{}, training", self.case.row_name());
        let train = Train { source: source.clone(), config, seed, without: Vec::new(), stego: None, field, label };
        let field = train.field.clone();
        train.unless_kept(children)?;
        Ok(field)
    }
}

/// What a photograph of the place is placed with, of all; `None` where nothing was asked for.
fn min_photographs_placed(name: Name) -> Option<f64> {
    match name {
        Name::Flower | Name::Fern => Some(0.95),
        Name::Liberty => Some(0.7),
        Name::Lego | Name::Trex => None,
    }
}

/// Adds the rows: each condition, groups of them (`renders` are sharp ones to which one thing was done), what is wrong, and
/// the seconds.
fn add(rows: &mut Rows, name: &str, case: &Case, found: &Found, seed: u64) {
    let mut figures = Figures { rows: &mut *rows, name, found, seed };
    let fixed = |trial: &Trial, is: &dyn Fn(&Fix) -> bool| trial.fix().is_some_and(is);
    for (number, condition) in CONDITIONS.iter().enumerate() {
        let of = |trial: &Trial| trial.condition == number;
        let [placed, at_40, at_35] = match (condition.group, case.size) {
            (Group::Blurred, _) => [None, Some(0.95), None],
            (Group::Together, Size::Large) => [Some(0.95), None, Some(0.7)],
            _ => [None; 3],
        };
        let what = condition.name;
        let mut share = |figure: &str, is: &dyn Fn(&Fix) -> bool, min: Option<f64>| {
            figures.share(&format!("{what}: {figure}"), |trial| of(trial).then(|| fixed(trial, is)), min);
        };
        share("placed", &Fix::is_placed, placed);
        share("at 40 dB", &|fix| fix.is_at(40.0), at_40);
        share("at 35 dB", &|fix| fix.is_at(35.0), at_35);
        figures.count(&format!("{what}: n"), of);
        figures.count(&format!("{what}: found, 2 px off or more"), |t| of(t) && fixed(t, &|fix| !fix.is_placed()));
        figures.count(&format!("{what}: wrong placements"), |t| of(t) && fixed(t, &Fix::is_wrong));
    }
    let group = |trial: &Trial| CONDITIONS[trial.condition].group;
    let sharp = |trial: &Trial| (group(trial) == Group::Single).then(|| fixed(trial, &Fix::is_placed));
    figures.share("renders: placed", sharp, Some(0.99));
    let near = |trial: &Trial| (sharp(trial) == Some(true)).then(|| fixed(trial, &|fix| fix.is_at(40.0)));
    figures.share("renders: at 40 dB, of those placed", near, Some(0.98));
    let placed = found.trials.iter().filter(|trial| sharp(trial) == Some(true));
    let psnr: Vec<f64> = placed.filter_map(|trial| Some(trial.fix()?.psnr_db)).collect();
    if let Some(psnr) = median(&psnr) {
        figures.rows.add(name, "renders: PSNR of those placed, median", psnr, "dB", None);
    }
    let photographs = |trial: &Trial| group(trial) == Group::Photographs;
    let placed = |trial: &Trial| photographs(trial).then(|| fixed(trial, &Fix::is_placed));
    figures.share("photographs: placed", placed, min_photographs_placed(case.name));
    for (what, of_photographs) in [("renders", false), ("photographs", true)] {
        let within = |trial: &Trial| trial.fix().filter(|_| photographs(trial) == of_photographs)?.is_within();
        figures.share(&format!("{what}: within 3 uncertainties"), within, None);
    }
    figures.count("found, 2 px off or more", |trial| fixed(trial, &|fix| !fix.is_placed()));
    let none = Some(Target::at_most(0.0));
    let wrong = found.trials.iter().filter(|trial| fixed(trial, &Fix::is_wrong)).count();
    rows.add(name, "wrong placements", wrong as f64, "", none);
    if found.strangers > 0 {
        rows.add(name, "pictures of other scenes: n", found.strangers as f64, "", None);
        rows.add(name, "pictures of other scenes: found", found.strangers_located.len() as f64, "", none);
    }
    let seconds: Vec<f64> = found.trials.iter().map(|trial| trial.seconds).collect();
    if let Some(seconds) = median(&seconds) {
        rows.add(name, "search, median", seconds, "s", (case.size == Size::Large).then(|| Target::at_most(2.0)));
    }
    rows.add(name, "index of places", found.index_seconds, "s", Some(Target::at_most(30.0)));
    rows.add(name, "keypoints of the index", found.points as f64, "", None);
}

/// Figures of tries on their way into rows.
struct Figures<'a> {
    rows: &'a mut Rows,
    name: &'a str,
    found: &'a Found,
    seed: u64,
}

impl Figures<'_> {
    /// Adds the share of the tries that are right among those that `right` says something of, with its limits over places;
    /// nothing where there are none.
    fn share(&mut self, metric: &str, right: impl Fn(&Trial) -> Option<bool>, min: Option<f64>) {
        let mut of_places = vec![Right::default(); self.found.places];
        for trial in &self.found.trials {
            let Some(right) = right(trial) else { continue };
            let of_place = &mut of_places[trial.place];
            of_place.asked += 1;
            of_place.right += usize::from(right);
        }
        let Some(found) = bootstrap::share(&of_places, self.seed) else { return };
        self.rows.add(self.name, metric, found.whole, "", min.map(Target::at_least));
        self.rows.add(self.name, &format!("{metric}, low"), found.low, "", None);
        self.rows.add(self.name, &format!("{metric}, high"), found.high, "", None);
    }

    /// Adds how many tries are so.
    fn count(&mut self, metric: &str, is: impl Fn(&Trial) -> bool) {
        let count = self.found.trials.iter().filter(|trial| is(trial)).count();
        self.rows.add(self.name, metric, count as f64, "", None);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::trial::Outcome;
    use crate::results::Row;

    /// Ten places: all placed well but one clean render that is not found, one photograph that is 3 px off, and one picture
    /// with all together that is elsewhere.
    fn found() -> Found {
        let fix = Fix {
            off_px: 0.1,
            longest_px: 600,
            psnr_db: 50.0,
            uncertainty_px: Some(0.05),
            explained: 0.9,
            surprise: 30.0,
        };
        let trial = |place: usize, condition: usize| {
            let outcome = match (place, CONDITIONS[condition].name) {
                (0, "clean") => Outcome::NotLocated("none".into()),
                (1, "photograph") => Outcome::Located(Fix { off_px: 3.0, ..fix }),
                (2, "all together") => Outcome::Located(Fix { off_px: 90.0, psnr_db: 12.0, ..fix }),
                (_, "blur 2 px") => Outcome::Located(Fix { psnr_db: 37.0, uncertainty_px: None, ..fix }),
                _ => Outcome::Located(fix),
            };
            Trial { condition, place, view: place.to_string(), seconds: 1.5, outcome }
        };
        let trials = (0..10).flat_map(|place| (0..CONDITIONS.len()).map(move |condition| trial(place, condition)));
        Found {
            places: 10,
            points: 5000,
            index_seconds: 40.0,
            trials: trials.collect(),
            strangers: 300,
            strangers_located: vec!["view.jpg, whole".into()],
        }
    }

    fn rows(case: &Case) -> Vec<Row> {
        #[derive(clap::Parser)]
        struct Given {
            #[command(flatten)]
            args: Args,
        }
        let args = <Given as clap::Parser>::parse_from(["cairn-eval", "registration"]).args;
        let mut rows = Rows::new(&args);
        add(&mut rows, "case", case, &found(), 1);
        rows.take()
    }

    #[test]
    fn rows_count_what_was_placed() {
        let rows = rows(&CASES[4]);
        let row = |metric: &str| rows.iter().find(|row| row.metric == metric).unwrap_or_else(|| panic!("no {metric}"));
        for (metric, value) in [
            ("clean: placed", 0.9),
            ("clean: n", 10.0),
            ("clean: wrong placements", 0.0),
            ("blur 2 px: placed", 1.0),
            ("blur 2 px: at 40 dB", 0.0),
            ("blur 2 px: at 35 dB", 1.0),
            ("all together: at 35 dB", 0.9),
            ("renders: placed", 139.0 / 140.0),
            ("renders: at 40 dB, of those placed", 1.0),
            ("renders: PSNR of those placed, median", 50.0),
            ("photographs: placed", 19.0 / 20.0),
            // Blurred ones state none; of the 149 others that are found one is elsewhere.
            ("renders: within 3 uncertainties", 148.0 / 149.0),
            ("found, 2 px off or more", 2.0),
            ("wrong placements", 1.0),
            ("pictures of other scenes: found", 1.0),
            ("search, median", 1.5),
        ] {
            assert!((row(metric).value - value).abs() < 1e-12, "{metric}: {} is not {value}", row(metric).value);
        }
        assert!(row("clean: placed, low").value < 0.9 && row("clean: placed, high").value == 1.0);
    }

    #[test]
    fn targets_are_those_of_the_case() {
        let targets = |case: &Case| -> Vec<(String, f64, bool)> {
            let rows = rows(case).into_iter();
            rows.filter_map(|row| Some((row.metric, row.target?.value, row.met?))).collect()
        };
        let of = |metric: &str, target: f64, met: bool| (metric.to_owned(), target, met);
        let mut expected = vec![
            of("blur 2 px: at 40 dB", 0.95, false),
            of("all together: placed", 0.95, false),
            of("all together: at 35 dB", 0.7, true),
            of("renders: placed", 0.99, true),
            of("renders: at 40 dB, of those placed", 0.98, true),
            of("photographs: placed", 0.7, true),
            of("wrong placements", 0.0, false),
            of("pictures of other scenes: found", 0.0, false),
            of("search, median", 2.0, true),
            of("index of places", 30.0, false),
        ];
        assert_eq!(targets(&large(Name::Liberty, 600)), expected);
        // What is not asked for at a small size, and of photographs of an object.
        expected.retain(|(metric, ..)| !metric.starts_with("all together") && !metric.starts_with("photo"));
        expected.retain(|(metric, ..)| metric != "search, median");
        assert_eq!(targets(&small(Name::Lego)), expected);
    }
}
