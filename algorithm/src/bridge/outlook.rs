//! The outlook of each mentor state: how near a stored transition ends, and the best reward of the stored transitions that
//! begin in a similar state. It spares searches that could not improve anything.
//!
//! Each value holds as long as the newest transition that showed it is stored. After that, the next question looks it up
//! anew. So a transition that leaves needs no work, and the answers are a function of the stored transitions.

use super::Path;
use super::graph::Graph;
use crate::similarity::metric::kl;
use crate::similarity::{Hit, Similarity};
use crate::states::States;

/// A value and the newest stored transition that shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Seen<T> {
    value: T,
    index: u64,
}

/// A value that may be unknown, which is not the same as a value that does not exist.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Known<T> {
    #[default]
    Unknown,
    Nothing,
    Value(Seen<T>),
}

impl<T: Copy + PartialOrd> Known<T> {
    /// Takes `value`, shown by transition `index`, the newest, into account; `better` of equals is true. Whether it is the
    /// first one where there was none.
    fn see(&mut self, value: T, index: u64, better: fn(&T, &T) -> bool) -> bool {
        let first = matches!(self, Self::Nothing);
        match self {
            Self::Unknown => {}
            Self::Value(seen) if !better(&value, &seen.value) => {}
            _ => *self = Self::Value(Seen { value, index }),
        }
        first
    }

    /// Whether this has to be looked up, when transitions before `oldest` are gone.
    fn is_stale(&self, oldest: u64) -> bool {
        match self {
            Self::Unknown => true,
            Self::Nothing => false,
            Self::Value(seen) => seen.index < oldest,
        }
    }

    fn value(&self) -> Option<T> {
        match self {
            Self::Value(seen) => Some(seen.value),
            _ => None,
        }
    }
}

/// The stored transitions as a search asks for them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stock<'a> {
    pub(super) states: &'a States,
    pub(super) graph: &'a Graph,
    /// Number of the oldest stored transition.
    pub(super) oldest: u64,
}

/// The values of each mentor state.
#[derive(Clone, Debug)]
pub(super) struct Outlook {
    ends: Vec<Known<f32>>,
    starts: Vec<Known<f32>>,
}

impl Outlook {
    /// That of this many mentor states when no transition is stored.
    pub(super) fn new(mentor_states: usize) -> Self {
        Self { ends: vec![Known::Nothing; mentor_states], starts: vec![Known::Nothing; mentor_states] }
    }

    /// Forgets everything: transitions have been stored without [`Outlook::add`].
    pub(super) fn forget(&mut self) {
        self.ends.fill(Known::Unknown);
        self.starts.fill(Known::Unknown);
    }

    /// Transition `index`, the newest, has been stored. `from` and `to` are the mentor states similar to its ends. Calls
    /// `covered` with each mentor transition that may be [`Outlook::covers`] now and was not before, perhaps more than once.
    pub(super) fn add(
        &mut self,
        (index, reward): (u64, f32),
        from: &[Hit],
        to: &[Hit],
        path: &Path<'_>,
        mut covered: impl FnMut(usize),
    ) {
        let (order, n) = (path.order, path.rule.n);
        for hit in from {
            let m = hit.state as usize;
            if self.starts[m].see(reward, index, |new, old| new >= old)
                && let Some(j) = order.transition_of(m)
                && order.ahead(j, n).any(|end| self.ends[end] != Known::Nothing)
            {
                covered(j);
            }
        }
        for hit in to {
            let m = hit.state as usize;
            if self.ends[m].see(hit.kl, index, |new, old| new <= old) {
                let starts = |&j: &usize| self.starts[order.state_of(j)] != Known::Nothing;
                order.behind(m, n).filter(starts).for_each(&mut covered);
            }
        }
    }

    /// Whether stored transitions begin where a bridge of mentor transition `j` must, and end where it must.
    pub(super) fn covers(&mut self, j: usize, stock: &Stock<'_>, path: &Path<'_>) -> bool {
        self.best_start(path.order.state_of(j), stock, path.similarity).is_some()
            && path.order.ahead(j, path.rule.n).any(|m| self.nearest_end(m, stock, path.similarity).is_some())
    }

    /// The smallest KL between mentor state `m` and the end of a stored transition; none where no end is similar.
    pub(super) fn nearest_end(
        &mut self,
        m: usize,
        stock: &Stock<'_>,
        similarity: &Similarity,
    ) -> Option<f32> {
        if self.ends[m].is_stale(stock.oldest) {
            let newest = |id| stock.graph.incoming(id).map(|link| link.newest()).max();
            let better = |a: &Seen<f32>, b: &Seen<f32>| (a.value, b.index) < (b.value, a.index);
            self.ends[m] = look_up(m, stock, similarity, better, |id, kl, found| {
                if let Some(index) = newest(id) {
                    found(Seen { value: kl, index });
                }
            });
        }
        self.ends[m].value()
    }

    /// The highest reward of the stored transitions that begin in a state similar to mentor state `m`; none where there
    /// are none.
    pub(super) fn best_start(&mut self, m: usize, stock: &Stock<'_>, similarity: &Similarity) -> Option<f32> {
        if self.starts[m].is_stale(stock.oldest) {
            let better = |a: &Seen<f32>, b: &Seen<f32>| (a.value, a.index) > (b.value, b.index);
            self.starts[m] = look_up(m, stock, similarity, better, |id, _, found| {
                for link in stock.graph.outgoing(id) {
                    link.rewards().for_each(|(index, value)| found(Seen { value, index }));
                }
            });
        }
        self.starts[m].value()
    }
}

/// The best value that `each` finds at the stored states similar to mentor state `m`.
fn look_up(
    m: usize,
    stock: &Stock<'_>,
    similarity: &Similarity,
    better: impl Fn(&Seen<f32>, &Seen<f32>) -> bool,
    mut each: impl FnMut(u32, f32, &mut dyn FnMut(Seen<f32>)),
) -> Known<f32> {
    let (centre, mut best) = (similarity.state(m), Known::Nothing);
    stock.graph.cells.nearby(centre, |list| {
        for &id in list {
            let kl = kl(centre, stock.states.whitened(id));
            if kl <= similarity.e_th() {
                each(id, kl, &mut |seen| match &best {
                    Known::Value(known) if !better(&seen, known) => {}
                    _ => best = Known::Value(seen),
                });
            }
        }
    });
    best
}
