//! The map as squares: how often the agent was in each lately, what it thinks of each, and what it would do there.

use super::uncounted;
use serde::{Deserialize, Serialize};
use trestle_algorithm::agent::Agent;
use trestle_proto::experiment::Experiment;
use trestle_proto::map_file::MapFile;
use trestle_qnet::{Encoding, Layout, Workspace, argmax, forward, network_of};

/// Squares that are looked at, at most; a map with more has coarser ones, or none.
const MAX_SQUARES: usize = 4096;
/// Environment steps after which a visit counts half.
pub(super) const HALF_LIFE: f64 = 5_000.0;
/// Steps between the least and the greatest number of a picture.
pub(super) const SHADES: f64 = 255.0;

/// The free squares of a map, row by row, with what values are computed from.
#[derive(Debug)]
pub(super) struct Squares {
    map: MapFile,
    /// Squares along the side of a cell.
    pub(super) fine: usize,
    /// Number of each square among the free ones.
    number: Vec<Option<usize>>,
    layout: Layout,
    /// The network's input for each free square, at rest in its middle.
    inputs: Vec<f32>,
    count: usize,
    visits: Vec<f64>,
    /// Transitions that have been counted, by their number in the history.
    counted: u64,
}

/// What there is to say about the free squares.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Looks {
    /// Visits, 0 to [`SHADES`] in proportion to the greatest.
    pub(super) visits: Vec<u8>,
    /// The greatest, decayed visits.
    pub(super) visits_most: f64,
    /// The largest Q-value of each, 0 to [`SHADES`] from the least to the greatest.
    pub(super) values: Vec<u8>,
    /// The least and the greatest.
    pub(super) values_range: [f64; 2],
    /// The greedy action of each.
    pub(super) policy: Vec<u32>,
}

impl Squares {
    /// The squares of `map`; none if they are too many, or the experiment's network is not to be had.
    pub(super) fn new(map: &MapFile, experiment: &Experiment) -> Option<Self> {
        let [columns, rows] = map.size();
        let cells = || (0..rows).flat_map(|row| (0..columns).map(move |column| [column, row]));
        let free = cells().filter(|&cell| map.is_free(cell)).count();
        let fine = (1..=map.squares).rev().find(|fine| free * fine * fine <= MAX_SQUARES)?;
        let (layout, encoding) = network_of(experiment).ok()?;
        let mut number = Vec::new();
        let mut states: Vec<f32> = Vec::new();
        let mut state = vec![0.0; experiment.spec.obs_dim()];
        let mut count = 0;
        for (row, column) in
            (0..rows * fine).flat_map(|row| (0..columns * fine).map(move |column| (row, column)))
        {
            let is_free = map.is_free([column / fine, row / fine]);
            number.push(is_free.then_some(count));
            if is_free {
                let place = [column, row].map(|at| (at as f64 + 0.5) / fine as f64 - 0.5);
                map.state(place, &mut state);
                clamp(&mut state, experiment);
                states.extend_from_slice(&state);
                count += 1;
            }
        }
        let inputs = encoded(&encoding, &states, count, layout.input());
        Some(Self {
            map: map.clone(),
            fine,
            number,
            layout,
            inputs,
            count,
            visits: vec![0.0; count],
            counted: 0,
        })
    }

    /// Number of the free square that `state` lies in.
    fn square(&self, state: &[f32]) -> Option<usize> {
        let [columns, rows] = self.map.size().map(|side| side * self.fine);
        let [column, row] = self.map.place(state).map(|at| ((at + 0.5) * self.fine as f64).floor());
        let inside = (0.0..columns as f64).contains(&column) && (0.0..rows as f64).contains(&row);
        inside.then(|| self.number[row as usize * columns + column as usize]).flatten()
    }

    /// What there is to say now.
    pub(super) fn look(&mut self, agent: &Agent) -> Looks {
        self.count_visits(agent);
        let visits_most = self.visits.iter().copied().fold(0.0, f64::max);
        let shade = |share: f64| (share * SHADES).round().clamp(0.0, SHADES) as u8;
        let visits = self
            .visits
            .iter()
            .map(|visits| if visits_most > 0.0 { shade(visits / visits_most) } else { 0 })
            .collect();
        let n = self.layout.output();
        let mut q = vec![0.0; self.count * n];
        let mut workspace = Workspace::new(&self.layout, self.count);
        forward(&self.layout, agent.weights(), &self.inputs, self.count, &mut workspace, &mut q);
        let policy: Vec<u32> = q.chunks_exact(n).map(|q| argmax(q) as u32).collect();
        let best: Vec<f64> = q.chunks_exact(n).map(|q| f64::from(q[argmax(q)])).collect();
        let low = best.iter().copied().fold(f64::INFINITY, f64::min);
        let high = best.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let values = best
            .iter()
            .map(|value| if high > low { shade((value - low) / (high - low)) } else { 0 })
            .collect();
        Looks { visits, visits_most, values, values_range: [low, high], policy }
    }

    fn count_visits(&mut self, agent: &Agent) {
        let replay = agent.replay();
        let next = replay.next_index();
        let fade = |steps: u64| 0.5f64.powf(steps as f64 / HALF_LIFE);
        let faded = fade(next.saturating_sub(self.counted));
        self.visits.iter_mut().for_each(|visits| *visits *= faded);
        let mut wide = Vec::new();
        for index in uncounted(replay, self.counted) {
            if let Some(square) = self.square(replay.obs(replay.slot(index)).wide(&mut wide)) {
                self.visits[square] += fade(next - 1 - index);
            }
        }
        self.counted = next;
    }
}

/// A state that the environment could give: a feature at rest may be outside its bounds.
fn clamp(state: &mut [f32], experiment: &Experiment) {
    for ((x, &low), &high) in state.iter_mut().zip(&experiment.spec.low).zip(&experiment.spec.high) {
        *x = x.clamp(low, high);
    }
}

fn encoded(encoding: &Encoding, states: &[f32], count: usize, input: usize) -> Vec<f32> {
    let mut inputs = vec![0.0; count * input];
    encoding.encode_batch(states, count, &mut inputs);
    inputs
}
