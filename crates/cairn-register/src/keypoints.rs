//! Keypoints of a picture: SIFT (Lowe 2004) with the square root of its descriptors ("RootSIFT", Arandjelovic and
//! Zisserman 2012), rounded to bytes.

use cairn_scene::Picture;
use glam::DVec2;
use lowe_sift::{Feature, GrayImage, Sift, SiftConfig};

/// Numbers of a descriptor.
pub(crate) const DESCRIPTOR: usize = 128;
/// A descriptor's length: its numbers' squares add up to the square of that, to rounding. The square root of a share
/// of the whole is seldom more than a half, so that bytes hold it.
const LENGTH: f32 = 512.0;
/// Pictures are brought to this standard deviation of lightness, so that a dark one has keypoints as well,
const SPREAD: f32 = 0.2;
/// by this factor at most: what is flat shows noise alone.
const MAX_GAIN: f32 = 4.0;
/// The faintest response that counts, of lightness in [0, 1]. Lowe's 0.03 is for photographs of millions of pixels. Of
/// small renders (liberty, 200 x 300) half as many keypoints again agree at 0.006 as at 0.013, and at 0.003 hardly more.
const MIN_RESPONSE: f32 = 0.006;

/// A place in a picture that is known again in another.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Keypoint {
    /// Pixels from the top left corner.
    pub(crate) at: DVec2,
    /// Standard deviation of the blur at which it stands out, px.
    pub(crate) scale: f32,
    /// Which way it points, radians in [0, 2 pi).
    pub(crate) angle: f32,
    /// What is around it.
    pub(crate) descriptor: [u8; DESCRIPTOR],
}

/// The `count` keypoints of `picture` that stand out most, the strongest first.
pub(crate) fn keypoints(picture: &Picture, count: usize) -> Vec<Keypoint> {
    let Some(gray) = lightness(picture) else { return Vec::new() };
    let config = SiftConfig { contrast_threshold: MIN_RESPONSE, ..SiftConfig::default() };
    let sift = Sift::new(config).expect("Lowe's settings but for the response");
    let mut features = sift.detect_and_compute(&gray);
    features.sort_by(|a, b| b.keypoint.response.total_cmp(&a.keypoint.response));
    features.truncate(count);
    features.iter().map(Keypoint::of).collect()
}

/// Rec. 601's luma, about its mean, spread to [`SPREAD`]. `None` of a picture without pixels.
fn lightness(picture: &Picture) -> Option<GrayImage> {
    let mut luma: Vec<f32> =
        picture.rgb().chunks_exact(3).map(|c| 0.299 * c[0] + 0.587 * c[1] + 0.114 * c[2]).collect();
    let n = luma.len() as f32;
    let mean = luma.iter().sum::<f32>() / n;
    let spread = (luma.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / n).sqrt();
    let gain = (SPREAD / spread.max(1e-6)).min(MAX_GAIN);
    luma.iter_mut().for_each(|v| *v = 0.5 + gain * (*v - mean));
    GrayImage::new(picture.width(), picture.height(), luma).ok()
}

impl Keypoint {
    fn of(feature: &Feature) -> Self {
        let all = feature.descriptor.as_slice();
        let sum = all.iter().sum::<f32>().max(1e-12);
        let descriptor = all.map(|v| (LENGTH * (v.max(0.0) / sum).sqrt()).round().min(255.0) as u8);
        let k = &feature.keypoint;
        // The library counts from the first pixel's middle.
        let at = DVec2::new(f64::from(k.x) + 0.5, f64::from(k.y) + 0.5);
        Self { at, scale: k.scale, angle: k.angle, descriptor }
    }
}

/// How alike two descriptors are: their scalar product, the square of their length where they are the same.
#[inline]
pub(crate) fn likeness(a: &[i16; DESCRIPTOR], b: &[i16; DESCRIPTOR]) -> i32 {
    a.iter().zip(b).map(|(a, b)| i32::from(*a) * i32::from(*b)).sum()
}

/// Distance of descriptors that are so alike, by that of others. The rounding of bytes is all that separates descriptors
/// that are the same: two such are as far as one another.
pub(crate) fn distance_ratio(like: i32, next: i32) -> f64 {
    let square = |likeness: i32| (2.0 * (f64::from(LENGTH).powi(2) - f64::from(likeness))).max(1.0);
    (square(like) / square(next)).sqrt()
}

/// A descriptor in the numbers that processors multiply eight at a time.
pub(crate) fn widened(descriptor: &[u8; DESCRIPTOR]) -> [i16; DESCRIPTOR] {
    descriptor.map(i16::from)
}
