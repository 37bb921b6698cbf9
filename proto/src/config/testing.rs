//! Two made-up environments for the tests of reading configurations.

use super::accepts::{any, between};
use super::{
    CombineKind, Config, ConfigError, DrawKind, Environments, Field, Preset, RewardKind, SelectionRule,
    Setting, Table, Value, load, refuse,
};
use crate::settings;
use std::collections::BTreeMap;

settings! {
    pub(super) struct Maze {
        /// The map.
        map: String = "small".into(), any("a map");
        /// Action sets.
        action_sets: BTreeMap<String, Vec<String>> = BTreeMap::new();
    }
}

settings! {
    pub(super) struct Cart {
        /// The force.
        force: f64 = 10.0, between(0.0, 100.0);
    }
}

/// `maze` and `cart-pole`.
pub(super) struct Two;

impl Environments for Two {
    fn names(&self) -> Vec<&'static str> {
        vec!["maze", "cart-pole"]
    }

    fn about(&self, name: &str) -> &'static str {
        if name == "maze" { "a maze" } else { "a cart" }
    }

    fn declared(&self, name: &str) -> Vec<Setting> {
        match name {
            "maze" => Maze::declared("env.maze"),
            "cart-pole" => Cart::declared("env.cart-pole"),
            _ => Vec::new(),
        }
    }

    fn complete(&self, name: &str, given: Table) -> Result<Table, ConfigError> {
        fn whole<S: Field>(given: Table) -> Result<Table, ConfigError> {
            let settings = S::read(Value::Table(given), "env", "")?;
            settings.check("env")?;
            Ok(Table::try_from(settings).expect("made for this"))
        }
        if name == "maze" { whole::<Maze>(given) } else { whole::<Cart>(given) }
    }

    fn check(&self, config: &Config) -> Result<(), ConfigError> {
        match config.env.own.get("force").and_then(Value::as_float) {
            Some(force) if force > f64::from(config.env.step_limit) => {
                Err(refuse("env.force", force, "up to env.step_limit"))
            }
            _ => Ok(()),
        }
    }

    fn presets(&self) -> Vec<Preset> {
        vec![
            Preset {
                name: "maze30",
                text: "# A maze.\n[run]\nepisodes = 9\n[env.maze]\nmap = \"maze30\"\n[learner]\nlr = 5e-4\n[mentor]\nselection = \"confidence\"\n",
            },
            Preset {
                name: "maze30-tuned",
                text: "# The same.\nbase = \"maze30\"\n[env]\nencoding = \"one-hot\"\n[learner]\ntrain_every = 1\n",
            },
            Preset { name: "cart", text: "# A cart.\n[run]\nepisodes = 9\n[env]\nname = \"cart-pole\"\n" },
        ]
    }

    fn selections(&self) -> Vec<SelectionRule> {
        let (draws, combines) =
            (&[DrawKind::Similar, DrawKind::Uniform], &[CombineKind::Instead, CombineKind::Beside]);
        let rewards = &[RewardKind::Matched, RewardKind::Observer];
        let rule =
            |name| SelectionRule { name, about: "a rule", remembers: "nothing", draws, combines, rewards };
        let paired = SelectionRule { draws: &[DrawKind::Similar], ..rule("min-distance") };
        vec![paired, rule("confidence"), rule("always")]
    }
}

/// The preset `name` with `sets`.
pub(super) fn with(name: &str, sets: &[&str]) -> Result<Config, ConfigError> {
    load(&Two, name, &sets.iter().map(ToString::to_string).collect::<Vec<_>>())
}
