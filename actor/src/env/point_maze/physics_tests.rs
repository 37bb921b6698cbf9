#![allow(clippy::unwrap_used)]
use super::*;
use crate::env::grid::Map;
use crate::env::point_maze::Layout;
use proptest::prelude::*;

const STEPS: &str = include_str!("../../../../tests/golden/point_maze_steps.csv");
const ROLLOUTS: &str = include_str!("../../../../tests/golden/point_maze_rollouts.csv");

/// The lines of a golden file: map, margin and the numbers after them.
fn golden(text: &'static str) -> Vec<(&'static str, f64, Vec<f64>)> {
    let line = |line: &'static str| {
        let mut fields = line.split(',');
        let name = fields.next().unwrap();
        let numbers: Vec<f64> = fields.map(|field| field.parse().unwrap()).collect();
        (name, numbers[0], numbers[1..].to_vec())
    };
    text.lines().skip(1).map(line).collect()
}

fn geometry(name: &str, layout: Layout) -> Geometry {
    let text = match name {
        "umaze" => include_str!("../../../maps/umaze.txt"),
        "medium" => include_str!("../../../maps/medium.txt"),
        "large" => include_str!("../../../maps/large.txt"),
        _ => panic!("no map {name}"),
    };
    Geometry::new(Map::parse(name, text).unwrap(), layout)
}

fn body(numbers: &[f64]) -> Body {
    Body { position: [numbers[0], numbers[1]], velocity: [numbers[2], numbers[3]] }
}

/// A step of the environment.
fn step(physics: &Physics, body: &mut Body, control: Vector) {
    *body = body.limited();
    physics.step(body, control);
}

/// The largest difference of a component.
fn difference(a: &Body, b: &Body) -> f64 {
    let of = |a: Vector, b: Vector| (a[0] - b[0]).abs().max((a[1] - b[1]).abs());
    of(a.position, b.position).max(of(a.velocity, b.velocity))
}

#[test]
fn a_step_is_mujocos() {
    let steps = golden(STEPS);
    assert_eq!(steps.len(), 240);
    for (name, margin, numbers) in steps {
        let physics = Physics::new(geometry(name, Layout::Gymnasium), margin);
        let mut found = body(&numbers[..4]);
        step(&physics, &mut found, [numbers[4], numbers[5]]);
        let difference = difference(&found, &body(&numbers[6..]));
        assert!(difference < 1e-12, "{name} {margin} {numbers:?}: {difference:e}");
    }
}

#[test]
fn three_hundred_steps_are_mujocos() {
    let lines = golden(ROLLOUTS);
    assert_eq!(lines.len(), 6 * 30);
    for rollout in lines.chunks(30) {
        let (name, margin, _) = rollout[0];
        let geometry = geometry(name, Layout::Gymnasium);
        let mut found = Body { position: geometry.place(geometry.map().start()), ..Body::default() };
        let physics = Physics::new(geometry, margin);
        for (_, _, numbers) in rollout {
            for _ in 0..10 {
                step(&physics, &mut found, [numbers[0], numbers[1]]);
            }
            let difference = difference(&found, &body(&numbers[2..]));
            assert!(difference < 1e-7, "{name} {margin}: {difference:e}");
        }
    }
}

/// The layouts are one maze in other coordinates: transposed and moved.
#[test]
fn both_layouts_are_the_same_physics() {
    let [d4rl, gymnasium] = [Layout::D4rl, Layout::Gymnasium].map(|layout| geometry("medium", layout));
    let start = d4rl.centre([1, 1]);
    let mut ours = Body { position: [start[0] + 0.1, start[1] + 0.3], ..Body::default() };
    let start = gymnasium.centre([1, 1]);
    let mut theirs = Body { position: [start[0] + 0.3, start[1] - 0.1], ..Body::default() };
    let (d4rl_physics, gymnasium_physics) =
        (Physics::new(d4rl.clone(), 0.002), Physics::new(gymnasium.clone(), 0.002));
    for time in 0..300 {
        let change = [[1.0, 0.5], [-0.5, 1.0], [0.5, -1.0], [-1.0, 1.0]][time / 20 % 4];
        step(&d4rl_physics, &mut ours, d4rl.turn(change));
        step(&gymnasium_physics, &mut theirs, gymnasium.turn(change));
        let (a, b) = (d4rl.grid(ours.position), gymnasium.grid(theirs.position));
        assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 1e-9, "step {time}: {a:?} and {b:?}");
    }
}

fn contacts() -> impl Strategy<Value = Vec<Contact>> {
    let contact = (0.0..std::f64::consts::TAU, 30.0..80.0f64, -200.0..800.0f64).prop_map(
        |(angle, stiffness, reference)| Contact { normal: [angle.cos(), angle.sin()], stiffness, reference },
    );
    prop::collection::vec(contact, 1..4)
}

proptest! {
    /// At the minimum of a convex function no step aside goes down.
    #[test]
    fn the_contact_force_minimises(contacts in contacts(), x in -50.0..50.0f64, y in -50.0..50.0f64) {
        let cost = |a: Vector| {
            let pushes = contacts.iter().map(|c| 0.5 * c.stiffness * (dot(c.normal, a) - c.reference).min(0.0).powi(2));
            0.5 * MASS * ((a[0] - x).powi(2) + (a[1] - y).powi(2)) + pushes.sum::<f64>()
        };
        let force = contact_force(&contacts, [x, y]);
        let a = [x + force[0] / MASS, y + force[1] / MASS];
        for angle in 0..16 {
            let angle = f64::from(angle) * std::f64::consts::TAU / 16.0;
            let aside = [a[0] + 1e-2 * angle.cos(), a[1] + 1e-2 * angle.sin()];
            prop_assert!(cost(a) <= cost(aside) + 1e-9 * cost(a));
        }
    }

    /// Whatever is done, the ball enters no wall by more than the 7.5 cm that the fastest one goes in a step, before any
    /// contact can act on it.
    #[test]
    fn walls_hold(controls in prop::collection::vec((-1.0..=1.0f64, -1.0..=1.0f64), 1..40)) {
        let geometry = geometry("medium", Layout::D4rl);
        let physics = Physics::new(geometry.clone(), 0.002);
        let mut ball = Body { position: geometry.place(geometry.map().start()), ..Body::default() };
        for (x, y) in controls {
            for _ in 0..20 {
                step(&physics, &mut ball, [x, y]);
                prop_assert!(!geometry.is_wall(geometry.cell(ball.position)));
                for wall in geometry.walls() {
                    prop_assert!(clearance(ball.position, wall).0 > -0.08);
                }
            }
        }
    }
}

#[test]
fn a_ball_inside_a_wall_is_pushed_out_by_the_nearest_face() {
    let (distance, normal) = clearance([0.4, -0.1], [0.0, 0.0]);
    assert!((distance + 0.2).abs() < 1e-12);
    assert_eq!(normal, [1.0, 0.0]);
    assert_eq!(clearance([0.1, -0.2], [0.0, 0.0]).1, [0.0, -1.0]);
}
