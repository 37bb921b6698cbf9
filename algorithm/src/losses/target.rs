//! The value that a Q-value is regressed onto.

use trestle_qnet::argmax;

/// Value of a next state from its Q-values, one an action, at least one.
///
/// Plain DQN, as (2), (3) and (6) have it: the largest value under the target network (`online` is `None`).
/// Double DQN (van Hasselt et al. 2016, an option of ours): the target network's value of the action that is best
/// under the `online` network. Ties go to the lowest action. A NaN is never preferred to a number.
#[inline]
pub fn next_value(target: &[f32], online: Option<&[f32]>) -> f32 {
    target[argmax(online.unwrap_or(target))]
}

/// What n steps bring: r_0 + γ r_1 + ... + γ^(m-1) r_(m-1), and γ^m, the weight of what comes after. There is at least one
/// reward; with one alone it is r_0 and γ to the bit.
#[inline]
pub fn n_step(gamma: f32, mut rewards: impl Iterator<Item = f32>) -> (f32, f32) {
    let first = (rewards.next().unwrap_or(0.0), gamma);
    rewards.fold(first, |(sum, discount), reward| (sum + discount * reward, discount * gamma))
}

/// r + γ V(s'), and r alone where there is no `next` value: a terminal state does not bootstrap. An episode that
/// a step limit cut off ends in no terminal state and does.
#[inline]
pub fn target_value(reward: f32, gamma: f32, next: Option<f32>) -> f32 {
    next.map_or(reward, |value| reward + gamma * value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_targets_take_the_maximum_and_double_ones_the_chosen_action() {
        let (target, online) = ([1.0, 5.0, 3.0], [0.0, 1.0, 2.0]);
        assert_eq!(next_value(&target, None), 5.0);
        assert_eq!(next_value(&target, Some(&online)), 3.0);
        // Of the equal actions 0 and 2 the first is chosen.
        assert_eq!(next_value(&target, Some(&[2.0, 1.0, 2.0])), 1.0);
    }

    #[test]
    fn rewards_of_n_steps_are_discounted_step_by_step() {
        assert_eq!(n_step(0.5, [-0.0].into_iter()).0.to_bits(), (-0.0f32).to_bits());
        assert_eq!(n_step(0.5, [3.0].into_iter()), (3.0, 0.5));
        assert_eq!(n_step(0.5, [1.0, 2.0, 4.0].into_iter()), (3.0, 0.125));
    }

    #[test]
    fn only_a_terminal_state_has_no_value() {
        assert_eq!(target_value(-0.5, 0.5, Some(3.0)), 1.0);
        assert_eq!(target_value(-0.5, 0.5, None), -0.5);
    }
}
