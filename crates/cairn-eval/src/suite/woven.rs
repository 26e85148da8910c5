//! Suite `woven`: keyed marks in a field, read back from distorted renders of held-out views whose cameras are known, and the
//! controls: unmarked pictures, and keys that have woven nothing.
//!
//! A capture's base field is kept among the work, with all scores as JSON and a sheet of renders. The weaving's seed is
//! known: nothing of it is published.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_mark::{WAYS, threshold};
use cairn_service::config::{Chosen, Quality};
use cairn_service::query::report::Right;

use crate::args::Args;
use crate::bootstrap;
use crate::captures::Name;
use crate::children::Children;
use crate::contribution::groups::Deal;
use crate::file;
use crate::origin::trees;
use crate::results::Target;
use crate::rows::Rows;
use crate::settings::QUICK_SIDE_PX;
use crate::source::Source;
use crate::timing::median;
use crate::trained::Train;
use crate::woven::work::{CONDITIONS, ReadBack, Scored, WRONG, WasRead};

/// Held-out views at most.
const MAX_VIEWS: usize = 12;
/// Views to train on at most, and to read, of a quick run.
const QUICK: [usize; 2] = [24, 2];

/// A capture, and at which size.
#[derive(Clone, Copy, Debug)]
struct Case {
    name: Name,
    longest_side_px: usize,
    deal: Deal,
}

/// The captures, in the order they are measured. Liberty's views 8, 24 and 64 shaped the method in a trial.
const CASES: [Case; 5] = [
    Case { name: Name::Liberty, longest_side_px: 300, deal: Deal::Table },
    Case { name: Name::Flower, longest_side_px: 504, deal: Deal::Neighbours(4) },
    Case { name: Name::Fern, longest_side_px: 504, deal: Deal::Neighbours(4) },
    Case { name: Name::Lego, longest_side_px: 400, deal: Deal::Neighbours(4) },
    Case { name: Name::Liberty, longest_side_px: 600, deal: Deal::Table },
];

/// Those views.
const TUNED_ON: [&str; 3] = ["view_008.jpg", "view_024.jpg", "view_064.jpg"];

/// Shares from which on contributors are counted, and the words for it.
const SHARES: [(f64, &str); 3] = [(0.10, ">= 10 %"), (0.03, ">= 3 %"), (0.01, ">= 1 %")];

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
    for (done, case) in cases.iter().copied().enumerate() {
        println!("{}, {} of {} cases", case.row_name(), done + 1, cases.len());
        let (captures, out, seed, quick) = (captures.clone(), args.out.clone(), args.seed, args.quick);
        let was_read =
            children.unless_stopped(move |children| case.was_read(children, &captures, &out, seed, quick)).await?;
        add(rows, &args.case_name(&case.row_name()), &was_read, args.seed);
        rows.save(args)?;
    }
    Ok(())
}

impl Case {
    fn row_name(&self) -> String {
        format!("{}, {} px", self.name.as_str(), self.longest_side_px)
    }

    fn was_read(
        &self,
        children: &Children,
        captures: &Path,
        out: &Path,
        seed: u64,
        quick: bool,
    ) -> anyhow::Result<WasRead> {
        let folder = captures.join(self.name.as_str());
        let folder = folder.canonicalize().with_context(|| format!("cannot find {}", folder.display()))?;
        let side = if quick { QUICK_SIDE_PX } else { self.longest_side_px };
        let source = Source { folder, longest_side_px: Some(side), max_views: quick.then_some(QUICK[0]) };
        let quality = if quick { Quality::Smoke } else { Quality::Draft };
        let preset = source.open()?.kind().into();
        let config = cairn_service::config::preset::settings(Chosen { preset, quality, robust: false }).field;
        let file = out.join(format!("woven-{}-{}", self.name.as_str(), self.longest_side_px));
        let work = ReadBack {
            field: self.field(children, &source, &config, out, seed)?,
            source,
            deal: self.deal,
            huber: config.huber,
            tuned_on: TUNED_ON.map(str::to_owned).to_vec(),
            max_views: if quick { QUICK[1] } else { MAX_VIEWS },
            seed,
            sheet: file.with_extension("png"),
            label: self.row_name(),
        };
        let was_read = children.run(&work)?;
        file::write(&file.with_extension("json"), &serde_json::to_vec_pretty(&was_read)?)?;
        Ok(was_read)
    }

    /// The file of the capture's field, which is trained where it is not kept from another run.
    fn field(
        &self,
        children: &Children,
        source: &Source,
        config: &cairn_field::FieldConfig,
        out: &Path,
        seed: u64,
    ) -> anyhow::Result<PathBuf> {
        // Another trainer or other settings make another field.
        let trainer = trees(Path::new("."), &["crates/cairn-field", "crates/cairn-scene"]);
        let out = file::folder_of(&out.join(self.name.as_str()), &(trainer, source, config))?;
        let field = out.join(format!("seed-{seed}.field"));
        let train = Train {
            source: source.clone(),
            config: config.clone(),
            seed,
            without: Vec::new(),
            stego: None,
            field: field.clone(),
            label: format!("{}, training", self.row_name()),
        };
        train.unless_kept(children)?;
        Ok(field)
    }
}

/// What is to be found of a condition from each of [`SHARES`] on.
fn wanted(condition: &str) -> [Option<f64>; 3] {
    match condition {
        "clean" => [Some(1.0), Some(1.0), Some(0.99)],
        "JPEG 75" => [None, Some(0.99), Some(0.75)],
        "JPEG 50" => [Some(1.0), Some(0.93), None],
        "JPEG 30" => [Some(0.98), None, None],
        "noise 0.05" => [Some(1.0), Some(0.9), None],
        "blur 2 px" | "crop 60 %" | "turn 30 deg" | "scale 75 %" | "another light" => [Some(1.0), None, None],
        "all together" => [Some(0.05), None, None],
        _ => [None; 3],
    }
}

/// Adds the rows: what is found of each condition, the controls, what is seen, and the seconds.
fn add(rows: &mut Rows, name: &str, was_read: &WasRead, seed: u64) {
    let from = threshold(was_read.contributors.max(1) * WAYS, WRONG);
    rows.add(name, "contributors", was_read.contributors as f64, "", None);
    rows.add(name, "views", was_read.views as f64, "", None);
    rows.add(name, "vertices on a side of a cell", f64::from(was_read.side), "", None);
    for (condition, scores) in CONDITIONS.iter().zip(&was_read.scores) {
        for ((min, words), wanted) in SHARES.into_iter().zip(wanted(condition.name)) {
            let what = format!("{}, {words}: found", condition.name);
            let of: Vec<&Scored> = scores.iter().filter(|scored| scored.share >= min).collect();
            let mut of_views = vec![Right::default(); was_read.views];
            for scored in &of {
                of_views[scored.view].asked += 1;
                of_views[scored.view].right += usize::from(scored.z > from);
            }
            let Some(found) = bootstrap::share(&of_views, seed) else { continue };
            rows.add(name, &what, found.whole, "", wanted.map(Target::at_least));
            rows.add(name, &format!("{what}, low"), found.low, "", None);
            rows.add(name, &format!("{what}, high"), found.high, "", None);
            rows.add(name, &format!("{what}, n"), of.len() as f64, "", None);
            if let Some(z) = median(&of.iter().map(|scored| scored.z).collect::<Vec<f64>>()) {
                rows.add(name, &format!("{what}, median z"), z, "", None);
            }
        }
    }
    let together = was_read.together.iter().filter(|scored| scored.share >= SHARES[0].0);
    let (right, asked) = together.fold((0u32, 0u32), |(r, n), scored| (r + u32::from(scored.z > from), n + 1));
    if asked > 0 {
        let what = format!("all together, {} pictures added up, >= 10 %: found", was_read.views);
        rows.add(name, &what, f64::from(right) / f64::from(asked), "", Some(Target::at_least(0.6)));
        rows.add(name, &format!("{what}, n"), f64::from(asked), "", None);
    }
    let none = Some(Target::at_most(0.0));
    let named = was_read.unmarked.iter().filter(|z| **z > from).count();
    rows.add(name, "unmarked pictures that name a contributor", named as f64, "", none);
    rows.add(name, "unmarked pictures: n", was_read.unmarked.len() as f64, "", None);
    let null = &was_read.under_others;
    rows.add(name, "keys that have woven nothing: scores above the threshold", null.above as f64, "", none);
    rows.add(name, "keys that have woven nothing: scores", null.count as f64, "", None);
    rows.add(name, "keys that have woven nothing: largest z", null.max, "", None);
    for (what, target) in [("at least", Target::at_least(0.98)), ("at most", Target::at_most(1.02))] {
        let metric = format!("keys that have woven nothing: variance of z, {what}");
        rows.add(name, &metric, null.variance(), "", Some(target));
    }
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
    rows.add(name, "PSNR of woven renders, mean", mean(&was_read.psnr_db), "dB", Some(Target::at_least(45.0)));
    let max = was_read.max_levels.iter().copied().fold(0.0, f64::max);
    rows.add(name, "largest change of a colour", max, "levels", Some(Target::at_most(8.0)));
    rows.add(name, "cost", mean(&was_read.cost_db), "dB", Some(Target::at_most(0.05)));
    rows.add(name, "weaving", was_read.weaving_seconds, "s", Some(Target::at_most(3.0)));
    if let Some(seconds) = median(&was_read.reading_seconds) {
        rows.add(name, "reading with known camera", seconds, "s", Some(Target::at_most(0.6)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::results::Row;
    use crate::woven::work::Null;

    fn rows(was_read: &WasRead) -> Vec<Row> {
        #[derive(clap::Parser)]
        struct Given {
            #[command(flatten)]
            args: Args,
        }
        let args = <Given as clap::Parser>::parse_from(["cairn-eval", "woven"]).args;
        let mut rows = Rows::new(&args);
        add(&mut rows, "case", was_read, 1);
        rows.take()
    }

    #[test]
    fn rows_count_who_is_found_by_share() {
        // The threshold for ten contributors and three ways is 5.6.
        let scored = |view: usize, share: f64, z: f64| Scored { view, share, z };
        let clean = vec![scored(0, 0.2, 9.0), scored(0, 0.05, 5.0), scored(1, 0.3, 9.0), scored(1, 0.02, 5.7)];
        let mut scores = vec![Vec::new(); CONDITIONS.len()];
        scores[0] = clean;
        let was_read = WasRead {
            contributors: 10,
            views: 2,
            scores,
            unmarked: vec![3.0, 6.5],
            under_others: Null { count: 100, sum: 3.0, squares: 101.0, max: 3.1, above: 0 },
            together: vec![scored(0, 0.2, 6.0), scored(0, 0.2, 2.0)],
            psnr_db: vec![45.0, 46.0],
            ..WasRead::default()
        };
        let rows = rows(&was_read);
        let value = |metric: &str| rows.iter().find(|r| r.metric == metric).unwrap_or_else(|| panic!("{metric}")).value;
        assert_eq!(value("clean, >= 10 %: found"), 1.0);
        assert!((value("clean, >= 3 %: found") - 2.0 / 3.0).abs() < 1e-12);
        assert_eq!(value("clean, >= 1 %: found"), 0.75);
        assert_eq!(value("clean, >= 1 %: found, n"), 4.0);
        assert_eq!(value("all together, 2 pictures added up, >= 10 %: found"), 0.5);
        assert_eq!(value("unmarked pictures that name a contributor"), 1.0);
        assert_eq!(value("keys that have woven nothing: scores above the threshold"), 0.0);
        assert_eq!(value("PSNR of woven renders, mean"), 45.5);
    }
}
