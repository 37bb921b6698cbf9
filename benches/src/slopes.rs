//! `slopes`: the cost of a step as one quantity grows by powers of ten and the others stay.
//!
//! A *slope* is the power of the quantity with which the cost grew from the size before: 1 is in proportion, 0 not at all. *Expected* is
//! that of the operations: of a gradient step's arithmetic, counted; 0 for what is looked up in place or through an index, whose
//! depth is the logarithm; 1, at most, for a message of each actor.

use super::Effort;
use super::clock::{Case, medians};
use super::mentor::{bridge, similar};
use super::replay::drawing;
use super::report::Row;
use super::step::flops;
use super::tick::tick_us;
use anyhow::Result;
use trestle_bench::gradient::GradientStep;
use trestle_bench::walk::World;
use trestle_proto::row::{Element, RowKind};
use trestle_qnet::{Kernels, Layout};

/// Widths of two hidden layers with which the network has about 10^3 to 10^6 parameters.
const HIDDEN: [usize; 4] = [28, 94, 310, 994];
const BATCHES: [usize; 4] = [1, 10, 100, 1000];
const FEATURES: [usize; 3] = [10, 100, 1000];
const STORED: [usize; 4] = [10_000, 100_000, 1_000_000, 10_000_000];
const MENTOR: [usize; 4] = [100, 1000, 10_000, 100_000];
/// Stored transitions that bridges are looked for among, and the mentor transitions that they are for.
const HISTORY: [usize; 3] = [10_000, 100_000, 1_000_000];
const BRIDGED: usize = 10_000;
const ACTORS: [u32; 2] = [1, 10];
/// Rows of a batch, and units of hidden layers, where it is another quantity that grows.
const BATCH: usize = 32;
const UNITS: usize = 64;
/// How far a quick look is below the sizes of figures.
const QUICK: usize = 100;

/// One quantity: its sizes, what is paid at each of them, and the slopes expected from each size to the next.
struct Growth {
    quantity: &'static str,
    cost: &'static str,
    sizes: Vec<usize>,
    us: Vec<Option<f64>>,
    expected: Vec<f64>,
}

pub(super) fn run(effort: Effort) -> Result<Vec<Row>> {
    let layouts =
        |sizes: &[[usize; 4]]| sizes.iter().map(|sizes| Ok(Layout::new(sizes)?)).collect::<Result<_>>();
    let networks: Vec<Layout> = layouts(&HIDDEN.map(|h| [8, h, h, 4]))?;
    let inputs: Vec<Layout> = layouts(&FEATURES.map(|d| [d, UNITS, UNITS, 4]))?;
    let small = Layout::new(&[8, UNITS, UNITS, 4])?;
    let growths = [
        steps("parameters", networks.iter().map(Layout::n_params).collect(), networks, &[BATCH; 4], effort)?,
        steps("batch", BATCHES.to_vec(), vec![small; 4], &BATCHES, effort)?,
        steps("features", FEATURES.to_vec(), inputs, &[BATCH; 3], effort)?,
        drawn(effort)?,
        searched(effort)?,
        similar_states(effort)?,
        ticks(effort)?,
    ];
    Ok(growths.iter().flat_map(Growth::rows).collect())
}

impl Growth {
    /// With the same slope expected everywhere.
    fn even(
        quantity: &'static str,
        cost: &'static str,
        slope: f64,
        sizes: Vec<usize>,
        us: Vec<Option<f64>>,
    ) -> Self {
        Self { quantity, cost, expected: vec![slope; sizes.len() - 1], sizes, us }
    }

    fn rows(&self) -> Vec<Row> {
        let row = |at: usize| {
            let before = at.checked_sub(1);
            let ratio = before.and_then(|before| Some(self.us[at]? / self.us[before]?));
            let tens = |before: usize| (self.sizes[at] as f64 / self.sizes[before] as f64).log10();
            Row::new()
                .with("quantity", self.quantity)
                .with("cost", self.cost)
                .with("size", self.sizes[at])
                .measured("us", self.us[at])
                .measured("expected", before.map(|before| self.expected[before]))
                .measured("slope", before.zip(ratio).map(|(before, ratio)| ratio.log10() / tens(before)))
        };
        (0..self.sizes.len()).map(row).collect()
    }
}

/// Gradient steps of DQN, with so many rows each, of `networks` that differ in the quantity.
fn steps(
    quantity: &'static str,
    sizes: Vec<usize>,
    networks: Vec<Layout>,
    batches: &[usize],
    effort: Effort,
) -> Result<Growth> {
    let mut cases: Vec<Case<'_>> = Vec::new();
    let mut work = Vec::new();
    for (layout, &rows) in networks.into_iter().zip(batches) {
        work.push(flops(&layout, rows, rows) as f64);
        let mut step = GradientStep::new(layout, rows, false, Kernels::detect())?;
        cases.push(Box::new(move || step.run()));
    }
    let us = medians(&mut cases, effort)?.into_iter().map(|ns| ns.map(|ns| ns / 1e3)).collect();
    let slope =
        |at: usize| (work[at + 1] / work[at]).log10() / (sizes[at + 1] as f64 / sizes[at] as f64).log10();
    let expected = (0..sizes.len() - 1).map(slope).collect();
    Ok(Growth { quantity, cost: "gradient step", sizes, us, expected })
}

/// Batches drawn from replays.
fn drawn(effort: Effort) -> Result<Growth> {
    let row = RowKind { dim: 4, element: Element::F32 };
    let sizes = STORED.map(|stored| effort.pick(stored, stored / QUICK)).to_vec();
    let mut cases = sizes.iter().map(|&stored| drawing(row, stored)).collect::<Result<Vec<_>>>()?;
    let us = medians(&mut cases, effort)?.into_iter().map(|ns| ns.map(|ns| ns / 1e3)).collect();
    Ok(Growth::even("stored transitions", "drawing a batch", 0.0, sizes, us))
}

/// Bridge searches, in a world of cells.
fn searched(effort: Effort) -> Result<Growth> {
    // The naive search, which is tried beside it, looks at every thousandth.
    let sizes = HISTORY.map(|stored| effort.pick(stored, stored / 10)).to_vec();
    let found = bridge(2, effort.pick(BRIDGED, BRIDGED / QUICK), 0.0, &sizes)?;
    let us = found.into_iter().map(|(_, ns, _)| Some(ns / 1e3)).collect();
    Ok(Growth::even("stored transitions", "bridge search", 0.0, sizes, us))
}

/// Queries for the mentor states similar to a state.
fn similar_states(effort: Effort) -> Result<Growth> {
    let sizes = MENTOR.map(|mentor| effort.pick(mentor, mentor / 10)).to_vec();
    let worlds: Vec<World> = sizes.iter().map(|&mentor| World::new(2, mentor, 0.2)).collect();
    let demonstrations = worlds
        .iter()
        .zip(&sizes)
        .map(|(world, &mentor)| world.demonstration(mentor))
        .collect::<Result<Vec<_>>>()?;
    let indexed = |(world, demonstration)| similar(world, demonstration).into_iter().next();
    let mut cases: Vec<Case<'_>> = worlds.iter().zip(&demonstrations).filter_map(indexed).collect();
    let us = medians(&mut cases, effort)?.into_iter().map(|ns| ns.map(|ns| ns / 1e3)).collect();
    Ok(Growth::even("mentor states", "similar states", 0.0, sizes, us))
}

/// Lockstep ticks in which nobody has anything to do.
fn ticks(effort: Effort) -> Result<Growth> {
    let us = ACTORS.into_iter().map(|actors| tick_us(actors, effort).map(Some)).collect::<Result<_>>()?;
    let sizes = ACTORS.map(|actors| actors as usize).to_vec();
    Ok(Growth::even("actors", "tick", 1.0, sizes, us))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_slope_is_the_power_with_which_the_cost_grows() {
        let us = vec![Some(2.0), Some(200.0), None, Some(1.0)];
        let growth = Growth {
            quantity: "q",
            cost: "c",
            sizes: vec![10, 100, 1000, 10_000],
            us,
            expected: vec![2.0, 1.0, 0.0],
        };
        let text = serde_json::to_string(&growth.rows()).unwrap();
        let rows: serde_json::Value = serde_json::from_str(&text).unwrap();
        let column =
            |name: &str| rows.as_array().unwrap().iter().map(|row| row[name].as_f64()).collect::<Vec<_>>();
        assert_eq!(column("slope"), [None, Some(2.0), None, None]);
        assert_eq!(column("expected"), [None, Some(2.0), Some(1.0), Some(0.0)]);
        assert_eq!(column("size")[3], Some(10_000.0));
    }
}
