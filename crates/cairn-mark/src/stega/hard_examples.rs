//! Which views a step trains on: those whose mark is read with ease, and not found where it
//! is not, come up less often, so that steps go where something is left to learn.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Share of what was known of a view that stays when it is looked at again.
const MEMORY: f32 = 0.7;
/// What is not known yet, nats: a guess between two classes.
const UNSEEN: f32 = std::f32::consts::LN_2;

/// How each view of a scene was told lately.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Draws {
    /// Running cross-entropy of each view's render with the mark and without, nats.
    losses: Vec<f32>,
    /// Below this a view is settled, nats.
    settled: f32,
    /// How often a settled view comes up, as a share of how often another does; above 0, to 1.
    share: f64,
}

impl Draws {
    pub(crate) fn new(views: usize, settled: f32, share: f64) -> Self {
        Self { losses: vec![UNSEEN; views], settled, share }
    }

    /// One of the views `of`, which are not none.
    pub(crate) fn draw(&self, of: &[usize], rng: &mut ChaCha8Rng) -> usize {
        let weight = |view: &usize| if self.losses[*view] < self.settled { self.share } else { 1.0 };
        let mut left = rng.random_range(0.0..of.iter().map(weight).sum());
        let chosen = of.iter().find(|view| {
            left -= weight(view);
            left < 0.0
        });
        // Rounding may leave a little beyond the last.
        *chosen.unwrap_or(&of[of.len() - 1])
    }

    /// Takes in the cross-entropy of `view` in a step; a view outside all clusters is not drawn here.
    pub(crate) fn hear(&mut self, view: usize, loss: f32) {
        if let Some(of) = self.losses.get_mut(view) {
            *of = MEMORY * *of + (1.0 - MEMORY) * loss;
        }
    }

    /// How the views `of` were told lately, nats, their mean; 0 of none.
    pub(crate) fn told(&self, of: &[usize]) -> f32 {
        of.iter().map(|view| self.losses[*view]).sum::<f32>() / of.len().max(1) as f32
    }

    /// Another view stands in the place of `view`.
    pub(crate) fn forget(&mut self, view: usize) {
        self.losses[view] = UNSEEN;
    }

    /// All running cross-entropies, for a checkpoint.
    pub(crate) fn losses(&self) -> &[f32] {
        &self.losses
    }

    /// Takes over a checkpoint's; as many as there are views.
    pub(crate) fn restore(&mut self, losses: Vec<f32>) {
        self.losses = losses;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn settled_views_come_up_by_their_share_and_come_back_when_they_are_missed() {
        let mut draws = Draws::new(4, 0.06, 0.25);
        let counted = |draws: &Draws| {
            let (mut rng, mut counts) = (ChaCha8Rng::seed_from_u64(1), [0u32; 4]);
            (0..6000).for_each(|_| counts[draws.draw(&[0, 2, 3], &mut rng)] += 1);
            counts
        };
        let near = |counts: [u32; 4], expected: [f64; 4]| {
            let off = |(n, share): (&u32, &f64)| (f64::from(*n) / 6000.0 - share).abs();
            assert!(counts.iter().zip(&expected).map(off).fold(0.0, f64::max) < 0.02, "{counts:?} for {expected:?}");
        };
        near(counted(&draws), [1.0 / 3.0, 0.0, 1.0 / 3.0, 1.0 / 3.0]);
        (0..20).for_each(|_| draws.hear(2, 0.001));
        let told = draws.told(&[2, 3]);
        assert!((told - 0.5 * (UNSEEN + 0.0015)).abs() < 1e-3, "{told}");
        assert_eq!(draws.told(&[]), 0.0);
        near(counted(&draws), [4.0 / 9.0, 0.0, 1.0 / 9.0, 4.0 / 9.0]);
        draws.hear(2, 2.0);
        near(counted(&draws), [1.0 / 3.0, 0.0, 1.0 / 3.0, 1.0 / 3.0]);
        // Where all are settled, all alike; a view of nobody's is not heard of.
        (0..20).for_each(|_| (0..5).for_each(|view| draws.hear(view, 0.0)));
        near(counted(&draws), [1.0 / 3.0, 0.0, 1.0 / 3.0, 1.0 / 3.0]);
    }
}
