//! Enlarging, bilinear, with its transpose: pictures of training stand for larger ones.

/// The two old samples that a new one lies between, and the second's share.
type Between = (usize, usize, f32);

/// From one size to a larger; see the module's text.
pub(super) struct Stretch {
    from: [usize; 2],
    columns: Vec<Between>,
    rows: Vec<Between>,
}

impl Stretch {
    /// From `[width, height]` to `[width, height]`.
    pub(super) fn new(from: [usize; 2], to: [usize; 2]) -> Self {
        Self { from, columns: between(from[0], to[0]), rows: between(from[1], to[1]) }
    }

    /// The enlarged picture, interleaved.
    pub(super) fn apply(&self, rgb: &[f32]) -> Vec<f32> {
        let w = self.from[0];
        let mut out = Vec::with_capacity(self.rows.len() * self.columns.len() * 3);
        for &(top, bottom, down) in &self.rows {
            let (top, bottom) = (&rgb[top * w * 3..][..w * 3], &rgb[bottom * w * 3..][..w * 3]);
            for &(left, right, across) in &self.columns {
                for c in 0..3 {
                    let above = top[left * 3 + c] + across * (top[right * 3 + c] - top[left * 3 + c]);
                    let below = bottom[left * 3 + c] + across * (bottom[right * 3 + c] - bottom[left * 3 + c]);
                    out.push(above + down * (below - above));
                }
            }
        }
        out
    }

    /// The transpose of [`Stretch::apply`].
    pub(super) fn transpose(&self, slope: &[f32]) -> Vec<f32> {
        let (w, width) = (self.from[0], self.columns.len());
        let mut out = vec![0.0; w * self.from[1] * 3];
        for (&(top, bottom, down), slope) in self.rows.iter().zip(slope.chunks_exact(width * 3)) {
            for (&(left, right, across), slope) in self.columns.iter().zip(slope.chunks_exact(3)) {
                for (y, wy) in [(top, 1.0 - down), (bottom, down)] {
                    for (x, wx) in [(left, 1.0 - across), (right, across)] {
                        for (c, s) in slope.iter().enumerate() {
                            out[(y * w + x) * 3 + c] += wy * wx * s;
                        }
                    }
                }
            }
        }
        out
    }
}

fn between(from: usize, to: usize) -> Vec<Between> {
    let place = |i: usize| ((i as f32 + 0.5) * from as f32 / to as f32 - 0.5).clamp(0.0, (from - 1) as f32);
    (0..to).map(|i| (place(i) as usize, (place(i) as usize + 1).min(from - 1), place(i).fract())).collect()
}
