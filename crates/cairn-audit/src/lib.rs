//! cairn-audit
