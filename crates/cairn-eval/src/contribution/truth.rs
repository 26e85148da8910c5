//! What leaving a group out changes: trainings without it, and held-out views rendered by both fields.

use std::path::{Path, PathBuf};

use cairn_field::{Field, FieldConfig};
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
}

impl Trainings<'_> {
    /// The file of the field of `seed`, of all photographs or without a group.
    fn field_file(&self, seed: u64, without: Option<usize>) -> PathBuf {
        let left_out = without.map_or("of-all".to_owned(), |group| format!("without-{group}"));
        self.out.join(format!("seed-{seed}-{left_out}.field"))
    }

    /// The field of `seed`, of all photographs or without a group.
    ///
    /// # Errors
    /// For one that was not trained yet, or does not read.
    pub fn field(&self, seed: u64, without: Option<usize>) -> anyhow::Result<Field> {
        Ok(Field::from_bytes(&read(&self.field_file(seed, without))?)?)
    }

    /// Trains what is not there yet, of some seeds.
    ///
    /// # Errors
    /// Those of a training.
    pub fn run(&self, children: &Children, seeds: &[u64]) -> anyhow::Result<()> {
        let wanted = seeds.iter().flat_map(|seed| (0..=self.groups.len()).map(|n| (*seed, n.checked_sub(1))));
        let missing: Vec<_> = wanted.filter(|(seed, without)| !self.field_file(*seed, *without).is_file()).collect();
        for (n, (seed, without)) in missing.iter().enumerate() {
            let field = self.field_file(*seed, *without);
            // Under its own name only once it is whole: a run that was stopped goes on there.
            let filling = field.with_extension("part");
            let which = without.map_or("all".to_owned(), |group| format!("without group {}", group + 1));
            children.run(&Train {
                source: self.source.clone(),
                config: self.config.clone(),
                seed: *seed,
                without: without.map_or(Vec::new(), |group| self.groups[group].clone()),
                stego: None,
                field: filling.clone(),
                label: format!("training {} of {} ({which}, seed {seed})", n + 1, missing.len()),
            })?;
            std::fs::rename(&filling, &field)?;
        }
        Ok(())
    }

    /// What leaving each group out changes, by some seeds.
    ///
    /// # Errors
    /// For fields and photographs that do not read.
    pub fn truth(&self, opened: &Opened, seeds: &[u64]) -> anyhow::Result<Truth> {
        let held_out = opened.held_out();
        let shown = |seed: &u64, without: Option<usize>| -> anyhow::Result<Vec<Shown>> {
            let field = self.field(*seed, without)?;
            held_out.iter().map(|index| shown(opened, &field, *index)).collect()
        };
        let of_all = seeds.iter().map(|seed| shown(seed, None)).collect::<anyhow::Result<Vec<_>>>()?;
        let none: Table = vec![Vec::new(); held_out.len()];
        let (mut change, mut growth) = (vec![none.clone(); seeds.len()], vec![none.clone(); seeds.len()]);
        let mut shared = none;
        for group in 0..self.groups.len() {
            let without = seeds.iter().map(|seed| shown(seed, Some(group))).collect::<anyhow::Result<Vec<_>>>()?;
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
        Ok(Truth { change, growth, shared })
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
    let light = if field.appearances().is_empty() {
        field.canonical_appearance().clone()
    } else {
        field.fit_appearance_left_half(camera, photograph)?
    };
    Ok(field.render(camera, &light).clamped())
}

/// How far two pictures lie apart, RMS.
pub fn rms(a: &[f32], b: &[f32]) -> f64 {
    let sum: f64 = a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum();
    (sum / a.len() as f64).sqrt()
}
