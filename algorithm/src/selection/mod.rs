//! How much of L_o and of L_m a sample trains with: the weight Φ of L_m.
//!
//! A rule is a file of its own. The file has the rule's equation, what the rule remembers from one gradient step to the next,
//! and the bytes that a checkpoint keeps of that memory. `TABLE` lists the rules: configurations, their refusals and the
//! documentation read it, and nothing else names a rule.

mod always;
mod confidence;
mod min_distance;

use crate::losses::MentorKind;
use std::fmt::Debug;
use trestle_proto::config::{ConfigError, Mentor, SelectionRule};

/// The rules in the order in which they are listed: what people and configurations are told of each, and what makes it.
const TABLE: [(SelectionRule, Make); 3] = [
    (min_distance::RULE, min_distance::make),
    (confidence::RULE, confidence::make),
    (always::RULE, always::make),
];

/// Makes a rule.
type Make = fn(&Need<'_>) -> Result<Box<dyn Rule>, SelectionError>;

/// What the making of a rule may need.
#[derive(Clone, Copy, Debug)]
pub struct Need<'a> {
    /// The settings.
    pub mentor: &'a Mentor,
    /// Mentor transitions, 1 or more.
    pub mentor_len: usize,
    /// Capacity of the replay, transitions.
    pub replay: usize,
}

/// Why a rule cannot be had, or its memory not be given back.
#[derive(Debug, thiserror::Error)]
pub enum SelectionError {
    /// The configuration.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The memory cannot be had.
    #[error(
        "no memory for what mentor.selection = {rule} remembers of learner.replay = {replay} transitions"
    )]
    Memory {
        /// The rule.
        rule: &'static str,
        /// Transitions.
        replay: usize,
    },
    /// A saved memory that is none of this rule's.
    #[error("saved memory of the selection rule: {found} bytes; accepted: {accepted}")]
    Bytes {
        /// Its length.
        found: usize,
        /// The length that it should have.
        accepted: usize,
    },
}

/// The stored transition of a sample under the present weights θ.
#[derive(Clone, Copy, Debug)]
pub struct Own {
    /// Its slot in the replay.
    pub slot: usize,
    /// a_o.
    pub action: u32,
    /// Q(s_o, a_o; θ).
    pub q: f32,
}

/// The mentor transition of a sample, which has an L_m, under the present weights θ.
#[derive(Clone, Copy, Debug)]
pub struct Candidate<'a> {
    /// Its number.
    pub j: usize,
    /// Which loss it has.
    pub kind: MentorKind,
    /// a_m: a_est, or a_feas where it is bridged.
    pub action: u32,
    /// e_KL; infinite if no action has been inferred.
    pub e_kl: f32,
    /// Q(s_m, a; θ), one for each action.
    pub q: &'a [f32],
}

impl Candidate<'_> {
    /// Q(s_m, a_m; θ).
    pub fn q_m(&self) -> f32 {
        self.q[self.action as usize]
    }
}

/// A rule with its memory. All but [`Rule::weight`] is about the memory; a rule without one leaves it out.
pub trait Rule: Debug + Send {
    /// Φ, from 0 to 1. It is a constant of the sample: no gradient flows through it.
    fn weight(&self, own: &Own, mentor: &Candidate<'_>) -> f32;

    /// A sample of a gradient step that has a mentor transition, and that transition if it has an L_m. It is called once all
    /// samples of the step have their weights.
    fn trained(&mut self, _own: &Own, _mentor: Option<&Candidate<'_>>) {}

    /// A new transition is in `slot` of the replay.
    fn stored(&mut self, _slot: usize) {}

    /// Whether the rule wants to know the values of transitions that are stored, which costs a forward pass.
    fn values_stored(&self) -> bool {
        false
    }

    /// The values of a new transition that has a mentor transition. It is called if [`Rule::values_stored`].
    fn valued(&mut self, _own: &Own, _mentor: Option<&Candidate<'_>>) {}

    /// The memory as a checkpoint keeps it.
    fn save(&self) -> Vec<u8> {
        Vec::new()
    }

    /// Takes over what [`Rule::save`] gave of a rule with the same settings, whose replay had `stored` transitions.
    ///
    /// # Errors
    /// Bytes that are of another length.
    fn restore(&mut self, bytes: &[u8], _stored: usize) -> Result<(), SelectionError> {
        of_length(bytes, 0)
    }
}

/// What configurations and people are told of each rule.
pub fn rules() -> Vec<SelectionRule> {
    TABLE.iter().map(|(rule, _)| *rule).collect()
}

/// The rule that `need.mentor` asks for, with an empty memory.
///
/// # Errors
/// There is no such rule, it does not go with the other settings, or its memory cannot be had.
pub fn make(need: &Need<'_>) -> Result<Box<dyn Rule>, SelectionError> {
    let chosen = SelectionRule::chosen(&rules(), need.mentor)?;
    let (_, make) = TABLE.iter().find(|(rule, _)| rule.name == chosen.name).unwrap_or(&TABLE[0]);
    make(need)
}

fn of_length(bytes: &[u8], accepted: usize) -> Result<(), SelectionError> {
    let found = bytes.len();
    if found == accepted { Ok(()) } else { Err(SelectionError::Bytes { found, accepted }) }
}

#[cfg(test)]
mod tests;
