//! The hunter is tried on planted faults: what it cannot find here it would not find anywhere.

use std::panic::{AssertUnwindSafe, catch_unwind};

use cairn_testkit::{Counting, Limit, attack_with, peak_of, samples};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

const SOME: Limit = Limit { times: 16, plus: 4096 };

/// What an attack on `target` says against it.
fn found(name: &str, good: &[&[u8]], target: impl Fn(&[u8])) -> String {
    let run = AssertUnwindSafe(|| attack_with(name, good, 1500, |length| SOME.of(length), target));
    let panicked = catch_unwind(run).expect_err("the planted fault was not found");
    panicked.downcast_ref::<String>().cloned().unwrap_or_default()
}

#[test]
fn a_panic_is_found_and_shrinks_to_what_matters() {
    let said = found("panic", &[b"a record with 12 fields, and one more"], |bytes| {
        assert!(!bytes.windows(4).any(|four| four == b"[[[["), "too deep");
    });
    assert!(said.contains("too deep"), "{said}");
    assert_eq!(said.matches("Nest").count(), 1, "one mutation is enough: {said}");
    assert!(said.contains("b\"[[[[") || said.contains("[[[[a record"), "{said}");
}

#[test]
fn an_allocation_that_a_header_asks_for_is_found() {
    let good = [7, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7];
    let said = found("allocation", &[&good], |bytes| {
        if let Some((length, _)) = bytes.split_first_chunk::<4>() {
            // Bounded, so that the test itself stays small.
            drop(std::hint::black_box(Vec::<u8>::with_capacity(u32::from_le_bytes(*length).min(1 << 24) as usize)));
        }
    });
    assert!(said.contains("bytes allocated for an input of"), "{said}");
}

#[test]
fn the_peak_is_what_was_held_at_once() {
    let (_, peak) = peak_of(|| {
        for _ in 0..100 {
            drop(std::hint::black_box(vec![0_u8; 10_000]));
        }
    });
    assert!((10_000..20_000).contains(&peak), "{peak}");
    let (_, peak) = peak_of(|| std::hint::black_box((vec![0_u8; 10_000], vec![1_u8; 10_000])));
    assert!((20_000..30_000).contains(&peak), "{peak}");
}

#[test]
fn the_same_name_gives_the_same_cases() {
    let some = |name| samples(name, &[b"good"]).take(50).collect::<Vec<_>>();
    assert_eq!(some("a"), some("a"));
    assert_ne!(some("a"), some("b"));
}
