//! What a photograph taught a field: the rendering weights of its pixels, each as much as it counted in training.

use cairn_field::{Field, MarkableField as _, OfPixel, Pixel, RowWeights, VisibleField as _};
use cairn_scene::TrainView;

use crate::necessity::Lesson;

/// Pixels of a photograph that are looked at, at most about so many: larger ones are made smaller first, by a whole
/// number each way.
pub const SAMPLED_PIXELS: usize = 15_000;

/// Entries of a photograph's linear map that weigh less are left out, pixels.
const CUTOFF: f32 = 1e-3;

/// What the photograph `name` taught each row of `field`, in its own pixels. Pixels that its mask leaves out taught
/// nothing. Where training was robust (`huber` > 0) a pixel that the field does not explain taught as much less as its
/// residual was cut down: `min(1, huber / |r|)`, the mean over channels (Huber 1964).
pub fn taught(field: &Field, name: &str, view: &TrainView, huber: f64) -> RowWeights {
    let seen = Smaller::of(view, SAMPLED_PIXELS);
    let (light, pixels) = (field.appearance_of(name), seen.view().rgb8.rgb());
    let robust = |pixel: &Pixel| {
        let shown = pixel.colour(light);
        let residual = |c: usize| shown[c] - f32::from(pixels[3 * pixel.at + c]) / 255.0;
        counted([residual(0), residual(1), residual(2)], huber as f32)
    };
    let counts = |at: usize| seen.counts(at);
    let by_colour = |pixel: &Pixel| match counts(pixel.at) {
        0.0 => 0.0,
        counts => counts * robust(pixel),
    };
    let of_pixel = if huber > 0.0 { OfPixel::ByColour(&by_colour) } else { OfPixel::ByPlace(&counts) };
    field.row_weights(&seen.view().camera, of_pixel)
}

/// How much a pixel of so large residuals counted in training: `min(1, huber / |r|)`, the mean over channels (Huber 1964).
fn counted(residuals: [f32; 3], huber: f32) -> f32 {
    let share = |r: f32| if r.abs() > huber { huber / r.abs() } else { 1.0 };
    residuals.map(share).iter().sum::<f32>() / 3.0
}

/// A photograph, made smaller by a whole number each way where it is large.
struct Smaller<'a> {
    whole: &'a TrainView,
    small: Option<TrainView>,
    /// The share of each pixel that is to be used; `None` where all are.
    used: Option<Vec<f32>>,
    /// As many of the photograph's own pixels were made into one.
    stands_for: f32,
}

impl<'a> Smaller<'a> {
    /// Of about so many pixels at most.
    fn of(whole: &'a TrainView, max_pixels: usize) -> Self {
        let (w, h) = (whole.camera.intrinsics.width, whole.camera.intrinsics.height);
        let every = ((w * h) as f64 / max_pixels as f64).sqrt().ceil().max(1.0) as usize;
        let (width, height) = ((w / every).max(1), (h / every).max(1));
        let small = (every > 1).then(|| whole.resized(width, height));
        let used = whole.mask.as_ref().map(|_| used_shares(whole, width, height));
        Self { whole, small, used, stands_for: (w * h) as f32 / (width * height) as f32 }
    }

    fn view(&self) -> &TrainView {
        self.small.as_ref().unwrap_or(self.whole)
    }

    /// What a pixel counts, in pixels of the photograph.
    fn counts(&self, at: usize) -> f32 {
        self.used.as_ref().map_or(1.0, |used| used[at]) * self.stands_for
    }
}

impl Lesson {
    /// Of the photograph `name` at about so many pixels at most, which count as they did in training (see [`taught`]).
    pub fn of(field: &Field, name: &str, view: &TrainView, huber: f64, max_pixels: usize) -> Self {
        let seen = Smaller::of(view, max_pixels);
        let map = field.view(&seen.view().camera, CUTOFF, 1);
        let light = field.appearance_of(name).clone();
        let pixels = seen.view().rgb8.rgb().iter().map(|v| f32::from(*v) / 255.0);
        let residual: Vec<f32> = pixels.zip(map.base(&light)).map(|(y, shown)| y - shown).collect();
        let counts = |(at, r): (usize, &[f32])| match huber > 0.0 {
            true => seen.counts(at) * counted([r[0], r[1], r[2]], huber as f32),
            false => seen.counts(at),
        };
        let weights = residual.chunks_exact(3).enumerate().map(counts).collect();
        Self { view: map, light, residual, weights }
    }
}

/// The share of the pixels to be used of each pixel of `view` made as small as `width x height`, row-major.
fn used_shares(view: &TrainView, width: usize, height: usize) -> Vec<f32> {
    let (w, h) = (view.camera.intrinsics.width, view.camera.intrinsics.height);
    let mut counts = vec![[0u32; 2]; width * height];
    for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
        let [used, all] = &mut counts[y * height / h * width + x * width / w];
        *used += u32::from(view.uses(x, y));
        *all += 1;
    }
    counts.into_iter().map(|[used, all]| used as f32 / all.max(1) as f32).collect()
}
