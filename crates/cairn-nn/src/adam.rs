//! Adam (Kingma and Ba 2015, arXiv 1412.6980) over [`Params`].
//!
//! Own code because candle's keeps no order, cannot be saved, and takes a
//! gradient that is not finite into the parameters without a word.

use std::collections::BTreeMap;

use candle_core::backprop::GradStore;
use candle_core::{Device, Tensor, Var};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::error::{NnError, Result};
use crate::params::{FileKind, Params, Tensors, pack, unpack, values};

const FILE: FileKind = FileKind { what: "optimiser state", format: "cairn-nn adam", version: 1 };

/// A learning rate that falls exponentially: `initial * decay ^ steps done`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rate {
    /// Before the first step; at least 0.
    pub initial: f64,
    /// Factor a step, in (0, 1]; 1 for a constant rate.
    pub decay: f64,
}

impl Rate {
    /// The same rate always.
    pub fn constant(rate: f64) -> Self {
        Self { initial: rate, decay: 1.0 }
    }

    /// From `initial` to `end` (both above 0) within `steps` steps.
    pub fn falling(initial: f64, end: f64, steps: u64) -> Self {
        Self { initial, decay: (end / initial).powf(1.0 / steps.max(1) as f64) }
    }

    /// The rate after `steps` steps.
    pub fn at(&self, steps: u64) -> f64 {
        self.initial * self.decay.powf(steps as f64)
    }

    fn check(self) -> Result<Self> {
        let good = self.initial.is_finite() && self.initial >= 0.0 && self.decay > 0.0 && self.decay <= 1.0;
        let allowed = "an initial rate of at least 0 and a decay above 0 and at most 1";
        if good { Ok(self) } else { Err(NnError::Setting { key: "learning rate", got: format!("{self:?}"), allowed }) }
    }
}

/// Adam's other constants, in the paper's symbols.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AdamConfig {
    /// Decay of the mean of gradients, in [0, 1).
    pub beta1: f64,
    /// Decay of the mean of squared gradients, in [0, 1).
    pub beta2: f64,
    /// Added to the root of the latter, above 0.
    pub epsilon: f64,
}

impl Default for AdamConfig {
    fn default() -> Self {
        Self { beta1: 0.9, beta2: 0.999, epsilon: 1e-8 }
    }
}

/// The optimiser and its state.
#[derive(Clone, Debug)]
pub struct Adam {
    config: AdamConfig,
    rate: Rate,
    steps: u64,
    moments: BTreeMap<String, Moments>,
}

#[derive(Clone, Debug)]
struct Moments {
    /// Steps in which this parameter had a gradient.
    steps: u64,
    mean: Vec<f32>,
    square: Vec<f32>,
}

#[derive(Serialize, Deserialize)]
struct Header {
    steps: u64,
    parameter_steps: BTreeMap<String, u64>,
}

impl Adam {
    /// A fresh optimiser.
    ///
    /// # Errors
    /// [`NnError::Setting`] for numbers out of range.
    pub fn new(config: AdamConfig, rate: Rate) -> Result<Self> {
        let setting = |key, got: f64, allowed| Err(NnError::Setting { key, got: got.to_string(), allowed });
        for (key, beta) in [("beta1", config.beta1), ("beta2", config.beta2)] {
            if !(0.0..1.0).contains(&beta) {
                return setting(key, beta, "at least 0 and below 1");
            }
        }
        if !(config.epsilon > 0.0 && config.epsilon.is_finite()) {
            return setting("epsilon", config.epsilon, "above 0");
        }
        Ok(Self { config, rate: rate.check()?, steps: 0, moments: BTreeMap::new() })
    }

    /// Steps done.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// One step for every parameter that has a gradient in `grads`; those
    /// without keep their value and state.
    ///
    /// # Errors
    /// [`NnError::Gradient`] when a gradient is not finite or too large to be
    /// squared; then neither parameters nor state have changed.
    pub fn step(&mut self, params: &Params, grads: &GradStore) -> Result<()> {
        let mut found = Vec::new();
        for (name, var) in params.iter() {
            if let Some(grad) = grads.get(var.as_tensor()) {
                found.push((name, var, checked_gradient(name, var, grad)?));
            }
        }
        let rate = self.rate.at(self.steps);
        for (name, var, grad) in found {
            let moments = self.moments.entry(name.to_owned()).or_insert_with(|| Moments {
                steps: 0,
                mean: vec![0.0; grad.len()],
                square: vec![0.0; grad.len()],
            });
            moments.steps += 1;
            let mut data = values(var)?;
            moments.apply(&self.config, rate, &grad, &mut data);
            var.set(&Tensor::from_vec(data, var.shape(), &Device::Cpu)?)?;
        }
        self.steps += 1;
        Ok(())
    }

    /// The state as safetensors; rates and constants are the caller's
    /// configuration and not part of it. The same state gives the same bytes.
    ///
    /// # Errors
    /// [`NnError::Container`] when it cannot be written.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        let parameter_steps = self.moments.iter().map(|(name, m)| (name.clone(), m.steps)).collect();
        let header = Header { steps: self.steps, parameter_steps };
        let mut tensors = Tensors::new();
        for (name, m) in &self.moments {
            tensors.insert(format!("mean/{name}"), (vec![m.mean.len()], m.mean.clone()));
            tensors.insert(format!("square/{name}"), (vec![m.square.len()], m.square.clone()));
        }
        pack(&FILE, &header, &tensors)
    }

    /// Takes over the state of [`Self::to_bytes`] for `params`: training goes on
    /// to the same bytes as if it had not stopped. All or nothing.
    ///
    /// # Errors
    /// When the bytes are no such state or do not fit `params`.
    pub fn load(&mut self, params: &Params, bytes: &[u8]) -> Result<()> {
        let (header, mut tensors): (Header, Tensors) = unpack(&FILE, bytes)?;
        let mut moments = BTreeMap::new();
        for (name, steps) in header.parameter_steps {
            let what = "in the optimiser state but not among the parameters";
            let var = params.get(&name).ok_or(NnError::ParameterName { name: name.clone(), what })?;
            let mut take = |kind: &str| {
                let what = "without its moments in the optimiser state";
                let found = tensors.remove(&format!("{kind}/{name}"));
                let (shape, data) = found.ok_or(NnError::ParameterName { name: name.clone(), what })?;
                if data.len() != var.elem_count() {
                    let (name, expected) = (name.clone(), vec![var.elem_count()]);
                    return Err(NnError::ParameterShape { name, expected, got: shape });
                }
                Ok(data)
            };
            let entry = Moments { steps, mean: take("mean")?, square: take("square")? };
            moments.insert(name, entry);
        }
        self.steps = header.steps;
        self.moments = moments;
        Ok(())
    }
}

impl Moments {
    fn apply(&mut self, config: &AdamConfig, rate: f64, grad: &[f32], data: &mut [f32]) {
        const CHUNK: usize = 1 << 14;
        let (b1, b2) = (config.beta1 as f32, config.beta2 as f32);
        // Bias corrections folded into the rate and into epsilon (section 2 of the paper).
        let root = (1.0 - config.beta2.powf(self.steps as f64)).sqrt();
        let rate = (rate * root / (1.0 - config.beta1.powf(self.steps as f64))) as f32;
        let epsilon = (config.epsilon * root) as f32;
        let moments = self.mean.par_chunks_mut(CHUNK).zip(self.square.par_chunks_mut(CHUNK));
        data.par_chunks_mut(CHUNK).zip(grad.par_chunks(CHUNK)).zip(moments).for_each(
            |((data, grad), (mean, square))| {
                for (((p, &g), m), v) in data.iter_mut().zip(grad).zip(mean).zip(square) {
                    *m = b1 * *m + (1.0 - b1) * g;
                    *v = b2 * *v + (1.0 - b2) * g * g;
                    *p -= rate * *m / (v.sqrt() + epsilon);
                }
            },
        );
    }
}

fn checked_gradient(name: &str, var: &Var, grad: &Tensor) -> Result<Vec<f32>> {
    if grad.dims() != var.dims() {
        let (expected, got) = (var.dims().to_vec(), grad.dims().to_vec());
        return Err(NnError::ParameterShape { name: name.to_owned(), expected, got });
    }
    let grad = values(grad)?;
    match grad.iter().position(|g| !(g * g).is_finite()) {
        Some(entry) => Err(NnError::Gradient { name: name.to_owned(), entry, value: grad[entry] }),
        None => Ok(grad),
    }
}
