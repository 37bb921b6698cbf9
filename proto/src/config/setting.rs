//! How a setting is declared: its key, type, default, accepted values and help in one place.
//!
//! ```
//! # use trestle_proto::{settings, choices};
//! use trestle_proto::config::{Field, accepts::between};
//!
//! choices! {
//!     /// What pushes.
//!     pub enum Push {
//!         /// A constant force.
//!         Constant = "constant",
//!         /// Nothing.
//!         None = "none",
//!     }
//! }
//!
//! settings! {
//!     /// A cart with a pole on it.
//!     pub struct CartPole {
//!         /// Newtons of a push.
//!         force: f64 = 10.0, between(0.0, 100.0);
//!         /// What pushes.
//!         push: Push = Push::Constant;
//!     }
//! }
//!
//! let all = CartPole::declared("env.cart-pole");
//! assert_eq!((all[0].key.as_str(), all[0].accepted.as_str()), ("env.cart-pole.force", "0 to 100"));
//! ```
//!
//! The comment on a field is its help: `trestle config list`, the documentation and rustdoc print the same text. A comment is
//! read as one paragraph.

use super::accepts::Accepts;
use super::{ConfigError, refuse};
use crate::names;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::fmt::Debug;
use toml::{Table, Value};

/// A setting as it is declared, for people.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Setting {
    /// Its dotted key, such as `run.actors`.
    pub key: String,
    /// Its type in words.
    pub kind: String,
    /// Its default as TOML, or `none`.
    pub default: String,
    /// What is accepted, in words.
    pub accepted: String,
    /// What it is for; one paragraph.
    pub help: String,
    /// Each value's word and what it means, where there are only a few.
    pub choices: Vec<(&'static str, &'static str)>,
}

impl Setting {
    /// The last word of its key.
    pub fn name(&self) -> &str {
        self.key.rsplit('.').next().unwrap_or(&self.key)
    }

    /// The key of its table.
    pub fn table(&self) -> &str {
        self.key.rsplit_once('.').map_or("", |(table, _)| table)
    }
}

/// A type that a setting can have.
pub trait Field: Sized + Serialize + Debug + 'static {
    /// The type in words, such as `whole number`.
    fn kind() -> String;

    /// What the type alone accepts, in words.
    fn accepted() -> String {
        Self::kind()
    }

    /// Each value's word and what it means, where there are only a few.
    fn choices() -> Vec<(&'static str, &'static str)> {
        Vec::new()
    }

    /// Reads `value`, which was given as `key`; `accepted` says what the setting accepts.
    ///
    /// # Errors
    /// A value of another type. Ranges are checked by [`Field::check`].
    fn read(value: Value, key: &str, accepted: &str) -> Result<Self, ConfigError>;

    /// Checks what the type itself demands of the value, which is called `key`.
    ///
    /// # Errors
    /// The first value that is not accepted, with what is.
    fn check(&self, _key: &str) -> Result<(), ConfigError> {
        Ok(())
    }

    /// The value as a message shows it.
    fn shown(&self) -> String {
        Value::try_from(self).map_or_else(|_| format!("{self:?}"), |value| in_words(&value))
    }

    /// Adds the settings that a field of this type stands for to `all`: `setting`, or those of its table.
    fn declare(setting: Setting, all: &mut Vec<Setting>) {
        all.push(setting);
    }

    /// The settings of a table of this type that is called `key`, in the order of their declaration.
    fn declared(key: &str) -> Vec<Setting> {
        let mut all = Vec::new();
        let table = Setting {
            key: key.into(),
            kind: Self::kind(),
            default: String::new(),
            accepted: Self::accepted(),
            help: String::new(),
            choices: Vec::new(),
        };
        Self::declare(table, &mut all);
        all
    }
}

/// `value` as serde reads it, or a refusal in words, which names the type `kind` where the value is of another one and
/// `accepted` does not tell.
fn by_serde<T: DeserializeOwned>(
    value: Value,
    key: &str,
    kind: &str,
    accepted: &str,
) -> Result<T, ConfigError> {
    value.clone().try_into().map_err(|_| {
        let text = in_words(&value);
        let of_kind = match kind {
            "whole number" => is_whole(&text),
            list if list.starts_with("list") => value.is_array(),
            _ => true,
        };
        let told = of_kind || accepted.contains(kind);
        let accepted = if told { accepted.into() } else { format!("{accepted}, a {kind}") };
        refuse(key, text, &accepted)
    })
}

/// Whether `text` is a whole number, of whatever size.
pub fn is_whole(text: &str) -> bool {
    let digits = text.strip_prefix(['-', '+']).unwrap_or(text);
    !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit())
}

macro_rules! plain_fields {
    ($($field:ty: $kind:literal, $accepted:literal;)+) => { $(impl Field for $field {
        fn kind() -> String {
            $kind.into()
        }

        fn accepted() -> String {
            $accepted.into()
        }

        fn read(value: Value, key: &str, accepted: &str) -> Result<Self, ConfigError> {
            by_serde(value, key, $kind, accepted)
        }
    })+ };
}

plain_fields! {
    bool: "boolean", "true, false";
    i64: "whole number", "a whole number";
    u32: "whole number", "0 or more";
    u64: "whole number", "0 or more";
    usize: "whole number", "0 or more";
    f64: "number", "a number";
    String: "text", "text";
    Vec<usize>: "list of whole numbers", "a list of whole numbers";
    Vec<f64>: "list of numbers", "a list of numbers";
    Vec<String>: "list of texts", "a list of texts";
    BTreeMap<String, Vec<String>>: "table", "a table of lists of texts";
}

impl<T: Field> Field for Option<T> {
    fn kind() -> String {
        T::kind()
    }

    fn accepted() -> String {
        T::accepted()
    }

    fn choices() -> Vec<(&'static str, &'static str)> {
        T::choices()
    }

    fn read(value: Value, key: &str, accepted: &str) -> Result<Self, ConfigError> {
        T::read(value, key, accepted).map(Some)
    }

    fn check(&self, key: &str) -> Result<(), ConfigError> {
        self.as_ref().map_or(Ok(()), |value| value.check(key))
    }

    fn shown(&self) -> String {
        self.as_ref().map_or_else(|| "none".into(), T::shown)
    }
}

/// A type with a few values, each with a word for it and a line of help. [`crate::choices`] makes one.
pub trait Choice: Copy + Eq + Send + Sync + 'static {
    /// All values: value, word and help.
    const ALL: &'static [(Self, &'static str, &'static str)];

    /// All values.
    const VALUES: &'static [Self];

    /// The value's word.
    fn name(self) -> &'static str {
        Self::ALL.iter().find(|(value, ..)| *value == self).map_or("", |(_, word, _)| word)
    }

    /// The value with this word.
    fn of_name(name: &str) -> Option<Self> {
        Self::ALL.iter().find(|(_, word, _)| *word == name).map(|(value, ..)| *value)
    }

    /// All words, in the order of the declaration.
    fn names() -> impl Iterator<Item = &'static str> {
        Self::ALL.iter().map(|(_, word, _)| *word)
    }

    /// What is accepted, in words, and for a misspelt `name` the nearest word.
    fn accepted_for(name: &str) -> String {
        Self::names().collect::<Vec<_>>().join(", ") + &names::hint(name, Self::names())
    }
}

/// What [`crate::settings`] and [`crate::choices`] expand to uses these.
#[doc(hidden)]
pub mod expansion {
    use super::*;

    /// Declares the field `name` of the table `table`.
    pub fn declare<T: Field>(
        table: &str,
        name: &str,
        accepts: Option<Accepts<T>>,
        default: &T,
        help: &str,
        all: &mut Vec<Setting>,
    ) {
        let default = Value::try_from(default).map_or_else(|_| "none".into(), |value| as_toml(&value));
        let accepted = accepts.map_or_else(T::accepted, |accepts| accepts.words().into());
        let setting = Setting {
            key: below(table, name),
            kind: T::kind(),
            default,
            accepted,
            help: help.trim().into(),
            choices: T::choices(),
        };
        T::declare(setting, all);
    }

    /// Takes the field `name` out of the table `values`, which is called `table`; none if it is not there.
    pub fn take<T: Field>(
        values: &mut Table,
        table: &str,
        name: &str,
        accepts: Option<Accepts<T>>,
    ) -> Result<Option<T>, ConfigError> {
        let Some(value) = values.remove(name) else { return Ok(None) };
        let accepted = accepts.map_or_else(T::accepted, |accepts| accepts.words().into());
        T::read(value, &below(table, name), &accepted).map(Some)
    }

    /// Checks the field `name` of the table that is called `table`.
    pub fn check<T: Field>(
        value: &T,
        table: &str,
        name: &str,
        accepts: Option<Accepts<T>>,
    ) -> Result<(), ConfigError> {
        let key = below(table, name);
        match accepts {
            Some(accepts) if !accepts.test(value) => Err(refuse(&key, value.shown(), accepts.words())),
            _ => value.check(&key),
        }
    }

    /// `value` as a table.
    pub fn table(value: Value, key: &str) -> Result<Table, ConfigError> {
        match value {
            Value::Table(table) => Ok(table),
            other => Err(refuse(key, in_words(&other), "a table of settings")),
        }
    }

    /// Refuses the first of the keys that are left in the table `table`, whose fields are `known`.
    pub fn nothing_left(values: &Table, table: &str, known: &[&str]) -> Result<(), ConfigError> {
        values.keys().next().map_or(Ok(()), |name| Err(super::super::unknown(table, name, known)))
    }

    /// The key of `name` in `table`, which is empty at the top.
    pub fn below(table: &str, name: &str) -> String {
        if table.is_empty() { name.into() } else { format!("{table}.{name}") }
    }

    /// The value of a choice, or a refusal with the nearest word.
    pub fn choice<T: Choice>(value: &Value, key: &str) -> Result<T, ConfigError> {
        let name = in_words(value);
        value.as_str().and_then(T::of_name).ok_or_else(|| refuse(key, &name, &T::accepted_for(&name)))
    }
}

/// `value` as TOML, small numbers with an exponent.
pub(super) fn as_toml(value: &Value) -> String {
    match value {
        Value::Float(number) if *number != 0.0 && number.abs() < 1e-4 => format!("{number:e}"),
        other => other.to_string(),
    }
}

/// `value` as a message shows it: text as it stands, all else as TOML.
pub(super) fn in_words(value: &Value) -> String {
    match value {
        Value::String(text) if !text.is_empty() => text.clone(),
        other => other.to_string(),
    }
}

/// Declares a table of settings: a struct with a default, and all that reading, checking and documenting it needs.
///
/// Each field is `/// help`, then `key: Type = default;` or `key: Type = default, accepts;`, where the type implements
/// [`Field`](crate::config::Field) and `accepts` is an [`Accepts`](crate::config::accepts::Accepts) of it, or of the type
/// in an `Option`. Fields whose type is another table of settings are tables within the table.
///
/// A crate that uses it must depend on `serde`.
#[macro_export]
macro_rules! settings {
    (@accepts $type:ty) => { ::core::option::Option::<$crate::config::accepts::Accepts<$type>>::None };
    (@accepts $type:ty, $accepts:expr) => {
        ::core::option::Option::Some($crate::config::accepts::Accepts::<$type>::from($accepts))
    };
    (
        $(#[$attribute:meta])*
        $vis:vis struct $name:ident {
            $(
                $(#[doc = $help:literal])+
                $field:ident: $type:ty = $default:expr $(, $accepts:expr)?;
            )+
        }
    ) => {
        $(#[$attribute])*
        #[derive(Clone, Debug, PartialEq, ::serde::Serialize, ::serde::Deserialize)]
        $vis struct $name {
            $( $(#[doc = $help])+ pub $field: $type, )+
        }

        impl ::core::default::Default for $name {
            fn default() -> Self {
                Self { $($field: $default),+ }
            }
        }

        impl $crate::config::Field for $name {
            fn kind() -> ::std::string::String {
                "table".into()
            }

            fn read(
                value: $crate::config::Value,
                key: &str,
                _accepted: &str,
            ) -> ::core::result::Result<Self, $crate::config::ConfigError> {
                use $crate::config::expansion;
                let mut values = expansion::table(value, key)?;
                let mut read = Self::default();
                $(
                    let accepts = $crate::settings!(@accepts $type $(, $accepts)?);
                    if let Some(value) = expansion::take(&mut values, key, stringify!($field), accepts)? {
                        read.$field = value;
                    }
                )+
                expansion::nothing_left(&values, key, &[$(stringify!($field)),+])?;
                Ok(read)
            }

            fn check(&self, key: &str) -> ::core::result::Result<(), $crate::config::ConfigError> {
                $(
                    let accepts = $crate::settings!(@accepts $type $(, $accepts)?);
                    $crate::config::expansion::check(&self.$field, key, stringify!($field), accepts)?;
                )+
                Ok(())
            }

            fn declare(table: $crate::config::Setting, all: &mut ::std::vec::Vec<$crate::config::Setting>) {
                let default = Self::default();
                $(
                    let accepts = $crate::settings!(@accepts $type $(, $accepts)?);
                    let help = concat!($($help),+);
                    $crate::config::expansion::declare(
                        &table.key, stringify!($field), accepts, &default.$field, help, all,
                    );
                )+
            }
        }
    };
}

/// Declares a type with a few values: an enum, and for each value `/// help`, then `Variant = "word",`. The word stands for
/// it in configurations, on the command line and in results.
///
/// A crate that uses it must depend on `serde`.
#[macro_export]
macro_rules! choices {
    (
        $(#[$attribute:meta])*
        $vis:vis enum $name:ident {
            $( $(#[doc = $help:literal])+ $variant:ident = $word:literal, )+
        }
    ) => {
        $(#[$attribute])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, ::serde::Serialize, ::serde::Deserialize)]
        $vis enum $name {
            $( $(#[doc = $help])+ #[serde(rename = $word)] $variant, )+
        }

        impl $crate::config::Choice for $name {
            const ALL: &'static [(Self, &'static str, &'static str)] =
                &[$((Self::$variant, $word, concat!($($help),+))),+];
            const VALUES: &'static [Self] = &[$(Self::$variant),+];
        }

        impl $name {
            /// Its word in configurations, on the command line and in results.
            pub fn name(self) -> &'static str {
                $crate::config::Choice::name(self)
            }
        }

        impl ::core::fmt::Display for $name {
            fn fmt(&self, f: &mut ::core::fmt::Formatter<'_>) -> ::core::fmt::Result {
                f.write_str(self.name())
            }
        }

        impl $crate::config::Field for $name {
            fn kind() -> ::std::string::String {
                "choice".into()
            }

            fn accepted() -> ::std::string::String {
                <Self as $crate::config::Choice>::names().collect::<::std::vec::Vec<_>>().join(", ")
            }

            fn choices() -> ::std::vec::Vec<(&'static str, &'static str)> {
                let all = <Self as $crate::config::Choice>::ALL.iter();
                all.map(|(_, word, help)| (*word, help.trim())).collect()
            }

            fn read(
                value: $crate::config::Value,
                key: &str,
                _accepted: &str,
            ) -> ::core::result::Result<Self, $crate::config::ConfigError> {
                $crate::config::expansion::choice(&value, key)
            }
        }
    };
}
