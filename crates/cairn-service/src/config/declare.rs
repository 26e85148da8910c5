//! What a declared setting is, and what may stand there. `settings.rs` declares them.

use toml::Value;

/// A table of settings.
#[derive(Clone, Copy, Debug)]
pub struct Table {
    /// Its path in the file, as `server.tls`.
    pub path: &'static str,
    /// What it is about, a sentence a line.
    pub about: &'static str,
    /// Its settings, in their order.
    pub settings: &'static [Setting],
}

/// A setting.
#[derive(Clone, Copy, Debug)]
pub struct Setting {
    /// Its key in its table.
    pub key: &'static str,
    /// What may stand there.
    pub allowed: Allowed,
    /// What it is, a sentence a line.
    pub about: &'static str,
    /// Why a user changes it.
    pub reason: &'static str,
}

/// What a setting's value may be; it names the value's type as well.
#[derive(Clone, Copy, Debug)]
pub enum Allowed {
    /// A whole number from the first to the second.
    Whole(u64, u64),
    /// A whole number from the first to the second, or 0 for the preset's own.
    WholeOrPreset(u64, u64),
    /// A multiple of the first from the second to the third, or 0 for the preset's own.
    MultipleOrPreset(u64, u64, u64),
    /// A number from the first to the second, or 0 for the preset's own.
    NumberOrPreset(f64, f64),
    /// `true` or `false`.
    Switch,
    /// One of these words.
    OneOf(&'static [&'static str]),
    /// Text that the start checks further.
    Text(&'static str),
    /// A list of texts that the start checks further.
    Texts(&'static str),
}

impl Allowed {
    /// Whether `value`, which has the right type, is allowed.
    pub fn takes(&self, value: &Value) -> bool {
        let whole = value.as_integer().and_then(|whole| u64::try_from(whole).ok());
        match *self {
            Self::Whole(low, high) => whole.is_some_and(|n| (low..=high).contains(&n)),
            Self::WholeOrPreset(low, high) => whole.is_some_and(|n| n == 0 || (low..=high).contains(&n)),
            Self::MultipleOrPreset(of, low, high) => {
                whole.is_some_and(|n| n == 0 || (n.is_multiple_of(of) && (low..=high).contains(&n)))
            }
            Self::NumberOrPreset(low, high) => value.as_float().is_some_and(|n| n == 0.0 || (low..=high).contains(&n)),
            Self::OneOf(words) => value.as_str().is_some_and(|word| words.contains(&word)),
            Self::Switch | Self::Text(_) | Self::Texts(_) => true,
        }
    }

    /// The values in words.
    pub fn words(&self) -> String {
        match *self {
            Self::Whole(low, high) => format!("{low} to {high}"),
            Self::WholeOrPreset(low, high) => format!("0 (the preset's) or {low} to {high}"),
            Self::MultipleOrPreset(of, low, high) => {
                format!("0 (the preset's) or a multiple of {of} from {low} to {high}")
            }
            Self::NumberOrPreset(low, high) => format!("0 (the preset's) or {low} to {high}"),
            Self::Switch => "true or false".into(),
            Self::OneOf(words) => words.join(", "),
            Self::Text(words) | Self::Texts(words) => words.into(),
        }
    }
}

/// Declares all settings once: a typed struct a table with its defaults, `Settings` over them, and [`Table`]s for the
/// check and the documents. A line is `key: type = default, allowed, reason;` under the sentence that says what it is.
macro_rules! settings {
    ($($(#[doc = $about:literal])+ [$path:literal] $field:ident: $Table:ident {
        $($(#[doc = $sentence:literal])+ $key:ident: $kind:ty = $default:expr, $allowed:expr, $reason:literal;)+
    })+) => {
        $(
            $(#[doc = $about])+
            #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
            #[serde(deny_unknown_fields)]
            pub struct $Table {
                $($(#[doc = $sentence])+ pub $key: $kind,)+
            }

            impl Default for $Table {
                fn default() -> Self {
                    Self { $($key: $default,)+ }
                }
            }
        )+

        /// A whole settings file, typed.
        #[derive(Clone, Debug, Default, PartialEq)]
        pub struct Settings {
            $($(#[doc = $about])+ pub $field: $Table,)+
        }

        /// All tables of settings, in the file's order.
        pub const TABLES: &[crate::config::declare::Table] = &[$(crate::config::declare::Table {
            path: $path,
            about: concat!($($about, "\n"),+),
            settings: &[$(crate::config::declare::Setting {
                key: stringify!($key),
                allowed: $allowed,
                about: concat!($($sentence, "\n"),+),
                reason: $reason,
            }),+],
        }),+];

        impl Settings {
            /// Each table's path and its values, in [`TABLES`]' order.
            pub fn values(&self) -> Result<Vec<(&'static str, toml::Table)>, toml::ser::Error> {
                Ok(vec![$(($path, toml::Table::try_from(&self.$field)?)),+])
            }

            /// The settings whose table at each path `of` gives.
            pub fn typed(mut of: impl FnMut(&'static str) -> toml::Table) -> Result<Self, toml::de::Error> {
                Ok(Self { $($field: of($path).try_into()?,)+ })
            }
        }
    };
}

pub(super) use settings;
