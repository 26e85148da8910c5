//! Rotation about a picture's middle, bilinear, and its transpose.

/// A rotation; see the module's text.
pub(super) struct Turn {
    sin: f32,
    cos: f32,
}

impl Turn {
    /// By `degrees`, counter-clockwise.
    pub(super) fn new(degrees: f32) -> Self {
        let (sin, cos) = degrees.to_radians().sin_cos();
        Self { sin, cos }
    }

    /// Of `height x width x 3` numbers, size = [width, height]; black comes in.
    pub(super) fn apply(&self, rgb: &[f32], size: [usize; 2]) -> Vec<f32> {
        let mut out = vec![0.0; rgb.len()];
        self.each(size, |to, from, weight| {
            for c in 0..3 {
                out[to * 3 + c] += weight * rgb[from * 3 + c];
            }
        });
        out
    }

    /// The transpose of [`Turn::apply`].
    pub(super) fn transpose(&self, slope: &[f32], size: [usize; 2]) -> Vec<f32> {
        let mut out = vec![0.0; slope.len()];
        self.each(size, |to, from, weight| {
            for c in 0..3 {
                out[from * 3 + c] += weight * slope[to * 3 + c];
            }
        });
        out
    }

    /// Tells of every pixel which pixels it is made of, and with which weights.
    fn each(&self, [w, h]: [usize; 2], mut f: impl FnMut(usize, usize, f32)) {
        let middle = [w as f32 / 2.0, h as f32 / 2.0];
        for y in 0..h {
            for x in 0..w {
                let (dx, dy) = (x as f32 + 0.5 - middle[0], y as f32 + 0.5 - middle[1]);
                // Rows go down, so this turns counter-clockwise to the eye.
                let u = middle[0] + self.cos * dx - self.sin * dy - 0.5;
                let v = middle[1] + self.sin * dx + self.cos * dy - 0.5;
                let (left, top) = (u.floor(), v.floor());
                for (i, wx) in [(left, 1.0 - (u - left)), (left + 1.0, u - left)] {
                    for (j, wy) in [(top, 1.0 - (v - top)), (top + 1.0, v - top)] {
                        let there = i >= 0.0 && j >= 0.0 && i < w as f32 && j < h as f32;
                        if there && wx * wy > 0.0 {
                            f(y * w + x, j as usize * w + i as usize, wx * wy);
                        }
                    }
                }
            }
        }
    }
}
