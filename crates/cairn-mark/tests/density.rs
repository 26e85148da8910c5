//! Free density: theta's densities move with the mark, theta_0 stays what it was, and
//! what is trained is stored and seen alike.

use crate::common::{bytes, cameras, config, field, plan, ran, run, start, trained};
use cairn_field::Field;
use cairn_field::grid::lattice::Grid;
use cairn_mark::{CarrierKind, DensityKind, MarkError, MarkTrainer, MarkedField, MaskKind, Recipe};

fn free(steps: u64) -> Recipe {
    Recipe { carrier: CarrierKind::Harmonics, density: DensityKind::Free, ..config(steps) }
}

/// How far `theta`'s densities are from theta_0's: the mean over rows of the raw ones.
fn moved(theta: &Field) -> f64 {
    let rows = |grid: &Grid<f32>| grid.raw_rows().map(f64::from).collect::<Vec<_>>();
    let (was, is) = (rows(field().grid()), rows(theta.grid()));
    was.iter().zip(&is).map(|(a, b)| (a - b).abs()).sum::<f64>() / was.len() as f64
}

#[test]
fn densities_move_where_they_are_free_and_only_there() {
    let frozen = trained(Recipe { carrier: CarrierKind::Harmonics, ..config(6) }).0;
    assert_eq!(moved(frozen.theta()), 0.0);
    let marked = trained(free(6)).0;
    assert!(moved(marked.theta()) > 1e-6, "{}", moved(marked.theta()));
    assert!(marked.base().to_bytes().unwrap() == field().to_bytes().unwrap(), "theta_0 moved");
    // A binary mask that locks everything but what has no density holds them.
    let locked = Recipe { mask: MaskKind::Binary, mask_share: 1.0, ..free(6) };
    assert_eq!(moved(trained(locked).0.theta()), 0.0);
    let slow = Recipe { learning_rate_density: 1e-9, ..free(6) };
    assert!(moved(trained(slow).0.theta()) < 0.01 * moved(marked.theta()), "the rate of densities is not theirs");
}

#[test]
fn what_was_trained_is_what_comes_back_and_renders() {
    let (marked, _) = trained(free(4));
    let again = MarkedField::from_bytes(&marked.to_bytes().unwrap()).unwrap();
    assert!(again.to_bytes().unwrap() == marked.to_bytes().unwrap());
    let (camera, appearance) = (cameras()[0], field().canonical_appearance().clone());
    let picture = marked.render(&camera, &appearance);
    assert!(again.render(&camera, &appearance) == picture, "the field read back renders another picture");
    assert!(field().render(&camera, &appearance) != picture, "nothing shows");
    // Whose pose it is makes no difference: there is one theta.
    assert!(marked.render_as(&camera, &appearance, None) == picture);
    assert!(marked.pruned(0.5).render(&camera, &appearance) != picture);
    assert_eq!(moved(marked.pruned(0.5).theta()), moved(marked.theta()), "pruning is of colours");
}

#[test]
fn threads_and_interruptions_do_not_change_the_bytes() {
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| bytes(ran(free(5))))
    };
    let whole = with(1);
    assert!(whole == with(3), "one thread and three differ");
    let mut first = start(free(5));
    for _ in 0..3 {
        first.step().unwrap();
    }
    let stopped = first.checkpoint().unwrap();
    let mut second = MarkTrainer::resume(&stopped, field(), plan(), &mut |_, _| true).unwrap();
    run(&mut second);
    assert!(bytes(second) == whole, "the resumed run ended elsewhere");
}

#[test]
fn harmonics_with_densities_as_they_are_resume_to_the_same_bytes() {
    let frozen = Recipe { carrier: CarrierKind::Harmonics, ..config(12) };
    let weights = Recipe { mask: MaskKind::PerCoefficientGroup, recover_moves_marks: true, ..frozen.clone() };
    for (config, stop) in [(Recipe { view_refresh_steps: 2, ..frozen }, 7), (Recipe { budget: false, ..weights }, 6)] {
        // The last state as well as what is kept, which may be the state judged before the stop; on one thread.
        let ended = |mut trainer: MarkTrainer| {
            run(&mut trainer);
            (trainer.checkpoint().unwrap(), bytes(trainer))
        };
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let whole = one.install(|| ended(start(config.clone())));
        let mut first = start(config);
        for _ in 0..stop {
            first.step().unwrap();
            if first.steps_done() == 5 {
                first.judge().unwrap();
            }
        }
        let stopped = first.checkpoint().unwrap();
        drop(first);
        let second = MarkTrainer::resume(&stopped, field(), plan(), &mut |_, _| true).unwrap();
        assert!(second.checkpoint().unwrap() == stopped, "a checkpoint read and written again is another ({stop})");
        let resumed = ended(second);
        assert!(resumed.0 == whole.0, "the last states differ (stopped after {stop})");
        assert!(resumed.1 == whole.1, "the resumed run ended elsewhere (stopped after {stop})");
    }
}

#[test]
fn a_mark_is_learnt_with_free_density() {
    let mut only = plan();
    only.signals.truncate(1);
    let poses: Vec<_> = only.views.iter().map(|v| v.camera.pose).collect();
    let all = cairn_scene::cluster::ClusterConfig { anchors: 1, neighbours: 12, ..Default::default() };
    only.clusters =
        cairn_scene::cluster::Clusters::build(&poses, &cairn_scene::cluster::Grouping::Anchors(all), &[], 5).unwrap();
    let config = Recipe { budget_db: 36.0, classify_until: 0.3, ..free(250) };
    let mut trainer = MarkTrainer::new(field(), only, config, 7, &mut |_, _| true).unwrap();
    run(&mut trainer);
    let (marked, detector) = trainer.finish().unwrap();
    let appearance = field().canonical_appearance().clone();
    let all = cameras();
    let right = all.iter().filter(|camera| {
        let with = detector.detect(&marked.render(camera, &appearance)).unwrap();
        let without = detector.detect(&field().render(camera, &appearance)).unwrap();
        with.identity == Some(1) && without.identity.is_none()
    });
    let right = right.count();
    assert!(right >= 11, "{right} of 12 views are told from their unmarked twins");
}

#[test]
fn carriers_of_the_clusters_own_are_refused_with_a_remedy() {
    let config = Recipe { carrier: CarrierKind::PerCluster, ..free(3) };
    let error = MarkTrainer::new(field(), plan(), config, 7, &mut |_, _| true).err().unwrap();
    assert!(matches!(error, MarkError::Setting { key: "mark.density", .. }), "{error}");
    let text = error.to_string();
    assert!(text.contains("mark.carrier = \"harmonics\"") && text.contains("frozen"), "{text}");
}

#[test]
fn a_file_that_says_its_densities_moved_and_has_none_is_refused() {
    let relabelled = |carrier| {
        let mut bytes = trained(Recipe { carrier, ..config(2) }).0.to_bytes().unwrap();
        let [is, other] = [br#"density\":\"frozen\""#, br#"density\":\"free\"  "#];
        let at = bytes.windows(is.len()).position(|w| w == is).expect("the header says it");
        bytes[at..at + is.len()].copy_from_slice(other);
        MarkedField::from_bytes(&bytes).err().unwrap().to_string()
    };
    assert!(relabelled(CarrierKind::PerCluster).contains("moved for one identity alone"));
    assert!(relabelled(CarrierKind::Harmonics).contains("carriers do not fit"));
}
