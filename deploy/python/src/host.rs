//! The host of Gymnasium's environments: `env.reset` and `env.step` in the Python of this process.

use crate::end_if_forked;
use crate::flat::{Space, wrong};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use trestle_actor::env::Frame;
use trestle_actor::env::gym::{Found, GymError, Host, Outcome, Settings, Simulator};

/// Makes environments in the Python of this process.
pub(crate) const HOST: Host = Host { make };

/// Lines of a traceback that a message shows, from its end.
const MAX_LINES: usize = 8;
/// Characters of a line.
const MAX_LINE: usize = 400;

/// An environment of Python.
struct Env {
    name: String,
    space: Space,
    /// The whole observation, and the places in it of the features that the agent sees.
    flat: Vec<f32>,
    places: Vec<usize>,
    reset: Py<PyAny>,
    step: Py<PyAny>,
    close: Py<PyAny>,
    /// The environment, for pictures of it.
    env: Py<PyAny>,
    actions: Vec<Py<PyAny>>,
    /// Whether an action is an array, which the environment could change: it gets a copy.
    arrays: bool,
}

fn make(settings: &Settings, found: &Found) -> Result<Box<dyn Simulator>, GymError> {
    let name = found.name.clone();
    let space = Space::parse(&found.space).map_err(GymError::Found)?;
    let (features, actions) = (&found.features, &found.actions);
    let fits = features.places.len() == features.range.len()
        && features.places.iter().all(|&place| place < space.len())
        && actions.values.len() == actions.names.len();
    if !fits {
        let what = "lists that do not fit the space; accepted: what a run has found";
        return Err(GymError::Found(what.into()));
    }
    let settings = serde_json::to_string(settings).map_err(|error| GymError::Found(error.to_string()))?;
    let found_json = found.to_json()?;
    let made = Python::attach(|py| -> PyResult<Env> {
        let module = py.import(intern!(py, "trestle._gym"))?;
        let made = module.call_method1(intern!(py, "make_found"), (settings, found_json))?;
        let (env, actions): (Bound<'_, PyAny>, Vec<Py<PyAny>>) = made.extract()?;
        let method = |name| env.getattr(name).map(Bound::unbind);
        Ok(Env {
            name: name.clone(),
            flat: vec![0.0; space.len()],
            space,
            places: found.features.places.clone(),
            reset: method(intern!(py, "reset"))?,
            step: method(intern!(py, "step"))?,
            close: method(intern!(py, "close"))?,
            env: env.unbind(),
            actions,
            arrays: !found.actions.shape.is_empty(),
        })
    });
    end_if_forked();
    match made {
        Ok(env) => Ok(Box::new(env)),
        Err(error) => Err(raised(&name, "making it", &error)),
    }
}

/// The exception `error` while `doing` something with the environment `name`, the end of its traceback in the log.
fn raised(name: &str, doing: &str, error: &PyErr) -> GymError {
    let text = Python::attach(|py| {
        let traceback = error.traceback(py).and_then(|traceback| traceback.format().ok()).unwrap_or_default();
        let lines: Vec<&str> = traceback.lines().collect();
        let kept = &lines[lines.len().saturating_sub(MAX_LINES)..];
        // Each call whole: its line begins it.
        let first = kept.iter().position(|line| line.starts_with("  File ")).unwrap_or(0);
        let kept = &kept[first..];
        let kept = kept.iter().map(|line| line.chars().take(MAX_LINE).collect::<String>());
        let exception: String = error.to_string().chars().take(4 * MAX_LINE).collect();
        // The exception is the last line of the log: that is how a run tells whether it has failed so before.
        for line in kept {
            eprintln!("{line}");
        }
        exception.lines().collect::<Vec<_>>().join(" / ")
    });
    GymError::Raised { name: name.into(), what: format!("{doing} raised {text}") }
}

impl Env {
    fn pick(&self, obs: &mut [f32]) {
        obs.iter_mut().zip(&self.places).for_each(|(feature, &place)| *feature = self.flat[place]);
    }

    fn begin(&mut self, py: Python<'_>, seed: u32) -> PyResult<()> {
        let named = PyDict::new(py);
        named.set_item(intern!(py, "seed"), seed)?;
        let answer = self.reset.bind(py).call((), Some(&named))?;
        match answer.cast::<PyTuple>() {
            Ok(pair) if pair.len() == 2 => self.space.write(&pair.get_item(0)?, &mut self.flat),
            _ => Err(wrong("what reset returned", "(observation, info)", &answer)),
        }
    }

    fn advance(&mut self, py: Python<'_>, action: usize) -> PyResult<Outcome> {
        let action = self.actions[action].bind(py);
        let answer = if self.arrays {
            self.step.bind(py).call1((action.call_method0(intern!(py, "copy"))?,))?
        } else {
            self.step.bind(py).call1((action,))?
        };
        let Some(parts) = answer.cast::<PyTuple>().ok().filter(|parts| parts.len() == 5) else {
            return Err(wrong(
                "what step returned",
                "(observation, reward, terminated, truncated, info)",
                &answer,
            ));
        };
        self.space.write(&parts.get_item(0)?, &mut self.flat)?;
        let reward = parts.get_item(1)?;
        let reward: f64 = reward.extract().map_err(|_| wrong("a reward", "a number", &reward))?;
        let flag = |place| -> PyResult<bool> { parts.get_item(place)?.is_truthy() };
        let told = match parts.get_item(4)?.cast::<PyDict>() {
            Ok(info) => info.get_item(intern!(py, "is_success"))?,
            Err(_) => None,
        };
        let success = told.map_or(Ok(false), |told| told.is_truthy())?;
        Ok(Outcome { reward: reward as f32, terminated: flag(2)?, truncated: flag(3)?, success })
    }
}

impl Simulator for Env {
    fn reset(&mut self, seed: u32, obs: &mut [f32]) -> Result<(), GymError> {
        let begun = Python::attach(|py| self.begin(py, seed));
        end_if_forked();
        begun.map_err(|error| raised(&self.name, "reset", &error))?;
        self.pick(obs);
        Ok(())
    }

    fn step(&mut self, action: usize, obs: &mut [f32]) -> Result<Outcome, GymError> {
        let stepped = Python::attach(|py| self.advance(py, action));
        end_if_forked();
        let outcome = stepped.map_err(|error| raised(&self.name, "step", &error))?;
        self.pick(obs);
        Ok(outcome)
    }

    fn frame(&mut self) -> Result<Option<Frame>, GymError> {
        let seen = Python::attach(|py| -> PyResult<Option<Frame>> {
            let module = py.import(intern!(py, "trestle._gym"))?;
            let seen = module.call_method1(intern!(py, "frame"), (&self.env,))?;
            let seen: Option<(usize, usize, Vec<u8>)> = seen.extract()?;
            Ok(seen.map(|(width, height, rgb)| Frame { width, height, rgb }))
        });
        end_if_forked();
        seen.map_err(|error| raised(&self.name, "drawing it", &error))
    }
}

impl Drop for Env {
    /// Lets it end what it has started. What it raises then is nobody's concern any more.
    fn drop(&mut self) {
        let _ = Python::try_attach(|py| self.close.call0(py).map(drop));
        end_if_forked();
    }
}
