//! Suite `own`: what stage 1 makes of any capture, at the size that is wanted, and where its photographs ask for a finer
//! grid also without it.

use std::path::Path;
use std::sync::Arc;

use anyhow::Context as _;
use cairn_field::FieldConfig;

use super::super::super::connect::Where;
use super::super::Args;
use super::super::children::Children;
use super::super::rows::Rows;
use super::{Run, score, train, unless_stopped};

/// What came of the capture.
struct Found {
    shipped: (train::Trained, score::Scored),
    /// With a grid of `field.voxels` vertices; none where that is the same training.
    never_finer: Option<(train::Trained, score::Scored)>,
}

/// Measures the capture that was given and puts its rows into the ledger.
pub async fn measure(place: &Where, args: &Args, rows: &mut Rows) -> anyhow::Result<()> {
    let folder = args.folder.as_deref().context("say where the capture is: --folder DIR")?;
    std::fs::create_dir_all(&args.out).with_context(|| format!("cannot make the folder {}", args.out.display()))?;
    let name = named(folder)?;
    let run = Run::of(place, args, (&name, None), folder, args.longest_side.map(|px| px as usize))?;
    let held_out = run.source.open()?.held_out().len();
    anyhow::ensure!(held_out > 0, "{} holds no view out to score on; bring two at least", folder.display());
    let children = Arc::new(Children::default());
    let work = tokio::task::spawn_blocking({
        let children = children.clone();
        move || run.of_its_own(&children)
    });
    let found = unless_stopped(work, &children).await?;
    let size = args.longest_side.filter(|_| !args.quick).map(|px| format!(", {px} px")).unwrap_or_default();
    add(rows, &args.case_name(&format!("{name}{size}")), &found);
    rows.save(args)
}

/// What the capture is called: as its folder.
fn named(folder: &Path) -> anyhow::Result<String> {
    let path = folder.canonicalize().with_context(|| format!("cannot find {}", folder.display()))?;
    let name = path.file_name().with_context(|| format!("{} has no name", folder.display()))?;
    Ok(name.to_string_lossy().into_owned())
}

impl Run {
    fn of_its_own(&self, children: &Children) -> anyhow::Result<Found> {
        let one = |what: &str, config: FieldConfig| {
            let file = format!("{}-own-{}-{}.field", self.name, self.seed, what.replace(' ', "-"));
            self.trained(children, config, self.out.join(file), what)
        };
        let shipped = one("as shipped", self.config.clone())?;
        let never_finer = FieldConfig { voxel_px: 0.0, ..self.config.clone() };
        let never_finer = shipped.0.finer.then(|| one("never finer", never_finer)).transpose()?;
        Ok(Found { shipped, never_finer })
    }
}

fn add(rows: &mut Rows, name: &str, found: &Found) {
    let both = [("", Some(&found.shipped)), (", never finer", found.never_finer.as_ref())];
    for (what, (trained, scored)) in both.into_iter().filter_map(|(what, one)| Some((what, one?))) {
        let half = if trained.appearances { ", right half" } else { "" };
        rows.add(name, &format!("PSNR{half}{what}"), scored.psnr_db, "dB", None);
        rows.add(name, &format!("SSIM{half}{what}"), scored.ssim, "", None);
        rows.add(name, &format!("training{what}"), trained.seconds, "s", None);
        rows.add(name, &format!("vertices{what}"), trained.vertices as f64 / 1e6, "million", None);
        if let Some(peak) = trained.peak_mib {
            rows.add(name, &format!("memory in training{what}"), peak, "MiB", None);
        }
    }
}
