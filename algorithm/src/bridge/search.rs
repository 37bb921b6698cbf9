//! Cross-referenced bridges: all paths through the newest transition, by breadth-first search in both directions.
//!
//! A bridge through transition t is p steps that lead to t, t itself, and q steps that follow, p + 1 + q <= k. Forward
//! from t, level q holds the states that q further steps reach; backward, level p the states from which p steps
//! lead to t. For each mentor transition the smallest p of a state similar to its beginning and the smallest q of a
//! state similar to one ahead of it make the shortest bridge through t, and each level gives the best of its ties. A
//! state is expanded at its first level only, since a later one makes no shorter path.
//!
//! The search looks only at states that could matter. `wanted` names the mentor transitions whose bridge a path through t
//! could improve, judged by the longest stored step and the nearest stored ends. Mostly there are none, and the search is
//! over before it begins. Otherwise each level keeps the states from which a wanted bridge is still within reach, until
//! every wanted one has been found or is out of reach. Of two levels the one with fewer states to expand comes first.
//!
//! With a large demonstration many mentor transitions have no bridge, and distances rule few of them out. They are not all
//! named:
//!
//! - A *survey* goes through what lies around t, whatever it may lead to, as long as that is little. It is over as soon as no
//!   beginning that it has met, or may still meet, has an end within its steps.
//! - Where it is much, a *sample* of the wanted is named. What a search does next depends on whether some wanted transition has no
//!   beginning yet, and whether some has no end, and on their goals if these are few. More than `FEW` of either kind decide as all
//!   of that kind would. As levels are looked at, entries of the sample are done with, and another is drawn. Those that have no end yet
//!   matter only while there are further levels after t, and those that have no beginning only while there are further ones before
//!   it. Once a search has met its limit in one direction, or has looked at so many levels that only short bridges are left, the
//!   wanted are all among those that it has met.
//!
//! Before anything else `horizon` is asked whether a bridge can lead through t at all. A search that goes on asks after each level
//! whether a further one could still add a bridge, and needs no survey. With and without all this the same bridges are found.
//!
//! The contents of a level depend on the stored transitions alone, not on the order in which the graph keeps them. A search that
//! has looked at [`MAX_LOOKS`] states and links in one direction drops its present level as a whole, and goes no further that way. So
//! this choice, too, depends on the stored transitions alone.

use super::frontier::{Seen, Side, Step, similar};
use super::graph::{Graph, News};
use super::horizon::Horizon;
use super::outlook::{Outlook, Stock};
use super::trace::{self, Levels, Trail};
use super::wanted::{Goal, Newest, Reach, Scratch, Tally, Wanted, backward_goals, forward_goals};
use super::{Arrival, NEVER, Path, Place, improve, known_length};
use crate::demonstration::transitions;
use crate::similarity::Hit;
use crate::similarity::metric::kl;
use crate::states::States;
use trestle_proto::annotation::{AnnotationTable, Bridge};

/// Wanted transitions from which on a survey takes the place of naming them all.
const MANY: usize = 16;
/// Wanted transitions that are named, unless it takes all to decide what a search does next.
const SAMPLE: usize = 96;
/// States and links that a survey looks at in each direction, at most.
const SURVEY: usize = 1 << 14;
/// States and links that a search looks at in each direction, at most. Beyond the limit bridges may be missed, or longer
/// than they could be, but never bridges without cross-referencing. Few searches begin, and most of them look at little.
/// The limit is there so that even the largest batch is answered before its deadline.
pub const MAX_LOOKS: usize = 1 << 18;
/// Goals that each state is compared with, at most. If there are more, the search uses the index instead, and leaves no
/// state out for its distance.
const FEW: usize = 32;

/// Where paths from t end, for each mentor state: fewest steps after t, then smallest KL.
#[derive(Clone, Debug, Default)]
struct Ends {
    steps: Vec<u32>,
    kl: Vec<f32>,
    touched: Vec<u32>,
    /// The fewest steps to any.
    least: u32,
}

/// Where paths to t begin, for each mentor transition: fewest steps before t, then best first step.
#[derive(Clone, Debug, Default)]
struct Starts {
    steps: Vec<u32>,
    first: Vec<Step>,
    touched: Vec<u32>,
    /// The most steps that one of them leaves for t and what follows.
    left: u32,
}

/// Whether any mentor state is similar to a stored state.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Beside {
    #[default]
    Unknown,
    Nothing,
    Something,
}

/// Kinds of wanted transitions of which some are not named: those without a beginning so far, and those without an end.
#[derive(Clone, Copy, Debug, Default)]
struct Missing {
    not_started: bool,
    not_ended: bool,
}

/// Working memory of the search.
#[derive(Clone, Debug)]
pub struct Search {
    /// [`MAX_LOOKS`], but for tests.
    pub(crate) limit: usize,
    /// [`MANY`], [`SAMPLE`] and [`FEW`], but for tests.
    pub(crate) many: usize,
    pub(crate) sample: usize,
    pub(crate) few: usize,
    outlook: Outlook,
    pub(super) horizon: Horizon,
    collecting: Scratch,
    wanted: Vec<Wanted>,
    /// Where the present level heads for, if that is few places, and how near to them its states must be.
    goals: Vec<Goal>,
    limits: Vec<(u32, f32)>,
    ends: Ends,
    starts: Starts,
    /// Forward: the states reached; the states among them from which a path may go on; the states that its steps leave.
    reached: Seen,
    continued: Seen,
    onward: Seen,
    level: Vec<u32>,
    next_level: Vec<u32>,
    next_reached: Vec<u32>,
    /// Backward: states from which a path comes in; states that its steps leave from.
    entered: Seen,
    left: Seen,
    /// The states that the state at hand adds to those that have been marked.
    fresh: Vec<u32>,
    back: Vec<(u32, Step)>,
    next_back: Vec<(u32, Step)>,
    /// Position of a state in `next_back`, where it is there.
    slots: Vec<u32>,
    /// For each stored state.
    beside: Vec<Beside>,
    /// The steps of a bridge that has been found.
    trail: Trail,
    stack: Vec<u32>,
    cut_short: u64,
}

impl Search {
    /// Working memory for a demonstration with this many states and transitions.
    pub fn new(mentor_states: usize, mentor_transitions: usize) -> Self {
        let nowhere = Step { action: 0, reward: 0.0, to: 0 };
        Self {
            limit: MAX_LOOKS,
            many: MANY,
            sample: SAMPLE,
            few: FEW,
            outlook: Outlook::new(mentor_states),
            horizon: Horizon::new(),
            collecting: Scratch::default(),
            wanted: Vec::new(),
            goals: Vec::new(),
            limits: Vec::new(),
            ends: Ends {
                steps: vec![NEVER; mentor_states],
                kl: vec![f32::INFINITY; mentor_states],
                touched: Vec::new(),
                least: NEVER,
            },
            starts: Starts {
                steps: vec![NEVER; mentor_transitions],
                first: vec![nowhere; mentor_transitions],
                touched: Vec::new(),
                left: 0,
            },
            reached: Seen::default(),
            continued: Seen::default(),
            onward: Seen::default(),
            entered: Seen::default(),
            left: Seen::default(),
            fresh: Vec::new(),
            level: Vec::new(),
            next_level: Vec::new(),
            next_reached: Vec::new(),
            back: Vec::new(),
            next_back: Vec::new(),
            slots: Vec::new(),
            beside: Vec::new(),
            trail: Trail::default(),
            stack: Vec::new(),
            cut_short: 0,
        }
    }

    /// Searches that met their limit so far.
    pub fn cut_short(&self) -> u64 {
        self.cut_short
    }

    /// Transitions have been stored, or annotations replaced, without [`Search::run`].
    pub fn forget(&mut self) {
        self.outlook.forget();
        self.horizon.forget();
        self.collecting.forget();
        self.beside.clear();
    }

    /// Before [`Search::run`], when the transition has been stored: has an index kept in memory, or no longer, whichever makes
    /// searches cheaper. The bridges found are the same.
    pub fn prepare(&mut self, graph: &mut Graph, states: &States, path: &Path<'_>) {
        self.horizon.prepare(graph, states, path);
    }

    /// The newest transition has been stored.
    fn learn(&mut self, new: &Arrival<'_>, path: &Path<'_>) {
        let Self { outlook, horizon, collecting, .. } = self;
        outlook.add((new.index, new.t.reward), new.starts, new.ends, path, |j| collecting.grow(j, path));
        horizon.add(new, path);
        self.beside.resize(new.states.bound().max(self.beside.len()), Beside::Unknown);
        for (id, hits) in [(new.t.from, new.starts), (new.t.to, new.ends)] {
            self.beside[id as usize] = if hits.is_empty() { Beside::Nothing } else { Beside::Something };
        }
    }

    /// Looks for bridges through a new transition and improves `table`. `improved` is called with each mentor
    /// transition whose bridge was replaced. Must be called for each transition that is stored, but for those before
    /// [`Search::forget`]. False if the search met its limit.
    pub fn run(
        &mut self,
        new: &Arrival<'_>,
        path: &Path<'_>,
        table: &mut AnnotationTable,
        mut improved: impl FnMut(usize),
    ) -> bool {
        let Arrival { t, graph, .. } = *new;
        self.learn(new, path);
        if new.news == News::Nothing {
            return true;
        }
        let outline = self.horizon.outline(new, path, table);
        if outline.is_some_and(|outline| !outline.promises()) {
            return true;
        }
        let reach = Reach::new(path.similarity.e_th(), graph.strides.longest());
        let mut ahead = Side::new(!t.ends_episode(), self.limit);
        let mut behind = Side::new(new.news == News::Link, self.limit);
        // An outline ends a search as early as a survey would.
        let most = if outline.is_some() { self.sample } else { self.many };
        let mut missing = self.collect(new, path, &reach, most, table, None);
        if missing.any() && outline.is_none() {
            if self.survey(new, path, table, &mut improved) {
                return true;
            }
            missing = self.collect(new, path, &reach, self.sample, table, None);
        }
        self.horizon.looked(self.wanted.len() as u64);
        if self.wanted.is_empty() {
            return true;
        }
        self.begin(new);
        if missing.any() {
            self.meet(new, path, table);
        } else {
            let first = Step { action: t.action, reward: t.reward, to: t.to };
            for w in self.wanted.iter().filter(|w| w.started) {
                self.starts.note(w.j, 0, first, new.states);
            }
        }
        while !outline.is_some_and(|outline| outline.is_settled(&ahead, &behind)) {
            let Self { wanted, starts, ends, .. } = self;
            wanted.retain_mut(|w| w.is_open(starts, ends, [&ahead, &behind], path));
            if missing.is_due(Tally::of(&self.wanted), self.few) {
                missing = self.collect(new, path, &reach, self.few, table, Some([&ahead, &behind]));
            }
            if self.wanted.is_empty() {
                break;
            }
            let (forward, backward) =
                (self.wanted.iter().any(|w| !w.ended), self.wanted.iter().any(|w| !w.started));
            // Nothing has been marked before the first level.
            if ahead.steps + behind.steps == 0 {
                self.mark(new);
            }
            if backward && (!forward || self.back.len() < self.level.len()) {
                self.backward(new, &mut behind, path, Some(&reach), table);
            } else {
                self.forward(new, &mut ahead, path, Some(&reach));
            }
        }
        self.horizon.looked(ahead.looks() + behind.looks());
        let cut_short = ahead.exhausted() || behind.exhausted();
        self.cut_short += u64::from(cut_short);
        self.join(new, path, table, &mut improved);
        self.ends.clear();
        self.starts.clear();
        !cut_short
    }

    /// Names the mentor transitions whose bridge a path through t could improve; with `sides`, those that are still open. Of each
    /// kind at least `most` + 1 are named, or all of them. Returns the kinds of which some are missing.
    fn collect(
        &mut self,
        new: &Arrival<'_>,
        path: &Path<'_>,
        reach: &Reach,
        most: usize,
        table: &AnnotationTable,
        sides: Option<[&Side; 2]>,
    ) -> Missing {
        let Arrival { states, t, graph, oldest, starts, ends, .. } = *new;
        let Self { outlook, collecting, wanted, starts: begun, ends: ended, .. } = self;
        let newest = Newest {
            from: states.whitened(t.from),
            to: states.whitened(t.to),
            reward: t.reward,
            starts,
            ends,
            path,
            stock: Stock { states, graph, oldest },
            reach: *reach,
            table,
            levels: sides.map_or([0; 2], |sides| sides.map(|side| side.steps as u32)),
        };
        let mut keep = |w: &mut Wanted| sides.is_none_or(|sides| w.is_open(begun, ended, sides, path));
        newest.collect_near(outlook, collecting, wanted, &mut keep);
        let mut missing = Missing::default();
        let [further_ahead, further_behind] = sides.map_or([true; 2], |sides| sides.map(|side| side.open));
        // What lacks an end is open only as long as there are further levels ahead, and what lacks a beginning, behind.
        if further_ahead {
            let met = begun.touched.iter().map(|&j| j as usize);
            let is_enough = |tally: Tally| tally.not_ended > most;
            missing.not_ended = !newest.collect_met(met, outlook, collecting, wanted, &mut keep, is_enough);
        }
        if further_behind {
            let met = ended.within(newest.most_after()).iter();
            let met = met.flat_map(|&m| path.order.behind(m as usize, path.rule.n));
            let is_enough = |tally: Tally| tally.not_started > most;
            missing.not_started = !newest.collect_met(met, outlook, collecting, wanted, &mut keep, is_enough);
        }
        let is_met = !(further_ahead && further_behind) || newest.is_only_met();
        if !is_met && !newest.collect_far(outlook, collecting, most, wanted, &mut keep) {
            missing = Missing { not_started: true, not_ended: true };
        }
        missing
    }

    /// Goes through all that lies around t, and improves `table`. False if that is too much: then nothing has changed.
    fn survey(
        &mut self,
        new: &Arrival<'_>,
        path: &Path<'_>,
        table: &mut AnnotationTable,
        improved: &mut impl FnMut(usize),
    ) -> bool {
        let (t, k) = (new.t, path.rule.k as u32);
        let limit = self.limit.min(SURVEY);
        let mut ahead = Side::new(!t.ends_episode(), limit);
        let mut behind = Side::new(new.news == News::Link, limit);
        self.wanted.clear();
        self.begin(new);
        self.mark(new);
        self.meet(new, path, table);
        while !ahead.exhausted() && !behind.exhausted() {
            let next = [&ahead, &behind].map(|side| if side.open { side.steps as u32 + 1 } else { NEVER });
            // A beginning p steps before t and an end q steps after it make p + 1 + q.
            let left = self.starts.left.max(k.saturating_sub(next[1]));
            let nearest = self.ends.least.min(next[0]);
            let forward = next[0] < left;
            let backward = next[1].saturating_add(1).saturating_add(nearest) <= k;
            if backward && (!forward || self.back.len() < self.level.len()) {
                self.backward(new, &mut behind, path, None, table);
            } else if forward {
                self.forward(new, &mut ahead, path, None);
            } else {
                self.join(new, path, table, improved);
                break;
            }
        }
        self.horizon.looked(ahead.looks() + behind.looks());
        self.ends.clear();
        self.starts.clear();
        !ahead.exhausted() && !behind.exhausted()
    }

    /// The first level: the end of t itself, and its beginning.
    fn begin(&mut self, new: &Arrival<'_>) {
        let t = new.t;
        self.level.clear();
        self.level.push(t.to);
        new.ends.iter().for_each(|hit| self.ends.note(hit, 0));
        let first = Step { action: t.action, reward: t.reward, to: t.to };
        self.back.clear();
        self.back.push((t.from, first));
    }

    /// Notes t as the first step from where it begins.
    fn meet(&mut self, new: &Arrival<'_>, path: &Path<'_>, table: &AnnotationTable) {
        let first = Step { action: new.t.action, reward: new.t.reward, to: new.t.to };
        for (j, _) in transitions(new.starts, path.order) {
            self.starts.meet(j, 0, first, (table, path), new.states);
        }
    }

    /// Marks the first level, and no other state.
    fn mark(&mut self, new: &Arrival<'_>) {
        let (t, bound) = (new.t, new.states.bound());
        let Self { reached, continued, onward, entered, left, .. } = self;
        [reached, continued, onward, entered, left].into_iter().for_each(|marks| marks.begin(bound));
        self.slots.resize(bound.max(self.slots.len()), 0);
        self.reached.first_time(t.to, 0);
        self.continued.first_time(t.to, 0);
        self.left.first_time(t.from, 0);
    }

    /// The next level of states after t: with `reach` those from which a wanted bridge is within it.
    fn forward(&mut self, new: &Arrival<'_>, side: &mut Side, path: &Path<'_>, reach: Option<&Reach>) {
        let Arrival { states, graph, .. } = *new;
        let next = side.steps as u32 + 1;
        let Self { goals, limits, wanted, ends, beside, stack, few: most, .. } = self;
        limits.clear();
        let few = reach.is_some_and(|reach| {
            let few = forward_goals(wanted, path, reach, *most, goals);
            limits.extend(goals.iter().filter_map(|goal| Some((goal.m, goal.limit(next, reach)?))));
            few
        });
        let Self { reached, continued, onward, fresh, level, next_level, next_reached, .. } = self;
        next_level.clear();
        next_reached.clear();
        side.expect(graph, level.iter().copied());
        for &y in level.iter() {
            if side.exhausted() {
                break;
            }
            similar(graph, states, y, path, (side, onward, next), fresh);
            for &z in fresh.iter() {
                side.look(graph.outgoing(z).len());
                for link in graph.outgoing(z) {
                    if reached.first_time(link.to, next) {
                        next_reached.push(link.to);
                    }
                    if link.continues()
                        && continued.first_time(link.to, next)
                        && (!few || within(states.whitened(link.to), limits, path))
                    {
                        next_level.push(link.to);
                    }
                }
            }
        }
        side.steps += 1;
        side.open = !side.exhausted() && !next_level.is_empty();
        if side.exhausted() {
            return;
        }
        for &id in next_reached.iter() {
            let state = states.whitened(id);
            if few {
                path.similarity.among(state, goals.iter().map(|goal| goal.m), |hit| ends.note(&hit, next));
            } else {
                beside[id as usize].hits(state, path, stack, |hit| ends.note(&hit, next));
            }
        }
        std::mem::swap(level, next_level);
    }

    /// The next level of states before t: with `reach` those to which a wanted bridge is within it.
    fn backward(
        &mut self,
        new: &Arrival<'_>,
        side: &mut Side,
        path: &Path<'_>,
        reach: Option<&Reach>,
        table: &AnnotationTable,
    ) {
        let Arrival { states, graph, .. } = *new;
        let next = side.steps as u32 + 1;
        let Self { goals, limits, wanted, starts, beside, stack, few: most, .. } = self;
        limits.clear();
        let few = reach.is_some_and(|reach| {
            let few = backward_goals(wanted, path, reach, *most, goals);
            limits.extend(goals.iter().filter_map(|goal| Some((goal.m, goal.limit(next, reach)?))));
            few
        });
        let Self { entered, left, fresh, back, next_back, slots, .. } = self;
        next_back.clear();
        side.expect(graph, back.iter().map(|&(z, _)| z));
        for &(z, _) in back.iter() {
            if side.exhausted() {
                break;
            }
            similar(graph, states, z, path, (side, entered, next), fresh);
            for &y in fresh.iter() {
                side.look(graph.incoming(y).len());
                for link in graph.incoming(y) {
                    let Some((action, reward)) = link.best_continuing() else { continue };
                    let (x, first) = (link.from, Step { action, reward, to: y });
                    if left.first_time(x, next) {
                        slots[x as usize] = next_back.len() as u32;
                        next_back.push((x, first));
                    } else if let Some((at, known)) = next_back.get_mut(slots[x as usize] as usize)
                        && *at == x
                        && first.beats(known, states)
                    {
                        *known = first;
                    }
                }
            }
        }
        side.steps += 1;
        side.open = !side.exhausted();
        if side.exhausted() {
            return;
        }
        for &(id, first) in next_back.iter() {
            let state = states.whitened(id);
            let meet = |hit: Hit| {
                if let Some(j) = path.order.transition_of(hit.state as usize) {
                    starts.meet(j, next, first, (table, path), states);
                }
            };
            if few {
                path.similarity.among(state, goals.iter().map(|goal| goal.m), meet);
            } else {
                beside[id as usize].hits(state, path, stack, meet);
            }
        }
        next_back.retain(|&(id, _)| !few || within(states.whitened(id), limits, path));
        side.open = !next_back.is_empty();
        std::mem::swap(back, next_back);
    }

    /// Puts beginnings and ends together.
    fn join(
        &mut self,
        new: &Arrival<'_>,
        path: &Path<'_>,
        table: &mut AnnotationTable,
        improved: &mut impl FnMut(usize),
    ) {
        let Self { starts, ends, trail, reached, continued, onward, entered, left, .. } = self;
        let levels = Levels { reached, continued, onward, entered, left };
        for &j in &starts.touched {
            let j = j as usize;
            let mut end = (NEVER, f32::INFINITY);
            let mut arrived = path.order.state_of(j);
            for m in path.order.ahead(j, path.rule.n) {
                if (ends.steps[m], ends.kl[m]) < end {
                    end = (ends.steps[m], ends.kl[m]);
                    arrived = m;
                }
            }
            let before = starts.steps[j];
            if end.0 == NEVER || (before + 1 + end.0) as usize > path.rule.k {
                continue;
            }
            let first = &starts.first[j];
            let found = Bridge {
                action: first.action,
                length: before + 1 + end.0,
                reward: first.reward,
                end_kl: end.1,
                next_obs: new.states.raw(first.to),
                // A first step with another behind it did not end its episode.
                terminated: before == 0 && new.t.terminated(),
                ahead: (arrived - path.order.state_of(j)) as u32,
            };
            let place = Place { first: before == 0, last: end.0 == 0 };
            if improve(table, j, &found, place) {
                improved(j);
                if table.further_at_most() > 0 && found.length > 1 {
                    let goal = path.similarity.state(arrived);
                    let ends = trace::Ends { before, after: end.0, first: *first, goal, end_kl: end.1 };
                    trace::trace(&ends, &levels, new, path, trail);
                    table.set_further(j, trail.steps(new.states));
                }
            }
        }
    }
}

impl Wanted {
    /// Brings this entry up to date with what the sides, ahead and behind, have found. False if it is complete, or out of reach.
    fn is_open(
        &mut self,
        starts: &Starts,
        ends: &Ends,
        [ahead, behind]: [&Side; 2],
        path: &Path<'_>,
    ) -> bool {
        let found = starts.steps[self.j as usize];
        self.started = found != NEVER;
        self.before = if self.started { found } else { self.before.max(behind.steps as u32 + 1) };
        let found =
            path.order.ahead(self.j as usize, path.rule.n).map(|m| ends.steps[m]).min().unwrap_or(NEVER);
        self.ended = found != NEVER;
        self.after = if self.ended { found } else { self.after.max(ahead.steps as u32 + 1) };
        let open = (self.started || behind.open) && (self.ended || ahead.open);
        !(self.started && self.ended) && open && self.is_possible()
    }
}

impl Beside {
    /// Calls `visit` with the mentor states similar to `state`, of which this is the entry.
    fn hits(&mut self, state: &[f32], path: &Path<'_>, stack: &mut Vec<u32>, mut visit: impl FnMut(Hit)) {
        if *self == Self::Nothing {
            return;
        }
        *self = Self::Nothing;
        path.similarity.each(state, stack, |hit| {
            *self = Self::Something;
            visit(hit);
        });
    }
}

impl Missing {
    /// Whether some are missing.
    fn any(self) -> bool {
        self.not_started || self.not_ended
    }

    /// Whether no more than `few` of a kind are left of which some are missing.
    fn is_due(self, left: Tally, few: usize) -> bool {
        self.not_started && left.not_started <= few || self.not_ended && left.not_ended <= few
    }
}

impl Ends {
    /// The mentor states to which at most `steps` steps after t lead.
    fn within(&self, steps: u32) -> &[u32] {
        // A level is noted as a whole, after all nearer ones.
        &self.touched[..self.touched.partition_point(|&m| self.steps[m as usize] <= steps)]
    }

    /// A path has arrived near a mentor state after `steps` steps.
    fn note(&mut self, hit: &Hit, steps: u32) {
        let m = hit.state as usize;
        if self.steps[m] == NEVER {
            self.touched.push(hit.state);
        }
        self.least = self.least.min(steps);
        if (steps, hit.kl) < (self.steps[m], self.kl[m]) {
            (self.steps[m], self.kl[m]) = (steps, hit.kl);
        }
    }

    /// Forgets everything.
    fn clear(&mut self) {
        let Self { steps, kl, touched, least } = self;
        *least = NEVER;
        touched.drain(..).for_each(|m| (steps[m as usize], kl[m as usize]) = (NEVER, f32::INFINITY));
    }
}

impl Starts {
    /// Notes the beginning of a path to t near the beginning of mentor transition `j`, if `j` is infeasible and a bridge with
    /// so many steps before t could be of use.
    fn meet(
        &mut self,
        j: usize,
        steps: u32,
        first: Step,
        (table, path): (&AnnotationTable, &Path<'_>),
        states: &States,
    ) {
        if table.errors()[j] < path.rule.e_infeas {
            return;
        }
        let most = known_length(table, j, &path.rule).unwrap_or(path.rule.k as u32);
        if steps < most {
            self.left = self.left.max(most - steps);
            self.note(j as u32, steps, first, states);
        }
    }

    /// A path to t, of `steps` steps before it, begins near the beginning of mentor transition `j` with `first`.
    fn note(&mut self, j: u32, steps: u32, first: Step, states: &States) {
        let at = j as usize;
        let known = self.steps[at];
        if known == NEVER {
            self.touched.push(j);
        }
        if steps < known || (steps == known && first.beats(&self.first[at], states)) {
            (self.steps[at], self.first[at]) = (steps, first);
        }
    }

    /// Forgets everything.
    fn clear(&mut self) {
        let Self { steps, touched, left, .. } = self;
        *left = 0;
        touched.drain(..).for_each(|j| steps[j as usize] = NEVER);
    }
}

/// Whether `state` is near enough to one of the mentor states in `limits`.
fn within(state: &[f32], limits: &[(u32, f32)], path: &Path<'_>) -> bool {
    limits.iter().any(|&(m, limit)| kl(state, path.similarity.state(m as usize)) <= limit)
}
