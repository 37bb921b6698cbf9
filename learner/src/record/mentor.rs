//! `mentor.csv`: a line a mentor transition, with what the run has found out about it and how often it mattered.
//!
//! It holds nothing but what follows from the run's configuration: no times, and the same bytes for equal runs.

use super::error::{RecordError, io};
use std::io::{self as stdio, Write};
use std::path::Path;
use trestle_algorithm::agent::MentorRow;
use trestle_proto::experiment::MentorPart;
use trestle_proto::run_files::MENTOR_FILE;
use trestle_proto::rundir::{Durable, write_atomically};

const COLUMNS: &str =
    "transition,demo,trajectory,step,visited,used,e_kl,a_est,r_est,feasible,bridge_len,a_feas,r_feas";

/// Writes `mentor.csv` into the run directory `dir`. A reader sees the old file or the new one, never a part. `rows`
/// are the transitions of all `parts`, in order.
pub fn write_mentor<'a>(
    dir: &Path,
    parts: &[MentorPart],
    dim: usize,
    rows: impl Iterator<Item = MentorRow<'a>>,
) -> Result<(), RecordError> {
    let path = dir.join(MENTOR_FILE);
    // It can be made again from the checkpoint, and a checkpoint does not wait for it.
    write_atomically(&path, Durable::Later, |file| write_rows(file, parts, dim, rows))
        .map_err(io("write", &path))
}

fn write_rows<'a>(
    file: &mut impl Write,
    parts: &[MentorPart],
    dim: usize,
    rows: impl Iterator<Item = MentorRow<'a>>,
) -> stdio::Result<()> {
    write!(file, "{COLUMNS}")?;
    (0..dim).try_for_each(|feature| write!(file, ",s{feature}"))?;
    writeln!(file)?;
    let demos =
        parts.iter().flat_map(|part| (0..part.transitions).map(|within| (part.name.as_str(), within)));
    let (mut trajectory, mut step) = (0, 0);
    for (transition, ((demo, within), row)) in demos.zip(rows).enumerate() {
        (trajectory, step) = match (within, row.first) {
            (0, _) => (0, 0),
            (_, true) => (trajectory + 1, 0),
            _ => (trajectory, step + 1),
        };
        write!(file, "{transition},{demo},{trajectory},{step},{},{},", row.visited, row.used)?;
        match row.estimate {
            Some(e) => write!(file, "{},{},{},{}", e.e_kl, e.action, e.reward, u8::from(row.feasible))?,
            None => write!(file, ",,,")?,
        }
        match row.bridge {
            Some(b) => write!(file, ",{},{},{}", b.length, b.action, b.reward)?,
            None => write!(file, ",,,")?,
        }
        row.state.iter().try_for_each(|x| write!(file, ",{x}"))?;
        writeln!(file)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use trestle_proto::annotation::{Bridge, Estimate};

    #[test]
    fn a_line_a_transition_with_blanks_for_what_is_unknown() {
        let dir = tempfile::tempdir().unwrap();
        let part = |name: &str, transitions| MentorPart { name: name.into(), transitions };
        let state = [0.5, -1.0];
        let unknown = MentorRow {
            state: &state,
            first: false,
            visited: 0,
            used: 0,
            estimate: None,
            feasible: false,
            bridge: None,
        };
        let estimate = Some(Estimate { action: 3, e_kl: 0.25, start_kl: 0.0, reward: -0.04 });
        let bridge = Some(Bridge {
            action: 1,
            length: 2,
            reward: 1.0,
            end_kl: 0.0,
            next_obs: &state,
            terminated: false,
            ahead: 2,
        });
        let rows = [
            MentorRow { first: true, ..unknown },
            MentorRow { visited: 7, used: 2, estimate, feasible: true, ..unknown },
            MentorRow { first: true, estimate, bridge, ..unknown },
            MentorRow { bridge, ..unknown },
        ];
        write_mentor(dir.path(), &[part("a", 3), part("b", 1)], 2, rows.into_iter()).unwrap();
        let text = std::fs::read_to_string(dir.path().join(MENTOR_FILE)).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], format!("{COLUMNS},s0,s1"));
        assert_eq!(lines[1], "0,a,0,0,0,0,,,,,,,,0.5,-1");
        assert_eq!(lines[2], "1,a,0,1,7,2,0.25,3,-0.04,1,,,,0.5,-1");
        assert_eq!(lines[3], "2,a,1,0,0,0,0.25,3,-0.04,0,2,1,1,0.5,-1");
        assert_eq!(lines[4], "3,b,0,0,0,0,,,,,2,1,1,0.5,-1");
        assert!(lines.iter().all(|line| line.split(',').count() == 15), "{text}");
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "no temporary file is left");
    }
}
