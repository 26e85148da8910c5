//! Captions on made-up photographs: found where they are, and nothing where they are not.

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

/// Strokes 2 wide, 6 apart, with bars to their right, in a box that goes on a while to their right; how much of it hides the scene, and that of the box.
fn stamp(rgb: &mut [u8], w: usize, (strokes, ground): (f32, f32)) -> Vec<bool> {
    let mut on = vec![false; rgb.len() / 3];
    let h = on.len() / w;
    for (y, x) in (h * 7 / 10..h * 9 / 10).flat_map(|y| (w / 10..w * 7 / 10).map(move |x| (y, x))) {
        let letter = ((x / 2).is_multiple_of(3) || (x / 2 % 3 == 1 && (y / 2).is_multiple_of(4)))
            && x < w * 6 / 10
            && y > h * 7 / 10 + 3
            && y + 4 < h * 9 / 10;
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
            // As a JPEG would leave it.
            let grain = |at: usize| drawn(seed << 32 | at as u64, 7) as u8;
            rgb.iter_mut().enumerate().for_each(|(at, v)| *v = v.saturating_add(grain(at)));
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

/// Small squares on grey, sparsely, as they lie for `pose`; the light is `light` times as strong, and each photograph has grain of its own.
fn sparse(pose: u64, grain: u64, light: f32) -> Vec<u8> {
    let mut rgb = vec![120.0f32; W * H * 3];
    for n in 0..14u64 {
        let (x, y) = (drawn(pose << 8 | n, W - 5), drawn(pose << 8 | n | 128, H - 5));
        let at = |k: usize| ((y + k / 5) * W + x + k % 5) * 3;
        (0..25).for_each(|k| rgb[at(k)..at(k) + 3].fill(if n % 2 == 0 { 20.0 } else { 220.0 }));
    }
    let bits = |(at, v): (usize, f32)| (light * v) as u8 + drawn(grain << 32 | at as u64, 3) as u8;
    rgb.into_iter().enumerate().map(bits).collect()
}

#[test]
fn photographs_of_one_pose_are_not_evidence() {
    // What stands still in all of them are the scene's squares, in another light each time.
    let lights = [0.6, 0.7, 0.8, 0.9, 1.0, 1.1];
    let of_one: Vec<Vec<u8>> = (0..12).map(|n| sparse(1, n, lights[n as usize % 6])).collect();
    let all: Vec<Seen<'_>> = of_one.iter().map(|pixels| Seen { size: (W, H), pixels }).collect();
    let frames: Vec<Frame> = all.iter().map(Frame::of).collect();
    let first = watermark(&frames.iter().collect::<Vec<_>>()).expect("it looks like one");
    assert!(first.covered.count() > 0);
    assert!(find_in(&all).is_none(), "one pose is no evidence");
    // A few of another pose beside them neither.
    let mut more = of_one.clone();
    more.extend((0..2).map(|n| sparse(2, 50 + n, 1.0)));
    assert_eq!(found(&more, (W, H)), None);
}

#[test]
fn a_burst_does_not_hide_a_caption() {
    // Nine of one pose, and six others: what is said by all is the caption alone.
    let mut on = Vec::new();
    let mut stamped = |mut rgb: Vec<u8>| {
        on = stamp(&mut rgb, W, (1.0, 1.0));
        rgb
    };
    let mut photographs: Vec<Vec<u8>> = (0..9).map(|n| stamped(sparse(1, n, 1.0))).collect();
    photographs.extend((0..6).map(|n| stamped(photograph(70 + n, (W, H), false))));
    let (of_it, beside) = shares(&found(&photographs, (W, H)).expect("found"), &on);
    assert!(of_it > 0.97 && beside < 0.1, "{of_it:.3} of it, {beside:.3} beside");
}

#[test]
fn a_band_across_all_photographs_is_the_scene() {
    // A dark coast between sky and water, level in all of them.
    let of = |seed: u64| {
        let mut rgb = photograph(seed, (W, H), false);
        rgb[40 * W * 3..43 * W * 3].fill(20);
        rgb[..40 * W * 3].fill(230);
        rgb[43 * W * 3..50 * W * 3].fill(170);
        rgb
    };
    for n in [5, 9, 20] {
        assert_eq!(found(&(0..n).map(of).collect::<Vec<_>>(), (W, H)), None, "{n} photographs");
    }
}

#[test]
fn on_a_plain_background_letters_are_found() {
    // Objects before white, which would be taken for the caption's ground.
    let mut on = Vec::new();
    let of = |seed: u64| {
        let mut rgb = vec![250u8; W * H * 3];
        let thing = photograph(seed, (W, H), false);
        let (left, top) = (20 + drawn(seed, 20), 5 + drawn(seed << 3, 10));
        for y in top..top + 40 {
            let row = (y * W + left) * 3..(y * W + left + 50) * 3;
            rgb[row.clone()].copy_from_slice(&thing[row]);
        }
        on = stamp(&mut rgb, W, (1.0, 0.0));
        (0..W * H).filter(|at| on[*at]).for_each(|at| rgb[at * 3..at * 3 + 3].fill(40));
        rgb
    };
    let photographs: Vec<Vec<u8>> = (0..12).map(of).collect();
    let (of_it, beside) = shares(&found(&photographs, (W, H)).expect("found"), &on);
    assert!(of_it > 0.9 && beside < 0.3, "{of_it:.3} of it, {beside:.3} beside");
}

#[test]
fn who_lacks_it_is_told_as_well() {
    let stamped = |seed| {
        let mut rgb = photograph(seed, (W, H), false);
        if seed != 3 && seed != 8 {
            stamp(&mut rgb, W, (1.0, 1.0));
        }
        rgb
    };
    let photographs: Vec<Vec<u8>> = (0..16).map(stamped).collect();
    let all: Vec<(&str, Seen<'_>)> = photographs.iter().map(|pixels| ("ada", Seen { size: (W, H), pixels })).collect();
    let marks = find(&all);
    assert_eq!(marks.len(), 1);
    assert_eq!(marks[0].views, (0..16).filter(|at| ![3, 8].contains(at)).collect::<Vec<_>>());
}

#[test]
fn masks_grow_and_shrink_by_so_many_pixels() {
    let (width, height) = (11, 9);
    let mut mask = Mask { width, height, on: vec![false; width * height] };
    mask.on[4 * width + 5] = true;
    mask.on[0] = true;
    let grown = mask.grown(2);
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        let near = (x.abs_diff(5) <= 2 && y.abs_diff(4) <= 2) || (x <= 2 && y <= 2);
        assert_eq!(grown.on[y * width + x], near, "at {x}, {y}");
    }
    assert_eq!(grown.shrunk(2).on, mask.on);
    assert_eq!(mask.grown(0).on, mask.on);
    assert_eq!(mask.grown(20).count(), width * height);
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
    let table =
        [(4, 4, TIGHT), (6, 6, TIGHT), (7, 7, LOOSE), (9, 8, LOOSE), (12, 10, LOOSE), (21, 17, LOOSE), (32, 26, LOOSE)];
    for (n, need, limits) in table {
        assert_eq!(agreement(n), (need, limits), "{n} photographs");
    }
}
