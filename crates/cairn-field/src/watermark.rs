//! Visible watermarks: a caption, a logo, a date that a camera or a site has put on all photographs of one contributor, at
//! the same place of the frame. No scene explains them, and a field that is to explain them hangs them before that
//! contributor's cameras. Pixels that they cover are not learnt from.
//!
//! What tells them is that they stay where they are while the scene moves (Dekel et al., "On the Effectiveness of
//! Visible Watermarks", CVPR 2017, estimate them from the median of a collection's gradients): a pixel lies on a
//! watermark's edge where four of five photographs have the same gradient. A horizon that is level in all of them has as well,
//! or the side of a tower that everybody puts in the middle; but letters and frames have edges that face each other
//! within a few pixels, and only what is near such a pair counts. From there a watermark goes on as far as the photographs have one brightness (a
//! caption's ground: to the edges around it, or a little way where there are none), and over strokes that two edges enclose. Photographs of one pose say nothing and are counted once.

use crate::trainer::TrainingView;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Photographs of one size by one contributor that this takes, at least.
const LEAST_PHOTOGRAPHS: usize = 4;
/// Photographs looked at, at most.
const MOST_PHOTOGRAPHS: usize = 32;
/// Share of the photographs that must agree, at least.
const AGREE: f64 = 0.8;
/// How often an edge of one photograph is met by a [`LOOSE`] one of another by chance: more than any two of four captures' photographs
/// had (0.05 to 0.23, half of them 0.08 to 0.15).
const CHANCE: f64 = 0.2;
/// So often may chance alone make photographs agree at a pixel.
const BY_CHANCE: f64 = 1e-4;
/// How slopes that agree differ, as shares of the middle one: from, to, and at right angles to it. A watermark that lets the
/// scene through changes less where that is bright.
const LOOSE: [f32; 3] = [0.4, 2.5, 0.6];
/// The same where photographs are too few to tell a watermark from chance by loose agreement: only opaque ones are found there.
const TIGHT: [f32; 3] = [0.85, 1.18, 0.15];
/// Longest side that is looked at, pixels; larger photographs are made smaller by a whole number.
const LONGEST_PX: usize = 768;
/// Weakest edge, 8-bit steps a pixel, by central differences: a twelfth of white on grey, sharply drawn.
const EDGE: f32 = 5.0;
/// How far brightnesses of a caption's ground lie apart, 8-bit steps.
const ALIKE: f32 = 3.0;
/// Photographs whose edges agree in this share are of one pose.
const ONE_POSE: f64 = 0.5;
/// Edge pixels beside a watermark by which photographs are compared, at least.
const LEAST_SHOWN: usize = 32;
/// Edge pixels of a watermark, at least.
const LEAST_EDGES: usize = 24;
/// Where more of the frame than this seems covered, it is the scene that stands still.
const MOST_COVERED: f64 = 0.3;
/// How far from its edges a caption's ground may go on, as a share of the frame's longer side.
const GROUND: f64 = 0.125;
/// A ground of which so much of the rim lies at shared edges is the caption's as far as it goes.
const BOUNDED: f64 = 0.8;

/// A visible watermark, and whose photographs carry it.
#[derive(Clone, Debug, PartialEq)]
pub struct VisibleWatermark {
    /// Whose photographs they are.
    pub contributor: String,
    /// Which of the views that were asked about, in their order; all of one size.
    pub views: Vec<usize>,
    /// Pixels that it covers, row-major, of that size.
    pub covered: Arc<[bool]>,
}

impl VisibleWatermark {
    /// How much of the frame it covers, above 0 and to 0.35.
    pub fn share(&self) -> f64 {
        self.covered.iter().filter(|on| **on).count() as f64 / self.covered.len() as f64
    }
}

/// The visible watermarks that contributors' photographs carry; at most one for each contributor and size of photographs,
/// of which there must be four from different poses, and seven where it lets the scene through.
pub fn watermarks(views: &[TrainingView]) -> Vec<VisibleWatermark> {
    let bits: Vec<Vec<u8>> = views.par_iter().map(|view| view.picture.to_rgb8()).collect();
    let all: Vec<(&str, Seen<'_>)> = views
        .iter()
        .zip(&bits)
        .map(|(view, pixels)| {
            (view.contributor.as_str(), Seen { size: (view.picture.width(), view.picture.height()), pixels })
        })
        .collect();
    find(&all)
}

/// A photograph as this looks at it.
#[derive(Clone, Copy)]
pub(crate) struct Seen<'a> {
    /// Width and height, pixels.
    pub(crate) size: (usize, usize),
    /// RGB, 8 bits, row-major.
    pub(crate) pixels: &'a [u8],
}

/// As [`watermarks`], of photographs with who took them.
pub(crate) fn find(photographs: &[(&str, Seen<'_>)]) -> Vec<VisibleWatermark> {
    let mut groups: BTreeMap<(&str, (usize, usize)), Vec<usize>> = BTreeMap::new();
    for (at, (contributor, seen)) in photographs.iter().enumerate() {
        groups.entry((contributor, seen.size)).or_default().push(at);
    }
    let of_group = |((contributor, _), views): ((&str, (usize, usize)), Vec<usize>)| {
        let seen: Vec<Seen<'_>> = views.iter().map(|at| photographs[*at].1).collect();
        let covered = covered(&seen)?.into();
        Some(VisibleWatermark { contributor: contributor.to_owned(), views, covered })
    };
    groups.into_iter().filter_map(of_group).collect()
}

/// Which pixels of a frame are covered, row-major, by what all of `photographs` (of one size) carry at the same place;
/// `None` where nothing is, or too few photographs differ to tell.
fn covered(photographs: &[Seen<'_>]) -> Option<Vec<bool>> {
    if photographs.len() < LEAST_PHOTOGRAPHS {
        return None;
    }
    let every = photographs.len().div_ceil(MOST_PHOTOGRAPHS);
    let some: Vec<&Seen<'_>> = photographs.iter().step_by(every).collect();
    let frames: Vec<Frame> = some.into_par_iter().map(Frame::of).collect();
    let (width, height) = photographs[0].size;
    if width.min(height) < 16 {
        return None;
    }
    let first = watermark(&frames.iter().collect::<Vec<_>>())?;
    let several = of_several_poses(&frames, &first.on);
    if several.len() < LEAST_PHOTOGRAPHS {
        return None;
    }
    let small = if several.len() < frames.len() { watermark(&several)? } else { first };
    let by = frames[0].by;
    let pixel = |at: usize| {
        small.on[((at / width / by).min(small.height - 1)) * small.width + (at % width / by).min(small.width - 1)]
    };
    Some((0..width * height).map(pixel).collect())
}

/// Brightness of a photograph, made smaller.
struct Frame {
    width: usize,
    height: usize,
    /// How many pixels across one of these stands for.
    by: usize,
    /// 0 to 255.
    brightness: Vec<f32>,
    /// Changes across and down, a pixel; 0 on the rim.
    slopes: Vec<[f32; 2]>,
}

impl Frame {
    fn of(seen: &Seen<'_>) -> Self {
        let (w, h) = seen.size;
        let by = w.max(h).div_ceil(LONGEST_PX).max(1);
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
        Self { width, height, by, brightness, slopes }
    }

    /// Where this frame has edges and nothing is `covered`.
    fn edges<'a>(&'a self, covered: &'a [bool]) -> impl Iterator<Item = usize> + 'a {
        (0..covered.len()).filter(|at| !covered[*at] && squared(self.slopes[*at]) >= EDGE * EDGE)
    }

    /// Share of this frame's edges beside what is `covered` that `other` has as well.
    fn alike(&self, other: &Self, covered: &[bool]) -> f64 {
        let both = self.edges(covered).filter(|at| follows(other.slopes[*at], self.slopes[*at], LOOSE)).count();
        both as f64 / self.edges(covered).count().max(1) as f64
    }
}

/// Sixteen times the brightness of a pixel.
fn luma(rgb: &[u8]) -> u32 {
    5 * u32::from(rgb[0]) + 9 * u32::from(rgb[1]) + 2 * u32::from(rgb[2])
}

fn squared(a: [f32; 2]) -> f32 {
    a[0] * a[0] + a[1] * a[1]
}

/// Whether slope `a` is about `m`, by [`LOOSE`] or [`TIGHT`] limits.
fn follows(a: [f32; 2], m: [f32; 2], [from, to, across]: [f32; 3]) -> bool {
    let along = (a[0] * m[0] + a[1] * m[1]) / squared(m);
    (from..to).contains(&along) && (a[0] * m[1] - a[1] * m[0]).abs() <= across * squared(m)
}

/// How many of `photographs` must agree at a pixel, and how closely.
fn agreement(photographs: usize) -> (usize, [f32; 3]) {
    // One of them is the middle one, or next to it.
    let others = photographs - 1;
    let exactly = |k: usize| -> f64 {
        let ways: f64 = (0..k).map(|i| (others - i) as f64 / (i + 1) as f64).product();
        ways * CHANCE.powi(k as i32) * (1.0 - CHANCE).powi((others - k) as i32)
    };
    let least = (AGREE * photographs as f64).ceil() as usize;
    let enough = (least..=photographs).find(|need| (need - 1..=others).map(exactly).sum::<f64>() <= BY_CHANCE);
    enough.map_or((photographs, TIGHT), |need| (need, LOOSE))
}

/// One frame of each pose, in their order, by what is not `covered`. Those that show nothing there cannot tell.
fn of_several_poses<'a>(frames: &'a [Frame], covered: &[bool]) -> Vec<&'a Frame> {
    let mut kept: Vec<&Frame> = Vec::new();
    for frame in frames.iter().filter(|f| f.edges(covered).count() >= LEAST_SHOWN) {
        let of_one = |other: &&Frame| other.alike(frame, covered).max(frame.alike(other, covered)) >= ONE_POSE;
        if !kept.par_iter().any(of_one) {
            kept.push(frame);
        }
    }
    kept
}

/// A picture of two values.
struct Mask {
    width: usize,
    height: usize,
    on: Vec<bool>,
}

/// What of the frame is covered.
fn watermark(frames: &[&Frame]) -> Option<Mask> {
    let (width, height) = (frames[0].width, frames[0].height);
    let (need, limits) = agreement(frames.len());
    let shared: Vec<Option<[f32; 2]>> =
        (0..width * height).into_par_iter().map(|at| shared(frames, at, (need, limits))).collect();
    let near = (width.max(height) / 48).max(4);
    let faced = |at: usize| shared[at].is_some_and(|slope| is_faced(&shared, (width, height), at, slope, near));
    let edges: Vec<bool> = (0..width * height).into_par_iter().map(faced).collect();
    let alike: Vec<bool> = (0..width * height).into_par_iter().map(|at| is_alike(frames, at, need)).collect();
    let edges = Mask { width, height, on: edges };
    let strokes = edges.grown(near / 2).shrunk(near / 2);
    // Its ground ends at edges that are shared as well, though they face nothing; a bright sky behind letters does not.
    let ends = Mask { width, height, on: shared.iter().map(Option::is_some).collect() }.grown(2);
    let ground = strokes.flooded(|at| alike[at]);
    let ground = ground.parts_where(|part| ground.share_of_rim(part, &ends) >= BOUNDED);
    let reach = edges.grown((width.max(height) as f64 * GROUND) as usize);
    let mask = strokes.flooded(|at| ground.on[at] || (alike[at] && reach.on[at]));
    // An edge is blurred over a pixel or two.
    let letters = |part: &[usize]| part.iter().filter(|at| edges.on[**at]).count();
    let mask = mask.parts_where(|part| letters(part) >= LEAST_EDGES).grown(2);
    let share = mask.on.iter().filter(|on| **on).count() as f64 / mask.on.len() as f64;
    (share > 0.0 && share <= MOST_COVERED).then_some(mask)
}

/// The slope that enough of the frames have at a pixel.
fn shared(frames: &[&Frame], at: usize, (need, limits): (usize, [f32; 3])) -> Option<[f32; 2]> {
    let slope = [0, 1].map(|c| median(frames.iter().map(|f| f.slopes[at][c]).collect()));
    if squared(slope) < EDGE * EDGE {
        return None;
    }
    (frames.iter().filter(|f| follows(f.slopes[at], slope, limits)).count() >= need).then_some(slope)
}

/// Whether enough of the frames have about one brightness at a pixel.
fn is_alike(frames: &[&Frame], at: usize, need: usize) -> bool {
    let middle = median(frames.iter().map(|f| f.brightness[at]).collect());
    frames.iter().filter(|f| (f.brightness[at] - middle).abs() <= ALIKE).count() >= need
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

fn median(mut values: Vec<f32>) -> f32 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

impl Mask {
    /// On wherever a pixel within `by` pixels, across and down, is.
    fn grown(&self, by: usize) -> Self {
        let along = |on: &[bool], width: usize, height: usize| -> Vec<bool> {
            // Turned over as it goes: the second time puts rows and columns back.
            let one = |at: usize| {
                let (x, y) = (at / height, at % height);
                let row = &on[y * width..(y + 1) * width];
                row[x.saturating_sub(by)..(x + by + 1).min(width)].iter().any(|on| *on)
            };
            (0..width * height).map(one).collect()
        };
        let across = along(&self.on, self.width, self.height);
        Self { on: along(&across, self.height, self.width), ..*self }
    }

    /// Off wherever a pixel within `by` pixels, across and down, is.
    fn shrunk(&self, by: usize) -> Self {
        let off = Self { on: self.on.iter().map(|on| !on).collect(), ..*self };
        Self { on: off.grown(by).on.iter().map(|on| !on).collect(), ..*self }
    }

    /// Grown step by step, to the sides, into pixels that are `open`.
    fn flooded(&self, open: impl Fn(usize) -> bool) -> Self {
        let mut on = self.on.clone();
        self.reach((0..on.len()).filter(|at| self.on[*at]).collect(), &mut on, open);
        Self { on, ..*self }
    }

    /// Its connected parts that are `kept`.
    fn parts_where(&self, kept: impl Fn(&[usize]) -> bool) -> Self {
        let mut left = vec![false; self.on.len()];
        let mut seen = left.clone();
        for start in 0..self.on.len() {
            if !self.on[start] || seen[start] {
                continue;
            }
            seen[start] = true;
            let part = self.reach(vec![start], &mut seen, |at| self.on[at]);
            if kept(&part) {
                part.iter().for_each(|at| left[*at] = true);
            }
        }
        Self { on: left, ..*self }
    }

    /// Of the pixels of `part` that have neighbours out of it, the share that lies in `ends`; 1 where it fills the frame.
    fn share_of_rim(&self, part: &[usize], ends: &Self) -> f64 {
        let rim = || part.iter().filter(|at| self.sides(**at).any(|side| !self.on[side]));
        rim().filter(|at| ends.on[**at]).count() as f64 / rim().count().max(1) as f64
    }

    /// Pixels beside `at`, above and below.
    fn sides(&self, at: usize) -> impl Iterator<Item = usize> + use<> {
        let (x, y, width) = (at % self.width, at / self.width, self.width);
        let sides = [
            (x > 0).then(|| at - 1),
            (x + 1 < width).then(|| at + 1),
            (y > 0).then(|| at - width),
            (y + 1 < self.height).then(|| at + width),
        ];
        sides.into_iter().flatten()
    }

    /// Goes from `starts`, which are `seen`, to the sides through what is `open` and not yet seen; all that was reached.
    fn reach(&self, starts: Vec<usize>, seen: &mut [bool], open: impl Fn(usize) -> bool) -> Vec<usize> {
        let mut reached = starts;
        let mut next = 0;
        while let Some(at) = reached.get(next).copied() {
            next += 1;
            for side in self.sides(at) {
                if !seen[side] && open(side) {
                    seen[side] = true;
                    reached.push(side);
                }
            }
        }
        reached
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::mixed;

    const W: usize = 120;
    const H: usize = 90;

    /// A number in 0..n for each `key`.
    fn drawn(key: u64, n: usize) -> usize {
        (mixed(key) % n as u64) as usize
    }

    /// A photograph full of sharp edges, which lie elsewhere for each `seed`; where `horizon`, all is bright above a third.
    fn photograph(seed: u64, (w, h): (usize, usize), horizon: bool) -> Vec<u8> {
        let mut rgb = vec![110u8; w * h * 3];
        let from = if horizon { h / 3 } else { 0 };
        for n in 0..60u64 {
            let key = |k: u64| mixed(seed << 20 | n << 4 | k);
            let (x, y) = (drawn(key(0), w), from + drawn(key(1), h - from));
            let (across, down) = (2 + drawn(key(2), w / 5), 2 + drawn(key(3), h / 5));
            for at in (y..(y + down).min(h)).flat_map(|y| (x..(x + across).min(w)).map(move |x| y * w + x)) {
                (0..3).for_each(|c| rgb[at * 3 + c] = drawn(key(4 + c as u64), 256) as u8);
            }
        }
        if horizon {
            rgb[..from * w * 3].fill(235);
        }
        rgb
    }

    /// Strokes 2 wide, 6 apart, in a box that goes on a while to their right; how much of it hides the scene, and that of the box.
    fn stamp(rgb: &mut [u8], w: usize, (strokes, ground): (f32, f32)) -> Vec<bool> {
        let mut on = vec![false; rgb.len() / 3];
        let h = on.len() / w;
        for (y, x) in (h * 7 / 10..h * 9 / 10).flat_map(|y| (w / 10..w * 7 / 10).map(move |x| (y, x))) {
            let letter = (x / 2).is_multiple_of(3) && x < w * 6 / 10 && y > h * 7 / 10 + 3 && y + 4 < h * 9 / 10;
            let (share, value) = if letter { (strokes, 250.0) } else { (ground, 15.0) };
            if share > 0.0 {
                on[y * w + x] = true;
                for v in &mut rgb[(y * w + x) * 3..][..3] {
                    *v = (share * value + (1.0 - share) * f32::from(*v)).round() as u8;
                }
            }
        }
        on
    }

    fn found(photographs: &[Vec<u8>], size: (usize, usize)) -> Option<Vec<bool>> {
        let all: Vec<(&str, Seen<'_>)> = photographs.iter().map(|pixels| ("ada", Seen { size, pixels })).collect();
        find(&all).pop().map(|mark| mark.covered.to_vec())
    }

    /// What of the watermark is covered, and how much else, as a share of the frame.
    fn shares(covered: &[bool], on: &[bool]) -> (f64, f64) {
        let both = covered.iter().zip(on).filter(|(a, b)| **a && **b).count() as f64;
        let all = covered.iter().filter(|a| **a).count() as f64;
        (both / on.iter().filter(|b| **b).count() as f64, (all - both) / on.len() as f64)
    }

    #[test]
    fn captions_are_found_in_few_photographs_and_in_many() {
        for n in [4, 5, 6, 7, 12, 40] {
            let mut on = Vec::new();
            let stamped = |seed| {
                let mut rgb = photograph(seed, (W, H), false);
                on = stamp(&mut rgb, W, (1.0, 1.0));
                rgb
            };
            let photographs: Vec<Vec<u8>> = (0..n).map(stamped).collect();
            let covered = found(&photographs, (W, H)).unwrap_or_else(|| panic!("of {n} photographs"));
            let (of_it, beside) = shares(&covered, &on);
            assert!(of_it > 0.97 && beside < 0.1, "{n} photographs: {of_it:.3} of it, {beside:.3} beside");
        }
    }

    #[test]
    fn letters_that_let_the_scene_through_are_found() {
        for n in [7, 12, 40] {
            let mut on = Vec::new();
            let stamped = |seed| {
                let mut rgb = photograph(seed, (W, H), false);
                on = stamp(&mut rgb, W, (0.5, 0.0));
                rgb
            };
            let photographs: Vec<Vec<u8>> = (0..n).map(stamped).collect();
            let covered = found(&photographs, (W, H)).unwrap_or_else(|| panic!("of {n} photographs"));
            let (of_it, beside) = shares(&covered, &on);
            assert!(of_it > 0.8 && beside < 0.1, "{n} photographs: {of_it:.3} of it, {beside:.3} beside");
        }
    }

    #[test]
    fn nothing_is_found_where_nothing_is() {
        for n in [3, 4, 5, 6, 7, 8, 12, 20] {
            for series in 0..6u64 {
                for horizon in [false, true] {
                    let of = |at: u64| photograph(1000 * (series + 1) + at, (W, H), horizon);
                    let photographs: Vec<Vec<u8>> = (0..n).map(of).collect();
                    assert_eq!(found(&photographs, (W, H)), None, "{n} photographs, horizon {horizon}");
                }
            }
        }
        let same = vec![stamped_once(); 3];
        assert_eq!(found(&same, (W, H)), None, "three are too few");
    }

    fn stamped_once() -> Vec<u8> {
        let mut rgb = photograph(1, (W, H), false);
        stamp(&mut rgb, W, (1.0, 1.0));
        rgb
    }

    #[test]
    fn photographs_of_one_pose_are_not_evidence() {
        // Ten of one pose, each with grain of its own, and ten of three poses.
        for poses in [1, 3] {
            let of = |at: u64| -> Vec<u8> {
                let mut rgb = photograph(at % poses, (W, H), false);
                rgb.iter_mut()
                    .enumerate()
                    .for_each(|(k, v)| *v = v.saturating_add(drawn(at << 32 | k as u64, 4) as u8));
                rgb
            };
            assert_eq!(found(&(0..10).map(of).collect::<Vec<_>>(), (W, H)), None, "{poses} poses");
        }
    }

    #[test]
    fn whose_photographs_carry_it_is_told() {
        let size = (W, H);
        let bela: Vec<Vec<u8>> = (0..9).map(|seed| photograph(seed, size, false)).collect();
        let ada: Vec<Vec<u8>> = (20..29)
            .map(|seed| {
                let mut rgb = photograph(seed, size, false);
                stamp(&mut rgb, W, (1.0, 1.0));
                rgb
            })
            .collect();
        // Upright ones of hers have none.
        let upright: Vec<Vec<u8>> = (40..49).map(|seed| photograph(seed, (H, W), false)).collect();
        let mut all: Vec<(&str, Seen<'_>)> = Vec::new();
        for at in 0..9 {
            all.push(("bela", Seen { size, pixels: &bela[at] }));
            all.push(("ada", Seen { size, pixels: &ada[at] }));
            all.push(("ada", Seen { size: (H, W), pixels: &upright[at] }));
        }
        let marks = find(&all);
        assert_eq!(marks.len(), 1);
        assert_eq!(marks[0].contributor, "ada");
        assert_eq!(marks[0].views, (0..9).map(|at| 3 * at + 1).collect::<Vec<_>>());
        assert!((0.05..0.2).contains(&marks[0].share()), "{}", marks[0].share());
    }

    #[test]
    fn large_photographs_are_looked_at_smaller() {
        let size = (1700, 700);
        let mut on = Vec::new();
        let stamped = |seed| {
            // As if enlarged, so that strokes are six pixels wide.
            let mut small = photograph(seed, (567, 234), false);
            let covers = stamp(&mut small, 567, (1.0, 1.0));
            let at = |p: usize| (p / 1700 / 3).min(233) * 567 + (p % 1700 / 3).min(566);
            on = (0..1700 * 700).map(|p| covers[at(p)]).collect();
            (0..1700 * 700).flat_map(|p| small[at(p) * 3..][..3].to_vec()).collect()
        };
        let photographs: Vec<Vec<u8>> = (0..8).map(stamped).collect();
        let (of_it, beside) = shares(&found(&photographs, size).expect("found"), &on);
        assert!(of_it > 0.95 && beside < 0.05, "{of_it:.3} of it, {beside:.3} beside");
    }

    #[test]
    fn the_fewer_the_photographs_the_more_must_agree() {
        let table = [
            (4, 4, TIGHT),
            (6, 6, TIGHT),
            (7, 7, LOOSE),
            (9, 8, LOOSE),
            (12, 10, LOOSE),
            (21, 17, LOOSE),
            (32, 26, LOOSE),
        ];
        for (n, need, limits) in table {
            assert_eq!(agreement(n), (need, limits), "{n} photographs");
        }
    }
}
