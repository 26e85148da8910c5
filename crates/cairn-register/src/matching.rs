//! Which keypoint of the index each of a picture's is like.

use crate::index::Index;
use crate::keypoints::{DESCRIPTOR, Keypoint, distance_ratio};
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// The nearest descriptor that shows another place must be farther by this: Lowe's ratio test, as loose as a search for
/// an agreement of many allows (measured in a trial on two captures).
const RATIO: f64 = 0.92;
/// Descriptors that are looked through for one that shows another place.
const NEAREST: usize = 12;
/// Places nearer than this are one, spans of a pixel.
const ELSEWHERE: f32 = 12.0;

/// A keypoint of a picture and a place that looks like it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Match {
    /// In the picture, px.
    pub(crate) at: DVec2,
    /// In space, capture units.
    pub(crate) place: DVec3,
    /// The view that shows the place so.
    pub(crate) view: u32,
    /// How much larger it is in the picture than in the view.
    pub(crate) larger: f64,
    /// How far it is turned against the view, radians, clockwise on the screen.
    pub(crate) turned: f64,
    /// Distance by that of the nearest that shows another place: small is sure.
    pub(crate) ratio: f64,
}

/// Matches of `picture`'s keypoints, the surest first, one for a spot of the picture.
pub(crate) fn matches(index: &Index, picture: &[Keypoint]) -> Vec<Match> {
    // Of each thread's keypoints every block of descriptors is unpacked once.
    let share = picture.len().div_ceil(rayon::current_num_threads()).max(1);
    let nearest: Vec<Nearest> =
        picture.par_chunks(share).flat_map_iter(|keypoints| nearest(&index.descriptors, keypoints)).collect();
    let mut found: Vec<Match> =
        picture.iter().zip(&nearest).filter_map(|(keypoint, near)| near.matched(index, keypoint)).collect();
    found.sort_by(|a, b| a.ratio.total_cmp(&b.ratio));
    one_a_spot(found)
}

/// The `descriptors` most like each of some keypoints'.
fn nearest(descriptors: &[[u8; DESCRIPTOR]], keypoints: &[Keypoint]) -> Vec<Nearest> {
    let asked: Vec<[f32; DESCRIPTOR]> = keypoints.iter().map(|k| k.descriptor.map(f32::from)).collect();
    let mut nearest = vec![Nearest::default(); asked.len()];
    for (k, chunk) in descriptors.chunks(BLOCK).enumerate() {
        let block = Block::of(chunk);
        for (near, q) in nearest.iter_mut().zip(&asked) {
            for (n, like) in block.likeness(q)[..chunk.len()].iter().enumerate() {
                near.add(*like as i32, (k * BLOCK + n) as u32);
            }
        }
    }
    nearest
}

/// Descriptors that are compared together: as many as registers hold sums of.
const BLOCK: usize = 64;

/// Some descriptors, number by number.
struct Block([[f32; BLOCK]; DESCRIPTOR]);

impl Block {
    fn of(descriptors: &[[u8; DESCRIPTOR]]) -> Box<Self> {
        let mut block = Box::new(Self([[0.0; BLOCK]; DESCRIPTOR]));
        for (n, descriptor) in descriptors.iter().enumerate() {
            for (row, v) in block.0.iter_mut().zip(descriptor) {
                row[n] = f32::from(*v);
            }
        }
        block
    }

    /// Scalar products with each; whole numbers below 2^24, and so exact.
    fn likeness(&self, q: &[f32; DESCRIPTOR]) -> [f32; BLOCK] {
        let mut sums = [0.0f32; BLOCK];
        for (row, q) in self.0.iter().zip(q) {
            for (sum, v) in sums.iter_mut().zip(row) {
                *sum = q.mul_add(*v, *sum);
            }
        }
        sums
    }
}

/// The first of those within a pixel of one another.
pub(crate) fn one_a_spot(found: Vec<Match>) -> Vec<Match> {
    let mut kept: Vec<Match> = Vec::with_capacity(found.len());
    for m in found {
        if kept.iter().all(|k| (k.at - m.at).length_squared() > 1.0) {
            kept.push(m);
        }
    }
    kept
}

/// The most alike descriptors, the likest first.
#[derive(Clone, Default)]
struct Nearest {
    all: Vec<(i32, u32)>,
}

impl Nearest {
    #[inline]
    fn add(&mut self, like: i32, k: u32) {
        if self.all.len() == NEAREST && self.all[NEAREST - 1].0 >= like {
            return;
        }
        let at = self.all.partition_point(|(other, n)| (*other, std::cmp::Reverse(*n)) >= (like, std::cmp::Reverse(k)));
        self.all.insert(at, (like, k));
        self.all.truncate(NEAREST);
    }

    fn matched(&self, index: &Index, keypoint: &Keypoint) -> Option<Match> {
        let (like, best) = *self.all.first()?;
        let point = index.points[best as usize];
        let elsewhere = self.all.iter().find(|(_, k)| {
            let other = index.points[*k as usize];
            (other.place - point.place).length() > ELSEWHERE * point.span.max(other.span)
        });
        // Where all that are alike show one place, the next that might not is at least as far as the last of them.
        let (next, _) = *elsewhere.or(self.all.last())?;
        let ratio = distance_ratio(like, next);
        (ratio < RATIO).then(|| Match {
            at: keypoint.at,
            place: index.place(best as usize),
            view: point.view,
            larger: f64::from(keypoint.scale / point.scale),
            turned: f64::from(keypoint.angle - point.angle),
            ratio,
        })
    }
}
