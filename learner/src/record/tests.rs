//! Whole runs through a recorder: what the files hold, and that an interruption leaves no trace in them.

#![allow(clippy::unwrap_used)]

use super::*;
use serde_json::Value;
use trestle_proto::codec::{self, Kind};

const KIND: Kind = Kind { magic: *b"TRTEST\0\0", version: 1 };

fn settings(goal: Option<Goal>) -> Settings {
    Settings {
        algo: "dqn".into(),
        seed: 3,
        env: "maze-small".into(),
        goal,
        limits: Limits { episodes: Some(40), env_steps: None },
        metrics_every: Duration::MAX,
        progress_every: Duration::ZERO,
    }
}

fn at(tick: u64) -> Counters {
    Counters { episodes: tick, env_steps: 10 * tick, grad_steps: 2 * tick }
}

fn episode(tick: u64) -> Episode {
    Episode { total_reward: -(tick as f64) / 7.0, length: tick, success: Some(tick.is_multiple_of(2)) }
}

/// An episode a tick, an evaluation of two episodes every third, an interval row every fourth.
fn play(recorder: &mut Recorder, ticks: std::ops::RangeInclusive<u64>) {
    for tick in ticks {
        recorder.episode(&at(tick), &episode(tick)).unwrap();
        if tick.is_multiple_of(3) {
            recorder.evaluation(&at(tick), &[episode(tick), episode(tick + 1)]).unwrap();
        }
        if tick.is_multiple_of(4) {
            recorder.interval(&at(tick), &Gauges { loss: 0.25, ..Gauges::default() }).unwrap();
        }
    }
}

fn ending() -> Ending {
    Ending { weights_sha256: "ab".into(), restarts: 0, interrupted: false, mentor_samples: Some([400, 3]) }
}

/// `evals.csv` without the column `wall_s`.
fn evals(dir: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(dir.join(EVALS_FILE)).unwrap();
    let without = |line: &str| {
        let mut cells: Vec<&str> = line.split(',').collect();
        cells.remove(3);
        cells.join(",")
    };
    text.lines().map(without).collect()
}

/// `metrics.jsonl` without what depends on the clock.
fn metrics(dir: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(dir.join(METRICS_FILE)).unwrap();
    let without = |line: &str| {
        let mut row: serde_json::Map<String, Value> = serde_json::from_str(line).unwrap();
        row.remove("time/time_elapsed").unwrap();
        row.remove("time/fps");
        Value::Object(row)
    };
    text.lines().map(without).collect()
}

#[test]
fn files_hold_what_was_recorded() {
    let dir = tempfile::tempdir().unwrap();
    let mut recorder = Recorder::create(dir.path(), settings(None)).unwrap();
    recorder.begin();
    play(&mut recorder, 1..=4);
    let one = [Episode { total_reward: -3.4, length: 35, success: Some(true) }];
    recorder.evaluation(&at(5), &one).unwrap();
    let result = recorder.finish(&at(5), &Gauges::default(), ending()).unwrap();

    let text = std::fs::read_to_string(dir.path().join(EVALS_FILE)).unwrap();
    assert_eq!(text.lines().next(), Some("episode,env_steps,grad_steps,wall_s,return,length,success"));
    assert_eq!(evals(dir.path())[1..], ["3,30,6,-0.5,3.5,0.5".to_owned(), "5,50,10,-3.4,35,1".to_owned()]);

    let rows = metrics(dir.path());
    assert_eq!(rows.len(), 6, "four episodes, the interval at tick 4 and the last one");
    assert_eq!(rows[1]["rollout/ep_rew"], -2.0 / 7.0);
    assert_eq!(rows[1]["rollout/ep_len_mean"], 1.5);
    assert_eq!(rows[4]["train/loss"], 0.25);
    assert_eq!(rows[4]["time/episodes"], 4);
    assert_eq!(rows[5]["train/n_updates"], 10);
    assert!(rows[5].get("train/loss").is_none());

    assert_eq!((result.threshold, result.solved_episode, result.best_return), (None, None, Some(-0.5)));
    assert_eq!(result.final_return, Some(-3.4));
    assert_eq!((result.mentor_loss_frac, result.mentor_feasible_frac), (Some(0.0075), None));
    let written: RunResult =
        serde_json::from_slice(&std::fs::read(dir.path().join(RESULT_FILE)).unwrap()).unwrap();
    // Other numbers than times are such that reading decimals cannot lose a bit.
    assert_eq!(RunResult { wall_s: result.wall_s, ..written }, result);
    assert!(result.wall_s >= 0.0);
}

#[test]
fn an_interruption_leaves_no_trace() {
    let goal = Some(Goal { threshold: -2.0, tolerance: 0.0 });
    let undisturbed = tempfile::tempdir().unwrap();
    let mut recorder = Recorder::create(undisturbed.path(), settings(goal)).unwrap();
    play(&mut recorder, 1..=40);
    let expected = recorder.finish(&at(40), &Gauges::default(), ending()).unwrap();
    assert_eq!((expected.solved_episode, expected.solved_env_steps), (Some(3), Some(30)));

    for checkpoint in [1, 3, 8, 12, 39] {
        let dir = tempfile::tempdir().unwrap();
        let mut recorder = Recorder::create(dir.path(), settings(goal)).unwrap();
        play(&mut recorder, 1..=checkpoint);
        let state = codec::encode(KIND, &recorder.checkpoint().unwrap().0).unwrap();
        play(&mut recorder, checkpoint + 1..=40);
        drop(recorder);

        let state: RecorderState = codec::decode(KIND, &state).unwrap();
        let before_s = state.wall_s;
        let mut recorder = Recorder::resume(dir.path(), settings(goal), state, at(checkpoint)).unwrap();
        recorder.begin();
        assert!(recorder.wall_s() >= before_s);
        play(&mut recorder, checkpoint + 1..=40);
        let result = recorder.finish(&at(40), &Gauges::default(), ending()).unwrap();
        assert_eq!(evals(dir.path()), evals(undisturbed.path()));
        assert_eq!(metrics(dir.path()), metrics(undisturbed.path()));
        assert_eq!(RunResult { wall_s: expected.wall_s, ..result }, expected);
        let names = std::fs::read_dir(dir.path()).unwrap().map(|entry| entry.unwrap().file_name());
        assert_eq!(
            names.filter(|name| name.to_str().unwrap().starts_with("events.out.tfevents.")).count(),
            2
        );
    }
}

#[test]
fn progress_is_one_line_that_reads_back() {
    let dir = tempfile::tempdir().unwrap();
    let mut recorder =
        Recorder::create(dir.path(), settings(Some(Goal { threshold: -9.0, tolerance: 0.0 }))).unwrap();
    assert!(recorder.progress_due());
    assert!(!recorder.interval_due());
    play(&mut recorder, 1..=20);
    let gauges = Gauges { feasible_frac: 0.5, ..Gauges::default() };
    let mut progress = recorder.progress(&at(20), &gauges);
    assert_eq!((progress.episodes, progress.env_steps, progress.grad_steps), (20, 200, 40));
    assert_eq!((progress.feasible_frac, progress.bridged_frac), (Some(0.5), None));
    assert!(progress.solved && progress.optimal && progress.fps > 0.0);
    assert!(progress.seconds_left.unwrap() > 0.0);
    // Decimals may lose a bit when they are read: compare with numbers that do not.
    (progress.fps, progress.seconds_left, progress.ep_rew_mean, progress.eval_return) =
        (2.5, Some(8.0), None, Some(-3.5));
    let line = serde_json::to_string(&progress).unwrap();
    assert!(!line.contains('\n'));
    assert_eq!(serde_json::from_str::<Progress>(&line).unwrap(), progress);
}

#[test]
fn lost_lines_and_empty_evaluations_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let mut recorder = Recorder::create(dir.path(), settings(None)).unwrap();
    play(&mut recorder, 1..=6);
    assert!(matches!(recorder.evaluation(&at(7), &[]), Err(RecordError::NoEpisodes { env_steps: 70 })));
    let (state, _) = recorder.checkpoint().unwrap();
    drop(recorder);
    std::fs::write(dir.path().join(METRICS_FILE), "{}\n").unwrap();
    let recorder = Recorder::resume(dir.path(), settings(None), state.clone(), at(6)).unwrap();
    assert_eq!(recorder.metrics.rows(), 1, "metrics are no reason not to go on");
    drop(recorder);
    std::fs::write(dir.path().join(EVALS_FILE), EVALS_HEADER).unwrap();
    let error = Recorder::resume(dir.path(), settings(None), state, at(6)).unwrap_err();
    assert!(error.to_string().contains("evals.csv has 0 of the 2 lines"), "{error}");
}

/// A run of very many very short episodes: `evals.csv` is complete, all else has its bound, and an interruption leaves no
/// trace in what is kept.
#[test]
fn logs_are_bounded() {
    const EPISODES_PLAYED: u64 = 600_000;
    let play = |recorder: &mut Recorder, ticks: std::ops::RangeInclusive<u64>| {
        for tick in ticks {
            recorder.episode(&at(tick), &episode(tick % 7)).unwrap();
            if tick.is_multiple_of(10) {
                recorder.evaluation(&at(tick), &[episode(tick % 5)]).unwrap();
            }
        }
    };
    let (undisturbed, resumed) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let mut recorder = Recorder::create(undisturbed.path(), settings(None)).unwrap();
    play(&mut recorder, 1..=EPISODES_PLAYED);
    recorder.finish(&at(EPISODES_PLAYED), &Gauges::default(), ending()).unwrap();

    let mut recorder = Recorder::create(resumed.path(), settings(None)).unwrap();
    play(&mut recorder, 1..=12_345);
    let (state, _) = recorder.checkpoint().unwrap();
    play(&mut recorder, 12_346..=70_000);
    drop(recorder);
    let mut recorder = Recorder::resume(resumed.path(), settings(None), state, at(12_345)).unwrap();
    play(&mut recorder, 12_346..=EPISODES_PLAYED);
    recorder.finish(&at(EPISODES_PLAYED), &Gauges::default(), ending()).unwrap();

    assert_eq!(evals(undisturbed.path()).len() as u64, EPISODES_PLAYED / 10 + 1);
    assert_eq!(evals(resumed.path()), evals(undisturbed.path()));
    let rows = metrics(undisturbed.path());
    assert_eq!(metrics(resumed.path()), rows);
    // All up to 2^14, half of them more with each of the next five doublings, and a part of the sixth.
    assert!((50_000..70_000).contains(&rows.len()), "{}", rows.len());
    assert!(rows[..16_383].iter().zip(1..).all(|(row, number)| row["time/episodes"] == number));
    for entry in std::fs::read_dir(undisturbed.path()).unwrap() {
        let entry = entry.unwrap();
        let most = match entry.file_name().to_str().unwrap() {
            EVALS_FILE => u64::MAX,
            METRICS_FILE => 20 << 20,
            name if name.starts_with("events.out.tfevents.") => 4 << 20,
            _ => 1 << 10,
        };
        assert!(entry.metadata().unwrap().len() < most, "{entry:?}");
    }
}

#[test]
fn an_earlier_result_is_gone_before_lines_are_cut_back() {
    let dir = tempfile::tempdir().unwrap();
    let result = dir.path().join(RESULT_FILE);
    std::fs::write(&result, "of an earlier start").unwrap();
    let mut recorder = Recorder::create(dir.path(), settings(None)).unwrap();
    assert!(!result.exists());
    let state = recorder.checkpoint().unwrap().0;
    recorder.finish(&at(1), &Gauges::default(), ending()).unwrap();
    assert!(result.exists());
    drop(Recorder::resume(dir.path(), settings(None), state, at(1)).unwrap());
    assert!(!result.exists());
}
