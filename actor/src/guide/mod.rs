//! Guided exploration (ours, not the paper's): an action that an exploring step takes instead of a random one.
//!
//! - `known`: the action that is known for the mentor state nearest to where the actor is, and perhaps the rest of its bridge;
//! - `learned`: an action of a policy that leads along the mentor's path.

mod known;
mod learned;

pub use known::{Known, UnderWay};
pub use learned::Learned;

use crate::error::ActorError;
use serde::{Deserialize, Serialize};
use trestle_proto::acting::Acting;
use trestle_proto::batch::Tally;
use trestle_proto::experiment::Experiment;
use trestle_proto::rng::Stream;

/// What guides exploring steps.
pub enum Guide {
    /// Known actions.
    Known(Box<Known>),
    /// Learned bridges.
    Learned(Box<Learned>),
}

/// What of a guide belongs to a snapshot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Progress {
    /// Of known actions: the option under way.
    Known(UnderWay),
    /// Of learned bridges.
    Learned(Box<learned::Progress>),
}

impl Guide {
    /// The guide of `experiment`'s run; none without guided exploration.
    ///
    /// # Errors
    /// Settings that give no state distance or no network.
    pub fn new(experiment: &Experiment) -> Result<Option<Self>, ActorError> {
        let known = Known::new(experiment)?.map(|guide| Self::Known(Box::new(guide)));
        let learned =
            || Ok::<_, ActorError>(Learned::new(experiment)?.map(|guide| Self::Learned(Box::new(guide))));
        known.map_or_else(learned, |known| Ok(Some(known)))
    }

    /// Steps are about to be taken with `acting`, the first of them in `obs`.
    pub fn renew(&mut self, acting: &Acting, obs: &[f32]) {
        if let Self::Learned(guide) = self {
            guide.renew(acting, obs);
        }
    }

    /// Whether the episode looks for the first success, and explores as at a run's start.
    pub fn searches(&self) -> bool {
        matches!(self, Self::Learned(guide) if guide.searches())
    }

    /// Whether an episode may still do so, whatever the schedules say.
    pub fn may_search(&self, acting: &Acting) -> bool {
        matches!(self, Self::Learned(guide) if guide.may_search(acting))
    }

    /// The action in `obs`, if the guide has one. A learned guide draws it from `rng`.
    pub fn action(&mut self, obs: &[f32], acting: &Acting, rng: &mut Stream) -> Option<u32> {
        match self {
            Self::Known(guide) => guide.action(obs, acting),
            Self::Learned(guide) => guide.action(obs, &acting.policy, rng),
        }
    }

    /// The next action of the whole bridge that is followed, in `obs`, if there is one.
    pub fn go_on(&mut self, obs: &[f32]) -> Option<u32> {
        match self {
            Self::Known(guide) => guide.go_on(obs),
            Self::Learned(_) => None,
        }
    }

    /// No whole bridge is followed any more.
    pub fn leave(&mut self) {
        if let Self::Known(guide) = self {
            guide.leave();
        }
    }

    /// An episode begins in `obs`.
    pub fn begin(&mut self, obs: &[f32], rng: &mut Stream) {
        if let Self::Learned(guide) = self {
            guide.begin(obs, rng);
        }
    }

    /// A step of the episode, with the reward that is reported, has led to `obs`.
    pub fn follow(&mut self, obs: &[f32], reward: f64) {
        if let Self::Learned(guide) = self {
            guide.follow(obs, reward);
        }
    }

    /// The episode has ended, and the environment `said` that it succeeded, or not.
    pub fn finish(&mut self, said: bool) {
        if let Self::Learned(guide) = self {
            guide.finish(said);
        }
    }

    /// What the guide has done since it was asked last.
    pub fn take_tally(&mut self) -> Tally {
        match self {
            Self::Known(_) => Tally::default(),
            Self::Learned(guide) => guide.take_tally(),
        }
    }

    /// What belongs to a snapshot; none where nothing does.
    pub fn progress(&self) -> Option<Progress> {
        match self {
            Self::Known(guide) => guide.under_way().cloned().map(Progress::Known),
            Self::Learned(guide) => Some(Progress::Learned(Box::new(guide.progress().clone()))),
        }
    }

    /// Whether `progress`, of a snapshot, can be that of `guide`.
    pub fn fits(guide: Option<&Self>, progress: Option<&Progress>) -> bool {
        match (guide, progress) {
            (Some(Self::Known(guide)), Some(Progress::Known(under_way))) => guide.fits(under_way),
            (Some(Self::Learned(guide)), Some(Progress::Learned(progress))) => guide.fits(progress),
            (Some(Self::Known(guide)), None) => guide.under_way().is_none(),
            (None, None) => true,
            _ => false,
        }
    }

    /// Goes on from `progress`, which [`Guide::fits`].
    pub fn restore(&mut self, progress: Progress) {
        match (self, progress) {
            (Self::Known(guide), Progress::Known(under_way)) => guide.restore(under_way),
            (Self::Learned(guide), Progress::Learned(progress)) => guide.restore(*progress),
            _ => {}
        }
    }
}
