//! Seeded, ordered parameters.
//!
//! candle's `VarMap` iterates in random order and its CPU generator cannot be
//! seeded. Here every tensor draws from a stream of its own, derived from the
//! seed and the tensor's name: adding a layer changes no other layer's start,
//! and iteration is by name.

use std::collections::{BTreeMap, HashMap};

use candle_core::{Device, Tensor, Var};
use rand_chacha::ChaCha12Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};
use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::error::{NnError, Result};
use crate::raw::with_floats;

const FILE: FileKind = FileKind { what: "parameters", format: "cairn-nn parameters", version: 1 };
/// The one metadata key: with a single key the header's bytes cannot depend on
/// a hash map's order.
pub(crate) const METADATA_KEY: &str = "cairn";

/// How a new parameter starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Init {
    /// Every number the same.
    Constant(f32),
    /// He et al. 2015 (arXiv 1502.01852), uniform: in +-sqrt(6 / fan_in), which
    /// keeps the variance through a rectifier.
    He {
        /// Inputs that each output sums over.
        fan_in: usize,
    },
    /// Uniform in +-bound.
    Uniform(f32),
}

/// Named parameters in name order.
#[derive(Debug)]
pub struct Params {
    seed: u64,
    vars: BTreeMap<String, Var>,
    /// Of tensors with an entry a class: along which axis, and where class 0 stands
    /// there; -1 where it has none.
    class_axes: BTreeMap<String, (usize, isize)>,
}

#[derive(Serialize, Deserialize)]
struct Header {
    seed: u64,
}

impl Params {
    /// No parameters yet; those made later start from `seed` and their names.
    pub fn new(seed: u64) -> Self {
        Self { seed, vars: BTreeMap::new(), class_axes: BTreeMap::new() }
    }

    /// A place to make or find parameters whose names start with `prefix.`.
    pub fn scope(&mut self, prefix: &str) -> Scope<'_> {
        Scope { params: self, prefix: prefix.to_owned() }
    }

    /// The seed.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// The parameter called `name`.
    pub fn get(&self, name: &str) -> Option<&Var> {
        self.vars.get(name)
    }

    /// All parameters in name order.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Var)> {
        self.vars.iter().map(|(name, var)| (name.as_str(), var))
    }

    /// Tensors.
    pub fn len(&self) -> usize {
        self.vars.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.vars.is_empty()
    }

    /// Numbers in all tensors together.
    pub fn numbers(&self) -> usize {
        self.vars.values().map(|v| v.elem_count()).sum()
    }

    /// All parameters as safetensors (f32), with format, version and seed in
    /// the header. The same parameters give the same bytes.
    ///
    /// # Errors
    /// [`NnError::Tensor`] if a tensor cannot be read.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        let tensors = self
            .vars
            .iter()
            .map(|(name, var)| Ok((name.clone(), (var.dims().to_vec(), values(var)?))))
            .collect::<Result<BTreeMap<_, _>>>()?;
        pack(&FILE, &Header { seed: self.seed }, &tensors)
    }

    /// Parameters from [`Self::to_bytes`]; networks built on them find theirs by name.
    ///
    /// # Errors
    /// [`NnError::Container`] or [`NnError::Format`] when the bytes are not such a file,
    /// or hold a number that is not finite.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let (header, tensors): (Header, _) = unpack(&FILE, bytes)?;
        let vars = tensors
            .into_iter()
            .map(|(name, (shape, data))| Ok((name, Var::from_vec(data, shape, &Device::Cpu)?)))
            .collect::<Result<_>>()?;
        Ok(Self { seed: header.seed, vars, class_axes: BTreeMap::new() })
    }

    /// Overwrites the present parameters, which networks go on using, with
    /// those of [`Self::to_bytes`]. All or nothing.
    ///
    /// # Errors
    /// As [`Self::from_bytes`], and when names or shapes differ.
    pub fn load(&mut self, bytes: &[u8]) -> Result<()> {
        let other = Self::from_bytes(bytes)?;
        for (name, var) in &self.vars {
            let what = "missing in what is loaded";
            let from = other.vars.get(name).ok_or(NnError::ParameterName { name: name.clone(), what })?;
            check_shape(name, var.dims(), from)?;
        }
        if let Some(name) = other.vars.keys().find(|name| !self.vars.contains_key(*name)) {
            let what = "in what is loaded but not used here";
            return Err(NnError::ParameterName { name: name.clone(), what });
        }
        for (name, var) in &self.vars {
            var.set(&other.vars[name])?;
        }
        self.seed = other.seed;
        Ok(())
    }

    /// Takes over what `from` has learnt, for networks of the same make but other classes:
    /// `class_of[k]` is the class of `from` that class `k` here goes on from, if any. A
    /// class without one keeps its start, and so does a tensor that `from` has not, or has
    /// in another size. The names of the latter are returned.
    ///
    /// # Errors
    /// [`NnError::ParameterShape`] where `class_of` names a class that `from` has not;
    /// parameters before it in order of name are then taken over already.
    pub fn graft(&mut self, from: &Self, class_of: &[Option<usize>]) -> Result<Vec<String>> {
        let mut fresh = Vec::new();
        for (name, var) in &self.vars {
            let axis = self.class_axes.get(name).copied();
            match from.vars.get(name) {
                Some(old) if fits(var, old, axis.map(|(axis, _)| axis)) => match axis {
                    None => var.set(old)?,
                    Some((axis, first)) => var.set(&grafted(name, var, old, axis, first, class_of)?)?,
                },
                _ => fresh.push(name.clone()),
            }
        }
        Ok(fresh)
    }

    fn make(&mut self, name: String, shape: &[usize], init: Init) -> Result<Tensor> {
        if let Some(var) = self.vars.get(&name) {
            check_shape(&name, shape, var)?;
            return Ok(var.as_tensor().clone());
        }
        let count = shape.iter().product();
        let data = match init {
            Init::Constant(v) => vec![v; count],
            Init::He { fan_in } => uniform(self.seed, &name, (6.0 / fan_in.max(1) as f32).sqrt(), count),
            Init::Uniform(bound) => uniform(self.seed, &name, bound, count),
        };
        let var = Var::from_vec(data, shape, &Device::Cpu)?;
        let tensor = var.as_tensor().clone();
        self.vars.insert(name, var);
        Ok(tensor)
    }
}

/// A part of [`Params`] under a common name.
#[derive(Debug)]
pub struct Scope<'a> {
    params: &'a mut Params,
    prefix: String,
}

impl Scope<'_> {
    /// The scope `prefix.name`.
    pub fn sub(&mut self, name: &str) -> Scope<'_> {
        Scope { prefix: format!("{}.{name}", self.prefix), params: self.params }
    }

    /// The parameter `prefix.name`: the present one, or a new one of `shape`
    /// started by `init`. The tensor is the variable itself: gradients are found
    /// by it, and updates show in it.
    ///
    /// # Errors
    /// [`NnError::ParameterShape`] when it exists with another shape.
    pub fn get(&mut self, name: &str, shape: &[usize], init: Init) -> Result<Tensor> {
        self.params.make(format!("{}.{name}", self.prefix), shape, init)
    }

    /// Says that the parameter `prefix.name` has an entry a class along `axis`, class 0's
    /// at `first` (-1 where class 0 has none); what is left of it stands for no class.
    /// [`Params::graft`] goes by it.
    pub fn by_class(&mut self, name: &str, axis: usize, first: isize) {
        self.params.class_axes.insert(format!("{}.{name}", self.prefix), (axis, first));
    }
}

/// Whether `old` has `new`'s shape but for `axis`.
fn fits(new: &Tensor, old: &Tensor, axis: Option<usize>) -> bool {
    let (a, b) = (new.dims(), old.dims());
    a.len() == b.len() && (0..a.len()).all(|i| a[i] == b[i] || Some(i) == axis)
}

/// `new` with the entries of `old` along an axis: those of no class, and those of classes that go on.
fn grafted(name: &str, new: &Var, old: &Var, axis: usize, first: isize, class_of: &[Option<usize>]) -> Result<Tensor> {
    let mut slices = Vec::with_capacity(new.dim(axis)?);
    for at in 0..new.dim(axis)? {
        let from = match usize::try_from(at as isize - first) {
            // Before the classes.
            Err(_) => Some(at),
            Ok(class) => class_of.get(class).copied().flatten().map(|of| (of as isize + first) as usize),
        };
        slices.push(match from {
            Some(from) if from < old.dim(axis)? => old.narrow(axis, from, 1)?,
            Some(_) => {
                let (expected, got) = (new.dims().to_vec(), old.dims().to_vec());
                return Err(NnError::ParameterShape { name: name.to_owned(), expected, got });
            }
            None => new.narrow(axis, at, 1)?,
        });
    }
    Ok(Tensor::cat(&slices, axis)?.contiguous()?)
}

/// `count` numbers in +-bound from the stream that belongs to `name`.
fn uniform(seed: u64, name: &str, bound: f32, count: usize) -> Vec<f32> {
    let key = Sha256::new().chain_update(b"cairn-nn parameter\0").chain_update(seed.to_le_bytes()).chain_update(name);
    let mut rng = ChaCha12Rng::from_seed(key.finalize().into());
    // 24 bits, so that every draw is exact in f32 and the bytes are the same everywhere.
    let unit = |bits: u32| (bits >> 8) as f32 * (1.0 / 8_388_608.0) - 1.0;
    (0..count).map(|_| unit(rng.next_u32()) * bound).collect()
}

fn check_shape(name: &str, expected: &[usize], got: &Tensor) -> Result<()> {
    if got.dims() != expected {
        let (expected, got) = (expected.to_vec(), got.dims().to_vec());
        return Err(NnError::ParameterShape { name: name.to_owned(), expected, got });
    }
    Ok(())
}

/// The numbers of `t`.
pub(crate) fn values(t: &Tensor) -> Result<Vec<f32>> {
    Ok(with_floats("parameters", &t.contiguous()?, <[f32]>::to_vec)?)
}

/// Named tensors as read from a file: shape and numbers.
pub(crate) type Tensors = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

/// A kind of file of tensors: what errors call it, and its one format and version.
pub(crate) struct FileKind {
    pub(crate) what: &'static str,
    pub(crate) format: &'static str,
    pub(crate) version: u32,
}

/// The header of every kind of file, its own part beside format and version.
#[derive(Serialize, Deserialize)]
struct Head<H> {
    format: String,
    version: u32,
    #[serde(flatten)]
    own: H,
}

/// `header` and `tensors` as one safetensors file.
pub(crate) fn pack(kind: &FileKind, header: &impl Serialize, tensors: &Tensors) -> Result<Vec<u8>> {
    let what = kind.what;
    let container = |source| NnError::Container { what, source };
    let bytes: BTreeMap<&String, (&Vec<usize>, Vec<u8>)> = tensors
        .iter()
        .map(|(name, (shape, data))| (name, (shape, data.iter().flat_map(|v| v.to_le_bytes()).collect())))
        .collect();
    let views = bytes
        .iter()
        .map(|(name, (shape, data))| Ok((name.as_str(), TensorView::new(Dtype::F32, shape.to_vec(), data)?)))
        .collect::<std::result::Result<Vec<_>, _>>()
        .map_err(container)?;
    let header = Head { format: kind.format.into(), version: kind.version, own: header };
    let header = serde_json::to_string(&header).map_err(|e| NnError::Format {
        what,
        expected: "a header".into(),
        got: e.to_string(),
    })?;
    serialize(views, Some(HashMap::from([(METADATA_KEY.to_owned(), header)]))).map_err(container)
}

/// Header and tensors of [`pack`], every number finite; another format or version is refused by name.
pub(crate) fn unpack<H: DeserializeOwned>(kind: &FileKind, bytes: &[u8]) -> Result<(H, Tensors)> {
    let what = kind.what;
    let container = |source| NnError::Container { what, source };
    let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(container)?;
    let expected = || format!("safetensors with a `{METADATA_KEY}` header");
    let header = metadata.metadata().as_ref().and_then(|m| m.get(METADATA_KEY));
    let header = header.ok_or_else(|| NnError::Format { what, expected: expected(), got: "none".into() })?;
    let wrong = |e: serde_json::Error| NnError::Format { what, expected: expected(), got: e.to_string() };
    let Head { format, version, own: IgnoredAny } = serde_json::from_str(header).map_err(wrong)?;
    if format != kind.format || version != kind.version {
        let say = |format: &str, version: u32| format!("`{format}` version {version}");
        let (expected, got) = (say(kind.format, kind.version), say(&format, version));
        return Err(NnError::Format { what, expected, got });
    }
    let Head { own: header, .. } = serde_json::from_str(header).map_err(wrong)?;
    let mut tensors = Tensors::new();
    for (name, view) in SafeTensors::deserialize(bytes).map_err(container)?.iter() {
        if view.dtype() != Dtype::F32 {
            let got = format!("{:?} in `{name}`", view.dtype());
            return Err(NnError::Format { what, expected: "f32 tensors".into(), got });
        }
        let data: Vec<f32> =
            view.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        if let Some(at) = data.iter().position(|v| !v.is_finite()) {
            let got = format!("{} at entry {at} of `{name}`", data[at]);
            return Err(NnError::Format { what, expected: "finite numbers".into(), got });
        }
        tensors.insert(name.to_owned(), (view.shape().to_vec(), data));
    }
    Ok((header, tensors))
}
