//! What every arm is trained on: `--over env.map=random:1:20x20,random:2:20x20` crosses the arms with two maps.

use super::arms::{Arm, pieces};
use std::str::FromStr;

/// A setting with several values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Over {
    key: String,
    values: Vec<String>,
}

impl FromStr for Over {
    type Err = String;

    /// `key=value,value`. Commas within brackets or quotes belong to the value.
    fn from_str(text: &str) -> Result<Self, String> {
        let (key, values) = text.split_once('=').ok_or("no equals sign; accepted: KEY=VALUE,VALUE")?;
        let values = pieces(values)?;
        if key.is_empty() || values.iter().any(|value| value.trim().is_empty()) {
            return Err("an empty key or value; accepted: KEY=VALUE,VALUE".into());
        }
        if ["run.seed", "run.algo", "algo"].contains(&key) {
            return Err(format!("the key {key}; accepted: any but those of --seeds and --algos"));
        }
        Ok(Self { key: key.into(), values })
    }
}

impl Over {
    /// The setting of `value`, and the name of a directory for it: the key's last word, and the value's letters.
    fn setting(&self, value: &str) -> (String, String) {
        let word = self.key.rsplit('.').next().unwrap_or(&self.key);
        let letter = |c: char| if c.is_ascii_alphanumeric() || "_.@".contains(c) { c } else { '-' };
        let value_name: String = value.chars().map(letter).collect();
        (format!("{}={value}", self.key), format!("{word}-{}", value_name.trim_matches(['-', '.'])))
    }
}

/// Every arm of `arms` with every combination of the values of `over`. An arm's own settings win.
pub(crate) fn cross(arms: Vec<Arm>, over: &[Over]) -> Vec<Arm> {
    let mut tasks = vec![(String::new(), Vec::new())];
    for axis in over {
        let with = |(name, sets): &(String, Vec<String>)| -> Vec<(String, Vec<String>)> {
            let values = axis.values.iter().map(|value| {
                let (set, word) = axis.setting(value);
                let name = if name.is_empty() { word } else { format!("{name}+{word}") };
                (name, sets.iter().cloned().chain([set]).collect())
            });
            values.collect()
        };
        tasks = tasks.iter().flat_map(with).collect();
    }
    if over.is_empty() {
        return arms;
    }
    let of_task = |(task, sets): &(String, Vec<String>)| -> Vec<Arm> {
        let arms = arms.iter().map(|arm| Arm {
            name: format!("{task}/{}", arm.name),
            sets: sets.iter().chain(&arm.sets).cloned().collect(),
            task: arm.task.clone(),
        });
        arms.collect()
    };
    tasks.iter().flat_map(of_task).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn every_arm_meets_every_combination() {
        let arms = vec![Arm::plain(trestle_proto::config::Algo::Dqn), "x:learner.lr=1e-3".parse().unwrap()];
        assert_eq!(cross(arms.clone(), &[]), arms);
        let over = ["env.map=random:1:9x9,maps/a.txt", "learner.hidden=[8,8],[16]"];
        let over: Vec<Over> = over.iter().map(|text| text.parse().unwrap()).collect();
        let crossed = cross(arms, &over);
        assert_eq!(crossed.len(), 8);
        assert_eq!(crossed[0].name, "map-random-1-9x9+hidden-8-8/dqn");
        assert_eq!(crossed[7].name, "map-maps-a.txt+hidden-16/x");
        assert_eq!(crossed[7].sets, ["env.map=maps/a.txt", "learner.hidden=[16]", "learner.lr=1e-3"]);
    }

    #[test]
    fn what_is_no_axis_is_refused() {
        for text in ["env.map", "=a", "env.map=", "env.map=a,,b", "run.seed=1,2", "algo=dqn"] {
            assert!(text.parse::<Over>().unwrap_err().contains("accepted"), "{text}");
        }
    }
}
