//! cairn-metrics
