//! What is looked at of a photograph: its brightness and edges, made smaller where it is large.

use super::Seen;
use rayon::prelude::*;

/// Longest side that is looked at, pixels; larger photographs are made smaller by a whole number, in which thin strokes may vanish.
const LONGEST_PX: usize = 768;
/// Weakest edge, 8-bit steps a pixel, by central differences: a twelfth of white on grey, sharply drawn.
pub(super) const EDGE: f32 = 5.0;
/// How slopes that agree differ, as shares of the middle one: from, to, and at right angles to it. A watermark that lets the
/// scene through changes less where that is bright.
pub(super) const LOOSE: [f32; 3] = [0.4, 2.5, 0.6];
/// The same where photographs are too few to tell a watermark from chance by loose agreement: only those on a ground of their own are found there.
pub(super) const TIGHT: [f32; 3] = [0.85, 1.18, 0.15];
/// Photographs whose edges agree in this share are of one pose.
const ONE_POSE: f64 = 0.5;
/// Edge pixels beside a watermark by which photographs are compared: so many at least,
const LEAST_SHOWN: usize = 32;
/// and about so many at most.
const MOST_COMPARED: usize = 8192;

/// Brightness of a photograph, made smaller.
pub(super) struct Frame {
    pub(super) width: usize,
    pub(super) height: usize,
    /// 0 to 255.
    pub(super) brightness: Vec<f32>,
    /// Changes across and down, a pixel; 0 on the rim.
    pub(super) slopes: Vec<[f32; 2]>,
}

impl Frame {
    pub(super) fn of(seen: &Seen<'_>) -> Self {
        let (w, h) = seen.size;
        let by = by((w, h));
        let (width, height) = (w / by, h / by);
        let mean = |at: usize| {
            let (x, y) = (at % width * by, at / width * by);
            let mut sum = 0u32;
            for row in y..y + by {
                let from = (row * w + x) * 3;
                // Rec. 601 in sixteenths.
                sum += seen.pixels[from..from + 3 * by].chunks_exact(3).map(luma).sum::<u32>();
            }
            sum as f32 / (16 * by * by) as f32
        };
        let brightness: Vec<f32> = (0..width * height).map(mean).collect();
        let slope = |at: usize| {
            let (x, y) = (at % width, at / width);
            if x == 0 || y == 0 || x + 1 == width || y + 1 == height {
                return [0.0; 2];
            }
            let b = &brightness;
            [(b[at + 1] - b[at - 1]) / 2.0, (b[at + width] - b[at - width]) / 2.0]
        };
        let slopes = (0..width * height).map(slope).collect();
        Self { width, height, brightness, slopes }
    }

    /// Some of the places where this frame has edges and nothing is `covered`, evenly; none where they are too few to tell anything.
    fn edges(&self, covered: &[bool]) -> Vec<usize> {
        let edge = |at: &usize| !covered[*at] && squared(self.slopes[*at]) >= EDGE * EDGE;
        let all: Vec<usize> = (0..covered.len()).filter(edge).collect();
        let some = if all.len() < LEAST_SHOWN { 0 } else { all.len() };
        all[..some].iter().copied().step_by(some.div_ceil(MOST_COMPARED).max(1)).collect()
    }

    /// Share of `edges`, which are this frame's, that `other` has as well.
    fn alike(&self, edges: &[usize], other: &Self) -> f64 {
        let both = edges.iter().filter(|at| follows(other.slopes[**at], self.slopes[**at], LOOSE)).count();
        both as f64 / edges.len() as f64
    }
}

/// How many pixels of a photograph of `size`, across and down, become one.
pub(super) fn by((width, height): (usize, usize)) -> usize {
    width.max(height).div_ceil(LONGEST_PX).max(1)
}

/// One frame of each pose, in their order, by what is not `covered`. Those that show nothing there cannot tell.
pub(super) fn of_several_poses<'a>(frames: &'a [Frame], covered: &[bool]) -> Vec<&'a Frame> {
    let edges: Vec<Vec<usize>> = frames.par_iter().map(|frame| frame.edges(covered)).collect();
    let mut kept: Vec<usize> = Vec::new();
    for at in (0..frames.len()).filter(|at| !edges[*at].is_empty()) {
        let alike = |a: usize, b: usize| frames[a].alike(&edges[a], &frames[b]);
        if !kept.par_iter().any(|other| alike(*other, at).max(alike(at, *other)) >= ONE_POSE) {
            kept.push(at);
        }
    }
    kept.into_iter().map(|at| &frames[at]).collect()
}

/// Sixteen times the brightness of a pixel.
fn luma(rgb: &[u8]) -> u32 {
    5 * u32::from(rgb[0]) + 9 * u32::from(rgb[1]) + 2 * u32::from(rgb[2])
}

pub(super) fn squared(a: [f32; 2]) -> f32 {
    a[0] * a[0] + a[1] * a[1]
}

/// Whether slope `a` is about `m`, by [`LOOSE`] or [`TIGHT`] limits.
pub(super) fn follows(a: [f32; 2], m: [f32; 2], [from, to, across]: [f32; 3]) -> bool {
    let along = (a[0] * m[0] + a[1] * m[1]) / squared(m);
    (from..to).contains(&along) && (a[0] * m[1] - a[1] * m[0]).abs() <= across * squared(m)
}
