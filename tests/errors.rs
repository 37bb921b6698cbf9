//! Mistakes: each is refused before anything starts, by its name, its value and what is accepted, and leaves
//! everything as it was.

use crate::util::{LIMIT, Outcome, Place, Trace, dead_runs, start, tree, trestle, wait_until};
use std::fs;

/// Runs `args`, which must be refused with all of `words` and change nothing.
fn refused(place: &Place, args: &[&str], words: &[&str]) -> Outcome {
    let (files, dead) = (tree(place.root()), dead_runs());
    let outcome = trestle(args).refused(words);
    let causes: Vec<&str> = outcome.stderr.trim_end().split(": ").collect();
    assert!(causes.windows(2).all(|pair| pair[0] != pair[1]), "said twice: {outcome:?}");
    assert!(outcome.stderr.lines().count() < 12, "a message, not a flood: {outcome:?}");
    assert!(!outcome.stderr.contains("panicked") && outcome.stdout.is_empty(), "{outcome:?}");
    assert!(tree(place.root()) == files, "{args:?} changed files");
    // Other tests' runs may be on their way out just now.
    assert!(wait_until(LIMIT, || dead_runs().iter().all(|run| dead.contains(run))));
    outcome
}

/// Refuses a training with `args` in a new directory.
fn refused_training(place: &Place, args: &[&str], words: &[&str]) {
    let out = place.path("runs/never");
    refused(place, &[&["train", "--episodes", "3", "--out", &out], args].concat(), words);
}

#[test]
fn maps() {
    let place = Place::new();
    let cases: [(&str, &[u8], &[&str]); 9] = [
        ("ragged", b"S..\n..\n..G\n", &["line 2", "2 characters", "accepted: 3"]),
        ("two-starts", b"S.S\n..G\n", &["line 1, column 3", "second `S`", "exactly one"]),
        ("two-goals", b"S.G\n..G\n", &["line 2, column 3", "second `G`", "exactly one"]),
        ("no-start", b"...\n..G\n", &["without a `S`", "exactly one"]),
        ("no-goal", b"S..\n...\n", &["without a `G`", "exactly one"]),
        ("unknown", b"S.x\n..G\n", &["line 1, column 3", "'x'", "accepted: # . S G"]),
        ("walled", b"S#.\n##.\n..G\n", &["goal `G` cannot be reached", "line 1, column 1", "irregular"]),
        ("empty", b"", &["the map is empty", "accepted"]),
        ("bytes", b"S.\xff\n..G\n", &["line 1, column 3", "not UTF-8"]),
    ];
    for (name, text, words) in cases {
        let map = format!("env.map={}", place.write(name, text));
        refused_training(&place, &["maze-small", "--set", &map], &[words, &[name]].concat());
        refused(&place, &["config", "check", "maze-small", "--set", &map], words);
    }
    for map in ["no-such.txt", "random:1:2x2", "random:x:9x9"] {
        let set = format!("env.map={map}");
        refused_training(&place, &["maze-small", "--set", &set], &[map, "accepted"]);
    }
    // What the mentor cannot reach, it cannot show.
    let sets = ["--set", "mentor.actions=up", "--set", "env.action_sets.up=[\"N\",\"W\"]"];
    refused_training(
        &place,
        &[&["maze-small"], &sets[..]].concat(),
        &["cannot be reached", "N, W of the set `up`"],
    );
}

#[test]
fn settings() {
    let place = Place::new();
    let cases: [(&str, &[&str]); 20] = [
        ("learner.gamma=1.5", &["learner.gamma = 1.5", "accepted: 0 to 1"]),
        ("learner.lr=0", &["learner.lr = 0", "above 0"]),
        ("learner.lr=nan", &["learner.lr = nan", "above 0"]),
        ("learner.batch=0", &["learner.batch = 0", "1 to 1024"]),
        ("learner.batch=many", &["learner.batch", "many"]),
        ("learner.hidden=[]", &["learner.hidden = []", "1 to 6 layers"]),
        ("learner.hidden=[64, 0]", &["learner.hidden = [64, 0]", "1 to 4096"]),
        ("learner.conv=[{channels=0,kernel=3}]", &["learner.conv", "channels, kernel, stride", "1 to 4096"]),
        ("learner.conv=[{channels=4,kernel=2}]", &["1 convolutions", "maze", "2 separate features"]),
        ("learner.replay=8", &["learner.replay = 8", "learner.batch"]),
        ("learner.gama=0.9", &["learner", "gama", "gamma"]),
        ("run.actors=65", &["run.actors = 65", "1 to 64"]),
        ("run.rollout=4097", &["run.rollout = 4097", "1 to 4096"]),
        ("run.lag=2", &["run.lag = 2", "0 or 1"]),
        ("run.seed=-1", &["run.seed", "-1"]),
        ("run.algo=sarsa", &["run.algo", "sarsa", "ha-diiqn"]),
        ("mentor.k=0", &["mentor.k = 0", "1 to 64"]),
        ("env.actions=none", &["env.actions = none", "irregular"]),
        ("nonsense.key=1", &["nonsense"]),
        ("learner.lr", &["learner.lr", "key=value"]),
    ];
    for (set, words) in cases {
        refused_training(&place, &["maze-small", "--set", set], words);
        refused(&place, &["config", "check", "maze-small", "--set", set], words);
    }
}

#[test]
fn files_and_presets() {
    let place = Place::new();
    refused_training(&place, &["maze31"], &["maze31", "maze30", "maze-small"]);
    let broken = place.write("broken.toml", "[run\nseed = 1\n");
    refused_training(&place, &[&broken], &["broken.toml", "not valid TOML", "line 1"]);
    let unknown = place.write("unknown.toml", "base = \"maze-small\"\n[lerner]\nlr = 1.0\n");
    refused_training(&place, &[&unknown], &["lerner", "learner"]);
    let typed = place.write("typed.toml", "base = \"maze-small\"\n[learner]\nlr = \"fast\"\n");
    refused_training(&place, &[&typed], &["learner.lr", "fast"]);
    let base = place.write("base.toml", "base = \"maze31\"\n");
    refused_training(&place, &[&base], &["maze31", "maze-small"]);
    let directory = place.root().to_str().unwrap().to_string();
    refused_training(&place, &[&directory], &[&directory, "not a file"]);
    let endless = place.write("endless.toml", "[run]\nseed = 1\n");
    let out = place.path("never");
    refused(&place, &["train", &endless, "--out", &out], &["run.episodes", "run.env_steps"]);
}

#[test]
fn flags() {
    let place = Place::new();
    refused_training(&place, &["maze-small", "--sed", "1"], &["--sed", "--seed"]);
    refused_training(&place, &["maze-small", "--seed", "x"], &["x", "--seed"]);
    refused_training(&place, &["maze-small", "--algo", "sarsa"], &["sarsa", "dqn, diiqn, ha-diiqn"]);
    refused_training(&place, &["maze-small", "--mode", "fast"], &["fast", "lockstep"]);
    refused_training(&place, &["maze-small", "--resume", "--overwrite"], &["--resume", "--overwrite"]);
    refused_training(&place, &["maze-small", "--actors", "0"], &["run.actors = 0", "1 to 64"]);
    for (flag, value, accepted) in [
        ("--seed", "18446744073709551615", "run.seed = 18446744073709551615; accepted: 0 to 2^63 - 1"),
        ("--seed", "9223372036854775808", "run.seed = 9223372036854775808; accepted: 0 to 2^63 - 1"),
        ("--seed", "-1", "run.seed = -1; accepted: 0 to 2^63 - 1"),
        ("--actors", "many", "run.actors = many; accepted: 1 to 64, a whole number"),
        ("--env-steps", "1e6", "run.env_steps = 1e6; accepted: 1 or more, a whole number"),
    ] {
        refused_training(&place, &["maze-small", flag, value], &[accepted, &format!("{flag} {value}")]);
    }
    for out in ["--out=--weird", "--out=-"] {
        let words = [out.trim_start_matches("--out="), "looks like a flag; accepted: ./-"];
        refused(&place, &["train", "maze-small", "--episodes", "3", out], &words);
    }
    let sweep = ["sweep", "maze-small", "--seeds", "0..1", "--out", "never"];
    refused(&place, &[&sweep[..], &["--jobs", "0"]].concat(), &["--jobs 0; accepted: 1 to 256"]);
    refused(&place, &["actor", "--run", "never", "--index", "64"], &["--index 64; accepted: 0 to 63"]);
    refused(
        &place,
        &["eval", "never", "--checkpoint", "lats"],
        &["last, best, or the tick", "did you mean `last`?"],
    );
    refused(&place, &["train", "maze-small", "--episodes", "0"], &["run.episodes = 0", "1 or more"]);
    refused(&place, &["train"], &["PRESET|CONFIG.TOML"]);
    refused(&place, &["trian"], &["trian", "train"]);
    refused(&place, &["eval", &place.path("none")], &["none", "not a run's directory"]);
    refused(
        &place,
        &["eval", &place.path("none"), "--episodes", "0"],
        &["--episodes 0", "accepted: 1 to 4096"],
    );
    for role in ["learner", "mentor-server"] {
        refused(&place, &[role, "--run", &place.path("none")], &["none", "not a run's directory"]);
    }
    // The processes of a run join one that is in progress.
    place.train("run", &["maze-small", "--env-steps", "100"]);
    for role in [&["learner"][..], &["mentor-server"], &["actor", "--index", "0"]] {
        refused(
            &place,
            &[role, &["--run", &place.path("run")]].concat(),
            &["joining the run", "not in progress"],
        );
    }
}

#[test]
fn a_misspelt_name_is_met_with_the_right_one() {
    let place = Place::new();
    let cases: [(&[&str], &str); 14] = [
        (&["train", "gim:CartPole-v1"], "did you mean `gym:CartPole-v1`?"),
        (&["train", "maze-smal"], "did you mean `maze-small`?"),
        (&["train", "maze-small", "--set", "env.map=radnom:1:9x9"], "did you mean `random:1:9x9`?"),
        (&["train", "maze-small", "--set", "env.map=lage"], "did you mean `large`?"),
        (&["train", "maze-small", "--set", "hazard.kind=none"], "did you mean `env.hazard`?"),
        (&["train", "maze-small", "--set", "map=umaze"], "did you mean `env.maze.map`?"),
        (&["train", "maze-small", "--set", "maze.map=umaze"], "did you mean `env.maze`?"),
        (&["train", "maze-small", "--set", "learner_gama=0.9"], "did you mean `learner.gamma`?"),
        (&["train", "maze-small", "--set", "mentor.selection.rule=confidense"], "min-distance, confidence"),
        (
            &["train", "maze-small", "--algo", "dqn+gafo"],
            "for dqn+gaifo type --algo dqn --set rival.kind=gaifo",
        ),
        (&["train", "maze-small", "--algo", "ha-diqn+guided"], "did you mean `ha-diiqn`?"),
        (&["config", "list", "maze-smal"], "did you mean `maze-small`?"),
        (&["config", "list", "gim"], "did you mean `gym`?"),
        (&["config", "list", "hazard"], "did you mean `env.hazard`?"),
    ];
    for (args, says) in cases {
        refused(&place, args, &[says]);
    }
    let said = start(&["tran"]).finish().stderr;
    assert!(said.contains("'train'") && !said.contains("orphaned"), "what only the program types: {said}");
    let said = start(&["orphane"]).finish().stderr;
    assert!(said.contains("'orphane'\n\nUsage") && !said.contains("tip:"), "{said}");
    for (args, says) in [
        (&["watch", "--port", "65536"][..], "--port 65536; accepted: 0 to 65535"),
        (&["train", "maze-small", "--watch=x"], "--watch x; accepted: 0 to 65535, a whole number"),
        (&["watch", "--bind", "here"], "accepted: an address, such as 127.0.0.1"),
        (&["eval", "no-such-run"], "no-such-run is not a run's directory: there is nothing"),
    ] {
        refused(&place, args, &[says]);
    }
}

#[test]
fn demonstrations() {
    let place = Place::new();
    let cases: [(&str, &str, &[&str]); 9] = [
        ("header", "a,b,c\n0,0,1,1\n", &["row 1", "`a`", "`trajectory`"]),
        ("text", "trajectory,terminal,x,y\n0,0,1,one\n0,1,1,2\n", &["row 2", "y", "`one`", "finite"]),
        ("nan", "trajectory,terminal,x,y\n0,0,1,NaN\n0,1,1,2\n", &["row 2", "`NaN`", "finite"]),
        (
            "columns",
            "trajectory,terminal,x,y\n0,0,1\n0,1,1,2\n",
            &["row 2", "columns", "is 3", "accepted: 4"],
        ),
        ("terminal", "trajectory,terminal,x,y\n0,2,1,1\n0,1,1,2\n", &["row 2", "terminal", "`2`", "0 or 1"]),
        ("short", "trajectory,terminal,x,y\n0,1,1,1\n", &["trajectory 0", "2 rows or more"]),
        ("none", "trajectory,terminal,x,y\n", &["missing", "2 rows or more"]),
        ("torn", "trajectory,terminal,x,y\n0,0,1,1\n0,1,1,2\n0,0,3,3\n", &["row 3", "terminal is 1"]),
        ("dim", "trajectory,terminal,x\n0,0,1\n0,1,2\n", &["1 features", "accepted: 2"]),
    ];
    for (name, text, words) in cases {
        let path = place.write(&format!("{name}.csv"), text);
        let set = format!("mentor.demo={path}");
        refused_training(&place, &["maze-small", "--set", &set], &[words, &[path.as_str()]].concat());
        refused(&place, &["demo", "inspect", &path, "--config", "maze-small"], words);
    }
    refused_training(&place, &["maze-small", "--set", "mentor.demo=no-such.csv"], &["no-such.csv"]);
    let taken = place.write("taken.csv", "something");
    refused(&place, &["demo", "plan", "maze-small", "--out", &taken], &["taken.csv exists", "--overwrite"]);
}

/// Messages to actors have a largest size, which a long demonstration and long bridges exceed.
#[test]
fn whole_bridges_beyond_a_message() {
    let place = Place::new();
    let there_and_back: String = (0..22_000).map(|step| format!("0,0,1,{}\n", 1 + step % 2)).collect();
    let demo = place.write("demo.csv", format!("trajectory,terminal,x,y\n{there_and_back}"));
    let set = format!("mentor.demo={demo}");
    let whole = ["--set", "exploration.guide_start=0.5", "--set", "exploration.guide_whole=true"];
    let args =
        [&["maze-small", "--algo", "ha-diiqn", "--set", &set, "--set", "mentor.k=64"], &whole[..]].concat();
    let words = [
        "exploration.guide_whole = true",
        "64 steps for 21999 mentor transitions",
        "accepted: up to 4194304",
    ];
    refused_training(&place, &args, &words);
}

#[test]
fn directories() {
    let place = Place::new();
    let train = ["maze-small", "--algo", "dqn", "--seed", "1"];
    let short = [&train[..], &["--env-steps", "2000"]].concat();
    let out = |name: &str| ["--out".to_string(), place.path(name)];
    let refused_in = |name: &str, more: &[&str], words: &[&str]| {
        let out = out(name);
        let args = [&["train"], &train[..], &[&out[0], &out[1]], more].concat();
        refused(&place, &args, words)
    };
    place.train("run", &short);
    refused_in("run", &[], &["run exists", "--resume", "--overwrite"]);
    // A power cut may leave an empty directory of a start, or none: nothing is lost there.
    fs::create_dir(place.root().join("empty")).unwrap();
    for name in ["none", "empty"] {
        place.train(name, &[&short[..], &["--resume"]].concat());
    }
    fs::create_dir(place.root().join("photos")).unwrap();
    place.write("photos/cat.jpg", "miaow");
    refused_in("photos", &[], &["photos exists"]);
    refused_in("photos", &["--overwrite"], &["--overwrite", "photos", "not a run"]);
    place.write("file", "text");
    for how in [&[][..], &["--overwrite"], &["--resume"]] {
        refused_in("file", how, &["file"]);
    }
    refused_in("file/below", &[], &["file/below"]);
    // Without a checkpoint there is nothing to go on from.
    refused_in(
        "run",
        &["--resume", "--env-steps", "2000"],
        &["--resume", "run is complete", "--episodes or --env-steps"],
    );
    fs::remove_dir_all(place.run("run").checkpoints()).unwrap();
    refused_in("run", &["--resume", "--env-steps", "3000"], &["--resume", "no checkpoint to go on from"]);
}

#[test]
fn an_existing_run_is_replaced_whole_or_not_at_all() {
    let place = Place::new();
    let train = |seed| ["maze-small", "--env-steps", "2000", "--seed", seed, "--overwrite"];
    let first = place.train("run", &train("1"));
    fs::write(place.root().join("run/note.txt"), "of the first").unwrap();
    let bad = [&train("2")[..], &["--set", "env.map=none.txt"]].concat();
    let (files, args) = (tree(place.root()), place.training("run", &bad));
    start(&args).finish().refused(&["none.txt"]);
    assert!(tree(place.root()) == files);
    assert_eq!(Trace::of(&place.run("run")), first);
    let second = place.train("run", &train("2"));
    assert_ne!(second.weights_sha256, first.weights_sha256);
    assert!(!place.root().join("run/note.txt").exists());
    assert_eq!(fs::read_dir(place.root()).unwrap().count(), 1, "the old one is gone");
    fs::create_dir(place.root().join("empty")).unwrap();
    place.train("empty", &train("2")[..5]);
}
