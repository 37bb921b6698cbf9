//! What a run does and leaves behind.

use crate::util::{Place, Trace, assert_gone, metrics, newest_checkpoint, result, start, trestle};
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use trestle_actor::env::registry;
use trestle_learner::checkpoint;
use trestle_proto::config;
use trestle_proto::rundir::RunDir;

#[test]
fn heterogeneous_imitation_solves_the_small_maze() {
    let place = Place::new();
    let out = place.path("run");
    let args = ["train", "maze-small", "--algo", "ha-diiqn", "--seed", "7", "--out", &out];
    let outcome = start(&args).finish().ok();
    assert!(outcome.stdout.contains(&format!("next: trestle eval {out}")), "{outcome:?}");
    assert!(outcome.stderr.contains("episode 0/400"), "plain lines off a terminal: {outcome:?}");

    let dir = place.run("run");
    assert_gone(&dir);
    let result = result(&dir);
    assert_eq!((result.algo.as_str(), result.seed, result.episodes), ("ha-diiqn", 7, 400));
    assert!(result.solved_episode.is_some(), "{result:?}");
    assert!(result.solved_env_steps <= Some(result.env_steps));
    assert!(outcome.stdout.contains(&result.weights_sha256));
    assert!(result.wall_s > 0.0 && result.restarts == 0 && !result.interrupted);

    check_documents(&dir, &args);
    check_evals(&dir);
    check_metrics(&dir);
    check_checkpoints(&dir);
    check_eval_command(&dir, result.final_return.unwrap());
}

/// config.toml, command.txt, build.json, result.json, logs and TensorBoard's file.
fn check_documents(dir: &RunDir, args: &[&str]) {
    let text = fs::read_to_string(dir.config()).unwrap();
    let resolved = config::parse_toml("config.toml", &text).unwrap();
    let map = resolved.env.own.get("map_text").expect("the map itself is in the resolved configuration");
    let mut expected =
        config::load(registry(), "maze-small", &["run.seed=7".into(), "run.algo=ha-diiqn".into()]).unwrap();
    expected.env.own.insert("map_text".into(), map.clone());
    // A cell of a maze has no velocity.
    expected.mentor.metric = config::MetricKind::Kl;
    assert_eq!(resolved, expected);

    let command = fs::read_to_string(dir.command()).unwrap();
    assert!(command.trim_end().ends_with(&args.join(" ")), "{command}");
    let build: Value = serde_json::from_slice(&fs::read(dir.build()).unwrap()).unwrap();
    for key in ["version", "commit", "isa", "backends"] {
        assert!(build.get(key).is_some(), "{key} in {build}");
    }
    let result: Value = serde_json::from_slice(&fs::read(dir.result()).unwrap()).unwrap();
    let keys = "algo seed env episodes env_steps grad_steps wall_s solved_episode solved_env_steps optimal_episode \
        optimal_env_steps threshold best_return final_return weights_sha256 restarts";
    for key in keys.split_whitespace() {
        assert!(result.get(key).is_some(), "{key} in {result}");
    }
    for process in ["learner", "mentor-server", "actor-0"] {
        let log = fs::read_to_string(dir.log(process)).unwrap();
        assert!(log.contains(&format!("role={process}")), "{process}: {log}");
    }
    let names = fs::read_dir(dir.root()).unwrap().map(|e| e.unwrap().file_name());
    let events: Vec<_> = names.filter(|n| n.to_string_lossy().starts_with("events.out.tfevents.")).collect();
    assert_eq!(events.len(), 1);
    assert!(fs::metadata(dir.root().join(&events[0])).unwrap().len() > 1000);
}

fn check_evals(dir: &RunDir) {
    let text = fs::read_to_string(dir.evals()).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("episode,env_steps,grad_steps,wall_s,return,length,success"));
    let rows: Vec<Vec<f64>> = lines.map(|l| l.split(',').map(|x| x.parse().unwrap()).collect()).collect();
    assert!(rows.len() >= 400 / 5, "{} evaluations of 400 episodes, one every 5", rows.len());
    assert!(rows.iter().all(|row| row.len() == 7 && (0.0..=1.0).contains(&row[6])));
    for pair in rows.windows(2) {
        assert!(pair[0][..2].iter().zip(&pair[1][..2]).all(|(a, b)| a < b), "{pair:?}");
        assert!(pair[0][2..4].iter().zip(&pair[1][2..4]).all(|(a, b)| a <= b), "{pair:?}");
    }
    let (last, result) = (rows.last().unwrap(), result(dir));
    assert_eq!(last[0] as u64, result.episodes);
    assert_eq!(last[1] as u64, result.env_steps);
    assert_eq!(last[2] as u64, result.grad_steps);
    assert_eq!(Some(last[4]), result.final_return);
    let best = rows.iter().map(|row| row[4]).fold(f64::NEG_INFINITY, f64::max);
    assert_eq!(Some(best), result.best_return);
}

fn check_metrics(dir: &RunDir) {
    let rows = metrics(dir);
    let episodes: Vec<&Value> = rows.iter().filter(|row| row.get("rollout/ep_rew").is_some()).collect();
    assert_eq!(episodes.len(), 400);
    for (i, row) in episodes.iter().enumerate() {
        assert_eq!(row["time/episodes"], i as u64 + 1);
    }
    let last = rows.last().unwrap();
    let documented = "rollout/ep_rew_mean rollout/ep_len_mean time/fps train/loss train/n_updates \
        mentor/feasible_frac mentor/bridged_frac mentor/e_kl_mean bridge/len_mean loss/mentor_frac replay/size \
        ipc/wait_frac";
    for key in documented.split_whitespace() {
        assert!(last[key].is_number(), "{key} in {last}");
    }
    for key in ["mentor/feasible_frac", "mentor/bridged_frac", "loss/mentor_frac", "ipc/wait_frac"] {
        let share = last[key].as_f64().unwrap();
        assert!((0.0..=1.0).contains(&share), "{key} = {share}");
    }
    assert!(last["mentor/feasible_frac"].as_f64() > Some(0.0), "moves straight on are feasible");
    assert!(last["mentor/bridged_frac"].as_f64() > Some(0.0), "turns are bridged");
    assert!(last["bridge/len_mean"].as_f64() >= Some(1.0));
}

fn check_checkpoints(dir: &RunDir) {
    let newest = newest_checkpoint(dir).unwrap();
    let last = fs::canonicalize(dir.last()).unwrap();
    assert_eq!(last, fs::canonicalize(checkpoint::directory(dir.root(), newest)).unwrap());
    let kept = fs::read_dir(dir.checkpoints()).unwrap().count();
    assert_eq!(kept, 2 + 1, "checkpoint.keep, and the last one");
    for entry in fs::read_dir(dir.checkpoints()).unwrap() {
        let path = entry.unwrap().path();
        let manifest: Value = serde_json::from_slice(&fs::read(path.join("MANIFEST")).unwrap()).unwrap();
        let listed: BTreeSet<String> = manifest["files"]
            .as_array()
            .unwrap()
            .iter()
            .map(|file| {
                let name = file["name"].as_str().unwrap().to_string();
                assert_eq!(file["bytes"], fs::metadata(path.join(&name)).unwrap().len());
                name
            })
            .chain(["MANIFEST".into(), "COMPLETE".into()])
            .collect();
        assert_eq!(listed, names(&path));
        for name in ["model.safetensors", "target.safetensors", "optimizer.safetensors"] {
            assert!(listed.contains(name));
        }
    }
}

fn names(dir: &Path) -> BTreeSet<String> {
    fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect()
}

/// `trestle eval` plays the weights that the last evaluation played, so it must see the same return.
fn check_eval_command(dir: &RunDir, final_return: f64) {
    let root = dir.root().to_str().unwrap();
    let outcome = trestle(&["eval", root, "--episodes", "3"]).ok();
    let line = outcome.stdout.lines().find_map(|line| line.trim().strip_prefix("mean return")).unwrap();
    assert_eq!(line.trim(), format!("{final_return:.3}"), "{outcome:?}");
    assert!(outcome.stdout.contains("success rate"), "{outcome:?}");
    let steps = outcome.stdout.lines().find_map(|line| line.trim().strip_prefix("mean steps")).unwrap();
    let path = outcome.stdout.matches('o').count();
    assert!(path >= 10 && steps.trim().parse::<f64>().unwrap() >= 10.0, "{outcome:?}");
    assert_eq!(trestle(&["eval", root, "--episodes", "3"]).ok().stdout, outcome.stdout);
}

#[test]
fn the_other_algorithms_train_to_their_end() {
    let place = Place::new();
    let mut weights = BTreeSet::new();
    for algo in ["dqn", "diiqn", "ha-diiqn"] {
        let trace = place.train(algo, &["maze-small", "--algo", algo, "--seed", "7", "--episodes", "60"]);
        assert_eq!((trace.result.algo.as_str(), trace.result.episodes), (algo, 60));
        assert!(weights.insert(trace.weights_sha256), "{algo} learns as another");
        let dir = place.run(algo);
        let last = metrics(&dir).pop().unwrap();
        assert_eq!(last.get("mentor/feasible_frac").is_some(), algo != "dqn");
        assert_eq!(dir.log("mentor-server").exists(), algo != "dqn");
        assert_eq!(dir.demonstration().exists(), algo != "dqn");
    }
}

#[test]
fn limits_end_a_run_exactly() {
    let place = Place::new();
    let steps = place.train("steps", &["maze-small", "--env-steps", "3001", "--actors", "2"]);
    assert_eq!(steps.result.env_steps, 3001);
    let last = steps.evals.last().unwrap();
    assert_eq!(last[1], "3001", "the last evaluation is of the end");
    let episodes = place.train("episodes", &["maze-small", "--episodes", "13", "--env-steps", "1000000"]);
    assert_eq!(episodes.result.episodes, 13);
    assert_eq!(episodes.episodes.len(), 13);
    // One step in, nothing has been learnt and no episode has ended.
    let one = place.train("one", &["maze-small", "--env-steps", "1"]);
    assert_eq!((one.result.env_steps, one.result.episodes, one.result.grad_steps), (1, 0, 0));
}

#[test]
fn quiet_prints_the_result_alone() {
    let place = Place::new();
    let outcome = start(&place.training("run", &["maze-small", "--env-steps", "2000"])).finish().ok();
    assert_eq!(outcome.stderr, "");
    assert!(outcome.stdout.contains("weights_sha256") && !outcome.stdout.contains("next:"), "{outcome:?}");
    assert_eq!(Trace::of(&place.run("run")).result.env_steps, 2000);
}
