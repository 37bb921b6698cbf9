//! How much of a mentor reached the training of a run or of an arm, and whether that is next to nothing.

use serde::Serialize;
use std::fmt;
use trestle_proto::run_result::RunResult;

/// A mentor whose loss trained fewer of the samples than this has next to no effect.
pub const LEAST_LOSS: f64 = 0.01;

/// What decides how much of a mentor an observer can use.
pub const SETTINGS: &str =
    "mentor.e_infeas, mentor.e_th, mentor.covariance, mentor.k, mentor.n, mentor.selection";

/// The figures of one run, or their means over several; all of them are shares, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Effect {
    /// The mentor's transitions that are taken as feasible at the end.
    pub feasible_frac: f64,
    /// The mentor's transitions that are infeasible and have a bridge at the end.
    pub bridged_frac: f64,
    /// The samples of all gradient steps that were trained with the mentor's loss.
    pub loss_frac: f64,
}

impl Effect {
    /// The effect that `result` tells of; none without a mentor or a gradient step, and none of a version that did not count it.
    pub fn of(result: &RunResult) -> Option<Self> {
        let (feasible, bridged) = (result.mentor_feasible_frac?, result.mentor_bridged_frac?);
        Some(Self { feasible_frac: feasible, bridged_frac: bridged, loss_frac: result.mentor_loss_frac? })
    }

    /// The mean of `effects`; none of none.
    pub fn mean(effects: &[Self]) -> Option<Self> {
        let n = effects.len() as f64;
        let mean = |of: fn(&Self) -> f64| effects.iter().map(of).sum::<f64>() / n;
        (!effects.is_empty()).then(|| Self {
            feasible_frac: mean(|e| e.feasible_frac),
            bridged_frac: mean(|e| e.bridged_frac),
            loss_frac: mean(|e| e.loss_frac),
        })
    }

    /// A sentence that says so and names the settings to look at, where the mentor had next to no effect.
    pub fn warning(&self) -> Option<String> {
        (self.loss_frac < LEAST_LOSS).then(|| {
            format!("the mentor had next to no effect ({self}); settings that decide about it: {SETTINGS}")
        })
    }
}

impl fmt::Display for Effect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let percent = |share: f64| format!("{:.1} %", 100.0 * share);
        write!(
            f,
            "{} of its transitions feasible, {} bridged, its loss in {} of the samples",
            percent(self.feasible_frac),
            percent(self.bridged_frac),
            percent(self.loss_frac)
        )
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn next_to_nothing_is_said_with_figures_and_settings() {
        let of = |bridged| {
            Effect::of(&RunResult {
                mentor_feasible_frac: Some(0.0),
                mentor_bridged_frac: bridged,
                mentor_loss_frac: Some(0.008),
                ..RunResult::default()
            })
        };
        let effect = of(Some(0.125)).unwrap();
        let warning = effect.warning().unwrap();
        assert!(
            warning.contains("0.0 % of its transitions feasible, 12.5 % bridged, its loss in 0.8 %"),
            "{warning}"
        );
        assert!(warning.contains("mentor.e_infeas, mentor.e_th"), "{warning}");
        assert_eq!(Effect { loss_frac: LEAST_LOSS, ..effect }.warning(), None);
        assert_eq!(of(None), None);
    }

    #[test]
    fn an_arm_has_the_mean_of_its_runs() {
        let one = Effect { feasible_frac: 1.0, bridged_frac: 0.0, loss_frac: 0.5 };
        let other = Effect { feasible_frac: 0.0, bridged_frac: 0.5, loss_frac: 0.0 };
        let mean = Effect { feasible_frac: 0.5, bridged_frac: 0.25, loss_frac: 0.25 };
        assert_eq!((Effect::mean(&[one, other]), Effect::mean(&[])), (Some(mean), None));
    }
}
