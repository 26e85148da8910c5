//! Working out what a view's pixels see of which vertices ([`super::linear`]). A view has millions of such
//! entries, and stage 2 asks for a fresh view every few steps: each thread writes those of a band of pixels one
//! after another, and all bands are moved together at once.

use crate::appearance::code::{FEATURES, features};
use crate::grid::sh::SH;
use crate::grid::table::Table;
use crate::render::picture::{Seen, Tiling};

/// Marks entries in contracted space, which another appearance matrix tints.
pub(super) const FAR: u32 = 1 << 31;

/// A view's pixels, row-major: the parts of a [`super::linear::LinearView`].
#[derive(Clone, Debug, Default)]
pub(super) struct ViewWeights {
    /// First entry of each pixel, one more than pixels.
    pub(super) starts: Vec<u32>,
    /// (row | FAR, weight), a pixel's ascending.
    pub(super) entries: Vec<(u32, f32)>,
    /// Spherical harmonics a pixel.
    pub(super) harmonics: Vec<[f32; SH]>,
    /// The base field's features a pixel.
    pub(super) features: Vec<[f32; FEATURES]>,
}

/// A pixel as it is worked out: sums over its rays, and what they met.
#[derive(Default)]
struct Pixel {
    features: [f32; FEATURES],
    harmonics: [f32; SH],
    met: Vec<(u32, f32)>,
}

/// Some rows of pixels.
struct Band {
    /// Of each pixel, the first of its entries and how many they are.
    spans: Vec<(usize, usize)>,
    entries: Vec<(u32, f32)>,
    harmonics: Vec<[f32; SH]>,
    features: Vec<[f32; FEATURES]>,
}

impl ViewWeights {
    /// Of a picture whose pixels are means over `rays x rays` rays each, without what weighs less than
    /// `cutoff` of a ray.
    pub(super) fn of(tiling: &Tiling<'_>, rays: usize, cutoff: f32) -> Self {
        let add = |pixel: &mut Pixel, seen: &Seen<'_>| pixel.add(seen, cutoff);
        let finish = |pixel: &mut Pixel, table: &mut Table, band: &mut Band, at: usize| {
            band.put(at, pixel, rays * rays, table);
        };
        Self::together(&tiling.bands(Band::of, add, finish))
    }

    fn together(bands: &[Band]) -> Self {
        let pixels = bands.iter().map(|b| b.spans.len()).sum::<usize>();
        let mut all = Self {
            starts: vec![0; pixels + 1],
            entries: vec![(0, 0.0); bands.iter().map(|b| b.entries.len()).sum()],
            harmonics: vec![[0.0; SH]; pixels],
            features: vec![[0.0; FEATURES]; pixels],
        };
        let Self { starts, entries, harmonics, features } = &mut all;
        let (mut starts, mut entries) = (&mut starts[1..], &mut entries[..]);
        let (mut harmonics, mut features) = (&mut harmonics[..], &mut features[..]);
        let mut first = 0;
        rayon::scope(|scope| {
            for band in bands {
                let own = Place {
                    ends: take_first(&mut starts, band.spans.len()),
                    entries: take_first(&mut entries, band.entries.len()),
                    harmonics: take_first(&mut harmonics, band.harmonics.len()),
                    features: take_first(&mut features, band.features.len()),
                };
                scope.spawn(move |_| band.move_to(first, own));
                first += band.entries.len() as u32;
            }
        });
        all
    }
}

/// Takes the first `count` of what is left.
fn take_first<'a, T>(left: &mut &'a mut [T], count: usize) -> &'a mut [T] {
    let (first, rest) = std::mem::take(left).split_at_mut(count);
    *left = rest;
    first
}

/// A band's place in each part of [`ViewWeights`].
struct Place<'a> {
    /// Where each pixel's entries end.
    ends: &'a mut [u32],
    entries: &'a mut [(u32, f32)],
    harmonics: &'a mut [[f32; SH]],
    features: &'a mut [[f32; FEATURES]],
}

impl Band {
    fn of(pixels: usize) -> Self {
        Self {
            spans: vec![(0, 0); pixels],
            entries: Vec::new(),
            harmonics: vec![[0.0; SH]; pixels],
            features: vec![[0.0; FEATURES]; pixels],
        }
    }

    /// Puts the mean over the `rays` of `pixel` in place `at`, and leaves a new one. `table` is room for the work.
    fn put(&mut self, at: usize, pixel: &mut Pixel, rays: usize, table: &mut Table) {
        let share = 1.0 / rays as f32;
        self.features[at] = pixel.features.map(|v| v * share);
        self.harmonics[at] = pixel.harmonics.map(|v| v * share);
        (pixel.features, pixel.harmonics) = ([0.0; FEATURES], [0.0; SH]);
        let first = self.entries.len();
        table.clear();
        for (row, weight) in pixel.met.drain(..) {
            let fresh = (self.entries.len() - first) as u32;
            let found = table.find_or_insert(row, fresh);
            if found == fresh {
                self.entries.push((row, 0.0));
            }
            self.entries[first + found as usize].1 += share * weight;
        }
        let own = &mut self.entries[first..];
        own.sort_unstable_by_key(|entry| entry.0);
        self.spans[at] = (first, own.len());
    }

    /// Moves the pixels to their `place` in a whole view, where `first` is the number of entries before.
    fn move_to(&self, first: u32, place: Place<'_>) {
        let Place { ends, entries, harmonics, features } = place;
        let mut done = 0;
        for (end, &(from, count)) in ends.iter_mut().zip(&self.spans) {
            entries[done..done + count].copy_from_slice(&self.entries[from..from + count]);
            done += count;
            *end = first + done as u32;
        }
        harmonics.copy_from_slice(&self.harmonics);
        features.copy_from_slice(&self.features);
    }
}

impl Pixel {
    /// Adds a ray.
    fn add(&mut self, seen: &Seen<'_>, cutoff: f32) {
        seen.each_vertex(|row, weight, far| {
            if row != 0 && weight >= cutoff {
                self.met.push((row as u32 | if far { FAR } else { 0 }, weight));
            }
        });
        let of_ray = features(&seen.gathered, &seen.harmonics);
        self.features.iter_mut().zip(of_ray).for_each(|(sum, f)| *sum += f);
        self.harmonics.iter_mut().zip(seen.harmonics).for_each(|(sum, b)| *sum += b);
    }
}
