//! A guide that leads along the mentor's path: a policy π(a | s, g), published with the weights, and the progress of this
//! actor's episodes, which is its own.

use crate::policy::unit;
use crate::worker::ActorError;
use serde::{Deserialize, Serialize};
use trestle_algorithm::learned_bridges::{
    Goal, MentorPath, Pace, Tracker, draw, path_of, policy_of, softmax,
};
use trestle_algorithm::similarity::Hit;
use trestle_proto::plan::RunPlan;
use trestle_proto::rng::Stream;
use trestle_proto::space::Success;
use trestle_qnet::{Layout, Workspace, forward, kernels_of};

/// π's network, the mentor's path, and where this actor is on it.
pub struct Learned {
    goal: Goal,
    path: MentorPath,
    pace: Pace,
    layout: Layout,
    workspace: Workspace,
    input: Vec<f32>,
    outputs: Vec<f32>,
    place: Vec<f32>,
    stack: Vec<u32>,
    hits: Vec<Hit>,
    progress: Progress,
    /// What counts as an episode's success.
    success: Success,
}

/// How far an actor has come. All of it belongs to a snapshot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    tracker: Tracker,
    /// Return of the episode so far, as it is reported.
    total_reward: f64,
}

impl Learned {
    /// The guide of `plan`'s run; none without learned bridges.
    ///
    /// # Errors
    /// Settings that give no network.
    pub fn new(plan: &RunPlan) -> Result<Option<Self>, ActorError> {
        let Some((goal, layout)) = policy_of(plan)? else { return Ok(None) };
        let Some(path) = path_of(plan, &goal) else { return Ok(None) };
        let pace = Pace::of(&plan.config.mentor.learned);
        Ok(Some(Self {
            workspace: Workspace::with_kernels(&layout, 1, kernels_of(plan)?),
            input: vec![0.0; layout.input()],
            outputs: vec![0.0; layout.output()],
            place: Vec::with_capacity(goal.dim()),
            stack: Vec::new(),
            hits: Vec::new(),
            progress: Progress { tracker: Tracker::new(&path, &pace), total_reward: 0.0 },
            success: plan.success(),
            goal,
            path,
            pace,
            layout,
        }))
    }

    /// An episode begins in `obs`. Draws one word, which decides whether it is guided.
    pub fn begin(&mut self, obs: &[f32], rng: &mut Stream) {
        self.progress.tracker.begin(&self.pace, unit(rng));
        self.progress.total_reward = 0.0;
        self.observe(obs);
    }

    /// A step of the episode, with the reward that is reported, has led to `obs`.
    pub fn follow(&mut self, obs: &[f32], reward: f64) {
        self.progress.tracker.step();
        self.progress.total_reward += reward;
        self.observe(obs);
    }

    /// The episode has ended, and the environment `said` that it succeeded, or not.
    pub fn finish(&mut self, said: bool) {
        let success = self.success.of(said, self.progress.total_reward) == Some(true);
        self.progress.tracker.finish(&self.path, &self.pace, success);
    }

    fn observe(&mut self, obs: &[f32]) {
        self.place.clear();
        self.goal.place(obs, &mut self.place);
        let (stack, hits) = (&mut self.stack, &mut self.hits);
        self.progress.tracker.observe(&self.path, &self.pace, &self.place, stack, hits);
    }

    /// An action of π in `obs`, drawn with one word of `rng`, if there is a goal to lead to. `params` are π's.
    pub fn action(&mut self, obs: &[f32], params: &[f32], rng: &mut Stream) -> Option<u32> {
        let goal = self.progress.tracker.goal(&self.path, &self.pace)?;
        self.goal.encode(obs, self.path.state(goal), &mut self.input);
        forward(&self.layout, params, &self.input, 1, &mut self.workspace, &mut self.outputs);
        softmax(&mut self.outputs);
        Some(draw(&self.outputs, unit(rng)) as u32)
    }

    /// What belongs to a snapshot.
    pub fn progress(&self) -> &Progress {
        &self.progress
    }

    /// Whether `progress` can be one of this guide.
    pub fn fits(&self, progress: &Progress) -> bool {
        progress.total_reward.is_finite() && progress.tracker.fits(&self.path, &self.pace)
    }

    /// Goes on from `progress`, which [`Learned::fits`].
    pub fn restore(&mut self, progress: Progress) {
        self.progress = progress;
    }
}
