//! Mentors of tasks, good ones and bad ones. A demonstration is a function of its task.

use crate::paths::{Paths, Ties};
use trestle_actor::env::grid::{self, ActionSet, Cell, GridError, Map};
use trestle_actor::env::{EnvError, registry};
use trestle_algorithm::demonstration::{Demonstration, DemonstrationError};
use trestle_proto::choices;
use trestle_proto::config::{self, ConfigError};
use trestle_proto::rng::{Purpose, Stream, below, stream};

/// Maps that are tried to find another one whose path fits here.
const MAX_OTHERS: u64 = 64;
/// A random walk is so many times as long as the shortest path, and has so many moves at the most.
const WALK: [u32; 2] = [4, 400];
/// Moves of the shortest path for each leap.
const LEAP: u32 = 5;

choices! {
    /// What a mentor does. "Its path" is the shortest one that hugs walls, or what the environment plans where states are no cells
    /// of a map.
    pub enum Mentor {
        /// What `mentor.demo = "plan"` gives. Trajectories after the first begin in free cells by chance.
        Planned = "planned",
        /// The shortest path that is nearest to walls.
        Hugging = "hugging",
        /// The shortest path that is farthest from walls.
        Free = "free",
        /// A shortest path by chance.
        Mixed = "mixed",
        /// A path by way of some cell: half as long again as the shortest one, or up to three times as long.
        Detour = "detour",
        /// The first third of its path.
        Short = "short",
        /// Jumps over three cells or more, which nobody can follow.
        Leaps = "leaps",
        /// The path through the map of the generator's next seed where some states, fewer than half, lie in walls here.
        OtherMap = "other-map",
        /// Possible moves by chance, four times as many as its path has, up to 400.
        RandomWalk = "random-walk",
        /// Its path from the goal to the start; velocities change their sign.
        Backwards = "backwards",
    }
}

/// The text of the map called `name`, as `env.map` takes it.
///
/// # Errors
/// No such map.
pub fn map_text(name: &str) -> Result<String, GridError> {
    let mut text = None;
    grid::resolve(name, &mut text, 0)?;
    Ok(text.unwrap_or_default())
}

/// A demonstration that is wanted.
#[derive(Clone, Copy, Debug)]
pub struct Wanted<'a> {
    /// Preset or configuration file.
    pub source: &'a str,
    /// Settings upon it, `key=value`, those of the map included.
    pub sets: &'a [String],
    /// The map, as `env.map` has it.
    pub map: &'a str,
    /// What the mentor does.
    pub mentor: Mentor,
    /// Decides what the mentor leaves to chance.
    pub seed: u64,
    /// Number of trajectories, 1 or more.
    pub trajectories: u32,
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
    #[error("the mentor {mentor} in the environment {env}; accepted: planned, short, backwards")]
    NoCells {
        /// What was asked for.
        mentor: Mentor,
        /// The environment.
        env: String,
    },
    /// More trajectories than there is a rule for.
    #[error(
        "{trajectories} trajectories of the mentor {mentor}; accepted: 1, or the mentor planned where states are no cells of a map"
    )]
    Trajectories {
        /// What was asked for.
        trajectories: u32,
        /// See `trajectories`.
        mentor: Mentor,
    },
    /// No other map fits.
    #[error(
        "the mentor other-map on the map {map}; accepted: a generator's map, whose next {MAX_OTHERS} seeds must have one"
    )]
    NoOther {
        /// The map.
        map: String,
    },
}

/// The demonstration that is wanted: a function of `task` alone.
///
/// # Errors
/// One that there cannot be.
pub fn demonstration(task: &Wanted<'_>) -> Result<Demonstration, MentorError> {
    let mut config = config::load(registry(), task.source, task.sets)?;
    registry().resolve(&mut config.env, config.run.seed)?;
    let env = registry().build(&config.env)?;
    let dim = env.spec().obs_dim();
    let names = match &env.features()[..] {
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
        let states = from_elsewhere(task, rng)?;
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
    task: &Wanted<'_>,
    map: &Map,
    set: &ActionSet,
    rng: &mut Stream,
) -> Result<(Vec<Cell>, bool), MentorError> {
    if task.trajectories != 1 {
        return Err(MentorError::Trajectories { trajectories: task.trajectories, mentor: task.mentor });
    }
    let paths = Paths::new(map, set);
    let no_way = || MentorError::NoWay { map: task.map.into(), actions: set.name.clone() };
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
    task: &Wanted<'_>,
    map: &Map,
    set: &ActionSet,
    rng: &mut Stream,
) -> Result<Vec<Cell>, MentorError> {
    let none = || MentorError::NoOther { map: task.map.into() };
    let (generator, rest) = task.map.split_once(':').ok_or_else(none)?;
    let (seed, size) = rest.split_once(':').ok_or_else(none)?;
    let seed: u64 = seed.parse().map_err(|_| none())?;
    for seed in (1..=MAX_OTHERS).filter_map(|more| seed.checked_add(more)) {
        let name = format!("{generator}:{seed}:{size}");
        let other = Map::parse(&name, &map_text(&name)?).map_err(GridError::from)?;
        let Some(path) = Paths::new(&other, set).shortest(Ties::Hugging, rng) else { continue };
        let walls = path.iter().filter(|&&cell| !map.is_free(cell)).count();
        // A path that fits with its axes swapped would be taken for a mistake.
        let swapped = path.iter().all(|&[column, row]| map.is_free([row, column]));
        if walls > 0 && 2 * walls < path.len() && !swapped {
            return Ok(path);
        }
    }
    Err(none())
}

/// What is planned from a free cell that `rng` draws.
fn from_elsewhere(task: &Wanted<'_>, rng: &mut Stream) -> Result<Vec<Vec<f32>>, MentorError> {
    let text = map_text(task.map)?;
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
    let sets: Vec<String> = task.sets.iter().cloned().chain(here).collect();
    let mut config = config::load(registry(), task.source, &sets)?;
    registry().resolve(&mut config.env, config.run.seed)?;
    Ok(registry().plan_states(&config.env, &config.mentor.actions)?)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn made(
        mentor: Mentor,
        source: &str,
        map: &str,
        seed: u64,
        trajectories: u32,
    ) -> Result<Demonstration, String> {
        let sets = [format!("env.map={map}")];
        demonstration(&Wanted { source, sets: &sets, map, mentor, seed, trajectories })
            .map_err(|error| error.to_string())
    }

    fn states(demonstration: &Demonstration) -> Vec<&[f32]> {
        (0..demonstration.n_states()).map(|m| demonstration.state(m)).collect()
    }

    #[test]
    fn bad_mentors_do_what_they_are_called() {
        let of = |mentor, seed| made(mentor, "maze-small", "rooms:5:16x16", seed, 1).unwrap();
        let path = of(Mentor::Hugging, 0);
        assert_eq!(path.names(), ["column", "row"]);
        assert!(path.terminal(0));
        let short = of(Mentor::Short, 0);
        assert_eq!(states(&short), states(&path)[..path.n_states() / 3]);
        let mut back = states(&path);
        back.reverse();
        let backwards = of(Mentor::Backwards, 0);
        assert_eq!(states(&backwards), back);
        let (detour, walk) = (of(Mentor::Detour, 0), of(Mentor::RandomWalk, 0));
        assert!(2 * detour.n_transitions() >= 3 * path.n_transitions(), "{}", detour.n_transitions());
        assert_eq!(walk.n_transitions(), (4 * path.n_transitions()).min(400));
        let leaps = of(Mentor::Leaps, 0);
        assert_eq!((states(&leaps)[0], states(&leaps).last()), (states(&path)[0], states(&path).last()));
        assert_eq!([&short, &backwards, &walk].map(|d| d.terminal(0)), [false; 3]);
        assert_eq!([&detour, &leaps].map(|d| d.terminal(0)), [true; 2]);
        for mentor in [Mentor::Detour, Mentor::Leaps, Mentor::RandomWalk, Mentor::Mixed] {
            assert_eq!(of(mentor, 3), of(mentor, 3));
            assert!((1..9).any(|seed| of(mentor, seed) != of(mentor, 0)), "{mentor}");
        }
        assert_ne!(of(Mentor::OtherMap, 0), path);
    }

    #[test]
    fn a_ball_has_velocities_and_many_starts() {
        let of = |mentor, seed, n| made(mentor, "point-umaze", "serpentine-1:3:6x7", seed, n).unwrap();
        let path = of(Mentor::Planned, 0, 1);
        let backwards = of(Mentor::Backwards, 0, 1);
        let (first, last) = (path.state(path.n_states() - 2), backwards.state(1));
        assert_eq!((first[..2].to_vec(), -first[2], -first[3]), (last[..2].to_vec(), last[2], last[3]));
        let many = of(Mentor::Planned, 7, 4);
        assert_eq!(many.n_trajectories(), 4);
        assert_eq!(many.state(0), path.state(0));
        assert!((1..4).any(|i| many.state(many.trajectory(i).start) != path.state(0)));
        assert!((0..4).all(|i| many.terminal(i)));
        assert_eq!(many, of(Mentor::Planned, 7, 4));
    }

    #[test]
    fn what_there_cannot_be_is_refused() {
        for (found, says) in [
            (
                made(Mentor::Leaps, "point-umaze", "umaze", 0, 1),
                "the mentor leaps in the environment point-maze; accepted: planned",
            ),
            (
                made(Mentor::Hugging, "maze-small", "maze30", 0, 2),
                "2 trajectories of the mentor hugging; accepted: 1",
            ),
            (
                made(Mentor::Planned, "maze-small", "maze30", 0, 2),
                "2 trajectories of the mentor planned; accepted: 1",
            ),
            (made(Mentor::OtherMap, "maze-small", "maze30", 0, 1), "the mentor other-map on the map maze30"),
            (made(Mentor::Free, "maze-small", "corridors-1:1:9x9", 0, 1), "cannot be reached"),
        ] {
            let error = found.unwrap_err();
            assert!(error.contains(says), "{error}");
        }
    }
}
