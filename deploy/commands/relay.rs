//! `trestle relay`: the process of a run that speaks to other hosts, on either side.

use super::role::{Ordered, Start};
use crate::build_info::BUILD;
use crate::carrier;
use crate::cli::RelayRole;
use crate::output::say;
use crate::prepare::draw;
use crate::status::{ExitCode, LOST_HOST, LOST_PEER, TOLD};
use crate::supervise::{FAREWELL, GRANTED, HOST};
use anyhow::{Context, Result, ensure};
use std::env;
use std::fs;
use std::io::{Write, stdout};
use std::path::Path;
use std::time::Duration;
use trestle_hosts::head::News;
use trestle_hosts::joined::{self, Answer, Ended};
use trestle_hosts::message::{Grant, Hello};
use trestle_hosts::wire::{Program, WireError};
use trestle_hosts::{RelayError, head};
use trestle_learner::checkpoint;
use trestle_proto::config::Mode;
use trestle_proto::plan::{Life, RunPlan};
use trestle_proto::regular_file;
use trestle_proto::rundir::{Durable, RunDir, write_atomically};

/// What `trestle-relay` logs on a host that joins, unless `RUST_LOG` says otherwise: Zenoh gives the reason why there is no
/// connection at the level DEBUG.
const FILTER: (&str, &str) = ("RUST_LOG", "warn,zenoh::net::runtime::orchestrator=debug");
/// Largest file of a checkpoint that is sent to another host, bytes.
const MAX_FILE: u64 = 1 << 30;

/// A line for the supervisor, which may be gone.
fn tell(line: &str) {
    let mut out = stdout().lock();
    let _ = writeln!(out, "{}", line.replace('\n', " "));
    let _ = out.flush();
}

/// News for the supervisor.
fn tell_news(news: News<'_>) {
    match news {
        News::Words(text) => tell(text),
        News::Host(row) => match serde_json::to_string(&row) {
            Ok(row) => tell(&format!("{HOST}{row}")),
            Err(error) => tracing::warn!("{error}"),
        },
    }
}

pub(super) fn run(args: &RelayRole) -> Result<ExitCode> {
    match args {
        RelayRole::Head { role, first, listen, network, replacements } => {
            let start = Start::new(role, "relay")?;
            let plan = &start.plan;
            let actors = plan.experiment.config.run.actors;
            ensure!(*first < actors, "--first {first}; accepted: less than {actors} (run.actors)");
            let mut program = carrier::command()?;
            program.arg("listen").arg(listen).args(carrier::options(network));
            let mut wire = Program::start(program)?;
            let options = head::Options {
                build: BUILD.into(),
                session: draw()?,
                actors: *first..actors,
                silence: Duration::from_secs(network.host_silence.into()),
                replacements: *replacements,
                files: files(&start.dir, plan)?,
            };
            ended(head::run(&mut wire, plan, &options, &start.stop(), &mut tell_news).map(|()| TOLD))
        }
        RelayRole::Joined { role, url, identity, actors, name, network, wait } => {
            let dir = RunDir::new(&role.run);
            let ordered = Ordered::new(role, "relay", *identity)?;
            let mut program = carrier::command()?;
            // Never u64::MAX, which is no peer.
            let id = draw()? >> 1;
            program.arg("connect").arg(url).arg(format!("{id:016x}")).args(carrier::options(network));
            let (variable, filter) = FILTER;
            if env::var_os(variable).is_none() {
                program.env(variable, filter);
            }
            let mut wire = Program::start(program)?;
            let options = joined::Options {
                hello: Hello { build: BUILD.into(), name: name.clone(), actors: *actors },
                silence: Duration::from_secs(network.host_silence.into()),
                patience: Duration::from_secs((*wait).into()),
            };
            let stop = ordered.stop();
            let (mut joined, grant) = match joined::join(&mut wire, &options, &stop, &mut tell) {
                Ok(Answer::In(joined, grant)) => (joined, grant),
                Ok(Answer::Over(reason)) => {
                    tell(&reason);
                    return Ok(ExitCode::SUCCESS);
                }
                Ok(Answer::Told) => return Ok(ExitCode::from(TOLD)),
                Err(error) => return ended(Err(error)),
            };
            let plan = RunPlan::decode(&grant.plan)?;
            let here = unpack(&dir, &plan, *identity, &grant)?;
            let seats: Vec<String> =
                grant.seats.iter().map(|seat| format!("{}:{}", seat.actor, seat.incarnation)).collect();
            tell(&format!("{GRANTED}{}", seats.join(" ")));
            let reason =
                || fs::read_to_string(dir.root().join(FAREWELL)).unwrap_or_else(|_| "told to leave".into());
            let end = match joined.idle(&mut wire, &ordered.go(), &stop, &reason) {
                Err(error) => return ended(Err(error)),
                Ok(Some(end)) => end,
                Ok(None) => {
                    let actors: Vec<u32> = grant.seats.iter().map(|seat| seat.actor).collect();
                    match joined.serve(&mut wire, &here, plan.life.run, &actors, &stop, &reason) {
                        Ok(end) => end,
                        Err(error) => return ended(Err(error)),
                    }
                }
            };
            match end {
                Ended::Over(reason) => {
                    tell(&reason);
                    Ok(ExitCode::SUCCESS)
                }
                Ended::Session(reason) => ended(Err(RelayError::Lost(reason))),
                Ended::Told => Ok(ExitCode::from(TOLD)),
            }
        }
    }
}

/// The exit status of a relay: an end for which it is not to blame has a status of its own.
fn ended(result: Result<u8, RelayError>) -> Result<ExitCode> {
    match result {
        Ok(status) => Ok(ExitCode::from(status)),
        Err(RelayError::Lost(reason)) => {
            say(&format!("error: {reason}"));
            Ok(ExitCode::from(LOST_HOST))
        }
        Err(RelayError::Link(error)) if error.is_lost_peer() => {
            say(&format!("error: {error}"));
            Ok(ExitCode::from(LOST_PEER))
        }
        // Another one may do better.
        Err(RelayError::Wire(error @ WireError::Gone)) => {
            say(&format!("error: {error}"));
            Ok(ExitCode::from(LOST_PEER))
        }
        Err(error) => Err(error.into()),
    }
}

/// The files that actors read when the run of `plan` goes on.
fn files(dir: &RunDir, plan: &RunPlan) -> Result<Vec<(String, Vec<u8>)>> {
    let Some(tick) = plan.life.resume_tick.filter(|_| plan.experiment.config.run.mode != Mode::Free) else {
        return Ok(Vec::new());
    };
    let dir = checkpoint::directory(dir.root(), tick);
    let read = |name: &&str| Ok(((*name).into(), regular_file::read(&dir.join(name), MAX_FILE)?));
    checkpoint::FOR_ACTORS.iter().map(read).collect()
}

/// Writes what the head has sent into the directory of this host, and returns this host's plan: that of the head, under another identity.
fn unpack(dir: &RunDir, plan: &RunPlan, identity: u64, grant: &Grant) -> Result<RunPlan> {
    let save = |path: &Path, bytes: &[u8]| {
        write_atomically(path, Durable::Later, |file| file.write_all(bytes))
            .with_context(|| format!("cannot write {}", path.display()))
    };
    if let Some(tick) = plan.life.resume_tick {
        let place = checkpoint::directory(dir.root(), tick);
        fs::create_dir_all(&place).with_context(|| format!("cannot make {}", place.display()))?;
        // A file of any other name is not written.
        for (name, bytes) in
            grant.files.iter().filter(|(name, _)| checkpoint::FOR_ACTORS.contains(&name.as_str()))
        {
            save(&place.join(name), bytes)?;
        }
    }
    let here = RunPlan { life: Life { run: identity, ..plan.life }, experiment: plan.experiment.clone() };
    save(&dir.plan(), &here.encode()?)?;
    Ok(here)
}
