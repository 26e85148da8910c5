//! `cairn audit shares`: the shares that a registry signed, worked out again from the base field, its share table and the
//! view's camera; with a scene in hand the table's own entries, too.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context as _;
use cairn_durable::read_limited;
use cairn_log::Digest;
use cairn_log::format::record::random_salt;
use cairn_log::format::shares::{PhotographShare, SharedView, Shares};
use cairn_scene::{Camera, SceneFolder, View};
use cairn_service::query::recount::{self, Method, Misplaced, Taught};
use cairn_verify::{Code, FileInHand, Finding};

use super::answer::{Asked, MAX_ANSWER_BYTES};

/// How far a share may be from the one that is worked out again: the method and the rays are the same, and only the order
/// in which a machine adds differs.
const MAX_SHARE_ERROR: f64 = 1e-3;
/// How far what a photograph taught may be from what the table says, as a part of it: a number between two codes may be
/// rounded to either on another machine, which is 7 % of it, and few numbers lie so.
const MAX_LESSON_ERROR: f64 = 0.05;

/// `cairn audit shares`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// The answer about a view, JSON (see `cairn owners answer --view`)
    #[arg(value_name = "F")]
    pub answer: PathBuf,
    /// The base field's file
    #[arg(long, value_name = "FILE")]
    pub base_field: PathBuf,
    /// Its share table
    #[arg(long, value_name = "FILE")]
    pub share_table: PathBuf,
    /// The scene's folder, such as cairn-data/scenes/liberty: cameras, names and photographs are held to it, and the
    /// table's entries of sampled photographs
    #[arg(long, value_name = "DIR")]
    pub scene_folder: Option<PathBuf>,
    /// The training's settings (settings.toml), for --scene-folder; looked for beside the base field where not given
    #[arg(long, value_name = "FILE", requires = "scene_folder")]
    pub settings: Option<PathBuf>,
    /// How many photographs are drawn at random, for --scene-folder, 1 to 65,536; as many with the largest shares are
    /// looked at besides
    #[arg(long, value_name = "N", default_value_t = 3, requires = "scene_folder",
          value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub photographs: u32,
    #[command(flatten)]
    pub asked: Asked,
    /// The log's public key (see `cairn owners vkey`), obtained elsewhere; without it nothing is trusted
    #[arg(long, value_name = "FILE")]
    pub vkey: Option<PathBuf>,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
}

/// Answers `cairn audit shares`.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    anyhow::ensure!(
        args.asked.scene.is_none() || args.asked.view.is_some(),
        "--scene is given without --view; shares are of a view, so name the photograph that was asked about, too"
    );
    let answer = read_limited(&args.answer, MAX_ANSWER_BYTES)?;
    let pinned = args.vkey.as_deref().map(super::trust::vkey).transpose()?;
    let report = cairn_verify::audit_shares_to(&answer, pinned.as_ref(), args.asked.question()?.as_ref());
    let more = match &report.shares {
        Some(shares) => again(args, shares)?,
        None => Vec::new(),
    };
    let report = report.with(more);
    super::trust::show(&report, args.json.then(|| report.to_json()));
    Ok(super::trust::exit(report.outcome))
}

/// What working the shares out again finds.
fn again(args: &Args, shares: &Shares) -> anyhow::Result<Vec<Finding>> {
    let mut findings = Vec::new();
    let mut are_the_files = true;
    for (path, expected) in [(&args.base_field, shares.files.base_field), (&args.share_table, shares.files.share_table)]
    {
        are_the_files &= held_to(path, &expected, &mut findings)?;
    }
    let camera: Camera = match serde_json::from_value(shares.camera.clone()) {
        Ok(camera) => camera,
        Err(e) => {
            let finding =
                Finding::of(Code::SharesCameraMismatch, "statement, field camera", "a camera", &e.to_string());
            findings.push(finding);
            return Ok(findings);
        }
    };
    let scene = args.scene_folder.as_deref().map(open).transpose()?;
    match &scene {
        Some(scene) => {
            findings.push(held_to_scene(shares, &camera, scene));
            findings.extend(held_to_takers(shares, scene));
        }
        None => {
            let (expected, got) = ("the scene's folder", "nothing in hand");
            findings.push(Finding::of(Code::SharesSceneUnchecked, "statement and share table", expected, got));
            findings.push(Finding::of(Code::SharesRowsUnchecked, "share table", expected, got));
        }
    }
    if !are_the_files || !is_known(shares, &camera, &mut findings) {
        return Ok(findings);
    }
    let taught = Taught::read(&args.base_field, &args.share_table)?;
    compare(shares, &taught.shares(&camera)?, &mut findings);
    if let Some(scene) = &scene {
        findings.extend(left_out(shares, &taught, scene));
        findings.extend(positions(&taught, scene));
        lessons(args, shares, &taught, scene, &mut findings)?;
    }
    Ok(findings)
}

/// Whether the file at `path` is the one that the statement names.
fn held_to(path: &Path, expected: &Digest, findings: &mut Vec<Finding>) -> anyhow::Result<bool> {
    let FileInHand { place, digest } = FileInHand::read(path)?;
    let (expected, got) = (expected.to_string(), digest.to_string());
    let is_same = expected == got;
    findings.push(if is_same {
        Finding::of(Code::SharesFileMatch, &place, "", &got)
    } else {
        Finding::of(Code::SharesFileMismatch, &place, &expected, &got)
    });
    Ok(is_same)
}

fn open(folder: &Path) -> anyhow::Result<SceneFolder> {
    let name = folder.file_name().and_then(|name| name.to_str());
    let (name, above) = name.zip(folder.parent()).with_context(|| {
        format!("{} is no scene's folder; give one such as cairn-data/scenes/liberty", folder.display())
    })?;
    let above = if above.as_os_str().is_empty() { Path::new(".") } else { above };
    Ok(SceneFolder::open(above, name)?)
}

/// Whether the scene's view has the statement's camera and photograph.
fn held_to_scene(shares: &Shares, camera: &Camera, scene: &SceneFolder) -> Finding {
    let (place, view) = (format!("{}, view {:?}", scene.folder().display(), shares.view.name), &shares.view);
    let views = &scene.capture().views;
    let Some(at) = views.iter().position(|known| known.name == view.name) else {
        return Finding::of(Code::SharesCameraMismatch, &place, "the statement's view", "no view of this name");
    };
    let photograph = Digest::from_bytes(scene.photograph_digest(at));
    if photograph != view.photograph {
        let expected = format!("photograph {}", view.photograph);
        return Finding::of(Code::SharesCameraMismatch, &place, &expected, &photograph.to_string());
    }
    // Compared as they are written, so that both went through the same rounding.
    let text = |camera: &Camera| serde_json::to_string(camera).unwrap_or_default();
    let (expected, got) = (text(camera), text(&views[at].camera));
    if expected == got {
        Finding::of(Code::SharesCameraMatch, &place, "", &format!("photograph {photograph}, and its camera"))
    } else {
        Finding::of(Code::SharesCameraMismatch, &place, &expected, &got)
    }
}

/// The photographs of the statement that are others in the scene, or another contributor's.
fn held_to_takers(shares: &Shares, scene: &SceneFolder) -> Vec<Finding> {
    let views = scene.capture().views.iter().enumerate();
    let known: BTreeMap<&str, (&str, Digest)> = views
        .map(|(i, view)| {
            (view.name.as_str(), (view.contributor.as_str(), Digest::from_bytes(scene.photograph_digest(i))))
        })
        .collect();
    let named = shares.contributors.iter().flat_map(|of| of.photographs.iter().map(move |one| (of.name.as_str(), one)));
    let wrong = named.filter(|(name, one)| known.get(one.view.as_str()) != Some(&(*name, one.photograph)));
    let is_another =
        |view: &&SharedView| known.get(view.name.as_str()).is_none_or(|(_, digest)| *digest != view.photograph);
    let wrongly_excluded = shares.excluded_views.iter().filter(is_another).map(|view| {
        let place = format!("statement, excluded view {:?}", view.name);
        let expected =
            known.get(view.name.as_str()).map_or_else(|| "none".to_owned(), |(_, digest)| digest.to_string());
        Finding::of(Code::SharesPhotographMismatch, &place, &expected, &view.photograph.to_string())
    });
    let words = |name: &str, photograph: &Digest| format!("{photograph} by {name:?}");
    let finding = |(name, one): (&str, &PhotographShare)| {
        let place = format!("statement, photograph {:?}", one.view);
        let expected = known.get(one.view.as_str()).map_or_else(|| "none".to_owned(), |(by, digest)| words(by, digest));
        Finding::of(Code::SharesPhotographMismatch, &place, &expected, &words(name, &one.photograph))
    };
    wrong.map(finding).chain(wrongly_excluded).collect()
}

/// Whether the shares were worked out as this release does it.
fn is_known(shares: &Shares, camera: &Camera, findings: &mut Vec<Finding>) -> bool {
    let said =
        Method { power: shares.power, width: shares.sampled.width as usize, height: shares.sampled.height as usize };
    let words = |method: &Method| format!("power {}, {} x {} px", method.power, method.width, method.height);
    let (expected, got) = match recount::method(camera) {
        Ok(method) if method == said => return true,
        Ok(method) => (words(&method), words(&said)),
        Err(e) => ("a camera that this release looks through".to_owned(), e.to_string()),
    };
    findings.push(Finding::of(Code::SharesMethodUnknown, "statement, fields power and sampled", &expected, &got));
    false
}

/// Holds every share to the one that was worked out again.
fn compare(shares: &Shares, again: &recount::Recount, findings: &mut Vec<Finding>) {
    let mut left: BTreeMap<&str, f64> = again.photographs.iter().map(|(name, share)| (name.as_str(), *share)).collect();
    let (mut worst, mut count) = (0f64, 0);
    let mut hold = |what: String, said: f64, again: f64| {
        let off = (said - again).abs();
        (worst, count) = (worst.max(off), count + 1);
        if off > MAX_SHARE_ERROR {
            let expected = format!("{:.2} %, {:.1} % more or less", 100.0 * again, 100.0 * MAX_SHARE_ERROR);
            let got = format!("{:.2} %", 100.0 * said);
            findings.push(Finding::of(Code::SharesRecomputedMismatch, &what, &expected, &got));
        }
    };
    for of in &shares.contributors {
        let mut sum = 0.0;
        for photograph in &of.photographs {
            // A photograph that the table has not, or that is named twice, has no share.
            let again = left.remove(photograph.view.as_str()).unwrap_or(0.0);
            sum += again;
            hold(format!("share of photograph {:?}", photograph.view), photograph.share, again);
        }
        hold(format!("share of contributor {:?}", of.name), of.share, sum);
    }
    let listed = shares.excluded_views.iter();
    let excluded = listed.filter_map(|view| left.remove(view.name.as_str())).sum();
    hold("share of excluded photographs".to_owned(), shares.excluded, excluded);
    // The table has others: the statement left them out.
    for (name, again) in left {
        hold(format!("share of photograph {name:?}, neither credited nor excluded"), 0.0, again);
    }
    hold("share that no photograph shows".to_owned(), shares.unseen, again.unseen);
    hold("share behind the scene".to_owned(), shares.behind, again.behind);
    if findings.iter().all(|finding| finding.code != Code::SharesRecomputedMismatch) {
        let got = format!("{count} shares, {:.3} % off at most", 100.0 * worst);
        findings.push(Finding::of(Code::SharesRecomputed, "shares", "", &got));
    }
}

/// The scene's photographs that are not held out, and that the table does not have.
fn left_out(shares: &Shares, taught: &Taught, scene: &SceneFolder) -> Vec<Finding> {
    let has: BTreeSet<&str> = taught.names().collect();
    let excluded: BTreeSet<&str> = shares.excluded_views.iter().map(|view| view.name.as_str()).collect();
    let is_left_out = |view: &&View| !view.held_out && !has.contains(view.name.as_str());
    let finding = |view: &View| {
        let place = format!("share table, photograph {:?} by {:?}", view.name, view.contributor);
        let got = match excluded.contains(view.name.as_str()) {
            true => "none; the statement lists the view as excluded",
            false => "none, and the statement does not list the view as excluded",
        };
        Finding::of(Code::SharesPhotographLeftOut, &place, "an entry", got)
    };
    scene.capture().views.iter().filter(is_left_out).map(finding).collect()
}

/// Holds where the table has each photograph's camera to the scene.
fn positions(taught: &Taught, scene: &SceneFolder) -> Vec<Finding> {
    let misplaced = taught.misplaced(scene);
    if misplaced.is_empty() {
        let got = format!("{} cameras", taught.names().count());
        return vec![Finding::of(Code::SharesPositionMatch, "share table", "", &got)];
    }
    let finding = |of: &Misplaced| {
        let place = format!("share table, camera of photograph {:?}", of.view);
        let expected = of.in_scene.map_or_else(|| "no view of this name".to_owned(), |at| format!("{at:?}"));
        Finding::of(Code::SharesPositionMismatch, &place, &expected, &format!("{:?}", of.in_table))
    };
    misplaced.iter().map(finding).collect()
}

/// Which of the photographs `known` are looked at: the `count` of them that are `credited` with most, and `count` others,
/// which cannot be foreseen without `salt`.
fn drawn(known: &[&str], credited: &[&PhotographShare], count: usize, salt: &Digest) -> BTreeSet<String> {
    let mut largest = credited.to_vec();
    largest.sort_by(|a, b| b.share.total_cmp(&a.share).then_with(|| a.view.cmp(&b.view)));
    let is_known: BTreeSet<&str> = known.iter().copied().collect();
    let largest = largest.iter().map(|of| of.view.as_str()).filter(|name| is_known.contains(name)).take(count);
    let mut drawn: BTreeSet<String> = largest.map(str::to_owned).collect();
    let place = |name: &str| Digest::of_parts(&[salt.as_bytes(), name.as_bytes()]);
    let mut others: Vec<&str> = known.iter().copied().filter(|name| !drawn.contains(*name)).collect();
    others.sort_by_cached_key(|name| place(name));
    drawn.extend(others.into_iter().take(count).map(str::to_owned));
    drawn
}

/// Holds the table's entries of some photographs to what these teach the field.
fn lessons(
    args: &Args,
    shares: &Shares,
    taught: &Taught,
    scene: &SceneFolder,
    findings: &mut Vec<Finding>,
) -> anyhow::Result<()> {
    let beside = || args.base_field.with_file_name("settings.toml");
    let settings = args.settings.clone().unwrap_or_else(beside);
    let how = "the training's settings (--settings); they say how residuals counted";
    if !held_to(&settings, &shares.files.settings, findings).context(how)? {
        return Ok(());
    }
    let there: BTreeSet<&str> = scene.capture().views.iter().map(|view| view.name.as_str()).collect();
    // What the scene does not have was named with the cameras.
    let known: Vec<&str> = taught.names().filter(|name| there.contains(name)).collect();
    let credited: Vec<&PhotographShare> = shares.contributors.iter().flat_map(|of| &of.photographs).collect();
    let looked_at = drawn(&known, &credited, args.photographs as usize, &random_salt()?);
    let (count, all) = (looked_at.len(), taught.names().count());
    if count < all {
        let got = format!("{count} were looked at");
        findings.push(Finding::of(Code::SharesRowsUnchecked, "share table", &format!("all {all} photographs"), &got));
    }
    for compared in taught.compare(scene, recount::huber(&settings)?, &looked_at)? {
        let place = format!("share table, photograph {:?}", compared.view);
        let said = |pixels: f64| format!("{pixels:.1} px of light");
        findings.push(if compared.apart <= MAX_LESSON_ERROR {
            let got = format!("{}, {:.2} % apart by rows", said(compared.in_table), 100.0 * compared.apart);
            Finding::of(Code::SharesRowsMatch, &place, "", &got)
        } else {
            let expected = format!("{}, as the scene's photograph teaches the field", said(compared.again));
            let got = format!("{}, {:.0} % apart by rows", said(compared.in_table), 100.0 * compared.apart);
            Finding::of(Code::SharesRowsMismatch, &place, &expected, &got)
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_shares_are_always_looked_at_and_the_others_cannot_be_foreseen() {
        let names: Vec<String> = (0..100).map(|number| format!("view_{number:02}.jpg")).collect();
        let known: Vec<&str> = names.iter().map(String::as_str).collect();
        let share = |name: &str, share| PhotographShare { view: name.into(), photograph: Digest::of(name), share };
        // One with the largest share that the scene does not have is no reason to look at fewer.
        let credited =
            [share("gone.jpg", 0.5), share("view_07.jpg", 0.1), share("view_05.jpg", 0.3), share("view_99.jpg", 0.05)];
        let credited: Vec<&PhotographShare> = credited.iter().collect();
        let drawn = |salt: &str| drawn(&known, &credited, 2, &Digest::of(salt));
        let several: BTreeSet<BTreeSet<String>> = (0..8).map(|salt| drawn(&format!("salt {salt}"))).collect();
        assert!(several.len() > 1, "{several:?}");
        for names in &several {
            assert!(names.len() == 4 && names.contains("view_05.jpg") && names.contains("view_07.jpg"), "{names:?}");
        }
        assert_eq!(super::drawn(&known, &credited, 65_536, &Digest::of("salt")).len(), known.len());
    }
}
