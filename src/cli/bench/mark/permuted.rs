//! Whether answers follow the mark or the view: the same
//! clusters get permuted identities, and each view of a cluster is asked about again.
//! With the trained marks exchanged among the clusters, and trained anew.

use cairn_mark::{Detection, Detector, MarkedField, Signal};
use serde::{Deserialize, Serialize};

use super::judge::View;
use cairn_service::query::evaluate::eight_bits;
use cairn_service::query::recovery::picture_ssim;
use cairn_service::query::report::Right;

/// SSIM from which a picture counts as recovered; black is a little like anything.
const LEAST: f64 = 0.5;

/// Of renders whose mark and view speak for different identities, how many follow which.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Followed {
    /// The class is that of the mark.
    pub mark: Right,
    /// The class is that which the view had before.
    pub view: Right,
    /// What is recovered is the mark's hidden picture: like it ([`LEAST`]), and more so than like the view's.
    pub hidden_mark: Right,
    /// The other way round.
    pub hidden_view: Right,
    /// theta_0's renders at the same poses that are called `unmarked`.
    pub unmarked: Right,
}

impl Followed {
    /// Counts a render whose mark is that of identity `mark` on a view of `view`.
    ///
    /// # Errors
    /// For hidden pictures too small to compare.
    fn count(&mut self, signals: &[Signal], found: &Detection, [mark, view]: [u32; 2]) -> anyhow::Result<()> {
        self.mark.count(found.identity == Some(mark));
        self.view.count(found.identity == Some(view));
        let likeness = |identity: u32| picture_ssim(&signals[identity as usize - 1], found);
        if let (Some(mark), Some(view)) = (likeness(mark)?, likeness(view)?) {
            self.hidden_mark.count(mark > view && mark >= LEAST);
            self.hidden_view.count(view > mark && view >= LEAST);
        }
        Ok(())
    }
}

/// Asks about every view in a cluster of `marked`. Where its identities were `permuted`
/// by so many for the training, the view speaks for the identity before; else the marks
/// are exchanged here, in every such way. Nothing is asked with one identity.
///
/// # Errors
/// For pictures that the detector refuses.
pub fn follow(
    (detector, signals): (&Detector, &[Signal]),
    (marked, permuted): (&MarkedField, usize),
    views: &[View],
) -> anyhow::Result<Followed> {
    let mut followed = Followed::default();
    let all = marked.clusters().clusters.len();
    let exchanges: Vec<usize> = if permuted > 0 { vec![0] } else { (1..all).collect() };
    for by in exchanges {
        let exchanged = marked.permuted(by);
        let before = marked.clusters().permuted((all - permuted % all) % all);
        for view in views {
            let identity = |field: &MarkedField| field.clusters().identity_of(&view.camera.pose).identity;
            let of_view = before.identity_of(&view.camera.pose).identity;
            let (Some(mark), Some(of_view)) = (identity(&exchanged), of_view) else { continue };
            let render = eight_bits(&exchanged.render(&view.camera, &view.appearance))?;
            followed.count(signals, &detector.detect(&render)?, [mark, of_view])?;
            followed.unmarked.count(detector.detect(&view.base)?.identity.is_none());
        }
    }
    Ok(followed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_scene::Picture;

    #[test]
    fn what_is_neither_the_marks_nor_the_views_counts_for_neither() {
        let ramp = |down: bool| {
            let pixel = |i: usize| [if down { i / 16 } else { i % 16 } as f32 / 15.0; 3];
            Picture::new(16, 16, (0..256).flat_map(pixel).collect()).unwrap()
        };
        let signals = [Signal::from(ramp(false)), Signal::from(ramp(true))];
        let found = |identity, picture: &Picture| Detection {
            identity,
            probabilities: Vec::new(),
            is_center_crop: false,
            recovered: picture.clone().into(),
            text_bytes: None,
        };
        let mut followed = Followed::default();
        // As the mark says, as the view says, and nothing at all.
        followed.count(&signals, &found(Some(1), &ramp(false)), [1, 2]).unwrap();
        followed.count(&signals, &found(Some(2), &ramp(true)), [1, 2]).unwrap();
        followed.count(&signals, &found(None, &Picture::constant(16, 16, [0.0; 3])), [1, 2]).unwrap();
        let one = Right { right: 1, asked: 3 };
        assert_eq!([followed.mark, followed.view, followed.hidden_mark, followed.hidden_view], [one; 4]);
        assert_eq!(followed.unmarked, Right::default());
    }
}
