//! What a selection rule is to a configuration: its name, and the settings that go with it.

use super::{Choice, CombineKind, ConfigError, DrawKind, Mentor, RewardKind, Setting, refuse};
use crate::names;
use std::fmt::Display;

/// The setting that names a rule.
const KEY: &str = "mentor.selection";

/// The rules of the papers, which need no mention in an algorithm's name.
const OF_THE_PAPERS: [&str; 2] = ["min-distance", "confidence"];

/// A rule that weighs the mentor's loss of a sample against the observer's own, as configurations and people see it. The
/// crate `algorithm` has the rules themselves, and the one table of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SelectionRule {
    /// Its word in `mentor.selection`.
    pub name: &'static str,
    /// What it does, in one sentence.
    pub about: &'static str,
    /// What it keeps from one gradient step to the next, for each of what.
    pub remembers: &'static str,
    /// The values of `mentor.draw` that it can be had with.
    pub draws: &'static [DrawKind],
    /// Those of `mentor.combine`.
    pub combines: &'static [CombineKind],
    /// Those of `mentor.reward`.
    pub rewards: &'static [RewardKind],
}

impl SelectionRule {
    /// The rule in `rules` that `mentor` names, which goes with the other settings of `mentor`.
    ///
    /// # Errors
    /// There is no such rule, or it cannot be had with another setting.
    pub fn chosen(rules: &[Self], mentor: &Mentor) -> Result<Self, ConfigError> {
        let name = mentor.selection.as_str();
        let rule = rules.iter().find(|rule| rule.name == name);
        let rule = rule.ok_or_else(|| Self::refused(rules, name))?;
        rule.goes_with("mentor.draw", mentor.draw, rule.draws)?;
        rule.goes_with("mentor.combine", mentor.combine, rule.combines)?;
        rule.goes_with("mentor.reward", mentor.reward, rule.rewards)?;
        Ok(*rule)
    }

    /// The refusal of `name`, which is none of `rules`.
    pub(super) fn refused(rules: &[Self], name: &str) -> ConfigError {
        let all = rules.iter().map(|rule| rule.name);
        let accepted = format!("{}{}", all.clone().collect::<Vec<_>>().join(", "), names::hint(name, all));
        refuse(KEY, name, &accepted)
    }

    fn goes_with<T: PartialEq + Copy + Display>(
        &self,
        key: &str,
        value: T,
        accepted: &[T],
    ) -> Result<(), ConfigError> {
        if accepted.contains(&value) {
            return Ok(());
        }
        Err(refuse(key, value, &format!("{} with {KEY} = {}", listed(accepted), self.name)))
    }

    /// What `rule` adds to the name of the algorithm in results.
    pub fn suffix(name: &str) -> String {
        if OF_THE_PAPERS.contains(&name) { String::new() } else { format!("+{name}") }
    }

    /// Fills in what the declarations of `mentor.selection`, and of the settings that go with it, cannot know.
    pub(super) fn declare(rules: &[Self], all: &mut [Setting]) {
        for setting in all {
            match setting.key.as_str() {
                KEY => {
                    setting.accepted = rules.iter().map(|rule| rule.name).collect::<Vec<_>>().join(", ");
                    setting.choices = rules.iter().map(|rule| (rule.name, rule.about)).collect();
                }
                "mentor.draw" => except(setting, rules, |rule| rule.draws),
                "mentor.combine" => except(setting, rules, |rule| rule.combines),
                "mentor.reward" => except(setting, rules, |rule| rule.rewards),
                _ => {}
            }
        }
    }
}

/// Says in the help of `setting` with which rules some of its values cannot be had.
fn except<T: Choice + Display>(
    setting: &mut Setting,
    rules: &[SelectionRule],
    accepted: impl Fn(&SelectionRule) -> &'static [T],
) {
    for rule in rules {
        let refused: Vec<T> =
            T::VALUES.iter().copied().filter(|value| !accepted(rule).contains(value)).collect();
        if !refused.is_empty() {
            setting.help += &format!(" Not `{}` with `selection = \"{}\"`.", listed(&refused), rule.name);
        }
    }
}

/// `values`, with commas between them.
pub fn listed<T: Display>(values: &[T]) -> String {
    values.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}
