//! From a mentor transition and its annotation to the terms of the mentor's loss.

use trestle_proto::annotation::AnnotationTable;
use trestle_proto::config::{Algo, Mentor, RewardKind};
use trestle_proto::mentor::MentorTransitions;

/// How mentor transitions become terms of the loss.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MentorRule {
    /// The algorithm.
    pub algo: Algo,
    /// A transition is feasible below this e_KL (`ha-diiqn`).
    pub e_infeas: f32,
    /// Whether infeasible ones may use a bridge (`ha-diiqn`).
    pub bridges: bool,
    /// Whose reward is used.
    pub reward: RewardKind,
}

impl MentorRule {
    /// The rule that a configuration asks for. Before `auto` has become a number, nothing is feasible.
    pub fn new(algo: Algo, mentor: &Mentor) -> Self {
        let e_infeas = mentor.e_infeas.known().unwrap_or(0.0) as f32;
        Self { algo, e_infeas, bridges: mentor.bridges, reward: mentor.reward }
    }
}

/// Which loss a mentor transition has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MentorKind {
    /// (3): the observer can do what the mentor did.
    Feasible,
    /// (6): it cannot, but knows a way around.
    Bridged,
}

/// What the mentor's loss of one sample needs beside s_m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MentorTerm {
    /// Equation (3) or (6).
    pub kind: MentorKind,
    /// a_m, or a_feas.
    pub action: u32,
    /// Whether its next state is terminal and so has no value.
    pub terminal: bool,
    /// The reward of the target.
    pub reward: f32,
    /// e_KL of the transition; infinite if no action has been inferred.
    pub e_kl: f32,
}

impl MentorTerm {
    /// The next state of the term, which is that of mentor transition `j`: s'_m, or s_feas.
    pub fn next_obs<'a>(
        &self,
        j: usize,
        annotations: &'a AnnotationTable,
        transitions: &'a MentorTransitions,
    ) -> &'a [f32] {
        let bridge = annotations.bridge(j).filter(|_| self.kind == MentorKind::Bridged);
        bridge.map_or_else(|| transitions.next_state(j), |bridge| bridge.next_obs)
    }
}

/// The term of mentor transition `j` for a sample whose own reward is `r_o`; none where the mentor has nothing to
/// say.
///
/// `diiqn` takes every transition with an estimate as feasible. `ha-diiqn` takes those with e_KL below `e_infeas`,
/// and for the others the first step of the bridge, if there is one and bridges are wanted (paper, "Augmented
/// loss"). With the reward rule `observer` the reward is `r_o`, as (3) and (6) are written; with `matched` (our
/// choice, the default) it is what the observer got when it took a_est, or the bridge's first step: r_o belongs to
/// another action.
pub fn mentor_term(
    rule: &MentorRule,
    j: usize,
    annotations: &AnnotationTable,
    transitions: &MentorTransitions,
    r_o: f32,
) -> Option<MentorTerm> {
    let reward = |matched| match rule.reward {
        RewardKind::Matched => matched,
        RewardKind::Observer => r_o,
    };
    let e_kl = annotations.errors()[j];
    let feasible = match rule.algo {
        Algo::Dqn | Algo::Trestle => return None,
        Algo::Diiqn => true,
        Algo::HaDiiqn => e_kl < rule.e_infeas,
    };
    if feasible {
        let estimate = annotations.estimate(j)?;
        return Some(MentorTerm {
            kind: MentorKind::Feasible,
            action: estimate.action,
            terminal: transitions.terminal(j),
            reward: reward(estimate.reward),
            e_kl,
        });
    }
    let bridge = annotations.bridge(j).filter(|_| rule.bridges)?;
    Some(MentorTerm {
        kind: MentorKind::Bridged,
        action: bridge.action,
        terminal: bridge.terminated,
        reward: reward(bridge.reward),
        e_kl,
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use trestle_proto::annotation::{Bridge, Estimate};

    /// Transition 0 unknown, 1 feasible, 2 infeasible without a bridge, 3 infeasible with one, 4 a bridge alone.
    fn world() -> (AnnotationTable, MentorTransitions) {
        let mut transitions = MentorTransitions::new(1);
        (0..5).for_each(|j| transitions.push(&[j as f32], &[j as f32 + 1.0], j == 1));
        let mut table = AnnotationTable::new(5, 1, 4);
        table.set_estimate(1, &Estimate { action: 2, e_kl: 0.05, start_kl: 0.0, reward: -0.1 });
        table.set_estimate(2, &Estimate { action: 3, e_kl: 0.1, start_kl: 0.0, reward: -0.2 });
        table.set_estimate(3, &Estimate { action: 1, e_kl: 0.5, start_kl: 0.0, reward: -0.3 });
        for j in [3, 4] {
            let next_obs = &[9.0];
            let bridge = Bridge {
                action: 0,
                length: 2,
                reward: -0.4,
                end_kl: 0.0,
                next_obs,
                terminated: j == 4,
                ahead: 1,
            };
            table.set_bridge(j, &bridge);
        }
        (table, transitions)
    }

    fn rule(algo: Algo, bridges: bool, reward: RewardKind) -> MentorRule {
        MentorRule { algo, e_infeas: 0.1, bridges, reward }
    }

    fn kinds(rule: &MentorRule) -> [Option<(MentorKind, u32, f32)>; 5] {
        let (table, transitions) = world();
        std::array::from_fn(|j| {
            mentor_term(rule, j, &table, &transitions, 7.0).map(|t| (t.kind, t.action, t.reward))
        })
    }

    #[test]
    fn each_algorithm_uses_what_it_may() {
        use MentorKind::{Bridged, Feasible};
        let matched = RewardKind::Matched;
        assert_eq!(kinds(&rule(Algo::Dqn, true, matched)), [None; 5]);
        let diiqn =
            [None, Some((Feasible, 2, -0.1)), Some((Feasible, 3, -0.2)), Some((Feasible, 1, -0.3)), None];
        assert_eq!(kinds(&rule(Algo::Diiqn, true, matched)), diiqn);
        let bridged = Some((Bridged, 0, -0.4));
        // e_KL equal to the threshold is infeasible.
        let ha = [None, Some((Feasible, 2, -0.1)), None, bridged, bridged];
        assert_eq!(kinds(&rule(Algo::HaDiiqn, true, matched)), ha);
        let gated = [None, Some((Feasible, 2, -0.1)), None, None, None];
        assert_eq!(kinds(&rule(Algo::HaDiiqn, false, matched)), gated);
    }

    #[test]
    fn the_literal_reward_is_the_observers() {
        let rewards = kinds(&rule(Algo::HaDiiqn, true, RewardKind::Observer)).map(|k| k.map(|k| k.2));
        assert_eq!(rewards, [None, Some(7.0), None, Some(7.0), Some(7.0)]);
    }

    #[test]
    fn next_states_and_ends_are_the_mentors_or_the_bridges() {
        let (table, transitions) = world();
        let rule = rule(Algo::HaDiiqn, true, RewardKind::Matched);
        let term = |j| mentor_term(&rule, j, &table, &transitions, 0.0).unwrap();
        let found = |j| (term(j).next_obs(j, &table, &transitions), term(j).terminal, term(j).e_kl);
        assert_eq!(found(1), (&[2.0][..], true, 0.05));
        assert_eq!(found(3), (&[9.0][..], false, 0.5));
        assert_eq!(found(4), (&[9.0][..], true, f32::INFINITY));
    }
}
