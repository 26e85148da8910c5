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
    let view = small.as_ref().unwrap_or(view);
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
    field.row_weights(&view.camera, &|pixel| {
        if !view.uses(pixel.at % width, pixel.at / width) {
            return 0.0;
        }
        stands_for * if huber > 0.0 { robust(pixel) } else { 1.0 }
    })
}
