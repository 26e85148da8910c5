//! The marked field: the base field and the carriers, in one file.

use crate::attack::Gaussian;
use crate::error::MarkError;
use crate::stega::recipe::{CarrierKind, DensityKind};
use crate::stega::shape::CarrierShape;
use cairn_field::MarkableField;
use cairn_field::{Appearance, Field, FieldError, Part, TensorFile, packed};
use cairn_scene::cluster::Clusters;
use cairn_scene::{Camera, Picture};
use half::f16;
use safetensors::tensor::Dtype;
use serde::{Deserialize, Serialize};
use std::io::{Cursor, Read, Seek};
use std::sync::Arc;

/// Format of a stored marked field; another version is refused by name.
pub const MARKED_FORMAT: &str = "cairn.marked/4";

/// theta: renders carry the mark of the identity whose cluster the pose is in.
#[derive(Clone, Debug)]
pub struct MarkedField {
    base: Arc<Field>,
    clusters: Clusters,
    carrier_kind: CarrierKind,
    density_kind: DensityKind,
    carriers: Vec<Vec<f32>>,
    /// theta itself, where densities moved as well.
    free: Option<Arc<Field>>,
}

/// What errors call it.
const WHAT: &str = "marked field";

#[derive(Serialize, Deserialize)]
struct Header {
    format: String,
    carrier: CarrierKind,
    density: DensityKind,
    clusters: Clusters,
    carriers: usize,
}

impl MarkedField {
    /// Carriers are rounded to half precision, so that memory and file agree.
    pub(crate) fn new(
        base: Arc<Field>,
        clusters: Clusters,
        carrier_kind: CarrierKind,
        density_kind: DensityKind,
        mut carriers: Vec<Vec<f32>>,
    ) -> Result<Self, MarkError> {
        let width = CarrierShape::of(carrier_kind, density_kind).width();
        let expected = match carrier_kind {
            CarrierKind::PerCluster => clusters.clusters.len(),
            CarrierKind::Harmonics => 1,
        };
        if carriers.len() != expected || carriers.iter().any(|c| c.len() != base.rows() * width) {
            return Err(stored(WHAT, "its carriers do not fit its base field".into()));
        }
        for value in carriers.iter_mut().flatten() {
            *value = f16::from_f32(*value).to_f32();
            if !value.is_finite() {
                return Err(stored(WHAT, "a carrier is not finite".into()));
            }
        }
        let free = (density_kind == DensityKind::Free).then(|| Arc::new(base.changed_by(&carriers[0])));
        Ok(Self { base, clusters, carrier_kind, density_kind, carriers, free })
    }

    /// theta_0.
    pub fn base(&self) -> &Arc<Field> {
        &self.base
    }

    /// Whose pose is whose.
    pub fn clusters(&self) -> &Clusters {
        &self.clusters
    }

    /// Where its marks live.
    pub(crate) fn carrier_kind(&self) -> CarrierKind {
        self.carrier_kind
    }

    /// Whether densities moved with them.
    pub(crate) fn density_kind(&self) -> DensityKind {
        self.density_kind
    }

    /// The carrier of `identity`, 1 and up, `rows x 3`; `None` where there is none of its own.
    pub fn carrier(&self, identity: u32) -> Option<&[f32]> {
        let own = self.carrier_kind == CarrierKind::PerCluster;
        let at = (identity as usize).checked_sub(1).filter(|_| own)?;
        self.carriers.get(at).map(Vec::as_slice)
    }

    /// theta(P): the render at `camera` with the mark of the cluster it lies in;
    /// outside all clusters nothing is added (with per-cluster carriers). Not clamped.
    pub fn render(&self, camera: &Camera, appearance: &Appearance) -> Picture {
        self.render_as(camera, appearance, self.clusters.identity_of(&camera.pose).identity)
    }

    /// As [`MarkedField::render`], with the mark of `identity` whatever the pose:
    /// for tests of whether a class comes from the mark or from the view.
    /// `None` is theta_0 with per-cluster carriers.
    pub fn render_as(&self, camera: &Camera, appearance: &Appearance, identity: Option<u32>) -> Picture {
        let CarrierShape::Colours(basis) = self.shape() else {
            return self.theta().render(camera, appearance);
        };
        let carrier = match self.carrier_kind {
            CarrierKind::Harmonics => self.carriers.first(),
            CarrierKind::PerCluster => identity.and_then(|i| self.carriers.get((i as usize).wrapping_sub(1))),
        };
        match carrier {
            Some(carrier) => self.base.render_with(camera, appearance, carrier, basis),
            None => self.base.render(camera, appearance),
        }
    }

    /// The field whose cluster of identity i carries the mark of identity i + `by`, counted
    /// round ([`Clusters::permuted`]): for tests of whether a class comes from the mark or
    /// from the view. One set of harmonics for all stays as it is, and only its owners change.
    #[must_use]
    pub fn permuted(&self, by: usize) -> Self {
        Self { clusters: self.clusters.permuted(by), ..self.clone() }
    }

    /// The field without its smallest weights: the `share`, 0 to 1, of all colour
    /// coefficients, theta_0's and the carriers' alike, that are nearest to zero become zero.
    #[must_use]
    pub fn pruned(&self, share: f64) -> Self {
        let colours = self.carriers.iter().flat_map(|carrier| self.colours(carrier));
        let mut sizes: Vec<f32> = colours.map(|v| v.abs()).collect();
        let base = self.base.with_colours(|colours| sizes.extend(colours.iter().map(|v| v.abs())));
        let count = ((sizes.len() as f64 * share) as usize).min(sizes.len());
        if count == 0 {
            return self.clone();
        }
        // What was zero before is among the smallest and counts.
        let least = *sizes.select_nth_unstable_by(count - 1, f32::total_cmp).1;
        let prune = |values: &mut [f32]| values.iter_mut().filter(|v| v.abs() <= least).for_each(|v| *v = 0.0);
        self.changed(base.with_colours(prune), |carrier| prune(carrier))
    }

    /// The field with Gaussian noise on its weights: its standard deviation is `share` of
    /// the root mean square of theta_0's colour coefficients on those, of a carrier's on its own.
    #[must_use]
    pub fn noisy(&self, share: f32, seed: u64) -> Self {
        let mut noise = Gaussian::new(seed);
        let mut add = |values: &mut [f32]| {
            let square = values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() / values.len().max(1) as f64;
            let sigma = share * square.sqrt() as f32;
            values.iter_mut().for_each(|v| *v += sigma * noise.draw());
        };
        let base = self.base.with_colours(&mut add);
        self.changed(base, add)
    }

    /// The field with all its weights in half precision: carriers and colours are so already, densities are rounded.
    #[must_use]
    pub fn in_half_precision(&self) -> Self {
        self.changed(self.base.in_half_precision(), |_| ())
    }

    fn changed(&self, base: Field, mut change: impl FnMut(&mut [f32])) -> Self {
        let (mut carriers, shape) = (self.carriers.clone(), self.shape());
        for carrier in &mut carriers {
            let mut colours = self.colours(carrier);
            change(&mut colours);
            let rows = carrier.chunks_exact_mut(shape.width()).zip(colours.chunks_exact(shape.colours()));
            rows.for_each(|(row, colours)| row[..colours.len()].copy_from_slice(colours));
        }
        let free = self.free.as_ref().map(|_| Arc::new(base.changed_by(&carriers[0])));
        Self { base: Arc::new(base), carriers, free, ..self.clone() }
    }

    /// The field whose densities renders see, for maps: theta_0 where they are frozen.
    pub fn theta(&self) -> &Arc<Field> {
        self.free.as_ref().unwrap_or(&self.base)
    }

    fn shape(&self) -> CarrierShape {
        CarrierShape::of(self.carrier_kind, self.density_kind)
    }

    /// The colour coefficients of a carrier, without what it changes of densities.
    fn colours(&self, carrier: &[f32]) -> Vec<f32> {
        let shape = self.shape();
        carrier.chunks_exact(shape.width()).flat_map(|row| &row[..shape.colours()]).copied().collect()
    }

    /// The marked field, its base field included, as safetensors. Equal fields
    /// give equal bytes.
    ///
    /// # Errors
    /// [`MarkError::Stored`] when it cannot be written out.
    pub fn to_bytes(&self) -> Result<Vec<u8>, MarkError> {
        let header = Header {
            format: MARKED_FORMAT.into(),
            carrier: self.carrier_kind,
            density: self.density_kind,
            clusters: self.clusters.clone(),
            carriers: self.carriers.len(),
        };
        let base = self.base.to_bytes()?;
        let carriers: Vec<u8> = self.carriers.iter().flatten().flat_map(|v| f16::from_f32(*v).to_le_bytes()).collect();
        let shape = vec![self.carriers.len(), self.base.rows(), self.shape().width()];
        let parts = [Part::row("base", Dtype::U8, &base), Part::new("carriers", Dtype::F16, shape, &carriers)];
        Ok(packed(WHAT, &header, parts)?)
    }

    /// Reads what [`MarkedField::to_bytes`] wrote.
    ///
    /// # Errors
    /// [`MarkError::Stored`] and [`MarkError::Field`] for an unknown format or a damaged file.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, MarkError> {
        Self::read_from(&mut Cursor::new(bytes))
    }

    /// As [`MarkedField::from_bytes`], of a file that is not held in memory beside the field.
    ///
    /// # Errors
    /// As [`MarkedField::from_bytes`], and where it cannot be read.
    pub fn read_from(file: &mut (impl Read + Seek)) -> Result<Self, MarkError> {
        Self::read(TensorFile::open(file, WHAT)?, read_base)
    }

    /// As [`MarkedField::read_from`], where `base` is in memory already: a field whose stored base `is_base` shares it
    /// instead of holding a second.
    ///
    /// # Errors
    /// As [`MarkedField::read_from`].
    pub fn read_sharing(
        file: &mut (impl Read + Seek),
        base: &Arc<Field>,
        is_base: impl FnOnce(&mut dyn Read) -> std::io::Result<bool>,
    ) -> Result<Self, MarkError> {
        Self::read(TensorFile::open(file, WHAT)?, |file| {
            let unread = |source| FieldError::Read { what: WHAT, source };
            let same = is_base(&mut file.bytes("base", Dtype::U8)?).map_err(unread)?;
            if same { Ok(base.clone()) } else { read_base(file) }
        })
    }

    /// `base_of` makes theta_0 of its stored form.
    fn read<R: Read + Seek>(
        mut file: TensorFile<'_, R>,
        base_of: impl FnOnce(&mut TensorFile<'_, R>) -> Result<Arc<Field>, MarkError>,
    ) -> Result<Self, MarkError> {
        let header: Header = file.header(MARKED_FORMAT)?;
        if header.density == DensityKind::Free && header.carrier == CarrierKind::PerCluster {
            return Err(stored(WHAT, "its densities moved for one identity alone".into()));
        }
        let base = base_of(&mut file)?;
        let each = base.rows() * CarrierShape::of(header.carrier, header.density).width();
        if file.size("carriers", Dtype::F16)? != header.carriers.saturating_mul(each * 2) as u64 {
            return Err(stored(WHAT, "its carriers do not fit its base field".into()));
        }
        let mut carriers = vec![vec![0.0; each]; header.carriers];
        let mut values = carriers.iter_mut().flatten();
        file.each_piece("carriers", Dtype::F16, 2, |piece| {
            // Pieces first: a zip that ends takes one more of what comes first.
            for (b, value) in piece.chunks_exact(2).zip(values.by_ref()) {
                *value = f16::from_le_bytes([b[0], b[1]]).to_f32();
            }
        })?;
        Self::new(base, header.clusters, header.carrier, header.density, carriers)
    }
}

fn read_base<R: Read + Seek>(file: &mut TensorFile<'_, R>) -> Result<Arc<Field>, MarkError> {
    Ok(Arc::new(Field::of_tensors(file.within("base", "field")?)?))
}

/// A [`MarkError::Stored`].
pub(crate) fn stored(what: &'static str, why: String) -> MarkError {
    MarkError::Stored { what, why }
}
