//! Wall-clock time for measurements. Medians and not means: one page fault or
//! neighbour on the machine must not move a figure.

use std::time::{Duration, Instant};

/// Times laps of work.
#[derive(Clone, Debug)]
pub struct Stopwatch {
    since: Instant,
    laps: Vec<f64>,
}

impl Default for Stopwatch {
    fn default() -> Self {
        Self::start()
    }
}

impl Stopwatch {
    /// Starts now.
    pub fn start() -> Self {
        Self { since: Instant::now(), laps: Vec::new() }
    }

    /// Ends a lap and starts the next; how long it took.
    pub fn lap(&mut self) -> Duration {
        let now = Instant::now();
        let took = now - self.since;
        self.since = now;
        self.laps.push(took.as_secs_f64());
        took
    }

    /// Seconds of every lap, in order.
    pub fn laps_s(&self) -> &[f64] {
        &self.laps
    }

    /// Median seconds of a lap; `None` before the first.
    pub fn median_s(&self) -> Option<f64> {
        median(&self.laps)
    }

    /// Runs `work` once to warm caches and then `times` laps; median seconds.
    /// `None` when `times` is zero.
    pub fn median_of<T>(times: usize, mut work: impl FnMut() -> T) -> Option<f64> {
        std::hint::black_box(work());
        let mut watch = Self::start();
        for _ in 0..times {
            std::hint::black_box(work());
            watch.lap();
        }
        watch.median_s()
    }

    /// As [`Stopwatch::median_of`] with laps until there are `most` or `seconds` are
    /// over, and one at least: for work that may be fast or slow.
    pub fn median_within<T>(most: usize, seconds: f64, mut work: impl FnMut() -> T) -> f64 {
        std::hint::black_box(work());
        let mut watch = Self::start();
        loop {
            std::hint::black_box(work());
            watch.lap();
            if watch.laps.len() >= most || watch.laps.iter().sum::<f64>() >= seconds {
                return median(&watch.laps).unwrap_or(f64::NAN);
            }
        }
    }
}

/// The middle value (the mean of the middle two); `None` for no values.
/// NaN sorts last.
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
    fn laps_are_kept_and_work_is_done_once_more_to_warm_up() {
        let mut runs = 0;
        assert!(Stopwatch::median_of(3, || runs += 1).unwrap() >= 0.0);
        assert_eq!(runs, 4);
        assert!(Stopwatch::median_within(3, 60.0, || runs += 1).is_finite());
        assert_eq!(runs, 8);
        Stopwatch::median_within(3, 0.0, || runs += 1);
        assert_eq!(runs, 10, "one lap at least");
        let mut watch = Stopwatch::start();
        assert_eq!(watch.median_s(), None);
        watch.lap();
        assert_eq!(watch.laps_s().len(), 1);
    }
}
