//! One actor without any transport: it collects batches, plays greedy evaluations, and can be saved and restored.

use crate::env::hazard::Hazards;
use crate::env::{Environment, Frame, registry};
use crate::error::{ActorError, Moment, Number};
use crate::guide::{Guide, Progress};
use crate::policy::Policy;
use crate::rivals;
use serde::{Deserialize, Serialize};
use trestle_algorithm::reference;
use trestle_link::pulse;
use trestle_proto::acting::{Acting, Lengths};
use trestle_proto::batch::{Batch, BatchHeader, FIRST, SUCCEEDED, TERMINATED, TRUNCATED, Tally, Transition};
use trestle_proto::codec::{self, Kind};
use trestle_proto::config::{self, Hazard, HazardScope};
use trestle_proto::episode::Episode;
use trestle_proto::experiment::Experiment;
use trestle_proto::incarnation::Incarnation;
use trestle_proto::limits::{MAX_REPLY_BYTES, MAX_ROLLOUT};
use trestle_proto::orders::Collect;
use trestle_proto::reply::{Evaluation, EvaluationEpisode};
use trestle_proto::rng::{Purpose, Stream, stream};
use trestle_proto::row::Element;
use trestle_proto::schedule;
use trestle_proto::space::{Success, reported};
use trestle_qnet::{kernels_of, network_of};

/// What the frame of an actor's state says that it is.
pub const STATE_KIND: Kind = Kind { magic: *b"TRACTOR\0", version: 5 };

/// Most features in the paths of one evaluation, 4 bytes each, so that its reply stays below
/// [`MAX_REPLY_BYTES`].
const MAX_PATH_FEATURES: usize = MAX_REPLY_BYTES / 8;

/// The state of one actor.
pub struct Worker {
    index: u32,
    /// Actors of the run.
    actors: u32,
    /// See [`Worker::incarnation`].
    incarnation: Incarnation,
    seed: u64,
    exploration: config::Exploration,
    policy: Policy,
    guide: Option<Guide>,
    /// Whether a step may still be guided, by the last orders; the guide has nothing to do otherwise.
    guides: bool,
    /// Lengths of what it acts with.
    lengths: Lengths,
    env: Box<dyn Environment>,
    /// Type of its features.
    element: Element,
    /// For greedy episodes, so that they leave `env` alone.
    evaluation_env: Box<dyn Environment>,
    /// What counts as an episode's success.
    success: Success,
    explore: Stream,
    environment: Stream,
    /// Where `env` is.
    obs: Vec<f32>,
    /// Where a step of either environment has led.
    next_obs: Vec<f32>,
    /// Where `evaluation_env` is.
    evaluation_obs: Vec<f32>,
    /// Whether the next transition is the first of its episode.
    first: bool,
    /// The actor's own number of the next transition.
    seq: u64,
}

/// What a snapshot holds.
#[derive(Serialize, Deserialize)]
struct State {
    index: u32,
    seq: u64,
    first: bool,
    obs: Vec<f32>,
    env: Vec<u8>,
    explore: Stream,
    environment: Stream,
    guide: Option<Progress>,
}

impl reference::Actor for Worker {
    type Error = ActorError;

    fn collect(&mut self, acting: &Acting, order: &Collect, batch: &mut Batch) -> Result<(), ActorError> {
        Self::collect(self, acting, order, batch)
    }

    fn evaluate(&mut self, acting: &Acting, number: u64, episodes: u32) -> Result<Evaluation, ActorError> {
        let evaluation = Self::evaluate(self, &acting.weights, number, episodes)?;
        Ok(Evaluation { guide_return: self.evaluate_guide(&acting.policy, number)?, ..evaluation })
    }
}

impl Worker {
    /// Actor `index` of the run that `experiment` describes, at the start of its first episode, outside of that run's
    /// processes: `env.hazard` has no effect.
    ///
    /// # Errors
    /// A configuration that gives no environment or no network, an experiment whose spaces are not those of its
    /// environment, an index that the run does not have, or an environment whose first state is not finite.
    pub fn new(experiment: &Experiment, index: u32) -> Result<Self, ActorError> {
        Self::with(experiment, index, Incarnation::default(), Hazard::default())
    }

    /// The same as incarnation `incarnation` of that actor, with random streams of its own, in a process of the run.
    ///
    /// # Errors
    /// As [`Worker::new`].
    pub fn replacing(
        experiment: &Experiment,
        index: u32,
        incarnation: Incarnation,
    ) -> Result<Self, ActorError> {
        Self::with(experiment, index, incarnation, experiment.config.env.hazard)
    }

    fn with(
        experiment: &Experiment,
        index: u32,
        incarnation: Incarnation,
        hazard: Hazard,
    ) -> Result<Self, ActorError> {
        let run = &experiment.config.run;
        if index >= run.actors {
            return Err(ActorError::Index { index, last: run.actors.saturating_sub(1) });
        }
        let hazards = Hazards::new(hazard);
        let built =
            |training| rivals::around(registry().build(&experiment.config.env)?, experiment, training);
        let mut env = hazards.around(built(true)?, HazardScope::Training);
        if *env.spec() != experiment.spec {
            let (planned, built) = (experiment.spec.name.clone(), env.spec().name.clone());
            return Err(ActorError::Spec { planned, built });
        }
        let (layout, encoding) = network_of(experiment)?;
        let obs_dim = experiment.spec.obs_dim();
        let who = u64::from(index) + (u64::from(incarnation) << 32);
        let mut environment = stream(run.seed, Purpose::Environment, who);
        let mut obs = vec![0.0; obs_dim];
        env.reset(&mut environment, &mut obs)?;
        check_numbers(index, Moment::Steps(0), experiment.spec.element, &obs, 0.0)?;
        let mut explore = stream(run.seed, Purpose::Explore, who);
        let mut guide = Guide::new(experiment)?;
        if let Some(guide) = &mut guide {
            guide.begin(&obs, &mut explore);
        }
        Ok(Self {
            index,
            actors: run.actors,
            incarnation,
            seed: run.seed,
            exploration: experiment.config.exploration.clone(),
            policy: Policy::new(layout, encoding, kernels_of(experiment)?),
            guide,
            guides: true,
            lengths: experiment.acting(),
            env,
            element: experiment.spec.element,
            evaluation_env: hazards.around(built(false)?, HazardScope::Evaluation),
            success: experiment.success(),
            explore,
            environment,
            obs,
            next_obs: vec![0.0; obs_dim],
            evaluation_obs: vec![0.0; obs_dim],
            first: true,
            seq: 0,
        })
    }

    /// Index of the actor, from 0.
    pub fn index(&self) -> u32 {
        self.index
    }

    /// What is counted together, in free mode: the number of the learner's start above that of the replacements of this
    /// actor since.
    pub fn incarnation(&self) -> Incarnation {
        self.incarnation
    }

    /// Goes on as incarnation `incarnation`, at the beginning of an episode. The random streams go on.
    ///
    /// # Errors
    /// An environment whose first state is not finite.
    pub fn begin(&mut self, incarnation: Incarnation) -> Result<(), ActorError> {
        (self.incarnation, self.seq, self.first) = (incarnation, 0, true);
        self.reset()
    }

    /// Begins an episode.
    fn reset(&mut self) -> Result<(), ActorError> {
        self.env.reset(&mut self.environment, &mut self.obs)?;
        check_numbers(self.index, Moment::Steps(self.seq), self.element, &self.obs, 0.0)?;
        if let Some(guide) = &mut self.guide {
            guide.leave();
            if self.guides {
                guide.begin(&self.obs, &mut self.explore);
            }
        }
        Ok(())
    }

    /// Features of an observation.
    pub fn obs_dim(&self) -> usize {
        self.obs.len()
    }

    /// Lengths of what it acts with.
    pub fn lengths(&self) -> Lengths {
        self.lengths
    }

    /// Takes `order.steps` steps with `acting` and writes them to `batch`, header included; an episode that ends is followed
    /// by the next one. Allocates only while `batch` grows.
    ///
    /// Step s of actor i explores with the ε of environment step `order.env_steps + i * order.steps + s`: the place
    /// that the step has among those of all actors.
    ///
    /// # Errors
    /// Parts of other lengths, or an amount out of range; nothing has happened then. An environment that fails or gives what
    /// is not finite.
    pub fn collect(&mut self, acting: &Acting, order: &Collect, batch: &mut Batch) -> Result<(), ActorError> {
        let (found, expected) = (acting.lengths(), self.lengths);
        if found != expected {
            return Err(ActorError::Acting { found, expected });
        }
        check_amount("steps", order.steps)?;
        let weights = &acting.weights;
        batch.prepare(BatchHeader {
            run: order.run,
            round: order.round,
            first_seq: self.seq,
            weights_version: order.weights_version,
            actor: self.index,
            incarnation: self.incarnation,
            count: order.steps,
            obs_dim: self.obs.len() as u32,
            element: self.element.code(),
            reserved: 0,
            guide: Tally::default(),
        });
        let before = order.env_steps.saturating_add(u64::from(self.index) * u64::from(order.steps));
        let searching = self.guide.as_ref().is_some_and(|guide| guide.may_search(acting));
        self.guides = searching || schedule::guides(&self.exploration, before);
        if let Some(guide) = self.guide.as_mut().filter(|_| self.guides) {
            guide.renew(acting, &self.obs);
        }
        for s in 0..order.steps {
            let at = before.saturating_add(u64::from(s));
            let epsilon = schedule::actor_epsilon(&self.exploration, at, self.index, self.actors);
            let (obs, rng) = (&self.obs, &mut self.explore);
            let action = match self.guide.as_mut().filter(|_| self.guides) {
                None => self.policy.act(weights, obs, epsilon, rng),
                Some(guide) => guide.go_on(obs).unwrap_or_else(|| {
                    let (epsilon, share) = match guide.searches() {
                        true => (self.exploration.epsilon_start, self.exploration.guide_start),
                        false => (epsilon, schedule::guide(&self.exploration, at)),
                    };
                    self.policy
                        .act_guided(weights, obs, epsilon, share, rng, |rng| guide.action(obs, acting, rng))
                }),
            };
            let step = self.env.step(action, &mut self.next_obs)?;
            pulse::step();
            // The learner checks it as well, but this process is the one to blame, and to be replaced.
            check_numbers(self.index, Moment::Steps(self.seq), self.element, &self.next_obs, step.reward)?;
            let flags = if self.first { FIRST } else { 0 }
                | if step.terminated { TERMINATED } else { 0 }
                | if step.truncated { TRUNCATED } else { 0 }
                | if step.success { SUCCEEDED } else { 0 };
            let (obs, next_obs) = (&self.obs, &self.next_obs);
            batch.set(s as usize, &Transition { obs, next_obs, action, reward: step.reward, flags });
            self.seq += 1;
            self.first = step.terminated || step.truncated;
            if let Some(guide) = self.guide.as_mut().filter(|_| self.guides) {
                guide.follow(&self.next_obs, reported(step.reward, step.success, self.env.spec().goal_bonus));
                if self.first {
                    guide.finish(step.success);
                }
            }
            if self.first {
                self.reset()?;
            } else {
                std::mem::swap(&mut self.obs, &mut self.next_obs);
            }
        }
        batch.header.guide = self.guide.as_mut().map(Guide::take_tally).unwrap_or_default();
        Ok(())
    }

    /// Plays `episodes` greedy episodes with the flat parameters `weights`, in an environment of their own. Their resets draw
    /// from a stream that depends on the run's seed and `evaluation`, its number from 0, alone. The collecting side of the actor
    /// is untouched.
    ///
    /// The paths of the first episodes are returned, as many as fit into a reply; those of the others are empty.
    ///
    /// # Errors
    /// As [`Worker::collect`].
    pub fn evaluate(
        &mut self,
        weights: &[f32],
        evaluation: u64,
        episodes: u32,
    ) -> Result<Evaluation, ActorError> {
        let expected = Lengths { weights: self.policy.n_params(), ..Lengths::default() };
        if weights.len() != expected.weights {
            let found = Lengths { weights: weights.len(), ..Lengths::default() };
            return Err(ActorError::Acting { found, expected });
        }
        check_amount("episodes", episodes)?;
        let mut rng = stream(self.seed, Purpose::Evaluation, evaluation);
        let mut room = MAX_PATH_FEATURES;
        let mut played = Vec::with_capacity(episodes as usize);
        for _ in 0..episodes {
            let greedy =
                |policy: &mut Policy, _: Option<&mut Guide>, obs: &[f32]| policy.greedy(weights, obs);
            let episode = self.play(greedy, &mut rng, room, evaluation)?;
            // Once a path has been left out, all later ones are.
            room = if episode.path.is_empty() { 0 } else { room - episode.path.len() };
            played.push(episode);
        }
        Ok(Evaluation { evaluation, episodes: played, guide_return: None })
    }

    /// The first episode of the evaluation with this number again: `see` gets what the environment looks like at its beginning and
    /// after each step. Returns whether it has pictures at all.
    ///
    /// # Errors
    /// As [`Worker::evaluate`].
    pub fn film(
        &mut self,
        weights: &[f32],
        evaluation: u64,
        see: &mut dyn FnMut(Frame),
    ) -> Result<bool, ActorError> {
        let mut rng = stream(self.seed, Purpose::Evaluation, evaluation);
        self.evaluation_env.reset(&mut rng, &mut self.evaluation_obs)?;
        loop {
            let Some(frame) = self.evaluation_env.frame()? else { return Ok(false) };
            see(frame);
            let action = self.policy.greedy(weights, &self.evaluation_obs);
            let step = self.evaluation_env.step(action, &mut self.evaluation_obs)?;
            pulse::step();
            if step.terminated || step.truncated {
                self.evaluation_env.frame()?.into_iter().for_each(see);
                return Ok(true);
            }
        }
    }

    /// The return of an episode that follows the likeliest actions of a learned guide's policy with the parameters `policy`, and
    /// that begins as the evaluation with this number does. None where no guide is learnt, or it is of no more use.
    ///
    /// # Errors
    /// An environment that fails or gives what is not finite.
    pub fn evaluate_guide(&mut self, policy: &[f32], evaluation: u64) -> Result<Option<f64>, ActorError> {
        let guides = self.guides && policy.len() == self.lengths.policy;
        let Some(Guide::Learned(guide)) = self.guide.as_ref().filter(|_| guides) else { return Ok(None) };
        let mut tracker = guide.fresh();
        let lead = |_: &mut Policy, guide: Option<&mut Guide>, obs: &[f32]| match guide {
            Some(Guide::Learned(guide)) => guide.lead(&mut tracker, obs, policy),
            _ => 0,
        };
        let mut rng = stream(self.seed, Purpose::Evaluation, evaluation);
        Ok(Some(self.play(lead, &mut rng, 0, evaluation)?.episode.total_reward))
    }

    /// One episode of the evaluation with this number, by the actions that `choose` takes in its states. Its path is left out if
    /// it has more than `room` features.
    fn play(
        &mut self,
        mut choose: impl FnMut(&mut Policy, Option<&mut Guide>, &[f32]) -> u32,
        rng: &mut Stream,
        room: usize,
        evaluation: u64,
    ) -> Result<EvaluationEpisode, ActorError> {
        let (mut total_reward, mut length) = (0.0, 0);
        let goal_bonus = self.evaluation_env.spec().goal_bonus;
        let (index, moment, element) = (self.index, Moment::Evaluation(evaluation), self.element);
        self.evaluation_env.reset(rng, &mut self.evaluation_obs)?;
        check_numbers(index, moment, element, &self.evaluation_obs, 0.0)?;
        let mut path = Vec::new();
        let mut fits = true;
        let mut record = |obs: &[f32]| {
            fits = fits && path.len() + obs.len() <= room;
            if fits {
                path.extend_from_slice(obs);
            }
            fits
        };
        record(&self.evaluation_obs);
        let (last, whole) = loop {
            let action = choose(&mut self.policy, self.guide.as_mut(), &self.evaluation_obs);
            let step = self.evaluation_env.step(action, &mut self.evaluation_obs)?;
            pulse::step();
            check_numbers(index, moment, element, &self.evaluation_obs, step.reward)?;
            total_reward += reported(step.reward, step.success, goal_bonus);
            length += 1;
            let whole = record(&self.evaluation_obs);
            if step.terminated || step.truncated {
                break (step, whole);
            }
        };
        if !whole {
            path = Vec::new();
        }
        let success = self.success.of(last.success, total_reward);
        let episode = Episode { total_reward, length, success };
        Ok(EvaluationEpisode { episode, terminated: last.terminated, path })
    }

    /// All that changes while the actor collects: the environment in the middle of its episode, both random streams,
    /// the count of transitions. A codec frame that only [`Worker::restore`] reads.
    ///
    /// # Errors
    /// A state that the codec cannot write.
    pub fn snapshot(&self) -> Result<Vec<u8>, ActorError> {
        let state = State {
            index: self.index,
            seq: self.seq,
            first: self.first,
            obs: self.obs.clone(),
            env: self.env.snapshot()?,
            explore: self.explore.clone(),
            environment: self.environment.clone(),
            guide: self.guide.as_ref().and_then(Guide::progress),
        };
        Ok(codec::encode(STATE_KIND, &state)?)
    }

    /// Takes over the state in `bytes`, a snapshot of the same actor of the same run: every batch from then on is what
    /// it would have been. An environment that does not [repeat](Environment::repeats) begins an episode instead.
    ///
    /// # Errors
    /// Bytes that are damaged or of another actor or environment; the actor is unchanged then.
    pub fn restore(&mut self, bytes: &[u8]) -> Result<(), ActorError> {
        let state: State = codec::decode(STATE_KIND, bytes)?;
        let (index, expected) = (self.index, self.obs.len());
        if state.index != index || state.obs.len() != expected {
            return Err(ActorError::Foreign {
                found: state.index,
                features: state.obs.len(),
                index,
                expected,
            });
        }
        if !Guide::fits(self.guide.as_ref(), state.guide.as_ref()) {
            return Err(ActorError::Guide { index });
        }
        let repeats = self.env.repeats();
        if repeats {
            self.env.restore(&state.env)?;
            self.obs = state.obs;
        }
        if let (Some(guide), Some(progress)) = (&mut self.guide, state.guide) {
            guide.restore(progress);
        }
        self.seq = state.seq;
        self.first = state.first;
        self.explore = state.explore;
        self.environment = state.environment;
        if !repeats {
            self.first = true;
            self.reset()?;
        }
        Ok(())
    }
}

/// Refuses a state or a reward that nothing can be learnt from.
fn check_numbers(
    actor: u32,
    moment: Moment,
    element: Element,
    obs: &[f32],
    reward: f32,
) -> Result<(), ActorError> {
    let feature = obs.iter().position(|&value| !element.holds(value));
    let (what, value, element) = match feature {
        Some(index) => (Number::Feature(index), obs[index], element),
        None if !reward.is_finite() => (Number::Reward, reward, Element::F32),
        None => return Ok(()),
    };
    Err(ActorError::Number { actor, what, value, moment, accepted: element.accepted() })
}

/// Refuses too much work, or none.
fn check_amount(what: &'static str, amount: u32) -> Result<(), ActorError> {
    if (1..=MAX_ROLLOUT).contains(&amount) { Ok(()) } else { Err(ActorError::Amount { what, amount }) }
}

#[cfg(test)]
#[path = "worker_tests.rs"]
pub(crate) mod tests;
