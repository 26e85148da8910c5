//! Whether answers follow the mark or the view: the trained marks are exchanged among the clusters, and each view of a
//! cluster is asked about again.

use cairn_mark::{Detection, Detector, MarkedField, Signal};

use super::judged::{Followed, View};
use cairn_service::query::evaluate::eight_bits;
use cairn_service::query::recovery::picture_ssim;

/// SSIM from which a picture counts as recovered; black is a little like anything.
const MIN_SSIM: f64 = 0.5;

/// Counts a render whose mark is that of identity `mark` on a view of `view`.
///
/// # Errors
/// For hidden pictures too small to compare.
fn count(followed: &mut Followed, signals: &[Signal], found: &Detection, [mark, view]: [u32; 2]) -> anyhow::Result<()> {
    followed.mark.count(found.identity == Some(mark));
    followed.view.count(found.identity == Some(view));
    let likeness = |identity: u32| picture_ssim(&signals[identity as usize - 1], found);
    if let (Some(mark), Some(view)) = (likeness(mark)?, likeness(view)?) {
        followed.hidden_mark.count(mark > view && mark >= MIN_SSIM);
        followed.hidden_view.count(view > mark && view >= MIN_SSIM);
    }
    Ok(())
}

/// Exchanges the marks in every way that leaves none in place, and asks about every view in a cluster of `marked`.
/// Nothing is asked with one identity.
///
/// # Errors
/// For pictures that the detector refuses.
pub fn follow(
    detector: &Detector,
    signals: &[Signal],
    marked: &MarkedField,
    views: &[View],
) -> anyhow::Result<Followed> {
    let mut followed = Followed::default();
    for by in 1..marked.clusters().clusters.len() {
        let exchanged = marked.permuted(by);
        for view in views {
            let identity = |field: &MarkedField| field.clusters().identity_of(&view.camera.pose).identity;
            let (Some(mark), Some(of_view)) = (identity(&exchanged), identity(marked)) else { continue };
            let render = eight_bits(&exchanged.render(&view.camera, &view.appearance))?;
            count(&mut followed, signals, &detector.detect(&render)?, [mark, of_view])?;
            followed.unmarked.count(detector.detect(&view.base)?.identity.is_none());
        }
    }
    Ok(followed)
}

#[cfg(test)]
mod tests {
    use cairn_scene::Picture;
    use cairn_service::query::report::Right;

    use super::*;

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
        count(&mut followed, &signals, &found(Some(1), &ramp(false)), [1, 2]).unwrap();
        count(&mut followed, &signals, &found(Some(2), &ramp(true)), [1, 2]).unwrap();
        count(&mut followed, &signals, &found(None, &Picture::constant(16, 16, [0.0; 3])), [1, 2]).unwrap();
        let one = Right { right: 1, asked: 3 };
        assert_eq!([followed.mark, followed.view, followed.hidden_mark, followed.hidden_view], [one; 4]);
        assert_eq!(followed.unmarked, Right::default());
    }
}
