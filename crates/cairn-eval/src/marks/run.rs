//! One capture's trainings of marks, as a suite asks for them.
//!
//! Every training and judging runs in a process of its own. Base fields stay in the folder and are taken again by a later
//! run with the same settings and seed. So do their renders by the same program, in its folder `unmarked`.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_field::FieldConfig;
use cairn_mark::Recipe;
use sha2::{Digest as _, Sha256};

use super::judge::Judge;
use super::judged::Judged;
use super::kept;
use super::unmarked::Foreign;
use crate::args::Args;
use crate::captures::Name;
use crate::children::Children;
use crate::file;
use crate::marked::{Earlier, Files, Mark, Marked, ServeMarks, ServedMarks};
use crate::settings::{self, QUICK_SIDE_PX};
use crate::source::Source;
use crate::trained::{Train, Trained};

/// Views of each split, at most, in a quick run.
const QUICK_VIEWS: usize = 12;
/// Trainings of each capture, where it is not said how many: seeds from the one that was asked for on, and each its own
/// hidden pictures.
const TRAININGS: u64 = 3;

/// A capture and its targets, without robust training.
#[derive(Clone, Debug)]
pub struct Case {
    /// Which capture.
    pub name: Name,
    /// M, identities.
    pub anchors: usize,
    /// K, training views of each; `None` for all of them.
    pub neighbours: Option<usize>,
    /// Whether a sound and a text are hidden with each picture.
    pub all_kinds: bool,
    /// Whether light is fitted on the left half and the right half is scored.
    pub right_half: bool,
    /// Least SSIM of recovered against hidden pictures, of each identity.
    pub min_hidden_ssim: f64,
    /// Least share of right classes.
    pub min_accuracy: f64,
    /// Least change of PSNR by the mark, dB.
    pub min_change_db: f64,
    /// Most seconds of stage 2.
    pub max_seconds: f64,
}

/// The captures, in the order they are measured.
const CASES: [Case; 4] = [
    case(Name::Fern, 0.985, -0.02, 240.0),
    Case { all_kinds: true, ..case(Name::Trex, 0.97, -0.05, 360.0) },
    case(Name::Lego, 0.985, -0.05, 360.0),
    Case {
        anchors: 3,
        neighbours: Some(20),
        right_half: true,
        min_accuracy: 0.99,
        ..case(Name::Liberty, 0.97, -0.1, 600.0)
    },
];

const fn case(name: Name, min_hidden_ssim: f64, min_change_db: f64, max_seconds: f64) -> Case {
    Case {
        name,
        anchors: 1,
        neighbours: None,
        all_kinds: false,
        right_half: false,
        min_hidden_ssim,
        min_accuracy: 1.0,
        min_change_db,
        max_seconds,
    }
}

/// The cases that were asked for; all where none was.
pub fn cases(names: &[Name]) -> Vec<&'static Case> {
    CASES.iter().filter(|case| names.is_empty() || names.contains(&case.name)).collect()
}

/// Who has marks in a training.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Owners {
    /// As many as the case says.
    Case,
    /// Two, of half of the views each, trained together.
    Two,
    /// The same two: the second is added to what was trained for the first alone.
    OneAndAnother,
}

/// A training: what it is called and how it differs from the case's.
#[derive(Clone, Copy, Debug)]
pub struct Variant {
    /// Its name in the rows; empty for the case as it is.
    pub name: &'static str,
    /// What it changes of stage 2's settings.
    pub change: fn(&mut Recipe),
    /// Who has marks.
    pub owners: Owners,
}

/// The case as it is.
pub const AS_IT_IS: Variant = Variant { name: "", change: |_| (), owners: Owners::Case };

/// A capture's trainings.
#[derive(Default)]
pub struct Outcome {
    /// Stage 1, where it was trained in this run.
    pub base: Option<Trained>,
    /// Whether marks were trained to last.
    pub robust: bool,
    /// Each training and its judgement.
    pub runs: Vec<(Marked, Judged)>,
    /// The first training's marks, served; where all is judged.
    pub served: Option<ServedMarks>,
}

/// A stored base field.
#[derive(Clone, Debug)]
pub struct BaseField {
    /// Its file.
    pub file: PathBuf,
    /// How its training went, where it was trained in this run.
    pub trained: Option<Trained>,
}

/// One capture's measurements, as they are asked for.
#[derive(Clone)]
pub struct Run {
    /// The capture and its targets.
    pub case: &'static Case,
    /// What rows call it.
    pub name: String,
    /// Where the capture lies.
    pub source: Source,
    /// Stage 2's settings.
    pub mark: Recipe,
    /// Whether everything is judged, and not only renders as they are.
    pub thorough: bool,
    /// Other captures, to be silent on.
    foreign: Vec<Foreign>,
    pictures: Vec<PathBuf>,
    /// A sound and a text, where the case hides them.
    others: Files,
    field: FieldConfig,
    owners: Owners,
    seed: u64,
    trainings: u64,
    out: PathBuf,
    /// Where renders without a mark are kept.
    unmarked: PathBuf,
}

impl Run {
    /// That of `case` as `variant`, among the folder of `captures`, which hides `pictures`.
    ///
    /// # Errors
    /// For captures that do not read.
    pub fn new(
        args: &Args,
        case: &'static Case,
        captures: &Path,
        pictures: &[PathBuf],
        variant: &Variant,
    ) -> anyhow::Result<Self> {
        let sized = |name: Name| {
            let folder = captures.join(name.as_str());
            let folder = folder.canonicalize().with_context(|| format!("cannot find {}", folder.display()))?;
            let longest_side_px = args.quick.then_some(QUICK_SIDE_PX);
            anyhow::Ok(Source { folder, longest_side_px, max_views: args.quick.then_some(QUICK_VIEWS) })
        };
        let source = sized(case.name)?;
        let mut settings = settings::of(source.open()?.kind(), args.quick, args.robust);
        (variant.change)(&mut settings.mark);
        settings.mark.validate()?;
        let others = Name::ALL.into_iter().filter(|name| *name != case.name && captures.join(name.as_str()).is_dir());
        let foreign = others.map(|name| {
            let source = sized(name)?;
            let config = settings::of(source.open()?.kind(), args.quick, args.robust).field;
            let field = field_of(&args.out, &source, &config, args.seed)?;
            Ok(Foreign { source, field: Some(field) })
        });
        let name = args.case_name(case.name.as_str());
        let one = args.quick || !variant.name.is_empty();
        Ok(Self {
            case,
            name: if variant.name.is_empty() { name } else { format!("{name}, {}", variant.name) },
            foreign: foreign.collect::<anyhow::Result<_>>()?,
            source,
            mark: settings.mark,
            thorough: true,
            pictures: pictures.to_vec(),
            others: if case.all_kinds { beside(&pictures[0])? } else { Files::default() },
            field: settings.field,
            owners: variant.owners,
            seed: args.seed,
            trainings: args.trainings.unwrap_or(if one { 1 } else { TRAININGS }),
            out: args.out.clone(),
            unmarked: kept::of_this_program(&args.out.join("unmarked"))?,
        })
    }

    /// The stored base field, trained where it is not there yet.
    ///
    /// # Errors
    /// The training's.
    pub fn base(&self, children: &Children) -> anyhow::Result<BaseField> {
        let file = field_of(&self.out, &self.source, &self.field, self.seed)?;
        if file.is_file() {
            eprintln!("{}: the base field {} is there", self.name, file.display());
            return Ok(BaseField { file, trained: None });
        }
        let trained = children.run(&Train {
            source: self.source.clone(),
            config: self.field.clone(),
            seed: self.seed,
            without: Vec::new(),
            stego: None,
            field: file.clone(),
            label: format!("{}, base field", self.name),
        })?;
        Ok(BaseField { file, trained: Some(trained) })
    }

    /// All trainings on `base`, and their judgements.
    ///
    /// # Errors
    /// Those of the trainings.
    pub fn outcome(mut self, base: BaseField, children: &Children) -> anyhow::Result<Outcome> {
        if self.thorough {
            self.leave_out_missing();
        }
        let mut outcome = Outcome { base: base.trained, robust: self.mark.robust.enabled, ..Outcome::default() };
        for run in 0..self.trainings {
            outcome.runs.push(self.training(children, &base.file, run)?);
        }
        if self.thorough {
            let [marked, detector] = ["marked", "detector"].map(|what| self.file(0, what));
            let (cameras, label) = (self.source.open()?.held_out_cameras(), format!("{}, serving", self.name));
            outcome.served = Some(children.run(&ServeMarks { marked, detector, cameras, label })?);
        }
        Ok(outcome)
    }

    /// Prints of which other captures there is no base field in the folder: nothing is asked about their renders.
    fn leave_out_missing(&mut self) {
        for other in &mut self.foreign {
            if other.field.as_ref().is_none_or(|field| field.is_file()) {
                continue;
            }
            other.field = None;
            let (name, out) = (other.name(), self.out.display());
            println!(
                "{}: SKIPPED renders of {name}: {out} has no base field of it by these settings; measure it too (--case {name})",
                self.name
            );
        }
    }

    /// Training `run` on the base field `field`, and its judgement.
    fn training(&self, children: &Children, field: &Path, run: u64) -> anyhow::Result<(Marked, Judged)> {
        let label = |what: &str| format!("{}, {what}, {} of {}", self.name, run + 1, self.trainings);
        let file = |what: &str| self.file(run, what);
        let (anchors, neighbours) = self.clusters()?;
        let signals = (0..anchors).map(|i| {
            let at = run as usize * anchors + i;
            Files { picture: Some(self.pictures[at % self.pictures.len()].clone()), ..self.others.clone() }
        });
        let mut mark = Mark {
            source: self.source.clone(),
            base: field.to_owned(),
            config: self.mark.clone(),
            anchors,
            neighbours,
            signals: signals.collect(),
            earlier: None,
            seed: self.seed + run,
            marked: file("marked"),
            detector: file("detector"),
            label: label("marking"),
        };
        if self.owners == Owners::OneAndAnother {
            let (marked, detector) = (file("first.marked"), file("first.detector"));
            mark.earlier = Some(Earlier { marked: marked.clone(), detector: detector.clone() });
            let signals = mark.signals[..1].to_vec();
            let label = label("marking for the first");
            children.run(&Mark { anchors: 1, signals, earlier: None, marked, detector, label, ..mark.clone() })?;
        }
        let judge = Judge {
            source: self.source.clone(),
            foreign: self.foreign.clone(),
            base: field.to_owned(),
            marked: mark.marked.clone(),
            detector: mark.detector.clone(),
            signals: mark.signals.clone(),
            config: self.mark.clone(),
            right_half: self.case.right_half,
            thorough: self.thorough,
            unmarked: self.unmarked.clone(),
            sheet: file("png"),
            reliability: file("csv"),
            label: label("judging"),
        };
        Ok((children.run(&mark)?, children.run(&judge)?))
    }

    /// M and K; `None` for all views.
    fn clusters(&self) -> anyhow::Result<(usize, Option<usize>)> {
        if self.owners == Owners::Case {
            return Ok((self.case.anchors, self.case.neighbours));
        }
        Ok((2, Some(self.source.open()?.training().len() / 2)))
    }

    /// Where a training's result goes.
    fn file(&self, run: u64, what: &str) -> PathBuf {
        let slug: String = self.name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect();
        self.out.join(format!("{slug}-{}.{what}", self.seed + run))
    }
}

/// The first sound and the first text beside a picture.
fn beside(picture: &Path) -> anyhow::Result<Files> {
    let folder = picture.parent().unwrap_or(Path::new("."));
    let first = |ending: &str| {
        let problem = || format!("{} has no .{ending} to hide; name one that has (--signals DIR)", folder.display());
        file::with_ending(folder, &[ending])?.into_iter().next().with_context(problem)
    };
    Ok(Files { audio: Some(first("wav")?), text: Some(first("txt")?), picture: None })
}

/// Where a capture's base field lies in `out`. Settings, seed and pictures make a field; the folder's place does not.
fn field_of(out: &Path, source: &Source, config: &FieldConfig, seed: u64) -> anyhow::Result<PathBuf> {
    let key = serde_json::to_vec(&(config, seed, source.longest_side_px, source.max_views))?;
    let key: String = Sha256::digest(key).iter().take(6).map(|byte| format!("{byte:02x}")).collect();
    let name = source.folder.file_name().unwrap_or_default().to_string_lossy();
    Ok(out.join(format!("{name}-{key}.field")))
}
