//! A guide that leads along the mentor's path: a policy π(a | s, g), published with the weights, and the progress of this
//! actor's episodes, which is its own.

use crate::error::ActorError;
use crate::policy::unit;
use serde::{Deserialize, Serialize};
use trestle_algorithm::learned_bridges::{Goal, Pace, Paths, Tracker, draw, paths_of, policy_of, softmax};
use trestle_algorithm::similarity::Hit;
use trestle_proto::acting::{Acting, OwnPlaces, Room};
use trestle_proto::batch::Tally;
use trestle_proto::experiment::Experiment;
use trestle_proto::rng::{Stream, below};
use trestle_proto::space::Success;
use trestle_qnet::{Layout, Workspace, argmax, forward, kernels_of};

/// π's network, the paths that it leads along, and where this actor is on them.
pub struct Learned {
    route: Route,
    layout: Layout,
    workspace: Workspace,
    input: Vec<f32>,
    outputs: Vec<f32>,
    progress: Progress,
    tally: Tally,
    /// What counts as an episode's success.
    success: Success,
    /// How many own paths there may be.
    room: Room,
    /// Probability with which a step without a goal repeats the one before.
    persist: f64,
}

/// Paths as π sees them, and working memory to find places on them.
struct Route {
    goal: Goal,
    paths: Paths,
    pace: Pace,
    place: Vec<f32>,
    stack: Vec<u32>,
    hits: Vec<Hit>,
}

impl Route {
    /// Lets `tracker` see `obs`, the first state of an episode.
    fn begin(&mut self, tracker: &mut Tracker, obs: &[f32]) {
        self.place.clear();
        self.goal.place(obs, &mut self.place);
        tracker.observe(&self.paths, &self.pace, &self.place, &mut self.stack, &mut self.hits);
    }

    /// Lets `tracker` see `obs`, to which a step has led.
    fn follow(&mut self, tracker: &mut Tracker, obs: &[f32]) {
        self.place.clear();
        self.goal.place(obs, &mut self.place);
        tracker.follow(&self.paths, &self.pace, &self.place, &mut self.stack, &mut self.hits);
    }
}

/// How far an actor has come. All of it belongs to a snapshot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    tracker: Tracker,
    /// Return of the episode so far, as it is reported.
    total_reward: f64,
    /// The own paths that the tracker knows.
    own: OwnPlaces,
    /// The last step, if it was the guide's and had no goal.
    roamed: Option<Roamed>,
}

/// A step without a goal.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Roamed {
    /// Where it was taken.
    place: Vec<f32>,
    action: u32,
}

impl Learned {
    /// The guide of `experiment`'s run; none without learned bridges.
    ///
    /// # Errors
    /// Settings that give no network.
    pub fn new(experiment: &Experiment) -> Result<Option<Self>, ActorError> {
        let Some((goal, layout)) = policy_of(experiment)? else { return Ok(None) };
        let Some(paths) = paths_of(experiment, &goal) else { return Ok(None) };
        let pace = Pace::of(&experiment.config.mentor.learned);
        let (tracker, own) = (Tracker::default(), OwnPlaces::default());
        let progress = Progress { tracker, total_reward: 0.0, own, roamed: None };
        let place = Vec::with_capacity(goal.dim());
        Ok(Some(Self {
            route: Route { goal, paths, pace, place, stack: Vec::new(), hits: Vec::new() },
            workspace: Workspace::with_kernels(&layout, 1, kernels_of(experiment)?),
            input: vec![0.0; layout.input()],
            outputs: vec![0.0; layout.output()],
            progress,
            tally: Tally::default(),
            success: experiment.success(),
            room: experiment.own_room(),
            persist: experiment.config.mentor.learned.persist,
            layout,
        }))
    }

    /// Takes over the own paths in `acting` if they are others; the episode is in `obs`.
    pub fn renew(&mut self, acting: &Acting, obs: &[f32]) {
        if self.progress.own != acting.own {
            self.progress.own.clone_from(&acting.own);
            self.route.paths.set_own(&acting.own);
            self.progress.tracker.renew();
            self.route.begin(&mut self.progress.tracker, obs);
        }
    }

    /// Whether the episode looks for the first success, and explores as at a run's start.
    pub fn searches(&self) -> bool {
        self.progress.tracker.searches(&self.route.pace)
    }

    /// Whether an episode may still do so, whatever the schedules say.
    pub fn may_search(&self, acting: &Acting) -> bool {
        self.route.pace.search > 0.0 && acting.own.lengths.is_empty()
    }

    /// An episode begins in `obs`. Draws one word, which decides whether it is guided.
    pub fn begin(&mut self, obs: &[f32], rng: &mut Stream) {
        (self.progress.total_reward, self.progress.roamed) = (0.0, None);
        self.progress.tracker.begin(&self.route.pace, unit(rng));
        self.route.begin(&mut self.progress.tracker, obs);
    }

    /// A step of the episode, with the reward that is reported, has led to `obs`.
    pub fn follow(&mut self, obs: &[f32], reward: f64) {
        self.progress.total_reward += reward;
        self.route.follow(&mut self.progress.tracker, obs);
    }

    /// The episode has ended, and the environment `said` that it succeeded, or not.
    pub fn finish(&mut self, said: bool) {
        let success = self.success.of(said, self.progress.total_reward) == Some(true);
        let tracker = &mut self.progress.tracker;
        let stuck = tracker.finish(success);
        self.tally.episodes += 1;
        self.tally.guided += u64::from(tracker.guided());
        self.tally.stuck += u64::from(tracker.guided() && stuck);
        self.tally.progress += f64::from(tracker.furthest());
    }

    /// An action of π in `obs`, drawn with one word of `rng`, if there is a goal to lead to. `params` are π's. Where there is no goal and
    /// steps persist, one that repeats the last or is random.
    pub fn action(&mut self, obs: &[f32], params: &[f32], rng: &mut Stream) -> Option<u32> {
        let Some(goal) = self.progress.tracker.goal(&self.route.paths, &self.route.pace) else {
            return (self.persist > 0.0).then(|| self.roam(obs, rng));
        };
        self.progress.roamed = None;
        self.route.goal.encode(obs, goal, &mut self.input);
        self.forward(params);
        softmax(&mut self.outputs);
        self.tally.steps += 1;
        Some(draw(&self.outputs, unit(rng)) as u32)
    }

    /// A step in `obs` without a goal: the last one again, unless it led nowhere, or another one. Draws a word, and half of one for
    /// another one.
    fn roam(&mut self, obs: &[f32], rng: &mut Stream) -> u32 {
        let Route { goal, place, .. } = &mut self.route;
        place.clear();
        goal.place(obs, place);
        let again = unit(rng) < self.persist;
        let last = self.progress.roamed.get_or_insert_default();
        // A step from no place is none.
        if !again || last.place.is_empty() || last.place == *place {
            last.action = below(rng, self.outputs.len()) as u32;
        }
        last.place.clone_from(place);
        last.action
    }

    /// A tracker at the beginning of a guided episode, for an agent that follows π alone.
    pub fn fresh(&self) -> Tracker {
        let mut tracker = Tracker::default();
        tracker.begin(&self.route.pace, 0.0);
        tracker
    }

    /// π's likeliest action in `obs`, where `tracker` has not been yet; the first one of several. Before a path has been found it
    /// leads to where the observer is. It never lets go.
    pub fn lead(&mut self, tracker: &mut Tracker, obs: &[f32], params: &[f32]) -> u32 {
        self.route.begin(tracker, obs);
        let goal = tracker.next(&self.route.paths, &self.route.pace).unwrap_or(&self.route.place);
        self.route.goal.encode(obs, goal, &mut self.input);
        self.forward(params);
        argmax(&self.outputs) as u32
    }

    /// π's outputs for its input.
    fn forward(&mut self, params: &[f32]) {
        forward(&self.layout, params, &self.input, 1, &mut self.workspace, &mut self.outputs);
    }

    /// What the guide has done since it was asked last.
    pub fn take_tally(&mut self) -> Tally {
        std::mem::take(&mut self.tally)
    }

    /// What belongs to a snapshot.
    pub fn progress(&self) -> &Progress {
        &self.progress
    }

    /// Whether `progress` can be one of this guide.
    pub fn fits(&self, progress: &Progress) -> bool {
        let own = progress.own.lengths.iter().map(|&length| length as usize).sum();
        let one = |last: &Roamed| {
            last.place.len() == self.route.goal.dim() && (last.action as usize) < self.outputs.len()
        };
        progress.total_reward.is_finite()
            && progress.roamed.as_ref().is_none_or(one)
            && self.room.holds(&progress.own)
            && progress.tracker.fits(self.route.paths.mentor().len(), own)
    }

    /// Goes on from `progress`, which [`Learned::fits`].
    pub fn restore(&mut self, progress: Progress) {
        self.route.paths.set_own(&progress.own);
        self.progress = progress;
    }
}
