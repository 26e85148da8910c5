//! Suite `baseline`: hiding a picture in the least significant bits of the
//! photographs, and training an ordinary field on them, as the paper compares with
//! (its table 1). Read from the photographs it is all there; read from renders of
//! the field it should be gone.

use std::path::Path;
use std::sync::Arc;

use anyhow::Context as _;
use cairn_capture::Picture;
use cairn_field::Field;
use cairn_metrics::{psnr_db, ssim};
use cairn_stega::{hide_in_lowest_bits, read_lowest_bits};

use super::super::connect::Where;
use super::super::read;
use super::children::Children;
use super::field::source::Source;
use super::field::{Name, train, unless_stopped};
use super::rows::Rows;
use super::{Args, decoded};
use crate::config::{Config, overlay_for, training_settings};
use crate::engine::evaluate::{PERFECT_DB, eight_bits};

/// What was measured; means over views.
struct Outcome {
    from_photographs: f64,
    from_renders: f64,
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
        let source =
            Source { folder, longest_side_px: args.quick.then_some(256), most_views: args.quick.then_some(12) };
        let overlay = overlay_for(source.open()?.kind());
        let quick = ("the quick settings", if args.quick { crate::config::QUICK_TOML } else { "" });
        let base = Config::load(place.config.as_deref())?.training;
        let name = args.case_name(case.as_str());
        let train = train::Task {
            source,
            config: training_settings(&base, &[overlay, quick])?.field,
            seed: args.seed,
            lowest_bits: Some(pictures[0].clone()),
            field: args.out.join(format!("{}-lowest-bits.field", case.as_str())),
            label: format!("{name}, base field of photographs with a picture in their lowest bits"),
        };
        let work = tokio::task::spawn_blocking({
            let (children, hidden) = (children.clone(), pictures[0].clone());
            move || {
                children.run(&train)?;
                outcome(&train, &hidden)
            }
        });
        let found = unless_stopped(work, &children).await?;
        rows.add(&name, "lowest bits: hidden SSIM in the photographs", found.from_photographs, "", None);
        rows.add(&name, "lowest bits: hidden SSIM in renders", found.from_renders, "", None);
        rows.add(&name, "lowest bits: base field PSNR", found.psnr_db, "dB", None);
        rows.add(&name, "lowest bits: photographs against their originals", found.photographs_db, "dB", None);
        rows.save(args)?;
    }
    Ok(())
}

fn outcome(train: &train::Task, hidden: &Path) -> anyhow::Result<Outcome> {
    let (field, hidden) = (Field::from_bytes(&read(&train.field)?)?, decoded(hidden)?);
    let size = [hidden.width(), hidden.height()];
    let opened = train.source.open()?;
    let views = opened.held_out().into_iter().map(|index| opened.view(index)).collect::<anyhow::Result<Vec<_>>>()?;
    anyhow::ensure!(!views.is_empty(), "{} holds no view out to score on", train.source.folder.display());
    let found = |picture: &Picture| Ok::<_, anyhow::Error>(ssim(&hidden, &read_lowest_bits(picture, size)?)?);
    let mut sums = Outcome { from_photographs: 0.0, from_renders: 0.0, psnr_db: 0.0, photographs_db: 0.0 };
    for view in &views {
        let stego = hide_in_lowest_bits(&view.picture, &hidden)?;
        let render = eight_bits(&field.render(&view.camera, field.canonical_appearance()))?;
        sums.from_photographs += found(&stego)?;
        sums.from_renders += found(&render)?;
        sums.psnr_db += psnr_db(&view.picture, &render)?.min(PERFECT_DB);
        sums.photographs_db += psnr_db(&view.picture, &stego)?.min(PERFECT_DB);
    }
    let mean = |sum: f64| sum / views.len() as f64;
    Ok(Outcome {
        from_photographs: mean(sums.from_photographs),
        from_renders: mean(sums.from_renders),
        psnr_db: mean(sums.psnr_db),
        photographs_db: mean(sums.photographs_db),
    })
}
