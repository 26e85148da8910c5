//! What is trained: in suite `ablation` one training each with a part of the method switched off or replaced, in
//! the others the settings as they are.

use super::What;

/// A training: what it is called and how it differs from the case's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Training {
    /// Its name in the ledger; empty for the case as it is.
    pub name: &'static str,
    /// What is laid over the settings, TOML.
    pub over: &'static str,
    /// Who has marks.
    pub owners: Owners,
}

/// The case as it is.
pub const AS_IT_IS: Training = row("", "");

/// Who has marks in a training.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Owners {
    /// As many as the case says.
    Case,
    /// Two, of half of the views each, trained together.
    Two,
    /// The same two: the second is added to what was trained for the first alone.
    OneAndAnother,
}

/// The paper's recipe, its weights those for scenes in the wild.
const PAPER_TOML: &str = include_str!("../../../../configs/paper.toml");

/// The whole recipe of the paper, the rows of its table of ablations, three values of alpha, the other losses, the paper's carrier with its
/// densities as they are and free (ray weights worked out once, and at every look) and with the mask of the authors' code,
/// what the paper does without, and what else training skips, not skipped. Without a classifier nothing but recovery can move marks, so that
/// *recovery moves marks* is what that row is to be compared with.
const ABLATIONS: [Training; 25] = [
    row("full", ""),
    row("the paper's recipe", PAPER_TOML),
    row("no classifier", "[mark]\nguidance = \"no_classifier\"\nrecover_moves_marks = true\n"),
    row("recovery moves marks", "[mark]\nrecover_moves_marks = true\n"),
    row("classifier not guiding", "[mark]\nguidance = \"unguided\"\n"),
    row("no mask", "[mark]\nmask = \"none\"\n"),
    row("binary mask at 0.5", "[mark]\nmask = \"binary\"\nmask_share = 0.5\n"),
    row("binary mask at 0.9", "[mark]\nmask = \"binary\"\nmask_share = 0.9\n"),
    row("alpha 0", "[mark]\nmask_alpha = 0.0\n"),
    row("alpha 1", "[mark]\nmask_alpha = 1.0\n"),
    row("alpha 5", "[mark]\nmask_alpha = 5.0\n"),
    row("squared recovery", "[mark]\nloss = \"squared\"\n"),
    row("absolute picture loss", "[mark]\npicture_loss = \"absolute\"\n"),
    row("no budget", "[mark]\nbudget = false\n"),
    row("no memory", "[mark]\ndetector.memory = \"none\"\naudio.memory = \"none\"\ntext.memory = \"none\"\n"),
    row("no noise", "[mark]\nnoisy_share = 0.0\n"),
    row("settled views as often", "[mark]\nsettled_share = 1.0\n"),
    row("to the last step", "[mark]\nenough_ssim = 10.0\n"),
    row("two dozen views", "[mark]\nviews_apart_deg = 180.0\n"),
    row("heads that nobody uses", "[mark]\nunused_heads = true\n"),
    Training { name: "two owners", over: "", owners: Owners::Two },
    Training { name: "two owners, one of them later", over: "", owners: Owners::OneAndAnother },
    row("harmonics", "[mark]\ncarrier = \"harmonics\"\n"),
    row("harmonics, free density", "[mark]\ncarrier = \"harmonics\"\ndensity = \"free\"\n"),
    row("group mask, harmonics", "[mark]\ncarrier = \"harmonics\"\nmask = \"per_coefficient_group\"\n"),
];

/// The case's owners under other settings.
const fn row(name: &'static str, over: &'static str) -> Training {
    Training { name, over, owners: Owners::Case }
}

/// A suite's trainings: of the ablations those that `rows` names, all where that is empty; else the case as it is.
///
/// # Errors
/// For a name that is none of theirs, and for rows of another suite.
pub fn wanted(what: What, rows: &[String]) -> anyhow::Result<Vec<Training>> {
    if what != What::Ablation {
        anyhow::ensure!(rows.is_empty(), "--row chooses among the rows of suite `ablation`; leave it out");
        return Ok(vec![AS_IT_IS]);
    }
    let names = ABLATIONS.map(|training| training.name);
    if let Some(other) = rows.iter().find(|row| !names.contains(&row.as_str())) {
        anyhow::bail!("suite `ablation` has no row `{other}`; its rows are {}", names.join(", "));
    }
    let is_wanted = |training: &Training| rows.is_empty() || rows.iter().any(|row| row == training.name);
    Ok(ABLATIONS.into_iter().filter(is_wanted).collect())
}

#[cfg(test)]
mod tests {
    use super::super::QUICK_TOML;
    use super::*;
    use cairn_mark::{Guidance, Recipe};
    use cairn_scene::SceneKind;
    use cairn_service::config::{TrainingSettings, overlay_for, training_settings};

    #[test]
    fn rows_are_chosen_by_name_in_their_order_and_a_wrong_name_says_which_there_are() {
        let named = |rows: &[&str]| {
            wanted(What::Ablation, &rows.iter().map(|row| (*row).to_owned()).collect::<Vec<_>>())
                .map(|all| all.into_iter().map(|training| training.name).collect::<Vec<_>>())
        };
        assert_eq!(named(&[]).unwrap(), ABLATIONS.map(|training| training.name));
        assert_eq!(named(&["two dozen views", "full"]).unwrap(), ["full", "two dozen views"]);
        let error = named(&["full", "no masc"]).unwrap_err().to_string();
        assert!(error.contains("`no masc`") && error.contains("no mask, binary mask at 0.5"), "{error}");
        assert_eq!(wanted(What::Marks, &[]).unwrap(), [AS_IT_IS]);
        assert!(wanted(What::Honesty, &["full".to_owned()]).is_err());
    }

    #[test]
    fn what_the_classifier_is_for_is_all_that_its_rows_switch() {
        let base = TrainingSettings::given(Default::default(), Default::default());
        let mark = |name| {
            let over = ABLATIONS.into_iter().find(|training| training.name == name).unwrap().over;
            training_settings(&base, &[("row", over)]).unwrap().mark
        };
        let guided = |mark: Recipe| Recipe { guidance: Guidance::Guided, ..mark };
        assert_eq!(guided(mark("classifier not guiding")), mark("full"));
        assert_eq!(guided(mark("no classifier")), mark("recovery moves marks"));
    }

    #[test]
    fn every_row_is_accepted_over_every_kind_of_scene_and_is_another() {
        let base = TrainingSettings::given(Default::default(), Default::default());
        for kind in [SceneKind::ForwardFacing, SceneKind::Bounded, SceneKind::Unbounded] {
            for quick in ["", QUICK_TOML] {
                let laid = |over| training_settings(&base, &[overlay_for(kind), ("quick", quick), ("row", over)]);
                let mut seen: Vec<(&str, Owners, Recipe)> = Vec::new();
                for Training { name, over, owners } in ABLATIONS {
                    let settings = laid(over).unwrap_or_else(|e| panic!("{name}, {kind:?}: {e}"));
                    let same = seen.iter().find(|(_, whose, mark)| (*whose, mark) == (owners, &settings.mark));
                    assert!(same.is_none(), "{name} is the same as {same:?}");
                    assert_eq!(settings.field, laid("").unwrap().field, "{name} changes the base field");
                    seen.push((name, owners, settings.mark));
                }
            }
        }
    }
}
