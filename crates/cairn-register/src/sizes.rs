//! Pictures and cameras made smaller, in proportion to a pixel.

use cairn_scene::{Camera, Picture};
use glam::DVec2;

/// Both sides where the longer is to be `longest` px at most.
fn within([width, height]: [usize; 2], longest: usize) -> [usize; 2] {
    let long = width.max(height);
    if long <= longest {
        return [width, height];
    }
    [width, height].map(|side| ((side * longest + long / 2) / long).max(1))
}

/// `camera`, at most `longest` px long.
pub(crate) fn shrunk(camera: &Camera, longest: usize) -> Camera {
    let [w, h] = within([camera.intrinsics.width, camera.intrinsics.height], longest);
    camera.resized(w, h)
}

/// `picture`, at most `longest` px long.
pub(crate) fn smaller(picture: &Picture, longest: usize) -> Picture {
    let size = [picture.width(), picture.height()];
    let [w, h] = within(size, longest);
    if [w, h] == size { picture.clone() } else { picture.resized(w, h) }
}

/// How many times larger `large` is than `small`, across and down: sides are rounded one by one, so that these differ.
pub(crate) fn ratio(large: [usize; 2], small: [usize; 2]) -> DVec2 {
    DVec2::new(large[0] as f64 / small[0] as f64, large[1] as f64 / small[1] as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_are_rounded_and_what_is_small_stays() {
        assert_eq!(within([400, 600], 400), [267, 400]);
        assert_eq!(within([20, 5000], 800), [3, 800]);
        assert_eq!(within([30, 20], 400), [30, 20]);
        assert_eq!(ratio([400, 600], [267, 400]), DVec2::new(400.0 / 267.0, 1.5));
    }
}
