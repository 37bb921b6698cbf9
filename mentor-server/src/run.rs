//! The loop of the mentor-server's process: take requests, answer them, until told to leave.

use trestle_algorithm::bridge::search::MAX_LOOKS;
use trestle_algorithm::demonstration::Demonstration;
use trestle_algorithm::mentor::{Mentor, MentorError};
use trestle_link::{LinkError, MentorHandler, MentorLink, Stop};
use trestle_link::{logging, pulse};
use trestle_proto::batch::Spaces;
use trestle_proto::experiment::Experiment;
use trestle_proto::limits::{MAX_QUERY_ROWS, WAIT_SLICE};
use trestle_proto::observe::{OBSERVE, ObserveAnswer, ObserveRequest, Observed, Part, REBUILD, RESTORE};
use trestle_proto::query::{
    ANNOTATIONS, BRIDGE, MALFORMED, OK, OUT_OF_RANGE, QueryAnswer, QueryRequest, SIMILAR, STATS, TRANSITIONS,
    UNKNOWN_OP,
};

/// The mentor of `experiment`'s run, of its demonstration.
///
/// # Errors
/// Settings that do not meet the demonstration.
pub fn mentor_of(experiment: &Experiment, demonstration: &Demonstration) -> Result<Mentor, MentorError> {
    let config = &experiment.config;
    let (algo, seed) = (config.run.algo, config.run.seed);
    let mentor =
        Mentor::new(demonstration, &config.mentor, algo, &experiment.spec, config.learner.replay, seed)?;
    Ok(if config.whole_bridges() { mentor.keeping_whole_bridges() } else { mentor })
}

/// What ends the mentor-server's process early.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The other processes.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// Settings that do not meet the demonstration.
    #[error(transparent)]
    Mentor(#[from] MentorError),
}

/// Serves the clients at the other end of `link` from a mentor of `demonstration` until `stop` says so.
///
/// # Errors
/// Settings that do not meet the demonstration, or the transport fails. A request that cannot be right is answered with
/// its fault and does no harm.
pub fn run(
    link: &mut dyn MentorLink,
    experiment: &Experiment,
    demonstration: &Demonstration,
    stop: Stop<'_>,
) -> Result<(), RunError> {
    let mut server = Server {
        mentor: mentor_of(experiment, demonstration)?,
        experiment,
        demonstration,
        spaces: experiment.spaces(),
        wide: Vec::new(),
        observed: Observed::default(),
        cut_short: 0,
    };
    link.hello(&mut server, stop)?;
    tracing::info!("ready");
    while !stop() {
        pulse::step();
        link.serve(&mut server, WAIT_SLICE)?;
    }
    tracing::info!("leaving");
    Ok(())
}

struct Server<'a> {
    mentor: Mentor,
    experiment: &'a Experiment,
    demonstration: &'a Demonstration,
    spaces: Spaces,
    /// States of one byte as `f32`, of the part at hand.
    wide: Vec<f32>,
    observed: Observed,
    /// Searches for bridges that have met their limit.
    cut_short: u64,
}

impl Server<'_> {
    /// Carries `request` out part by part and appends the answers to `out`; returns how many searches met their limit.
    fn try_observe(
        &mut self,
        request: &ObserveRequest,
        mut payload: &[u32],
        out: &mut Vec<u32>,
    ) -> Result<u32, u32> {
        if request.op == RESTORE {
            return self.mentor.restore(payload).map(|()| 0).map_err(|e| refuse(&e));
        }
        let (mut first, mut cut_short) = (request.first_index, 0);
        for _ in 0..request.count {
            let part = Part::take(&mut payload, self.spaces.row).ok_or_else(|| {
                tracing::warn!("refused: a request whose parts do not fit its {} words", payload.len());
                MALFORMED
            })?;
            // The request is a private copy.
            let transitions = part.check(&self.spaces, &mut self.wide).map_err(|e| {
                tracing::warn!("refused: {e}");
                MALFORMED
            })?;
            match request.op {
                OBSERVE => {
                    self.mentor.observe(first, transitions, &mut self.observed).map_err(|e| refuse(&e))?;
                    self.observed.encode(self.mentor.table().record_words(), out);
                    cut_short += self.observed.cut_short;
                }
                REBUILD => self.mentor.rebuild(first, transitions).map_err(|e| refuse(&e))?,
                _ => return Err(UNKNOWN_OP),
            }
            first += u64::from(part.count);
            pulse::step();
        }
        if payload.is_empty() { Ok(cut_short) } else { Err(MALFORMED) }
    }

    /// Says so the first time, and whenever ten times as many searches have met their limit.
    fn count_cut_short(&mut self, more: u32) {
        let before = self.cut_short;
        self.cut_short += u64::from(more);
        if more > 0 && self.cut_short.checked_ilog10() != before.checked_ilog10() {
            tracing::warn!(
                searches = self.cut_short,
                looks = MAX_LOOKS,
                "searches for bridges met their limit: a bridge may have been missed, or be longer than it could be; \
                 a smaller mentor.e_th, mentor.k or learner.replay avoids it"
            );
        }
    }

    fn try_query(&mut self, request: &QueryRequest, state: &[f32], out: &mut Vec<u32>) -> Result<u32, u32> {
        let about_a_state = matches!(request.op, SIMILAR | BRIDGE);
        let wanted = if about_a_state { self.spaces.row.dim } else { 0 };
        if state.len() != wanted || state.iter().any(|x| !x.is_finite()) {
            return Err(MALFORMED);
        }
        let (first, count) = (request.first, request.count);
        if count > MAX_QUERY_ROWS {
            return Err(OUT_OF_RANGE);
        }
        match request.op {
            SIMILAR => self.mentor.similar(state, count as usize).map(|found| {
                out.extend(found.iter().flat_map(|(j, kl)| [*j, kl.to_bits()]));
                found.len() as u32
            }),
            BRIDGE => self.mentor.bridge(state, first, out).map(|()| u32::from(!out.is_empty())),
            ANNOTATIONS => self.mentor.annotations(first, count, out).map(|()| count),
            TRANSITIONS => self.mentor.transitions(first, count, out).map(|()| count),
            STATS => {
                out.extend_from_slice(bytemuck::cast_slice(&[self.mentor.stats()]));
                Ok(1)
            }
            _ => return Err(UNKNOWN_OP),
        }
        .map_err(|e| refuse(&e))
    }
}

fn refuse(error: &MentorError) -> u32 {
    tracing::warn!("refused: {error}");
    error.status()
}

impl MentorHandler for Server<'_> {
    fn forget(&mut self) {
        match mentor_of(self.experiment, self.demonstration) {
            Ok(mentor) => self.mentor = mentor,
            // The one there is came of the same.
            Err(error) => tracing::error!("{error}"),
        }
    }

    fn observe(&mut self, request: &ObserveRequest, payload: &[u32], out: &mut Vec<u32>) -> ObserveAnswer {
        logging::set_tick(request.round);
        let first_index = request.first_index;
        match self.try_observe(request, payload, out) {
            Ok(cut_short) => {
                self.count_cut_short(cut_short);
                ObserveAnswer { first_index, status: OK, cut_short }
            }
            Err(status) => {
                out.clear();
                ObserveAnswer { first_index, status, cut_short: 0 }
            }
        }
    }

    fn query(&mut self, request: &QueryRequest, state: &[f32], out: &mut Vec<u32>) -> QueryAnswer {
        match self.try_query(request, state, out) {
            Ok(count) => QueryAnswer { status: OK, count },
            Err(status) => {
                out.clear();
                QueryAnswer { status, count: 0 }
            }
        }
    }
}
