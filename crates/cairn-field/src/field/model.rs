//! A trained base field: what it renders, and how it is stored.

use crate::appearance::code::{Appearance, FEATURES, features};
use crate::appearance::prior::Prior;
use crate::error::FieldError;
use crate::grid::lattice::{Grid, ROW, fits};
use crate::grid::sh::{SH, SH_DC};
use crate::io::tensors::{Part, TensorFile, packed, stored};
use crate::rays::frame::SceneFrame;
use crate::rays::lens::{Eye, Lens};
use crate::rays::march::empty_density;
use crate::render::composite::{Gathered, Thresholds};
use crate::render::picture::{Seen, Tiling};
use cairn_scene::{Camera, Picture};
use glam::DVec3;
use half::f16;
use rayon::prelude::*;
use safetensors::tensor::Dtype;
use serde::{Deserialize, Serialize};
use std::io::{Cursor, Read, Seek};

/// Format of a stored field; another number is refused by name.
pub const FIELD_FORMAT: &str = "cairn.field/3";
/// Bytes of a stored row of colours: 9 coefficients x 3 channels in half precision.
const STORED_ROW: usize = 3 * SH * 2;

/// Numbers a row of a field's change takes: 27 colour coefficients, channel-major as
/// [`super::basis::CarrierBasis::Harmonics`] has them, and the raw density.
pub const CHANGE: usize = 3 * SH + 1;

/// A radiance field after stage 1 (theta_0). Immutable.
#[derive(Clone, Debug)]
pub struct Field {
    pub(crate) frame: SceneFrame,
    pub(crate) grid: Grid<f32>,
    pub(crate) canonical: Appearance,
    pub(crate) appearances: Vec<(String, Appearance)>,
}

/// A render with what lies behind the colours.
#[derive(Clone, Debug)]
pub struct Rendering {
    /// Colours, not clamped.
    pub picture: Picture,
    /// Share of light stopped by the field, a pixel each, [0, 1].
    pub accumulation: Vec<f32>,
    /// Mean distance travelled in unit-cube lengths, a pixel each.
    pub depth: Vec<f32>,
}

#[derive(Serialize, Deserialize)]
struct Header {
    format: String,
    frame: SceneFrame,
    dims: [usize; 3],
    canonical: Appearance,
    appearances: Vec<(String, Appearance)>,
}

impl Field {
    /// Takes a trained grid, as it is.
    pub(crate) fn new(
        frame: SceneFrame,
        mut grid: Grid<f32>,
        canonical: Appearance,
        appearances: Vec<(String, Appearance)>,
    ) -> Self {
        for row in grid.colour.chunks_exact_mut(ROW) {
            row[ROW - 1] = 0.0;
        }
        grid.refresh_occupancy(empty_density(grid.dims));
        Self { frame, grid, canonical, appearances }
    }

    /// The field with its colours rounded to half precision, as files hold them ([`Field::to_bytes`]): the
    /// one in memory and the one that is read back are then the same.
    #[must_use]
    pub fn with_stored_colours(mut self) -> Self {
        self.grid.colour.par_iter_mut().for_each(|v| *v = f16::from_f32(*v).to_f32());
        self
    }

    /// The field with its colour coefficients changed, `rows x 27` of them, red's first in
    /// each row; the first row is nobody's and stays zero. For trying what a field bears.
    ///
    /// # Panics
    /// When a coefficient is not finite afterwards.
    #[must_use]
    pub fn with_colours(&self, change: impl FnOnce(&mut [f32])) -> Self {
        let mut field = self.clone();
        change(&mut field.grid.colour[ROW..]);
        assert!(field.grid.colour.iter().all(|v| v.is_finite()), "colours are finite");
        field
    }

    /// The field with each row's colour changed by `colours` (`rows x 3`, RGB as stored), the same from everywhere.
    ///
    /// # Panics
    /// When `colours` is of another size, or a colour is not finite afterwards.
    #[must_use]
    pub fn with_colours_added(&self, colours: &[f32]) -> Self {
        assert_eq!(colours.len(), self.grid.rows() * 3, "a colour for each row");
        let mut field = self.clone();
        let rows = field.grid.colour.par_chunks_exact_mut(ROW).zip(colours.par_chunks_exact(3)).skip(1);
        rows.for_each(|(row, change)| {
            row[..3].iter_mut().zip(change).for_each(|(v, change)| *v += change / SH_DC as f32);
            assert!(row[..3].iter().all(|v| v.is_finite()), "colours are finite");
        });
        field
    }

    /// How far apart the image of `camera` has the vertex of `row` and the next on the lattice, px: the median of the three
    /// axes. `None` where the camera stands in it, or it lies at infinity.
    pub fn spacing_px(&self, row: usize, camera: &Camera) -> Option<f64> {
        let [nx, ny, nz] = self.grid.dims;
        let v = self.grid.vertex[row] as usize;
        let at = [v % nx, v / nx % ny, v / (nx * ny)];
        let place = |at: [usize; 3]| {
            let unit = DVec3::from_array([0, 1, 2].map(|k| at[k] as f64 / ([nx, ny, nz][k] - 1) as f64));
            self.frame.place(unit)
        };
        let eye = self.frame.place_of(camera.pose.position);
        let way = |[x, y, z, w]: [f64; 4]| (DVec3::new(x, y, z) - DVec3::new(eye[0], eye[1], eye[2]) * w).normalize();
        let here = way(place(at));
        let angle = |k: usize| {
            let mut next = at;
            next[k] = if at[k] + 1 < [nx, ny, nz][k] { at[k] + 1 } else { at[k] - 1 };
            here.angle_between(way(place(next)))
        };
        let mut angles = [angle(0), angle(1), angle(2)];
        angles.sort_by(f64::total_cmp);
        let px = angles[1] * camera.intrinsics.fx;
        px.is_finite().then_some(px)
    }

    /// The field with its raw densities rounded to half precision too, as its colours are already: what
    /// storing all of it so would do to pictures.
    #[must_use]
    pub fn in_half_precision(&self) -> Self {
        let mut field = self.clone();
        let max = f16::MAX.to_f32();
        // Occupancy stays: what was empty was so at a density far below a rounding.
        field.grid.raw.par_iter_mut().for_each(|v| *v = f16::from_f32(v.clamp(-max, max)).to_f32());
        field
    }

    /// theta = theta_0 + `change` (`rows x` [`CHANGE`]): colour coefficients and raw densities
    /// are added, and what rays may pass stays as it is, so that nothing appears in empty space.
    ///
    /// # Panics
    /// When `change` is not of this field's size.
    #[must_use]
    pub fn changed_by(&self, change: &[f32]) -> Self {
        assert_eq!(change.len(), self.grid.rows() * CHANGE, "a change of this field's size");
        let mut field = self.clone();
        let grid = &mut field.grid;
        for (row, change) in change.chunks_exact(CHANGE).enumerate().skip(1) {
            let colour = &mut grid.colour[row * ROW..(row + 1) * ROW];
            for (i, v) in change[..3 * SH].iter().enumerate() {
                colour[i % SH * 3 + i / SH] += v;
            }
            grid.raw[grid.vertex[row] as usize] += change[3 * SH];
        }
        field
    }

    /// The frame of the scene.
    pub fn frame(&self) -> &SceneFrame {
        &self.frame
    }

    /// The grid, for those who go through it themselves.
    pub fn grid(&self) -> &Grid<f32> {
        &self.grid
    }

    /// The appearance used where none is asked for: the mean of the views'.
    pub fn canonical_appearance(&self) -> &Appearance {
        &self.canonical
    }

    /// The appearance of training view `name`; the canonical one where the
    /// scene has none of its own.
    pub fn appearance_of(&self, name: &str) -> &Appearance {
        self.appearances.iter().find(|(n, _)| n == name).map_or(&self.canonical, |(_, a)| a)
    }

    /// Names and appearances of the training views; empty where the scene needs none.
    pub fn appearances(&self) -> &[(String, Appearance)] {
        &self.appearances
    }

    /// Each row's colour the same from everywhere, RGB as stored, before any light: the constant part of its harmonics.
    pub fn constant_colours(&self) -> Vec<[f32; 3]> {
        self.grid.colour.chunks_exact(ROW).map(|row| [0, 1, 2].map(|c| row[c] * SH_DC as f32)).collect()
    }

    /// What every pixel of `camera` gathers, row-major, with the spherical harmonics of its direction.
    pub fn gather_view(&self, camera: &Camera, limits: Thresholds) -> Vec<(Gathered<f32>, [f32; SH])> {
        self.each_pixel(camera, limits, |seen| (seen.gathered, seen.harmonics))
    }

    /// The features of every pixel of the eye, row-major.
    pub fn features_of(&self, eye: Eye<'_>) -> Vec<[f32; FEATURES]> {
        let tiling = Tiling::of(&self.grid, &self.frame, eye, Thresholds::SHOWN, 1);
        tiling.gather(|out, seen| *out = features(&seen.gathered, &seen.harmonics), |_| {})
    }

    /// What `pixel` makes of every pixel of `camera`, row-major.
    pub(super) fn each_pixel<O: Clone + Default + Send>(
        &self,
        camera: &Camera,
        limits: Thresholds,
        pixel: impl Fn(&Seen<'_>) -> O + Sync,
    ) -> Vec<O> {
        let lens = Lens::new(camera);
        let tiling = Tiling::of(&self.grid, &self.frame, Eye { camera, lens: &lens }, limits, 1);
        tiling.gather(|out, seen| *out = pixel(seen), |_| {})
    }

    /// Renders `camera` as `appearance` has it; colours are not clamped.
    pub fn render(&self, camera: &Camera, appearance: &Appearance) -> Picture {
        self.render_within(camera, appearance, Thresholds::SHOWN)
    }

    /// As [`Field::render`], leaving out what `limits` says.
    pub fn render_within(&self, camera: &Camera, appearance: &Appearance, limits: Thresholds) -> Picture {
        let shade = |seen: &Seen<'_>| appearance.shade(&features(&seen.gathered, &seen.harmonics));
        picture(camera, self.each_pixel(camera, limits, shade).into_flattened())
    }

    /// As [`Field::render`], with accumulation and depth.
    pub fn render_maps(&self, camera: &Camera, appearance: &Appearance) -> Rendering {
        let gathered = self.gather_view(camera, Thresholds::SHOWN);
        let rgb = gathered.iter().flat_map(|(g, basis)| appearance.shade(&features(g, basis))).collect();
        Rendering {
            picture: picture(camera, rgb),
            accumulation: gathered.iter().map(|(g, _)| 1.0 - g.end).collect(),
            depth: gathered.iter().map(|(g, _)| g.along / (1.0 - g.end).max(1e-6)).collect(),
        }
    }

    /// Fits an appearance to `photograph`: the likeliest one, where the training views'
    /// appearances say what is likely. The field is not changed.
    ///
    /// # Errors
    /// [`FieldError::Views`] when the photograph's size is not the camera's, or a number of it
    /// is not finite; [`FieldError::Stored`] when the training views' appearances are such as
    /// no photograph has.
    pub fn fit_appearance(&self, camera: &Camera, photograph: &Picture) -> Result<Appearance, FieldError> {
        self.fit_columns(camera, photograph, camera.intrinsics.width)
    }

    /// As [`Field::fit_appearance`], to the left half of `photograph` (the NeRF-W
    /// protocol: the right half is then fair to score).
    ///
    /// # Errors
    /// As [`Field::fit_appearance`].
    pub fn fit_appearance_left_half(&self, camera: &Camera, photograph: &Picture) -> Result<Appearance, FieldError> {
        self.fit_columns(camera, photograph, camera.intrinsics.width / 2)
    }

    /// Fits an appearance to the first `columns` of `photograph`.
    fn fit_columns(&self, camera: &Camera, photograph: &Picture, columns: usize) -> Result<Appearance, FieldError> {
        let (w, h) = (camera.intrinsics.width, camera.intrinsics.height);
        if (w, h) != (photograph.width(), photograph.height()) {
            return Err(FieldError::Views(format!(
                "a photograph of {} x {} px for a camera of {w} x {h}; resize one to the other",
                photograph.width(),
                photograph.height()
            )));
        }
        let seen: Vec<&Appearance> = self.appearances.iter().map(|(_, code)| code).collect();
        let prior = if seen.is_empty() {
            Prior::around(self.canonical.clone())
        } else {
            Prior::of(&seen).ok_or_else(|| stored("field", "its appearances are beyond all bounds".into()))?
        };
        let pixels: Vec<[f32; 3]> = (0..w * h).map(|at| photograph.pixel(at % w, at / w)).collect();
        let pixels = left(pixels, w, columns);
        let of = |seen: &Seen<'_>| features(&seen.gathered, &seen.harmonics);
        let shown = left(self.each_pixel(camera, Thresholds::SHOWN, of), w, columns);
        prior.fit(&shown, &pixels).ok_or_else(|| {
            let why = "it has a number that is not finite, or is lit beyond all bounds; import or save it again";
            FieldError::Views(format!("no light explains the photograph: {why}"))
        })
    }

    /// The field as safetensors with a versioned header: rows' vertices, raw densities,
    /// colour coefficients in half precision, and which cells may hold anything (a bit
    /// each in blocks of 4 x 4 x 4). Equal fields give
    /// equal bytes.
    ///
    /// # Errors
    /// [`FieldError::Stored`] when it cannot be written out.
    pub fn to_bytes(&self) -> Result<Vec<u8>, FieldError> {
        let header = Header {
            format: FIELD_FORMAT.into(),
            frame: self.frame.clone(),
            dims: self.grid.dims,
            canonical: self.canonical.clone(),
            appearances: self.appearances.clone(),
        };
        let rows = self.grid.rows() - 1;
        let vertex: Vec<u8> = self.grid.vertex[1..].iter().flat_map(|v| v.to_le_bytes()).collect();
        let raw: Vec<u8> = self.grid.raw_rows().flat_map(f32::to_le_bytes).collect();
        let colour: Vec<u8> = self.grid.colour[ROW..]
            .chunks_exact(ROW)
            .flat_map(|row| row[..3 * SH].iter().flat_map(|v| f16::from_f32(*v).to_le_bytes()))
            .collect();
        let cells: Vec<u8> = self.grid.occupancy.allowed().iter().flat_map(|v| v.to_le_bytes()).collect();
        let parts = [
            Part::row("cells", Dtype::U64, &cells),
            Part::new("colour", Dtype::F16, vec![rows, SH, 3], &colour),
            Part::row("density", Dtype::F32, &raw),
            Part::row("vertex", Dtype::U32, &vertex),
        ];
        packed("field", &header, parts)
    }

    /// Reads what [`Field::to_bytes`] wrote.
    ///
    /// # Errors
    /// [`FieldError::Stored`] for an unknown format, a damaged file or numbers that are not finite.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, FieldError> {
        Self::read_from(&mut Cursor::new(bytes))
    }

    /// As [`Field::from_bytes`], of a file that is not held in memory beside the field.
    ///
    /// # Errors
    /// As [`Field::from_bytes`], and where it cannot be read.
    pub fn read_from(file: &mut (impl Read + Seek)) -> Result<Self, FieldError> {
        Self::of_tensors(TensorFile::open(file, "field")?)
    }

    /// As [`Field::read_from`], of a file that was opened, or lies within another.
    ///
    /// # Errors
    /// As [`Field::read_from`].
    pub fn of_tensors<R: Read + Seek>(mut file: TensorFile<'_, R>) -> Result<Self, FieldError> {
        let header: Header = file.header(FIELD_FORMAT)?;
        let grid = read_grid(&mut file, header.dims)?;
        Ok(Self::new(header.frame, grid, header.canonical, header.appearances))
    }
}

/// The grid of a stored field.
fn read_grid<R: Read + Seek>(file: &mut TensorFile<'_, R>, dims: [usize; 3]) -> Result<Grid<f32>, FieldError> {
    let vertex = file.numbers("vertex", Dtype::U32, u32::from_le_bytes)?;
    if !fits(dims, &vertex) {
        return Err(stored("field", "its grid and its vertices do not fit together".into()));
    }
    let (of_densities, of_colours) = (file.size("density", Dtype::F32)?, file.size("colour", Dtype::F16)?);
    let rows = vertex.len() as u64;
    if of_densities != rows * 4 || of_colours != rows * STORED_ROW as u64 {
        return Err(stored("field", "its tensors are of different lengths".into()));
    }
    let mut grid = Grid::with_vertices(dims, vertex);
    // Gone again before the colours, which are most of a field.
    grid.set_raw_rows(&file.numbers("density", Dtype::F32, f32::from_le_bytes)?);
    let mut rows = grid.colour[ROW..].chunks_exact_mut(ROW);
    file.each_piece("colour", Dtype::F16, STORED_ROW, |piece| {
        // Pieces first: a zip that ends takes one more of what comes first.
        for (bytes, row) in piece.chunks_exact(STORED_ROW).zip(rows.by_ref()) {
            for (v, b) in row.iter_mut().zip(bytes.chunks_exact(2)) {
                *v = f16::from_le_bytes([b[0], b[1]]).to_f32();
            }
        }
    })?;
    let cells = file.numbers("cells", Dtype::U64, u64::from_le_bytes)?;
    if !grid.occupancy.allow_only(&cells) {
        return Err(stored("field", "its cells do not fit its grid".into()));
    }
    if !(grid.raw.iter().all(|v| v.is_finite()) && grid.colour.iter().all(|v| v.is_finite())) {
        return Err(stored("field", "it holds numbers that are not finite".into()));
    }
    Ok(grid)
}

/// The first `columns` of rows of `width`.
fn left<P: Copy>(all: Vec<P>, width: usize, columns: usize) -> Vec<P> {
    if columns == width {
        return all;
    }
    all.chunks_exact(width).flat_map(|row| &row[..columns]).copied().collect()
}

/// `camera`'s picture of these colours.
pub(super) fn picture(camera: &Camera, rgb: Vec<f32>) -> Picture {
    Picture::new(camera.intrinsics.width, camera.intrinsics.height, rgb).expect("one colour a pixel")
}
