//! One step of the simulation in Rust: what MuJoCo computes for this model, to the last few bits.
//!
//! The model: a ball that slides without friction in a plane, pushed by one motor an axis, slowed down by damping, and
//! walls that are boxes. Sources: MuJoCo's documentation, chapter "Computation" (Euler integration with implicit
//! damping; the soft constraint model with its `solref` and `solimp`, both at their defaults), and agreement with
//! MuJoCo itself, which the tests check on recorded steps. With mass m, damping 1, time step h and control u:
//!
//! ```text
//! a0     = (100 u - v) / m                                 acceleration without walls
//! a      = argmin 1/2 m |a - a0|^2 + sum_i 1/2 D_i min(0, n_i a - r_i)^2
//! v'     = v + h (100 u - v + m (a - a0)) / (m + h)        damping is implicit
//! q'     = q + h v'
//! ```
//!
//! over the walls i that are closer to the ball than the margin, with outward normal n_i. With p = distance - margin:
//!
//! ```text
//! x = |p| / 0.001       y = 2 x^2 for x <= 1/2, 1 - 2 (1 - x)^2 for x < 1, else 1
//! d = 0.9 + 0.05 y      D = m d / (1 - d)
//! r = -(B n v + K d p)  B = 2 / (0.95 * 0.02), K = 1 / (0.95 * 0.02)^2
//! ```

use super::geometry::{Geometry, Vector};

/// Time of one step of the simulation, seconds.
pub const TIMESTEP: f64 = 0.01;
/// Radius of the ball, metres.
pub const RADIUS: f64 = 0.1;
/// Mass of the ball, kilograms: its volume at a density of 1000 kg/m^3.
pub const MASS: f64 = 4.0 / 3.0 * std::f64::consts::PI * RADIUS * RADIUS * RADIUS * 1000.0;
/// Force of a motor at full control, newtons.
pub const GEAR: f64 = 100.0;
/// Largest component of the velocity with which a step of the environment begins, metres a second. The originals cut
/// off what is above *before* they step, so that observed velocities can be larger.
pub const SPEED_LIMIT: f64 = 5.0;

/// Damping of each axis, newtons for a metre a second.
pub(super) const DAMPING: f64 = 1.0;
/// Time constant of a contact, seconds: `solref[0]`, whose damping ratio is 1.
const TIME_CONSTANT: f64 = 0.02;
/// Smallest and largest impedance of a contact: `solimp[0]` and `solimp[1]`.
const IMPEDANCE: [f64; 2] = [0.9, 0.95];
/// Depth over which the impedance rises, metres: `solimp[2]`.
const IMPEDANCE_WIDTH: f64 = 0.001;

/// The most contacts: the cell that the ball's centre is in, and its neighbours.
const MAX_CONTACTS: usize = 9;

/// Where the ball is and how it moves.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Body {
    /// Position, metres.
    pub position: Vector,
    /// Velocity, metres a second.
    pub velocity: Vector,
}

/// A wall that pushes.
#[derive(Clone, Copy, Debug, Default)]
struct Contact {
    /// From the wall to the ball, of length 1.
    normal: Vector,
    /// D.
    stiffness: f64,
    /// r.
    reference: f64,
}

/// The simulation of one maze.
#[derive(Clone, Debug)]
pub struct Physics {
    geometry: Geometry,
    /// Distance at which a wall begins to push, metres.
    margin: f64,
}

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

impl Physics {
    /// The ball in the maze of `geometry`, pushed by walls that are closer than `margin` metres.
    pub fn new(geometry: Geometry, margin: f64) -> Self {
        Self { geometry, margin }
    }

    /// One step of the simulation with `control`, each component -1 to 1.
    pub fn step(&self, body: &mut Body, control: Vector) {
        let force = [0, 1].map(|i| GEAR * control[i] - DAMPING * body.velocity[i]);
        let mut contacts = [Contact::default(); MAX_CONTACTS];
        let n = self.contacts(body, &mut contacts);
        let pushed = if n == 0 { [0.0; 2] } else { contact_force(&contacts[..n], force.map(|f| f / MASS)) };
        for i in 0..2 {
            body.velocity[i] += TIMESTEP * (force[i] + pushed[i]) / (MASS + TIMESTEP * DAMPING);
            body.position[i] += TIMESTEP * body.velocity[i];
        }
    }

    /// `frames` steps with the same control.
    pub fn advance(&self, body: &mut Body, control: Vector, frames: u32) {
        for _ in 0..frames {
            self.step(body, control);
        }
    }

    /// Writes the walls that push `body` to `out`; returns their number.
    fn contacts(&self, body: &Body, out: &mut [Contact; MAX_CONTACTS]) -> usize {
        let reach = RADIUS + self.margin;
        let cell = self.geometry.cell(body.position);
        let centre = self.geometry.centre(cell);
        let inner = 0.5 - reach;
        let far_from_edges = [0, 1].iter().all(|&i| (body.position[i] - centre[i]).abs() < inner);
        if far_from_edges && !self.geometry.is_wall(cell) {
            return 0;
        }
        let mut n = 0;
        for row in cell[1] - 1..=cell[1] + 1 {
            for column in cell[0] - 1..=cell[0] + 1 {
                if self.geometry.is_wall([column, row])
                    && let Some(contact) = self.contact(body, self.geometry.centre([column, row]))
                {
                    out[n] = contact;
                    n += 1;
                }
            }
        }
        n
    }

    /// How the wall around `centre` pushes `body`, if it does.
    fn contact(&self, body: &Body, centre: Vector) -> Option<Contact> {
        let (distance, normal) = clearance(body.position, centre);
        let depth = distance - self.margin;
        if depth >= 0.0 {
            return None;
        }
        let (b, k) = (
            2.0 / (IMPEDANCE[1] * TIME_CONSTANT),
            1.0 / (IMPEDANCE[1] * IMPEDANCE[1] * TIME_CONSTANT * TIME_CONSTANT),
        );
        let impedance = impedance(depth);
        Some(Contact {
            normal,
            stiffness: impedance * MASS / (1.0 - impedance),
            reference: -(b * dot(normal, body.velocity) + k * impedance * depth),
        })
    }
}

/// Distance between the ball at `position` and the wall around `centre`, negative where they overlap, and the direction
/// from the wall to the ball.
fn clearance(position: Vector, centre: Vector) -> (f64, Vector) {
    let nearest = [0, 1].map(|i| position[i].clamp(centre[i] - 0.5, centre[i] + 0.5));
    let away = [position[0] - nearest[0], position[1] - nearest[1]];
    let length = dot(away, away).sqrt();
    if length > 0.0 {
        return (length - RADIUS, away.map(|a| a / length));
    }
    // The ball's centre is inside the wall, where no step leads to: out by the nearest face.
    let inside = [position[0] - centre[0], position[1] - centre[1]];
    let axis = usize::from(inside[1].abs() > inside[0].abs());
    let mut normal = [0.0; 2];
    normal[axis] = 1f64.copysign(inside[axis]);
    (inside[axis].abs() - 0.5 - RADIUS, normal)
}

/// d at `depth` beyond the margin.
fn impedance(depth: f64) -> f64 {
    let x = depth.abs() / IMPEDANCE_WIDTH;
    let y = if x >= 1.0 {
        1.0
    } else if x <= 0.5 {
        2.0 * x * x
    } else {
        1.0 - 2.0 * (1.0 - x) * (1.0 - x)
    };
    IMPEDANCE[0] + y * (IMPEDANCE[1] - IMPEDANCE[0])
}

/// The force of `contacts` on a ball that would accelerate with `free`, newtons: m (a - a0).
///
/// The function that a minimises is strictly convex and, for each set of pushing contacts, quadratic. So a is the
/// minimum of the one set that pushes at its own minimum; all sets are tried, the smaller ones first. There are at most
/// three contacts unless the ball is inside a wall. Where rounding leaves no set that fits, the one that is nearest to
/// fitting is taken.
fn contact_force(contacts: &[Contact], free: Vector) -> Vector {
    let (mut best, mut least) = ([0.0; 2], f64::INFINITY);
    for set in 0..1u32 << contacts.len() {
        let pushes = |i: usize| set >> i & 1 == 1;
        // H a = g with H = m I + sum D n n^T, g = m a0 + sum D r n.
        let (mut xx, mut xy, mut yy) = (MASS, 0.0, MASS);
        let mut g = free.map(|a| MASS * a);
        for (i, Contact { normal: [x, y], stiffness, reference }) in contacts.iter().enumerate() {
            if pushes(i) {
                xx += stiffness * x * x;
                xy += stiffness * x * y;
                yy += stiffness * y * y;
                g[0] += stiffness * reference * x;
                g[1] += stiffness * reference * y;
            }
        }
        let determinant = xx * yy - xy * xy;
        let a = [(yy * g[0] - xy * g[1]) / determinant, (xx * g[1] - xy * g[0]) / determinant];
        // By how much a contact pulls that should push, or lets through what it should stop.
        let misfit = contacts.iter().enumerate().fold(0.0, |worst: f64, (i, c)| {
            let slack = dot(c.normal, a) - c.reference;
            worst.max(if pushes(i) { slack } else { -slack })
        });
        if misfit < least {
            (best, least) = ([MASS * (a[0] - free[0]), MASS * (a[1] - free[1])], misfit);
        }
        if misfit == 0.0 {
            break;
        }
    }
    best
}

#[cfg(test)]
#[path = "physics_tests.rs"]
mod tests;
