//! Where libmujoco is looked for, and which of what is found is used.
//!
//! In this order: the file or directory that `MUJOCO_LIB` names; `third_party/mujoco/lib` in the working directory, in the
//! program's own directory, or above one of them; the `mujoco` package of the active virtual environment; what the
//! system's loader finds. Where `MUJOCO_LIB` is set nothing else is looked at, so that a slip in it is not passed over.

use super::MujocoError;
use super::api::{Api, Version};
use super::simulation::Simulation;
use crate::env::grid::Map;
use crate::env::point_maze::Layout;
use crate::env::point_maze::geometry::Geometry;
use crate::env::point_maze::physics::{Body, Physics};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

/// The variable that names the library.
const VARIABLE: &str = "MUJOCO_LIB";
/// The name by which the system's loader is asked.
const SYSTEM: &str = "libmujoco.so";
/// Largest difference of one step from the built-in physics. Real ones are below 1e-12.
const AGREEMENT: f64 = 1e-9;

/// A library that works.
#[derive(Clone)]
pub struct Found {
    api: Arc<Api>,
    path: PathBuf,
    /// What was passed over on the way to it, and why.
    passed_over: Vec<String>,
}

impl Found {
    /// The maze of `geometry`, with walls that push from `margin` metres on.
    ///
    /// # Errors
    /// A map with too many walls, or a model that MuJoCo does not accept.
    pub fn simulation(&self, geometry: &Geometry, margin: f64) -> Result<Simulation, MujocoError> {
        Simulation::new(&self.api, geometry, margin)
    }

    /// Its version.
    pub fn version(&self) -> Version {
        self.api.version
    }

    /// The file, or the name that the system's loader was asked for.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What was passed over on the way to it, and why.
    pub fn passed_over(&self) -> &[String] {
        &self.passed_over
    }
}

/// The library of this process: looked for once.
///
/// # Errors
/// None was found that works.
pub fn library() -> Result<&'static Found, MujocoError> {
    static LIBRARY: OnceLock<Result<Found, MujocoError>> = OnceLock::new();
    LIBRARY.get_or_init(find).as_ref().map_err(Clone::clone)
}

/// Looks for a library.
///
/// # Errors
/// What is wrong with the one that `MUJOCO_LIB` names, or all that was looked at.
pub fn find() -> Result<Found, MujocoError> {
    if let Some(named) = std::env::var_os(VARIABLE).filter(|named| !named.is_empty()) {
        let named = PathBuf::from(named);
        let path = if named.is_dir() { newest(&named).unwrap_or(named) } else { named };
        return Ok(Found { api: open(&path)?, path, passed_over: Vec::new() });
    }
    let mut passed_over = Vec::new();
    let mut places = directories();
    places.dedup();
    let mut files: Vec<PathBuf> = places.iter().filter_map(|place| newest(place)).collect();
    files.push(SYSTEM.into());
    for path in files {
        match open(&path) {
            Ok(api) => return Ok(Found { api, path, passed_over }),
            Err(error) => passed_over.push(error.to_string()),
        }
    }
    Err(MujocoError::Missing {
        tried: format!(
            "{VARIABLE} (not set), third_party/mujoco/lib, a virtual environment, {}",
            passed_over.join("; ")
        ),
    })
}

/// Directories in which the library may lie, the first one preferred.
fn directories() -> Vec<PathBuf> {
    let above =
        |path: &Path| path.ancestors().map(|dir| dir.join("third_party/mujoco/lib")).collect::<Vec<_>>();
    let mut places = Vec::new();
    if let Ok(here) = std::env::current_dir() {
        places.extend(above(&here));
    }
    if let Ok(program) = std::env::current_exe() {
        places.extend(above(&program));
    }
    for variable in ["VIRTUAL_ENV", "CONDA_PREFIX"] {
        let Some(root) = std::env::var_os(variable) else { continue };
        let Ok(entries) = fs::read_dir(Path::new(&root).join("lib")) else { continue };
        let mut pythons: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
        pythons.sort();
        places.extend(pythons.into_iter().map(|python| python.join("site-packages/mujoco")));
    }
    places
}

/// The library in `directory`, the newest if there are several.
fn newest(directory: &Path) -> Option<PathBuf> {
    let version = |path: &PathBuf| -> Option<Vec<u32>> {
        let rest = path.file_name()?.to_str()?.strip_prefix(SYSTEM)?;
        rest.split('.').filter(|part| !part.is_empty()).map(|part| part.parse().ok()).collect()
    };
    let files = fs::read_dir(directory).ok()?.filter_map(|entry| Some(entry.ok()?.path()));
    files.filter_map(|path| Some((version(&path)?, path))).max().map(|(_, path)| path)
}

/// Loads the library at `path` and sees whether it computes what it should.
fn open(path: &Path) -> Result<Arc<Api>, MujocoError> {
    let api = Arc::new(Api::load(path)?);
    let map = Map::parse("probe", "S.G\n").map_err(|e| MujocoError::Model { message: e.to_string() })?;
    let geometry = Geometry::new(map, Layout::Gymnasium);
    let mut simulation = Simulation::new(&api, &geometry, 0.002)?;
    let physics = Physics::new(geometry, 0.002);
    // Free flight, a wall within the margin, a wall that is pushed into, and a corner.
    for (position, velocity) in [
        ([0.0, 0.0], [1.0, -2.0]),
        ([0.2, 0.399], [0.0, 0.1]),
        ([0.2, -0.405], [3.0, -4.0]),
        ([-1.41, 0.401], [-1.0, 2.0]),
    ] {
        let (start, control) = (Body { position, velocity }, [0.75, -0.5]);
        let (mut theirs, mut ours) = (start, start);
        simulation.advance(&mut theirs, control, 1)?;
        physics.step(&mut ours, control);
        let numbers =
            |body: &Body| [body.position, body.velocity].concat().try_into().unwrap_or([f64::NAN; 4]);
        let (found, expected): ([f64; 4], [f64; 4]) = (numbers(&theirs), numbers(&ours));
        // What is not a number does not agree either.
        if !found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < AGREEMENT) {
            let version = simulation.version();
            return Err(MujocoError::Differs { path: path.into(), version, found, expected });
        }
    }
    Ok(api)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn the_newest_library_of_a_directory_is_taken() {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(newest(dir.path()), None);
        for name in [
            "libmujoco.so.3.9.0",
            "libmujoco.so.3.10.0",
            "libmujoco.so.x",
            "libother.so.9",
            "libmujoco.so.3.2",
        ] {
            fs::write(dir.path().join(name), "").unwrap();
        }
        assert_eq!(newest(dir.path()), Some(dir.path().join("libmujoco.so.3.10.0")));
    }

    #[test]
    fn the_projects_own_directory_comes_first() {
        let places = directories();
        assert_eq!(places[0], std::env::current_dir().unwrap().join("third_party/mujoco/lib"));
    }
}
