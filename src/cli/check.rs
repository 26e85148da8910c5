//! `cairn scene check`, `exclude`, `include`: which photographs are to be trusted.

use std::path::PathBuf;

use cairn_api::v1;

use super::connect::Connection;
use super::files::write;
use super::json::{self, Json};

/// `cairn scene check`.
#[derive(Clone, Debug, clap::Args)]
pub struct CheckArgs {
    /// The scene
    #[arg(value_name = "SCENE")]
    name: String,
    /// Measure again, whatever was measured before
    #[arg(long)]
    anew: bool,
    /// Also draw the most suspicious photographs beside their renders
    #[arg(long, value_name = "PNG")]
    picture: Option<PathBuf>,
    /// Also look for the eight most suspicious among the places that the other photographs tell: seconds each
    #[arg(long)]
    places: bool,
    #[command(flatten)]
    json: Json,
}

/// `cairn scene exclude`.
#[derive(Clone, Debug, clap::Args)]
pub struct ExcludeArgs {
    /// The scene
    #[arg(value_name = "SCENE")]
    name: String,
    /// The views, by name
    #[arg(required = true)]
    views: Vec<String>,
    /// Why, for those who read the list later
    #[arg(long, value_name = "TEXT", default_value = "")]
    why: String,
}

/// `cairn scene include`.
#[derive(Clone, Debug, clap::Args)]
pub struct IncludeArgs {
    /// The scene
    #[arg(value_name = "SCENE")]
    name: String,
    /// The views, by name
    #[arg(required = true)]
    views: Vec<String>,
}

/// Answers `cairn scene check`: a table of the views, the most suspicious first.
pub async fn check(line: &Connection, args: CheckArgs) -> anyhow::Result<()> {
    let (scene, anew, places) = (args.name.clone(), args.anew, args.places);
    let request = v1::CheckSceneRequest { scene, anew, picture: args.picture.is_some(), places };
    let mut answer = line.about(&args.name).scenes().check(request).await?.into_inner();
    if args.json.json {
        let png = std::mem::take(&mut answer.picture_png);
        args.picture.iter().try_for_each(|path| write(path, &png))?;
        return json::print(&answer);
    }
    table(&answer.views).iter().for_each(|line| println!("{line}"));
    if !answer.doubt.is_empty() {
        println!("{}", answer.doubt);
    } else if answer.median_fit_db > 0.0 {
        let (median, limit) = (answer.median_fit_db, answer.limit_fit_db);
        println!("the median view fits by {median:.2} dB, outliers by less than {limit:.2} dB");
    }
    if let Some(path) = &args.picture {
        write(path, &answer.picture_png)?;
        println!("photographs beside their renders in {}", path.display());
    }
    Ok(())
}

/// The columns, and those of them that say how structure from motion supports a view.
const HEADING: [&str; 7] = ["view", "contributor", "sigmas", "fit dB", "points", "error px", "state"];
const OF_SUPPORT: [usize; 2] = [4, 5];

/// The lines of the table. Where the support of no view is known its columns are left out, and a last line says why.
fn table(views: &[v1::CheckedView]) -> Vec<String> {
    let has_support = views.iter().any(|view| view.support.is_some());
    let rows: Vec<_> = std::iter::once(HEADING.map(str::to_owned)).chain(views.iter().map(row)).collect();
    let columns: Vec<usize> = (0..HEADING.len()).filter(|at| has_support || !OF_SUPPORT.contains(at)).collect();
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: [usize; 7] = std::array::from_fn(width);
    let line = |row: &[String; 7]| {
        let cell = |column: &usize| match (*column, &row[*column], widths[*column]) {
            // Numbers on the right.
            (2..=5, cell, width) => format!("{cell:>width$}"),
            (6, cell, _) => cell.clone(),
            (_, cell, width) => format!("{cell:<width$}"),
        };
        columns.iter().map(cell).collect::<Vec<_>>().join("  ")
    };
    let why = "the capture does not say which photographs saw its points, so points and errors of views are not known";
    rows.iter().map(line).chain((!has_support).then(|| why.to_owned())).collect()
}

fn row(view: &v1::CheckedView) -> [String; 7] {
    let (fit, support) = (view.fit.as_ref(), view.support.as_ref());
    let number = |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{v:.2}"));
    let mut state = Vec::new();
    if view.held_out {
        state.push("held out".to_owned());
    }
    state.extend(view.decision.as_ref().map(decision));
    if fit.is_some_and(|fit| fit.outlier) {
        state.push("outlier".to_owned());
    }
    state.extend(Some(view.against.clone()).filter(|against| !against.is_empty()));
    state.extend(view.found.as_ref().and_then(found));
    [
        view.view_name.clone(),
        view.contributor.clone(),
        fit.map_or("-".to_owned(), |fit| format!("{:.1}", fit.score)),
        number(fit.map(|fit| fit.fit_db)),
        support.map_or("-".to_owned(), |s| s.points.to_string()),
        number(support.filter(|s| s.points > 0).map(|s| s.reprojection_error_px)),
        state.join(", "),
    ]
}

/// Where the others' places have a photograph, in words.
fn found(found: &v1::Whereabouts) -> Option<String> {
    use v1::whereabouts::Answer;
    Some(match found.answer.as_ref()? {
        Answer::Off(v1::OffCamera { off_px, .. }) if off_px.is_infinite() => {
            "found, but its camera looks away".to_owned()
        }
        Answer::Off(v1::OffCamera { off_px, uncertainty_px }) if uncertainty_px.is_infinite() => {
            format!("found {off_px:.1} px off its camera, not known how surely")
        }
        Answer::Off(v1::OffCamera { off_px, uncertainty_px }) => {
            format!("found {off_px:.1} px off its camera, give or take {uncertainty_px:.1} px")
        }
        Answer::NotFound(why) => format!("not found: {why}"),
    })
}

/// What was decided about a view, in words.
pub fn decision(decision: &v1::ViewDecision) -> String {
    let what = match (decision.excluded, decision.automatic) {
        (true, true) => "excluded by training",
        (true, false) => "excluded",
        (false, _) => "included",
    };
    if decision.why.is_empty() { what.to_owned() } else { format!("{what} ({})", decision.why) }
}

/// Answers `cairn scene exclude`.
pub async fn exclude(line: &Connection, args: ExcludeArgs) -> anyhow::Result<()> {
    let ExcludeArgs { name, views, why } = args;
    let request = v1::ExcludeViewsRequest { scene: name.clone(), view_names: views, why };
    let answer = line.about(&name).scenes().exclude(request).await?.into_inner();
    println!("{}; train it again to have them out", excluded(answer.excluded, &name));
    Ok(())
}

/// Answers `cairn scene include`.
pub async fn include(line: &Connection, args: IncludeArgs) -> anyhow::Result<()> {
    let IncludeArgs { name, views } = args;
    let request = v1::IncludeViewsRequest { scene: name.clone(), view_names: views };
    let answer = line.about(&name).scenes().include(request).await?.into_inner();
    println!("{}; train it again where a view is in that was out", excluded(answer.excluded, &name));
    Ok(())
}

/// How many views are excluded, in words.
fn excluded(count: u32, scene: &str) -> String {
    match count {
        0 => format!("no view of {scene} is excluded"),
        1 => format!("1 view of {scene} is excluded"),
        _ => format!("{count} views of {scene} are excluded"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_known_of_no_view_is_said_once() {
        let view = |support| v1::CheckedView { view_name: "a.jpg".into(), support, ..v1::CheckedView::default() };
        let seen = view(Some(v1::Support { points: 7, reprojection_error_px: 0.5 }));
        let lines = table(&[seen, view(None)]);
        assert_eq!(lines.len(), 3, "{lines:?}");
        assert!(lines[0].contains("points  error px") && lines[1].contains("     7      0.50"), "{lines:?}");
        let lines = table(&[view(None), view(None)]);
        assert_eq!(lines.len(), 4, "{lines:?}");
        assert!(!lines[0].contains("points") && lines[3].contains("which photographs saw its points"), "{lines:?}");
    }

    #[test]
    fn where_a_photograph_is_found_is_said_in_words() {
        use v1::whereabouts::Answer;
        let off = |off_px, uncertainty_px| Answer::Off(v1::OffCamera { off_px, uncertainty_px });
        let said = |answer| found(&v1::Whereabouts { answer: Some(answer) }).unwrap();
        assert_eq!(said(off(212.04, 1.5)), "found 212.0 px off its camera, give or take 1.5 px");
        assert_eq!(said(off(0.4, f64::INFINITY)), "found 0.4 px off its camera, not known how surely");
        assert_eq!(said(off(f64::INFINITY, 1.5)), "found, but its camera looks away");
        assert_eq!(said(Answer::NotFound("too small".into())), "not found: too small");
    }
}
