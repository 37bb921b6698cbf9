//! Faults at length: `cargo test --test faults -- --mode lockstep --seed 1 --faults 200 --kinds kill,shm,slow`. Any of the
//! arguments may be left out. Prints a line a run, and the time of recovery after a kill; fails at the first run that does
//! not end as it should. Not part of `cargo test` unless it is named.

#![allow(clippy::unwrap_used)]

mod client;
mod room;
mod schedule;
// It serves many tests; this one needs a part of it.
#[allow(dead_code)]
mod util;

use schedule::{KINDS, Kind};
use trestle_proto::config::Mode;

fn main() {
    client::be_one();
    let (mut mode, mut seed, mut faults, mut kinds) = (Mode::Lockstep, 1, 200, KINDS.to_vec());
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let value = args.next().unwrap_or_else(|| panic!("{arg} needs a value"));
        match arg.as_str() {
            "--mode" => {
                mode = match value.as_str() {
                    "lockstep" => Mode::Lockstep,
                    "free" => Mode::Free,
                    _ => panic!("unknown mode {value}; accepted: lockstep, free"),
                }
            }
            "--seed" => seed = value.parse().unwrap(),
            "--faults" => faults = value.parse().unwrap(),
            "--kinds" => kinds = value.split(',').map(kind).collect(),
            _ => panic!("unknown argument {arg}; accepted: --mode, --seed, --faults, --kinds"),
        }
    }
    let summary = schedule::play(mode, seed, faults, &kinds, |line| println!("{line}"));
    let mut recoveries = summary.recoveries.clone();
    recoveries.sort();
    // The time within which the share `q` of the recoveries lies.
    let within = |q: f64| {
        let at = (q * recoveries.len() as f64).ceil() as usize;
        recoveries.get(at.saturating_sub(1)).map_or(0, std::time::Duration::as_millis)
    };
    println!("{} faults in {} runs, all of which ended as they should", summary.faults, summary.runs);
    if !recoveries.is_empty() {
        let (median, p99) = (within(0.5), within(0.99));
        println!("recovery after {} kills: median {median} ms, p99 {p99} ms", recoveries.len());
    }
    if summary.doubles > 0 {
        println!("{} of them took the supervisor within 50 ms as well", summary.doubles);
    }
    if summary.ends > 0 || summary.clients > 0 {
        println!(
            "{} runs ended for want of room and went on later; {} clients",
            summary.ends, summary.clients
        );
    }
}

fn kind(name: &str) -> Kind {
    let found = KINDS.into_iter().find(|kind| format!("{kind:?}").eq_ignore_ascii_case(name));
    found.unwrap_or_else(|| panic!("unknown kind {name}; accepted: {KINDS:?}"))
}
