//! What the eye lets pass. Detail hides detail: a threshold of contrast rises with the contrast about it to the power of
//! some 0.6 (contrast masking, Legge and Foley 1980), and does not fall below that of a plain surface.

use crate::attack::Blur;
use cairn_scene::Picture;

/// Contrast of a plain surface, standard deviation of luma in [0, 1].
const PLAIN: f32 = 2.0 / 255.0;
/// How thresholds rise with contrast.
const EXPONENT: f32 = 0.6;
/// How far around a pixel contrast is looked at, standard deviation, px: of pictures that were made small.
const AROUND_PX: f32 = 1.0;

/// How strong a change of each pixel of `picture` may be, as a multiple of what a plain surface bears; 1 at least.
pub fn allowed(picture: &Picture) -> Vec<f32> {
    let size = [picture.width(), picture.height()];
    // Blurs take three numbers a pixel: luma and its square, and nothing.
    let of = |rgb: &[f32]| {
        let luma = 0.299 * rgb[0] + 0.587 * rgb[1] + 0.114 * rgb[2];
        [luma, luma * luma, 0.0]
    };
    let both: Vec<f32> = picture.rgb().chunks_exact(3).flat_map(of).collect();
    let mean = Blur::new(AROUND_PX).apply(&both, size);
    let contrast = |m: &[f32]| (m[1] - m[0] * m[0]).max(0.0).sqrt();
    mean.chunks_exact(3).map(|m| (contrast(m) / PLAIN).max(1.0).powf(EXPONENT)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_plain_bears_least() {
        let at = |i: usize| {
            let (x, y) = (i % 60, i / 60);
            if x < 30 { 0.3 } else { 0.3 + 0.2 * ((x + y) % 2) as f32 }
        };
        let picture = Picture::new(60, 20, (0..1200).flat_map(|i| [at(i); 3]).collect()).unwrap();
        let allowed = allowed(&picture);
        let of = |x: usize| allowed[10 * 60 + x];
        assert!((of(5) - 1.0).abs() < 1e-3, "{}", of(5));
        // A standard deviation of 0.1.
        assert!((of(55) - (0.1f32 / PLAIN).powf(EXPONENT)).abs() < 0.05, "{}", of(55));
    }
}
