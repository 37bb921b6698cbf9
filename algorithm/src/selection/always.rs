//! The mentor's loss wherever there is one. Ours, not the papers'.

use super::{Candidate, Need, Own, Rule, SelectionError};
use trestle_proto::config::{Choice, CombineKind, DrawKind, RewardKind, SelectionRule};

pub(super) const RULE: SelectionRule = SelectionRule {
    name: "always",
    about: "The mentor's wherever there is one; not the paper's.",
    remembers: "nothing",
    draws: DrawKind::VALUES,
    combines: CombineKind::VALUES,
    rewards: RewardKind::VALUES,
};

#[derive(Debug)]
struct Always;

pub(super) fn make(_: &Need<'_>) -> Result<Box<dyn Rule>, SelectionError> {
    Ok(Box::new(Always))
}

impl Rule for Always {
    fn weight(&self, _: &Own, _: &Candidate<'_>) -> f32 {
        1.0
    }
}
