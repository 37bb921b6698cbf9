//! Ranges and combinations of settings that types do not exclude.

use super::{Config, ConfigError, DrawKind, EnvKind, HazardKind, Mode, SelectionKind, TargetKind};
use crate::limits::{
    MAX_ACTORS, MAX_BRIDGE_DEPTH, MAX_DEADLINE_S, MAX_MENTORS, MAX_REPLAY, MAX_RESTARTS, MAX_ROLLOUT,
    MAX_SIZES, MAX_WIDTH, MIN_DEADLINE_S, TRANSITIONS_BUFFER,
};
use std::fmt::Display;
use std::ops::RangeBounds;

/// Refuses `value` outside `range`.
fn within<T: PartialOrd + Display>(
    key: &str,
    value: T,
    range: impl RangeBounds<T>,
    accepted: &str,
) -> Result<(), ConfigError> {
    if range.contains(&value) { Ok(()) } else { Err(refuse(key, value, accepted)) }
}

fn refuse(key: &str, value: impl Display, accepted: &str) -> ConfigError {
    ConfigError::Value { key: key.into(), value: value.to_string(), accepted: accepted.into() }
}

/// Refuses what is not a finite number above 0.
fn positive(key: &str, value: f64) -> Result<(), ConfigError> {
    if value.is_finite() && value > 0.0 { Ok(()) } else { Err(refuse(key, value, "a number above 0")) }
}

impl Config {
    /// Checks every range and combination.
    ///
    /// # Errors
    /// The first setting that is out of range, with what is accepted.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.validate_run()?;
        self.validate_env()?;
        self.validate_hazard()?;
        self.validate_exploration()?;
        self.validate_learner()?;
        self.validate_mentor()?;
        self.validate_shaping()?;
        within("eval.every", self.eval.every, 1.., "1 or more")?;
        within("eval.episodes", self.eval.episodes, 1..=MAX_ROLLOUT, "1 to 4096")?;
        within("eval.tolerance", self.eval.tolerance, 0.0..=f64::MAX, "0 or more")?;
        if let Some(threshold) = self.eval.threshold
            && !threshold.is_finite()
        {
            return Err(refuse("eval.threshold", threshold, "a finite number"));
        }
        within("checkpoint.keep", self.checkpoint.keep, 1..=1000, "1 to 1000")?;
        self.validate_supervise()
    }

    fn validate_supervise(&self) -> Result<(), ConfigError> {
        let s = &self.supervise;
        within("supervise.restarts", s.restarts, 0..=MAX_RESTARTS, "0 to 1000")?;
        for (key, seconds) in [("supervise.silence_s", s.silence_s), ("supervise.stall_s", s.stall_s)] {
            if seconds > 0 {
                within(key, seconds, MIN_DEADLINE_S..=MAX_DEADLINE_S, "3 to 86400, or 0 for never")?;
            }
        }
        Ok(())
    }

    fn validate_run(&self) -> Result<(), ConfigError> {
        let run = &self.run;
        within("run.seed", run.seed, 0..=i64::MAX as u64, "0 to 2^63 - 1")?;
        if run.episodes.is_none() && run.env_steps.is_none() {
            return Err(refuse(
                "run.episodes",
                "not given",
                "a number of episodes, or run.env_steps instead",
            ));
        }
        within("run.episodes", run.episodes.unwrap_or(1), 1.., "1 or more")?;
        within("run.env_steps", run.env_steps.unwrap_or(1), 1.., "1 or more")?;
        within("run.actors", run.actors, 1..=MAX_ACTORS, "1 to 64")?;
        within("run.rollout", run.rollout, 1..=MAX_ROLLOUT, "1 to 4096")?;
        if run.mode == Mode::Free {
            within("run.lag", run.lag, ..=0, "0 with run.mode = free, whose actors never wait for a tick")?;
            let least = u64::from(run.actors) * u64::from(run.rollout);
            let most = least * TRANSITIONS_BUFFER as u64;
            let accepted = format!("{least} (run.actors * run.rollout) to {most}, or 0 for twice {least}");
            if run.ahead > 0 {
                within("run.ahead", run.ahead, least..=most, &accepted)?;
            }
            return Ok(());
        }
        within("run.ahead", run.ahead, ..=0, "0 without run.mode = free")?;
        within("run.lag", run.lag, 0..=1, "0 or 1")
    }

    fn validate_env(&self) -> Result<(), ConfigError> {
        let env = &self.env;
        within("env.step_limit", env.step_limit, 1.., "1 or more")?;
        let point = &env.point_maze;
        let magnitudes = "env.point_maze.magnitudes";
        if !(1..=8).contains(&point.magnitudes.len()) {
            return Err(refuse(magnitudes, format!("{:?}", point.magnitudes), "1 to 8 numbers"));
        }
        for (i, &magnitude) in point.magnitudes.iter().enumerate() {
            within(magnitudes, magnitude, f64::MIN_POSITIVE..=1.0, "numbers above 0, up to 1")?;
            if point.magnitudes[..i].contains(&magnitude) {
                return Err(refuse(magnitudes, format!("{:?}", point.magnitudes), "each number once"));
            }
        }
        within("env.point_maze.frame_skip", point.frame_skip, 1..=100, "1 to 100")?;
        within("env.point_maze.goal_reward", point.goal_reward, 0.0..=1e6, "0 to 1000000")?;
        within("env.point_maze.contact_margin", point.contact_margin, 0.0..=0.05, "0 to 0.05")?;
        match self.eval.threshold {
            // Every step costs 0.001, and an episode that is cut off has cost step_limit of them.
            Some(threshold)
                if env.kind == EnvKind::PointMaze
                    && threshold - self.eval.tolerance <= -0.001 * f64::from(env.step_limit) =>
            {
                Err(refuse(
                    "eval.threshold",
                    threshold,
                    &format!(
                        "with eval.tolerance = {} and env.step_limit = {}, above {:.3}: else an episode that never \
                         reaches the goal would count as solved",
                        self.eval.tolerance,
                        env.step_limit,
                        self.eval.tolerance - 0.001 * f64::from(env.step_limit)
                    ),
                ))
            }
            _ => Ok(()),
        }
    }

    fn validate_hazard(&self) -> Result<(), ConfigError> {
        let hazard = &self.env.hazard;
        let kind = hazard.kind.name();
        let refused = |accepted| Err(refuse("env.hazard.kind", kind, accepted));
        match hazard.kind {
            HazardKind::None => return Ok(()),
            _ if self.run.mode == Mode::Reference => {
                return refused("none with run.mode = reference, which has nobody to start it again");
            }
            HazardKind::Stall if self.supervise.stall_s == 0 => {
                return refused("another one with supervise.stall_s = 0, as nobody would ever notice");
            }
            _ => {}
        }
        let accepted = format!("1 or more with env.hazard.kind = {kind}");
        within("env.hazard.after", hazard.after, 1.., &accepted)
    }

    fn validate_exploration(&self) -> Result<(), ConfigError> {
        let e = &self.exploration;
        within("exploration.epsilon_start", e.epsilon_start, 0.0..=1.0, "0 to 1")?;
        within("exploration.epsilon_end", e.epsilon_end, 0.0..=1.0, "0 to 1")?;
        within("exploration.epsilon_spread", e.epsilon_spread, 0.0..=100.0, "0 to 100")?;
        within("exploration.guide_start", e.guide_start, 0.0..=1.0, "0 to 1")?;
        within("exploration.guide_end", e.guide_end, 0.0..=1.0, "0 to 1")
    }

    fn validate_shaping(&self) -> Result<(), ConfigError> {
        let (potential, algo) = (self.shaping.potential, self.run.algo);
        within("shaping.potential", potential, 0.0..=f64::MAX, "0 (no shaping) or more")?;
        if self.shaped() && algo.has_mentor() {
            // The mentor's losses know unshaped rewards only: the two would disagree about every value.
            let accepted = format!("0 with run.algo = {}", algo.name());
            return Err(refuse("shaping.potential", potential, &accepted));
        }
        Ok(())
    }

    fn validate_learner(&self) -> Result<(), ConfigError> {
        let l = &self.learner;
        // Input and output are sizes of the network, too.
        if l.hidden.is_empty() || l.hidden.len() > MAX_SIZES - 2 {
            return Err(refuse("learner.hidden", format!("{:?}", l.hidden), "1 to 6 layers"));
        }
        for &width in &l.hidden {
            within("learner.hidden", width, 1..=MAX_WIDTH, "layers of 1 to 4096 units")?;
        }
        within("learner.gamma", l.gamma, 0.0..=1.0, "0 to 1")?;
        positive("learner.lr", l.lr)?;
        within("learner.adam_beta1", l.adam_beta1, 0.0..1.0, "0 to below 1")?;
        within("learner.adam_beta2", l.adam_beta2, 0.0..1.0, "0 to below 1")?;
        positive("learner.adam_eps", l.adam_eps)?;
        within("learner.max_grad_norm", l.max_grad_norm, 0.0..=f64::MAX, "0 (no clipping) or more")?;
        within("learner.batch", l.batch, 1..=1024, "1 to 1024")?;
        within("learner.warmup", l.warmup, l.batch as u64.., "learner.batch or more")?;
        within("learner.train_every", l.train_every, 1.., "1 or more")?;
        within("learner.replay", l.replay, l.batch..=MAX_REPLAY, "learner.batch to 100000000")?;
        positive("learner.huber_delta", l.huber_delta)?;
        match l.target {
            TargetKind::Hard => within("learner.target_every", l.target_every, 1.., "1 or more"),
            TargetKind::Polyak if l.tau > 0.0 && l.tau <= 1.0 => Ok(()),
            TargetKind::Polyak => Err(refuse("learner.tau", l.tau, "above 0, up to 1")),
        }
    }

    fn validate_mentor(&self) -> Result<(), ConfigError> {
        let m = &self.mentor;
        self.validate_demos()?;
        positive("mentor.sigma_floor", m.sigma_floor)?;
        for (key, threshold) in [("mentor.e_th", m.e_th), ("mentor.e_infeas", m.e_infeas)] {
            let kl = threshold.known().unwrap_or(1.0);
            if !(kl.is_finite() && kl > 0.0) {
                return Err(refuse(key, kl, "a number above 0, or auto"));
            }
        }
        within("mentor.k", m.k, 1..=MAX_BRIDGE_DEPTH, "1 to 64")?;
        within("mentor.n", m.n, 1..=MAX_BRIDGE_DEPTH, "1 to 64")?;
        if m.draw == DrawKind::Uniform && m.selection == SelectionKind::MinDistance {
            // Its past values belong to a stored pair of transitions.
            return Err(refuse("mentor.draw", "uniform", "`similar` with mentor.selection = min-distance"));
        }
        positive("mentor.beta", m.beta)?;
        within("mentor.c_max", m.c_max, 1.., "1 or more")?;
        positive("mentor.e_max", m.e_max)
    }

    fn validate_demos(&self) -> Result<(), ConfigError> {
        let demos = &self.mentor.demo;
        within("mentor.demo", demos.iter().len(), 1..=MAX_MENTORS, "1 to 64 demonstrations")?;
        for (name, source) in demos.iter() {
            let plain = |c: char| c.is_ascii_alphanumeric() || "-_".contains(c);
            if !(1..=40).contains(&name.len()) || !name.chars().all(plain) {
                let accepted = "names of 1 to 40 letters, digits, - and _";
                return Err(refuse("mentor.demo", format!("{{ {name:?} = ... }}"), accepted));
            }
            if source.is_empty() {
                return Err(refuse("mentor.demo", "\"\"", "`plan` or a CSV file"));
            }
        }
        Ok(())
    }
}
