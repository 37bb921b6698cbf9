//! Observations of any space as flat rows of `f32`.

use pyo3::buffer::{Element, PyBuffer};
use pyo3::exceptions::PyValueError;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use serde_json::Value;

/// A space of observations, as `_gym.describe` writes it.
pub(crate) enum Space {
    /// An array of numbers.
    Box { shape: Vec<usize>, len: usize },
    /// A whole number from `start` on.
    Discrete { n: i64, start: i64 },
    /// What has no features.
    Nothing,
    /// Several spaces in a row.
    Tuple(Vec<Space>),
    /// Several spaces by name.
    Dict(Vec<(String, Space)>),
}

impl Space {
    /// Reads what `_gym.describe` wrote.
    pub(crate) fn parse(value: &Value) -> Result<Self, String> {
        let field = |name: &str| value.get(name).ok_or_else(|| format!("a space without {name}: {value}"));
        let whole =
            |name: &str| field(name)?.as_i64().ok_or_else(|| format!("{name} is no whole number: {value}"));
        let list = |name: &str| field(name)?.as_array().ok_or_else(|| format!("{name} is no list: {value}"));
        match field("kind")?.as_str().unwrap_or_default() {
            "box" => {
                let sides = list("shape")?.iter().map(|side| side.as_u64().map(|side| side as usize));
                let shape: Vec<usize> =
                    sides.collect::<Option<_>>().ok_or("a shape of other than numbers")?;
                Ok(Self::Box { len: shape.iter().product(), shape })
            }
            "discrete" => Ok(Self::Discrete { n: whole("n")?, start: whole("start")? }),
            "none" => Ok(Self::Nothing),
            "tuple" => Ok(Self::Tuple(list("spaces")?.iter().map(Self::parse).collect::<Result<_, _>>()?)),
            "dict" => {
                let names = list("keys")?.iter().map(|key| key.as_str().unwrap_or_default().to_string());
                let spaces = list("spaces")?.iter().map(Self::parse).collect::<Result<Vec<_>, _>>()?;
                Ok(Self::Dict(names.zip(spaces).collect()))
            }
            other => Err(format!("a space of the kind {other:?}")),
        }
    }

    /// Features of an observation.
    pub(crate) fn len(&self) -> usize {
        match self {
            Self::Box { len, .. } => *len,
            Self::Discrete { .. } => 1,
            Self::Nothing => 0,
            Self::Tuple(spaces) => spaces.iter().map(Self::len).sum(),
            Self::Dict(spaces) => spaces.iter().map(|(_, space)| space.len()).sum(),
        }
    }

    /// Writes `obs` into `out` (`[len]`), row-major, parts in their order.
    pub(crate) fn write(&self, obs: &Bound<'_, PyAny>, out: &mut [f32]) -> PyResult<()> {
        match self {
            Self::Box { shape, .. } => numbers(obs, shape, out),
            Self::Discrete { n, start } => {
                let value = obs
                    .extract::<i64>()
                    .or_else(|error| match obs.call_method0(intern!(obs.py(), "item")) {
                        Ok(item) => item.extract::<i64>(),
                        Err(_) => Err(error),
                    })
                    .map_err(|_| {
                        wrong(
                            "an observation",
                            &format!("a whole number from {start} to {}", start + n - 1),
                            obs,
                        )
                    })?;
                if !(*start..start + n).contains(&value) {
                    return Err(wrong("an observation", &format!("{start} to {}", start + n - 1), obs));
                }
                out[0] = (value - start) as f32;
                Ok(())
            }
            Self::Nothing => Ok(()),
            Self::Tuple(spaces) => {
                let parts =
                    obs.cast::<PyTuple>().ok().filter(|parts| parts.len() == spaces.len()).ok_or_else(
                        || wrong("an observation", &format!("a tuple of {}", spaces.len()), obs),
                    )?;
                let mut from = 0;
                for (place, (space, part)) in spaces.iter().zip(parts.iter_borrowed()).enumerate() {
                    let written = space.write(&part, &mut out[from..from + space.len()]);
                    written.map_err(|error| of_part(obs.py(), &place.to_string(), error))?;
                    from += space.len();
                }
                Ok(())
            }
            Self::Dict(spaces) => {
                let parts = obs.cast::<PyDict>().map_err(|_| wrong("an observation", "a dict", obs))?;
                let mut from = 0;
                for (key, space) in spaces {
                    let part = parts.get_item(key)?.ok_or_else(|| {
                        wrong("an observation", &format!("a dict with the key {key:?}"), obs)
                    })?;
                    let written = space.write(&part, &mut out[from..from + space.len()]);
                    written.map_err(|error| of_part(obs.py(), key, error))?;
                    from += space.len();
                }
                Ok(())
            }
        }
    }
}

/// How a message names an observation, and a part of one.
const WHOLE: &str = "an observation";
const PART: &str = "the part ";

/// `error` of a part of an observation, which is called `key`, with the name of the part.
fn of_part(py: Python<'_>, key: &str, error: PyErr) -> PyErr {
    if !error.is_instance_of::<PyValueError>(py) {
        return error;
    }
    let said = error.value(py).to_string();
    let named = match (said.strip_prefix(PART), said.strip_prefix(WHOLE)) {
        (Some(below), _) => format!("{PART}{key}.{below}"),
        (_, Some(rest)) => format!("{PART}{key} of {WHOLE}{rest}"),
        _ => said,
    };
    PyValueError::new_err(named)
}

/// What is in the place of something else.
pub(crate) fn wrong(what: &str, accepted: &str, found: &Bound<'_, PyAny>) -> PyErr {
    let kind = found.get_type().name().map_or_else(|_| "?".into(), |name| name.to_string());
    let mut shown = found.repr().map_or_else(|_| "?".into(), |text| text.to_string());
    if shown.chars().count() > 200 {
        shown = shown.chars().take(200).collect::<String>() + " ...";
    }
    PyValueError::new_err(format!("{what} is {shown} ({kind}); accepted: {accepted}"))
}

/// Writes an array of numbers of `shape` into `out`, row-major.
fn numbers(obs: &Bound<'_, PyAny>, shape: &[usize], out: &mut [f32]) -> PyResult<()> {
    if copied::<f32>(obs, shape, out)?
        || copied::<f64>(obs, shape, out)?
        || copied::<u8>(obs, shape, out)?
        || copied::<i64>(obs, shape, out)?
        || copied::<i32>(obs, shape, out)?
    {
        return Ok(());
    }
    // Truth values, other widths, lists, scalars: numpy knows them all.
    let py = obs.py();
    let numpy = py.import(intern!(py, "numpy"))?;
    let array = numpy
        .call_method1(intern!(py, "asarray"), (obs, intern!(py, "float32")))
        .map_err(|_| wrong("an observation", &format!("an array of shape {shape:?}"), obs))?;
    if copied::<f32>(&array, shape, out)? { Ok(()) } else { Err(wrong("an observation", "numbers", obs)) }
}

/// Whether `obs` is an array of `T`; then it has been copied.
fn copied<T: Element + Number + Default>(
    obs: &Bound<'_, PyAny>,
    shape: &[usize],
    out: &mut [f32],
) -> PyResult<bool> {
    let Ok(buffer) = PyBuffer::<T>::get(obs) else { return Ok(false) };
    if buffer.shape() != shape {
        let found = buffer.shape().to_vec();
        return Err(PyValueError::new_err(format!(
            "an observation has the shape {found:?}; accepted: {shape:?}, as in its space"
        )));
    }
    let values = buffer.to_vec(obs.py())?;
    values.into_iter().zip(out).for_each(|(value, out)| *out = value.number());
    Ok(true)
}

/// A number as the network takes it.
trait Number: Copy {
    fn number(self) -> f32;
}

macro_rules! numbers {
    ($($kind:ty),+) => { $(impl Number for $kind {
        fn number(self) -> f32 {
            self as f32
        }
    })+ };
}

numbers!(f32, f64, u8, i64, i32);

/// Turns observations of a space into flat rows.
#[pyclass(frozen)]
pub(crate) struct Flattener {
    space: Space,
}

#[pymethods]
impl Flattener {
    /// For the space that `_gym.describe` has written as JSON.
    #[new]
    fn new(space: &str) -> PyResult<Self> {
        let value: Value =
            serde_json::from_str(space).map_err(|error| PyValueError::new_err(error.to_string()))?;
        Ok(Self { space: Space::parse(&value).map_err(PyValueError::new_err)? })
    }

    /// The features of `obs`, as a list of floats.
    fn __call__(&self, obs: &Bound<'_, PyAny>) -> PyResult<Vec<f32>> {
        let mut out = vec![0.0; self.space.len()];
        self.space.write(obs, &mut out)?;
        Ok(out)
    }

    /// Features of an observation.
    fn __len__(&self) -> usize {
        self.space.len()
    }
}
