//! The agent as parts that a checkpoint keeps, and back.

use super::Counters;
use super::{Agent, AgentError, MentorSide, Running};
use crate::learned_bridges::{Hindsight, HindsightState, OwnPath, OwnPaths};
use crate::rivals::{Rival, RivalState};
use serde::{Deserialize, Serialize};
use trestle_proto::mentor::MentorTransitions;
use trestle_proto::rng::Stream;
use trestle_qnet::Adam;

/// What an agent remembers beside its parameters, its optimiser, its replay and its annotations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AgentState {
    /// Episodes, environment steps and gradient steps.
    pub counters: Counters,
    /// Environment steps up to which gradient steps have been taken.
    trained_to: u64,
    /// The stream that draws from the replay.
    rng: Stream,
    /// Return, length and first transition of each actor's unfinished episode.
    running: Vec<(f64, u64, u64)>,
    /// For each mentor transition how often it was picked for an observer transition, and used in a sample's loss.
    visited: Vec<u64>,
    used: Vec<u64>,
    /// Searches for bridges that met their limit.
    searches_cut_short: u64,
    /// What learns the policy of learned bridges.
    hindsight: Option<HindsightState>,
    /// Own paths, and the stream that draws from them.
    own: Vec<OwnPath>,
    imitation: Option<Stream>,
    /// What a rival remembers.
    rival: RivalState,
    /// CRC-32C of the demonstration, so that an agent never goes on with another one.
    demonstration: u32,
}

/// What [`Agent::restore`] needs beside the replay.
#[derive(Clone, Debug)]
pub struct Parts {
    /// Counters, streams, running episodes.
    pub state: AgentState,
    /// Online parameters.
    pub online: Vec<f32>,
    /// Target parameters.
    pub target: Vec<f32>,
    /// The optimiser.
    pub adam: Adam,
    /// Annotation records of every mentor transition; empty for `dqn`.
    pub annotations: Vec<u32>,
    /// What the selection rule remembers; empty for `dqn`.
    pub selection: Vec<u8>,
}

fn fingerprint(transitions: &MentorTransitions) -> u32 {
    let mut words = Vec::new();
    (0..transitions.len()).fold(0, |crc, j| {
        words.clear();
        transitions.encode(j, &mut words);
        crc32c::crc32c_append(crc, bytemuck::cast_slice(&words))
    })
}

impl MentorSide {
    fn records(&self) -> Vec<u32> {
        let mut words = Vec::new();
        (0..self.annotations.len()).for_each(|j| self.annotations.encode(j, &mut words));
        words
    }
}

impl Agent {
    /// The part of the state that is small and its own business.
    pub fn state(&self) -> AgentState {
        AgentState {
            counters: self.counters,
            trained_to: self.trained_to,
            rng: self.rng.clone(),
            running: self.running.iter().map(|r| (r.total_reward, r.length, r.first)).collect(),
            visited: self.mentor.as_ref().map(|mentor| mentor.visited.clone()).unwrap_or_default(),
            used: self.mentor.as_ref().map(|mentor| mentor.used.clone()).unwrap_or_default(),
            searches_cut_short: self.searches_cut_short().unwrap_or(0),
            hindsight: self.hindsight.as_ref().map(|hindsight| hindsight.state().clone()),
            own: self.own.as_ref().map(|own| own.paths().to_vec()).unwrap_or_default(),
            imitation: self.imitation.as_ref().map(|imitation| imitation.rng().clone()),
            rival: self.rival.as_ref().map(Rival::state).unwrap_or_default(),
            demonstration: self.mentor.as_ref().map_or(0, |mentor| fingerprint(&mentor.transitions)),
        }
    }

    /// The optimiser.
    pub fn adam(&self) -> &Adam {
        &self.adam
    }

    /// Annotation records ([`trestle_proto::annotation`]) of every mentor transition; empty for `dqn`. They are
    /// also what a new mentor-server is given when a run is resumed.
    pub fn annotation_records(&self) -> Vec<u32> {
        self.mentor.as_ref().map(MentorSide::records).unwrap_or_default()
    }

    /// What the selection rule remembers ([`crate::selection::Rule::save`]); none for `dqn`.
    pub fn selection(&self) -> Option<Vec<u8>> {
        self.mentor.as_ref().map(|mentor| mentor.selection.save())
    }

    /// Gives a new agent of the same experiment the state of another. Its replay must have been read before.
    ///
    /// # Errors
    /// Parts that are not of this experiment, or do not belong together.
    pub fn restore(&mut self, parts: &Parts) -> Result<(), AgentError> {
        let state = &parts.state;
        let mentor_len = self.mentor.as_ref().map_or(0, |mentor| mentor.transitions.len());
        let demonstration = self.mentor.as_ref().map_or(0, |mentor| fingerprint(&mentor.transitions));
        let n_params = self.network.layout().n_params();
        let moments = |moments: &[f32]| moments.len() as u64;
        for (what, found, accepted) in [
            ("the number of actors", state.running.len() as u64, self.running.len() as u64),
            ("the number of visit counts", state.visited.len() as u64, mentor_len as u64),
            ("the number of use counts", state.used.len() as u64, mentor_len as u64),
            ("the demonstration's checksum", state.demonstration.into(), demonstration.into()),
            ("the number of first moments", moments(&parts.adam.m), n_params as u64),
            ("the number of second moments", moments(&parts.adam.v), n_params as u64),
            ("the number of optimiser steps", parts.adam.step, state.counters.grad_steps),
            ("the number of stored transitions", self.replay.next_index(), state.counters.env_steps),
        ] {
            if found != accepted {
                return Err(AgentError::Restore { what, found, accepted });
            }
        }
        if state.trained_to > state.counters.env_steps {
            let (found, accepted) = (state.trained_to, state.counters.env_steps);
            return Err(AgentError::Restore { what: "the step trained up to", found, accepted });
        }
        let hindsight = match (&mut self.hindsight, &state.hindsight) {
            (Some(own), Some(saved)) => own.restore(saved),
            (own, saved) => own.is_none() && saved.is_none(),
        };
        if !hindsight {
            let params = |state: Option<&HindsightState>| state.map_or(0, |state| state.params.len() as u64);
            return Err(AgentError::Restore {
                what: "the number of parameters of learned bridges",
                found: params(state.hindsight.as_ref()),
                accepted: params(self.hindsight.as_ref().map(Hindsight::state)),
            });
        }
        let obs_dim = self.replay.obs_dim();
        let own = match &mut self.own {
            Some(own) => own.restore(&state.own, obs_dim),
            None => state.own.is_empty(),
        };
        if !own {
            let most = self.own.as_ref().map_or(0, OwnPaths::most) as u64;
            return Err(AgentError::Restore {
                what: "the number of own paths that are whole",
                found: state.own.len() as u64,
                accepted: most,
            });
        }
        if let (Some(imitation), Some(rng)) = (&mut self.imitation, &state.imitation) {
            imitation.restore(rng);
        }
        if let Some(mentor) = &mut self.mentor {
            mentor.annotations.apply(&parts.annotations)?;
            mentor.selection.restore(&parts.selection, self.replay.len())?;
            mentor.visited.copy_from_slice(&state.visited);
            mentor.used.copy_from_slice(&state.used);
            mentor.searches_cut_short = state.searches_cut_short;
        }
        self.replay.relink();
        self.network.load(&parts.online, &parts.target)?;
        self.acting.weights.copy_from_slice(&parts.online);
        if let Some(hindsight) = &self.hindsight {
            self.acting.policy.copy_from_slice(hindsight.params());
        }
        self.publish_own();
        (0..mentor_len).for_each(|j| self.renew_known(j));
        self.renew_options();
        let rival = match &mut self.rival {
            Some(rival) => rival.restore(&state.rival, &self.replay),
            None => state.rival == RivalState::None,
        };
        if !rival {
            return Err(AgentError::RivalState);
        }
        self.adam.clone_from(&parts.adam);
        self.counters = state.counters;
        self.trained_to = state.trained_to;
        self.rng = state.rng.clone();
        self.running = state
            .running
            .iter()
            .map(|&(total_reward, length, first)| Running { total_reward, length, first })
            .collect();
        Ok(())
    }

    /// Forgets return and length of `actor`'s unfinished episode: it will have no end.
    pub fn abandon_episode(&mut self, actor: u32) {
        self.running[actor as usize] = Running::default();
    }

    /// The replay, to be read from a checkpoint.
    pub fn replay_mut(&mut self) -> &mut crate::replay::Replay {
        &mut self.replay
    }
}
