//! What tests share: hostile input (arbitrary and mutated bytes that shrink, and a count of what
//! reading them allocates), and, with the feature `daemon`, the program at work.
//!
//! A test binary declares the allocator and calls [`attack`] for each reader:
//!
//! ```
//! use cairn_testkit::{Counting, Limit, attack};
//!
//! #[global_allocator]
//! static ALLOCATOR: Counting = Counting;
//!
//! # fn main() {
//! attack("lines", &[b"one\ntwo\n"], Limit { times: 64, plus: 4096 }, |bytes| {
//!     let _ = std::str::from_utf8(bytes).map(|text| text.lines().count());
//! });
//! # }
//! ```
//!
//! The same seed gives the same cases, so a failure in CI is one here. `CAIRN_FUZZ_CASES` asks for more of them.
//! For tests only: nothing that ships depends on this crate.

mod allocator;
#[cfg(feature = "daemon")]
pub mod daemon;
mod mutate;

pub use allocator::{Counting, allocations_of, peak_of};
pub use mutate::{Input, inputs};

use proptest::{
    strategy::{Strategy as _, ValueTree as _},
    test_runner::{Config, RngAlgorithm, TestRng, TestRunner},
};

/// Cases a target gets where `CAIRN_FUZZ_CASES` says nothing: some seconds for all of them on two cores.
pub const CASES: u32 = 3000;

/// What a reader may allocate at its peak, in bytes: `times` the input's length and `plus`.
#[derive(Clone, Copy, Debug)]
pub struct Limit {
    /// Bytes for each byte of input.
    pub times: usize,
    /// Bytes for no input at all: what errors and fixed tables take.
    pub plus: usize,
}

impl Limit {
    /// The bound for an input of `length` bytes.
    pub fn of(self, length: usize) -> usize {
        self.times * length + self.plus
    }
}

/// How many cases a target gets: `CAIRN_FUZZ_CASES`, or [`CASES`].
///
/// # Panics
/// Where `CAIRN_FUZZ_CASES` is no number.
pub fn cases() -> u32 {
    match std::env::var("CAIRN_FUZZ_CASES") {
        Ok(text) => text.parse().unwrap_or_else(|_| panic!("CAIRN_FUZZ_CASES is {text:?}; a number is expected")),
        Err(_) => CASES,
    }
}

/// A runner of `cases` cases whose generator is seeded with `name`: the same cases on every machine.
pub fn runner(name: &str, cases: u32) -> TestRunner {
    let mut seed = [0; 32];
    for (i, byte) in name.bytes().enumerate() {
        seed[i % 32] ^= byte.rotate_left((i / 32) as u32);
    }
    let config = Config { cases, failure_persistence: None, max_shrink_iters: 4000, ..Config::default() };
    TestRunner::new_with_rng(config, TestRng::from_seed(RngAlgorithm::ChaCha, &seed))
}

/// The cases of [`attack`], one after the other without an end, for targets that are no function call.
pub fn samples(name: &str, good: &[&[u8]]) -> impl Iterator<Item = Vec<u8>> + use<> {
    let (inputs, mut runner) = (inputs(good), runner(name, 1));
    // Generating fails only where a strategy filters, and these filter nothing.
    std::iter::from_fn(move || Some(inputs.new_tree(&mut runner).ok()?.current().bytes().to_vec()))
}

/// Feeds `target` with the `good` inputs, mutations of them and noise: it MUST NOT panic, nor allocate beyond `limit`.
///
/// # Panics
/// With the smallest input found that breaks the rule.
pub fn attack(name: &str, good: &[&[u8]], limit: Limit, target: impl Fn(&[u8])) {
    attack_with(name, good, cases(), |length| limit.of(length), target);
}

/// As [`attack`], with a number of cases and any bound on the peak, in bytes, by the input's length.
///
/// # Panics
/// As [`attack`].
pub fn attack_with(name: &str, good: &[&[u8]], cases: u32, bound: impl Fn(usize) -> usize, target: impl Fn(&[u8])) {
    let (_, counted) = peak_of(|| drop(std::hint::black_box(vec![1_u8; 4096])));
    assert!(counted >= 4096, "nothing is counted: the test binary must declare `Counting` as its global allocator");
    let check = |input: &[u8]| {
        let ((), peak) = peak_of(|| target(input));
        let allowed = bound(input.len());
        assert!(peak <= allowed, "{peak} bytes allocated for an input of {}, {allowed} allowed", input.len());
    };
    good.iter().for_each(|input| check(input));
    let ran = runner(name, cases).run(&inputs(good), |input| {
        check(input.bytes());
        Ok(())
    });
    if let Err(broken) = ran {
        panic!("{name}: {broken}");
    }
}

/// Copies a folder, all of its files and folders: a socket is its process's alone.
///
/// # Panics
/// Where a file cannot be read or written.
pub fn copy(from: &std::path::Path, to: &std::path::Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let to = to.join(entry.file_name());
        let kind = entry.file_type().unwrap();
        if kind.is_dir() {
            copy(&entry.path(), &to);
        } else if kind.is_file() {
            std::fs::copy(entry.path(), &to).unwrap();
        }
    }
}
