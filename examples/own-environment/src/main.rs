//! Trestle with an environment of its own: a pole that is balanced on a cart, as in Barto, Sutton and Anderson (1983) and in
//! Gymnasium's CartPole-v1.
//!
//!     cargo run --release -- train cart-pole --algo dqn

use std::process::ExitCode;
use trestle::config::{self, Preset, accepts::between};
use trestle::env::{EnvError, Environment, Kind, Step};
use trestle::{Element, EnvSpec, Stream, codec, rand::Rng, settings};

fn main() -> ExitCode {
    trestle::Program::new().environment::<CartPole>("cart-pole").main()
}

settings! {
    /// `[env.cart-pole]`
    pub struct Settings {
        /// Force of a push, newtons.
        force: f64 = 10.0, between(0.1, 100.0);
        /// Half the length of the pole, metres.
        half_length: f64 = 0.5, between(0.05, 5.0);
        /// Acceleration of gravity, metres per second squared.
        gravity: f64 = 9.8, between(0.0, 100.0);
    }
}

/// Seconds of a step.
const STEP_S: f64 = 0.02;
/// Mass of the cart, and of the pole, kilograms.
const CART_KG: f64 = 1.0;
const POLE_KG: f64 = 0.1;
/// How far the cart may be from the middle, metres, and how far the pole may lean, radians.
const MAX_POSITION: f64 = 2.4;
const MAX_ANGLE: f64 = 12.0 * std::f64::consts::PI / 180.0;

/// What a snapshot says that it is.
const SNAPSHOT: codec::Kind = codec::Kind { magic: *b"CARTPOLE", version: 1 };

/// A cart on a track, with a pole on it.
struct CartPole {
    spec: EnvSpec,
    settings: Settings,
    step_limit: u32,
    /// Position, velocity, angle and angular velocity, in metres, radians and seconds.
    state: [f64; 4],
    steps: u32,
    running: bool,
}

impl Kind for CartPole {
    type Settings = Settings;

    const ABOUT: &'static str = "A pole on a cart that is pushed to the left or to the right.";

    fn new(settings: &Settings, env: &config::Env) -> Result<Self, EnvError> {
        let bounds = [MAX_POSITION as f32, 3.0, MAX_ANGLE as f32, 3.0];
        let spec = EnvSpec {
            name: "cart-pole".into(),
            element: Element::F32,
            shape: Vec::new(),
            low: bounds.map(|bound| -bound).to_vec(),
            high: bounds.to_vec(),
            scale: vec![0.02, 0.2, 0.02, 0.3],
            integral: false,
            categories: Vec::new(),
            velocities: vec![1, 3],
            actions: vec!["left".into(), "right".into()],
            // A point for each step, as long as the pole stands.
            best_return: Some(f64::from(env.step_limit)),
            threshold: Some(0.95 * f64::from(env.step_limit)),
            goal_bonus: 0.0,
            defines_success: false,
        };
        let (settings, step_limit) = (settings.clone(), env.step_limit);
        Ok(Self { spec, settings, step_limit, state: [0.0; 4], steps: 0, running: false })
    }

    fn presets() -> &'static [Preset] {
        &[Preset { name: "cart-pole", text: include_str!("cart-pole.toml") }]
    }
}

impl CartPole {
    fn observe(&self, obs: &mut [f32]) {
        obs.iter_mut().zip(self.state).for_each(|(feature, value)| *feature = value as f32);
    }
}

impl Environment for CartPole {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn features(&self) -> Vec<&str> {
        vec!["position", "velocity", "angle", "angular velocity"]
    }

    fn reset(&mut self, rng: &mut Stream, obs: &mut [f32]) -> Result<(), EnvError> {
        self.state = std::array::from_fn(|_| rng.random_range(-0.05..0.05));
        (self.steps, self.running) = (0, true);
        self.observe(obs);
        Ok(())
    }

    fn step(&mut self, action: u32, obs: &mut [f32]) -> Result<Step, EnvError> {
        if !self.running {
            return Err(EnvError::Ended);
        }
        let Settings { force, half_length, gravity } = self.settings;
        let push = match action {
            0 => -force,
            1 => force,
            _ => return Err(EnvError::Action { action, last: 1 }),
        };
        let [_, velocity, angle, turning] = self.state;
        let (sin, cos, mass) = (angle.sin(), angle.cos(), CART_KG + POLE_KG);
        let along = (push + POLE_KG * half_length * turning * turning * sin) / mass;
        let leverage = half_length * (4.0 / 3.0 - POLE_KG * cos * cos / mass);
        let angular = (gravity * sin - cos * along) / leverage;
        let linear = along - POLE_KG * half_length * angular * cos / mass;
        let change = [velocity, linear, turning, angular];
        self.state.iter_mut().zip(change).for_each(|(value, change)| *value += STEP_S * change);
        self.steps += 1;
        let terminated = self.state[0].abs() > MAX_POSITION || self.state[2].abs() > MAX_ANGLE;
        let truncated = !terminated && self.steps >= self.step_limit;
        self.running = !(terminated || truncated);
        self.observe(obs);
        Ok(Step { reward: 1.0, terminated, truncated, success: false })
    }

    fn snapshot(&self) -> Result<Vec<u8>, EnvError> {
        Ok(codec::encode(SNAPSHOT, &(self.state, self.steps, self.running))?)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), EnvError> {
        (self.state, self.steps, self.running) = codec::decode(SNAPSHOT, bytes)?;
        Ok(())
    }

    /// The cart may be anywhere near the track: the bounds of the spaces are the network's alone.
    fn can_be_in(&self, _state: &[f32]) -> Result<(), trestle::env::Impossible> {
        Ok(())
    }
}
