//! The registry's readers: the first byte chooses which, the rest is its input.
#![no_main]

mod seeds;
#[path = "../../crates/cairn-log/tests/targets/mod.rs"]
mod targets;

libfuzzer_sys::fuzz_target!(init: seeds::write(targets::TARGETS.iter().map(|t| (t.name, (t.good)()))), |data: &[u8]| {
    if let Some((which, input)) = data.split_first() {
        (targets::TARGETS[usize::from(*which) % targets::TARGETS.len()].read)(input);
    }
});
