//! `mentor`: similarity queries, action inference and bridge search, beside scans of everything.
//!
//! `similar` and `infer` happen in a continuous world, where no state comes twice; neither depends on the stored
//! transitions, whose number is given as 0. In `infer` half of the mentor's transitions have an estimate with a small
//! error and half one with a large error. `bridge` happens on whole cells (`states` = `cells`), as in a maze, where the
//! same states are seen again and again, and where states lie anywhere (`anywhere`), so that more stored transitions
//! crowd the same space: the history is full, half of the mentor's transitions are infeasible, and each stored
//! transition is followed by the search, whose time is what counts.

use super::Effort;
use super::clock::{Case, median, medians};
use super::report::Row;
use anyhow::Result;
use std::hint::black_box;
use std::time::{Duration, Instant};
use trestle_algorithm::bridge::cells::Cells;
use trestle_algorithm::bridge::graph::Graph;
use trestle_algorithm::bridge::store::store;
use trestle_algorithm::bridge::{Arrival, search::Search};
use trestle_algorithm::bridge::{BridgeRule, Path, oracle, straight};
use trestle_algorithm::demonstration::{Demonstration, Order, transitions};
use trestle_algorithm::history::History;
use trestle_algorithm::inference::{Inference, Observation};
use trestle_algorithm::similarity::Similarity;
use trestle_algorithm::similarity::metric::{Metric, kl};
use trestle_bench::walk::{Walk, World};
use trestle_proto::annotation::{AnnotationTable, Estimate};
use trestle_proto::config::{InferenceKind, MetricKind};

const DIMS: [usize; 2] = [2, 4];
/// Sizes for figures, and for a quick look.
const MENTOR: [&[usize]; 2] = [&[100, 10_000, 100_000], &[100]];
const STORED: [&[usize]; 2] = [&[10_000, 100_000, 1_000_000], &[1_000]];
const E_TH: f32 = 0.1;
const RULE: BridgeRule = BridgeRule { k: 4, n: 4, e_infeas: 0.1 };
/// e_KL of the mentor transitions that are feasible, and of the others.
const ERRORS: [f32; 2] = [0.02, 0.5];
const JITTER: f32 = 0.2;
/// Observer transitions that take turns in a sample.
const TURNS: usize = 4096;
/// Bridge search: transitions that one observer takes in before it is another's turn, and turns.
const CHUNK: usize = 64;
const CHUNKS: usize = 200;
/// The naive bridge search is tried up to this many stored transitions, so many times, for mentor transitions that begin
/// where one of them does, and given up where one takes longer than this.
const NAIVE_STORED: usize = 10_000;
const NAIVE_TRIES: usize = 10;
const NAIVE_LIMIT: Duration = Duration::from_secs(1);

pub(super) fn run(effort: Effort) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for dim in DIMS {
        for &mentor in effort.pick(MENTOR[0], MENTOR[1]) {
            let world = World::new(dim, mentor, JITTER);
            let demonstration = world.demonstration(mentor)?;
            let mut cases = similar(&world, &demonstration);
            cases.extend(infer(&world, &demonstration));
            let found = medians(&mut cases, effort)?;
            let row = |op: &str| Row::new().with("op", op).with("dim", dim).with("mentor", mentor);
            rows.push(
                row("similar")
                    .with("stored", 0)
                    .with("states", "anywhere")
                    .measured("ns", found[0])
                    .measured("naive_ns", found[1]),
            );
            rows.push(
                row("infer")
                    .with("stored", 0)
                    .with("states", "anywhere")
                    .measured("ns", found[2])
                    .measured("naive_ns", found[3]),
            );
            for (states, jitter) in [("cells", 0.0), ("anywhere", JITTER)] {
                for (stored, ns, naive_ns) in bridge(dim, mentor, jitter, effort.pick(STORED[0], STORED[1]))?
                {
                    let row = row("bridge").with("stored", stored).with("states", states);
                    rows.push(row.measured("ns", ns).measured("naive_ns", naive_ns));
                }
            }
        }
    }
    Ok(rows)
}

/// Both states and the action of observer transitions.
struct Seen {
    dim: usize,
    pairs: Vec<f32>,
    at: usize,
}

impl Seen {
    fn new(world: &World) -> Self {
        let mut walk = world.walk();
        let mut pairs = Vec::with_capacity(2 * TURNS * world.dim);
        for _ in 0..TURNS {
            // Far enough apart to be anywhere in the world.
            (0..world.dim * 16).for_each(|_| _ = walk.step());
            let transition = walk.step();
            pairs.extend_from_slice(transition.obs);
            pairs.extend_from_slice(transition.next_obs);
        }
        Self { dim: world.dim, pairs, at: 0 }
    }

    fn next(&mut self) -> (&[f32], &[f32]) {
        self.at = (self.at + 1) % TURNS;
        self.pairs[2 * self.dim * self.at..][..2 * self.dim].split_at(self.dim)
    }
}

/// The query for the mentor states similar to a state, and the scan of all of them.
pub(super) fn similar<'a>(world: &World, demonstration: &'a Demonstration) -> Vec<Case<'a>> {
    let (dim, states) = (world.dim, demonstration.states());
    let index = Similarity::new(states.to_vec(), dim, E_TH);
    let (mut stack, mut hits) = (Vec::new(), Vec::new());
    let mut seen = Seen::new(world);
    let indexed = move || {
        index.states(seen.next().0, &mut stack, &mut hits);
        black_box(&hits);
        Ok(())
    };
    let mut seen = Seen::new(world);
    let mut found = Vec::new();
    let naive = move || {
        let state = seen.next().0;
        found.clear();
        for (m, s) in states.chunks_exact(dim).enumerate() {
            let kl = kl(state, s);
            if kl <= E_TH {
                found.push((m, kl));
            }
        }
        black_box(&found);
        Ok(())
    };
    vec![Box::new(indexed), Box::new(naive)]
}

/// The inference of one observer transition, and the scan of all mentor transitions.
fn infer<'a>(world: &World, demonstration: &'a Demonstration) -> Vec<Case<'a>> {
    let (dim, states) = (world.dim, demonstration.states());
    let order = demonstration.order();
    let mut inference = Inference::new(MetricKind::Kl, InferenceKind::Any, states, dim, &order);
    let mut table = half_feasible(&order, dim);
    inference.restore(table.errors());
    let mut seen = Seen::new(world);
    let indexed = move || {
        let (state, next) = seen.next();
        let seen = Observation { state, next, similar: &[], action: 0, reward: -0.04 };
        inference.observe(&seen, &order, &mut table, |_, _, _| {});
        black_box(&table);
        Ok(())
    };
    let order = demonstration.order();
    let mut table = half_feasible(&order, dim);
    let mut seen = Seen::new(world);
    let naive = move || {
        let (state, next) = seen.next();
        for j in 0..order.n_transitions() {
            let (s, s_next) = states[order.state_of(j) * dim..][..2 * dim].split_at(dim);
            let e_kl = kl(state, s) + kl(next, s_next);
            if e_kl < table.errors()[j] {
                table.set_estimate(j, &Estimate { action: 0, e_kl, start_kl: 0.0, reward: -0.04 });
            }
        }
        black_box(&table);
        Ok(())
    };
    vec![Box::new(indexed), Box::new(naive)]
}

/// Every other mentor transition feasible, the others not.
fn half_feasible(order: &Order, dim: usize) -> AnnotationTable {
    let mut table = AnnotationTable::new(order.n_transitions(), dim, 2 * dim);
    for j in 0..order.n_transitions() {
        table.set_estimate(j, &Estimate { action: 0, e_kl: ERRORS[j % 2], start_kl: 0.0, reward: -0.04 });
    }
    table
}

/// Bridge search per stored transition, for each number of stored transitions; they take turns.
pub(super) fn bridge(
    dim: usize,
    mentor: usize,
    jitter: f32,
    sizes: &[usize],
) -> Result<Vec<(usize, f64, Option<f64>)>> {
    let world = World::new(dim, mentor, jitter);
    let demonstration = world.demonstration(mentor)?;
    let order = demonstration.order();
    let similarity = Similarity::new(demonstration.states().to_vec(), dim, E_TH);
    let path = Path { rule: RULE, order: &order, similarity: &similarity };
    let mut observers =
        sizes.iter().map(|&s| Observer::new(world, s, &demonstration, path)).collect::<Result<Vec<_>>>()?;
    let mut taken = vec![Duration::ZERO; observers.len()];
    for _ in 0..CHUNKS {
        for (observer, taken) in observers.iter_mut().zip(&mut taken) {
            *taken += observer.search(CHUNK);
        }
    }
    let row = |((&stored, observer), taken): ((&usize, &Observer<'_>), Duration)| {
        // The mean: few transitions are searched from, and those cost the most.
        let ns = taken.as_nanos() as f64 / (CHUNK * CHUNKS) as f64;
        (stored, ns, if stored <= NAIVE_STORED { observer.naive() } else { None })
    };
    Ok(sizes.iter().zip(&observers).zip(taken).map(row).collect())
}

/// An observer with a full history, which has been replaced once. All its transitions have been searched from.
struct Observer<'a> {
    walk: Walk,
    metric: Metric,
    history: History,
    graph: Graph,
    table: AnnotationTable,
    path: Path<'a>,
    scratch: straight::Scratch,
    search: Search,
}

impl<'a> Observer<'a> {
    fn new(world: World, stored: usize, demonstration: &Demonstration, path: Path<'a>) -> Result<Self> {
        let dim = world.dim;
        let mut observer = Self {
            walk: world.walk(),
            metric: Metric::diagonal(&vec![1.0; dim])?,
            history: History::new(stored, dim),
            graph: Graph::new(Cells::new(E_TH, demonstration.states(), dim)),
            table: half_feasible(path.order, dim),
            path,
            scratch: straight::Scratch::default(),
            search: Search::new(path.order.n_states(), path.order.n_transitions()),
        };
        observer.search(2 * stored);
        Ok(observer)
    }

    /// Takes `count` more transitions in; returns the time that the searches took.
    fn search(&mut self, count: usize) -> Duration {
        let Self { walk, history, graph, metric, table, path, scratch, search } = self;
        let (mut taken, mut stack) = (Duration::ZERO, Vec::new());
        let (mut starts, mut ends) = (Vec::new(), Vec::new());
        for _ in 0..count {
            let (index, news) = store(history, Some(graph), metric, 0, &walk.step());
            let start = Instant::now();
            search.prepare(graph, &history.states, path);
            let (states, oldest) = (&history.states, history.oldest());
            let t = history.get(index);
            path.similarity.states(states.whitened(t.from), &mut stack, &mut starts);
            path.similarity.states(states.whitened(t.to), &mut stack, &mut ends);
            let (starts, ends) = (starts.as_slice(), ends.as_slice());
            let new = Arrival { states, graph, t, index, oldest, news, starts, ends };
            if !search.run(&new, path, table, |_| {}) {
                straight::search(history, index, [starts, ends], path, table, scratch, |_| {});
            }
            taken += start.elapsed();
        }
        taken
    }

    /// The paper's Algorithm 1 for one infeasible mentor transition that the observer has come by, nanoseconds.
    fn naive(&self) -> Option<f64> {
        let (mut stack, mut hits, mut samples) = (Vec::new(), Vec::new(), Vec::new());
        // Some begin nowhere near an infeasible transition of the mentor's.
        for index in (self.history.oldest()..self.history.end()).step_by(self.history.len() / 1000) {
            if samples.len() == NAIVE_TRIES {
                break;
            }
            let state = self.history.states.whitened(self.history.get(index).from);
            self.path.similarity.states(state, &mut stack, &mut hits);
            let infeasible = |&(j, _): &(usize, f32)| self.table.errors()[j] >= RULE.e_infeas;
            let Some((j, _)) = transitions(&hits, self.path.order).find(infeasible) else { continue };
            let start = Instant::now();
            black_box(oracle::best(&self.history, j, true, &self.path));
            if start.elapsed() > NAIVE_LIMIT {
                return None;
            }
            samples.push(start.elapsed().as_nanos() as f64);
        }
        (!samples.is_empty()).then(|| median(samples))
    }
}
