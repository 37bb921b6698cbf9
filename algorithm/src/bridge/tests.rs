//! Bridges against Algorithm 1, over random walks of several actors.

#![allow(clippy::unwrap_used)]

use super::graph::Graph;
use super::oracle::{self, Quality};
use super::search::Search;
use super::store::store;
use super::{Arrival, BridgeRule, Path, Place, cells::Cells, straight};
use crate::demonstration::{Demonstration, Order};
use crate::history::History;
use crate::similarity::Similarity;
use crate::similarity::metric::{APART, Metric, kl};
use crate::similarity::testing::cases;
use crate::states::mix;
use proptest::prelude::*;
use trestle_proto::annotation::{AnnotationTable, Bridge, Estimate};
use trestle_proto::batch::{FIRST, TERMINATED, TRUNCATED, Transition};

/// One observer step: actor, where it goes (0 to 3), reward, whether and how its episode ends, whether it jumps first.
type Move = (u32, u8, i8, u8, bool);

#[derive(Clone, Debug)]
struct World {
    mentor: Vec<Vec<(i8, i8)>>,
    moves: Vec<Move>,
    /// Size of the grid, and the factor of its steps: 1 for whole cells, less where similarity reaches farther than a
    /// step and is not transitive.
    side: i8,
    step: f32,
    e_th: f32,
    /// The factors of x and of y in each feature: 1 to 16 features, perhaps on a line, perhaps all points equal.
    features: Vec<(f32, f32)>,
    /// How far places are moved about, so that hardly any state repeats; 0 for none.
    jitter: f32,
    k: usize,
    n: usize,
    capacity: usize,
    /// Whether everything around a transition is surveyed, however few mentor transitions are wanted.
    surveyed: bool,
    /// More wanted mentor transitions than these stand for all.
    few: usize,
    /// Whether horizons are kept, and states in a cell that is not yet crowded, at most.
    kept: bool,
    crowd: usize,
}

fn worlds() -> impl Strategy<Value = World> {
    let cell = || (0i8..4, 0i8..4);
    let mentor = proptest::collection::vec(proptest::collection::vec(cell(), 2..6), 1..3);
    let moves =
        proptest::collection::vec((0u32..3, 0u8..4, -1i8..2, 0u8..12, proptest::bool::weighted(0.05)), 1..70);
    let shape = prop_oneof![Just((1.0f32, 0.1f32)), Just((0.4, 0.1)), Just((0.7, 0.25)), Just((1.0, 0.5))];
    let features = prop_oneof![
        3 => Just(vec![(1.0f32, 0.0f32), (0.0, 1.0)]),
        1 => proptest::collection::vec((-1.0f32..1.0, -1.0f32..1.0), 1..=16),
        1 => proptest::collection::vec((-1.0f32..1.0, Just(0.0)), 1..=16),
        1 => proptest::collection::vec((Just(0.0), Just(0.0)), 1..=3),
        // A category, alone or beside a number.
        1 => proptest::collection::vec(prop_oneof![Just((APART, 0.0f32)), Just((0.0, 1.0))], 1..=3),
    ];
    let jitter = prop_oneof![2 => Just(0.0f32), 1 => 0.01f32..0.4];
    let scale = (shape, 1usize..5, 1usize..4, prop_oneof![1usize..12, 30usize..80]);
    let few = prop_oneof![Just(32), 0usize..3];
    let search = (any::<bool>(), few, any::<bool>(), prop_oneof![1usize..4, Just(64)]);
    (mentor, moves, 2i8..5, features, jitter, scale, search).prop_map(
        |(
            mentor,
            moves,
            side,
            features,
            jitter,
            ((step, e_th), k, n, capacity),
            (surveyed, few, kept, crowd),
        )| {
            World {
                mentor,
                moves,
                side,
                step,
                e_th,
                features,
                jitter,
                k,
                n,
                capacity,
                surveyed,
                few,
                kept,
                crowd,
            }
        },
    )
}

/// The same in numbers.
struct Step {
    actor: u32,
    from: Vec<f32>,
    to: Vec<f32>,
    action: u32,
    reward: f32,
    flags: u32,
}

impl Step {
    fn transition(&self) -> Transition<'_> {
        let Self { from, to, action, reward, flags, .. } = self;
        Transition { obs: from, next_obs: to, action: *action, reward: *reward, flags: *flags }
    }
}

impl World {
    fn demo(&self) -> Demonstration {
        let names = (0..self.features.len()).map(|i| format!("s{i}")).collect();
        let mut demo = Demonstration::new(names).unwrap();
        for part in &self.mentor {
            let states: Vec<f32> = part.iter().flat_map(|&c| self.place(c, 0)).collect();
            demo.push_trajectory(&states, false).unwrap();
        }
        demo
    }

    /// What the observer does, in order.
    fn steps(&self) -> Vec<Step> {
        let mut places = [(0i8, 0i8), (1, 0), (0, 1)];
        let mut fresh = [true; 3];
        // How often each actor has moved on: its s is the s' before, jitter and all.
        let mut nth = [1u64, 1 << 20, 1 << 30];
        let step = |&(actor, heading, reward, end, jump): &Move| {
            let a = actor as usize;
            if jump {
                // Without a flag: the history must notice by itself.
                places[a] = (places[a].1, places[a].0);
            }
            let (dx, dy) = [(1, 0), (0, 1), (-1, 0), (0, -1)][heading as usize];
            let inside = |x: i8| x.clamp(0, self.side - 1);
            let next = (inside(places[a].0 + dx), inside(places[a].1 + dy));
            let flags = match end {
                0 => TERMINATED,
                1 => TRUNCATED,
                _ => 0,
            } | if fresh[a] { FIRST } else { 0 };
            let (from, to) = (self.place(places[a], nth[a]), self.place(next, nth[a] + 1));
            nth[a] += 1;
            fresh[a] = end < 2;
            places[a] = if end < 2 { (0, 0) } else { next };
            Step { actor, from, to, action: u32::from(heading), reward: f32::from(reward), flags }
        };
        self.moves.iter().map(step).collect()
    }

    /// The state in cell (x, y) for the `nth` time: jitter depends on that number.
    fn place(&self, (x, y): (i8, i8), nth: u64) -> Vec<f32> {
        let shift = |salt: u64| match nth {
            0 => 0.0,
            nth => self.jitter * (mix(salt, nth) % 1000) as f32 / 1000.0,
        };
        let (x, y) = (f32::from(x) * self.step + shift(1), f32::from(y) * self.step + shift(2));
        self.features.iter().map(|(a, b)| a * x + b * y).collect()
    }
}

/// The part of a mentor-server that the tests need, without action inference, so that feasibility can be set at will.
struct Bench {
    metric: Metric,
    history: History,
    graph: Option<Graph>,
    search: Search,
    straight: straight::Scratch,
}

impl Bench {
    fn new(demo: &Demonstration, e_th: f32, capacity: usize, cross_reference: bool) -> Self {
        let (order, dim) = (demo.order(), demo.dim());
        Self {
            history: History::new(capacity, dim),
            graph: cross_reference.then(|| Graph::new(Cells::new(e_th, demo.states(), dim))),
            search: Search::new(order.n_states(), order.n_transitions()),
            straight: straight::Scratch::default(),
            metric: Metric::diagonal(&vec![1.0; dim]).unwrap(),
        }
    }

    /// Forms the horizons anew, and keeps them.
    fn keep_horizons(&mut self, path: &Path<'_>) {
        if let Some(graph) = &self.graph {
            self.search.horizon.build(graph, &self.history.states, path);
        }
    }

    fn observe(
        &mut self,
        actor: u32,
        t: &Transition<'_>,
        path: &Path<'_>,
        table: &mut AnnotationTable,
    ) -> u64 {
        let Self { metric, history, graph, search, straight } = self;
        let (index, news) = store(history, graph.as_mut(), metric, actor, t);
        let (t, mut starts, mut ends) = (history.get(index), Vec::new(), Vec::new());
        for (state, hits) in [(t.from, &mut starts), (t.to, &mut ends)] {
            path.similarity.states(history.states.whitened(state), &mut Vec::new(), hits);
        }
        let (starts, ends) = (starts.as_slice(), ends.as_slice());
        if let Some(graph) = graph {
            let (states, oldest) = (&history.states, history.oldest());
            let new = Arrival { states, graph, t, index, oldest, news, starts, ends };
            search.run(&new, path, table, |_| ());
        } else {
            straight::search(history, index, [starts, ends], path, table, straight, |_| ());
        }
        index
    }
}

/// Whether the stored transitions hold a path that is `bridge`: its first step as described, each step joined to the one
/// before, its last where it says.
fn is_real(history: &History, j: usize, bridge: &Bridge<'_>, cross_reference: bool, path: &Path<'_>) -> bool {
    let similar = |a: &[f32], b: &[f32]| kl(a, b) <= path.similarity.e_th();
    let whitened = |id| history.states.whitened(id);
    let all = || history.oldest()..history.end();
    let mut reached: Vec<u64> = all()
        .filter(|&t| {
            let step = history.get(t);
            similar(whitened(step.from), path.similarity.state(path.order.state_of(j)))
                && (step.action, step.reward) == (bridge.action, bridge.reward)
                && history.states.raw(step.to) == bridge.next_obs
                && step.terminated() == bridge.terminated
        })
        .collect();
    for _ in 1..bridge.length {
        let joined = |t: u64, next: u64| {
            let before = history.get(t);
            let similar = cross_reference && similar(whitened(before.to), whitened(history.get(next).from));
            (history.predecessor(next) == Some(t) || similar) && !before.ends_episode()
        };
        reached = all().filter(|&next| reached.iter().any(|&t| joined(t, next))).collect();
    }
    reached.iter().any(|&t| {
        let end = whitened(history.get(t).to);
        let nearest = path.order.ahead(j, path.rule.n).map(|m| kl(end, path.similarity.state(m)));
        nearest.reduce(f32::min) == Some(bridge.end_kl) && bridge.end_kl <= path.similarity.e_th()
    })
}

/// The best bridge so far: its quality, its action, s', and whether s' is terminal.
type Ever = (Quality, u32, Vec<f32>, bool);

/// The best path for mentor transition `j` through transition `index`, the newest, its first transition, and the place of
/// `index` in it; all paths are looked at.
fn through(history: &History, index: u64, j: usize, path: &Path<'_>) -> Option<(Quality, u64, Place)> {
    let similar = |a: &[f32], b: &[f32]| kl(a, b) <= path.similarity.e_th();
    let whitened = |id| history.states.whitened(id);
    let all = || history.oldest()..history.end();
    let joined = |t: u64, next: u64| {
        let before = history.get(t);
        !before.ends_episode() && similar(whitened(before.to), whitened(history.get(next).from))
    };
    let t = history.get(index);
    // A link that existed before makes no new path, but perhaps a better first step.
    let repeated = all().filter(|&other| {
        let other_t = history.get(other);
        let goes_on = t.ends_episode() || !other_t.ends_episode();
        other != index && (other_t.from, other_t.to) == (t.from, t.to) && goes_on
    });
    let repeated = repeated.map(|other| history.get(other).reward).reduce(f32::max);
    if repeated.is_some_and(|reward| reward >= t.reward) {
        return None;
    }
    let start = path.similarity.state(path.order.state_of(j));
    let mut level = vec![index];
    let mut before = 0;
    let first = loop {
        let starts = level.iter().filter(|&&f| similar(whitened(history.get(f).from), start));
        if let Some(&first) = starts.min_by(|&&a, &&b| oracle::first_order(history, a, b)) {
            break first;
        }
        before += 1;
        if before == path.rule.k || repeated.is_some() {
            return None;
        }
        level = all().filter(|&f| level.iter().any(|&next| joined(f, next))).collect();
    };
    let mut level = vec![index];
    for after in 0..path.rule.k - before {
        let ends = level.iter().filter_map(|&e| oracle::end_kl(history.get(e), j, history, path));
        if let Some(end_kl) = ends.reduce(f32::min) {
            let length = (before + 1 + after) as u32;
            let quality = Quality { length, end_kl, reward: history.get(first).reward };
            return Some((quality, first, Place { first: before == 0, last: after == 0 }));
        }
        level = all().filter(|&next| level.iter().any(|&e| joined(e, next))).collect();
    }
    None
}

/// The last `count` steps of the path of predecessors that ends with transition `index`: actions, and the states in which they were
/// taken.
fn further_straight(history: &History, index: u64, count: usize) -> Vec<(u32, Vec<f32>)> {
    let all = std::iter::successors(Some(index), |&at| history.predecessor(at)).map(|at| history.get(at));
    let mut steps: Vec<_> =
        all.take(count).map(|step| (step.action, history.states.raw(step.from).to_vec())).collect();
    steps.reverse();
    steps
}

/// The steps after the first of the bridge for mentor transition `j` through transition `index`, the newest: by walks of all
/// transitions, of every length.
fn further_through(history: &History, index: u64, j: usize, path: &Path<'_>) -> Vec<(u32, Vec<f32>)> {
    let similar = |a: &[f32], b: &[f32]| kl(a, b) <= path.similarity.e_th();
    let (whitened, raw) = (|id| history.states.whitened(id), |id| history.states.raw(id).to_vec());
    let all = || history.oldest()..history.end();
    let joined = |t: u64, next: u64| {
        let before = history.get(t);
        !before.ends_episode() && similar(whitened(before.to), whitened(history.get(next).from))
    };
    let start = path.similarity.state(path.order.state_of(j));
    let begins = |&f: &u64| similar(whitened(history.get(f).from), start);
    let best = |a: &u64, b: &u64| oracle::first_order(history, *a, *b);
    // The transitions from which so many steps lead to the newest one.
    let mut before = vec![vec![index]];
    while !before.last().unwrap().iter().any(begins) {
        let level = before.last().unwrap();
        before.push(all().filter(|&f| level.iter().any(|&next| joined(f, next))).collect());
    }
    let mut at = before.pop().unwrap().into_iter().filter(begins).min_by(best).unwrap();
    let mut steps = Vec::new();
    while let Some(level) = before.pop() {
        let next = level.into_iter().filter(|&next| joined(at, next)).min_by(best).unwrap();
        steps.push((history.get(next).action, raw(history.get(at).to)));
        at = next;
    }
    // Those that so many steps after it reach.
    let mut after = vec![vec![index]];
    let end_kl = |e: u64| oracle::end_kl(history.get(e), j, history, path);
    let least = loop {
        let level = after.last().unwrap();
        if let Some(least) = level.iter().filter_map(|&e| end_kl(e)).reduce(f32::min) {
            break least;
        }
        after.push(all().filter(|&next| level.iter().any(|&e| joined(e, next))).collect());
    };
    let ends = |m: usize, e: u64| kl(whitened(history.get(e).to), path.similarity.state(m)) == least;
    let last = after.last().unwrap();
    let goal = path.order.ahead(j, path.rule.n).find(|&m| last.iter().any(|&e| ends(m, e))).unwrap();
    let arrived = last.iter().filter(|&&e| ends(goal, e)).map(|&e| history.get(e).to);
    let mut to = arrived.min_by(|&a, &b| history.states.order(a, b)).unwrap();
    let behind = steps.len();
    for at in (1..after.len()).rev() {
        let goes_on = |next: u64| at + 1 == after.len() || !history.get(next).ends_episode();
        let links = after[at].iter().filter(|&&next| history.get(next).to == to && goes_on(next));
        let pairs = links.flat_map(|&next| after[at - 1].iter().map(move |&from| (from, next)));
        let (from, next) = pairs
            .filter(|&(from, next)| joined(from, next))
            .min_by(|a, b| {
                let (x, y) = (history.get(a.1), history.get(b.1));
                let order = y.reward.total_cmp(&x.reward).then(x.action.cmp(&y.action));
                order.then_with(|| history.states.order(history.get(a.0).to, history.get(b.0).to))
            })
            .unwrap();
        to = history.get(from).to;
        steps.push((history.get(next).action, raw(to)));
    }
    steps[behind..].reverse();
    steps
}

/// The expected bridges after transition `index`. Without cross-referencing, and in a world where states are equal or
/// dissimilar, each is the best that has ever been in the history. Otherwise each is as short as that, and the rule of
/// [`super`] decides between equally long ones.
fn expect(
    ever: Option<Ever>,
    (history, index, j): (&History, u64, usize),
    (cross_reference, discrete): (bool, bool),
    path: &Path<'_>,
) -> Result<Option<Ever>, TestCaseError> {
    let best = oracle::best(history, j, cross_reference, path);
    let found = |quality, first| {
        let step = history.get(first);
        Some((quality, step.action, history.states.raw(step.to).to_vec(), step.terminated()))
    };
    if !cross_reference || discrete {
        return Ok(match best {
            Some((now, first)) if ever.as_ref().is_none_or(|(best, ..)| now.beats(best)) => found(now, first),
            _ => ever,
        });
    }
    let next = match through(history, index, j, path) {
        Some((now, first, place))
            if ever.as_ref().is_none_or(|(known, ..)| {
                let reward = now.reward > known.reward;
                let last = now.end_kl < known.end_kl || now.end_kl == known.end_kl && reward;
                let first = now.end_kl <= known.end_kl && reward;
                let anywhere = now.end_kl == 0.0 && known.end_kl == 0.0 && reward;
                now.length < known.length
                    || now.length == known.length && (place.last && last || place.first && first || anywhere)
            }) =>
        {
            found(now, first)
        }
        _ => ever,
    };
    if let Some((best, _)) = best {
        let length = next.as_ref().map(|(quality, ..)| quality.length);
        prop_assert!(
            length.is_some_and(|length| length <= best.length),
            "{length:?}, Algorithm 1: {}",
            best.length
        );
    }
    Ok(next)
}

/// After every transition, each infeasible mentor transition's bridge is the expected one, to the last field, and real.
fn check(world: &World, cross_reference: bool) -> Result<(), TestCaseError> {
    let demo = world.demo();
    let order = demo.order();
    let dim = demo.dim();
    let similarity = Similarity::new(demo.states().to_vec(), dim, world.e_th);
    let rule = BridgeRule { k: world.k, n: world.n, e_infeas: 0.1 };
    let path = Path { rule, order: &order, similarity: &similarity };
    let mut table = AnnotationTable::new(order.n_transitions(), dim, 4).keeping(world.k - 1);
    let mut bench = Bench::new(&demo, world.e_th, world.capacity, cross_reference);
    if world.surveyed {
        bench.search.many = 0;
    }
    (bench.search.sample, bench.search.few) = (world.few, world.few);
    if let Some(graph) = &mut bench.graph {
        graph.cells.crowded = world.crowd;
    }
    let whole = [vec![(1.0, 0.0), (0.0, 1.0)], vec![(0.0, 0.0)]].contains(&world.features);
    let discrete = whole && world.jitter == 0.0 && world.step * world.step > 2.0 * world.e_th;
    // Of each mentor transition.
    let mut ever: Vec<Option<Ever>> = vec![None; order.n_transitions()];
    for (i, step) in world.steps().iter().enumerate() {
        let before = table.clone();
        if world.kept && (i == 0 || i == 50) {
            bench.keep_horizons(&path);
        }
        let index = bench.observe(step.actor, &step.transition(), &path, &mut table);
        if i == 40 {
            // From here on no bridge is looked for there.
            table.set_estimate(0, &Estimate { action: 0, e_kl: 0.0, start_kl: 0.0, reward: 0.0 });
        }
        for j in (0..order.n_transitions()).filter(|&j| table.errors()[j] >= rule.e_infeas) {
            let at = (&bench.history, index, j);
            ever[j] = expect(ever[j].take(), at, (cross_reference, discrete), &path)?;
            let stored = table.bridge(j).map(|b| {
                let quality = Quality { length: b.length, end_kl: b.end_kl, reward: b.reward };
                (quality, b.action, b.next_obs.to_vec(), b.terminated)
            });
            prop_assert_eq!(&stored, &ever[j], "mentor transition {} after {} moves", j, i + 1);
        }
        for j in (0..order.n_transitions()).filter(|&j| table.bridge(j) != before.bridge(j)) {
            let real =
                table.bridge(j).is_some_and(|b| is_real(&bench.history, j, &b, cross_reference, &path));
            prop_assert!(real, "{:?} of {} after {} moves", table.bridge(j), j, i + 1);
            let found: Vec<(u32, Vec<f32>)> = table.further(j).map_or(Vec::new(), |further| {
                let states = further.states.chunks(dim).map(<[f32]>::to_vec);
                further.actions.iter().copied().zip(states).collect()
            });
            let expected = if cross_reference {
                further_through(&bench.history, index, j, &path)
            } else {
                further_straight(&bench.history, index, found.len())
            };
            prop_assert_eq!(found.len() + 1, table.bridge(j).map_or(0, |b| b.length as usize));
            prop_assert_eq!(found, expected, "mentor transition {} after {} moves", j, i + 1);
        }
    }
    Ok(())
}

/// A search that names a sample, or is ended by horizons, finds what one finds that names all it wants and knows no horizon,
/// whatever it may look at.
fn check_sample(world: &World, limit: usize) -> Result<(), TestCaseError> {
    let demo = world.demo();
    let (order, dim) = (demo.order(), demo.dim());
    let similarity = Similarity::new(demo.states().to_vec(), dim, world.e_th);
    let rule = BridgeRule { k: world.k + 3, n: world.n, e_infeas: 0.1 };
    let path = Path { rule, order: &order, similarity: &similarity };
    let mut sides = [true, false].map(|sampled| {
        let mut bench = Bench::new(&demo, world.e_th, world.capacity, true);
        (bench.search.limit, bench.search.few) = (limit, world.few);
        let all = if world.surveyed { 0 } else { usize::MAX };
        (bench.search.many, bench.search.sample) =
            if sampled { (all, world.few) } else { (usize::MAX, usize::MAX) };
        (bench, AnnotationTable::new(order.n_transitions(), dim, 4).keeping(rule.k - 1), sampled)
    });
    for (i, step) in world.steps().iter().enumerate() {
        for (bench, table, sampled) in &mut sides {
            if *sampled && world.kept && i % 20 == 0 {
                bench.keep_horizons(&path);
            }
            bench.observe(step.actor, &step.transition(), &path, table);
        }
        let [(sampled, found, _), (all, expected, _)] = &sides;
        prop_assert_eq!(found, expected, "after {} moves", i + 1);
        prop_assert!(sampled.search.cut_short() <= all.search.cut_short());
    }
    Ok(())
}

#[test]
fn a_level_beyond_the_limit_is_dropped_whatever_the_order() {
    let mut demo = Demonstration::new(vec!["x".into(), "y".into()]).unwrap();
    demo.push_trajectory(&[0.0, 0.0, 50.0, 50.0], false).unwrap();
    let order = demo.order();
    let similarity = Similarity::new(demo.states().to_vec(), 2, 0.1);
    let path =
        Path { rule: BridgeRule { k: 2, n: 1, e_infeas: 0.1 }, order: &order, similarity: &similarity };
    let cases = [(15, 0), (15, 10), (15, 19), (1000, 0), (1000, 19)];
    for ((limit, place), kept) in cases.into_iter().flat_map(|case| [(case, false), (case, true)]) {
        let mut table = AnnotationTable::new(1, 2, 4);
        let mut bench = Bench::new(&demo, 0.1, 100, true);
        bench.search.limit = limit;
        if kept {
            bench.keep_horizons(&path);
        }
        let mut step = |obs: [f32; 2], next_obs: [f32; 2]| {
            let t = Transition { obs: &obs, next_obs: &next_obs, action: 0, reward: 0.0, flags: FIRST };
            bench.observe(0, &t, &path, &mut table);
        };
        // Twenty ways lead on from (9, 0), and one of them to the mentor's next state.
        for i in 0..20 {
            step([9.0, 0.0], if i == place { [50.0, 50.0] } else { [10.0 + i as f32, 20.0] });
        }
        step([0.0, 0.0], [9.0, 0.0]);
        let length = table.bridge(0).map(|b| b.length);
        assert_eq!(length, (limit == 1000).then_some(2), "limit {limit}, place {place}");
        assert_eq!(bench.search.cut_short(), u64::from(limit == 15));
    }
}

/// A mentor goes from 0 to 1.
fn line() -> (Demonstration, Order, Similarity) {
    let mut demo = Demonstration::new(vec!["x".into()]).unwrap();
    demo.push_trajectory(&[0.0, 1.0], false).unwrap();
    let order = demo.order();
    let similarity = Similarity::new(demo.states().to_vec(), 1, 0.1);
    (demo, order, similarity)
}

/// The observer finds a way of three steps by its sixth transition, and no other one promises anything.
#[test]
fn a_horizon_ends_searches_before_they_begin() {
    let (demo, order, similarity) = line();
    let path =
        Path { rule: BridgeRule { k: 3, n: 1, e_infeas: 0.1 }, order: &order, similarity: &similarity };
    let mut table = AnnotationTable::new(1, 1, 1);
    let mut bench = Bench::new(&demo, 0.1, 100, true);
    bench.keep_horizons(&path);
    let mut promised = Vec::new();
    for (from, to) in [(9.0, 8.0), (8.0, 0.0), (0.5, 9.0), (0.0, 2.0), (2.0, 3.0), (3.0, 1.0), (7.0, 6.0)] {
        let t = Transition { obs: &[from], next_obs: &[to], action: 0, reward: 0.0, flags: FIRST };
        let index = bench.observe(0, &t, &path, &mut table);
        let (Some(graph), t) = (&bench.graph, bench.history.get(index)) else { panic!("no graph") };
        let (states, news) = (&bench.history.states, super::graph::News::Link);
        let new = Arrival { states, graph, t, index, oldest: 0, news, starts: &[], ends: &[] };
        let outline = bench.search.horizon.outline(&new, &path, &table);
        promised.push(outline.is_none_or(|outline| outline.promises()));
    }
    assert_eq!(promised, [false, false, false, false, false, true, false]);
    assert_eq!(table.bridge(0).map(|b| b.length), Some(3));
}

/// The index is kept from when searches have been dear for some time, and given up once they are cheap.
#[test]
fn horizons_are_kept_while_they_pay() {
    let (demo, order, similarity) = line();
    let path =
        Path { rule: BridgeRule { k: 3, n: 1, e_infeas: 0.1 }, order: &order, similarity: &similarity };
    let mut bench = Bench::new(&demo, 0.1, 100, true);
    let states = &bench.history.states;
    let Some(graph) = &mut bench.graph else { panic!("no graph") };
    // For each transition: what its search looks at, and whether the index is kept then.
    let kept: Vec<bool> = (0..30_000)
        .map(|i| {
            bench.search.horizon.prepare(graph, states, &path);
            bench.search.horizon.looked(if i < 3_000 { 200 } else { 1 });
            assert_eq!(graph.cells.is_wide(), bench.search.horizon.is_kept());
            bench.search.horizon.is_kept()
        })
        .collect();
    let changes: Vec<usize> = (1..kept.len()).filter(|&i| kept[i] != kept[i - 1]).collect();
    assert_eq!(changes.len(), 2, "{changes:?}");
    assert!(changes[0] < 3_000 && changes[1] > 3_000, "{changes:?}");
}

proptest! {
    #![proptest_config(cases(300))]

    #[test]
    fn straight_bridges_are_those_of_algorithm_1(world in worlds()) {
        check(&world, false)?;
    }

    #[test]
    fn a_sample_decides_as_all_would(world in worlds(), limit in prop_oneof![1usize..200, Just(1 << 18)]) {
        check_sample(&world, limit)?;
    }

    #[test]
    fn cross_referenced_bridges_are_as_short_as_those_of_algorithm_1(world in worlds()) {
        check(&world, true)?;
    }
}
