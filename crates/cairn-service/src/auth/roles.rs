//! Roles, and the one table of what every method needs.
//!
//! A method without a row is refused, and a test of the daemon holds the table to
//! the services as they were compiled: a new rpc without a row fails it.

use std::fmt;
use std::str::FromStr;

use serde::de::IntoDeserializer as _;
use serde::de::value::{self, StrDeserializer};
use serde::{Deserialize, Serialize};

/// What an account is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Imports scenes of their own, trains on them within quota, submits records under their own key.
    Contributor,
    /// Changes any scene, and anybody's jobs; excludes and includes views; binds contributors' names to keys.
    Curator,
    /// Reads everything and changes nothing.
    Auditor,
    /// Everything, accounts and quotas included.
    Operator,
}

impl Role {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Contributor, Self::Curator, Self::Auditor, Self::Operator];

    /// How far the role reaches in methods of this need.
    pub fn reach(self, need: Need) -> Reach {
        match (need, self) {
            (Need::Anyone | Need::Read | Need::Account, _) => Reach::All,
            (_, Self::Operator) => Reach::All,
            (Need::Contribute, Self::Contributor | Self::Curator) => Reach::All,
            (Need::Contribute, Self::Auditor) => Reach::None,
            (Need::Inspect, Self::Contributor) => Reach::Own,
            (Need::Inspect, Self::Curator | Self::Auditor) => Reach::All,
            (Need::Change, Self::Contributor) => Reach::Own,
            (Need::Change, Self::Curator) => Reach::All,
            (Need::Change, Self::Auditor) => Reach::None,
            (Need::Curate, Self::Curator) => Reach::All,
            (Need::Curate, Self::Contributor | Self::Auditor) => Reach::None,
            (Need::Oversee, Self::Auditor) => Reach::All,
            (Need::Oversee, Self::Contributor | Self::Curator) => Reach::None,
            (Need::Operate, Self::Contributor | Self::Curator | Self::Auditor) => Reach::None,
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

impl FromStr for Role {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let word: StrDeserializer<'_, value::Error> = text.into_deserializer();
        Self::deserialize(word).map_err(|_| {
            let shown: String = text.chars().take(32).collect();
            format!("there is no role {shown:?}; allowed is contributor, curator, auditor, operator")
        })
    }
}

/// How far a role reaches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// Not at all.
    None,
    /// To what the account imported, started or signed itself.
    Own,
    /// To everybody's.
    All,
}

/// What a method needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// Nothing ever: how strangers become known.
    Anyone,
    /// A token only where reading is closed; then any account's.
    Read,
    /// Any account's token.
    Account,
    /// A token of one who contributes: contributor, curator, operator.
    Contribute,
    /// A read that costs much or shows what a thief would want: the scene's owner, curator, auditor, operator.
    Inspect,
    /// A change of a scene or a job: its owner, curator, operator.
    Change,
    /// A decision about others' photographs: curator, operator; not whoever brought them.
    Curate,
    /// A look at all accounts: auditor, operator.
    Oversee,
    /// Operators only.
    Operate,
}

impl Need {
    /// Whether a call changes or spends something, or shows what is not for everybody: a token is needed
    /// even where reading is open.
    pub fn is_guarded(self) -> bool {
        !matches!(self, Self::Anyone | Self::Read)
    }

    /// The roles that reach anything here, for people.
    pub fn roles(self) -> String {
        let reaching = Role::ALL.into_iter().filter(|r| r.reach(self) != Reach::None);
        reaching.map(|role| role.to_string()).collect::<Vec<_>>().join(" or ")
    }
}

/// Full gRPC paths and what each needs, by service.
pub const METHODS: &[(&str, Need)] = &[
    ("/cairn.v1.AccessService/About", Need::Anyone),
    ("/cairn.v1.AccessService/Nonce", Need::Anyone),
    // Its proof of possession is its authorisation.
    ("/cairn.v1.AccessService/Register", Need::Anyone),
    ("/cairn.v1.AccessService/List", Need::Oversee),
    ("/cairn.v1.AccessService/Change", Need::Operate),
    // One's own usage; anybody else's needs what `List` needs.
    ("/cairn.v1.AccessService/Quota", Need::Account),
    ("/cairn.v1.SceneService/Import", Need::Contribute),
    ("/cairn.v1.SceneService/List", Need::Read),
    ("/cairn.v1.SceneService/Get", Need::Read),
    ("/cairn.v1.SceneService/DrawPoses", Need::Read),
    ("/cairn.v1.SceneService/Delete", Need::Change),
    ("/cairn.v1.SceneService/Check", Need::Inspect),
    ("/cairn.v1.SceneService/Exclude", Need::Curate),
    ("/cairn.v1.SceneService/Include", Need::Curate),
    ("/cairn.v1.TrainingService/Start", Need::Change),
    ("/cairn.v1.TrainingService/Watch", Need::Read),
    ("/cairn.v1.TrainingService/Cancel", Need::Change),
    ("/cairn.v1.TrainingService/Resume", Need::Change),
    ("/cairn.v1.TrainingService/List", Need::Read),
    // The base field, which is what a thief would want, needs what `Evaluate` needs.
    ("/cairn.v1.RenderService/Render", Need::Read),
    ("/cairn.v1.RenderService/RenderPath", Need::Read),
    // To register a picture needs what `Evaluate` needs.
    ("/cairn.v1.QueryService/Identify", Need::Read),
    // As to register a picture.
    ("/cairn.v1.QueryService/Locate", Need::Inspect),
    ("/cairn.v1.QueryService/Contributors", Need::Read),
    ("/cairn.v1.QueryService/Necessity", Need::Inspect),
    ("/cairn.v1.QueryService/Evaluate", Need::Inspect),
    ("/cairn.v1.OwnerService/Nonce", Need::Contribute),
    ("/cairn.v1.OwnerService/Material", Need::Account),
    ("/cairn.v1.OwnerService/Submit", Need::Contribute),
    ("/cairn.v1.OwnerService/Erase", Need::Contribute),
    ("/cairn.v1.OwnerService/List", Need::Read),
    ("/cairn.v1.OwnerService/Get", Need::Read),
    ("/cairn.v1.OwnerService/Answer", Need::Read),
    ("/cairn.v1.OwnerService/Checkpoint", Need::Read),
    ("/cairn.v1.OwnerService/Proof", Need::Read),
];

/// What the method at a gRPC path needs; `None` where the table has no such row.
pub fn need(path: &str) -> Option<Need> {
    METHODS.iter().find(|(known, _)| *known == path).map(|(_, need)| *need)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reaches_are_as_the_roles_are_described() {
        use Need::*;
        for (role, wanted) in [
            (Role::Contributor, [Reach::All, Reach::Own, Reach::Own, Reach::None, Reach::None, Reach::None]),
            (Role::Curator, [Reach::All, Reach::All, Reach::All, Reach::All, Reach::None, Reach::None]),
            (Role::Auditor, [Reach::None, Reach::All, Reach::None, Reach::None, Reach::All, Reach::None]),
            (Role::Operator, [Reach::All; 6]),
        ] {
            let got = [Contribute, Inspect, Change, Curate, Oversee, Operate].map(|need| role.reach(need));
            assert_eq!(got, wanted, "{role}");
            for need in [Anyone, Read, Account] {
                assert_eq!(role.reach(need), Reach::All);
            }
        }
        assert_eq!(Need::Change.roles(), "contributor or curator or operator");
    }

    #[test]
    fn no_method_stands_in_the_table_twice_and_unknown_ones_have_no_row() {
        let mut paths: Vec<&str> = METHODS.iter().map(|(path, _)| *path).collect();
        paths.sort_unstable();
        assert!(paths.windows(2).all(|pair| pair[0] != pair[1]));
        assert_eq!(need("/cairn.v1.SceneService/delete"), None, "names are compared exactly");
        assert_eq!(need("/cairn.v1.SceneService/Delete/"), None);
        assert_eq!("curator".parse(), Ok(Role::Curator));
        assert!("Curator".parse::<Role>().unwrap_err().contains("allowed is contributor"));
    }
}
