//! The part of a render that the networks are shown, as a linear map with a
//! transpose. People crop pictures and photograph from nearer by: training shows
//! whole renders and parts of them alike.

use crate::attack::Cut;
use cairn_scene::AreaFilter;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// The least share of a side that a part keeps.
pub(crate) const LEAST: f64 = 0.6;

/// A rectangle of a render, resized to the networks' square.
pub(crate) struct Window {
    cut: Cut,
    filter: AreaFilter,
}

impl Window {
    fn of(cut: Cut, side: usize) -> Self {
        Self { filter: AreaFilter::new(cut.size, [side, side]), cut }
    }

    /// All of a `width x height` render.
    pub(crate) fn whole(width: usize, height: usize, side: usize) -> Self {
        let whole = [width, height];
        Self::of(Cut { whole, from: [0, 0], size: whole }, side)
    }

    /// As often all of it as a part, its sides drawn apart from one another.
    pub(crate) fn draw(width: usize, height: usize, side: usize, rng: &mut ChaCha8Rng) -> Self {
        if rng.random_range(0..2) == 0 {
            return Self::whole(width, height, side);
        }
        let mut part = |whole: usize| {
            let kept = ((whole as f64 * rng.random_range(LEAST..1.0)).round() as usize).clamp(1, whole);
            (rng.random_range(0..=whole - kept), kept)
        };
        let ((left, across), (top, down)) = (part(width), part(height));
        Self::of(Cut { whole: [width, height], from: [left, top], size: [across, down] }, side)
    }

    fn is_whole(&self) -> bool {
        self.cut.size == self.cut.whole
    }

    /// The window of `picture` (`height x width x 3`), `side x side x 3`.
    pub(crate) fn apply(&self, picture: &[f32]) -> Vec<f32> {
        if self.is_whole() { self.filter.apply(picture) } else { self.filter.apply(&self.cut.apply(picture)) }
    }

    /// The transpose: from d(loss)/d(window) to d(loss)/d(picture).
    pub(crate) fn transpose(&self, slope: &[f32]) -> Vec<f32> {
        let part = self.filter.transpose(slope);
        if self.is_whole() { part } else { self.cut.transpose(&part) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn the_transpose_is_one() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let numbers = |n: usize, rng: &mut ChaCha8Rng| -> Vec<f32> {
            (0..n * 3).map(|_| rng.random_range(-1.0f32..1.0)).collect()
        };
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(a * b)).sum::<f64>();
        let mut parts = 0;
        for _ in 0..20 {
            let window = Window::draw(23, 17, 8, &mut rng);
            parts += usize::from(!window.is_whole());
            let (x, y) = (numbers(23 * 17, &mut rng), numbers(64, &mut rng));
            let (there, back) = (dot(&window.apply(&x), &y), dot(&x, &window.transpose(&y)));
            assert!((there - back).abs() < 1e-4, "{there} and {back}");
        }
        assert!((3..=17).contains(&parts), "{parts} of 20 windows are parts");
    }

    #[test]
    fn a_part_is_cut_where_it_says() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let window =
            std::iter::repeat_with(|| Window::draw(30, 20, 10, &mut rng)).find(|w| w.cut.from.iter().all(|at| *at > 0));
        let window = window.expect("some window starts inside");
        let ramp: Vec<f32> = (0..600).flat_map(|i| [(i % 30) as f32, (i / 30) as f32, 1.0]).collect();
        let seen = window.apply(&ramp);
        let centre = |from: usize, count: usize| from as f32 + (count as f32 - 1.0) / 2.0;
        let mean = |c: usize| seen.chunks_exact(3).map(|p| p[c]).sum::<f32>() / 100.0;
        assert!((mean(0) - centre(window.cut.from[0], window.cut.size[0])).abs() < 1e-3, "across");
        assert!((mean(1) - centre(window.cut.from[1], window.cut.size[1])).abs() < 1e-3, "down");
        assert!((mean(2) - 1.0).abs() < 1e-5, "shares sum to one");
    }
}
