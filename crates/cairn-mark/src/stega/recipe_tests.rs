//! Budgets that photographs afford, settings of several scenes, and what is refused.

use super::*;

#[test]
fn marks_cost_photographs_no_more_than_they_may() {
    let config = Recipe { budget_db: 42.0, max_cost_db: 0.1, ..Recipe::default() };
    let cost = |explained_db: f64, budget_db: f64| {
        let [error, mark] = [explained_db, budget_db].map(|db| 10f64.powf(-db / 10.0));
        10.0 * ((error + mark) / error).log10()
    };
    for explained_db in [26.0, 28.5, 33.0, 45.0] {
        let affording = config.affording(explained_db);
        affording.validate().unwrap();
        let costs = cost(explained_db, affording.budget_db);
        assert!((costs - 0.1).abs() < 1e-9, "{explained_db} dB: {costs} dB at {}", affording.budget_db);
    }
    // What costs less already stays as strong as it is.
    assert_eq!(config.affording(22.0), config);
    assert_eq!(config.affording(f64::NEG_INFINITY), config);
    assert_eq!(config.affording(f64::INFINITY).budget_db, MAX_BUDGET_DB);
    let free = Recipe { max_cost_db: 0.0, ..config.clone() };
    assert_eq!(free.affording(33.0), free);
    let unbound = Recipe { budget: false, ..config };
    assert_eq!(unbound.affording(33.0), unbound);
}

#[test]
fn of_several_scenes_networks_are_shared_and_marks_are_each_ones_own() {
    let usual = Recipe::default();
    let forward = Recipe {
        steps: 99,
        weight_recover: 9.0,
        budget_db: 31.0,
        max_cost_db: 0.3,
        views: 7,
        views_apart_deg: 8.0,
        easy_view_share: 0.9,
        virtual_views: 5,
        view_refresh_steps: 11,
        longest_side_px: 64,
        others: 3,
        others_colours: OtherColours::Any,
        others_cutout_share: 0.5,
        ..usual.clone()
    };
    let object = Recipe { finer: 2, budget_db: 52.5, longest_side_px: 400, steps: 1500, ..usual.clone() };
    assert_eq!(Recipe::finest([&forward, &object, &object]), 1);
    assert_eq!(Recipe::finest([&forward, &forward]), 0);
    assert_eq!(Recipe::finest([]), 0);
    let sure = Recipe { min_confidence: 0.8, ..usual.clone() };
    assert_eq!(Recipe::min_confidence_of([&sure, &sure]), 0.8);
    for both in [[&sure, &usual], [&usual, &sure]] {
        assert_eq!(Recipe::min_confidence_of(both), 0.0, "what one cannot have, in any order");
    }
    assert_eq!(Recipe::min_confidence_of([]), 0.0);
    let own = object.for_scene(&forward);
    own.validate().unwrap();
    // Pictures not smaller than the networks are shown, and no budget that starts beyond its end.
    let (finer, steps, weight_recover) = (2, 1500, usual.weight_recover);
    let of_forward =
        Recipe { finer, steps, weight_recover, longest_side_px: 256, budget_start_db: 31.0, ..forward.clone() };
    assert_eq!(own, of_forward);
    for (shared, own) in [(&object, &own), (&object, &object), (&usual, &usual)] {
        assert_eq!(shared.for_scene(own), *own);
    }
    // Where the networks look less finely than a scene wants, larger pictures would be for nothing.
    assert_eq!(usual.for_scene(&object).longest_side_px, usual.longest_side_px);
}

#[test]
fn a_mask_by_groups_is_refused_where_there_is_one_group() {
    let grouped = Recipe { mask: MaskKind::PerCoefficientGroup, ..Recipe::default() };
    let error = grouped.validate().unwrap_err();
    assert!(matches!(error, MarkError::Setting { key: "mark.mask", .. }), "{error}");
    let text = error.to_string();
    assert!(text.contains("per_coefficient_group") && text.contains("mark.carrier = \"harmonics\""), "{text}");
    for density in [DensityKind::Frozen, DensityKind::Free] {
        Recipe { carrier: CarrierKind::Harmonics, density, ..grouped.clone() }.validate().unwrap();
    }
}
