//! What a photograph taught a field: the rendering weights of its pixels, each as much as it counted in training.

use cairn_field::{Field, Pixel, RowWeights, VisibleField};
use cairn_scene::TrainView;

/// Pixels of a photograph that are looked at, at most about so many: larger ones are made smaller first, by a whole
/// number each way.
pub const SAMPLED_PIXELS: usize = 60_000;

/// What the photograph `name` taught each row of `field`, in its own pixels. Pixels that its mask leaves out taught
/// nothing. Where training was robust (`huber` > 0) a pixel that the field does not explain taught as much less as its
/// residual was cut down: `min(1, huber / |r|)`, the mean over channels (Huber 1964).
pub fn taught(field: &Field, name: &str, view: &TrainView, huber: f64) -> RowWeights {
    let (w, h) = (view.camera.intrinsics.width, view.camera.intrinsics.height);
    let every = ((w * h) as f64 / SAMPLED_PIXELS as f64).sqrt().ceil().max(1.0) as usize;
    let small = (every > 1).then(|| view.resized((w / every).max(1), (h / every).max(1)));
    let whole = view;
    let view = small.as_ref().unwrap_or(whole);
    let (width, height) = (view.camera.intrinsics.width, view.camera.intrinsics.height);
    // Each stands for as many as were made into it.
    let stands_for = (w * h) as f32 / (width * height) as f32;
    let (light, pixels, huber) = (field.appearance_of(name), view.rgb8.rgb(), huber as f32);
    let robust = |pixel: &Pixel| {
        let shown = pixel.colour(light);
        let share = |c: usize| {
            let residual = (shown[c] - f32::from(pixels[3 * pixel.at + c]) / 255.0).abs();
            if residual > huber { huber / residual } else { 1.0 }
        };
        (share(0) + share(1) + share(2)) / 3.0
    };
    let used: Option<Vec<f32>> = whole.mask.as_ref().map(|_| used_shares(whole, width, height));
    field.row_weights(&view.camera, &|pixel| {
        let used = used.as_ref().map_or(1.0, |used| used[pixel.at]);
        used * stands_for * if huber > 0.0 { robust(pixel) } else { 1.0 }
    })
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
