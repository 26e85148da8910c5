//! The readers of contributors' files: the first byte chooses which, the rest is its input.
#![no_main]

#[path = "../../crates/cairn-capture/tests/common/mod.rs"]
mod common;
#[path = "../../crates/cairn-capture/tests/targets/mod.rs"]
mod targets;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    if let Some((which, input)) = data.split_first() {
        (targets::TARGETS[usize::from(*which) % targets::TARGETS.len()].read)(input);
    }
});
