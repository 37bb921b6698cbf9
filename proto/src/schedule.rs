//! Schedules over environment steps.

use crate::config::Exploration;

/// ε after `env_steps` environment steps of all actors: from `epsilon_start` to `epsilon_end`, linearly over
/// `epsilon_decay_steps`, constant from then on.
pub fn epsilon(exploration: &Exploration, env_steps: u64) -> f64 {
    linear(exploration.epsilon_start, exploration.epsilon_end, exploration.epsilon_decay_steps, env_steps)
}

/// ε of actor `actor` of `actors` after `env_steps` environment steps of all actors: [`epsilon`] to the power of
/// `1 + epsilon_spread * actor / (actors - 1)`, so that later actors explore less.
pub fn actor_epsilon(exploration: &Exploration, env_steps: u64, actor: u32, actors: u32) -> f64 {
    let epsilon = epsilon(exploration, env_steps);
    if exploration.epsilon_spread == 0.0 || actors < 2 {
        return epsilon;
    }
    epsilon.powf(1.0 + exploration.epsilon_spread * f64::from(actor) / f64::from(actors - 1))
}

/// The share of exploring steps that are guided after `env_steps` environment steps of all actors: from `guide_start`
/// to `guide_end`, linearly over `guide_decay_steps`, or over ε's steps where these are 0, constant from then on.
pub fn guide(exploration: &Exploration, env_steps: u64) -> f64 {
    let decay_steps = match exploration.guide_decay_steps {
        0 => exploration.epsilon_decay_steps,
        steps => steps,
    };
    linear(exploration.guide_start, exploration.guide_end, decay_steps, env_steps)
}

/// Whether a step may still be guided after `env_steps` environment steps of all actors.
pub fn guides(exploration: &Exploration, env_steps: u64) -> bool {
    exploration.guide_end > 0.0 || guide(exploration, env_steps) > 0.0
}

fn linear(start: f64, end: f64, decay_steps: u64, env_steps: u64) -> f64 {
    if env_steps >= decay_steps {
        return end;
    }
    start + env_steps as f64 / decay_steps as f64 * (end - start)
}

/// How many gradient steps are due when the count of environment steps goes from `before` to `after`: one every
/// `train_every` steps once `warmup` steps have been taken.
pub fn gradient_steps_due(before: u64, after: u64, warmup: u64, train_every: u64) -> u64 {
    let due = |steps: u64| steps.saturating_sub(warmup) / train_every;
    due(after) - due(before)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::GuideKind;
    use proptest::prelude::*;

    #[test]
    fn epsilon_is_linear_and_then_constant() {
        let exploration = Exploration {
            epsilon_start: 1.0,
            epsilon_end: 0.1,
            epsilon_decay_steps: 90,
            epsilon_spread: 7.0,
            guide: GuideKind::Known,
            guide_start: 0.5,
            guide_end: 0.0,
            guide_decay_steps: 10,
            guide_whole: false,
        };
        assert_eq!([0, 5, 10].map(|steps| guide(&exploration, steps)), [0.5, 0.25, 0.0]);
        assert_eq!([0, 9, 10].map(|steps| guides(&exploration, steps)), [true, true, false]);
        let tied = Exploration { guide_decay_steps: 0, ..exploration.clone() };
        assert_eq!([0, 45, 90].map(|steps| guide(&tied, steps)), [0.5, 0.25, 0.0]);
        let rising = Exploration { guide_start: 0.0, guide_end: 0.5, ..exploration.clone() };
        assert!(guides(&rising, 0) && guides(&rising, 1000));
        assert_eq!(epsilon(&exploration, 0), 1.0);
        assert!((epsilon(&exploration, 45) - 0.55).abs() < 1e-12);
        assert_eq!(epsilon(&exploration, 90), 0.1);
        assert_eq!(epsilon(&exploration, u64::MAX), 0.1);
        let spread = [0, 1, 2].map(|actor| actor_epsilon(&exploration, 90, actor, 3));
        for (found, power) in spread.iter().zip([1, 45, 8]) {
            let expected = if power == 45 { 0.1f64.powf(4.5) } else { 0.1f64.powi(power) };
            assert!((found - expected).abs() < 1e-12, "{spread:?}");
        }
        assert_eq!(actor_epsilon(&exploration, 90, 0, 1), 0.1);
    }

    proptest! {
        /// However the steps are cut into ticks, as many gradient steps are taken.
        #[test]
        fn due_steps_do_not_depend_on_the_cut(cuts in proptest::collection::vec(0u64..50, 1..40), warmup in 0u64..300, every in 1u64..9) {
            let mut at = 0;
            let mut sum = 0;
            for cut in &cuts {
                sum += gradient_steps_due(at, at + cut, warmup, every);
                at += cut;
            }
            prop_assert_eq!(sum, gradient_steps_due(0, at, warmup, every));
            prop_assert_eq!(sum, at.saturating_sub(warmup) / every);
        }
    }
}
