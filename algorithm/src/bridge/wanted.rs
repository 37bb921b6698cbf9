//! The aims of a search: the bridges that a path through the newest transition could still improve, as far as distances
//! allow.
//!
//! A step changes the whitened state by the longest stored step at most, and the join before it by the radius of
//! similarity. So a state that is farther away than i of both cannot be reached, or left, in i steps. The search does not
//! look at states that this rules out. It never rules out a state that could improve a bridge.

use super::frontier::Marks;
use super::outlook::{Outlook, Stock};
use super::room::Room;
use super::search::NEVER;
use super::{BridgeRule, Path};
use crate::demonstration::transitions;
use crate::similarity::Hit;
use crate::similarity::metric::kl;
use trestle_proto::annotation::{AnnotationTable, Bridge};

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
        (((distance(kl) * SHORTER - radius) / self.stride).ceil() as u32).min(MANY)
    }

    /// The largest divergence that `steps` steps may overcome to within `radius`.
    pub(super) fn limit(&self, steps: u32, radius: f64) -> f32 {
        let distance = (f64::from(steps) * self.stride + radius) / (SHORTER * SHORTER);
        (0.5 * distance * distance) as f32
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
                let radius = if self.equal > goal.equal { self.radius } else { goal.radius.max(self.radius) };
                *goal = Self {
                    m: self.m,
                    shorter: goal.shorter.max(self.shorter),
                    equal: goal.equal.max(self.equal),
                    radius,
                };
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
}

/// Working memory of [`Newest::collect`].
#[derive(Clone, Debug, Default)]
pub(super) struct Scratch {
    room: Room,
    seen: Marks,
    candidates: Vec<(usize, f32)>,
    stack: Vec<u32>,
}

impl Scratch {
    /// Annotations have been replaced.
    pub(super) fn forget(&mut self) {
        self.room.forget();
    }
}

impl Newest<'_> {
    /// Fills `wanted` with the mentor transitions whose bridge a path through t may improve: with t as its first step, with t
    /// as its last step, or with room for more steps on both sides.
    pub(super) fn collect(
        &self,
        table: &AnnotationTable,
        outlook: &mut Outlook,
        scratch: &mut Scratch,
        wanted: &mut Vec<Wanted>,
    ) {
        wanted.clear();
        let Path { rule, order, similarity } = self.path;
        let Scratch { room, seen, candidates, stack } = scratch;
        candidates.clear();
        candidates.extend(transitions(self.starts, order));
        for hit in self.ends {
            let behind = order.behind(hit.state as usize, rule.n);
            candidates.extend(behind.map(|j| (j, kl(self.from, similarity.state(order.state_of(j))))));
        }
        let most = (rule.k as u32).saturating_sub(2);
        let room_of = |m: usize| {
            let open = order.transition_of(m).filter(|&j| table.errors()[j] >= rule.e_infeas);
            open.map_or(0, |j| known(table, j, rule).map_or(most, |known| known.length.saturating_sub(2)))
        };
        room.around(self.from, (similarity, &self.reach, most), room_of, stack, |m, kl| {
            candidates.extend(order.transition_of(m).map(|j| (j, kl)));
        });
        seen.begin(order.n_transitions());
        for &(j, start_kl) in candidates.iter() {
            if table.errors()[j] >= rule.e_infeas && seen.first_time(j as u32) {
                wanted.extend(self.want(j, start_kl, table, outlook));
            }
        }
    }

    /// The entry for mentor transition `j`, which begins at KL `start_kl` from s, if its bridge may be improved.
    fn want(
        &self,
        j: usize,
        start_kl: f32,
        table: &AnnotationTable,
        outlook: &mut Outlook,
    ) -> Option<Wanted> {
        let Self { to, path, stock, reach, .. } = self;
        let similarity = path.similarity;
        let known = known(table, j, &path.rule);
        let longest = known.as_ref().map_or(path.rule.k as u32, |known| known.length - 1);
        let before = reach.steps(start_kl, reach.radius);
        let mut wanted = Wanted {
            j: j as u32,
            longest,
            end_kl: similarity.e_th(),
            before,
            after: NEVER,
            started: start_kl <= similarity.e_th(),
            ended: false,
        };
        for m in path.order.ahead(j, path.rule.n) {
            let kl = kl(to, similarity.state(m));
            let after = reach.steps(kl, reach.radius);
            if before + 1 + after > longest + u32::from(known.is_some()) {
                continue;
            }
            let Some(nearest) = outlook.nearest_end(m, stock, similarity) else { continue };
            let best_start = outlook.best_start(path.order.state_of(j), stock, similarity)?;
            if before + 1 + after <= longest {
                wanted.after = wanted.after.min(after);
            }
            let Some(known) = &known else { continue };
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
        wanted.is_possible().then_some(wanted)
    }
}

/// The bridge of mentor transition `j`, if it counts.
fn known<'a>(table: &'a AnnotationTable, j: usize, rule: &BridgeRule) -> Option<Bridge<'a>> {
    table.bridge(j).filter(|known| known.length as usize <= rule.k)
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
