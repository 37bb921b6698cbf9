//! `[mentor.learned]`: learned bridges, a policy that leads along the mentor's path.

use super::accepts::{above, any, at_least, between, list};
use super::learner::MAX_HIDDEN;
use crate::limits::{MAX_HORIZON, MAX_OWN_PATHS, MAX_WIDTH};
use crate::settings;

settings! {
    /// `[mentor.learned]`, for `exploration.guide = "learned"`. Lengths are Euclidean in the chosen features, each in units of
    /// `mentor.scale`, or else of the environment's scale of it. A change of a category is one unit long.
    pub struct Learned {
        /// Units of each hidden layer of the policy π.
        hidden: Vec<usize> = vec![64, 64], list(1..=MAX_HIDDEN, between(1, MAX_WIDTH))
            .in_words(format!("1 to {MAX_HIDDEN} layers of 1 to {MAX_WIDTH} units"));
        /// Samples of an update. There is one update for each gradient step of the Q-network.
        batch: usize = 64, between(1, 1024);
        /// Adam's learning rate.
        lr: f64 = 1e-3, above(0.0);
        /// Most steps between a state and the later state that is taken for its goal.
        horizon: usize = 6, between(1, MAX_HORIZON);
        /// Features of a state, counted from 0, in which it is compared with the mentor's path. Empty: those of
        /// `mentor.features`, or else all that are neither velocities nor categories, or else all that are no velocities.
        features: Vec<usize> = Vec::new(), any("features of the environment, each once, in ascending order");
        /// How near to a mentor state the observer counts as being there. 0: 1.5, which in a maze is less
        /// than the two cells between passages.
        radius: f64 = 0.0, at_least(0.0);
        /// How far along the path, either way from the last place, the next one is looked for. 0: eight strides. A
        /// stride is the mentor's median step, or one unit if that is longer.
        window: f64 = 0.0, at_least(0.0);
        /// How far ahead along the path the goal lies. 0: three strides.
        lookahead: f64 = 0.0, at_least(0.0);
        /// Whether an episode is guided with probability 1 / (1 + k) after k guided ones in a row that got stuck, and, once there are own
        /// paths, guided episodes leave a quarter of the steps to others. Else each episode is guided.
        gate: bool = true;
        /// Steps of an episode without progress after which the guide lets go. 0: it never does.
        idle: u64 = 40;
        /// Steps for which it lets go then.
        roam: u64 = 50;
        /// How many times as long it lets go each time as the time before, in an episode that comes no further and as long as the
        /// observer has not come to success. 1: equally long.
        back_off: f64 = 2.0, between(1.0, 1000.0);
        /// Probability with which a step that would be guided, but has no goal, repeats the action before it, unless that led nowhere.
        /// Otherwise its action is random. 0: all are random.
        persist: f64 = 0.7, between(0.0, 1.0);
        /// Least probability with which an episode is guided as long as the observer has not come to success; such an episode explores
        /// as a run's first step does. 0: the gate and the schedules alone decide. Only where the environment defines success.
        search: f64 = 0.5, between(0.0, 1.0);
        /// Paths of the observer's own that are kept at most: how it once came to success, without the loops. The guide leads along
        /// them rather than along the mentor's. 0: none.
        own_paths: usize = 16, between(0, MAX_OWN_PATHS);
        /// Weight λ of the loss with which each gradient step imitates `learner.batch` steps of own paths. 0: none does.
        imitate: f64 = 0.0, at_least(0.0);
        /// By how much the value of an own path's action is to exceed those of all others.
        margin: f64 = 0.1, at_least(0.0);
        /// Weight, beside that of a step of an own path, with which each gradient step imitates the guide's likeliest action in
        /// stored states near an own path. `learner.batch` stored states are drawn for it. 0: it never does. Only where states
        /// have velocities, and with `imitate` above 0.
        correct: f64 = 0.0, at_least(0.0);
    }
}
