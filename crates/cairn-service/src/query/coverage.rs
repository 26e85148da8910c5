//! Whose photographs show what a place sees: shares of contributors, and the map of them.

use std::collections::BTreeMap;

use cairn_field::{OfPixel, VisibleField as _};
use cairn_scene::{Camera, Picture, Unused};
use cairn_share::{SeenFrom, Shares, Sharpness};

use crate::config::Limits;
use crate::error::EngineError;
use crate::query::viewpoint::{FieldKind, Viewpoint, camera_of};
use crate::query::whose_map::WhoseMap;
use crate::records::credits::Credits;
use crate::store::model::Model;
use crate::store::snapshot::SceneSnapshot;

/// Rays that a view's shares are worked out from, at most about so many: of a larger picture every second pixel each
/// way, every third, and so on. A share may be off by 0.01; with so many those of liberty's held-out views are off by 0.0005
/// at most from those with 60,000 (400 x 600 px).
const MAX_RAYS: usize = 4_000;
/// The same of a map, whose pixels people look at.
const MAX_MAP_RAYS: usize = 60_000;
/// The map's longest side, px: a camera may ask for a picture that no screen shows.
const MAX_MAP_SIDE_PX: usize = 800;

/// Which place is asked about.
#[derive(Clone, Debug)]
pub struct Asked {
    /// From where.
    pub viewpoint: Viewpoint,
    /// The part of the picture; `None` is all of it.
    pub region: Option<Region>,
    /// Whether the map is drawn, too.
    pub map: bool,
    /// Whether the caller may see renders of the base field: a map of a scene without marks shows one.
    pub may_see_base: bool,
}

/// A rectangle of a picture, px. What of it lies outside of the picture is left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// Its left edge.
    pub left: usize,
    /// Its upper edge.
    pub top: usize,
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
}

/// Who contributed to a place. All shares together are 1.
#[derive(Clone, Debug)]
pub struct Contributors {
    /// Whose photographs show it, largest share first, then by name.
    pub shares: Vec<ContributorShare>,
    /// What photographs show that were excluded since the training.
    pub excluded: f64,
    /// What no photograph shows.
    pub unseen: f64,
    /// What lies behind the scene.
    pub behind: f64,
    /// Who took the view that was asked about; `None` for a camera, and for a view that is excluded.
    pub photographed_by: Option<String>,
    /// Why that view earns its contributor no share, where it is excluded or held out.
    pub view_unused: Option<Unused>,
    /// The map, where it was asked for.
    pub map: Option<Picture>,
}

/// A contributor's part of what is seen.
#[derive(Clone, Debug, PartialEq)]
pub struct ContributorShare {
    /// Their name.
    pub name: String,
    /// Above 0, to 1.
    pub share: f64,
    /// Their photographs that show some of it, by the views' names, largest share first, then by name.
    pub photographs: Vec<(String, f64)>,
    /// The records that credit them here, where these were looked up.
    pub credits: Credits,
}

impl Asked {
    /// All that is seen from `viewpoint`, without a map.
    pub fn about(viewpoint: Viewpoint) -> Self {
        Self { viewpoint, region: None, map: false, may_see_base: false }
    }
}

impl Region {
    /// The camera that takes this part of the picture of `camera` alone, pixel by pixel.
    ///
    /// # Errors
    /// [`EngineError::Invalid`] for a region without a pixel in the picture.
    fn of(&self, camera: &Camera) -> Result<Camera, EngineError> {
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        if self.width == 0 || self.height == 0 || self.left >= width || self.top >= height {
            let got = format!("{} x {} px from ({}, {})", self.width, self.height, self.left, self.top);
            let allowed = format!("a rectangle that begins within {width} x {height} px");
            return Err(EngineError::invalid("the region", got, allowed));
        }
        let mut part = *camera;
        part.intrinsics.width = self.width.min(width - self.left);
        part.intrinsics.height = self.height.min(height - self.top);
        part.intrinsics.cx -= self.left as f64;
        part.intrinsics.cy -= self.top as f64;
        Ok(part)
    }
}

/// Whose photographs show what is asked about.
///
/// # Errors
/// As [`camera_of`]; [`EngineError::Invalid`] for a region outside of the picture; [`EngineError::WrongState`] for a map
/// that would show what the caller may not see; what is said of [`Model::share_table`].
pub fn contributors(
    model: &Model,
    snapshot: &SceneSnapshot,
    asked: &Asked,
    limits: &Limits,
) -> Result<Contributors, EngineError> {
    let whole = camera_of("the view", snapshot, &asked.viewpoint, limits)?;
    let camera = asked.region.map_or(Ok(whole), |region| region.of(&whole))?;
    let table = model.share_table()?;
    let from = SeenFrom::new(table, &*model.base, camera.pose.position, Sharpness::default());
    let few = sampled(&camera);
    let seen = model.base.row_weights(&few, OfPixel::All);
    let Shares { of_photographs, unseen, behind } = from.shares(&seen);

    let views = &snapshot.scene.capture().views;
    let takers: BTreeMap<&str, &str> =
        views.iter().map(|view| (view.name.as_str(), view.contributor.as_str())).collect();
    // An excluded photograph is credited to no contributor.
    let taker = |view: &str| takers.get(view).copied().filter(|_| !snapshot.is_out(view));
    let mut of: BTreeMap<&str, Vec<(String, f64)>> = BTreeMap::new();
    let mut excluded = 0.0;
    for (photograph, share) in table.photographs().iter().zip(&of_photographs) {
        match taker(&photograph.name) {
            None => excluded += share,
            Some(_) if *share <= 0.0 => {}
            Some(name) => of.entry(name).or_default().push((photograph.name.clone(), *share)),
        }
    }
    let mut shares: Vec<ContributorShare> = of.into_iter().map(|(name, own)| ContributorShare::of(name, own)).collect();
    shares.sort_by(|a, b| b.share.total_cmp(&a.share).then_with(|| a.name.cmp(&b.name)));
    let (photographed_by, view_unused) = match &asked.viewpoint {
        Viewpoint::View(name) => {
            let name = snapshot.full_name(name)?;
            (taker(name).map(str::to_owned), snapshot.unused(name))
        }
        Viewpoint::Camera(_) => (None, None),
    };
    if asked.map && model.mark.is_none() && !asked.may_see_base {
        let what = format!("scene {:?}", snapshot.name);
        let why = "its newest model has no marks, and a map of it shows the base field; ask again with a token";
        return Err(EngineError::wrong_state(what, "drawn", why));
    }
    let mut found = Contributors { shares, excluded, unseen, behind, photographed_by, view_unused, map: None };
    if asked.map {
        let camera = within(&camera, MAX_MAP_SIDE_PX);
        let contributors: Vec<(&str, f64)> = found.shares.iter().map(|of| (of.name.as_str(), of.share)).collect();
        let group = |view: &str| taker(view).map_or(WhoseMap::EXCLUDED, |name| WhoseMap::group_of(&contributors, name));
        let group_of: Vec<usize> = table.photographs().iter().map(|photograph| group(&photograph.name)).collect();
        let coarse = at_most(&camera, MAX_MAP_RAYS);
        let seen = if coarse == few { seen } else { model.base.row_weights(&coarse, OfPixel::All) };
        let (pixels, pixels_across) = (from.map(&coarse, &seen, &group_of), coarse.intrinsics.width);
        let kind = if model.mark.is_some() { FieldKind::Marked } else { FieldKind::Base };
        let render = model.look(kind, &camera, model.base.canonical_appearance())?;
        let Contributors { excluded, unseen, behind, .. } = found;
        let (pixels, contributors) = (&pixels, &contributors);
        let map = WhoseMap { render: &render, pixels, pixels_across, contributors, excluded, unseen, behind };
        found.map = Some(map.draw());
    }
    Ok(found)
}

/// The camera that takes the pixels that shares are worked out from: of a large picture every second one each way, or
/// every third, and so on.
pub(crate) fn sampled(camera: &Camera) -> Camera {
    at_most(camera, MAX_RAYS)
}

/// The same of about so many pixels at most.
fn at_most(camera: &Camera, max: usize) -> Camera {
    let (w, h) = (camera.intrinsics.width, camera.intrinsics.height);
    let every = ((w * h) as f64 / max as f64).sqrt().ceil().max(1.0) as usize;
    if every == 1 { *camera } else { camera.resized((w / every).max(1), (h / every).max(1)) }
}

/// The camera, made smaller where a side is longer than so many px.
fn within(camera: &Camera, longest_px: usize) -> Camera {
    let (w, h) = (camera.intrinsics.width, camera.intrinsics.height);
    let longest = w.max(h);
    if longest <= longest_px {
        return *camera;
    }
    let side = |px: usize| (px * longest_px / longest).max(1);
    camera.resized(side(w), side(h))
}

impl ContributorShare {
    fn of(name: &str, mut photographs: Vec<(String, f64)>) -> Self {
        photographs.sort_by(|a, b| b.1.total_cmp(&a.1).then_with(|| a.0.cmp(&b.0)));
        let share = photographs.iter().map(|(_, share)| share).sum();
        Self { name: name.to_owned(), share, photographs, credits: Credits::default() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_region_is_a_part_of_the_picture() {
        let intrinsics = cairn_scene::Intrinsics {
            width: 40,
            height: 30,
            fx: 40.0,
            fy: 40.0,
            cx: 20.0,
            cy: 15.0,
            distortion: cairn_scene::Distortion::default(),
        };
        let pose = cairn_scene::Pose::look_at(glam::DVec3::ZERO, glam::DVec3::X, glam::DVec3::Z).unwrap();
        let camera = Camera { intrinsics, pose };
        let at = |left, top, width, height| Region { left, top, width, height }.of(&camera);
        for outside in [at(40, 0, 1, 1), at(0, 30, 1, 1), at(0, 0, 0, 1), at(0, 0, 1, 0)] {
            let refused = outside.unwrap_err().to_string();
            assert!(refused.contains("the region") && refused.contains("40 x 30 px"), "{refused}");
        }
        // The same rays, and no more than the picture has.
        let part = at(10, 5, 500, 2).unwrap();
        assert_eq!((part.intrinsics.width, part.intrinsics.height), (30, 2));
        assert!((part.ray(0.5, 1.5).1 - camera.ray(10.5, 6.5).1).length() < 1e-12);
        assert_eq!(within(&camera, 20).intrinsics.height, 15);
        assert_eq!(within(&camera, 40), camera);
    }
}
