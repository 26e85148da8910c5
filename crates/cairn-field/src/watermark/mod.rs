//! Visible watermarks: a caption, a logo, a date that a camera or a site has put on all photographs of one contributor, at
//! the same place of the frame. No scene explains them, and a field that is to explain them hangs them before that
//! contributor's cameras. Pixels that they cover are not learnt from.
//!
//! What tells them is that they stay where they are while the scene moves (Dekel et al., "On the Effectiveness of
//! Visible Watermarks", CVPR 2017, estimate them from the median of a collection's gradients): a pixel lies on a
//! watermark's edge where at least four of five photographs have about the same gradient, and the fewer there are the more must (`agreement`).
//! A horizon that is level in all of them has as well, or the side of a tower that everybody puts in the middle; but
//! letters and frames have edges that face each other within a few pixels, level and upright ones, and only what is
//! near such pairs counts. From there a watermark goes on as far as the photographs have one brightness (a caption's
//! ground: to the edges around it, or a little way where there are none), and over strokes that two edges enclose.
//! Photographs of one pose say nothing and are counted once.

mod frame;
mod mask;

use cairn_scene::Picture8;
use frame::{EDGE, Frame, LOOSE, TIGHT, follows, of_several_poses, squared};
use mask::Mask;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Photographs of one size by one contributor that this takes, at least.
const LEAST_PHOTOGRAPHS: usize = 4;
/// Photographs looked at, at most.
const MOST_PHOTOGRAPHS: usize = 32;
/// Shorter side of what is looked at, pixels, at least.
const LEAST_SIDE: usize = 16;
/// Share of the photographs that must agree, at least.
const AGREE: f64 = 0.8;
/// How often an edge of one photograph is met by a [`LOOSE`] one of another by chance: pairs of four captures' photographs had 0.04 to 0.23, half
/// of each capture's 0.07 to 0.15.
const CHANCE: f64 = 0.2;
/// So often may chance alone make photographs agree at a pixel.
const BY_CHANCE: f64 = 1e-4;
/// How far brightnesses of a caption's ground lie apart, 8-bit steps.
const ALIKE: f32 = 3.0;
/// Edge pixels of a watermark, at least,
const LEAST_EDGES: usize = 24;
/// and the share of them that are level, and that are upright, at least.
const BOTH_WAYS: f64 = 0.05;
/// Where more of the frame than this seems covered, it is the scene that stands still.
const MOST_COVERED: f64 = 0.3;
/// How far from its edges a caption's ground may go on, as a share of the frame's longer side.
const GROUND: f64 = 0.125;
/// A ground of which so much of the rim lies at shared edges is the caption's as far as it goes.
const BOUNDED: f64 = 0.8;
/// A photograph carries a watermark where it has this share of its edges.
const CARRIED: f64 = 0.5;

/// A visible watermark, and which photographs carry it.
#[derive(Clone, Debug, PartialEq)]
pub struct VisibleWatermark {
    /// Whose photographs they are.
    pub contributor: String,
    /// Which of the photographs that were asked about carry it, in their order; all of one size.
    pub views: Vec<usize>,
    /// Pixels that it covers, row-major, of that size.
    pub covered: Arc<[bool]>,
}

impl VisibleWatermark {
    /// How much of the frame it covers: above 0, to 0.3 and what rounding adds where photographs are made smaller.
    pub fn share(&self) -> f64 {
        self.covered.iter().filter(|on| **on).count() as f64 / self.covered.len() as f64
    }
}

/// The visible watermarks that photographs carry, each given with who took it: at most one for each contributor and size
/// of photographs. Of those there must be four from different poses; from nine on a fifth of them may lack it, and where it has no
/// ground of its own there must be seven. It covers 0.3 of the frame at most: of a larger one only letters are found, or nothing.
pub fn watermarks(photographs: &[(&str, &Picture8)]) -> Vec<VisibleWatermark> {
    let of = photographs.iter().map(|&(contributor, picture)| {
        (contributor, Seen { size: (picture.width(), picture.height()), pixels: picture.rgb() })
    });
    find(&of.collect::<Vec<_>>())
}

/// A photograph as this looks at it.
#[derive(Clone, Copy)]
pub(crate) struct Seen<'a> {
    /// Width and height, pixels.
    pub(crate) size: (usize, usize),
    /// RGB, 8 bits, row-major.
    pub(crate) pixels: &'a [u8],
}

/// As [`watermarks`], of what training keeps.
pub(crate) fn find(photographs: &[(&str, Seen<'_>)]) -> Vec<VisibleWatermark> {
    let mut groups: BTreeMap<(&str, (usize, usize)), Vec<usize>> = BTreeMap::new();
    for (at, (contributor, seen)) in photographs.iter().enumerate() {
        groups.entry((contributor, seen.size)).or_default().push(at);
    }
    let groups: Vec<_> = groups.into_iter().collect();
    let of_group = |((contributor, _), views): &((&str, (usize, usize)), Vec<usize>)| {
        let seen: Vec<Seen<'_>> = views.iter().map(|at| photographs[*at].1).collect();
        let found = find_in(&seen)?;
        let carries = found.carriers(&seen);
        let views = views.iter().zip(carries).filter(|(_, carries)| *carries).map(|(at, _)| *at).collect();
        Some(VisibleWatermark { contributor: (*contributor).to_owned(), views, covered: found.at_size(seen[0].size) })
    };
    groups.par_iter().filter_map(of_group).collect()
}

/// What most of `photographs` (of one size) carry at the same place; `None` where nothing is, or too few photographs
/// differ to tell.
fn find_in(photographs: &[Seen<'_>]) -> Option<Found> {
    let count = photographs.len();
    let (width, height) = photographs[0].size;
    if count < LEAST_PHOTOGRAPHS || width.min(height) / frame::by((width, height)) < LEAST_SIDE {
        return None;
    }
    let some = count.min(MOST_PHOTOGRAPHS);
    let frames: Vec<Frame> = (0..some).into_par_iter().map(|n| Frame::of(&photographs[n * count / some])).collect();
    let first = watermark(&frames.iter().collect::<Vec<_>>());
    // Photographs of one pose may have hidden it, or made it up.
    let nothing = vec![false; frames[0].slopes.len()];
    let several = of_several_poses(&frames, first.as_ref().map_or(&nothing, |found| &found.covered.on));
    match several.len() {
        0..LEAST_PHOTOGRAPHS => None,
        all if all == frames.len() => first,
        _ => watermark(&several),
    }
}

impl Found {
    /// Which of `photographs` carry it.
    fn carriers(&self, photographs: &[Seen<'_>]) -> Vec<bool> {
        let carries = |seen: &Seen<'_>| {
            let frame = Frame::of(seen);
            let with = self.edges.iter().filter(|(at, slope)| follows(frame.slopes[*at], *slope, LOOSE)).count();
            with as f64 >= CARRIED * self.edges.len() as f64
        };
        photographs.par_iter().map(carries).collect()
    }

    /// What it covers of photographs of `size`.
    fn at_size(&self, (width, height): (usize, usize)) -> Arc<[bool]> {
        let (by, small) = (frame::by((width, height)), &self.covered);
        let row = |at: usize| (at / width / by).min(small.height - 1);
        let column = |at: usize| (at % width / by).min(small.width - 1);
        (0..width * height).map(|at| small.on[row(at) * small.width + column(at)]).collect()
    }
}

/// How many of `photographs` must agree at a pixel, and how closely.
fn agreement(photographs: usize) -> (usize, [f32; 3]) {
    // The middle one each way is near one of them, mostly.
    let others = photographs - 1;
    let exactly = |k: usize| -> f64 {
        let ways: f64 = (0..k).map(|i| (others - i) as f64 / (i + 1) as f64).product();
        ways * CHANCE.powi(k as i32) * (1.0 - CHANCE).powi((others - k) as i32)
    };
    let least = (AGREE * photographs as f64).ceil() as usize;
    let enough = (least..=photographs).find(|need| (need - 1..=others).map(exactly).sum::<f64>() <= BY_CHANCE);
    enough.map_or((photographs, TIGHT), |need| (need, LOOSE))
}

/// A watermark as it is found in small frames.
struct Found {
    covered: Mask,
    /// Its edges, each with the slope that most frames have there.
    edges: Vec<(usize, [f32; 2])>,
}

/// What of the frame is covered.
fn watermark(frames: &[&Frame]) -> Option<Found> {
    let (width, height) = (frames[0].width, frames[0].height);
    let (need, limits) = agreement(frames.len());
    let every = || (0..width * height).into_par_iter();
    let shared: Vec<Option<[f32; 2]>> = every().map(|at| shared(frames, at, (need, limits))).collect();
    let near = (width.max(height) / 48).max(4);
    let faced = |at: usize| shared[at].is_some_and(|slope| is_faced(&shared, (width, height), at, slope, near));
    let edges = Mask { width, height, on: every().map(faced).collect() };
    if edges.count() < LEAST_EDGES {
        return None;
    }
    let strokes = edges.grown(near / 2).shrunk(near / 2);
    let alike: Vec<bool> = every().map(|at| is_alike(frames, at, need)).collect();
    // Its ground ends at edges that are shared as well, though they face nothing; a bright sky behind letters does not.
    let ends = Mask { width, height, on: shared.iter().map(Option::is_some).collect() }.grown(2);
    let ground = strokes.flooded(|at| alike[at]);
    let ground = ground.parts_where(|part| ground.share_of_rim(part, &ends) >= BOUNDED);
    let reach = edges.grown((width.max(height) as f64 * GROUND) as usize);
    let whole = strokes.flooded(|at| ground.on[at] || (alike[at] && reach.on[at]));
    // Where all photographs have one plain background, letters alone are left out rather than nothing.
    let covered = [whole, strokes].into_iter().map(|mask| {
        // An edge is blurred over a pixel or two.
        mask.parts_where(|part| is_drawn(part, &edges, &shared)).grown(2)
    });
    let covered = covered.into_iter().find(|mask| mask.count() as f64 <= MOST_COVERED * (width * height) as f64)?;
    let slope = |at: usize| Some((at, shared[at].filter(|_| covered.on[at] && edges.on[at])?));
    let edges: Vec<(usize, [f32; 2])> = (0..width * height).filter_map(slope).collect();
    (!edges.is_empty()).then_some(Found { covered, edges })
}

/// Whether a part has enough edges, and of both kinds: a band of water between coast and sky has level ones alone, a mast upright ones.
fn is_drawn(part: &[usize], edges: &Mask, shared: &[Option<[f32; 2]>]) -> bool {
    let slopes = || part.iter().filter(|at| edges.on[**at]).filter_map(|at| shared[*at]);
    let upright = slopes().filter(|[across, down]| across.abs() > down.abs()).count();
    let all = slopes().count();
    all >= LEAST_EDGES && upright.min(all - upright) as f64 >= BOTH_WAYS * all as f64
}

/// About the slope that enough of the frames have at a pixel, the middle one each way.
fn shared(frames: &[&Frame], at: usize, (need, limits): (usize, [f32; 3])) -> Option<[f32; 2]> {
    let slope = [0, 1].map(|c| middle(frames.iter().map(|f| f.slopes[at][c]).collect()));
    if squared(slope) < EDGE * EDGE {
        return None;
    }
    (frames.iter().filter(|f| follows(f.slopes[at], slope, limits)).count() >= need).then_some(slope)
}

/// Whether enough of the frames have about one brightness at a pixel.
fn is_alike(frames: &[&Frame], at: usize, need: usize) -> bool {
    let usual = middle(frames.iter().map(|f| f.brightness[at]).collect());
    frames.iter().filter(|f| (f.brightness[at] - usual).abs() <= ALIKE).count() >= need
}

/// Whether a shared edge that faces this one lies within `near` pixels.
fn is_faced(
    shared: &[Option<[f32; 2]>],
    (width, height): (usize, usize),
    at: usize,
    slope: [f32; 2],
    near: usize,
) -> bool {
    let (x, y) = (at % width, at / width);
    let rows = y.saturating_sub(near)..(y + near + 1).min(height);
    let columns = x.saturating_sub(near)..(x + near + 1).min(width);
    rows.flat_map(|row| shared[row * width + columns.start..row * width + columns.end].iter().flatten())
        .any(|other| slope[0] * other[0] + slope[1] * other[1] < -0.3 * (squared(slope) * squared(*other)).sqrt())
}

fn middle(mut values: Vec<f32>) -> f32 {
    let half = values.len() / 2;
    *values.select_nth_unstable_by(half, f32::total_cmp).1
}

#[cfg(test)]
mod tests;
