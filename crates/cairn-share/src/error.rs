//! What can go wrong with shares.

use cairn_field::FieldError;
use thiserror::Error;

/// Errors of shares, each naming the thing and the remedy.
#[derive(Debug, Error)]
pub enum ShareError {
    /// There are more photographs than a table has numbers for.
    #[error("the share table: {got} photographs, {max} at most; train on fewer")]
    Photographs {
        /// How many there are.
        got: usize,
        /// How many there may be.
        max: usize,
    },
    /// There are more pairs of a row and a photograph than a table counts.
    #[error("the share table: more than four thousand million entries; train on fewer or smaller photographs")]
    Entries,
    /// The table is of another field.
    #[error("the share table is of a field of {table} rows, and the field has {field}; train the scene again")]
    OtherField {
        /// Rows of the table.
        table: usize,
        /// Rows of the field.
        field: usize,
    },
    /// The file cannot be read or written.
    #[error(transparent)]
    File(#[from] FieldError),
}
