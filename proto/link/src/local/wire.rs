//! The queues between the processes of one run, and the events that a process can wait for there.

use crate::LinkError;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;
use trestle_proto::acting::ActingHeader;
use trestle_proto::batch::BatchHeader;
use trestle_proto::config::Mode;
use trestle_proto::limits::{REPLIES_BUFFER, TRANSITIONS_BUFFER};
use trestle_proto::observe::{ObserveAnswer, ObserveRequest};
use trestle_proto::orders::Orders;
use trestle_proto::plan::RunPlan;
use trestle_proto::query::{QueryAnswer, QueryRequest};
use trestle_proto::reply::Reply;

/// A message to the learner.
#[derive(Debug)]
pub(super) enum ToLearner {
    Batch(BatchHeader, Vec<u32>),
    Reply(Reply),
}

/// A question to the mentor-server.
#[derive(Debug)]
pub(super) enum Request {
    Observe(ObserveRequest, Vec<u32>),
    Query(QueryRequest, Vec<f32>),
}

/// The answer to it.
#[derive(Debug)]
pub(super) enum Answer {
    Observe(ObserveAnswer, Vec<u32>),
    Query(QueryAnswer, Vec<u32>),
}

/// All that the processes of a run share. Processes have numbers, which the [`Place`] gives.
#[derive(Debug, Default)]
pub struct Wire {
    /// The newest orders, and how many there have been.
    pub(super) orders: (u64, Orders),
    pub(super) published: Option<(ActingHeader, Vec<u32>)>,
    pub(super) to_learner: VecDeque<ToLearner>,
    /// Questions that the mentor-server has not taken, by their numbers.
    pub(super) requests: VecDeque<(u64, Request)>,
    /// Questions so far, and the answers to the questions that somebody waits for.
    pub(super) asked: u64,
    pub(super) answers: BTreeMap<u64, Option<Answer>>,
    pub(super) learner: Option<usize>,
    pub(super) mentor: Option<usize>,
    pub(super) actors: Vec<Option<usize>>,
    /// Whether the learner has let in all that it waits for.
    pub(super) welcomed: bool,
    has_mentor: bool,
    /// Whether actors are replaced while the others go on: in free mode.
    pub(super) replaces: bool,
}

/// An event that a process can wait for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Want {
    /// Other orders than the first so many.
    Orders(u64),
    /// That the learner has let all in.
    Welcome,
    /// That all whom the learner waits for have announced themselves.
    Gathered,
    /// A message to the learner.
    Message,
    /// Room for a message to the learner, or the learner's end.
    Room,
    /// A question to the mentor-server.
    Request,
    /// The answer to the question of this number, or the mentor-server's end.
    Answer(u64),
}

/// Where a wire lies, for one process, and how that process waits there.
pub trait Place {
    /// The process's number.
    fn process(&self) -> usize;

    /// Does `work` with the wire, and with what says whether a process lives.
    ///
    /// # Errors
    /// This process has no part in the run any more.
    fn with<R>(&self, work: impl FnOnce(&mut Wire, &dyn Fn(usize) -> bool) -> R) -> Result<R, LinkError>;

    /// Waits until the wire has what is wanted ([`Wire::has`]), `timeout` at the most.
    ///
    /// # Errors
    /// This process has no part in the run any more.
    fn wait(&self, want: Want, timeout: Duration) -> Result<(), LinkError>;

    /// A moment before a message at which others may go first.
    ///
    /// # Errors
    /// This process has no part in the run any more.
    fn step(&self) -> Result<(), LinkError> {
        Ok(())
    }
}

impl Wire {
    /// The wire of `plan`'s run, to which nobody has come.
    pub fn of(plan: &RunPlan) -> Self {
        let experiment = &plan.experiment;
        Self {
            actors: vec![None; experiment.config.run.actors as usize],
            has_mentor: experiment.mentor_len() > 0,
            replaces: experiment.config.run.mode == Mode::Free,
            ..Self::default()
        }
    }

    /// All have met: the learner, the mentor-server, and the actors, which have the numbers from `actor` on.
    pub(super) fn introduce(&mut self, learner: usize, mentor: usize, actor: usize) {
        (self.learner, self.mentor, self.welcomed) = (Some(learner), Some(mentor), true);
        (actor..).zip(&mut self.actors).for_each(|(process, place)| *place = Some(process));
    }

    /// Whether `want` is there; `alive` says of a process whether it lives.
    pub fn has(&self, want: Want, alive: &dyn Fn(usize) -> bool) -> bool {
        match want {
            Want::Orders(known) => self.orders.0 != known,
            Want::Welcome => self.welcomed,
            Want::Gathered => self.is_gathered(),
            Want::Message => !self.to_learner.is_empty(),
            Want::Room => self.has_room() || !self.learner.is_some_and(alive),
            Want::Request => !self.requests.is_empty(),
            Want::Answer(number) => {
                self.answers.get(&number).is_some_and(Option::is_some) || !self.mentor.is_some_and(alive)
            }
        }
    }

    /// Whether all whom the learner waits for have announced themselves.
    pub(super) fn is_gathered(&self) -> bool {
        let actors = self.replaces || self.actors.iter().all(Option::is_some);
        actors && (self.mentor.is_some() || !self.has_mentor)
    }

    /// Whether the learner has room for one message more.
    pub(super) fn has_room(&self) -> bool {
        self.to_learner.len() < self.actors.len() * (TRANSITIONS_BUFFER + REPLIES_BUFFER)
    }
}
