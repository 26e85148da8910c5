//! Photographs as training uses them: each with its lens, and of those its mask leaves out nothing.

use super::sampling::Tile;
use crate::error::FieldError;
use crate::rays::lens::{Eye, Lens};
use cairn_scene::{Camera, Picture, Picture8, TrainView};
use std::sync::Arc;

/// One photograph to learn from. Screening and training share it: it is decoded once.
#[derive(Clone, Debug)]
pub struct NamedView {
    /// The view's name, unique in the scene.
    pub name: String,
    /// Its camera, photograph and mask.
    pub view: Arc<TrainView>,
}

impl NamedView {
    /// A `picture` that `camera` took, all of whose pixels teach.
    pub fn new(name: impl Into<String>, camera: Camera, picture: &Picture) -> Self {
        let view = Arc::new(TrainView { camera, rgb8: Picture8::from(picture), mask: None });
        Self { name: name.into(), view }
    }
}

/// A view with its lens.
#[derive(Debug)]
pub(crate) struct Prepared {
    pub(crate) name: String,
    pub(crate) view: Arc<TrainView>,
    pub(crate) lens: Arc<Lens>,
    /// Whether the view is absent: it keeps its place in the order of pixels, and teaches nothing.
    pub(crate) absent: bool,
}

impl Prepared {
    /// 8-bit RGB, row-major.
    #[inline(always)]
    pub(crate) fn pixels(&self) -> &[u8] {
        self.view.rgb8.rgb()
    }

    /// The same view, absent.
    pub(crate) fn left_out(&self) -> Self {
        Self { name: self.name.clone(), view: self.view.clone(), lens: self.lens.clone(), absent: true }
    }

    /// The colour of pixel `at`, in [0, 1].
    pub(crate) fn colour(&self, at: usize) -> [f32; 3] {
        let pixels = self.pixels();
        std::array::from_fn(|c| f32::from(pixels[at * 3 + c]) / 255.0)
    }

    pub(crate) fn eye(&self) -> Eye<'_> {
        Eye { camera: &self.view.camera, lens: &self.lens }
    }

    /// Whether pixel `at` is one to learn from.
    #[inline(always)]
    pub(crate) fn uses(&self, at: usize) -> bool {
        let width = self.lens.size().0;
        !self.absent && self.view.mask.as_ref().is_none_or(|mask| mask.uses(at % width, at / width))
    }

    /// Pixels of a tile to learn from, or that would be if the view were not absent.
    pub(crate) fn used_in(&self, tile: &Tile) -> usize {
        let Some(mask) = &self.view.mask else { return tile.len() };
        let pixels = (tile.y..tile.bottom).flat_map(|y| (tile.x..tile.right).map(move |x| (x, y)));
        pixels.filter(|(x, y)| mask.uses(*x, *y)).count()
    }
}

/// Views as training uses them, in their order.
///
/// # Errors
/// [`FieldError::Views`] without views, for a photograph or a mask of another size than its camera's, and where masks
/// leave no pixel.
pub(crate) fn prepare(views: Vec<NamedView>) -> Result<Vec<Arc<Prepared>>, FieldError> {
    if views.is_empty() {
        return Err(FieldError::Views("none to train on; hold fewer out or import more photographs".into()));
    }
    views.iter().try_for_each(check)?;
    let used = |v: &NamedView| v.view.mask.as_ref().is_none_or(|mask| mask.used_pixels() > 0);
    if !views.iter().any(used) {
        return Err(FieldError::Views(
            "their masks leave no pixel to learn from; in a mask white means use: turn the masks around or import \
             without them"
                .into(),
        ));
    }
    let lenses = Lens::shared(views.iter().map(|v| v.view.camera));
    let prepared = |(NamedView { name, view }, lens)| Arc::new(Prepared { name, view, lens, absent: false });
    Ok(views.into_iter().zip(lenses).map(prepared).collect())
}

/// Whether a view's sizes agree.
fn check(NamedView { name, view }: &NamedView) -> Result<(), FieldError> {
    let (w, h) = (view.camera.intrinsics.width, view.camera.intrinsics.height);
    let differs = |what: &str, width: usize, height: usize| {
        let why =
            format!("`{name}`: the camera is {w} x {h} px and the {what} {width} x {height}; resize one to the other");
        if (w, h) == (width, height) { Ok(()) } else { Err(FieldError::Views(why)) }
    };
    differs("photograph", view.rgb8.width(), view.rgb8.height())?;
    view.mask.as_ref().map_or(Ok(()), |mask| differs("mask", mask.width(), mask.height()))
}

/// Mean colour of the pixels to learn from, RGB in [0, 1].
pub(crate) fn mean_colour(views: &[Arc<Prepared>]) -> [f32; 3] {
    let mut sum = [0u64; 3];
    let mut count = 0u64;
    for view in views {
        for (_, pixel) in view.pixels().chunks_exact(3).enumerate().filter(|(at, _)| view.uses(*at)) {
            for c in 0..3 {
                sum[c] += u64::from(pixel[c]);
            }
            count += 1;
        }
    }
    sum.map(|s| (s as f64 / count.max(1) as f64 / 255.0) as f32)
}
