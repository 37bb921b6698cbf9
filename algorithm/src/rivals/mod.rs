//! Rivals: other people's ways to learn from the mentor's states, as arms to compare with. docs/rivals.md describes each of them,
//! and the names of runs tell them apart.
//!
//! A rival plugs into the agent in few places, and a run without one passes them by:
//!
//! - *Rewards.* Whatever a rival adds to a reward lies beside the replay, one number a slot, and enters L_o when a sample is drawn
//!   ([`Shown::added`]). So the replay, its files, and what is reported of an episode hold the environment's own rewards. A rival may
//!   fill in its numbers when a transition is stored ([`Rival::store`]), when its episode ends ([`Rival::finish`]), or before each
//!   gradient step ([`Rival::prepare`]).
//! - *Samples.* A rival may show other transitions than those that were drawn ([`Shown::view`]).
//! - *Networks.* A rival's own network is updated once after each gradient step ([`Rival::learn`]).
//! - *Annotations.* Labels are written over a_est in the learner's copy of the annotations ([`Rival::label`]), where L_m finds them.
//! - *Episodes.* What a rival changes about the environment is done by the actor: where an episode begins, and what is observed.
//! - *State.* What follows from the replay alone is computed anew when a run is resumed. All else is part of the agent's state
//!   ([`RivalState`]).

pub mod dshape;
pub mod gaifo;
pub mod labels;
pub mod shaping;
pub mod sinkhorn;
pub mod transport;

use crate::replay::Replay;
use crate::similarity::metric::{APART, MetricError};
use dshape::{DShape, DShapeState, View};
use gaifo::{Gaifo, GaifoState};
use labels::{Labels, LabelsState};
use serde::{Deserialize, Serialize};
use shaping::Shaping;
use transport::{MAX_PAIRS, Transport};
use trestle_proto::annotation::AnnotationTable;
use trestle_proto::config::RivalKind;
use trestle_proto::experiment::Experiment;
use trestle_proto::mentor::MentorTransitions;
use trestle_qnet::PlanError;

/// The rival of a run, as far as it is the learner's business.
#[derive(Debug)]
pub enum Rival {
    /// Potential-based shaping.
    Shaping(Box<Shaping>),
    /// Rewards by optimal transport.
    Transport(Box<Transport>),
    /// Labels of an inverse model.
    Labels(Box<Labels>),
    /// Goals.
    DShape(Box<DShape>),
    /// Rewards of a discriminator.
    Gaifo(Box<Gaifo>),
}

/// All that a checkpoint has to keep of a [`Rival`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum RivalState {
    /// Nothing.
    #[default]
    None,
    /// What is added to the reward of the transition in each slot of the replay.
    Added(Vec<f32>),
    /// Labels and their model.
    Labels(Box<LabelsState>),
    /// Drawn goals.
    DShape(Box<DShapeState>),
    /// A discriminator.
    Gaifo(Box<GaifoState>),
}

/// What a gradient step sees of a rival. Nothing for most runs.
#[derive(Clone, Copy, Debug, Default)]
pub struct Shown<'a> {
    /// What is added to the reward of the transition in each slot.
    pub added: Option<&'a [f32]>,
    /// What takes the place of the transitions that were drawn.
    pub view: Option<&'a View>,
}

/// A run for which a rival cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum RivalError {
    /// The state distance.
    #[error(transparent)]
    Metric(#[from] MetricError),
    /// A rival's network.
    #[error(transparent)]
    Network(#[from] PlanError),
    /// Too many states for a plan between them.
    #[error(
        "rival.kind = optimal-transport: an episode of {steps} steps (env.step_limit) and a trajectory of {states} states are \
         {} pairs; accepted: up to {MAX_PAIRS}", steps.saturating_mul(*states)
    )]
    Pairs {
        /// Steps of the longest episode.
        steps: usize,
        /// States of the mentor's longest trajectory.
        states: usize,
    },
}

impl Rival {
    /// The rival of `experiment`, if the learner has to do with it.
    ///
    /// # Errors
    /// Settings that give no state distance or no network.
    pub fn new(experiment: &Experiment) -> Result<Option<Self>, RivalError> {
        Ok(match experiment.config.rival.kind {
            RivalKind::None => Shaping::new(experiment)?.map(|shaping| Self::Shaping(Box::new(shaping))),
            RivalKind::OptimalTransport => {
                Transport::new(experiment)?.map(|rival| Self::Transport(Box::new(rival)))
            }
            RivalKind::Resets => None,
            RivalKind::InverseDynamics => Some(Self::Labels(Box::new(Labels::new(experiment)?))),
            RivalKind::DShape => DShape::new(experiment)?.map(|rival| Self::DShape(Box::new(rival))),
            RivalKind::Gaifo => Gaifo::new(experiment)?.map(|rival| Self::Gaifo(Box::new(rival))),
        })
    }

    /// The transition in `slot` of `replay` has just been stored.
    pub fn store(&mut self, replay: &Replay, slot: usize) {
        match self {
            Self::Shaping(shaping) => shaping.store(replay, slot),
            Self::Transport(transport) => transport.store(slot),
            Self::DShape(dshape) => dshape.store(slot),
            Self::Labels(_) | Self::Gaifo(_) => {}
        }
    }

    /// An episode of `length` steps has ended, the first of which has global index `first` in `replay`.
    pub fn finish(&mut self, replay: &Replay, first: u64, length: u64) {
        match self {
            Self::Transport(transport) => transport.finish(replay, first, length),
            Self::DShape(dshape) => dshape.finish(replay, first, length),
            Self::Shaping(_) | Self::Labels(_) | Self::Gaifo(_) => {}
        }
    }

    /// The transitions in `slots` of `replay`, each with up to `steps` - 1 after it, are about to be trained with.
    pub fn prepare(&mut self, replay: &Replay, slots: &[u32], steps: usize) {
        match self {
            Self::DShape(dshape) => dshape.show(replay, slots, steps),
            Self::Gaifo(gaifo) => gaifo.refresh(replay, slots, steps),
            Self::Shaping(_) | Self::Transport(_) | Self::Labels(_) => {}
        }
    }

    /// What the gradient step sees.
    pub fn shown(&self) -> Shown<'_> {
        match self {
            Self::Shaping(shaping) => Shown { added: Some(shaping.added()), view: None },
            Self::Transport(transport) => Shown { added: Some(transport.added()), view: None },
            Self::Gaifo(gaifo) => Shown { added: Some(gaifo.added()), view: None },
            Self::DShape(dshape) => Shown { added: None, view: Some(dshape.view()) },
            Self::Labels(_) => Shown::default(),
        }
    }

    /// A gradient step has been taken. Whether all of the mentor's transitions have been labelled anew.
    pub fn learn(&mut self, replay: &Replay, transitions: Option<&MentorTransitions>) -> bool {
        match self {
            Self::Labels(labels) => {
                let due = labels.update(replay);
                let Some(transitions) = transitions.filter(|_| due) else { return false };
                labels.label(transitions);
                return true;
            }
            Self::Gaifo(gaifo) => _ = gaifo.update(replay),
            Self::Shaping(_) | Self::Transport(_) | Self::DShape(_) => {}
        }
        false
    }

    /// Writes what the rival knows better over the annotation of mentor transition `j`.
    pub fn label(&self, j: usize, annotations: &mut AnnotationTable) {
        if let Self::Labels(labels) = self {
            labels.put(j, annotations);
        }
    }

    /// What a checkpoint keeps.
    pub fn state(&self) -> RivalState {
        match self {
            Self::Shaping(_) => RivalState::None,
            Self::Transport(transport) => RivalState::Added(transport.added().to_vec()),
            Self::Labels(labels) => RivalState::Labels(Box::new(labels.state())),
            Self::DShape(dshape) => RivalState::DShape(Box::new(dshape.state().clone())),
            Self::Gaifo(gaifo) => RivalState::Gaifo(Box::new(gaifo.state().clone())),
        }
    }

    /// Goes on as another one did that had this `state` and this `replay`. Whether the state can be this rival's.
    #[must_use]
    pub fn restore(&mut self, state: &RivalState, replay: &Replay) -> bool {
        match (self, state) {
            (Self::Shaping(shaping), RivalState::None) => {
                shaping.store_all(replay);
                true
            }
            (Self::Transport(transport), RivalState::Added(added)) => transport.restore(added),
            (Self::Labels(labels), RivalState::Labels(state)) => labels.restore(state),
            (Self::DShape(dshape), RivalState::DShape(state)) => dshape.restore(state),
            (Self::Gaifo(gaifo), RivalState::Gaifo(state)) => gaifo.restore(state),
            _ => false,
        }
    }
}

/// The Euclidean distance of two whitened states, in which categories that differ are one unit apart.
fn distance(a: &[f32], b: &[f32]) -> f32 {
    let square = |(x, y): (&f32, &f32)| if (x - y).abs() < APART { (x - y) * (x - y) } else { 1.0 };
    a.iter().zip(b).map(square).sum::<f32>().sqrt()
}

/// Whether `experiment` is one that its rival accepts.
///
/// # Errors
/// More work or memory than a rival takes.
pub fn check(experiment: &Experiment) -> Result<(), RivalError> {
    let (RivalKind::OptimalTransport, Some(waypoints)) =
        (experiment.config.rival.kind, &experiment.waypoints)
    else {
        return Ok(());
    };
    let states = waypoints.lengths().max().unwrap_or(0);
    let steps = experiment.config.env.step_limit as usize;
    if steps.saturating_mul(states) > MAX_PAIRS { Err(RivalError::Pairs { steps, states }) } else { Ok(()) }
}
