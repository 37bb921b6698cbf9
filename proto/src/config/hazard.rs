//! `[env.hazard]`: an environment that fails on purpose, to see how a run stands it.

use serde::{Deserialize, Serialize};

/// `[env.hazard]`
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Hazard {
    /// How the environment fails.
    pub kind: HazardKind,
    /// Environment steps that each actor's process takes without harm, counted from its start; every step after them
    /// fails. 1 or more; 0 only where there is no hazard.
    pub after: u64,
    /// Which of an actor's environments fail. The steps of these are counted, and no others.
    pub during: HazardScope,
}

/// How an environment fails.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HazardKind {
    /// It does not.
    #[default]
    None,
    /// The process ends by SIGABRT.
    Abort,
    /// The step panics.
    Panic,
    /// The step is refused with an error.
    Error,
    /// The step never returns; its thread sleeps.
    Stall,
    /// The step gives NaN as its reward.
    NanReward,
    /// The step gives NaN as the last feature of the state reached.
    NanState,
}

impl HazardKind {
    /// Its name in configurations.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Abort => "abort",
            Self::Panic => "panic",
            Self::Error => "error",
            Self::Stall => "stall",
            Self::NanReward => "nan-reward",
            Self::NanState => "nan-state",
        }
    }
}

/// What an environment that fails is used for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HazardScope {
    /// Training and greedy evaluations, whose steps are counted together.
    #[default]
    Both,
    /// Training alone.
    Training,
    /// Greedy evaluations alone, which actor 0 plays.
    Evaluation,
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::config::{Config, load, parse_toml, to_toml};

    fn with(sets: &[&str]) -> Result<Config, String> {
        let sets: Vec<String> = sets.iter().map(ToString::to_string).collect();
        load("maze-small", &sets).map_err(|error| error.to_string())
    }

    #[test]
    fn every_kind_survives_toml_under_its_name() {
        use HazardKind::{Abort, Error, NanReward, NanState, None, Panic, Stall};
        for kind in [None, Abort, Panic, Error, Stall, NanReward, NanState] {
            for (during, scope) in [
                ("both", HazardScope::Both),
                ("training", HazardScope::Training),
                ("evaluation", HazardScope::Evaluation),
            ] {
                let sets = [
                    format!("env.hazard.kind={}", kind.name()),
                    "env.hazard.after=700".into(),
                    format!("env.hazard.during={during}"),
                ];
                let config = load("maze-small", &sets).unwrap();
                assert_eq!(config.env.hazard, Hazard { kind, after: 700, during: scope });
                assert_eq!(parse_toml("again", &to_toml(&config)).unwrap(), config);
            }
        }
    }

    #[test]
    fn what_makes_no_sense_is_refused() {
        let refused = |sets: &[&str]| with(sets).unwrap_err();
        assert_eq!(
            refused(&["env.hazard.kind=abort"]),
            "env.hazard.after = 0; accepted: 1 or more with env.hazard.kind = abort"
        );
        assert!(with(&["env.hazard.after=0"]).is_ok());
        let reference = ["env.hazard.kind=error", "env.hazard.after=5", "run.mode=reference"];
        assert!(
            refused(&reference)
                .starts_with("env.hazard.kind = error; accepted: none with run.mode = reference")
        );
        let unnoticed = ["env.hazard.kind=stall", "env.hazard.after=5", "supervise.stall_s=0"];
        assert!(
            refused(&unnoticed)
                .starts_with("env.hazard.kind = stall; accepted: another one with supervise.stall_s = 0")
        );
        assert!(
            refused(&["env.hazard.kind=sleep"])
                .contains("unknown variant `sleep`, expected one of `none`, `abort`")
        );
        assert!(refused(&["env.hazard.when=5"]).contains("unknown field `when`"));
        assert!(refused(&["env.hazard.after=-1"]).starts_with("env.hazard.after: "));
    }
}
