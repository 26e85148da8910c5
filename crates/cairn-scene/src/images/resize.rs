//! Resizing as a linear map with a transpose: training pushes gradients back
//! through the same filter that pictures went through, so both live here.

/// The share of one old sample in one new one.
type Tap = (usize, f32);

/// Resizes `height x width x 3` pictures by area: each new pixel is the mean of
/// the area it covers.
#[derive(Clone, Debug)]
pub struct AreaFilter {
    from: [usize; 2],
    to: [usize; 2],
    columns: Vec<Vec<Tap>>,
    rows: Vec<Vec<Tap>>,
}

impl AreaFilter {
    /// From `[width, height]` to `[width, height]`, in pixels.
    ///
    /// # Panics
    /// When a side is zero.
    pub fn new(from: [usize; 2], to: [usize; 2]) -> Self {
        assert!(from.iter().chain(&to).all(|side| *side > 0), "cannot resize from or to no pixels");
        Self { from, to, columns: area_taps(from[0], to[0]), rows: area_taps(from[1], to[1]) }
    }

    /// The resized picture, `to` high and wide, from one `from` high and wide.
    ///
    /// # Panics
    /// When `picture` is of another size.
    pub fn apply(&self, picture: &[f32]) -> Vec<f32> {
        let [fw, fh] = self.from;
        let [tw, th] = self.to;
        assert_eq!(picture.len(), fw * fh * 3, "a picture of the filter's size");
        let mut across = vec![0.0f32; fh * tw * 3];
        for (old, new) in picture.chunks_exact(fw * 3).zip(across.chunks_exact_mut(tw * 3)) {
            for (out, taps) in new.chunks_exact_mut(3).zip(&self.columns) {
                for &(at, share) in taps {
                    for (o, v) in out.iter_mut().zip(&old[at * 3..at * 3 + 3]) {
                        *o += share * v;
                    }
                }
            }
        }
        let mut result = vec![0.0f32; th * tw * 3];
        for (new, taps) in result.chunks_exact_mut(tw * 3).zip(&self.rows) {
            for &(at, share) in taps {
                for (o, v) in new.iter_mut().zip(&across[at * tw * 3..(at + 1) * tw * 3]) {
                    *o += share * v;
                }
            }
        }
        result
    }

    /// The transpose: from d(loss)/d(resized) to d(loss)/d(original).
    ///
    /// # Panics
    /// When `slope` is of another size.
    pub fn transpose(&self, slope: &[f32]) -> Vec<f32> {
        let [fw, fh] = self.from;
        let [tw, th] = self.to;
        assert_eq!(slope.len(), tw * th * 3, "a gradient of the resized picture's size");
        let mut across = vec![0.0f32; fh * tw * 3];
        for (new, taps) in slope.chunks_exact(tw * 3).zip(&self.rows) {
            for &(at, share) in taps {
                for (o, v) in across[at * tw * 3..(at + 1) * tw * 3].iter_mut().zip(new) {
                    *o += share * v;
                }
            }
        }
        let mut result = vec![0.0f32; fh * fw * 3];
        for (old, new) in result.chunks_exact_mut(fw * 3).zip(across.chunks_exact(tw * 3)) {
            for (g, taps) in new.chunks_exact(3).zip(&self.columns) {
                for &(at, share) in taps {
                    for (o, v) in old[at * 3..at * 3 + 3].iter_mut().zip(g) {
                        *o += share * v;
                    }
                }
            }
        }
        result
    }
}

/// For each of `to` new samples the old ones (of `from`) it covers and their
/// shares, which sum to one.
fn area_taps(from: usize, to: usize) -> Vec<Vec<Tap>> {
    let scale = from as f64 / to as f64;
    (0..to)
        .map(|i| {
            let (start, end) = (i as f64 * scale, (i + 1) as f64 * scale);
            let (first, last) = (start as usize, (end.ceil() as usize).min(from));
            (first..last)
                .filter_map(|j| {
                    let overlap = end.min((j + 1) as f64) - start.max(j as f64);
                    (overlap > 0.0).then_some((j, (overlap / scale) as f32))
                })
                .collect()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_transpose_is_one() {
        let filter = AreaFilter::new([7, 5], [3, 4]);
        let x: Vec<f32> = (0..7 * 5 * 3).map(|i| (i as f32 * 0.7).sin()).collect();
        let y: Vec<f32> = (0..3 * 4 * 3).map(|i| (i as f32 * 1.3).cos()).collect();
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
        let (left, right) = (dot(&filter.apply(&x), &y), dot(&x, &filter.transpose(&y)));
        assert!((left - right).abs() < 1e-4, "{left} and {right}");
    }
}
