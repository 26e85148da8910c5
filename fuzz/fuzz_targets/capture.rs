//! The readers of contributors' files: the first byte chooses which, the rest is its input.
#![no_main]

#[path = "../../crates/cairn-scene/tests/common/mod.rs"]
mod common;
mod seeds;
#[path = "../../crates/cairn-scene/tests/targets/mod.rs"]
mod targets;

libfuzzer_sys::fuzz_target!(init: seeds::write(targets::TARGETS.iter().map(|t| (t.name, (t.good)()))), |data: &[u8]| {
    if let Some((which, input)) = data.split_first() {
        (targets::TARGETS[usize::from(*which) % targets::TARGETS.len()].read)(input);
    }
});
