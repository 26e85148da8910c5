//! A sample of each scene's views, rendered again from the stored files: is the mark
//! still there, and does it lead to whose it is? Loads models as the daemon does, and
//! writes nothing.

use std::path::Path;

use cairn_scene::SceneFolder;
use cairn_verify::{Code, Finding};

use cairn_service::error::EngineError;
use cairn_service::query::evaluate::eight_bits;
use cairn_service::store::model::{self, Model, ModelInfo};
use cairn_service::store::scenes;

/// Renders `sample` views of every scene whose newest model has marks, and looks for the marks. Nothing here is an
/// error: what cannot be rendered is a finding.
pub fn check(data: &Path, sample: usize) -> Vec<Finding> {
    let (folder, models) = (data.join("scenes"), data.join("models"));
    if sample == 0 || !folder.is_dir() {
        return Vec::new();
    }
    let names = match scenes::list(&folder) {
        Ok(names) => names,
        Err(e) => return vec![failed("scenes", &e)],
    };
    names.iter().filter_map(|name| scene(&folder, &models, name, sample)).collect()
}

/// One scene; none where there is nothing to look for.
fn scene(folder: &Path, models: &Path, name: &str, sample: usize) -> Option<Finding> {
    let info = match model::newest(models, name) {
        Ok(info) => info.filter(|info| info.mark.is_some())?,
        Err(e) => return Some(failed(&format!("models/{name}"), &e)),
    };
    let place = format!("models/{name}/{}", info.job);
    match look(folder, models, info, sample) {
        Ok((0, asked)) => {
            let got = format!("none of {asked}");
            Some(Finding::of(Code::RenderMarkLost, &place, "a sampled view that leads to its cluster's identity", &got))
        }
        Ok((right, asked)) => {
            Some(Finding::of(Code::RenderMarkFound, &place, "", &format!("in {right} of {asked} sampled views")))
        }
        Err(e) => Some(failed(&place, &e)),
    }
}

fn failed(place: &str, error: &EngineError) -> Finding {
    Finding::of(Code::RenderFailed, place, "views that can be rendered", &error.to_string())
}

/// How many of the sampled views lead to their cluster's identity, and how many were asked.
fn look(folder: &Path, models: &Path, info: ModelInfo, sample: usize) -> Result<(usize, usize), EngineError> {
    let scene = SceneFolder::open(folder, &info.scene)?;
    let views = &scene.capture().views;
    let of_clusters: Vec<usize> =
        (0..views.len()).filter(|at| info.identities.iter().any(|i| i.views.contains(&views[*at].name))).collect();
    let model = Model::load(models, info)?;
    let mark = model.mark()?;
    // Spread over the whole capture, the same ones every time.
    let step = of_clusters.len().div_ceil(sample.max(1)).max(1);
    let (mut right, mut asked) = (0, 0);
    for at in of_clusters.into_iter().step_by(step) {
        let view = &views[at];
        let lights = model.base.appearances();
        let own = lights.iter().find(|(name, _)| *name == view.name).map(|(_, light)| light.clone());
        let light = own.unwrap_or_else(|| model.base.canonical_appearance().clone());
        let found = mark.detect(&eight_bits(&mark.field.render(&view.camera, &light))?)?;
        let named = found.identity.and_then(|number| model.info.identity(number).ok());
        right += usize::from(named.is_some_and(|identity| identity.views.contains(&view.name)));
        asked += 1;
    }
    Ok((right, asked))
}
