//! Necessity: what would change without some photographs.
//!
//! With density given, the constant parts of the colours are a least-squares problem: of all photographs' pixels p, each
//! weighed m, minimise `sum_p m[p] |y[p] - L sum_v W[p,v] c[v]|^2 + rho sum_v |c[v] - c0|^2`, L what the photograph's light
//! makes of a change of colour. Leaving photographs out
//! takes their terms away, and colours that nobody else shows go back to `c0`. Both problems are solved by the same few
//! steps of conjugate gradients from where training ended, each row's step divided by what it weighs in all pixels
//! (Hestenes and Stiefel 1952, preconditioned); their difference is what the photographs are needed for. Geometry stays as
//! it is: what it would lose is not in the answer.

use cairn_field::{Appearance, LinearView};
use rayon::prelude::*;

/// How strongly a row without photographs goes back to `c0`, pixels (rho): little beside the pixel that a photograph shows.
/// On lego 0.1 and 0.01 foresee alike.
pub const PULL: f32 = 0.01;
/// Steps of conjugate gradients.
pub const STEPS: usize = 8;

/// A photograph with what a field's linear map makes of it.
pub struct Lesson {
    /// The view's map.
    pub view: LinearView,
    /// The light that the photograph was taken in.
    pub light: Appearance,
    /// The photograph's colours at the map's size, row-major RGB, less what the field shows there in the photograph's own
    /// light: `3 x pixels`.
    pub residual: Vec<f32>,
    /// What each pixel counts, >= 0.
    pub weights: Vec<f32>,
}

/// The problem of all photographs; see the module's text.
pub struct Necessity<'a> {
    lessons: &'a [Lesson],
    rows: usize,
    /// How far each row's constant colour lies from where it would be without photographs, `rows x 3`.
    off: Vec<f32>,
    pull: f32,
    steps: usize,
}

impl<'a> Necessity<'a> {
    /// Of a field with `rows` rows whose constant colours lie `off` (`rows x 3`) from `c0`; `pull` is rho, pixels.
    ///
    /// # Panics
    /// When `off` is of another size, or `pull` is not above 0.
    pub fn new(lessons: &'a [Lesson], rows: usize, off: Vec<f32>, pull: f32, steps: usize) -> Self {
        assert_eq!(off.len(), 3 * rows, "a colour for each row");
        assert!(pull > 0.0, "rows that nobody shows need a pull");
        Self { lessons, rows, off, pull, steps }
    }

    /// How the constant colours would move, `rows x 3`, were only the photographs there that `stays` holds for.
    pub fn solve(&self, stays: impl Fn(usize) -> bool + Sync) -> Vec<f32> {
        let kept: Vec<&Lesson> = self.lessons.iter().enumerate().filter(|(i, _)| stays(*i)).map(|(_, l)| l).collect();
        let mass = self.mass(&kept);
        let mut moved = vec![0.0; 3 * self.rows];
        // What is left to explain: W^T m (y - W c) - rho (c - c0).
        let mut left = self.gather(&kept, |lesson| &lesson.light, |lesson| lesson.residual.clone());
        left.par_iter_mut().zip(&self.off).for_each(|(l, off)| *l -= self.pull * off);
        let scaled = |left: &[f32]| -> Vec<f32> {
            left.par_iter().enumerate().map(|(i, v)| v / (mass[i / 3] + self.pull)).collect()
        };
        let mut towards = scaled(&left);
        let mut along = towards.clone();
        let mut size = dot(&left, &towards);
        for _ in 0..self.steps {
            if size <= 0.0 {
                break;
            }
            let mut pushed = self.gather(
                &kept,
                |lesson| &lesson.light,
                |lesson| {
                    let mut picture = vec![0.0; lesson.residual.len()];
                    lesson.view.apply_lit(&along, &lesson.light, &mut picture);
                    picture
                },
            );
            pushed.par_iter_mut().zip(&along).for_each(|(p, a)| *p += self.pull * a);
            let step = (size / dot(&along, &pushed)) as f32;
            moved.par_iter_mut().zip(&along).for_each(|(m, a)| *m += step * a);
            left.par_iter_mut().zip(&pushed).for_each(|(l, p)| *l -= step * p);
            towards = scaled(&left);
            let next = dot(&left, &towards);
            let keep = (next / size) as f32;
            size = next;
            along.par_iter_mut().zip(&towards).for_each(|(a, t)| *a = t + keep * *a);
        }
        moved
    }

    /// `sum W^T L^T m x` over some photographs, `rows x 3`, x a picture of each and L its `light`.
    fn gather<'l>(
        &self,
        kept: &[&'l Lesson],
        light: impl Fn(&'l Lesson) -> &'l Appearance,
        picture: impl Fn(&Lesson) -> Vec<f32>,
    ) -> Vec<f32> {
        let mut sum = vec![0.0; 3 * self.rows];
        for lesson in kept {
            let mut slope = picture(lesson);
            slope.chunks_exact_mut(3).zip(&lesson.weights).for_each(|(v, m)| v.iter_mut().for_each(|v| *v *= m));
            lesson.view.push_back_lit(&slope, light(lesson), &mut sum);
        }
        sum
    }

    /// What each row weighs in some photographs, pixels, in a light that changes no colour.
    fn mass(&self, kept: &[&Lesson]) -> Vec<f32> {
        let plain = Appearance::neutral([0.0; 3]);
        let all = self.gather(kept, |_| &plain, |lesson| vec![1.0; lesson.residual.len()]);
        all.chunks_exact(3).map(|row| row[0]).collect()
    }
}

/// A sum of products, in the order of the numbers.
fn dot(a: &[f32], b: &[f32]) -> f64 {
    let of = |(a, b): (&[f32], &[f32])| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
    let parts: Vec<f64> = a.par_chunks(1 << 14).zip(b.par_chunks(1 << 14)).map(of).collect();
    parts.iter().sum()
}
