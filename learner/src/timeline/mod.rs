//! `timeline.jsonl`: moments of a run for the pictures of its page, in bounded size.
//!
//! The first line says what stays the same, each later one what the run knew and did at one moment: the findings about each
//! mentor transition, where the agent has been, its values and greedy actions, and the path of its newest evaluation.
//! (docs/run-directory.md has the keys.)
//!
//! A run writes at most [`MOST`] moments. When there are as many, every second one goes and the pauses double, so that the
//! whole run is covered evenly. A pause is also at least [`REST`] times as long as a moment took to make: it costs next to
//! nothing. The clock paces the moments; nothing of them flows back into training, and a file that cannot be written costs
//! the pictures and not the run.

mod moment;
mod squares;
mod visits;
mod way;

use crate::record::RecordError;
use moment::{Findings, Head, Moment, stride};
use squares::Squares;
use std::collections::VecDeque;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use trestle_algorithm::agent::{Agent, Counters};
use trestle_algorithm::replay::Replay;
use trestle_proto::NONE;
use trestle_proto::experiment::Experiment;
use trestle_proto::map_file::{MAX_MAP_BYTES, MapFile};
use trestle_proto::mentor::MentorTransitions;
use trestle_proto::own_file;
use trestle_proto::regular_file;
use trestle_proto::rundir::{Durable, RunDir, write_atomically};
use visits::Visits;
use way::Way;

/// Moments that are kept, at most.
pub(crate) const MOST: usize = 128;
/// Newest transitions that are looked at between two moments, at most. Visits before them count next to nothing.
const NEWEST: u64 = 25_000;
/// Environment steps from one state that a moment tells of to the next, where there is no map.
const APART: u64 = 20;
/// Least time between two moments.
const EVERY: Duration = Duration::from_millis(250);
/// How many times as long as it took to make a moment the pause after it is, at least.
const REST: u32 = 200;
/// Largest timeline that is gone on with, bytes.
const MAX_BYTES: u64 = 256 << 20;

/// The open timeline of a run.
#[derive(Debug)]
pub(crate) struct Timeline {
    path: PathBuf,
    head: Head,
    squares: Option<Squares>,
    /// Where there is no map.
    visits: Option<Visits>,
    findings: Findings,
    /// With learned bridges.
    way: Option<Way>,
    /// The places, or states, of the newest evaluation's first episode.
    path_taken: Vec<f64>,
    /// Whether a moment has told of it.
    told: bool,
    /// Environment steps and lines of the moments that are kept.
    kept: VecDeque<u64>,
    /// Pause between moments.
    every: Duration,
    due: Instant,
    /// Whether the file could not be written.
    broken: bool,
}

impl Timeline {
    /// For a run from its beginning, in the place of a former file.
    pub(crate) fn create(experiment: &Experiment, dir: &RunDir, mentor: Option<&MentorTransitions>) -> Self {
        let mut timeline = Self::new(experiment, dir, mentor);
        let begun = own_file::create(&timeline.path)
            .and_then(|mut file| file.write_all(timeline.head.line().as_bytes()));
        timeline.note(begun);
        timeline
    }

    /// For a run that goes on after `counters`: later moments go.
    pub(crate) fn resume(
        experiment: &Experiment,
        dir: &RunDir,
        mentor: Option<&MentorTransitions>,
        counters: Counters,
    ) -> Self {
        let mut timeline = Self::new(experiment, dir, mentor);
        let former = lines(&timeline.path).unwrap_or_default();
        let mut moments: Vec<(u64, String)> = Vec::new();
        let mut seconds = 0.0;
        for line in former.into_iter().skip(1) {
            let Ok(moment) = serde_json::from_str::<Moment>(&line) else { break };
            if moment.env_steps > counters.env_steps || moments.len() == MOST {
                break;
            }
            timeline.findings.take_over(&moment);
            seconds = moment.wall_s;
            moments.push((moment.env_steps, line));
        }
        if let Some(pauses) = moments.len().checked_sub(1).filter(|&pauses| pauses > 0) {
            let pause = Duration::try_from_secs_f64(seconds / pauses as f64).unwrap_or(EVERY);
            timeline.every = pause.max(EVERY);
        }
        let kept = moments.iter().map(|(_, line)| line.as_str());
        let written = timeline.write_all(kept);
        timeline.note(written);
        timeline.kept = moments.iter().map(|(env_steps, _)| *env_steps).collect();
        timeline
    }

    fn new(experiment: &Experiment, dir: &RunDir, mentor: Option<&MentorTransitions>) -> Self {
        let map = match map_of(experiment, dir) {
            Ok(map) => map,
            Err(fault) => {
                tracing::warn!("no map in the timeline: {fault}");
                None
            }
        };
        let squares = map.as_ref().and_then(|map| Squares::new(map, experiment));
        let visits = map.is_none().then(Visits::default);
        Self {
            path: dir.timeline(),
            findings: Findings::new(mentor.map_or(0, MentorTransitions::len)),
            head: Head::new(experiment, map, squares.as_ref(), mentor),
            squares,
            visits,
            way: if mentor.is_none() {
                Way::new(experiment, stride(steps(experiment).count()))
            } else {
                None
            },
            path_taken: Vec::new(),
            told: true,
            kept: VecDeque::new(),
            every: EVERY,
            due: Instant::now(),
            broken: false,
        }
    }

    /// Whether it is time for a moment. Reads the clock: ask once a tick.
    pub(crate) fn due(&self) -> bool {
        !self.broken && Instant::now() >= self.due
    }

    /// The states of an evaluation's first episode, one after the other.
    pub(crate) fn evaluation(&mut self, path: &[f32]) {
        self.path_taken = self.head.points(path);
        self.told = false;
    }

    /// Adds the moment that `agent` is in after `wall_s` seconds.
    pub(crate) fn add(&mut self, agent: &Agent, wall_s: f64) {
        let start = Instant::now();
        if self.broken || (self.told && self.kept.back() == Some(&agent.counters().env_steps)) {
            return;
        }
        let squares = self.squares.as_mut().map(|squares| squares.look(agent));
        let mut moment = self.findings.moment(agent, wall_s, squares, &self.path_taken);
        if let Some(visits) = &mut self.visits {
            moment.states = visits.look(agent, &self.head);
        }
        if let Some(way) = &mut self.way {
            way.tell(agent, &mut moment);
        }
        let written = self.write(&moment);
        self.note(written);
        self.told = true;
        self.due = Instant::now() + self.every.max(start.elapsed() * REST);
    }

    fn write(&mut self, moment: &Moment) -> io::Result<()> {
        if self.kept.len() == MOST {
            let former = lines(&self.path)?;
            let mut at = 0;
            self.kept.retain(|_| {
                at += 1;
                at % 2 == 1
            });
            self.every *= 2;
            self.write_all(former.iter().skip(1).step_by(2).map(String::as_str))?;
        }
        let line = serde_json::to_string(moment)? + "\n";
        own_file::append(&self.path)?.write_all(line.as_bytes())?;
        self.kept.push_back(moment.env_steps);
        Ok(())
    }

    /// Puts the head and these moments in the place of the file.
    fn write_all<'a>(&self, mut moments: impl Iterator<Item = &'a str>) -> io::Result<()> {
        write_atomically(&self.path, Durable::Later, |file| {
            file.write_all(self.head.line().as_bytes())?;
            moments.try_for_each(|line| writeln!(file, "{line}"))
        })
    }

    fn note(&mut self, outcome: io::Result<()>) {
        if let Err(source) = outcome {
            self.broken = true;
            let error = RecordError::Io { action: "write", path: self.path.clone(), source };
            tracing::warn!("the run goes on without moments for its page: {error}");
        }
    }
}

/// The map in the run's directory, if its environment has one.
fn map_of(experiment: &Experiment, dir: &RunDir) -> Result<Option<MapFile>, String> {
    let bytes = match regular_file::read(&dir.map(), MAX_MAP_BYTES) {
        Err(error) if error.is_not_found() => return Ok(None),
        bytes => bytes.map_err(|error| error.to_string())?,
    };
    let map: MapFile = serde_json::from_slice(&bytes).map_err(|error| format!("map.json: {error}"))?;
    map.check(experiment.spec.obs_dim()).map_err(|error| error.to_string())?;
    Ok(Some(map))
}

/// The whole lines of the file at `path`.
fn lines(path: &Path) -> io::Result<Vec<String>> {
    let mut reader = BufReader::new(own_file::change(path)?.take(MAX_BYTES));
    let mut lines = Vec::new();
    loop {
        let mut line = String::new();
        reader.read_line(&mut line)?;
        if line.pop() != Some('\n') {
            return Ok(lines);
        }
        lines.push(line);
    }
}

/// The numbers of the stored transitions that are still to be looked at when those before `counted` have been.
fn uncounted(replay: &Replay, counted: u64) -> Range<u64> {
    let next = replay.next_index();
    counted.max(replay.first_index()).max(next.saturating_sub(NEWEST))..next
}

/// The mentor states of `experiment`'s waypoints that begin a step; none without waypoints.
fn steps(experiment: &Experiment) -> impl Iterator<Item = usize> {
    let of = experiment.waypoints.iter().flat_map(|waypoints| waypoints.transition_of.iter().enumerate());
    of.filter(|(_, transition)| **transition != NONE).map(|(m, _)| m)
}

#[cfg(test)]
mod tests;
