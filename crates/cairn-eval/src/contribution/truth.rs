//! What leaving groups out changes: trainings without them, and held-out views rendered by both fields.

use std::path::{Path, PathBuf};

use cairn_field::{Appearance, Field, FieldConfig};
use cairn_scene::{Camera, Picture};
use cairn_service::query::evaluate::half;

use super::rank::Table;
use crate::children::Children;
use crate::file::read;
use crate::source::{Opened, Source};
use crate::trained::Train;

/// The trainings of a capture.
pub struct Trainings<'a> {
    /// The capture.
    pub source: &'a Source,
    /// Settings of all trainings.
    pub config: &'a FieldConfig,
    /// The views of each group.
    pub groups: &'a [Vec<usize>],
    /// Groups that are left out together, by their numbers; with the first seed alone.
    pub subsets: &'a [Vec<usize>],
    /// Where fields are kept: one that is there is not trained again.
    pub out: &'a Path,
}

/// What the held-out views are in fields without some photographs, by view and group.
pub struct Truth {
    /// How far the render moves, RMS over colours in [0, 1], by each seed.
    pub change: Vec<Table>,
    /// By how much the mean squared error against the photograph grows, by each seed.
    pub growth: Vec<Table>,
    /// What of the render's move two seeds have in common: `sqrt(max(0, mean D_1 D_2))`, D what leaving the group out
    /// changes of each colour. Two trainings differ wherever photographs do not say how things are; that is independent
    /// between seeds, and its mean here is 0.
    pub shared: Table,
    /// As `change` and `growth`, by the first seed, a column for each subset of the groups.
    pub of_subsets: [Table; 2],
}

/// What a training is without.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Without {
    /// Nothing: it has all photographs.
    None,
    /// A group.
    Group(usize),
    /// A subset of the groups.
    Subset(usize),
}

impl Without {
    fn in_words(self) -> String {
        match self {
            Self::None => "of-all".to_owned(),
            Self::Group(group) => format!("without-{group}"),
            Self::Subset(subset) => format!("without-subset-{subset}"),
        }
    }
}

impl Trainings<'_> {
    /// The file of the field of `seed`.
    fn field_file(&self, seed: u64, without: Without) -> PathBuf {
        self.out.join(format!("seed-{seed}-{}.field", without.in_words()))
    }

    /// The field of `seed`.
    ///
    /// # Errors
    /// For one that was not trained yet, or does not read.
    pub fn field(&self, seed: u64, without: Without) -> anyhow::Result<Field> {
        Ok(Field::from_bytes(&read(&self.field_file(seed, without))?)?)
    }

    /// The views that a training is without.
    fn views(&self, without: Without) -> Vec<usize> {
        match without {
            Without::None => Vec::new(),
            Without::Group(group) => self.groups[group].clone(),
            Without::Subset(subset) => {
                self.subsets[subset].iter().flat_map(|group| self.groups[*group].clone()).collect()
            }
        }
    }

    /// Trains what is not there yet, of some seeds.
    ///
    /// # Errors
    /// Those of a training.
    pub fn run(&self, children: &Children, seeds: &[u64]) -> anyhow::Result<()> {
        let each = || std::iter::once(Without::None).chain((0..self.groups.len()).map(Without::Group));
        let subsets = (0..self.subsets.len()).map(|subset| (seeds[0], Without::Subset(subset)));
        let wanted = seeds.iter().flat_map(|seed| each().map(|without| (*seed, without))).chain(subsets);
        let missing: Vec<_> = wanted.filter(|(seed, without)| !self.field_file(*seed, *without).is_file()).collect();
        for (n, (seed, without)) in missing.iter().enumerate() {
            let train = Train {
                source: self.source.clone(),
                config: self.config.clone(),
                seed: *seed,
                without: self.views(*without),
                stego: None,
                field: self.field_file(*seed, *without),
                label: format!("training {} of {} ({}, seed {seed})", n + 1, missing.len(), without.in_words()),
            };
            train.unless_kept(children)?;
        }
        Ok(())
    }

    /// What leaving each group out changes in the views `held_out`, by some seeds.
    ///
    /// # Errors
    /// For fields and photographs that do not read.
    pub fn truth(&self, opened: &Opened, held_out: &[usize], seeds: &[u64]) -> anyhow::Result<Truth> {
        let shown = |seed: &u64, without: Without| -> anyhow::Result<Vec<Shown>> {
            let field = self.field(*seed, without)?;
            held_out.iter().map(|index| shown(opened, &field, *index)).collect()
        };
        let of_all = seeds.iter().map(|seed| shown(seed, Without::None)).collect::<anyhow::Result<Vec<_>>>()?;
        let none: Table = vec![Vec::new(); held_out.len()];
        let (mut change, mut growth) = (vec![none.clone(); seeds.len()], vec![none.clone(); seeds.len()]);
        let (mut shared, mut of_subsets) = (none.clone(), [none.clone(), none]);
        for group in 0..self.groups.len() {
            let without =
                seeds.iter().map(|seed| shown(seed, Without::Group(group))).collect::<anyhow::Result<Vec<_>>>()?;
            for view in 0..held_out.len() {
                let mut moves = Vec::new();
                for (at, (all, without)) in of_all.iter().zip(&without).enumerate() {
                    let (a, b) = (&all[view], &without[view]);
                    change[at][view].push(rms(&a.colours, &b.colours));
                    growth[at][view].push(b.error - a.error);
                    moves.push(a.colours.iter().zip(&b.colours).map(|(a, b)| f64::from(b - a)).collect::<Vec<f64>>());
                }
                let (one, other) = (&moves[0], &moves[moves.len() - 1]);
                let common = one.iter().zip(other).map(|(a, b)| a * b).sum::<f64>() / one.len() as f64;
                shared[view].push(common.max(0.0).sqrt());
            }
        }
        for subset in 0..self.subsets.len() {
            for (view, without) in shown(&seeds[0], Without::Subset(subset))?.iter().enumerate() {
                let all = &of_all[0][view];
                of_subsets[0][view].push(rms(&all.colours, &without.colours));
                of_subsets[1][view].push(without.error - all.error);
            }
        }
        Ok(Truth { change, growth, shared, of_subsets })
    }
}

/// The right half of a held-out view as a field shows it in the light of the left half.
struct Shown {
    colours: Vec<f32>,
    /// Its mean squared error.
    error: f64,
}

fn shown(opened: &Opened, field: &Field, index: usize) -> anyhow::Result<Shown> {
    let view = opened.view(index)?;
    let colours = half(&render(field, &view.camera, &view.picture)?)?.into_rgb();
    let error = rms(half(&view.picture)?.rgb(), &colours).powi(2);
    Ok(Shown { colours, error })
}

/// `camera`'s view in the light of the left half of `photograph`, where the scene has lights.
fn render(field: &Field, camera: &Camera, photograph: &Picture) -> anyhow::Result<Picture> {
    Ok(field.render(camera, &light_of(field, camera, photograph)?).clamped())
}

/// The light of the left half of `photograph`, where the scene has lights.
///
/// # Errors
/// Those of the fit.
pub fn light_of(field: &Field, camera: &Camera, photograph: &Picture) -> anyhow::Result<Appearance> {
    if field.appearances().is_empty() {
        Ok(field.canonical_appearance().clone())
    } else {
        Ok(field.fit_appearance_left_half(camera, photograph)?)
    }
}

/// How far two pictures lie apart, RMS.
pub fn rms(a: &[f32], b: &[f32]) -> f64 {
    let sum: f64 = a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum();
    (sum / a.len() as f64).sqrt()
}
