//! The two back ends against each other. Where there is no libmujoco the tests say that they are skipped.
#![allow(clippy::unwrap_used)]

use super::{Found, MujocoError, library};
use crate::env::grid::Map;
use crate::env::point_maze::Layout;
use crate::env::point_maze::geometry::{Geometry, Vector};
use crate::env::point_maze::physics::{Body, Physics};
use rand::Rng;
use trestle_proto::rng::{Purpose, Stream, stream};

const MAPS: [&str; 3] = [
    include_str!("../../../../maps/umaze.txt"),
    include_str!("../../../../maps/medium.txt"),
    include_str!("../../../../maps/large.txt"),
];

/// The library, or none with a word about it.
fn found() -> Option<&'static Found> {
    match library() {
        Ok(found) => Some(found),
        Err(MujocoError::Missing { .. }) => {
            println!("skipped: libmujoco was not found; deploy/fetch-mujoco.sh gets it");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

fn geometries() -> Vec<Geometry> {
    let layouts = [Layout::D4rl, Layout::Gymnasium];
    let map = |text: &str| Map::parse("map", text).unwrap();
    MAPS.iter().flat_map(|text| layouts.map(|layout| Geometry::new(map(text), layout))).collect()
}

/// A ball somewhere near a free cell's edge or inside it, no deeper in a wall than a centimetre.
fn anywhere(geometry: &Geometry, rng: &mut Stream) -> Body {
    let cells: Vec<_> = geometry.free_cells().collect();
    let walls = geometry.walls();
    loop {
        let cell = cells[rng.random_range(0..cells.len())];
        let centre = geometry.centre(cell.map(|c| c as isize));
        let position: Vector = centre.map(|c| c + rng.random_range(-0.5..0.5));
        let clear = walls.iter().all(|wall| {
            let outside = |i: usize| ((position[i] - wall[i]).abs() - 0.5).max(0.0);
            outside(0).hypot(outside(1)) > 0.09
        });
        if clear {
            return Body { position, velocity: [0; 2].map(|_| rng.random_range(-5.0..5.0)) };
        }
    }
}

fn difference(a: &Body, b: &Body) -> f64 {
    let of = |a: Vector, b: Vector| (a[0] - b[0]).abs().max((a[1] - b[1]).abs());
    of(a.position, b.position).max(of(a.velocity, b.velocity))
}

#[test]
fn one_step_is_the_same() {
    let Some(found) = found() else { return };
    let mut rng = stream(1, Purpose::Environment, 0);
    for geometry in geometries() {
        for margin in [0.002, 0.004] {
            let mut simulation = found.simulation(&geometry, margin).unwrap();
            let physics = Physics::new(geometry.clone(), margin);
            for _ in 0..1000 {
                let start = anywhere(&geometry, &mut rng);
                let control = [0; 2].map(|_| rng.random_range(-1.0..=1.0));
                let (mut theirs, mut ours) = (start, start);
                simulation.advance(&mut theirs, control, 1).unwrap();
                physics.advance(&mut ours, control, 1);
                let difference = difference(&theirs, &ours);
                assert!(difference < 1e-12, "{start:?} {control:?} {margin}: {difference:e}");
            }
        }
    }
}

#[test]
fn three_hundred_steps_are_the_same() {
    let Some(found) = found() else { return };
    let mut rng = stream(2, Purpose::Environment, 0);
    for geometry in geometries() {
        let mut simulation = found.simulation(&geometry, 0.002).unwrap();
        let physics = Physics::new(geometry.clone(), 0.002);
        let start = Body { position: geometry.place(geometry.map().start()), ..Body::default() };
        let (mut theirs, mut ours) = (start, start);
        for _ in 0..30 {
            let control = [0; 2].map(|_| [-1.0, -0.5, 0.5, 1.0][rng.random_range(0..4)]);
            for _ in 0..10 {
                (theirs, ours) = (theirs.limited(), ours.limited());
                simulation.advance(&mut theirs, control, 1).unwrap();
                physics.advance(&mut ours, control, 1);
            }
            let difference = difference(&theirs, &ours);
            assert!(difference < 1e-7, "{difference:e}");
        }
    }
}

/// What snapshots rest on: nothing but the state that is handed in counts.
#[test]
fn a_step_depends_on_the_state_alone() {
    let Some(found) = found() else { return };
    let geometry = &geometries()[2];
    let [mut used, mut fresh] = [0; 2].map(|_| found.simulation(geometry, 0.002).unwrap());
    let mut rng = stream(3, Purpose::Environment, 0);
    for _ in 0..200 {
        let start = anywhere(geometry, &mut rng);
        used.advance(&mut anywhere(geometry, &mut rng), [1.0, -1.0], 7).unwrap();
        let (mut a, mut b) = (start, start);
        used.advance(&mut a, [0.5, 0.5], 3).unwrap();
        fresh.advance(&mut b, [0.5, 0.5], 3).unwrap();
        assert_eq!(a, b);
    }
}

/// MuJoCo's own answer to a state that it cannot use is to start over and write a log file.
#[test]
fn what_mujoco_reports_is_an_error() {
    let Some(found) = found() else { return };
    let mut simulation = found.simulation(&geometries()[0], 0.002).unwrap();
    let start = Body { position: [1.0, 1.0], velocity: [1e300, 0.0] };
    let mut body = start;
    let message = simulation.advance(&mut body, [0.0; 2], 1).unwrap_err().to_string();
    assert!(message.starts_with("MuJoCo: ") && body == start, "{message}");
    // The report is used up.
    simulation.advance(&mut Body { position: [1.0, 1.0], velocity: [0.0; 2] }, [0.0; 2], 1).unwrap();
}
