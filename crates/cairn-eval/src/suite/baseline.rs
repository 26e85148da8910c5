//! Suite `baseline`: hiding a picture in the photographs and training an ordinary field on them, as the paper compares
//! with (its table 1): in their least significant bits, and by networks trained to hide and reveal (DeepStega). Read from
//! the photographs it is all there; read from renders of the field it should be gone.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context as _;
use cairn_field::Field;
use cairn_scene::Picture;
use cairn_scene::metrics::{psnr_db, ssim};
use cairn_service::query::evaluate::eight_bits;
use cairn_service::query::report::PERFECT_DB;
use serde::{Deserialize, Serialize};

use crate::args::Args;
use crate::baseline::deepstega::{DeepConfig, DeepTrainer};
use crate::baseline::stego::Stego;
use crate::captures::Name;
use crate::children::{Children, Work};
use crate::file::{self, decoded, read, write};
use crate::memory::peak_mib;
use crate::progress::Progress;
use crate::rows::Rows;
use crate::settings;
use crate::source::Source;
use crate::trained::Train;

/// Steps of DeepStega's networks under `--quick`.
const QUICK_STEPS: u64 = 600;

/// Likeness to the hidden picture; means over views.
#[derive(Clone, Copy, Default)]
struct Likeness {
    ssim: f64,
    psnr_db: f64,
}

/// What was measured; means over held-out views.
struct Outcome {
    from_photographs: Likeness,
    from_renders: Likeness,
    /// What is read where nothing was hidden.
    from_originals: Likeness,
    psnr_db: f64,
    photographs_db: f64,
}

/// DeepStega's networks, trained on the photographs that stage 1 learns from.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TrainNetworks {
    /// The capture; its held-out photographs are not looked at.
    pub source: Source,
    /// Files of the pictures that are hidden in training, among others.
    pub hidden: Vec<PathBuf>,
    /// The networks' settings.
    pub config: DeepConfig,
    /// The seed.
    pub seed: u64,
    /// The file for the networks.
    pub networks: PathBuf,
    /// What is shown while it runs.
    pub label: String,
}

/// How it went.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Networks {
    /// Seconds from decoded photographs to trained networks.
    pub seconds: f64,
    /// Steps taken.
    pub steps: u64,
    /// The most memory held, photographs and storing included, MiB; `None` where the system does not say.
    pub peak_mib: Option<f64>,
}

impl Work for TrainNetworks {
    const NAME: &'static str = "train-networks";
    type Result = Networks;

    fn label(&self) -> &str {
        &self.label
    }

    fn run(&self) -> anyhow::Result<Networks> {
        let opened = self.source.open()?;
        let photograph = |index: usize| Ok(opened.view(index)?.picture);
        let photographs = opened.training().into_iter().map(photograph).collect::<anyhow::Result<Vec<_>>>()?;
        let hidden = self.hidden.iter().map(|path| decoded(path)).collect::<anyhow::Result<Vec<_>>>()?;
        let begun = Instant::now();
        let mut trainer = DeepTrainer::new(photographs, &hidden, self.config.clone(), self.seed)?;
        let mut progress = Progress::new(&self.label, trainer.steps_total());
        while trainer.steps_done() < trainer.steps_total() {
            let stats = trainer.step()?;
            progress.at(stats.step, &format!("kept {:.1} dB, revealed {:.1} dB, ", stats.cover_db, stats.revealed_db));
        }
        drop(progress);
        let steps = trainer.steps_done();
        let networks = trainer.finish();
        let seconds = begun.elapsed().as_secs_f64();
        write(&self.networks, &networks.to_bytes()?)?;
        Ok(Networks { seconds, steps, peak_mib: peak_mib() })
    }
}

/// Measures the captures that were asked for (fern where none was), and keeps each one's rows.
///
/// # Errors
/// For captures that are not there, and whatever goes wrong in a training.
pub async fn measure(args: &Args, rows: &mut Rows) -> anyhow::Result<()> {
    let cases = if args.cases.is_empty() { vec![Name::Fern] } else { args.cases.clone() };
    let (captures, pictures) = (args.captures_with(&cases)?, args.pictures()?);
    file::make_folder(&args.out)?;
    let children = Children::default();
    for case in cases {
        let folder = captures.join(case.as_str());
        let folder = folder.canonicalize().with_context(|| format!("cannot find {}", folder.display()))?;
        let (longest_side_px, max_views) = (args.quick.then_some(256), args.quick.then_some(12));
        let source = Source { folder, longest_side_px, max_views };
        let name = args.case_name(case.as_str());
        let deep = DeepConfig::default();
        let networks = TrainNetworks {
            source: source.clone(),
            hidden: pictures.clone(),
            config: DeepConfig { steps: if args.quick { QUICK_STEPS } else { deep.steps }, ..deep },
            seed: args.seed,
            networks: args.out.join(format!("{}.deepstega", case.as_str())),
            label: format!("{name}, DeepStega's networks"),
        };
        let hidden = pictures[0].clone();
        let deep = Stego::DeepStega { hidden: hidden.clone(), networks: networks.networks.clone() };
        for stego in [Stego::LowestBits { hidden }, deep] {
            let train = Train {
                source: source.clone(),
                config: settings::of(source.open()?.kind(), args.quick, false).field,
                seed: args.seed,
                without: Vec::new(),
                stego: Some(stego.clone()),
                field: args.out.join(format!("{}-{}.field", case.as_str(), stego.name().replace(' ', "-"))),
                label: format!("{name}, base field of photographs with a picture in them ({})", stego.name()),
            };
            let networks = matches!(stego, Stego::DeepStega { .. }).then(|| networks.clone());
            let method = stego.name();
            let work = move |children: &Children| {
                let networks = networks.map(|task| children.run(&task)).transpose()?;
                Ok((networks, children.run(&train)?, outcome(&train, &stego)?))
            };
            let (networks, field, found) = children.unless_stopped(work).await?;
            report(rows, &name, method, &found);
            cost(rows, &name, &format!("{method}: base field"), field.seconds, field.peak_mib);
            if let Some(Networks { seconds, steps, peak_mib }) = networks {
                cost(rows, &name, "DeepStega: networks", seconds, peak_mib);
                rows.add(&name, "DeepStega: networks, steps", steps as f64, "", None);
            }
            rows.save(args)?;
        }
    }
    Ok(())
}

fn outcome(train: &Train, stego: &Stego) -> anyhow::Result<Outcome> {
    let (field, stego) = (Field::from_bytes(&read(&train.field)?)?, stego.open()?);
    let opened = train.source.open()?;
    let views = opened.held_out().into_iter().map(|index| opened.view(index)).collect::<anyhow::Result<Vec<_>>>()?;
    anyhow::ensure!(!views.is_empty(), "{} holds no view out to score on", train.source.folder.display());
    let share = 1.0 / views.len() as f64;
    let add = |sum: &mut Likeness, picture: &Picture| {
        let found = stego.reveal(picture)?;
        sum.ssim += share * ssim(stego.hidden(), &found)?;
        sum.psnr_db += share * psnr_db(stego.hidden(), &found)?.min(PERFECT_DB);
        Ok::<_, anyhow::Error>(())
    };
    let mut sums = [Likeness::default(); 3];
    let [mut rendered_db, mut photographs_db] = [0.0; 2];
    for view in &views {
        let marked = stego.hide(&view.picture)?;
        let render = eight_bits(&field.render(&view.camera, field.canonical_appearance()))?;
        for (sum, picture) in sums.iter_mut().zip([&marked, &render, &view.picture]) {
            add(sum, picture)?;
        }
        rendered_db += share * psnr_db(&view.picture, &render)?.min(PERFECT_DB);
        photographs_db += share * psnr_db(&view.picture, &marked)?.min(PERFECT_DB);
    }
    let [from_photographs, from_renders, from_originals] = sums;
    Ok(Outcome { from_photographs, from_renders, from_originals, psnr_db: rendered_db, photographs_db })
}

/// Adds the rows of the method `stego`.
fn report(rows: &mut Rows, name: &str, stego: &str, found: &Outcome) {
    for (place, likeness) in [
        ("the photographs", found.from_photographs),
        ("renders", found.from_renders),
        ("photographs without it", found.from_originals),
    ] {
        rows.add(name, &format!("{stego}: hidden SSIM in {place}"), likeness.ssim, "", None);
        rows.add(name, &format!("{stego}: hidden PSNR in {place}"), likeness.psnr_db, "dB", None);
    }
    rows.add(name, &format!("{stego}: base field PSNR"), found.psnr_db, "dB", None);
    rows.add(name, &format!("{stego}: photographs against their originals"), found.photographs_db, "dB", None);
}

/// Adds how long the training of `what` took, in seconds, and the most memory that it held, in MiB.
fn cost(rows: &mut Rows, name: &str, what: &str, seconds: f64, peak_mib: Option<f64>) {
    rows.add(name, &format!("{what}, training"), seconds, "s", None);
    if let Some(peak) = peak_mib {
        rows.add(name, &format!("{what}, peak memory"), peak, "MiB", None);
    }
}
