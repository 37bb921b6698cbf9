//! A host without Python, for the tests of this crate, and what an environment does beside the conformance tests.
#![allow(clippy::unwrap_used)]

use super::*;
use crate::env::Registry;
use trestle_proto::rng::{Purpose, mix, stream};

pub(super) const HOST: Host = Host { make };

/// A walk on a line of 21 places that begins somewhere and drifts, both by the seed. With the argument `moody` each instance
/// of it drifts in its own way.
struct Walk {
    at: f32,
    drift: u64,
    mood: u64,
}

fn make(settings: &Settings, found: &Found) -> Result<Box<dyn Simulator>, GymError> {
    assert_eq!(found.actions.names.len(), 2);
    static MADE: std::sync::atomic::AtomicU64 = std::sync::atomic::AtomicU64::new(0);
    let made = MADE.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
    let mood = if settings.kwargs.0.contains_key("moody") { made } else { 0 };
    Ok(Box::new(Walk { at: 0.0, drift: 0, mood }))
}

impl Simulator for Walk {
    fn reset(&mut self, seed: u32, obs: &mut [f32]) -> Result<(), GymError> {
        self.drift = mix(u64::from(seed) ^ self.mood);
        self.at = (self.drift % 5) as f32 - 2.0;
        obs[0] = self.at;
        Ok(())
    }

    fn step(&mut self, action: usize, obs: &mut [f32]) -> Result<Outcome, GymError> {
        self.drift = mix(self.drift);
        self.at += if action == 0 { -1.0 } else { 1.0 } + (self.drift % 3) as f32 - 1.0;
        self.at = self.at.clamp(-10.0, 10.0);
        obs[0] = self.at;
        let over = self.at.abs() >= 10.0;
        Ok(Outcome { reward: -self.at, terminated: over, truncated: false, success: over && self.at < 0.0 })
    }
}

/// The settings of a walk with `sets`, resolved.
fn walk(sets: &[&str]) -> config::Env {
    let found: Table = include_str!("conformance.toml").parse().unwrap();
    let own = found["walk"].as_array().unwrap().iter().map(|set| set.as_str().unwrap().to_string());
    let sets: Vec<String> = own.chain(sets.iter().map(ToString::to_string)).collect();
    let all = ["env.name=gym".to_string(), "run.episodes=1".into()].into_iter().chain(sets);
    config::from_table(&Registry::builtin(), Table::new(), &all.collect::<Vec<_>>()).unwrap().env
}

#[test]
fn an_episode_that_cannot_be_repeated_is_refused() {
    let env = walk(&["env.gym.kwargs.moody=true"]);
    let build = || Registry::builtin().build(&env).unwrap();
    let (mut first, mut second, mut obs) = (build(), build(), [0.0]);
    first.reset(&mut stream(1, Purpose::Environment, 0), &mut obs).unwrap();
    (0..5).for_each(|_| _ = first.step(0, &mut obs));
    second.reset(&mut stream(1, Purpose::Environment, 0), &mut obs).unwrap();
    let error = second.restore(&first.snapshot().unwrap()).unwrap_err().to_string();
    assert!(error.starts_with("walk does not repeat its episodes: with seed "), "{error}");
    assert!(error.contains("the same 5 actions"), "{error}");
    assert!(second.step(0, &mut obs).is_err(), "there is no episode left");
    assert!(first.repeats());
    assert!(!Registry::builtin().build(&walk(&["env.gym.nondeterministic=true"])).unwrap().repeats());
}

#[test]
fn the_step_limit_cuts_an_episode_off() {
    let mut env = Registry::builtin().build(&walk(&["env.step_limit=2"])).unwrap();
    let mut obs = [0.0];
    env.reset(&mut stream(1, Purpose::Environment, 0), &mut obs).unwrap();
    let steps = [0, 1].map(|action| env.step(action, &mut obs).unwrap().truncated);
    assert_eq!(steps, [false, true]);
}

#[test]
fn success_counts_where_the_environment_was_found_to_tell_it() {
    let mut settings = walk(&[]);
    let found = settings.own["found"].as_str().unwrap().trim_end().strip_suffix('}').unwrap().to_string();
    for (tells, ends) in [(false, [false, false]), (true, [true, false])] {
        settings.own.insert("found".into(), format!("{found},\"success\":{tells}}}").into());
        let mut env = Registry::builtin().build(&settings).unwrap();
        assert_eq!(env.spec().defines_success, tells);
        let mut obs = [0.0];
        let succeeded = [0, 1].map(|action| {
            env.reset(&mut stream(1, Purpose::Environment, 0), &mut obs).unwrap();
            let steps = std::iter::from_fn(|| Some(env.step(action, &mut obs).unwrap()));
            let last = steps.take(200).find(|step| step.terminated).unwrap();
            last.success
        });
        assert_eq!(succeeded, ends, "left and right");
    }
}

#[test]
fn a_demonstration_may_leave_the_range_of_the_network_and_not_the_space() {
    let env = Registry::builtin().build(&walk(&[])).unwrap();
    assert_eq!(env.can_be_in(&[30.0]), Ok(()));
    assert!(env.can_be_in(&[31.0]).is_err());
    assert_eq!(env.spec().high, [20.0]);
    assert_eq!(env.features(), ["at"]);
}

#[test]
fn an_environment_is_named_once_and_by_its_short_form() {
    let registry = Registry::builtin();
    let load = |name: &str, sets: &[&str]| {
        let sets: Vec<String> = sets.iter().map(ToString::to_string).collect();
        config::load(&registry, name, &sets).map(|config| config.env)
    };
    let algo = |sets: &[&str]| {
        let sets: Vec<String> = sets.iter().map(ToString::to_string).collect();
        config::load(&registry, "gym", &sets).unwrap().run.algo
    };
    assert_eq!([algo(&[]), algo(&["run.algo=dqn"])], [config::Algo::Trestle, config::Algo::Dqn]);
    let env = load("gym:pkg:Cart-v1", &["env.gym.kwargs.force=5.0", "env.kwargs.mass=2"]).unwrap();
    assert_eq!((env.name.as_str(), env.own["id"].as_str()), ("gym", Some("pkg:Cart-v1")));
    assert_eq!(env.own["kwargs"].as_table().unwrap().len(), 2);
    let resolve =
        |sets: &[&str]| registry.resolve(&mut load("gym", sets).unwrap(), 0).unwrap_err().to_string();
    assert!(resolve(&[]).starts_with("env.gym.id = \"\"; accepted: an id such as CartPole-v1"));
    assert!(resolve(&["env.gym.id=A-v0", "env.gym.make=a:b"]).starts_with("env.gym.id = A-v0; accepted"));
    let refused = |set: &str| load("gym:A-v0", &[set]).unwrap_err().to_string();
    assert!(refused("env.gym.scale=[1.0, 0.0]").starts_with("env.gym.scale = 0"));
    assert!(refused("env.gym.bins=[1]").starts_with("env.gym.bins = 1; accepted: numbers from 2 to 1024"));
    assert!(refused("env.gym.actions=[1.5]").contains("a list of numbers or names of actions"));
    let misspelt = "env.gym.kwarg: there is no such setting; did you mean `env.gym.kwargs`?";
    assert_eq!(refused("env.gym.kwarg.body=x"), misspelt);
    assert!(refused("env.gym.kwargs=3").contains("a table of arguments by name"));
}

/// What the process that looks at an environment may do.
#[test]
fn a_probe_that_fails_is_told_with_its_last_words() {
    let probe = |script: &str| {
        let command = ["sh", "-c", script].map(String::from);
        let settings = Settings { probe_s: 1, ..Settings::default() };
        probe::probe(&command, &settings, 10, 0).unwrap_err().to_string()
    };
    let died = probe("echo 'ModuleNotFoundError: no x' >&2; exit 3");
    assert!(died.contains("exit status: 3; it said:\nModuleNotFoundError: no x"), "{died}");
    assert!(probe("kill -SEGV $$").contains("signal: 11"));
    assert_eq!(probe("echo '{\"refused\": \"no such space\"}'; sleep 100"), "no such space");
    let other = probe("echo '{\"other\": {\"version\": \"9.9.9\", \"build\": \"abc\"}}'");
    assert!(other.contains("sh has trestle 9.9.9, build abc, but this is "), "{other}");
    assert!(
        probe("echo at it >&2; sleep 100 & wait")
            .contains("more than 1 s (env.gym.probe_s); it said:\nat it")
    );
    assert!(probe("echo nonsense").starts_with("env.gym.found: "));
    let flood = probe("yes boom >&2 & sleep 0.2; kill $!; exit 1");
    assert!(flood.len() < 3000 && flood.contains("boom"), "{}", flood.len());
    let absent = probe::probe(&["/no/such/python".to_string()], &Settings::default(), 10, 0);
    assert!(absent.unwrap_err().to_string().contains("cannot start /no/such/python"));
}
