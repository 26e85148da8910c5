//! Which photographs are left out together.

use std::collections::BTreeMap;

use rand::SeedableRng as _;
use rand::seq::SliceRandom as _;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::source::Opened;

/// Groups of contributors, as many as are retrained without.
pub const GROUPS: usize = 8;

/// Draws of half of the groups: each is retrained without, and so is the other half.
const HALVES: usize = 4;

/// Halves of the groups, by their numbers, drawn at random, and their other halves.
pub fn subsets(seed: u64) -> Vec<Vec<usize>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut drawn = Vec::new();
    for _ in 0..HALVES {
        let mut order: Vec<usize> = (0..GROUPS).collect();
        order.shuffle(&mut rng);
        drawn.extend([order[..GROUPS / 2].to_vec(), order[GROUPS / 2..].to_vec()]);
    }
    drawn
}

/// Whose photographs a capture's are.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub enum Deal {
    /// Made-up contributors, of so many views that stand together each.
    Neighbours(usize),
    /// As the capture's `contributors.csv` has them.
    Table,
}

/// The views of each of [`GROUPS`] groups, by their indices in the capture. Contributors are dealt to groups one after
/// another, so that no group is one corner of the scene.
pub fn groups(opened: &Opened, deal: Deal) -> Vec<Vec<usize>> {
    let mut groups = vec![Vec::new(); GROUPS];
    for (n, views) in contributors(opened, deal).into_iter().enumerate() {
        groups[n % GROUPS].extend(views);
    }
    groups
}

/// The views of each contributor, by their indices in the capture.
pub fn contributors(opened: &Opened, deal: Deal) -> Vec<Vec<usize>> {
    match deal {
        Deal::Neighbours(views) => neighbours(opened, views),
        Deal::Table => table(opened),
    }
}

/// Each view that is left with those of the others that stand nearest to it.
fn neighbours(opened: &Opened, views: usize) -> Vec<Vec<usize>> {
    let mut left = opened.training();
    let mut contributors = Vec::new();
    while let Some(first) = left.first().copied() {
        let at = opened.camera(first).pose.position;
        left.sort_by(|a, b| {
            let away = |view: &usize| opened.camera(*view).pose.position.distance(at);
            away(a).total_cmp(&away(b)).then(a.cmp(b))
        });
        contributors.push(left.drain(..views.min(left.len())).collect());
        left.sort_unstable();
    }
    contributors
}

/// Those of most photographs first, so that they are dealt to different groups.
fn table(opened: &Opened) -> Vec<Vec<usize>> {
    let mut of: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for view in opened.training() {
        of.entry(opened.contributor(view)).or_default().push(view);
    }
    let mut contributors: Vec<Vec<usize>> = of.into_values().collect();
    contributors.sort_by_key(|views| std::cmp::Reverse(views.len()));
    contributors
}
