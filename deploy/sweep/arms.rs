//! The arms of a sweep: algorithms as they are, and settings with a name.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::str::FromStr;
use trestle_proto::config::{Algo, Choice, RivalKind};
use trestle_proto::names;
use trestle_suite::set::{MAX_NAME, is_plain};

/// The directory of a scheduler's job files and logs in the sweep's directory.
pub(crate) const SUBMIT: &str = "submit";
/// Directories of a sweep that hold something else: those of its report, and of the jobs that a scheduler got.
const RESERVED: [&str; 2] = ["report", SUBMIT];
/// Arms of a sweep, at most.
pub(crate) const MAX_ARMS: usize = 8192;

/// One arm: a name, and what it sets on top of the sweep's configuration.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Arm {
    /// Its name, which is that of its directory; with [`super::over`] the task's directory and that within it.
    pub(crate) name: String,
    /// `key=value`, as `--set` takes them.
    pub(crate) sets: Vec<String>,
    /// With a suite: what it is trained on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) task: Option<OnTask>,
}

/// What an arm of a suite is trained on, beneath the settings of the sweep and its own.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct OnTask {
    /// The preset, in the place of the sweep's configuration.
    pub(crate) preset: String,
    /// `key=value`.
    pub(crate) sets: Vec<String>,
    /// The file of the demonstration that is made for the task, below the sweep's directory; none if the settings name one.
    pub(crate) demonstration: Option<PathBuf>,
}

/// Rivals by the names that their runs have, each with the algorithm that it is added to and its kind.
const RIVALS: [(&str, Algo, RivalKind); 6] = [
    ("dqn+optimal-transport", Algo::Dqn, RivalKind::OptimalTransport),
    ("dqn+resets", Algo::Dqn, RivalKind::Resets),
    ("diiqn+labels", Algo::Diiqn, RivalKind::InverseDynamics),
    ("ha-diiqn+labels", Algo::HaDiiqn, RivalKind::InverseDynamics),
    ("dqn+d-shape", Algo::Dqn, RivalKind::DShape),
    ("dqn+gaifo", Algo::Dqn, RivalKind::Gaifo),
];

/// The key of `key=value`.
pub(super) fn key_of(set: &str) -> &str {
    set.split('=').next().unwrap_or_default().trim()
}

impl Arm {
    /// An algorithm as it is.
    pub(crate) fn plain(algo: Algo) -> Self {
        Self { name: algo.name().into(), sets: vec![format!("run.algo={:?}", algo.name())], task: None }
    }

    /// Whether the setting `key` is one of its own, which come after those of the sweep.
    pub(crate) fn decides(&self, key: &str) -> bool {
        self.sets.iter().any(|set| key_of(set) == key)
    }

    /// What can stand in --algos: the algorithms, and each rival as it is.
    pub(crate) fn known() -> Vec<Self> {
        let rivals = RIVALS.iter().map(|&(name, algo, kind)| Self {
            name: name.into(),
            sets: vec![format!("run.algo={:?}", algo.name()), format!("rival.kind={:?}", kind.name())],
            task: None,
        });
        Algo::ALL.iter().map(|&(algo, ..)| Self::plain(algo)).chain(rivals).collect()
    }

    /// What to type for one algorithm in the place of `name`, which is the name of a run of it with something added.
    pub(crate) fn instead(name: &str) -> Option<String> {
        let (algo, _) = name.split_once('+')?;
        let rivals = RIVALS.map(|(rival, ..)| rival);
        let rival = RIVALS.iter().find(|(rival, ..)| names::nearest(name, rivals) == Some(rival));
        if let Some((rival, algo, kind)) = rival {
            return Some(format!(
                "for {rival} type --algo {} --set rival.kind={}, or `trestle sweep` with --algos {rival}",
                algo.name(),
                kind.name()
            ));
        }
        let algo = names::nearest(algo, Algo::names())?;
        Some(format!("did you mean `{algo}`? What follows a + in the name of a run comes from settings"))
    }

    /// The one of [`Arm::known`] that is called `name`.
    pub(crate) fn of_name(name: &str) -> Result<Self, String> {
        let known = Self::known();
        let names: Vec<&str> = known.iter().map(|arm| arm.name.as_str()).collect();
        let hint = names::hint(name, names.iter().copied());
        let refused = format!("{name}; accepted: {}{hint}", names.join(", "));
        known.into_iter().find(|arm| arm.name == name).ok_or(refused)
    }
}

impl FromStr for Arm {
    type Err = String;

    /// `NAME:key=value,key=value`. Commas within brackets or quotes belong to the value.
    fn from_str(text: &str) -> Result<Self, String> {
        let (name, rest) = text.split_once(':').ok_or("no colon; accepted: NAME:key=value,key=value")?;
        if !is_plain(name) {
            return Err(format!(
                "the name {name:?}; accepted: 1 to {MAX_NAME} of the letters a-z, A-Z, 0-9 and -_.@+, no dot first"
            ));
        }
        if RESERVED.contains(&name) {
            return Err(format!(
                "the name {name:?}, which is that of another directory; accepted: another one"
            ));
        }
        let sets = pieces(rest)?;
        if let Some(set) = sets.iter().find(|set| !set.contains('=')) {
            return Err(format!("the setting {set:?}; accepted: key=value"));
        }
        // `algo` alone is how the flag is called.
        let full = |set: String| match set.strip_prefix("algo=") {
            Some(algo) => format!("run.algo={algo}"),
            None => set,
        };
        Ok(Self { name: name.into(), sets: sets.into_iter().map(full).collect(), task: None })
    }
}

/// `text` cut at its commas, but for those within brackets or quotes.
pub(crate) fn pieces(text: &str) -> Result<Vec<String>, String> {
    let (mut pieces, mut piece, mut depth, mut quote) = (Vec::new(), String::new(), 0u32, None);
    for c in text.chars() {
        match (c, quote) {
            (_, Some(open)) if c == open => quote = None,
            (_, Some(_)) => {}
            ('"' | '\'', None) => quote = Some(c),
            ('[' | '{', None) => depth += 1,
            (']' | '}', None) => {
                depth = depth.checked_sub(1).ok_or(format!("a bracket too many in {text:?}"))?
            }
            (',', None) if depth == 0 => {
                pieces.push(std::mem::take(&mut piece));
                continue;
            }
            _ => {}
        }
        piece.push(c);
    }
    if depth > 0 || quote.is_some() {
        return Err(format!("a bracket or quote without its end in {text:?}"));
    }
    pieces.push(piece);
    Ok(pieces)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn settings_are_cut_at_their_commas_alone() {
        let arm: Arm =
            "literal:algo=ha-diiqn,learner.hidden=[64, 64],mentor.demo=\"a,b.csv\"".parse().unwrap();
        assert_eq!(arm.name, "literal");
        assert_eq!(arm.sets, ["run.algo=ha-diiqn", "learner.hidden=[64, 64]", "mentor.demo=\"a,b.csv\""]);
    }

    #[test]
    fn what_is_no_arm_is_refused_by_name() {
        for (text, says) in [
            ("literal", "no colon"),
            (":algo=dqn", "name \"\""),
            ("../up:algo=dqn", "name \"../up\""),
            (".hidden:algo=dqn", "no dot first"),
            ("report:algo=dqn", "the name \"report\""),
            ("submit:algo=dqn", "the name \"submit\""),
            ("a:algo", "setting \"algo\""),
            ("a:x=1,,y=2", "setting \"\""),
            ("a:x=[1,2", "without its end"),
            ("a:x=1]", "a bracket too many"),
        ] {
            let error = Arm::from_str(text).unwrap_err();
            assert!(error.contains(says), "{text}: {error}");
        }
    }
}
