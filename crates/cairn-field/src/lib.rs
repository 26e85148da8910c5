//! cairn-field
