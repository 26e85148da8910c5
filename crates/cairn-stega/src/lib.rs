//! cairn-stega
