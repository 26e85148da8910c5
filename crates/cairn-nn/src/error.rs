//! What can go wrong in this crate, each with the name it happened to.

use thiserror::Error;

/// Results of this crate.
pub type Result<T> = std::result::Result<T, NnError>;

/// An error of a layer, a network, its parameters or its optimiser.
#[derive(Debug, Error)]
pub enum NnError {
    /// A tensor operation failed.
    #[error("tensor operation: {0}")]
    Tensor(#[from] candle_core::Error),
    /// A parameter exists with another shape.
    #[error(
        "parameter `{name}` has shape {got:?}, this network needs {expected:?}; load parameters of the same configuration"
    )]
    ParameterShape {
        /// The parameter.
        name: String,
        /// What the network asks for.
        expected: Vec<usize>,
        /// What is there.
        got: Vec<usize>,
    },
    /// Stored parameters and present ones differ in their names.
    #[error("parameter `{name}` is {what}; load parameters of the same configuration")]
    ParameterName {
        /// The parameter.
        name: String,
        /// Which of the two sides lacks it.
        what: &'static str,
    },
    /// A file is no file of ours, or of a format version that is not known.
    #[error("{what}: expected {expected}, got {got}; write it again with this version of Cairn")]
    Format {
        /// What was read.
        what: &'static str,
        /// What it must say.
        expected: String,
        /// What it says.
        got: String,
    },
    /// The safetensors container is broken.
    #[error("{what}: not readable as safetensors: {source}")]
    Container {
        /// What was read or written.
        what: &'static str,
        /// The reason.
        source: safetensors::SafeTensorError,
    },
    /// A gradient that would spoil the parameters; nothing was changed.
    #[error("the gradient of `{name}` holds {value} at entry {entry}; the step was refused and nothing changed")]
    Gradient {
        /// The parameter.
        name: String,
        /// Index into its numbers.
        entry: usize,
        /// The offending number.
        value: f32,
    },
    /// A setting out of range.
    #[error("`{key}` is {got}, allowed is {allowed}")]
    Setting {
        /// The setting's name.
        key: &'static str,
        /// Its value.
        got: String,
        /// What it may be.
        allowed: &'static str,
    },
    /// An input of the wrong shape.
    #[error("{network} takes {expected}, got {got:?}")]
    Input {
        /// The network.
        network: &'static str,
        /// The shape it takes.
        expected: String,
        /// The shape it got.
        got: Vec<usize>,
    },
}
