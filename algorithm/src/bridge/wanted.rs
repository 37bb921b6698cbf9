//! The aims of a search: the bridges that a path through the newest transition could still improve, as far as distances
//! allow.
//!
//! A step changes the whitened state by the longest stored step at most, and the join before it by the radius of
//! similarity. So a state that is farther away than i of both cannot be reached, or left, in i steps. The search does not
//! look at states that this rules out. It never rules out a state that could improve a bridge.

use super::frontier::Marks;
use super::outlook::{Outlook, Stock};
use super::room::Room;
use super::{NEVER, Path, known, known_length};
use crate::demonstration::transitions;
use crate::similarity::Hit;
use crate::similarity::metric::kl;
use trestle_proto::annotation::AnnotationTable;

/// Distances are taken as this much shorter than computed, which covers rounding: sums of 4096 squares are off by less.
const SHORTER: f64 = 0.999;

/// How far steps lead.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reach {
    /// The radius of similarity.
    pub(super) radius: f64,
    /// The largest change by a join and a step.
    stride: f64,
}

/// Divergences overflow from this distance on.
const OVERFLOW: f64 = 2.6e19;
/// No two whitened states are farther from each other than this.
const FARTHEST: f64 = 1e21;
/// Less than any divergence.
const NOWHERE: f32 = -1.0;
/// More steps than any path has.
const MANY: u32 = 1 << 20;

/// The distance of whitened states with divergence `kl`, or less where that has overflowed.
fn distance(kl: f32) -> f64 {
    (2.0 * f64::from(kl)).sqrt().min(OVERFLOW)
}

impl Reach {
    /// `e_th`, and KL between s and s' of the longest step.
    pub(super) fn new(e_th: f32, longest: f32) -> Self {
        let radius = distance(e_th);
        let longest = if longest.is_finite() { distance(longest) } else { FARTHEST };
        Self { radius, stride: radius + longest }
    }

    /// The fewest steps that may lead from a state to within `radius` of one with divergence `kl`.
    pub(super) fn steps(&self, kl: f32, radius: f64) -> u32 {
        let strides = ((distance(kl) * SHORTER - radius) / self.stride).min(f64::from(MANY));
        // Upwards without a call to the mathematical library, which is what `ceil` would be.
        let whole = strides as u32;
        whole + u32::from(f64::from(whole) < strides)
    }

    /// The largest divergence that `steps` steps may overcome to within `radius`.
    pub(super) fn limit(&self, steps: u32, radius: f64) -> f32 {
        let distance = (f64::from(steps) * self.stride + radius) / (SHORTER * SHORTER);
        (0.5 * distance * distance) as f32
    }

    /// The largest divergence between s of t and a mentor state that leaves a bridge of `steps` + 2 steps room for `steps` of
    /// them before t, and one or more after it. A bridge leads back to within `span` of where it began. So the farther away it
    /// begins, the more steps it needs after t, which changes the state by KL `step`.
    fn room(&self, steps: u32, step: f32, span: f64) -> f32 {
        let both = f64::from(steps + 1) * self.stride + 2.0 * self.radius;
        let farthest = 0.5 * (both / SHORTER + distance(step) + span) / (SHORTER * SHORTER);
        let limit = if step.is_finite() { (0.5 * farthest * farthest) as f32 } else { f32::INFINITY };
        limit.min(self.limit(steps, self.radius))
    }
}

/// A mentor transition whose bridge may be improved.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wanted {
    pub(super) j: u32,
    /// Steps of the longest bridge that is of use.
    longest: u32,
    /// Largest end KL that is of use in one of these many steps, unless t is its last; any in a shorter one.
    end_kl: f32,
    /// Fewest steps before t and after it, as far as is known.
    pub(super) before: u32,
    pub(super) after: u32,
    /// Whether that many have been found.
    pub(super) started: bool,
    pub(super) ended: bool,
}

impl Wanted {
    /// Whether a bridge with these many steps could still be of use.
    pub(super) fn is_possible(&self) -> bool {
        self.before.saturating_add(1).saturating_add(self.after) <= self.longest
    }
}

/// A mentor state that a search heads for, and the last levels from which it may be reached in time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Goal {
    pub(super) m: u32,
    /// For a bridge that is shorter than the one known: anywhere within the radius of similarity.
    shorter: u32,
    /// For one that is as long: within `radius`.
    equal: u32,
    radius: f64,
}

impl Goal {
    /// Adds this goal to `goals`, or widens the goal of the same mentor state. False if there are `most` already.
    fn join(self, most: usize, goals: &mut Vec<Self>) -> bool {
        let full = goals.len() == most;
        match goals.iter_mut().find(|goal| goal.m == self.m) {
            Some(goal) => {
                // A step leads farther than any radius: the larger number of steps decides.
                goal.shorter = goal.shorter.max(self.shorter);
                if (self.equal, self.radius) > (goal.equal, goal.radius) {
                    (goal.equal, goal.radius) = (self.equal, self.radius);
                }
            }
            None if full => return false,
            None => goals.push(self),
        }
        true
    }

    /// The largest KL at which a state on level `level` may be, if paths go on from there.
    pub(super) fn limit(&self, level: u32, reach: &Reach) -> Option<f32> {
        let left = |last: u32| last.checked_sub(level).filter(|&left| left > 0);
        let shorter = left(self.shorter).map(|left| reach.limit(left, reach.radius));
        let equal = left(self.equal).map(|left| reach.limit(left, self.radius));
        shorter.into_iter().chain(equal).reduce(f32::max)
    }
}

/// The newest transition t, whitened, among the stored ones.
#[derive(Clone, Copy, Debug)]
pub(super) struct Newest<'a> {
    /// s.
    pub(super) from: &'a [f32],
    /// s'.
    pub(super) to: &'a [f32],
    pub(super) reward: f32,
    /// The mentor states similar to s, and those similar to s'.
    pub(super) starts: &'a [Hit],
    pub(super) ends: &'a [Hit],
    pub(super) path: &'a Path<'a>,
    pub(super) stock: Stock<'a>,
    pub(super) reach: Reach,
    pub(super) table: &'a AnnotationTable,
    /// The levels after t and before t that have been looked at.
    pub(super) levels: [u32; 2],
}

/// Working memory of [`Newest::collect_near`], [`Newest::collect_met`] and [`Newest::collect_far`].
#[derive(Clone, Debug, Default)]
pub(super) struct Scratch {
    room: Room,
    /// The largest distance between the beginning of a mentor transition and a state where a bridge of it may end.
    span: Option<f64>,
    limits: Vec<f32>,
    seen: Marks,
    stack: Vec<u32>,
}

impl Scratch {
    /// Annotations have been replaced.
    pub(super) fn forget(&mut self) {
        self.room.forget();
    }

    /// Mentor transition `j` may have become one that stored transitions cover ([`Outlook::covers`]).
    pub(super) fn grow(&mut self, j: usize, path: &Path<'_>) {
        self.room.grow(path.similarity.fine(), path.order.state_of(j), most_room(path));
    }
}

/// The most steps of a path before t, if it also goes on after t.
fn most_room(path: &Path<'_>) -> u32 {
    (path.rule.k as u32).saturating_sub(2)
}

/// The largest distance between a mentor state and one that is ahead of it.
fn span(path: &Path<'_>) -> f64 {
    let state = |m| path.similarity.state(m);
    let of = |j| {
        let start = state(path.order.state_of(j));
        path.order.ahead(j, path.rule.n).map(|m| kl(start, state(m))).fold(0.0, f32::max)
    };
    let farthest = (0..path.order.n_transitions()).map(of).fold(0.0, f32::max);
    if farthest.is_finite() { distance(farthest) } else { FARTHEST }
}

impl Newest<'_> {
    /// Fills `wanted` with the mentor transitions whose bridge a path through t may improve with t as its first step or as its
    /// last one, as far as `keep` is for them.
    pub(super) fn collect_near(
        &self,
        outlook: &mut Outlook,
        scratch: &mut Scratch,
        wanted: &mut Vec<Wanted>,
        keep: &mut impl FnMut(&mut Wanted) -> bool,
    ) {
        wanted.clear();
        let Path { rule, order, similarity } = self.path;
        let seen = &mut scratch.seen;
        seen.begin(order.n_transitions());
        for (j, start_kl) in transitions(self.starts, order) {
            if self.is_infeasible(j) && seen.first_time(j as u32) {
                wanted.extend(self.want(j, start_kl, outlook, keep));
            }
        }
        for hit in self.ends {
            for j in order.behind(hit.state as usize, rule.n) {
                if self.is_infeasible(j) && seen.first_time(j as u32) {
                    let start_kl = kl(self.from, similarity.state(order.state_of(j)));
                    wanted.extend(self.want(j, start_kl, outlook, keep));
                }
            }
        }
    }

    fn is_infeasible(&self, j: usize) -> bool {
        self.table.errors()[j] >= self.path.rule.e_infeas
    }

    /// Adds those of the mentor transitions `met` whose bridge leaves room for more steps on both sides of t, after
    /// [`Newest::collect_near`]. They come perhaps more than once. False once there are enough: then some are missing.
    pub(super) fn collect_met(
        &self,
        mut met: impl Iterator<Item = usize>,
        outlook: &mut Outlook,
        scratch: &mut Scratch,
        wanted: &mut Vec<Wanted>,
        keep: &mut impl FnMut(&mut Wanted) -> bool,
        is_enough: impl Fn(Tally) -> bool,
    ) -> bool {
        let Path { order, similarity, .. } = self.path;
        let (step, widest) = (kl(self.from, self.to), *scratch.span.get_or_insert_with(|| span(self.path)));
        let Scratch { limits, seen, .. } = scratch;
        limits.clear();
        limits.extend((0..=most_room(self.path)).map(|steps| self.reach.room(steps, step, widest)));
        let mut tally = Tally::of(wanted);
        while !is_enough(tally)
            && let Some(j) = met.next()
        {
            if !(self.is_infeasible(j) && seen.first_time(j as u32)) {
                continue;
            }
            let (kl, steps) = (kl(self.from, similarity.state(order.state_of(j))), self.room_of(j));
            if steps > 0
                && kl <= limits[steps as usize]
                && self.could_want(j, self.reach.steps(kl, self.reach.radius), keep)
                && let Some(new) = self.want(j, kl, outlook, keep)
            {
                tally.add(&new);
                wanted.push(new);
            }
        }
        !is_enough(tally)
    }

    /// The most steps after t that a bridge may have if no beginning of it lies on a level so far.
    pub(super) fn most_after(&self) -> u32 {
        let [_, before] = self.levels;
        (self.path.rule.k as u32).saturating_sub(before + 2)
    }

    /// Whether a bridge of a mentor transition would be too long of which neither the beginning nor an end lies on a level so far.
    pub(super) fn is_only_met(&self) -> bool {
        self.levels.iter().map(|steps| steps + 1).sum::<u32>() + 1 > self.path.rule.k as u32
    }

    /// The same for all others, after [`Newest::collect_met`].
    pub(super) fn collect_far(
        &self,
        outlook: &mut Outlook,
        scratch: &mut Scratch,
        most: usize,
        wanted: &mut Vec<Wanted>,
        keep: &mut impl FnMut(&mut Wanted) -> bool,
    ) -> bool {
        let Path { order, similarity, .. } = self.path;
        let Scratch { room, limits, seen, stack, .. } = scratch;
        // These have neither a beginning nor an end on a level so far.
        let [after, before] = self.levels;
        for (limit, steps) in limits.iter_mut().zip(0u32..) {
            *limit = match steps.checked_sub(after).filter(|&left| left > before) {
                Some(left) => limit.min(self.reach.limit(left, self.reach.radius)),
                None => NOWHERE,
            };
        }
        let mut tally = Tally::of(wanted);
        room.around(self.from, similarity.fine(), limits, stack, |m, kl| {
            let open = order.transition_of(m).filter(|&j| self.is_infeasible(j));
            let Some((j, steps)) = open.map(|j| (j, self.room_of(j))) else { return Some(0) };
            // A transition that cannot be wanted now need not be looked up in the outlook.
            let before = self.reach.steps(kl, self.reach.radius);
            if steps == 0 || kl > limits[steps as usize] || !self.could_want(j, before, keep) {
                return Some(steps);
            }
            if !outlook.covers(j, &self.stock, self.path) {
                return Some(0);
            }
            if seen.first_time(j as u32)
                && let Some(new) = self.want(j, kl, outlook, keep)
            {
                tally.add(&new);
                wanted.push(new);
                if tally.is_more_than(most) {
                    return None;
                }
            }
            Some(steps)
        })
    }

    /// The steps that a bridge of infeasible mentor transition `j` may have before t, if it has some after t, too.
    fn room_of(&self, j: usize) -> u32 {
        let known = known_length(self.table, j, &self.path.rule);
        known.map_or(most_room(self.path), |length| length.saturating_sub(2))
    }

    /// Whether `keep` may be for mentor transition `j`, whatever its ends. At least `before` steps lead from where it begins to t.
    fn could_want(&self, j: usize, before: u32, keep: &mut impl FnMut(&mut Wanted) -> bool) -> bool {
        let longest = known_length(self.table, j, &self.path.rule).unwrap_or(self.path.rule.k as u32);
        let (started, ended) = (false, false);
        keep(&mut Wanted { j: j as u32, longest, end_kl: 0.0, before, after: 0, started, ended })
    }

    /// The entry for mentor transition `j`, which begins at KL `start_kl` from s, if its bridge may be improved, and if `keep` is for
    /// it.
    fn want(
        &self,
        j: usize,
        start_kl: f32,
        outlook: &mut Outlook,
        keep: &mut impl FnMut(&mut Wanted) -> bool,
    ) -> Option<Wanted> {
        let Self { to, path, stock, reach, table, .. } = self;
        let similarity = path.similarity;
        let known = known(table, j, &path.rule);
        let most = known.as_ref().map_or(path.rule.k as u32, |known| known.length);
        let longest = most - u32::from(known.is_some());
        let started = start_kl <= similarity.e_th();
        if most == 1 && !(started && path.nearest_end(j, self.ends).is_some()) {
            return None;
        }
        let before = reach.steps(start_kl, reach.radius);
        let farthest = reach.limit(most.checked_sub(before + 1)?, reach.radius);
        let mut wanted = Wanted {
            j: j as u32,
            longest,
            end_kl: similarity.e_th(),
            before,
            after: NEVER,
            started,
            ended: false,
        };
        let Some(known) = &known else {
            // The nearest end decides.
            let mut least = None;
            for m in path.order.ahead(j, path.rule.n) {
                let kl = kl(to, similarity.state(m));
                let nearer = kl <= farthest && least.is_none_or(|least| kl < least);
                if nearer && outlook.nearest_end(m, stock, similarity).is_some() {
                    least = Some(kl);
                }
            }
            wanted.after = reach.steps(least?, reach.radius);
            outlook.best_start(path.order.state_of(j), stock, similarity)?;
            return (wanted.is_possible() && keep(&mut wanted)).then_some(wanted);
        };
        for m in path.order.ahead(j, path.rule.n) {
            let kl = kl(to, similarity.state(m));
            if kl > farthest {
                continue;
            }
            let after = reach.steps(kl, reach.radius);
            if before + 1 + after > most {
                continue;
            }
            let Some(nearest) = outlook.nearest_end(m, stock, similarity) else { continue };
            let best_start = outlook.best_start(path.order.state_of(j), stock, similarity)?;
            if before + 1 + after <= longest {
                wanted.after = wanted.after.min(after);
            }
            // An equally long one: t is its last step, or its first one, or any.
            if kl < known.end_kl || kl == known.end_kl && best_start > known.reward {
                (wanted.longest, wanted.after) = (known.length, 0);
            }
            let first = wanted.started && self.reward > known.reward;
            let any = known.end_kl == 0.0 && best_start > known.reward;
            let after = reach.steps(kl, distance(known.end_kl));
            if (first || any) && nearest <= known.end_kl && before + 1 + after <= known.length {
                (wanted.longest, wanted.end_kl) = (known.length, known.end_kl);
                wanted.after = wanted.after.min(after);
            }
        }
        (wanted.is_possible() && keep(&mut wanted)).then_some(wanted)
    }
}

/// How many wanted mentor transitions have no beginning yet, and how many no end. They have as many goals and more.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tally {
    pub(super) not_started: usize,
    pub(super) not_ended: usize,
}

impl Tally {
    pub(super) fn of(wanted: &[Wanted]) -> Self {
        let mut tally = Self::default();
        wanted.iter().for_each(|w| tally.add(w));
        tally
    }

    fn add(&mut self, w: &Wanted) {
        self.not_started += usize::from(!w.started);
        self.not_ended += usize::from(!w.ended);
    }

    /// Whether both are more than `most`.
    pub(super) fn is_more_than(self, most: usize) -> bool {
        self.not_started.min(self.not_ended) > most
    }
}

/// Fills `goals` with the mentor states that the search forward heads for, each once. False, and of no use, if they are
/// more than `most`.
pub(super) fn forward_goals(
    wanted: &[Wanted],
    path: &Path<'_>,
    reach: &Reach,
    most: usize,
    goals: &mut Vec<Goal>,
) -> bool {
    goals.clear();
    wanted.iter().filter(|w| !w.ended).all(|w| {
        let equal = w.longest - (w.before + 1);
        let radius = distance(w.end_kl).min(reach.radius);
        let mut ahead = path.order.ahead(w.j as usize, path.rule.n);
        ahead.all(|m| Goal { m: m as u32, shorter: equal.saturating_sub(1), equal, radius }.join(most, goals))
    })
}

/// The same for the search backward.
pub(super) fn backward_goals(
    wanted: &[Wanted],
    path: &Path<'_>,
    reach: &Reach,
    most: usize,
    goals: &mut Vec<Goal>,
) -> bool {
    goals.clear();
    wanted.iter().filter(|w| !w.started).all(|w| {
        let (m, equal) = (path.order.state_of(w.j as usize) as u32, w.longest - (w.after + 1));
        Goal { m, shorter: equal, equal, radius: reach.radius }.join(most, goals)
    })
}
