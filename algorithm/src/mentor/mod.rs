//! The mentor-server's whole logic as a plain struct: it takes the observer's transitions in, and knows which mentor
//! transitions they resemble, which action the mentor probably took, and how else to get there.
//!
//! What it does next is a function of two things: the stored transitions ([`crate::history`]) and the annotations. So
//! one that is made anew, fed the stored transitions with [`Mentor::rebuild`] and given the annotations with
//! [`Mentor::restore`] goes on exactly as the former would have.

mod query;
#[cfg(test)]
mod tests;

use crate::bridge::cells::Cells;
use crate::bridge::graph::{Graph, News};
use crate::bridge::store::store;
use crate::bridge::{Arrival, search::Search};
use crate::bridge::{BridgeRule, Path, straight};
use crate::demonstration::transitions;
use crate::demonstration::{Demonstration, Order};
use crate::history::History;
use crate::inference::{Inference, Observation};
use crate::similarity::metric::{Metric, MetricError};
use crate::similarity::{Hit, Similarity};
use trestle_proto::NONE;
use trestle_proto::annotation::{AnnotationError, AnnotationTable};
use trestle_proto::batch::{Checked, Transition, Transitions};
use trestle_proto::config::{self, Algo};
use trestle_proto::limits::{MAX_BRIDGE_DEPTH, MAX_QUERY_ROWS, MAX_REPLAY};
use trestle_proto::mentor::MentorTransitions;
use trestle_proto::observe::Observed;
use trestle_proto::query::{MALFORMED, OUT_OF_ORDER, OUT_OF_RANGE};
use trestle_proto::rng::{Purpose, pick};
use trestle_proto::space::EnvSpec;

/// What a [`Mentor`] refuses. After a refusal it is as it was before, but for [`Mentor::restore`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MentorError {
    /// A demonstration that holds no transition.
    #[error("the demonstration has no transition; accepted: 1 or more")]
    EmptyDemonstration,
    /// A demonstration of other states than the environment's.
    #[error(
        "the demonstration's states have {found} features; accepted: {expected}, as the environment's have"
    )]
    Features {
        /// Those of the demonstration.
        found: usize,
        /// Those of the environment.
        expected: usize,
    },
    /// A setting out of range.
    #[error("{key} = {value}; accepted: {accepted}")]
    Setting {
        /// Dotted key of the configuration.
        key: &'static str,
        /// Its value.
        value: String,
        /// What is accepted.
        accepted: String,
    },
    /// A state distance that cannot be made.
    #[error(transparent)]
    Metric(#[from] MetricError),
    /// Transitions that do not continue the history.
    #[error("transitions begin with number {found} of the history; accepted: {expected}, where it ends")]
    Gap {
        /// Where the history ends.
        expected: u64,
        /// Number of the first one received.
        found: u64,
    },
    /// A state of another size, or not finite.
    #[error("{what} is {value}; accepted: {accepted}")]
    Value {
        /// What is wrong.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What is accepted.
        accepted: String,
    },
    /// An annotation that cannot be right.
    #[error(transparent)]
    Annotation(#[from] AnnotationError),
    /// A range that reaches beyond what there is.
    #[error(
        "mentor transitions {first} to {first} + {count}; accepted: within 0 to {len}, at most {MAX_QUERY_ROWS}"
    )]
    Range {
        /// First index.
        first: u32,
        /// Number of them.
        count: u32,
        /// Number of mentor transitions.
        len: usize,
    },
}

impl MentorError {
    /// The status to answer a request with ([`trestle_proto::query::STATUS`]).
    pub fn status(&self) -> u32 {
        match self {
            Self::Gap { .. } => OUT_OF_ORDER,
            Self::Range { .. } => OUT_OF_RANGE,
            _ => MALFORMED,
        }
    }
}

/// The state of the mentor-server.
#[derive(Clone, Debug)]
pub struct Mentor {
    seed: u64,
    rule: BridgeRule,
    /// Whether bridges are looked for.
    bridging: bool,
    order: Order,
    transitions: MentorTransitions,
    metric: Metric,
    similarity: Similarity,
    inference: Inference,
    table: AnnotationTable,
    /// Mentor transitions with an e_KL of `e_infeas` or more: without one there is no need for bridges.
    infeasible: usize,
    history: History,
    /// For cross-referencing.
    graph: Option<Graph>,
    changed: Changed,
    straight: straight::Scratch,
    search: Search,
    near: Near,
    candidates: Vec<u32>,
    stack: Vec<u32>,
}

/// The mentor states similar to both ends of the newest transition.
#[derive(Clone, Debug, Default)]
struct Near {
    starts: Vec<Hit>,
    ends: Vec<Hit>,
    /// Whether `ends` has been looked up.
    ends_known: bool,
}

/// The mentor transitions whose annotations have changed, each once.
#[derive(Clone, Debug)]
struct Changed {
    marked: Vec<bool>,
    list: Vec<u32>,
}

impl Changed {
    fn mark(&mut self, j: usize) {
        if !std::mem::replace(&mut self.marked[j], true) {
            self.list.push(j as u32);
        }
    }
}

impl Mentor {
    /// A mentor-server for `demo`, which knows nothing yet. `replay` is the capacity of the learner's replay.
    ///
    /// `algo`: bridges are looked for by `ha-diiqn` alone; `diiqn` takes every mentor transition as feasible. Without bridges the newest
    /// transition is kept and no other.
    ///
    /// # Errors
    /// An empty demonstration, one whose states are not the environment's, settings out of range.
    pub fn new(
        demo: &Demonstration,
        config: &config::Mentor,
        algo: Algo,
        spec: &EnvSpec,
        replay: usize,
        seed: u64,
    ) -> Result<Self, MentorError> {
        if demo.n_transitions() == 0 {
            return Err(MentorError::EmptyDemonstration);
        }
        let thresholds = check_settings(config, replay)?;
        let dim = spec.obs_dim();
        if demo.dim() != dim {
            return Err(MentorError::Features { found: demo.dim(), expected: dim });
        }
        let metric = Metric::of(config, spec, demo.states())?;
        let whitened = metric.whiten_all(demo.states());
        let order = demo.order();
        let count = order.n_transitions();
        let [e_th, e_infeas] = thresholds;
        let bridging = config.seeks_bridges(algo);
        let graph =
            (bridging && config.cross_reference).then(|| Graph::new(Cells::new(e_th, &whitened, dim)));
        Ok(Self {
            seed,
            rule: BridgeRule { k: config.k as usize, n: config.n as usize, e_infeas },
            bridging,
            transitions: demo.transitions(),
            metric,
            inference: Inference::new(config.metric.of(spec), config.inference, &whitened, dim, &order),
            similarity: Similarity::new(whitened, dim, e_th),
            table: AnnotationTable::new(count, dim, spec.n_actions()),
            infeasible: count,
            // Bridges alone lead through older transitions.
            history: History::new(if bridging { replay } else { 1 }, dim),
            graph,
            changed: Changed { marked: vec![false; count], list: Vec::new() },
            straight: straight::Scratch::default(),
            search: Search::new(order.n_states(), count),
            order,
            near: Near::default(),
            candidates: Vec::new(),
            stack: Vec::new(),
        })
    }

    /// The same, before it knows anything, where bridges are kept from beginning to end ([`AnnotationTable::further`]).
    pub fn keeping_whole_bridges(mut self) -> Self {
        self.table = self.table.keeping(self.rule.k - 1);
        self
    }

    /// Takes in `batch`, whose first transition has number `first` in the run's one history: stores the transitions, infers
    /// actions, looks for bridges. Fills `out` with a mentor transition for each one, drawn evenly from those whose s_m is similar
    /// to its s (none: [`NONE`]), and with the annotations that changed, each once, in ascending order.
    ///
    /// # Errors
    /// Transitions that do not continue the history: nothing is taken in.
    pub fn observe(
        &mut self,
        first: u64,
        batch: Checked<Transitions<'_>>,
        out: &mut Observed,
    ) -> Result<(), MentorError> {
        out.clear();
        self.accept(first)?;
        let cut_short = self.search.cut_short();
        self.near.ends_known = false;
        for i in 0..batch.len() {
            let t = batch.get(i);
            let (index, news) = self.store(batch.actor, &t);
            self.look_up(index, i > 0 && same(batch.get(i - 1).next_obs, t.obs));
            self.infer(index);
            if self.bridging && self.infeasible > 0 {
                self.bridge_through(index, news);
            }
            out.mentor.push(self.draw(index));
        }
        out.cut_short = (self.search.cut_short() - cut_short) as u32;
        self.changed.list.sort_unstable();
        for j in self.changed.list.drain(..) {
            self.changed.marked[j as usize] = false;
            self.table.encode(j as usize, &mut out.changed);
        }
        Ok(())
    }

    /// Takes in transitions as history alone. For a new mentor-server that takes over from another: first the whole
    /// content of the learner's replay, oldest first and actor by actor as it was observed.
    ///
    /// # Errors
    /// As for [`Mentor::observe`].
    pub fn rebuild(&mut self, first: u64, batch: Checked<Transitions<'_>>) -> Result<(), MentorError> {
        self.accept(first)?;
        for i in 0..batch.len() {
            self.store(batch.actor, &batch.get(i));
        }
        self.search.forget();
        Ok(())
    }

    /// Replaces annotations by the given records ([`trestle_proto::annotation`]).
    ///
    /// # Errors
    /// The first record that cannot be right; those before it have been taken over.
    pub fn restore(&mut self, records: &[u32]) -> Result<(), MentorError> {
        let applied = self.table.apply(records);
        self.inference.restore(self.table.errors());
        self.search.forget();
        self.infeasible = self.table.errors().iter().filter(|&&e| e >= self.rule.e_infeas).count();
        Ok(applied?)
    }

    /// Begins to take in transitions from number `first` on.
    fn accept(&mut self, first: u64) -> Result<(), MentorError> {
        if let Some(expected) = self.history.expected().filter(|&expected| expected != first) {
            return Err(MentorError::Gap { expected, found: first });
        }
        self.history.begin(first);
        Ok(())
    }

    /// Stores a transition. Its number, and what it adds to the graph.
    fn store(&mut self, actor: u32, t: &Transition<'_>) -> (u64, News) {
        store(&mut self.history, self.graph.as_mut(), &self.metric, actor, t)
    }

    /// Looks up the mentor states near stored transition `index`, the newest: each state once. `follows` says whether the
    /// transition begins in the state in which the one before it ended.
    fn look_up(&mut self, index: u64, follows: bool) {
        let Self { history, similarity, stack, near, .. } = self;
        let (t, states) = (history.get(index), &history.states);
        if follows && near.ends_known {
            std::mem::swap(&mut near.starts, &mut near.ends);
        } else {
            similarity.states(states.whitened(t.from), stack, &mut near.starts);
        }
        // Bridges alone ask for the end.
        near.ends_known = self.bridging && self.infeasible > 0;
        if near.ends_known {
            similarity.states(states.whitened(t.to), stack, &mut near.ends);
        }
    }

    /// Action inference for stored transition `index`, whose similar mentor states have been looked up.
    fn infer(&mut self, index: u64) {
        let t = self.history.get(index);
        let seen = Observation {
            state: self.history.states.whitened(t.from),
            next: self.history.states.whitened(t.to),
            similar: &self.near.starts,
            action: t.action,
            reward: t.reward,
        };
        let Self { inference, order, table, changed, infeasible, rule, .. } = self;
        let mut feasible = 0;
        inference.observe(&seen, order, table, |j, before, after| {
            changed.mark(j);
            feasible += usize::from(before >= rule.e_infeas && after < rule.e_infeas);
        });
        *infeasible -= feasible;
    }

    /// Looks for bridges that stored transition `index`, the newest, completes.
    fn bridge_through(&mut self, index: u64, news: News) {
        let Self { rule, order, similarity, history, graph, table, changed, straight, search, near, .. } =
            self;
        let (starts, ends) = (near.starts.as_slice(), near.ends.as_slice());
        let path = Path { rule: *rule, order, similarity };
        if let Some(graph) = graph.as_mut() {
            search.prepare(graph, &history.states, &path);
        }
        let complete = graph.as_ref().is_some_and(|graph| {
            let (states, oldest) = (&history.states, history.oldest());
            let new = Arrival { states, graph, t: history.get(index), index, oldest, news, starts, ends };
            search.run(&new, &path, table, |j| changed.mark(j))
        });
        // A complete search has found these, too.
        if !complete {
            straight::search(history, index, [starts, ends], &path, table, straight, |j| changed.mark(j));
        }
    }

    /// Draws the mentor transition for stored transition `index` from all mentor transitions that begin in a state similar to its s.
    fn draw(&mut self, index: u64) -> u32 {
        self.candidates.clear();
        self.candidates.extend(transitions(&self.near.starts, &self.order).map(|(j, _)| j as u32));
        match self.candidates.len() as u32 {
            0 => NONE,
            n => self.candidates[pick(self.seed, Purpose::MentorPick, index, n) as usize],
        }
    }
}

/// Whether two states are the same, bit for bit.
fn same(a: &[f32], b: &[f32]) -> bool {
    a.iter().map(|x| x.to_bits()).eq(b.iter().map(|x| x.to_bits()))
}

/// The ranges that this crate relies on; a checked and resolved configuration is always within them. Returns `e_th` and
/// `e_infeas`.
fn check_settings(config: &config::Mentor, replay: usize) -> Result<[f32; 2], MentorError> {
    let refuse = |key, value: &dyn ToString, accepted: String| {
        Err(MentorError::Setting { key, value: value.to_string(), accepted })
    };
    for (key, depth) in [("mentor.k", config.k), ("mentor.n", config.n)] {
        if !(1..=MAX_BRIDGE_DEPTH).contains(&depth) {
            return refuse(key, &depth, format!("1 to {MAX_BRIDGE_DEPTH}"));
        }
    }
    let mut thresholds = [0.0; 2];
    let keys = [("mentor.e_th", config.e_th), ("mentor.e_infeas", config.e_infeas)];
    for (known, (key, threshold)) in thresholds.iter_mut().zip(keys) {
        match threshold.known() {
            Some(kl) if kl.is_finite() && kl > 0.0 => *known = kl as f32,
            _ => return refuse(key, &threshold, "a number above 0".into()),
        }
    }
    if !(1..=MAX_REPLAY).contains(&replay) {
        return refuse("learner.replay", &replay, format!("1 to {MAX_REPLAY}"));
    }
    Ok(thresholds)
}
