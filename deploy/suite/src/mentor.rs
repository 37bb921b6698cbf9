//! Mentors of tasks, good ones and bad ones. A demonstration is a function of its task.

use crate::paths::{Paths, Ties, below};
use crate::set::{Task, map_text};
use serde::Deserialize;
use trestle_actor::env::grid::{ActionSet, Cell, GridError, Map};
use trestle_actor::env::{EnvError, registry};
use trestle_algorithm::demonstration::{Demonstration, DemonstrationError};
use trestle_proto::config::{self, ConfigError};
use trestle_proto::rng::{Purpose, Stream, stream};

/// Maps that are tried to find another one whose path fits here.
const MAX_OTHERS: u64 = 64;
/// A random walk is so many times as long as the shortest path, and has so many moves at the most.
const WALK: [u32; 2] = [4, 400];
/// Moves of the shortest path for each leap.
const LEAP: u32 = 5;

/// What a mentor does. Where it says "path", that is the shortest one that hugs walls, or what the environment plans where it
/// is no maze of cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mentor {
    /// What `mentor.demo = "plan"` gives. In the Point Maze several trajectories begin in free cells by chance, but for the
    /// first.
    Planned,
    /// The shortest path that is nearest to walls.
    Hugging,
    /// The shortest path that is farthest from walls.
    Free,
    /// A shortest path by chance.
    Mixed,
    /// A path by way of some cell that is half as long again as the shortest one, or up to three times as long.
    Detour,
    /// The first third of its path.
    Short,
    /// Jumps over three cells or more, which nobody can follow.
    Leaps,
    /// The path through another map of the same generator and size: that of the next seed where at least one state lies in a
    /// wall here, and fewer than half of them do.
    OtherMap,
    /// Possible moves by chance, four times as many as its path has, up to 400.
    RandomWalk,
    /// Its path from the goal to the start; velocities change their sign.
    Backwards,
}

/// A task whose demonstration cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum MentorError {
    /// Its settings.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// Its environment or its map.
    #[error(transparent)]
    Env(#[from] EnvError),
    /// The map that another one is compared with.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// States that are no demonstration.
    #[error(transparent)]
    States(#[from] DemonstrationError),
    /// No way to the goal.
    #[error("the mentor cannot reach the goal of {map} with the action set {actions}")]
    NoWay {
        /// The map.
        map: String,
        /// The mentor's action set.
        actions: String,
    },
    /// A mentor of cells in an environment without cells.
    #[error("mentor = {mentor:?} in the environment {env}; accepted: planned, short, backwards")]
    NoCells {
        /// What was asked for.
        mentor: Mentor,
        /// The environment.
        env: String,
    },
    /// More trajectories than there is a rule for.
    #[error(
        "trajectories = {trajectories} with mentor = {mentor:?}; accepted: 1, or mentor = planned in the Point Maze"
    )]
    Trajectories {
        /// What was asked for.
        trajectories: u32,
        /// See `trajectories`.
        mentor: Mentor,
    },
    /// No other map fits.
    #[error(
        "mentor = other-map with the map {map}; accepted: a generator's map, whose next {MAX_OTHERS} seeds must have one"
    )]
    NoOther {
        /// The map.
        map: String,
    },
}

/// The demonstration of `task` with `sets`, all settings of it.
///
/// # Errors
/// A task that cannot be.
pub fn demonstration(task: &Task, sets: &[String]) -> Result<Demonstration, MentorError> {
    let mut config = config::load(registry(), &task.preset, sets)?;
    registry().resolve(&mut config.env, 0)?;
    let env = registry().build(&config.env)?;
    let dim = env.spec().obs_dim();
    let names = match env.features() {
        [] => (0..dim).map(|i| format!("s{i}")).collect(),
        names => names.iter().map(ToString::to_string).collect(),
    };
    let rng = &mut stream(task.seed, Purpose::Demonstration, 0);
    let mut demonstration = Demonstration::new(names)?;
    let cells = registry().cells(&config.env, &config.mentor.actions)?;
    if let Some((map, set)) = cells.as_ref().filter(|_| task.mentor != Mentor::Planned) {
        let (states, terminal) = in_cells(task, map, set, rng)?;
        let states: Vec<f32> = states.into_iter().flatten().map(|at| at as f32).collect();
        demonstration.push_trajectory(&states, terminal)?;
        return Ok(demonstration);
    }
    let refused = || MentorError::NoCells { mentor: task.mentor, env: config.env.name.clone() };
    let mut states = registry().plan_states(&config.env, &config.mentor.actions)?;
    let terminal = match task.mentor {
        Mentor::Planned => true,
        Mentor::Short => {
            states.truncate(third(states.len()));
            false
        }
        Mentor::Backwards => {
            states.reverse();
            for velocity in &env.spec().velocities {
                states.iter_mut().for_each(|state| state[*velocity] = -state[*velocity]);
            }
            false
        }
        _ => return Err(refused()),
    };
    demonstration.push_trajectory(&states.concat(), terminal)?;
    for _ in 1..task.trajectories {
        if task.mentor != Mentor::Planned || cells.is_some() {
            return Err(MentorError::Trajectories { trajectories: task.trajectories, mentor: task.mentor });
        }
        let states = from_elsewhere(task, sets, rng)?;
        demonstration.push_trajectory(&states.concat(), true)?;
    }
    Ok(demonstration)
}

/// States that are kept of a path that is cut short.
fn third(states: usize) -> usize {
    (states / 3).max(2)
}

/// The states of a mentor in a maze of cells, and whether its last state is terminal.
fn in_cells(
    task: &Task,
    map: &Map,
    set: &ActionSet,
    rng: &mut Stream,
) -> Result<(Vec<Cell>, bool), MentorError> {
    if task.trajectories != 1 {
        return Err(MentorError::Trajectories { trajectories: task.trajectories, mentor: task.mentor });
    }
    let paths = Paths::new(map, set);
    let no_way = || MentorError::NoWay { map: task.map.clone(), actions: set.name.clone() };
    let mut shortest = |ties| paths.shortest(ties, rng).ok_or_else(no_way);
    Ok(match task.mentor {
        Mentor::Planned | Mentor::Hugging => (shortest(Ties::Hugging)?, true),
        Mentor::Free => (shortest(Ties::Free)?, true),
        Mentor::Mixed => (shortest(Ties::Mixed)?, true),
        Mentor::Short => {
            let mut path = shortest(Ties::Hugging)?;
            path.truncate(third(path.len()));
            (path, false)
        }
        Mentor::Backwards => {
            let mut path = shortest(Ties::Hugging)?;
            path.reverse();
            (path, false)
        }
        Mentor::Detour => (paths.detour(rng).ok_or_else(no_way)?, true),
        Mentor::Leaps => {
            let moves = paths.moves().ok_or_else(no_way)?;
            (paths.leaps((moves / LEAP).max(2), rng), true)
        }
        Mentor::RandomWalk => {
            let moves = paths.moves().ok_or_else(no_way)?;
            (paths.walk((WALK[0] * moves).min(WALK[1]), rng), false)
        }
        Mentor::OtherMap => (through_another(task, map, set, rng)?, true),
    })
}

/// The path through the next map of the same generator and size that fits; see [`Mentor::OtherMap`].
fn through_another(
    task: &Task,
    map: &Map,
    set: &ActionSet,
    rng: &mut Stream,
) -> Result<Vec<Cell>, MentorError> {
    let none = || MentorError::NoOther { map: task.map.clone() };
    let (generator, rest) = task.map.split_once(':').ok_or_else(none)?;
    let (seed, size) = rest.split_once(':').ok_or_else(none)?;
    let seed: u64 = seed.parse().map_err(|_| none())?;
    for seed in (1..=MAX_OTHERS).filter_map(|more| seed.checked_add(more)) {
        let name = format!("{generator}:{seed}:{size}");
        let other = Map::parse(&name, &map_text(&name)?).map_err(GridError::from)?;
        let Some(path) = Paths::new(&other, set).shortest(Ties::Hugging, rng) else { continue };
        let walls = path.iter().filter(|&&cell| !map.is_free(cell)).count();
        if walls > 0 && 2 * walls < path.len() {
            return Ok(path);
        }
    }
    Err(none())
}

/// What is planned from a free cell that `rng` draws.
fn from_elsewhere(task: &Task, sets: &[String], rng: &mut Stream) -> Result<Vec<Vec<f32>>, MentorError> {
    let text = map_text(&task.map)?;
    let free: Vec<usize> = text.char_indices().filter(|(_, c)| *c == '.').map(|(at, _)| at).collect();
    let moved: String = match free.is_empty() {
        true => text,
        false => {
            let start = free[below(rng, free.len())];
            let letter = |(at, c)| match c {
                _ if at == start => 'S',
                'S' => '.',
                c => c,
            };
            text.char_indices().map(letter).collect()
        }
    };
    // A name that is nobody's, so that the text stands for itself.
    let here = [format!("env.map=moved/{}", task.map.replace(':', "-")), format!("env.map_text={moved:?}")];
    let sets: Vec<String> = sets.iter().cloned().chain(here).collect();
    let mut config = config::load(registry(), &task.preset, &sets)?;
    registry().resolve(&mut config.env, 0)?;
    Ok(registry().plan_states(&config.env, &config.mentor.actions)?)
}
