//! Reading and writing safetensors files with a Cairn header.

pub mod tensors;
