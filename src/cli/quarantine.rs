//! `cairn quarantine`: views that the others do not explain; list, release and remove them.

use cairn_api::v1;

use super::connect::Connection;
use super::refused::refused;

/// What to do with views in quarantine.
#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// The views of a scene that are, or were, in quarantine, by contributor
    List {
        /// The scene
        scene: String,
    },
    /// Say that views are good: the next training trains on them again
    Release {
        /// The scene
        scene: String,
        /// The views, by name
        #[arg(required = true)]
        views: Vec<String>,
    },
    /// Remove views for good, in quarantine or not; their photographs are deleted from the disk
    Remove {
        /// The scene
        scene: String,
        /// The views, by name
        #[arg(required = true)]
        views: Vec<String>,
    },
}

/// Answers `cairn quarantine`.
pub async fn run(line: &Connection, command: Command) -> anyhow::Result<()> {
    match command {
        Command::List { scene } => list(line, scene).await,
        Command::Release { scene, views } => {
            let request = v1::ReleaseViewsRequest { scene: scene.clone(), view_names: views };
            let answer = line.about(&scene).quarantine().release(request).await.map_err(refused)?.into_inner();
            answer.views.iter().for_each(|view| println!("{}", one_line(view)));
            println!("train {scene} again to have them in");
            Ok(())
        }
        Command::Remove { scene, views } => {
            let request = v1::RemoveViewsRequest { scene: scene.clone(), view_names: views };
            let answer = line.about(&scene).quarantine().remove(request).await.map_err(refused)?.into_inner();
            answer.views.iter().for_each(|view| println!("{}", one_line(view)));
            Ok(())
        }
    }
}

async fn list(line: &Connection, scene: String) -> anyhow::Result<()> {
    let request = v1::ListQuarantineRequest { scene: scene.clone() };
    let groups = line.about(&scene).quarantine().list(request).await.map_err(refused)?.into_inner().groups;
    if groups.is_empty() {
        println!("no view of {scene} is, or was, in quarantine");
    }
    for group in groups {
        println!("{}: {} of {} views", group.contributor, held(&group), group.views_in_scene);
        group.views.iter().for_each(|view| println!("  {}", one_line(view)));
    }
    Ok(())
}

/// How many of a contributor's views are in quarantine now.
fn held(group: &v1::QuarantineGroup) -> usize {
    group.views.iter().filter(|v| v.standing() == v1::QuarantineStanding::Quarantined).count()
}

fn one_line(view: &v1::QuarantinedView) -> String {
    let standing = match view.standing() {
        v1::QuarantineStanding::Quarantined => "in quarantine",
        v1::QuarantineStanding::Released => "released",
        v1::QuarantineStanding::Removed => "removed",
        v1::QuarantineStanding::Unspecified => "unknown to this release",
    };
    let Some(f) = &view.figures else { return format!("{}  {standing}", view.view_name) };
    format!(
        "{}  {standing}: fits its pose by {:.2} dB, the median view by {:.2} dB; outliers by less than {:.2} dB ({})",
        view.view_name, f.fit_db, f.median_db, f.limit_db, f.job_id
    )
}
