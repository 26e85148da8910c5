//! Suite `few`: what stage 1 makes of ten photographs of a capture, as a visitor brings them home,
//! with what it does where views look far apart, and without.

use std::sync::Arc;

use anyhow::Context as _;
use cairn_field::{FieldConfig, Spacing};

use super::super::super::connect::Where;
use super::super::Args;
use super::super::children::Children;
use super::super::rows::Rows;
use super::case::Case;
use super::{Run, score, train, unless_stopped, wanted};

/// Views to train on, and to score on, at most.
const VIEWS: usize = 10;
/// `field.smoother_beyond_deg` that never takes effect.
const NEVER_DEG: f64 = 180.0;

/// What came of one capture.
struct Found {
    spacing: Spacing,
    shipped: (train::Trained, score::Scored),
    /// With [`NEVER_DEG`]; none where that is the same training.
    never: Option<(train::Trained, score::Scored)>,
}

/// Measures the captures that were asked for and puts each one's rows into the ledger.
pub async fn measure(place: &Where, args: &Args, rows: &mut Rows) -> anyhow::Result<()> {
    let (captures, cases) = wanted(args)?;
    std::fs::create_dir_all(&args.out).with_context(|| format!("cannot make the folder {}", args.out.display()))?;
    let children = Arc::new(Children::default());
    for case in cases {
        let mut run = Run::new(place, args, case, &captures)?;
        run.source.most_views = Some(VIEWS);
        let work = tokio::task::spawn_blocking({
            let children = children.clone();
            move || run.of_few(&children)
        });
        let found = unless_stopped(work, &children).await?;
        let name = args.case_name(case.name.as_str());
        add(rows, &format!("{name}, ten views"), case, &found);
        rows.save(args)?;
    }
    Ok(())
}

impl Run {
    fn of_few(&self, children: &Children) -> anyhow::Result<Found> {
        let opened = self.source.open()?;
        let cameras: Vec<_> = opened.training().into_iter().map(|view| opened.camera(view)).collect();
        let spacing = Spacing::of(&cameras, &self.config);
        drop(opened);
        let one = |what: &str, config: FieldConfig| {
            let file = format!("{}-few-{}-{}.field", self.name, self.seed, what.replace(' ', "-"));
            self.trained(children, config, self.out.join(file), &format!("ten views, {what}"))
        };
        let shipped = one("as shipped", self.config.clone())?;
        let never = FieldConfig { smoother_beyond_deg: NEVER_DEG, ..self.config.clone() };
        let never = (spacing.smoothing > 1.0).then(|| one("never smoother", never)).transpose()?;
        Ok(Found { spacing, shipped, never })
    }
}

fn add(rows: &mut Rows, name: &str, case: &Case, found: &Found) {
    let half = if case.right_half { ", right half" } else { "" };
    rows.add(name, "views look apart", found.spacing.apart_deg, "degrees", None);
    rows.add(name, "smoother by", found.spacing.smoothing, "", None);
    for (what, (trained, scored)) in [("", Some(&found.shipped)), (", never smoother", found.never.as_ref())]
        .into_iter()
        .filter_map(|(what, one)| one.map(|one| (what, one)))
    {
        rows.add(name, &format!("PSNR{half}{what}"), scored.psnr_db, "dB", None);
        rows.add(name, &format!("SSIM{half}{what}"), scored.ssim, "", None);
        rows.add(name, &format!("training{what}"), trained.seconds, "s", None);
    }
}
