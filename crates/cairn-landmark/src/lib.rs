//! cairn-landmark
