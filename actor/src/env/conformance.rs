//! What every environment must fulfil, written once and run over all of them.
#![allow(clippy::unwrap_used)]

use super::{EnvError, Environment, Step, registry};
use rand::Rng;
use trestle_proto::config::{self, Environments, Table};
use trestle_proto::rng::{Purpose, Stream, stream};

/// Configurations of the registered environments: their defaults, their presets, and those in `conformance.toml` of an
/// environment's folder. Step limits make episodes end both ways.
fn all() -> Vec<config::Env> {
    let load = |table: &str, sets: &[String]| {
        let table: Table = table.parse().unwrap();
        let sets: Vec<String> = sets.iter().cloned().chain(["run.episodes=1".into()]).collect();
        config::from_table(registry(), table, &sets).unwrap().env
    };
    let of = |name: &str| -> Vec<config::Env> {
        let more: Table = match std::fs::read_to_string(format!(
            "{}/src/env/{}/conformance.toml",
            env!("CARGO_MANIFEST_DIR"),
            name.replace('-', "_")
        )) {
            Ok(text) => text.parse().unwrap(),
            Err(_) => Table::new(),
        };
        let chosen = format!("env.name={name}");
        let default = load("", &[chosen.clone(), "env.step_limit=300".into()]);
        let more = more.values().map(|sets| {
            let sets = sets.as_array().unwrap().iter().map(|set| set.as_str().unwrap().to_string());
            load("", &std::iter::once(chosen.clone()).chain(sets).collect::<Vec<_>>())
        });
        std::iter::once(default).chain(more).collect()
    };
    let presets =
        registry().presets().into_iter().map(|preset| load(preset.text, &["env.step_limit=300".into()]));
    let mut all: Vec<config::Env> = presets.chain(registry().names().into_iter().flat_map(of)).collect();
    // A configuration may need what this machine has not, such as a library.
    all.retain_mut(|env| match registry().resolve(env, 0) {
        Ok(()) => true,
        Err(error) => {
            println!("skipped: {} {:?}: {error}", env.name, env.own);
            false
        }
    });
    for name in registry().names() {
        assert!(all.iter().any(|env| env.name == name), "{name} has a configuration");
    }
    all
}

#[test]
fn settings_survive_their_table_and_are_found_again() {
    for env in all() {
        let config = config::Config { env: env.clone(), ..config::Config::default() };
        let again =
            config::Config { run: config::Run { episodes: Some(1), ..config::Run::default() }, ..config };
        let text = config::to_toml(&again);
        assert_eq!(config::parse_toml("again", &text).unwrap(), again, "{text}");
        // Resolved once more nothing changes, and what is typed anew takes over what was filled in.
        let mut resolved = env.clone();
        registry().resolve(&mut resolved, 0).unwrap();
        assert_eq!(resolved, env);
        registry().adopt(&mut resolved, &env).unwrap();
        assert_eq!(resolved, env);
        let declared = registry().declared(&env.name);
        assert!(declared.iter().all(|setting| setting.key.starts_with(&format!("env.{}.", env.name))));
        assert!(declared.iter().all(|setting| !config::SHARED.contains(&setting.name())), "{}", env.name);
    }
}

#[test]
fn a_mistake_in_an_environment_s_table_is_named() {
    for name in registry().names() {
        let given = Table::from_iter([("no-such-setting".to_string(), 1.into())]);
        let error = registry().complete(name, given).unwrap_err().to_string();
        assert!(error.starts_with("env."), "{error}");
        assert!(error.contains("no-such-setting: there is no such setting"), "{error}");
    }
    let stranger = config::Env { name: "mase".into(), ..config::Env::default() };
    let error = registry().build(&stranger).err().unwrap().to_string();
    assert!(error.starts_with("env.name = mase; accepted: maze, point-maze"), "{error}");
    assert!(error.ends_with("did you mean `maze`?"), "{error}");
}

#[test]
fn pictures_and_plans_agree_with_the_spaces() {
    for env in all() {
        let built = registry().build(&env).unwrap();
        let dim = built.spec().obs_dim();
        let mut obs = vec![0.0; dim];
        let mut built = built;
        built.reset(&mut stream(1, Purpose::Environment, 0), &mut obs).unwrap();
        let path: Vec<f32> = obs.clone();
        if let Some(ground) = registry().ground(&env).unwrap() {
            let [columns, rows] = ground.size();
            assert!([1, 2, 4].contains(&ground.squares()) && columns * rows > 0);
            let inside = |[column, row]: [f64; 2]| {
                (-0.5..columns as f64 - 0.5).contains(&column) && (-0.5..rows as f64 - 0.5).contains(&row)
            };
            assert!(ground.ends().into_iter().chain(ground.places(&path)).all(inside));
            // States and places belong together.
            let cells = (0..rows).flat_map(|row| (0..columns).map(move |column| [column, row]));
            for cell in cells.filter(|&cell| ground.is_free(cell)).take(50) {
                let place = cell.map(|coordinate| coordinate as f64);
                let state = ground.state(place);
                assert_eq!(state.len(), dim);
                let found = ground.places(&state);
                assert!((0..2).all(|i| (found[0][i] - place[i]).abs() < 1e-5), "{} {found:?}", env.name);
            }
        }
        let drawn = registry().draw(&env, &[(&path, 'x')]).unwrap();
        assert!(drawn.is_none_or(|text| text.lines().count() > 1));
    }
}

/// One step of a random walk that resets where an episode ends: what a collector sees.
fn walk(env: &mut dyn Environment, rng: &mut Stream, obs: &mut [f32]) -> (u32, Step, Vec<f32>) {
    let action = rng.random_range(0..env.spec().n_actions() as u32);
    let step = env.step(action, obs).unwrap();
    let reached = obs.to_vec();
    if step.terminated || step.truncated {
        env.reset(rng, obs).unwrap();
    }
    (action, step, reached)
}

fn started(config: &config::Env, seed: u64) -> (Box<dyn Environment>, Stream, Vec<f32>) {
    let mut env = registry().build(config).unwrap();
    let mut rng = stream(seed, Purpose::Environment, 0);
    let mut obs = vec![f32::NAN; env.spec().obs_dim()];
    env.reset(&mut rng, &mut obs).unwrap();
    (env, rng, obs)
}

#[test]
fn spaces_are_respected() {
    for config in all() {
        let (mut env, mut rng, mut obs) = started(&config, 1);
        let spec = env.spec().clone();
        spec.validate().unwrap();
        let inside = |obs: &[f32]| {
            let bounds = spec.low.iter().zip(&spec.high);
            obs.iter().zip(bounds).all(|(x, (low, high))| (low..=high).contains(&x))
                && (!spec.integral || obs.iter().all(|x| x.fract() == 0.0))
        };
        assert!(inside(&obs));
        assert!(env.features().is_empty() || env.features().len() == obs.len());
        let mut ends = 0;
        for _ in 0..5000 {
            let (_, step, reached) = walk(env.as_mut(), &mut rng, &mut obs);
            assert!(inside(&reached) && inside(&obs) && step.reward.is_finite());
            assert_eq!([env.can_be_in(&reached), env.can_be_in(&obs)], [Ok(()); 2], "{}", spec.name);
            assert!(!(step.terminated && step.truncated));
            assert!(!step.success || spec.defines_success);
            ends += u32::from(step.terminated || step.truncated);
        }
        assert!(ends >= 1, "{}", spec.name);
    }
}

#[test]
fn equal_seeds_and_actions_give_equal_steps() {
    for config in all() {
        let run = |seed| {
            let (mut env, mut rng, mut obs) = started(&config, seed);
            (0..500).map(|_| walk(env.as_mut(), &mut rng, &mut obs)).collect::<Vec<_>>()
        };
        assert_eq!(run(3), run(3));
        assert_ne!(run(3), run(4));
    }
}

#[test]
fn a_restored_environment_goes_on_as_if_nothing_had_happened() {
    for config in all() {
        let (mut env, mut rng, mut obs) = started(&config, 5);
        for length in [0, 1, 17, 100, 433] {
            for _ in 0..length {
                walk(env.as_mut(), &mut rng, &mut obs);
            }
            let bytes = env.snapshot().unwrap();
            // Into one that has a history of its own.
            let (mut other, mut other_rng, mut other_obs) = started(&config, 6);
            for _ in 0..50 {
                walk(other.as_mut(), &mut other_rng, &mut other_obs);
            }
            other.restore(&bytes).unwrap();
            assert_eq!(other.snapshot().unwrap(), bytes);
            let (mut copy_rng, mut copy_obs) = (rng.clone(), obs.clone());
            for _ in 0..300 {
                let expected = walk(env.as_mut(), &mut rng, &mut obs);
                assert_eq!(walk(other.as_mut(), &mut copy_rng, &mut copy_obs), expected);
            }
        }
    }
}

#[test]
fn steps_without_an_episode_or_an_action_are_refused() {
    for config in all() {
        let mut env = registry().build(&config).unwrap();
        let n = env.spec().n_actions() as u32;
        let mut obs = vec![0.5; env.spec().obs_dim()];
        assert!(matches!(env.step(0, &mut obs), Err(EnvError::Ended)));
        let mut rng = stream(7, Purpose::Environment, 0);
        env.reset(&mut rng, &mut obs).unwrap();
        let (before, seen) = (env.snapshot().unwrap(), obs.clone());
        let refused = env.step(n, &mut obs);
        assert!(
            matches!(refused, Err(EnvError::Action { action, last }) if action == n && last == n as usize - 1)
        );
        assert_eq!((env.snapshot().unwrap(), &obs), (before, &seen));
        loop {
            let step = env.step(rng.random_range(0..n), &mut obs).unwrap();
            if step.terminated || step.truncated {
                break;
            }
        }
        let seen = obs.clone();
        assert!(matches!(env.step(0, &mut obs), Err(EnvError::Ended)));
        assert_eq!(obs, seen);
        // An ended episode is saved as such.
        let bytes = env.snapshot().unwrap();
        env.reset(&mut rng, &mut obs).unwrap();
        env.restore(&bytes).unwrap();
        assert!(matches!(env.step(0, &mut obs), Err(EnvError::Ended)));
    }
}
