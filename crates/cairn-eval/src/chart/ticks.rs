//! Where an axis is divided, and what stands there.

use super::Scale;

/// Lines of the grid along one axis, in the axis's own divisions.
pub struct Ticks {
    /// Place and label.
    pub labelled: Vec<(f64, String)>,
    /// Those in between, without a label.
    pub fine: Vec<f64>,
}

/// Decades below which a logarithmic axis is labelled like an even one, and
/// those below which 2 and 5 are labelled too.
const FEW_DECADES: (f64, f64) = (0.8, 2.4);

/// A value on its axis: itself or its logarithm; `None` where it has no place.
pub fn place(value: f64, scale: Scale) -> Option<f64> {
    let at = match scale {
        Scale::Linear => value,
        Scale::Log if value > 0.0 => value.log10(),
        Scale::Log => return None,
    };
    at.is_finite().then_some(at)
}

/// Smallest and largest, with a little air; never of no extent.
pub fn span(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    if low > high {
        return None;
    }
    let air = if low == high { low.abs().max(1.0) * 0.1 } else { (high - low) * 0.06 };
    Some((low - air, high + air))
}

/// The ticks of an axis that runs from `low` to `high` (logarithms on a
/// logarithmic one).
pub fn ticks((low, high): (f64, f64), scale: Scale) -> Ticks {
    match scale {
        Scale::Linear => Ticks { labelled: even(low, high).map(|v| (v, number(v))).collect(), fine: Vec::new() },
        Scale::Log if high - low < FEW_DECADES.0 => {
            let values = even(10f64.powf(low), 10f64.powf(high));
            Ticks { labelled: values.map(|v| (v.log10(), number(v))).collect(), fine: Vec::new() }
        }
        Scale::Log => decades(low, high),
    }
}

/// Round values from `low` to `high`: steps of 1, 2 or 5 times a power of ten.
fn even(low: f64, high: f64) -> impl Iterator<Item = f64> {
    let raw = (high - low) / 6.5;
    let unit = 10f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0].iter().map(|m| m * unit).find(|s| *s >= raw).unwrap_or(10.0 * unit);
    let first = (low / step).ceil() as i64;
    // Dividing by a whole number keeps 0.3 from becoming 0.30000000000000004.
    let inverse = (1.0 / step).round();
    let value = move |k: i64| if step < 1.0 { k as f64 / inverse } else { k as f64 * step };
    (first..).map(value).take_while(move |v| *v <= high).take(20)
}

/// Powers of ten, where they are few also 2 and 5 times those, unlabelled the rest.
fn decades(low: f64, high: f64) -> Ticks {
    let stride = ((high - low) / 8.0).ceil().max(1.0) as i32;
    let labelled_digits: &[u32] = if high - low < FEW_DECADES.1 { &[1, 2, 5] } else { &[1] };
    let (mut labelled, mut fine) = (Vec::new(), Vec::new());
    for decade in low.floor() as i32..=high.ceil() as i32 {
        for digit in 1..10u32 {
            let at = f64::from(digit).log10() + f64::from(decade);
            if !(low..=high).contains(&at) {
                continue;
            }
            if labelled_digits.contains(&digit) && decade % stride == 0 {
                labelled.push((at, number(f64::from(digit) * 10f64.powi(decade))));
            } else if stride == 1 {
                fine.push(at);
            }
        }
    }
    Ticks { labelled, fine }
}

/// A tick's value, as short as it can be said.
fn number(value: f64) -> String {
    if value != 0.0 && (value.abs() < 0.999e-3 || value.abs() >= 1e6) {
        return format!("{value:.0e}");
    }
    let text = format!("{value:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(span: (f64, f64), scale: Scale) -> Vec<String> {
        ticks(span, scale).labelled.into_iter().map(|(_, label)| label).collect()
    }

    #[test]
    fn ticks_are_round_numbers_within_the_axis() {
        assert_eq!(labels((-0.1, 1.1), Scale::Linear), ["0", "0.2", "0.4", "0.6", "0.8", "1"]);
        assert_eq!(labels((17.2, 33.0), Scale::Linear), ["20", "25", "30"].map(String::from));
        assert_eq!(labels((-2.1, 2.2), Scale::Log), ["0.01", "0.1", "1", "10", "100"]);
        assert_eq!(labels((-6.2, -2.9), Scale::Log), ["1e-6", "1e-5", "1e-4", "0.001"]);
    }

    #[test]
    fn a_short_logarithmic_axis_is_labelled_between_its_powers() {
        assert_eq!(labels((0.9, 2.1), Scale::Log), ["10", "20", "50", "100"]);
        assert_eq!(labels((0.31, 0.59), Scale::Log), ["2.5", "3", "3.5"]);
        assert!(!ticks((0.9, 2.1), Scale::Log).fine.is_empty());
    }
}
