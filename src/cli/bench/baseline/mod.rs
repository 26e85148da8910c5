//! Suite `baseline`: hiding a picture in the photographs and training an ordinary
//! field on them, as the paper compares with (its table 1): in their least significant
//! bits, and by networks trained to hide and reveal (DeepStega). Read from the
//! photographs it is all there; read from renders of the field it should be gone.

mod networks;
mod stego;

use std::sync::Arc;

use anyhow::Context as _;
use cairn_field::Field;
use cairn_mark::DeepConfig;
use cairn_scene::Picture;
use cairn_scene::metrics::{psnr_db, ssim};

use super::super::connect::Where;
use super::super::files::read;
use super::Args;
use super::children::Children;
use super::field::source::Source;
use super::field::{Name, train, unless_stopped};
use super::rows::Rows;
use cairn_service::config::{TrainingSettings, overlay_for, training_settings};
use cairn_service::query::evaluate::eight_bits;
use cairn_service::query::report::PERFECT_DB;
pub use networks::{Networks, Task as TrainNetworks, run as train_networks};
pub use stego::Stego;

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

/// Measures the captures that were asked for (fern where none was), and puts each one's rows into the ledger.
pub async fn measure(place: &Where, args: &Args, rows: &mut Rows) -> anyhow::Result<()> {
    let captures = args.captures()?;
    let pictures = super::mark::pictures(args.signals.as_deref().unwrap_or(&captures.join("signals")))?;
    std::fs::create_dir_all(&args.out).with_context(|| format!("cannot make the folder {}", args.out.display()))?;
    let children = Arc::new(Children::default());
    let fern = [Name::Fern];
    for case in if args.cases.is_empty() { &fern[..] } else { &args.cases } {
        let folder = captures.join(case.as_str());
        let folder = folder.canonicalize().with_context(|| format!("there is no capture {}", folder.display()))?;
        let source = Source {
            folder,
            longest_side_px: args.quick.then_some(256),
            most_views: args.quick.then_some(12),
            skip_missing: false,
        };
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
            let train = task(place, args, (*case, &source), &stego)?;
            let networks = matches!(stego, Stego::DeepStega { .. }).then(|| networks.clone());
            let work = tokio::task::spawn_blocking({
                let (children, stego) = (children.clone(), stego.clone());
                move || {
                    let trained = networks.map(|task| children.run(&task)).transpose()?;
                    let field = children.run(&train)?;
                    Ok::<_, anyhow::Error>((trained, field, outcome(&train, &stego)?))
                }
            });
            let (networks, field, found) = unless_stopped(work, &children).await?;
            report(rows, &name, stego.name(), &found);
            cost(rows, &name, &format!("{}: base field", stego.name()), (field.seconds, field.peak_mib));
            if let Some(Networks { seconds, steps, peak_mib }) = networks {
                cost(rows, &name, "DeepStega: networks", (seconds, peak_mib));
                rows.add(&name, "DeepStega: networks, steps", steps as f64, "", None);
            }
            rows.save(args)?;
        }
    }
    Ok(())
}

/// Stage 1 on photographs with something hidden in them.
fn task(place: &Where, args: &Args, (case, source): (Name, &Source), stego: &Stego) -> anyhow::Result<train::Task> {
    let overlay = overlay_for(source.open()?.kind());
    let quick = ("the quick settings", if args.quick { cairn_service::config::QUICK_TOML } else { "" });
    let base = TrainingSettings::given(Default::default(), Default::default());
    Ok(train::Task {
        source: source.clone(),
        config: training_settings(&base, &[overlay, quick])?.field,
        seed: args.seed,
        stego: Some(stego.clone()),
        field: args.out.join(format!("{}-{}.field", case.as_str(), stego.name().replace(' ', "-"))),
        label: format!(
            "{}, base field of photographs with a picture in them ({})",
            args.case_name(case.as_str()),
            stego.name()
        ),
    })
}

fn outcome(train: &train::Task, stego: &Stego) -> anyhow::Result<Outcome> {
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
fn cost(rows: &mut Rows, name: &str, what: &str, (seconds, peak_mib): (f64, Option<f64>)) {
    rows.add(name, &format!("{what}, training"), seconds, "s", None);
    if let Some(peak) = peak_mib {
        rows.add(name, &format!("{what}, peak memory"), peak, "MiB", None);
    }
}
