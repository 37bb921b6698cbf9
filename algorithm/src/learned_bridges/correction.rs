//! Correction: what the guide would do where the observer has left an own path by a little.
//!
//! With inertia no state of an own path ever comes back exactly. A greedy policy that knows the path's states alone gets stuck
//! beside it, in front of a wall or going round and round. So states are drawn uniformly from the replay. Where an own path is within
//! `REACH` of one, the guide's likeliest action towards the path, argmax_a π(a | s, g), is imitated as if it were the path's. The
//! goal g lies a lookahead further along than the state.
//!
//! π may be wrong, and the observer would then do the wrong thing there again and again, from which π could learn nothing better.
//! So where that action is most of what the observer did in the next steps, and they brought it less than a tenth closer to g, π's
//! second choice takes its place.
//!
//! Labels for the states that the learner itself comes to are the idea of `DAgger` (Ross, Gordon and Bagnell 2011). There an expert
//! gives them; here π does, which was learnt from the observer's own steps.

use super::goal::Goal;
use super::path::{Path, distance, kl_within, nearest};
use crate::replay::Replay;
use crate::similarity::Hit;
use trestle_proto::acting::OwnPlaces;
use trestle_proto::rng::Stream;
use trestle_proto::row::Row;
use trestle_qnet::{Kernels, Layout, Workspace, argmax, forward};

/// How far an own path may be from a state that is corrected, in radii of learned bridges. In the presets of the Point Maze, with their
/// five simulated steps to a step, that is three quarters of a cell, less than a wall is thick.
const REACH: f32 = 2.0;

/// By which share the way to the goal has to become shorter for a try to have led somewhere.
const CLOSER: f32 = 0.1;

/// How the guide corrects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CorrectionConfig {
    /// Weight of a corrected state beside a step of an own path, above 0.
    pub weight: f32,
    /// How near to a place the observer counts as being there, in units of the goal's scales, above 0.
    pub radius: f32,
    /// How far ahead along an own path the goal lies, in the same units.
    pub lookahead: f32,
    /// Steps of a try, after which it has led somewhere or not, 1 or more.
    pub horizon: usize,
}

impl CorrectionConfig {
    /// How far an own path may be.
    fn reach(&self) -> f32 {
        REACH * self.radius
    }

    /// The place where a state counts as being, given the places `hits` within reach of it. Among places within the radius it is the one
    /// with the shortest way to the end of its path, since a path may come by twice. Else it is the nearest place.
    fn place(&self, path: &Path, hits: &[Hit]) -> Option<usize> {
        let rest = |hit: &&Hit| path.length(path.end(hit.state as usize)) - path.length(hit.state as usize);
        let there = hits.iter().filter(|hit| hit.kl <= kl_within(self.radius));
        let last = there.min_by(|a, b| rest(a).total_cmp(&rest(b)));
        last.or_else(|| nearest(hits)).map(|hit| hit.state as usize)
    }
}

/// Draws states near own paths, each with the guide's action in it. Memory is allocated once.
#[derive(Debug)]
pub struct Correction {
    config: CorrectionConfig,
    goal: Goal,
    /// π's network.
    layout: Layout,
    workspace: Workspace,
    /// The own paths; none as long as there are none.
    path: Option<Path>,
    slots: Vec<u32>,
    /// Slot of each drawn state that an own path is near, and the place of its goal on that path.
    aims: Vec<(usize, usize)>,
    /// Slots with the action in each.
    corrected: Vec<(usize, u32)>,
    x: Vec<f32>,
    outputs: Vec<f32>,
    place: Vec<f32>,
    wide: Vec<f32>,
    stack: Vec<u32>,
    hits: Vec<Hit>,
}

impl Correction {
    /// Of up to `batch` states at once, by a policy over `layout`, whose input must be the goal's.
    pub fn new(goal: Goal, layout: Layout, config: CorrectionConfig, batch: usize, kernels: Kernels) -> Self {
        Self {
            config,
            workspace: Workspace::with_kernels(&layout, batch, kernels),
            path: None,
            slots: Vec::with_capacity(batch),
            aims: Vec::with_capacity(batch),
            corrected: Vec::with_capacity(batch),
            x: vec![0.0; batch * layout.input()],
            outputs: vec![0.0; batch * layout.output()],
            place: Vec::with_capacity(goal.dim()),
            wide: Vec::new(),
            stack: Vec::new(),
            hits: Vec::new(),
            goal,
            layout,
        }
    }

    /// How it corrects.
    pub fn config(&self) -> &CorrectionConfig {
        &self.config
    }

    /// Takes these own paths in the place of the former ones.
    pub fn renew(&mut self, own: &OwnPlaces) {
        let some = !own.lengths.is_empty();
        self.path =
            some.then(|| Path::new(own.places.clone(), self.goal.dim(), &own.lengths, self.config.reach()));
    }

    /// Draws `n` states of `replay`. Gives the slot of each drawn state near an own path, with the likeliest action there of π, whose
    /// parameters are `params`. The second likeliest takes its place where it has been tried and led nowhere. Nothing is drawn
    /// without an own path.
    pub fn draw(&mut self, n: usize, replay: &Replay, params: &[f32], rng: &mut Stream) -> &[(usize, u32)] {
        let Self { config, goal, layout, workspace, path, slots, aims, corrected, .. } = self;
        aims.clear();
        corrected.clear();
        let Some(path) = path else { return corrected };
        replay.sample(rng, n, slots);
        let (width, n_actions) = (layout.input(), layout.output());
        for &slot in &*slots {
            let (slot, row) = (slot as usize, aims.len() * width);
            let obs = replay.obs(slot).wide(&mut self.wide);
            self.place.clear();
            goal.place(obs, &mut self.place);
            path.near(&self.place, &mut self.stack, &mut self.hits);
            let Some(at) = config.place(path, &self.hits) else { continue };
            let aim = path.ahead(at, config.lookahead);
            goal.encode(obs, path.place(aim), &mut self.x[row..][..width]);
            aims.push((slot, aim));
        }
        if aims.is_empty() {
            return corrected;
        }
        let (x, outputs) = (&self.x[..aims.len() * width], &mut self.outputs[..aims.len() * n_actions]);
        forward(layout, params, x, aims.len(), workspace, outputs);
        for (&(slot, aim), outputs) in aims.iter().zip(outputs.chunks_exact_mut(n_actions)) {
            let (mut action, g) = (argmax(outputs), path.place(aim));
            let (mut steps, mut same) = (0, 0);
            for slot in replay.path(slot, config.horizon) {
                steps += 1;
                same += usize::from(replay.get(slot).action as usize == action);
            }
            if 2 * same > steps {
                let mut away = |obs: Row<'_>| {
                    self.place.clear();
                    goal.place(obs.wide(&mut self.wide), &mut self.place);
                    distance(&self.place, g)
                };
                let closer = (1.0 - CLOSER) * away(replay.obs(slot));
                let mut tried = replay.path(slot, config.horizon);
                if !tried.any(|slot| away(replay.next_obs(slot)) <= closer) {
                    outputs[action] = f32::NEG_INFINITY;
                    action = argmax(outputs);
                }
            }
            corrected.push((slot, action as u32));
        }
        corrected
    }
}
