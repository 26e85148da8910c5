//! Photographs as training uses them: in 8 bits, with their lenses, and what lies over the scene in them.

use crate::config::FieldConfig;
use crate::error::FieldError;
use crate::rays::Lens;
use crate::sampling::Tile;
use crate::watermark::{Seen, VisibleWatermark, find};
use cairn_scene::{Camera, Picture};
use rayon::prelude::*;
use std::sync::Arc;

/// One photograph to learn from.
#[derive(Clone, Debug)]
pub struct TrainingView {
    /// The view's name, unique in the scene.
    pub name: String,
    /// Who took it; what all of a contributor's photographs carry at one place of the frame is no part of the scene
    /// ([`FieldConfig::leave_out_watermarks`]).
    pub contributor: String,
    /// Its camera, at the photograph's resolution.
    pub camera: Camera,
    /// The photograph.
    pub picture: Arc<Picture>,
}

/// A view as training keeps it until it is prepared: a quarter of the size of a [`TrainingView`]. Who reads photograph
/// after photograph keeps each so ([`ToLearn::kept`]), and holds one of them in full at a time.
#[derive(Clone, Debug)]
pub struct KeptView {
    name: String,
    contributor: String,
    camera: Camera,
    /// 8-bit RGB.
    pixels: Vec<u8>,
}

/// A view to learn from, in full or as it is kept. Both give the same field.
pub trait ToLearn: Send {
    /// The view's name.
    fn name(&self) -> &str;

    /// The view as training keeps it.
    ///
    /// # Errors
    /// [`FieldError::Views`] for a picture whose size is not its camera's, or with a number that is not finite.
    fn kept(self) -> Result<KeptView, FieldError>;
}

impl ToLearn for TrainingView {
    fn name(&self) -> &str {
        &self.name
    }

    fn kept(self) -> Result<KeptView, FieldError> {
        check(&self)?;
        let pixels = self.picture.to_rgb8();
        Ok(KeptView { name: self.name, contributor: self.contributor, camera: self.camera, pixels })
    }
}

impl ToLearn for KeptView {
    fn name(&self) -> &str {
        &self.name
    }

    fn kept(self) -> Result<KeptView, FieldError> {
        Ok(self)
    }
}

/// A view as training uses it: 8-bit pixels (what photographs have) and its lens.
pub(crate) struct Prepared {
    pub(crate) name: String,
    pub(crate) camera: Camera,
    pub(crate) lens: Arc<Lens>,
    pub(crate) pixels: Vec<u8>,
    /// What lies over the scene in it.
    pub(crate) watermark: Option<Arc<VisibleWatermark>>,
}

impl Prepared {
    /// Whether pixel `at` shows the scene.
    pub(crate) fn shows_scene(&self, at: usize) -> bool {
        self.watermark.as_ref().is_none_or(|mark| !mark.covered[at])
    }

    /// Pixels of a tile that show the scene.
    pub(crate) fn shown_in(&self, tile: &Tile) -> usize {
        if self.watermark.is_none() {
            return tile.len();
        }
        let width = self.lens.size().0;
        let rows = (tile.y..tile.bottom).flat_map(|y| (tile.x..tile.right).map(move |x| y * width + x));
        rows.filter(|at| self.shows_scene(*at)).count()
    }
}

/// Views as training uses them, in their order; what visible watermarks cover is looked for where the settings leave it out.
pub(crate) fn prepare(views: Vec<impl ToLearn>, config: &FieldConfig) -> Result<Vec<Arc<Prepared>>, FieldError> {
    if views.is_empty() {
        return Err(FieldError::Views("none to train on; hold fewer out or import more photographs".into()));
    }
    // Pictures go as they are converted: they are four times as large.
    let kept: Vec<Result<KeptView, FieldError>> = views.into_par_iter().map(ToLearn::kept).collect();
    let views: Vec<KeptView> = kept.into_iter().collect::<Result<_, _>>()?;
    let lenses = Lens::shared(views.iter().map(|v| v.camera));
    let mut over: Vec<Option<Arc<VisibleWatermark>>> = vec![None; views.len()];
    if config.leave_out_watermarks {
        let size = |camera: &Camera| (camera.intrinsics.width, camera.intrinsics.height);
        let seen: Vec<(&str, Seen<'_>)> = views
            .iter()
            .map(|view| (view.contributor.as_str(), Seen { size: size(&view.camera), pixels: &view.pixels }))
            .collect();
        for mark in find(&seen) {
            let mark = Arc::new(mark);
            mark.views.iter().for_each(|view| over[*view] = Some(mark.clone()));
        }
    }
    let parts = views.into_iter().zip(lenses).zip(over);
    let prepared = parts.map(|((KeptView { name, camera, pixels, .. }, lens), watermark)| {
        Arc::new(Prepared { name, camera, lens, pixels, watermark })
    });
    Ok(prepared.collect())
}

/// Whether a view's picture can be learnt from.
fn check(view: &TrainingView) -> Result<(), FieldError> {
    let (w, h) = (view.camera.intrinsics.width, view.camera.intrinsics.height);
    if (w, h) != (view.picture.width(), view.picture.height()) {
        return Err(FieldError::Views(format!(
            "`{}`: the camera is {w} x {h} px and the photograph {} x {}; resize one to the other",
            view.name,
            view.picture.width(),
            view.picture.height()
        )));
    }
    if let Some(at) = view.picture.rgb().iter().position(|v| !v.is_finite()) {
        return Err(FieldError::Views(format!(
            "`{}`: pixel ({}, {}) is not finite; import the photograph again",
            view.name,
            at / 3 % w,
            at / 3 / w
        )));
    }
    Ok(())
}

/// Mean colour of what shows the scene, RGB in [0, 1].
pub(crate) fn mean_colour(views: &[Arc<Prepared>]) -> [f32; 3] {
    let mut sum = [0u64; 3];
    let mut count = 0u64;
    for view in views {
        for (_, pixel) in view.pixels.chunks_exact(3).enumerate().filter(|(at, _)| view.shows_scene(*at)) {
            for c in 0..3 {
                sum[c] += u64::from(pixel[c]);
            }
            count += 1;
        }
    }
    sum.map(|s| (s as f64 / count.max(1) as f64 / 255.0) as f32)
}
