//! The agent: all that learns, and nothing that communicates.
//!
//! A loop, distributed or not, calls the same few methods:
//!
//! ```text
//! agent = Agent::new(&experiment, mentor_transitions)
//! each tick, while !agent.done():
//!     each actor's batch, in the order of the actors:
//!         observed = what the mentor-server answers to the batch        (nothing for dqn)
//!         ingested = agent.ingest(&batch, Some(&observed))              counts, stores, reports ended episodes
//!     stats = agent.train()                                             all gradient steps that are due
//!     the actors get agent.acting()
//! ```
//!
//! The agent's state is a function of the experiment and of what was ingested, in this order.

mod counts;
mod error;
mod ingest;
mod rows;
mod samples;
mod state;
mod stats;
mod step;
mod terms;
mod train;

pub use counts::{Counters, MentorRow};
pub use error::AgentError;
pub use ingest::{FinishedEpisode, Ingested};
pub use state::{AgentState, Parts};
pub use stats::{MentorSummary, TrainStats};

use crate::learned_bridges::{Hindsight, Imitation, OwnPaths, hindsight_of, imitation_of, own_of};
use crate::losses::{MentorKind, MentorRule, mentor_term};
use crate::replay::Replay;
use crate::rivals::Rival;
use crate::selection::{self, Need, Rule};
use sha2::{Digest, Sha256};
use std::ops::Range;
use step::Step;
use trestle_proto::NONE;
use trestle_proto::acting::Acting;
use trestle_proto::annotation::AnnotationTable;
use trestle_proto::batch::Batch;
use trestle_proto::config::{CombineKind, DrawKind, Exploration, Learner, LossKind};
use trestle_proto::experiment::Experiment;
use trestle_proto::mentor::MentorTransitions;
use trestle_proto::rng::{Purpose, Stream, stream};
use trestle_proto::space::Success;
use trestle_qnet::{Adam, AdamConfig, Encoding, Loss, QNetwork, init, kernels_of, network_of, threads_of};

/// All that learns. See the module for how it is used.
#[derive(Debug)]
pub struct Agent {
    settings: Settings,
    encoding: Encoding,
    network: QNetwork,
    adam: Adam,
    replay: Replay,
    /// None for `dqn`.
    mentor: Option<MentorSide>,
    /// What learns from the mentor's states in another way, if anything does.
    rival: Option<Rival>,
    /// What learns the policy that guides, with learned bridges.
    hindsight: Option<Hindsight>,
    /// Own paths, and what imitates them.
    own: Option<OwnPaths>,
    imitation: Option<Imitation>,
    /// Draws from the replay.
    rng: Stream,
    counters: Counters,
    /// Environment steps up to which gradient steps have been taken.
    trained_to: u64,
    /// The unfinished episode of each actor.
    running: Vec<Running>,
    step: Step,
    /// What actors get: a copy of the online parameters as of the last [`Agent::train`], and what guides them.
    acting: Acting,
}

/// What the agent takes from the experiment.
#[derive(Clone, Debug)]
struct Settings {
    learner: Learner,
    exploration: Exploration,
    adam: AdamConfig,
    loss: Loss,
    gamma: f32,
    tau: f32,
    /// See [`trestle_proto::space::EnvSpec::goal_bonus`].
    goal_bonus: f32,
    /// What counts as an episode's success.
    success: Success,
    /// The run ends with this many finished episodes or environment steps.
    episodes: Option<u64>,
    env_steps: Option<u64>,
    rule: MentorRule,
    combine: CombineKind,
    draw: DrawKind,
    one_sided: bool,
    /// Whether actors get whole bridges.
    whole: bool,
    /// Whether a policy is learnt as long as there is no own path, whatever the schedules say.
    search: bool,
}

/// What the agent knows of the mentor.
#[derive(Debug)]
struct MentorSide {
    transitions: MentorTransitions,
    /// Mirror of the mentor-server's table.
    annotations: AnnotationTable,
    /// What weighs its loss of a sample against the observer's own.
    selection: Box<dyn Rule>,
    /// For each mentor transition the observer transitions that it was picked for.
    visited: Vec<u64>,
    /// For each mentor transition the samples whose loss had a share of its L_m.
    used: Vec<u64>,
    /// Searches for bridges that met their limit.
    searches_cut_short: u64,
}

impl MentorSide {
    fn new(experiment: &Experiment, transitions: MentorTransitions) -> Result<Self, AgentError> {
        let (config, len) = (&experiment.config, transitions.len());
        let need = Need { mentor: &config.mentor, mentor_len: len, replay: config.learner.replay };
        Ok(Self {
            annotations: AnnotationTable::new(len, experiment.spec.obs_dim(), experiment.spec.n_actions())
                .keeping(experiment.further()),
            selection: selection::make(&need)?,
            visited: vec![0; len],
            used: vec![0; len],
            searches_cut_short: 0,
            transitions,
        })
    }

    fn row(&self, j: usize, rule: &MentorRule) -> MentorRow<'_> {
        let term = mentor_term(rule, j, &self.annotations, &self.transitions, 0.0);
        MentorRow {
            state: self.transitions.state(j),
            first: self.transitions.first(j),
            visited: self.visited[j],
            used: self.used[j],
            estimate: self.annotations.estimate(j),
            feasible: term.is_some_and(|term| term.kind == MentorKind::Feasible),
            bridge: self.annotations.bridge(j),
        }
    }
}

/// An episode under way.
#[derive(Clone, Copy, Debug, Default)]
struct Running {
    total_reward: f64,
    length: u64,
    /// Global index of its first transition in the replay.
    first: u64,
}

impl Agent {
    /// A new agent with the initial weights of the experiment's seed. `mentor` is the demonstration, `experiment.mentor_len()`
    /// transitions of it, exactly where the algorithm learns from one.
    ///
    /// # Errors
    /// A setting that its user refuses, a demonstration that is not the experiment's, or memory that cannot be had.
    pub fn new(experiment: &Experiment, mentor: Option<MentorTransitions>) -> Result<Self, AgentError> {
        let settings = Settings::new(experiment)?;
        let ((layout, encoding), kernels) = (network_of(experiment)?, kernels_of(experiment)?);
        let mentor = match check_mentor(experiment, mentor)? {
            Some(transitions) => Some(MentorSide::new(experiment, transitions)?),
            None => None,
        };
        let seed = experiment.config.run.seed;
        let mut acting = Acting::zeros(experiment.acting());
        acting.weights = init(&layout, &mut stream(seed, Purpose::Weights, 0));
        acting.known.fill(NONE);
        let hindsight = hindsight_of(experiment)?;
        if let Some(hindsight) = &hindsight {
            acting.policy.copy_from_slice(hindsight.params());
        }
        let network = QNetwork::new(layout.clone(), &acting.weights)?.with_kernels(kernels);
        Ok(Self {
            step: Step::new(&layout, settings.learner.batch, kernels, threads_of(experiment)?),
            adam: Adam::new(layout.n_params()),
            replay: Replay::new(settings.learner.replay, experiment.spec.row())?,
            network,
            rival: Rival::new(experiment)?,
            hindsight,
            own: own_of(experiment)?,
            imitation: imitation_of(experiment)?,
            rng: stream(seed, Purpose::Replay, 0),
            counters: Counters::default(),
            trained_to: 0,
            running: vec![Running::default(); experiment.config.run.actors as usize],
            settings,
            encoding,
            mentor,
            acting,
        })
    }

    /// Episodes, environment steps and gradient steps so far.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// Whether the run has reached its number of episodes or of environment steps.
    pub fn done(&self) -> bool {
        self.reaches(self.counters.episodes, self.counters.env_steps)
    }

    /// Whether the run reaches them within `batches`, if these are ingested next.
    pub fn ends_within<'a>(&self, batches: impl Iterator<Item = &'a Batch>) -> bool {
        let Counters { mut episodes, mut env_steps, .. } = self.counters;
        for batch in batches {
            env_steps += batch.len() as u64;
            let ends = |&index: &usize| batch.transition(index).ends_episode();
            episodes += (0..batch.len()).filter(ends).count() as u64;
        }
        self.reaches(episodes, env_steps)
    }

    fn reaches(&self, episodes: u64, env_steps: u64) -> bool {
        let reached = |limit: Option<u64>, count| limit.is_some_and(|limit| count >= limit);
        reached(self.settings.episodes, episodes) || reached(self.settings.env_steps, env_steps)
    }

    /// The online parameters after the last [`Agent::train`] (the initial ones before the first), flat in the order
    /// of the layout.
    pub fn weights(&self) -> &[f32] {
        &self.acting.weights
    }

    /// What actors act with: [`Agent::weights`], and what guides their exploration. The known action of a mentor transition is
    /// that of its loss as of the last [`Agent::ingest`].
    pub fn acting(&self) -> &Acting {
        &self.acting
    }

    /// Shows own paths, where there may be any, to actors and to what imitates them.
    fn publish_own(&mut self) {
        if let Some(own) = &self.own {
            own.publish(&mut self.acting.own);
            if let Some(imitation) = &mut self.imitation {
                imitation.renew(&self.acting.own);
            }
        }
    }

    /// Takes in that the annotation of mentor transition `j` is a new one.
    fn renew_annotated(&mut self, j: usize) {
        if let (Some(rival), Some(mentor)) = (&self.rival, &mut self.mentor) {
            rival.label(j, &mut mentor.annotations);
        }
        self.renew_known(j);
    }

    /// Renews the known action of mentor transition `j`. Afterwards [`Agent::renew_options`] is due.
    fn renew_known(&mut self, j: usize) {
        let Some(mentor) = &self.mentor else { return };
        if let Some(entry) = self.acting.known.get_mut(j) {
            let term = mentor_term(&self.settings.rule, j, &mentor.annotations, &mentor.transitions, 0.0);
            *entry = term.map_or(NONE, |term| term.action);
        }
    }

    /// Renews the options, where there are any: how the bridge of each mentor transition goes on whose known action is the bridge's first.
    fn renew_options(&mut self) {
        let Some(mentor) = self.mentor.as_ref().filter(|_| self.settings.whole) else { return };
        let options = &mut self.acting.options;
        options.clear();
        for j in 0..mentor.transitions.len() {
            let Some(steps) = mentor.annotations.further(j) else { continue };
            let term = mentor_term(&self.settings.rule, j, &mentor.annotations, &mentor.transitions, 0.0);
            if term.is_some_and(|term| term.kind == MentorKind::Bridged) {
                options.push(j as u32, steps);
            }
        }
    }

    /// SHA-256 of [`Agent::weights`] as little-endian bytes, in hexadecimal: equal for runs that learnt the same.
    pub fn weights_sha256(&self) -> String {
        let mut hash = Sha256::new();
        for weight in self.weights() {
            hash.update(weight.to_le_bytes());
        }
        hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// The network: layout, online and target parameters.
    pub fn network(&self) -> &QNetwork {
        &self.network
    }

    /// The replay, from which a mentor-server's history can be rebuilt.
    pub fn replay(&self) -> &Replay {
        &self.replay
    }

    /// The mirror of the mentor-server's annotations; none for `dqn`.
    pub fn annotations(&self) -> Option<&AnnotationTable> {
        self.mentor.as_ref().map(|mentor| &mentor.annotations)
    }

    /// What the annotations of the mentor transitions `range` amount to, under this run's rule of feasibility; none for
    /// `dqn`. Looks at each of them.
    pub fn mentor_summary(&self, range: Range<usize>) -> Option<MentorSummary> {
        Some(MentorSummary::of(&self.settings.rule, self.mentor.as_ref()?, range))
    }

    /// Own paths that are kept; 0 without learned bridges.
    pub fn own_paths(&self) -> usize {
        self.own.as_ref().map_or(0, |own| own.paths().len())
    }

    /// Searches for bridges that met their limit so far; none for `dqn`.
    pub fn searches_cut_short(&self) -> Option<u64> {
        self.mentor.as_ref().map(|mentor| mentor.searches_cut_short)
    }

    /// What is known of each mentor transition, and how often it mattered; none for `dqn`.
    pub fn mentor_rows(&self) -> Option<impl Iterator<Item = MentorRow<'_>>> {
        let (mentor, rule) = (self.mentor.as_ref()?, &self.settings.rule);
        Some((0..mentor.transitions.len()).map(move |j| mentor.row(j, rule)))
    }
}

impl Settings {
    fn new(experiment: &Experiment) -> Result<Self, AgentError> {
        let (run, learner, mentor) =
            (&experiment.config.run, &experiment.config.learner, &experiment.config.mentor);
        let adam = AdamConfig {
            lr: learner.lr,
            beta1: learner.adam_beta1,
            beta2: learner.adam_beta2,
            eps: learner.adam_eps,
        };
        adam.validate()?;
        let loss = match learner.loss {
            LossKind::Huber => Loss::Huber { delta: learner.huber_delta as f32 },
            LossKind::Squared => Loss::Squared,
        };
        loss.validate()?;
        Ok(Self {
            learner: learner.clone(),
            exploration: experiment.config.exploration.clone(),
            adam,
            loss,
            gamma: learner.gamma as f32,
            tau: learner.tau as f32,
            goal_bonus: experiment.spec.goal_bonus,
            success: experiment.success(),
            episodes: run.episodes,
            env_steps: run.env_steps,
            rule: MentorRule::new(run.algo, mentor),
            combine: mentor.combine,
            draw: mentor.draw,
            one_sided: mentor.one_sided,
            whole: experiment.config.whole_bridges(),
            search: mentor.learned.search > 0.0,
        })
    }
}

/// Refuses a demonstration that is not the experiment's.
fn check_mentor(
    experiment: &Experiment,
    mentor: Option<MentorTransitions>,
) -> Result<Option<MentorTransitions>, AgentError> {
    let algo = experiment.config.run.algo;
    let refuse = |what, found, accepted| Err(AgentError::Mentor { algo: algo.name(), what, found, accepted });
    let found = mentor.as_ref().map_or(0, MentorTransitions::len);
    // The smallest demonstration has one transition.
    let accepted = if algo.has_mentor() { experiment.mentor_len().max(1) } else { 0 };
    match mentor {
        _ if found != accepted => refuse("the number of mentor transitions", found, accepted),
        Some(mentor) if mentor.obs_dim() != experiment.spec.obs_dim() => {
            refuse("the number of features of a mentor state", mentor.obs_dim(), experiment.spec.obs_dim())
        }
        mentor => Ok(mentor.filter(|_| algo.has_mentor())),
    }
}

#[cfg(test)]
mod tests;
