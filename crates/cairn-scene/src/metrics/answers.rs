//! Counting right answers. Counts are kept and not shares: 3 of 4 and 300 of
//! 400 are different evidence, and only counts can be added across views.

use serde::{Deserialize, Serialize};

use crate::metrics::error::MetricError;

/// How many of the questions asked were answered rightly.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Accuracy {
    /// Right answers.
    pub right: u64,
    /// Questions.
    pub asked: u64,
}

impl Accuracy {
    /// Counts one more answer.
    pub fn record(&mut self, right: bool) {
        self.right += u64::from(right);
        self.asked += 1;
    }

    /// The share of right answers in 0 to 1; `None` when nothing was asked.
    pub fn share(&self) -> Option<f64> {
        (self.asked > 0).then(|| self.right as f64 / self.asked as f64)
    }
}

impl std::ops::Add for Accuracy {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self { right: self.right + other.right, asked: self.asked + other.asked }
    }
}

impl std::iter::Sum for Accuracy {
    fn sum<I: Iterator<Item = Self>>(items: I) -> Self {
        items.fold(Self::default(), |a, b| a + b)
    }
}

impl FromIterator<bool> for Accuracy {
    fn from_iter<I: IntoIterator<Item = bool>>(items: I) -> Self {
        let mut accuracy = Self::default();
        items.into_iter().for_each(|right| accuracy.record(right));
        accuracy
    }
}

impl std::fmt::Display for Accuracy {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.share() {
            Some(share) => write!(f, "{:.1} % ({} of {})", 100.0 * share, self.right, self.asked),
            None => f.write_str("nothing asked"),
        }
    }
}

/// Which class was answered for which truth: the square table of counts.
/// By Cairn's convention class 0 is `unmarked`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Confusion {
    classes: usize,
    counts: Vec<u64>,
}

impl Confusion {
    /// An empty table for classes 0 to `classes - 1`.
    ///
    /// # Errors
    /// [`MetricError::NoneAskedFor`] for zero classes.
    pub fn new(classes: usize) -> Result<Self, MetricError> {
        if classes == 0 {
            return Err(MetricError::NoneAskedFor { what: "class" });
        }
        Ok(Self { classes, counts: vec![0; classes * classes] })
    }

    /// Counts one answer.
    ///
    /// # Errors
    /// [`MetricError::Class`] when either is beyond the table.
    pub fn record(&mut self, truth: usize, answer: usize) -> Result<(), MetricError> {
        if let Some(&got) = [truth, answer].iter().find(|c| **c >= self.classes) {
            return Err(MetricError::Class { largest: self.classes - 1, got });
        }
        self.counts[truth * self.classes + answer] += 1;
        Ok(())
    }

    /// How many classes the table has.
    pub fn classes(&self) -> usize {
        self.classes
    }

    /// How often `answer` was given for `truth`; 0 for classes beyond the table.
    pub fn count(&self, truth: usize, answer: usize) -> u64 {
        if truth < self.classes && answer < self.classes { self.counts[truth * self.classes + answer] } else { 0 }
    }

    /// Right answers over all classes.
    pub fn accuracy(&self) -> Accuracy {
        (0..self.classes).map(|class| self.recall(class)).sum()
    }

    /// Of the questions whose truth is `class`: how many were answered so.
    pub fn recall(&self, class: usize) -> Accuracy {
        let asked = (0..self.classes).map(|answer| self.count(class, answer)).sum();
        Accuracy { right: self.count(class, class), asked }
    }

    /// Of the answers that named `class`: how many were true.
    pub fn precision(&self, class: usize) -> Accuracy {
        let asked = (0..self.classes).map(|truth| self.count(truth, class)).sum();
        Accuracy { right: self.count(class, class), asked }
    }
}

/// Expected calibration error (Naeini, Cooper and Hauskrecht 2015; Guo et al.
/// 2017): the mean distance between confidence and accuracy over `bins` equal
/// confidence bins `(lower, upper]`, weighted by how many answers fall in each.
/// `answers` pairs the confidence of the answer given, in [0, 1], with whether
/// it was right. 0 is perfectly calibrated.
///
/// # Errors
/// [`MetricError`] for no answers, no bins, or a confidence outside [0, 1].
pub fn expected_calibration_error(answers: &[(f64, bool)], bins: usize) -> Result<f64, MetricError> {
    if answers.is_empty() {
        return Err(MetricError::Empty { what: "the list of answers" });
    }
    if bins == 0 {
        return Err(MetricError::NoneAskedFor { what: "bin" });
    }
    let mut table = vec![(0.0, Accuracy::default()); bins];
    for (index, &(confidence, right)) in answers.iter().enumerate() {
        if !(0.0..=1.0).contains(&confidence) {
            return Err(MetricError::Confidence { index, value: confidence });
        }
        let bin = ((confidence * bins as f64).ceil() as usize).clamp(1, bins) - 1;
        table[bin].0 += confidence;
        table[bin].1.record(right);
    }
    // |sum of confidences - right answers| is the bin's gap times its count.
    let gaps: f64 = table.iter().map(|(confidence, counted)| (confidence - counted.right as f64).abs()).sum();
    Ok(gaps / answers.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_asked_has_no_share() {
        assert_eq!(Accuracy::default().share(), None);
        let some: Accuracy = [true, true, false].into_iter().collect();
        assert_eq!(some.to_string(), "66.7 % (2 of 3)");
        assert_eq!(some + some, Accuracy { right: 4, asked: 6 });
    }

    #[test]
    fn the_table_tells_recall_from_precision() {
        let mut table = Confusion::new(3).unwrap();
        for (truth, answer) in [(0, 0), (0, 1), (1, 1), (1, 1), (2, 0)] {
            table.record(truth, answer).unwrap();
        }
        assert_eq!(table.accuracy(), Accuracy { right: 3, asked: 5 });
        assert_eq!(table.recall(0), Accuracy { right: 1, asked: 2 });
        assert_eq!(table.precision(1), Accuracy { right: 2, asked: 3 });
        assert_eq!(table.precision(2).share(), None);
        assert_eq!(table.record(0, 3), Err(MetricError::Class { largest: 2, got: 3 }));
        assert_eq!(Confusion::new(0), Err(MetricError::NoneAskedFor { what: "class" }));
    }

    #[test]
    fn calibration_of_a_boaster() {
        let boaster: Vec<_> = (0..10).map(|i| (1.0, i < 6)).collect();
        assert!((expected_calibration_error(&boaster, 15).unwrap() - 0.4).abs() < 1e-12);
        let honest: Vec<_> = (0..10).map(|i| (0.6, i < 6)).collect();
        assert!(expected_calibration_error(&honest, 15).unwrap() < 1e-12);
        assert!(matches!(
            expected_calibration_error(&[(0.5, true), (f64::NAN, true)], 5),
            Err(MetricError::Confidence { index: 1, .. })
        ));
    }
}
