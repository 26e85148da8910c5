//! Photographs that teach a field nothing, and the contributors who therefore get no share.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

/// Why a photograph teaches a field nothing, and earns its contributor no share.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Unused {
    /// It is kept from training, to measure on.
    HeldOut,
    /// A person or a screening excluded it.
    Excluded,
    /// It was trained on and taught nothing: its mask leaves out all that it shows of the field, or it shows nothing
    /// of it.
    Masked,
    /// The contributor table names it, and the capture has no camera for it.
    NoCamera,
    /// The contributor table and the camera file name it, and its file is not there.
    Missing,
}

/// Photographs of one contributor that are unused for one reason.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UnusedPhotographs {
    /// Who took them.
    pub contributor: String,
    /// Why they are unused.
    pub why: Unused,
    /// How many they are, 1 and up.
    pub photographs: usize,
}

/// Photographs of one contributor, as far as shares go.
#[derive(Clone, Copy, Debug)]
pub struct Standing<'a> {
    /// Who took them.
    pub contributor: &'a str,
    /// Why they are unused; `None` where they are used.
    pub why: Option<Unused>,
    /// How many they are.
    pub photographs: usize,
}

impl Unused {
    /// What is said of photographs that are unused for this reason, behind their number.
    pub const fn words(self) -> &'static str {
        match self {
            Self::HeldOut => "held out",
            Self::Excluded => "excluded",
            Self::Masked => "masked or beside the scene",
            Self::NoCamera => "without a camera",
            Self::Missing => "missing",
        }
    }
}

/// The photographs of all contributors who have unused ones alone, by contributor and then by reason. A contributor
/// whose photographs are unused for several reasons has an entry for each.
pub fn without_share<'a>(photographs: impl IntoIterator<Item = Standing<'a>>) -> Vec<UnusedPhotographs> {
    let mut used = BTreeSet::new();
    let mut unused: BTreeMap<(&str, Unused), usize> = BTreeMap::new();
    for Standing { contributor, why, photographs } in photographs {
        match why {
            None => drop(used.insert(contributor)),
            Some(why) => *unused.entry((contributor, why)).or_default() += photographs,
        }
    }
    let of = |((contributor, why), photographs): ((&str, Unused), usize)| UnusedPhotographs {
        contributor: contributor.to_owned(),
        why,
        photographs,
    };
    unused.into_iter().filter(|((contributor, _), _)| !used.contains(contributor)).map(of).collect()
}

/// A sentence that names all contributors without a share and says why, those with one reason together; `None` where there
/// is none. `all` is as [`without_share`] gives it.
pub fn no_share(all: &[UnusedPhotographs]) -> Option<String> {
    let mut groups: Vec<(String, Vec<&str>)> = Vec::new();
    for own in all.chunk_by(|a, b| a.contributor == b.contributor) {
        let why = reason(own);
        let at = groups.iter().position(|(known, _)| *known == why).unwrap_or_else(|| {
            groups.push((why, Vec::new()));
            groups.len() - 1
        });
        groups[at].1.push(&own[0].contributor);
    }
    let in_words = |(why, names): &(String, Vec<&str>)| {
        let each = if names.len() > 1 { " each" } else { "" };
        format!("{} ({why}{each})", names.join(", "))
    };
    let said: Vec<String> = groups.iter().map(in_words).collect();
    (!said.is_empty()).then(|| format!("no share for {}", said.join("; ")))
}

/// Why one contributor's photographs, all of `own`, are unused.
fn reason(own: &[UnusedPhotographs]) -> String {
    let count: usize = own.iter().map(|unused| unused.photographs).sum();
    let photographs = if count == 1 { "1 photograph".to_owned() } else { format!("{count} photographs") };
    match own {
        [only] => format!("{photographs} {}", only.why.words()),
        several => {
            let reasons = several.iter().map(|unused| format!("{} {}", unused.photographs, unused.why.words()));
            format!("{photographs}: {}", reasons.collect::<Vec<_>>().join(", "))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contributors_with_unused_photographs_alone_are_named_with_every_reason() {
        let of = |contributor, why, photographs| Standing { contributor, why, photographs };
        let all = without_share([
            of("cy", Some(Unused::Excluded), 1),
            of("ada", Some(Unused::HeldOut), 1),
            of("ada", None, 1),
            of("bo", Some(Unused::NoCamera), 2),
            of("cy", Some(Unused::HeldOut), 1),
            of("cy", Some(Unused::Excluded), 1),
            of("di", Some(Unused::Masked), 1),
            of("ed", Some(Unused::NoCamera), 2),
        ]);
        let row = |contributor: &str, why, photographs| UnusedPhotographs {
            contributor: contributor.into(),
            why,
            photographs,
        };
        let wanted = [
            row("bo", Unused::NoCamera, 2),
            row("cy", Unused::HeldOut, 1),
            row("cy", Unused::Excluded, 2),
            row("di", Unused::Masked, 1),
            row("ed", Unused::NoCamera, 2),
        ];
        assert_eq!(all, wanted);
        let said = "no share for bo, ed (2 photographs without a camera each); cy (3 photographs: 1 held out, \
                    2 excluded); di (1 photograph masked or beside the scene)";
        assert_eq!(no_share(&all).as_deref(), Some(said));
        assert_eq!(no_share(&[]), None);
    }
}
