//! The lines of the timeline.

use super::squares::{HALF_LIFE, Looks, SHADES, Squares};
use super::{APART, steps};
use serde::{Deserialize, Serialize};
use trestle_algorithm::agent::{Agent, MentorRow};
use trestle_proto::NONE;
use trestle_proto::experiment::Experiment;
use trestle_proto::map_file::MapFile;
use trestle_proto::mentor::MentorTransitions;

/// Version of the file.
const VERSION: u32 = 1;
/// Mentor transitions that a moment tells of, at most: of more, every second, third, ... one.
const MAX_TRANSITIONS: usize = 512;
/// Points of a path, likewise.
const MAX_POINTS: usize = 1024;
/// Features of a state that are kept where there is no map.
const MAX_FEATURES: usize = 8;

/// What stays the same.
#[derive(Debug, Serialize)]
pub(super) struct Head {
    version: u32,
    #[serde(skip)]
    obs_dim: usize,
    /// Numbers of a point: column and row on the map, or else the first features.
    dims: usize,
    map: Option<MapFile>,
    /// Squares along the side of a cell that moments tell of; none where they tell of none.
    squares: Option<usize>,
    shades: f64,
    visits_half_life: f64,
    /// Environment steps from one state to the next where moments tell of states; none on a map.
    states_every: Option<u64>,
    /// Names of the actions.
    actions: Vec<String>,
    /// The mentor's transitions.
    mentor: Mentor,
}

#[derive(Debug, Default, Serialize)]
struct Mentor {
    /// Whether the path is only led along, and no loss is the mentor's.
    led: bool,
    /// Of all transitions every `stride`th is told of.
    transitions: usize,
    stride: usize,
    /// Names of the demonstrations, and the number of transitions in each.
    demos: Vec<(String, usize)>,
    /// Whether a transition begins a trajectory: 1 or 0.
    first: Vec<u8>,
    /// Where it begins and ends, `dims` numbers each.
    from: Vec<f64>,
    to: Vec<f64>,
}

impl Head {
    pub(super) fn new(
        experiment: &Experiment,
        map: Option<MapFile>,
        squares: Option<&Squares>,
        mentor: Option<&MentorTransitions>,
    ) -> Self {
        let dims = map.as_ref().map_or(experiment.spec.obs_dim().min(MAX_FEATURES), |_| 2);
        let mut head = Self {
            version: VERSION,
            obs_dim: experiment.spec.obs_dim(),
            dims,
            map,
            squares: squares.map(|squares| squares.fine),
            shades: SHADES,
            visits_half_life: HALF_LIFE,
            states_every: None,
            actions: experiment.spec.actions.clone(),
            mentor: Mentor::default(),
        };
        let count = mentor.map_or_else(|| steps(experiment).count(), MentorTransitions::len);
        head.states_every = head.map.is_none().then_some(APART);
        let stride = stride(count);
        let mut told = Mentor { transitions: count, stride, led: mentor.is_none(), ..Mentor::default() };
        told.demos = experiment.mentors.iter().map(|part| (part.name.clone(), part.transitions)).collect();
        let mut tell = |from: &[f32], to: &[f32], first: bool| {
            told.from.extend(head.point(from));
            told.to.extend(head.point(to));
            told.first.push(u8::from(first));
        };
        if let Some(transitions) = mentor {
            for j in (0..count).step_by(stride) {
                tell(transitions.state(j), transitions.next_state(j), transitions.first(j));
            }
        } else if let Some(waypoints) = &experiment.waypoints {
            let state = |m: usize| &waypoints.states[m * head.obs_dim..][..head.obs_dim];
            for m in steps(experiment).step_by(stride) {
                tell(state(m), state(m + 1), m == 0 || waypoints.transition_of[m - 1] == NONE);
            }
        }
        head.mentor = told;
        head
    }

    /// The line.
    pub(super) fn line(&self) -> String {
        // Names and finite numbers: failing here is a defect of ours that the tests would show.
        serde_json::to_string(self).unwrap_or_default() + "\n"
    }

    /// Where `state` is drawn.
    pub(super) fn point(&self, state: &[f32]) -> Vec<f64> {
        match &self.map {
            Some(map) => map.place(state).map(short).to_vec(),
            None => state[..self.dims].iter().map(|&x| short(f64::from(x))).collect(),
        }
    }

    /// Where the states of a path are drawn, each stay once, and thinned out if they are many; the last one stays.
    pub(super) fn points(&self, path: &[f32]) -> Vec<f64> {
        let mut states: Vec<&[f32]> = path.chunks_exact(self.obs_dim).collect();
        states.dedup();
        let stride = states.len().div_ceil(MAX_POINTS).max(1);
        let last = states.len().saturating_sub(1);
        let shown = states.iter().enumerate().filter(|(at, _)| at.is_multiple_of(stride) || *at == last);
        shown.flat_map(|(_, state)| self.point(state)).collect()
    }
}

/// What a run knew and did at one moment. One entry in each list for each mentor transition that is told of.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Moment {
    pub(super) episodes: u64,
    pub(super) env_steps: u64,
    pub(super) grad_steps: u64,
    pub(super) wall_s: f64,
    /// A letter each: see [`kind()`].
    kind: String,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    e_kl: Vec<Option<f64>>,
    /// a_est, -1 before there is one; with learned bridges the likeliest action of their policy.
    action: Vec<i64>,
    /// With learned bridges the probability of that action.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    sure: Vec<f64>,
    /// Observer transitions that it was picked for; with learned bridges the observer's steps near its beginning.
    visited: Vec<u64>,
    /// Samples that were trained with its loss.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    used: Vec<u64>,
    /// Length of the bridge; 0 without one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    bridge: Vec<u32>,
    /// The mentor state that the bridge reaches: this many steps after the one that it begins in.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    ahead: Vec<u32>,
    /// Environment steps of the moment that this bridge was seen in first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    found: Vec<u64>,
    /// The free squares of the map.
    squares: Option<Looks>,
    /// Points of the agent's newest states, where there is no map.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) states: Vec<f64>,
    /// The path of the newest evaluation.
    path: Vec<f64>,
}

impl Moment {
    /// Tells of a step that is led along: how often the observer was near its beginning, and what the policy would do there with
    /// which probability.
    pub(super) fn push_led(&mut self, visited: u64, action: usize, sure: f32) {
        self.kind.push(if visited > 0 { 'r' } else { 'u' });
        self.visited.push(visited);
        self.action.push(action as i64);
        self.sure.push(digits(sure));
    }
}

/// What has been found out about a mentor transition, as a letter: `f`easible, `b`ridged, `g`ated (it is neither, so its loss is
/// not used), or `u`nseen. With learned bridges a step is `r`eached or `u`nseen.
fn kind(row: &MentorRow<'_>) -> char {
    match (row.feasible, row.bridge, row.estimate) {
        (true, ..) => 'f',
        (_, Some(_), _) => 'b',
        (.., Some(_)) => 'g',
        _ => 'u',
    }
}

/// The bridge of a transition: its length, how far it leads, and when it was seen first.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Span {
    length: u32,
    ahead: u32,
    found: u64,
}

/// The bridges of the moment before, so that each moment knows how old its bridges are.
#[derive(Debug)]
pub(super) struct Findings {
    stride: usize,
    spans: Vec<Span>,
}

impl Findings {
    /// Of a run with this many mentor transitions.
    pub(super) fn new(transitions: usize) -> Self {
        let stride = stride(transitions);
        Self { stride, spans: vec![Span::default(); transitions.div_ceil(stride)] }
    }

    /// Takes the bridges of `moment` for those of the moment before.
    pub(super) fn take_over(&mut self, moment: &Moment) {
        let spans = moment.bridge.iter().zip(&moment.ahead).zip(&moment.found);
        for (span, ((&length, &ahead), &found)) in self.spans.iter_mut().zip(spans) {
            *span = Span { length, ahead, found };
        }
    }

    /// The moment that `agent` is in.
    pub(super) fn moment(
        &mut self,
        agent: &Agent,
        wall_s: f64,
        squares: Option<Looks>,
        path: &[f64],
    ) -> Moment {
        let counters = agent.counters();
        let mut moment = Moment {
            episodes: counters.episodes,
            env_steps: counters.env_steps,
            grad_steps: counters.grad_steps,
            wall_s: (wall_s * 1e3).round() / 1e3,
            squares,
            path: path.to_vec(),
            ..Moment::default()
        };
        let rows = agent.mentor_rows().into_iter().flatten().step_by(self.stride);
        for (span, row) in self.spans.iter_mut().zip(rows) {
            let (length, ahead) = row.bridge.map_or((0, 0), |bridge| (bridge.length, bridge.ahead));
            if (span.length, span.ahead) != (length, ahead) {
                *span = Span { length, ahead, found: counters.env_steps };
            }
            moment.kind.push(kind(&row));
            moment.e_kl.push(row.estimate.map(|estimate| digits(estimate.e_kl)));
            moment.action.push(row.estimate.map_or(-1, |estimate| i64::from(estimate.action)));
            moment.visited.push(row.visited);
            moment.used.push(row.used);
            moment.bridge.push(span.length);
            moment.ahead.push(span.ahead);
            moment.found.push(span.found);
        }
        moment
    }
}

#[cfg(test)]
impl Findings {
    /// Length, reach and first moment of each bridge.
    pub(super) fn spans(&self) -> Vec<[u64; 3]> {
        self.spans.iter().map(|span| [span.length.into(), span.ahead.into(), span.found]).collect()
    }
}

/// Of how many mentor transitions one is told of.
pub(super) fn stride(transitions: usize) -> usize {
    transitions.div_ceil(MAX_TRANSITIONS).max(1)
}

/// Three digits of `x`.
fn digits(x: f32) -> f64 {
    format!("{x:.2e}").parse().unwrap_or(f64::from(x))
}

/// `x` with the digits that a picture can show.
fn short(x: f64) -> f64 {
    (x * 1e4).round() / 1e4
}
