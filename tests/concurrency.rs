//! Runs share a host without noticing each other.

use crate::util::{Place, Trace, assert_gone, start};

fn args(seed: &str) -> Vec<&str> {
    vec!["maze-small", "--env-steps", "6000", "--seed", seed]
}

fn at_once(seeds: &[&str]) {
    let place = Place::new();
    let name = |how: &str, seed: &str| format!("{how}-{seed}");
    let runs: Vec<_> =
        seeds.iter().map(|seed| start(&place.training(&name("together", seed), &args(seed)))).collect();
    for run in runs {
        run.finish().ok();
    }
    for seed in seeds {
        let dir = place.run(&name("together", seed));
        assert_gone(&dir);
        assert_eq!(Trace::of(&dir), place.train(&name("alone", seed), &args(seed)), "seed {seed}");
    }
}

#[test]
fn two_at_once() {
    at_once(&["1", "2"]);
}

#[test]
fn six_at_once() {
    at_once(&["1", "2", "3", "4", "5", "6"]);
}
