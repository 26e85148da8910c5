//! cairn-nn
