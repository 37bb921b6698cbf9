//! Rules over several settings, which no setting's own declaration can state.

use super::accepts::{at_least, between};
use super::learner::MAX_HIDDEN;
use super::{Algo, Config, ConfigError, Field, GuideKind, HazardKind, Mode, RivalKind, refuse};
use crate::limits::{MAX_REPLAY, TRANSITIONS_BUFFER};

impl Config {
    /// Checks every setting, and every combination of settings, but for those that only the environment or the
    /// selection rule knows.
    ///
    /// # Errors
    /// The first setting that is not accepted, with what is.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.check("")?;
        self.check_limits()?;
        self.check_streaming()?;
        self.check_hazard()?;
        self.check_learner()?;
        self.check_mentor()?;
        self.check_rival()
    }

    /// A run ends at some time.
    fn check_limits(&self) -> Result<(), ConfigError> {
        if self.run.episodes.is_none() && self.run.env_steps.is_none() {
            let accepted = "a number of episodes, or run.env_steps instead";
            return Err(refuse("run.episodes", "not given", accepted));
        }
        Ok(())
    }

    /// `lag` is lockstep's, `ahead` is free mode's.
    fn check_streaming(&self) -> Result<(), ConfigError> {
        let run = &self.run;
        if run.mode != Mode::Free {
            return require(run.ahead == 0, "run.ahead", run.ahead, "0 without run.mode = free");
        }
        let accepted = "0 with run.mode = free, whose actors never wait for a tick";
        require(run.lag == 0, "run.lag", run.lag, accepted)?;
        let least = u64::from(run.actors) * u64::from(run.rollout);
        let most = least * TRANSITIONS_BUFFER as u64;
        let accepted = format!("{least} (run.actors * run.rollout) to {most}, or 0 for twice {least}");
        require(run.ahead == 0 || (least..=most).contains(&run.ahead), "run.ahead", run.ahead, &accepted)
    }

    /// A process that fails on purpose is started again, and its failure is noticed.
    fn check_hazard(&self) -> Result<(), ConfigError> {
        let hazard = &self.env.hazard;
        let refused = |accepted| Err(refuse("env.hazard.kind", hazard.kind, accepted));
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
        let accepted = format!("1 or more with env.hazard.kind = {}", hazard.kind);
        require(hazard.after > 0, "env.hazard.after", hazard.after, &accepted)
    }

    /// A gradient step finds as many transitions as it samples.
    fn check_learner(&self) -> Result<(), ConfigError> {
        let learner = &self.learner;
        let (convs, most) = (learner.conv.len(), MAX_HIDDEN - learner.conv.len().min(MAX_HIDDEN));
        let accepted = format!("{most} layers behind {convs} convolutions");
        require(learner.hidden.len() <= most, "learner.hidden", learner.hidden.shown(), &accepted)?;
        let warm = at_least(learner.batch as u64).test(&learner.warmup);
        require(warm, "learner.warmup", learner.warmup, "learner.batch or more")?;
        let holds = between(learner.batch, MAX_REPLAY).test(&learner.replay);
        let accepted = format!("learner.batch to {MAX_REPLAY}");
        require(holds, "learner.replay", learner.replay, &accepted)
    }

    fn check_mentor(&self) -> Result<(), ConfigError> {
        let (mentor, algo, potential) = (&self.mentor, self.run.algo, self.shaping.potential);
        // The mentor's losses know unshaped rewards only: the two would disagree about every value.
        let accepted = format!("0 with run.algo = {algo}");
        require(!(self.shaped() && algo.has_mentor()), "shaping.potential", potential, &accepted)?;
        let e = &self.exploration;
        let learned = algo != Algo::Trestle || e.guide != GuideKind::Known;
        require(learned, "exploration.guide", e.guide, "auto or learned with run.algo = trestle")?;
        let some = algo != Algo::Trestle || self.guide().is_some();
        let accepted = "above 0 with run.algo = trestle, or exploration.guide_end above 0";
        require(some, "exploration.guide_start", e.guide_start, accepted)?;
        if e.guide_whole {
            let whole = |fits, accepted: &str| require(fits, "exploration.guide_whole", true, accepted);
            let accepted = format!("false with run.algo = {algo}, which has no bridges; ha-diiqn has some");
            whole(algo == Algo::HaDiiqn, &accepted)?;
            whole(mentor.bridges, "false with mentor.bridges = false")?;
            whole(mentor.k > 1, "false with mentor.k = 1, where each bridge has one step")?;
            let accepted =
                "false without a guide; exploration.guide_start or exploration.guide_end above 0 gives one";
            whole(self.guide().is_some(), accepted)?;
            let accepted = "false with exploration.guide = learned, which follows no bridges";
            whole(self.guide() == Some(GuideKind::Known), accepted)?;
        }
        let learned = &mentor.learned;
        let paths = learned.imitate == 0.0 || learned.own_paths > 0;
        let accepted = "1 or more with mentor.learned.imitate above 0";
        require(paths, "mentor.learned.own_paths", learned.own_paths, accepted)
    }

    /// A rival's rewards are unknown to a mentor's losses, and two rivals at once would be none.
    fn check_rival(&self) -> Result<(), ConfigError> {
        let (kind, algo, potential) = (self.rival.kind, self.run.algo, self.shaping.potential);
        let (fits, accepted) = match kind {
            RivalKind::None => return Ok(()),
            RivalKind::InverseDynamics => (algo.has_mentor(), "diiqn or ha-diiqn"),
            // Guides compare states with the mentor's, and know of no goals and no other beginnings.
            RivalKind::Resets | RivalKind::DShape => {
                (algo == Algo::Dqn && self.guide().is_none(), "dqn without a guide")
            }
            RivalKind::OptimalTransport | RivalKind::Gaifo => (!algo.has_mentor(), "dqn or trestle"),
        };
        require(fits, "run.algo", algo, &format!("{accepted} with rival.kind = {kind}"))?;
        let accepted = format!("0 with rival.kind = {kind}");
        require(!self.shaped(), "shaping.potential", potential, &accepted)
    }
}

/// Refuses the setting `key` with its `value` unless `condition` holds.
fn require(
    condition: bool,
    key: &str,
    value: impl std::fmt::Display,
    accepted: &str,
) -> Result<(), ConfigError> {
    if condition { Ok(()) } else { Err(refuse(key, value, accepted)) }
}
