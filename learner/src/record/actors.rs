//! `actors.csv`: a line for each incarnation of an actor in free mode, with what was counted of it.

use super::error::{RecordError, io};
use serde::{Deserialize, Serialize};
use std::fmt::Write;
use std::io::Write as _;
use std::path::Path;
use trestle_proto::incarnation::Incarnation;
use trestle_proto::run_files::ACTORS_FILE;
use trestle_proto::rundir::{Durable, write_atomically};

const COLUMNS: &str = "actor,incarnation,batches,env_steps,staleness_mean,staleness_max,host";

/// What has been counted of one incarnation.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ActorRow {
    /// Index of the actor.
    pub actor: u32,
    /// Its incarnation.
    pub incarnation: Incarnation,
    /// The name of its host; empty where that is the learner's own.
    pub host: String,
    /// Batches taken in.
    pub batches: u64,
    /// Their transitions that were counted and stored; fewer than the batches have only at the end of the run.
    pub env_steps: u64,
    /// How old the weights were that the batches were collected with, when they were taken in.
    pub staleness: Staleness,
}

/// Ages of weights, in publications: 0 is the newest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Staleness {
    batches: u64,
    sum: u64,
    max: u64,
}

impl Staleness {
    /// Adds a batch.
    pub fn add(&mut self, age: u64) {
        self.batches += 1;
        self.sum = self.sum.saturating_add(age);
        self.max = self.max.max(age);
    }

    /// Mean over the batches; NaN without any.
    pub fn mean(&self) -> f64 {
        self.sum as f64 / self.batches as f64
    }

    /// The oldest; NaN without any batch.
    pub fn max(&self) -> f64 {
        if self.batches > 0 { self.max as f64 } else { f64::NAN }
    }
}

/// Writes `actors.csv` into the run directory `dir`. A reader sees the old file or the new one, never a part.
pub fn write_actors(dir: &Path, rows: &[ActorRow]) -> Result<(), RecordError> {
    let mut text = format!("{COLUMNS}\n");
    for ActorRow { actor, incarnation, host, batches, env_steps, staleness } in rows {
        let _ = write!(text, "{actor},{incarnation},{batches},{env_steps},");
        if *batches > 0 {
            let _ = write!(text, "{:.3},{}", staleness.mean(), staleness.max);
        } else {
            text.push(',');
        }
        let _ = writeln!(text, ",{host}");
    }
    let path = dir.join(ACTORS_FILE);
    // It can be made again from the checkpoint, and a checkpoint does not wait for it.
    write_atomically(&path, Durable::Later, |file| file.write_all(text.as_bytes()))
        .map_err(io("write", &path))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_row_says_what_was_counted() {
        let dir = tempfile::tempdir().unwrap();
        let mut row = ActorRow {
            actor: 1,
            incarnation: Incarnation::new(1, 0),
            batches: 2,
            env_steps: 64,
            host: "b".into(),
            ..ActorRow::default()
        };
        row.staleness.add(1);
        row.staleness.add(4);
        write_actors(dir.path(), &[ActorRow::default(), row]).unwrap();
        assert_eq!(
            std::fs::read_to_string(dir.path().join(ACTORS_FILE)).unwrap(),
            "actor,incarnation,batches,env_steps,staleness_mean,staleness_max,host\n0,0,0,0,,,\n1,65536,2,64,2.500,4,b\n"
        );
        let none = Staleness::default();
        assert!(none.mean().is_nan() && none.max().is_nan());
    }
}
