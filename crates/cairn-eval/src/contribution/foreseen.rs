//! What is foreseen of leaving a group out, by each way of foreseeing it, from the field of all photographs alone.

use std::time::Instant;

use cairn_field::{Appearance, Field, MarkableField, NamedView, OfPixel, RowWeights, VisibleField};
use cairn_scene::Camera;
use cairn_share::{Builder, Lesson, Necessity, PULL, Photograph, STEPS, SeenFrom, ShareTable, Sharpness, taught};

use super::rank::Table;
use super::truth::{light_of, rms};
use crate::progress::Progress;
use crate::source::Opened;

/// Pixels of all photographs together where few are looked at.
const MAX_PIXELS: usize = cairn_service::query::necessity::MAX_PIXELS;
/// Entries of a view's linear map that weigh less are left out, pixels.
const CUTOFF: f32 = 1e-3;

/// Groups of one capture, and its field of all photographs.
pub struct Foresight<'a> {
    /// The capture.
    pub opened: &'a Opened,
    /// The field.
    pub field: &'a Field,
    /// The views of each group.
    pub groups: &'a [Vec<usize>],
    /// From which residual on a colour counted less in training.
    huber: f64,
    table: ShareTable,
    /// What the right half of each held-out view sees, and its light, fitted to the left half.
    seen: Vec<Sight>,
    /// Seconds that the table took.
    pub table_seconds: f64,
}

/// What a held-out view sees.
struct Sight {
    camera: Camera,
    weights: RowWeights,
    light: Appearance,
}

impl<'a> Foresight<'a> {
    /// Makes the share table.
    ///
    /// # Errors
    /// For more photographs than a table takes, and such as do not decode.
    pub fn new(
        opened: &'a Opened,
        held_out: &[usize],
        field: &'a Field,
        groups: &'a [Vec<usize>],
        huber: f64,
    ) -> anyhow::Result<Self> {
        let mut builder = Builder::new(VisibleField::rows(field));
        let mut table_seconds = 0.0;
        for index in opened.training() {
            // Without decoding: a training has the photographs at hand.
            let NamedView { name, view } = opened.view(index)?.named();
            let begun = Instant::now();
            let photograph = Photograph { name: name.clone(), position: view.camera.pose.position };
            builder.add(photograph, &taught(field, &name, &view, huber))?;
            table_seconds += begun.elapsed().as_secs_f64();
        }
        let begun = Instant::now();
        let table = builder.finish()?;
        table_seconds += begun.elapsed().as_secs_f64();
        let seen = |index: &usize| -> anyhow::Result<Sight> {
            let view = opened.view(*index)?;
            let camera = view.camera;
            let right = |at: usize| at % camera.intrinsics.width >= camera.intrinsics.width / 2;
            let weights = field.row_weights(&camera, OfPixel::ByPlace(&|at| f32::from(u8::from(right(at)))));
            Ok(Sight { camera, weights, light: light_of(field, &camera, &view.picture)? })
        };
        let seen = held_out.iter().map(seen).collect::<anyhow::Result<_>>()?;
        Ok(Self { opened, field, groups, huber, table, seen, table_seconds })
    }

    /// Each way's table, with its name.
    ///
    /// # Errors
    /// For photographs that do not decode.
    pub fn all(&self) -> anyhow::Result<Vec<(String, Table)>> {
        let mut all = vec![
            ("number of photographs".to_owned(), self.each_view(|_, group| group.len() as f64)),
            ("kernel on pose".to_owned(), self.kernels()),
        ];
        for power in [0, 4, 8, 16, 32] {
            all.push((format!("coverage, power {power}"), self.coverage(Sharpness::new(power))));
        }
        all.extend(self.necessity()?);
        Ok(all)
    }

    fn each_view(&self, of: impl Fn(&Camera, &[usize]) -> f64) -> Table {
        self.seen.iter().map(|seen| self.groups.iter().map(|group| of(&seen.camera, group)).collect()).collect()
    }

    /// Each photograph counts by how near it was taken from, and how alike it looks.
    fn kernels(&self) -> Table {
        let positions: Vec<_> = self.opened.training().iter().map(|i| self.opened.camera(*i).pose.position).collect();
        let middle = positions.iter().sum::<glam::DVec3>() / positions.len() as f64;
        let size = (positions.iter().map(|p| p.distance_squared(middle)).sum::<f64>() / positions.len() as f64).sqrt();
        let near = |camera: &Camera, other: usize| {
            let other = self.opened.camera(other).pose;
            let apart = camera.pose.position.distance(other.position) / (0.5 * size);
            let turned = 1.0 - camera.pose.forward().dot(other.forward());
            (-0.5 * apart * apart - turned / 0.1).exp()
        };
        self.each_view(|camera, group| group.iter().map(|i| near(camera, *i)).sum())
    }

    fn coverage(&self, sharpness: Sharpness) -> Table {
        let place: Vec<usize> = self.opened.training();
        let of = |seen: &Sight| {
            let from = SeenFrom::new(&self.table, self.field, seen.camera.pose.position, sharpness);
            let shares = from.shares(&seen.weights).of_photographs;
            let share = |group: &Vec<usize>| {
                place.iter().zip(&shares).filter(|(index, _)| group.contains(index)).map(|(_, share)| share).sum()
            };
            self.groups.iter().map(share).collect()
        };
        self.seen.iter().map(of).collect()
    }

    /// How far the render moves when colours are solved for again without each group: from all pixels, and from as few as
    /// an answer to a caller is worked out from.
    fn necessity(&self) -> anyhow::Result<Vec<(String, Table)>> {
        let few = MAX_PIXELS / self.opened.training().len();
        Ok(vec![
            ("necessity, rho 0.1".to_owned(), self.solved(0.1, usize::MAX)?),
            (format!("necessity, rho {PULL}"), self.solved(PULL, usize::MAX)?),
            (format!("necessity, rho {PULL}, fewer pixels"), self.solved(PULL, few)?),
        ])
    }

    fn solved(&self, pull: f32, max_pixels: usize) -> anyhow::Result<Table> {
        let training = self.opened.training();
        let mut lessons = Vec::new();
        let mut progress = Progress::new("linear maps", training.len() as u64);
        for index in &training {
            progress.at(lessons.len() as u64, "");
            let NamedView { name, view } = self.opened.view(*index)?.named();
            lessons.push(Lesson::of(self.field, &name, &view, self.huber, max_pixels));
        }
        drop(progress);
        let begun = Instant::now();
        let off = self.field.constant_colours().iter().flat_map(|c| c.map(|v| v - 0.5)).collect::<Vec<f32>>();
        let problem = Necessity::new(&lessons, MarkableField::rows(self.field), off, pull, STEPS);
        let mut progress = Progress::new("colours", self.groups.len() as u64 + 1);
        let all = problem.solve(|_| true);
        let mut table = vec![Vec::new(); self.seen.len()];
        for (n, group) in self.groups.iter().enumerate() {
            progress.at(n as u64 + 1, "");
            let without = problem.solve(|photograph| !group.contains(&training[photograph]));
            let moved: Vec<f32> = without.iter().zip(&all).map(|(a, b)| a - b).collect();
            for (row, seen) in table.iter_mut().zip(&self.seen) {
                row.push(self.shown(seen, &moved));
            }
        }
        drop(progress);
        println!("  necessity, rho {pull}, {max_pixels} px a photograph: {:.1} s", begun.elapsed().as_secs_f64());
        Ok(table)
    }

    /// What a change of constant colours changes in the right half of a view, RMS.
    fn shown(&self, seen: &Sight, moved: &[f32]) -> f64 {
        let view = self.field.view(&seen.camera, CUTOFF, 1);
        let mut picture = vec![0.0; 3 * view.width() * view.height()];
        view.apply_lit(moved, &seen.light, &mut picture);
        let from = 3 * (view.width() / 2);
        let right: Vec<f32> = picture.chunks_exact(3 * view.width()).flat_map(|row| row[from..].to_vec()).collect();
        rms(&right, &vec![0.0; right.len()])
    }
}
