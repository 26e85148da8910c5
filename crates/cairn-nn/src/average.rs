//! A running mean of parameters over the steps of a training.
//!
//! Small batches and a high learning rate leave the last step's parameters somewhere about a
//! good place; their mean over the last steps is nearer to it, and what it answers changes
//! less from one judgement to the next (Polyak and Juditsky 1992, exponentially weighted).

use candle_core::{Device, Tensor};
use serde::{Deserialize, Serialize};

use crate::error::{NnError, Result};
use crate::params::{FileKind, Params, Tensors, pack, unpack, values};

const FILE: FileKind = FileKind { what: "average", format: "cairn-nn average", version: 1 };

/// The mean of [`Params`] over the steps so far, the latest counting most.
#[derive(Debug)]
pub struct Average {
    decay: f64,
    steps: u64,
    tensors: Tensors,
}

#[derive(Serialize, Deserialize)]
struct Header {
    steps: u64,
}

impl Average {
    /// That of no step yet: the parameters as they are. A step counts `decay` times what the
    /// next one does, 0 (the last one alone) to below 1.
    ///
    /// # Errors
    /// [`NnError::Tensor`] if a parameter cannot be read.
    pub fn new(params: &Params, decay: f64) -> Result<Self> {
        let read = |(name, var): (&str, &candle_core::Var)| Ok((name.to_owned(), (var.dims().to_vec(), values(var)?)));
        Ok(Self { decay, steps: 0, tensors: params.iter().map(read).collect::<Result<_>>()? })
    }

    /// Takes in the parameters after a step. Over the first steps fewer are averaged, so that
    /// the start is soon forgotten.
    ///
    /// # Errors
    /// [`NnError::ParameterName`] for other parameters than it was made of.
    pub fn take_in(&mut self, params: &Params) -> Result<()> {
        self.steps += 1;
        let steps = self.steps as f64;
        let share = (1.0 - self.decay.min(steps / (10.0 + steps))) as f32;
        for (name, var) in params.iter() {
            let (_, mean) = self.tensors.get_mut(name).ok_or_else(|| missing(name))?;
            mean.iter_mut().zip(values(var)?).for_each(|(mean, now)| *mean += share * (now - *mean));
        }
        Ok(())
    }

    /// Exchanges the mean and the parameters, which networks go on using; a second time takes them back.
    ///
    /// # Errors
    /// [`NnError::ParameterName`] for other parameters than it was made of.
    pub fn swap(&mut self, params: &Params) -> Result<()> {
        for (name, var) in params.iter() {
            let (shape, mean) = self.tensors.get_mut(name).ok_or_else(|| missing(name))?;
            let now = values(var)?;
            var.set(&Tensor::from_vec(std::mem::replace(mean, now), shape.as_slice(), &Device::Cpu)?)?;
        }
        Ok(())
    }

    /// The mean as safetensors (f32), with the count of steps in the header.
    ///
    /// # Errors
    /// [`NnError::Container`] when it cannot be written.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        pack(&FILE, &Header { steps: self.steps }, &self.tensors)
    }

    /// Takes up [`Self::to_bytes`] of the same parameters.
    ///
    /// # Errors
    /// [`NnError::Container`] or [`NnError::Format`] when the bytes are not such a file;
    /// [`NnError::ParameterName`], [`NnError::ParameterShape`] for other parameters.
    pub fn load(&mut self, bytes: &[u8]) -> Result<()> {
        let (header, tensors): (Header, Tensors) = unpack(&FILE, bytes)?;
        for (name, (shape, _)) in &self.tensors {
            let (got, _) = tensors.get(name).ok_or_else(|| missing(name))?;
            if got != shape {
                let (name, expected, got) = (name.clone(), shape.clone(), got.clone());
                return Err(NnError::ParameterShape { name, expected, got });
            }
        }
        if let Some(name) = tensors.keys().find(|name| !self.tensors.contains_key(*name)) {
            return Err(missing(name));
        }
        (self.steps, self.tensors) = (header.steps, tensors);
        Ok(())
    }
}

fn missing(name: &str) -> NnError {
    NnError::ParameterName { name: name.to_owned(), what: "in the parameters or in their mean, and not in both" }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::Init;

    fn set(params: &Params, to: f32) {
        let var = params.get("a.w").unwrap();
        var.set(&Tensor::full(to, var.dims(), &Device::Cpu).unwrap()).unwrap();
    }

    fn get(params: &Params) -> f32 {
        values(params.get("a.w").unwrap()).unwrap()[2]
    }

    fn made() -> Params {
        let mut params = Params::new(1);
        params.scope("a").get("w", &[2, 2], Init::Constant(4.0)).unwrap();
        params
    }

    #[test]
    fn the_mean_is_the_weighted_one_and_is_exchanged_both_ways() {
        let params = made();
        let mut average = Average::new(&params, 0.5).unwrap();
        // Steps 1 to 9 are averaged with 1 / 11, 2 / 12, ... kept, below a half; then a half.
        let mut expected = 4.0f64;
        for step in 1..=30 {
            let value = f64::from(step % 5);
            set(&params, value as f32);
            average.take_in(&params).unwrap();
            let kept = (f64::from(step) / (10.0 + f64::from(step))).min(0.5);
            expected = kept * expected + (1.0 - kept) * value;
        }
        average.swap(&params).unwrap();
        assert!((f64::from(get(&params)) - expected).abs() < 1e-5, "{} for {expected}", get(&params));
        average.swap(&params).unwrap();
        assert_eq!(get(&params), 0.0);
        // Without memory it is the last step.
        let mut last = Average::new(&params, 0.0).unwrap();
        set(&params, 7.5);
        last.take_in(&params).unwrap();
        last.swap(&params).unwrap();
        assert_eq!(get(&params), 7.5);
    }

    #[test]
    fn files_come_back_and_others_are_refused() {
        let params = made();
        let mut average = Average::new(&params, 0.9).unwrap();
        set(&params, 1.0);
        average.take_in(&params).unwrap();
        let mut again = Average::new(&params, 0.9).unwrap();
        again.load(&average.to_bytes().unwrap()).unwrap();
        assert_eq!((again.steps, &again.tensors), (average.steps, &average.tensors));
        let mut other = made();
        other.scope("b").get("w", &[1], Init::Constant(0.0)).unwrap();
        assert!(Average::new(&other, 0.9).unwrap().load(&average.to_bytes().unwrap()).is_err());
        assert!(again.load(&Average::new(&other, 0.9).unwrap().to_bytes().unwrap()).is_err());
        assert!(again.take_in(&other).is_err() && again.load(&params.to_bytes().unwrap()).is_err());
    }
}
