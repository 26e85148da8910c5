//! Wall-clock time for measurements. Medians and not means: one page fault or neighbour on the machine must not move a
//! figure.

use std::time::Instant;

/// Median seconds of `work`, run once to warm caches and then until there are `max_laps` or `seconds` are over, and once
/// at least: for work that may be fast or slow.
pub fn median_within<T>(max_laps: usize, seconds: f64, mut work: impl FnMut() -> T) -> f64 {
    std::hint::black_box(work());
    let mut laps = Vec::new();
    loop {
        let begun = Instant::now();
        std::hint::black_box(work());
        laps.push(begun.elapsed().as_secs_f64());
        if laps.len() >= max_laps || laps.iter().sum::<f64>() >= seconds {
            return median(&laps).unwrap_or(f64::NAN);
        }
    }
}

/// The middle value (the mean of the middle two); `None` for no values. NaN sorts last.
pub fn median(values: &[f64]) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    match sorted.len() {
        0 => None,
        n if n % 2 == 1 => Some(sorted[middle]),
        _ => Some((sorted[middle - 1] + sorted[middle]) / 2.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_ignores_an_outlier() {
        assert_eq!(median(&[3.0, 1.0, 1000.0]), Some(3.0));
        assert_eq!(median(&[4.0, 1.0, 2.0, 1000.0]), Some(3.0));
        assert_eq!(median(&[]), None);
    }

    #[test]
    fn work_is_done_once_more_to_warm_up_and_one_lap_is_taken_at_least() {
        let mut runs = 0;
        assert!(median_within(3, 60.0, || runs += 1).is_finite());
        assert_eq!(runs, 4);
        median_within(3, 0.0, || runs += 1);
        assert_eq!(runs, 6);
    }
}
