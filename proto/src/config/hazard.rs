//! `[env.hazard]`: an environment that fails on purpose, to see how a run stands it.

use super::accepts::any;
use crate::{choices, settings};

settings! {
    /// `[env.hazard]`
    #[derive(Copy)]
    pub struct Hazard {
        /// How the environment fails. Only `none` with `mode = "reference"`, and no `stall` with `supervise.stall_s = 0`.
        kind: HazardKind = HazardKind::None;
        /// Environment steps that each actor's process takes without harm, counted from its start. Every later step fails.
        after: u64 = 0, any("1 or more; 0 with `kind = \"none\"`");
        /// Which of an actor's environments fail. Only their steps are counted.
        during: HazardScope = HazardScope::Both;
    }
}

choices! {
    /// How an environment fails.
    pub enum HazardKind {
        /// It does not.
        None = "none",
        /// The process ends by SIGABRT.
        Abort = "abort",
        /// The step panics.
        Panic = "panic",
        /// The step is refused with an error.
        Error = "error",
        /// The step never returns; its thread sleeps.
        Stall = "stall",
        /// The step gives NaN as its reward.
        NanReward = "nan-reward",
        /// The step gives NaN as the last feature of the state reached.
        NanState = "nan-state",
        /// The step takes a millisecond longer, and does no harm: a stand-in for slow environments.
        Slow = "slow",
    }
}

choices! {
    /// What an environment that fails is used for.
    pub enum HazardScope {
        /// Training and greedy evaluations, whose steps are counted together.
        Both = "both",
        /// Training alone.
        Training = "training",
        /// Greedy evaluations alone, which actor 0 plays.
        Evaluation = "evaluation",
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::config::testing::with;
    use crate::config::{parse_toml, to_toml};

    #[test]
    fn every_kind_survives_toml_under_its_name() {
        use HazardKind::{Abort, Error, NanReward, NanState, None, Panic, Slow, Stall};
        for kind in [None, Abort, Panic, Error, Stall, NanReward, NanState, Slow] {
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
                let config = with("maze30", &sets.each_ref().map(String::as_str)).unwrap();
                assert_eq!(config.env.hazard, Hazard { kind, after: 700, during: scope });
                assert_eq!(parse_toml("again", &to_toml(&config)).unwrap(), config);
            }
        }
    }

    #[test]
    fn what_makes_no_sense_is_refused() {
        let refused = |sets: &[&str]| with("maze30", sets).unwrap_err().to_string();
        assert_eq!(
            refused(&["env.hazard.kind=abort"]),
            "env.hazard.after = 0; accepted: 1 or more with env.hazard.kind = abort"
        );
        assert!(with("maze30", &["env.hazard.after=0"]).is_ok());
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
            refused(&["env.hazard.kind=stal"])
                .starts_with("env.hazard.kind = stal; accepted: none, abort, panic, error, stall,")
        );
        assert!(refused(&["env.hazard.kind=stal"]).ends_with("; did you mean `stall`?"));
        assert_eq!(
            refused(&["env.hazard.when=5"]),
            "env.hazard.when: there is no such setting; accepted in [env.hazard]: kind, after, during"
        );
        assert_eq!(
            refused(&["env.hazard.after=-1"]),
            "env.hazard.after = -1; accepted: 1 or more; 0 with `kind = \"none\"`"
        );
    }
}
