//! cairn-registry
