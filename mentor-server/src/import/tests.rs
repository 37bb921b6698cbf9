//! Every format against files that Minari, h5py and NumPy wrote: see `tests/golden/demonstrations.py`.

#![allow(clippy::unwrap_used)]
use super::*;
use crate::demo_file;
use std::fs;

/// The moves of the files' first episode; the second is its first half, broken off.
const WAY: &str = "EESSSSSSSEENNNNNNEEEEEEESSSSSSSSSS";

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/golden/demonstrations").join(name)
}

fn of(name: &str, options: &Options) -> Imported {
    import(&golden(name), options).unwrap()
}

fn refused(path: &Path, options: &Options) -> String {
    import(path, options).unwrap_err().to_string()
}

fn key(key: &str) -> Options {
    Options { key: Some(key.into()), ..Options::default() }
}

fn columns(text: &str) -> Options {
    Options { columns: Some(text.parse().unwrap()), ..Options::default() }
}

/// The cells of a walk of `steps` moves.
fn cells(steps: usize) -> Vec<[f32; 2]> {
    let mut cell = [0.0, 0.0];
    let moves = WAY[..steps].chars().map(|direction| match direction {
        'N' => [0.0, -1.0],
        'E' => [1.0, 0.0],
        _ => [0.0, 1.0],
    });
    let walk = moves.map(|[dx, dy]| {
        cell = [cell[0] + dx, cell[1] + dy];
        cell
    });
    [[0.0, 0.0]].into_iter().chain(walk).collect()
}

fn demonstration(trajectories: &[(Vec<[f32; 2]>, bool)]) -> Demonstration {
    let mut out = Demonstration::new(vec!["s0".into(), "s1".into()]).unwrap();
    for (states, terminal) in trajectories {
        out.push_trajectory(&states.concat(), *terminal).unwrap();
    }
    out
}

const N: usize = WAY.len();

#[test]
fn minari_in_both_formats() {
    let expected = demonstration(&[(cells(N), true), (cells(N / 2), false)]);
    for name in ["minari-hdf5", "minari-hdf5/main_data.hdf5", "minari-arrow"] {
        let imported = of(name, &key("cell"));
        assert_eq!(imported.demonstration, expected, "{name}");
        assert_eq!(imported.notes, [] as [String; 0]);
        // Four of six columns of another part, in 64 bits there.
        let options = Options { columns: Some("0..4".parse().unwrap()), ..key("observation") };
        let point = of(name, &options).demonstration;
        assert_eq!((point.dim(), point.n_states()), (4, N + 1 + N / 2 + 1));
        assert_eq!(point.state(1), [0.1, 0.0, 1.0, 0.0]);
        assert_eq!(point.state(N)[1], 1.1);
        // The second episode alone.
        let second = Options { episodes: Some("1..2".parse().unwrap()), ..key("cell") };
        assert_eq!(of(name, &second).demonstration, demonstration(&[(cells(N / 2), false)]));
        for (ends, flags) in [(Ends::Terminal, [true, true]), (Ends::CutOff, [false, false])] {
            let marked = of(name, &Options { ends, ..key("cell") }).demonstration;
            assert_eq!([0, 1].map(|i| marked.terminal(i)), flags);
        }
    }
    let single = of("minari-arrow/1/part-0.arrow", &key("cell")).demonstration;
    assert_eq!(single, demonstration(&[(cells(N / 2), false)]));
}

#[test]
fn d4rl_holds_the_states_before_the_actions() {
    let imported = of("d4rl.hdf5", &Options::default());
    assert_eq!(imported.demonstration, demonstration(&[(cells(N - 1), false), (cells(N / 2 - 1), false)]));
    assert!(imported.notes[0].starts_with("1 episodes were terminated, but"), "{:?}", imported.notes);
    let marked = of("d4rl.hdf5", &Options { ends: Ends::Terminal, ..Options::default() });
    assert!(marked.demonstration.terminal(0) && marked.notes.is_empty());
    // With next_observations the last state is known.
    let successors = of("d4rl-successors.hdf5", &Options::default());
    assert_eq!(successors.demonstration, demonstration(&[(cells(N), true), (cells(N / 2), false)]));
    assert_eq!(successors.notes, [] as [String; 0]);
    // Without timeouts the second episode ends with the file.
    let none = of("d4rl-no-timeouts.hdf5", &Options::default());
    assert_eq!(none.demonstration, imported.demonstration);
    assert!(none.notes.iter().any(|note| note.starts_with("no timeouts")), "{:?}", none.notes);
    assert_eq!(of("d4rl.hdf5", &key("infos/qpos")).demonstration.state(1), [1.5, 0.5]);
    assert!(refused(&golden("d4rl.hdf5"), &key("actions")).contains("--key is `actions`; accepted"));
}

#[test]
fn arrays_of_numpy() {
    assert_eq!(of("one.npy", &Options::default()).demonstration, demonstration(&[(cells(N), false)]));
    let two = of("two.npy", &Options { ends: Ends::Terminal, ..Options::default() });
    let back = cells(N).into_iter().rev().collect();
    assert_eq!(two.demonstration, demonstration(&[(cells(N), true), (back, true)]));
    assert!(two.notes.is_empty());
}

/// Two files that differ in actions and rewards alone give the same demonstration, to the byte of the file it is
/// written to.
#[test]
fn actions_and_rewards_leave_no_trace() {
    let dir = tempfile::tempdir().unwrap();
    let written = |name: &str, options: &Options| {
        let out = dir.path().join("out.csv");
        demo_file::write(&out, &of(name, options).demonstration).unwrap();
        fs::read(&out).unwrap()
    };
    for (one, other, options) in [
        ("minari-hdf5", "minari-hdf5-other-actions", key("cell")),
        ("minari-arrow", "minari-arrow-other-actions", key("observation")),
        ("d4rl.hdf5", "d4rl-gzip-other-actions.hdf5", Options::default()),
    ] {
        let data = |name: &str| {
            let path = golden(name);
            let file = [path.join("main_data.hdf5"), path.join("0/part-0.arrow"), path];
            fs::read(file.iter().find(|path| path.is_file()).unwrap()).unwrap()
        };
        assert_ne!(data(one), data(other), "the sources differ");
        assert_eq!(written(one, &options), written(other, &options), "{one}");
    }
    let csv = |reward: &str, action: &str| {
        let path = dir.path().join("in.csv");
        let rows = format!("x,action,reward,terminated\n1,{action},{reward},0\n2,{action},{reward},1\n");
        fs::write(&path, rows).unwrap();
        let out = dir.path().join("out.csv");
        demo_file::write(&out, &import(&path, &columns("x")).unwrap().demonstration).unwrap();
        fs::read(&out).unwrap()
    };
    assert_eq!(csv("0.5", "2"), csv("-1e9", "north"));
    assert_eq!(csv("0.5", "2"), b"trajectory,terminal,x\n0,0,1\n0,1,2\n");
}

#[test]
fn what_is_asked_for_must_be_there() {
    for name in ["minari-hdf5", "minari-arrow"] {
        let refused = |options| refused(&golden(name), &options);
        let message = refused(Options::default());
        assert!(message.contains(", episode 0: --key is missing"), "{message}");
        assert!(message.ends_with("accepted: one of cell, observation"), "{message}");
        assert!(refused(key("position")).contains("--key is `position`; accepted: one of cell, observation"));
        assert!(refused(key("cell/x")).contains("--key is `cell/x`"));
        let wide = Options { columns: Some("0..3".parse().unwrap()), ..key("cell") };
        assert!(refused(wide).contains("--columns is 2; accepted: 0 to 1"));
        let many = Options { episodes: Some("1..9".parse().unwrap()), ..key("cell") };
        assert!(refused(many).contains("--episodes is 1..9; accepted: up to 0..2"));
    }
    assert!(refused(&golden("one.npy"), &key("x")).contains("--key"));
    assert!(refused(&golden(""), &Options::default()).contains("this folder is no data set of Minari"));
    assert!(
        refused(Path::new("/nonexistent/x.npy"), &Options::default()).starts_with("/nonexistent/x.npy: ")
    );
}

#[test]
fn tables_of_others() {
    let dir = tempfile::tempdir().unwrap();
    let with = |text: &str, options: &Options| {
        let path = dir.path().join("t.csv");
        fs::write(&path, text).unwrap();
        import(&path, options).map_err(|error| {
            let text = error.to_string();
            text.split_once("t.csv")
                .map_or(text.clone(), |(_, rest)| rest.trim_start_matches([',', ':', ' ']).into())
        })
    };
    // Without a column of episodes their ends divide them.
    let text = "t,x,y,terminated,truncated\n0,1,2,0,0\n1,3,4,1,0\n2,5,6,False,False\n3,7,8,False,True\n";
    let imported = with(text, &columns("x,y")).unwrap().demonstration;
    assert_eq!(imported.names(), ["x", "y"]);
    assert_eq!(imported.states(), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]);
    assert!(imported.n_trajectories() == 2 && imported.terminal(0) && !imported.terminal(1));
    let second = Options { episodes: Some("1..2".parse().unwrap()), ..columns("1..3") };
    assert_eq!(with(text, &second).unwrap().demonstration.states(), [5.0, 6.0, 7.0, 8.0]);
    // With one, its changes do; an episode of one state holds no transition.
    let text = "episode,x,terminated\na,1,0\na,2,0\nb,3,0\nc,4,0\nc,5,1\n";
    let imported = with(text, &columns("x")).unwrap();
    assert_eq!(imported.demonstration.states(), [1.0, 2.0, 4.0, 5.0]);
    assert_eq!(imported.notes, ["1 episodes of a single state left out: they hold no transition"]);
    // The project's own form needs no choice, and comes back as it is.
    let own = "trajectory,terminal,x,y\n0,0,1,2\n0,1,3,4\n";
    assert_eq!(with(own, &Options::default()).unwrap().demonstration.states(), [1.0, 2.0, 3.0, 4.0]);

    let refused = |text: &str, options: &Options| with(text, options).unwrap_err();
    assert!(
        refused("x,y\n1,2\n", &Options::default()).contains("--columns is missing; accepted: --columns with")
    );
    let message = refused("x,Action_0\n1,2\n", &columns("0..2"));
    assert!(
        message.starts_with("row 1: --columns is `Action_0`; accepted: columns of the state"),
        "{message}"
    );
    assert!(
        refused("x\n1\nNaN\n", &columns("x")).starts_with("episode 0, row 3: x is `NaN`; accepted: a finite")
    );
    assert!(refused("x\n1\n1e39\n", &columns("x")).contains("row 3: x is `1e39`"));
    assert!(
        refused("x,y\n1,2\n1\n", &columns("x")).contains("row 3: the number of columns is 1; accepted: 2")
    );
    assert!(
        refused("episode,x\n0,1\n0,2\n1,3\n1,4\n0,5\n", &columns("x"))
            .contains("episode 2, row 6: episode is `0`")
    );
    assert!(refused("x,terminated\n1,maybe\n", &columns("x")).contains("row 2: terminated is `maybe`"));
    let early = "episode,x,terminated\n0,1,1\n0,2,0\n";
    assert!(refused(early, &columns("x")).contains("episode 0, row 2: the terminal flag is 1"));
    assert!(refused("x\n", &columns("x")).contains("every episode is shorter than two states"));
    assert!(refused("", &columns("x")).contains("the file is empty"));
}

/// Files that end early, and one with a NaN: refused with what is wrong, never a panic.
#[test]
fn damaged_files_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    for (name, options) in [
        ("d4rl.hdf5", Options::default()),
        ("d4rl-gzip-other-actions.hdf5", Options::default()),
        ("minari-hdf5/main_data.hdf5", key("cell")),
        ("minari-arrow/0/part-0.arrow", key("cell")),
        ("one.npy", Options::default()),
        ("two.npy", Options::default()),
    ] {
        let whole = fs::read(golden(name)).unwrap();
        let path = dir.path().join("damaged");
        for length in (1..40).map(|part| whole.len() * part / 40) {
            fs::write(&path, &whole[..length]).unwrap();
            let message = refused(&path, &options);
            assert!(
                message.contains("damaged") || message.contains("cut off"),
                "{name}, {length}: {message}"
            );
        }
    }
    let whole = fs::read(golden("one.npy")).unwrap();
    let path = dir.path().join("nan.npy");
    let mut bytes = whole.clone();
    let at = bytes.len() - 12;
    bytes[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    fs::write(&path, &bytes).unwrap();
    let message = refused(&path, &Options::default());
    assert!(message.contains(&format!("nan.npy, episode 0, row {}: column 1 is NaN", N - 1)), "{message}");
    // Where the state is not asked for, it does no harm.
    assert_eq!(import(&path, &columns("0")).unwrap().demonstration.dim(), 1);
}

proptest::proptest! {
    #![proptest_config(proptest::prelude::ProptestConfig::with_cases(200))]
    /// Bytes that are not what they were: some other demonstration or a refusal, never a panic.
    #[test]
    fn changed_bytes_are_survived(
        which in 0..4_usize,
        changes in proptest::collection::vec((proptest::prelude::any::<proptest::sample::Index>(), proptest::prelude::any::<u8>()), 1..8),
    ) {
        let (name, options) = [
            ("d4rl-gzip-other-actions.hdf5", Options::default()),
            ("minari-hdf5/main_data.hdf5", key("cell")),
            ("minari-arrow/0/part-0.arrow", key("cell")),
            ("two.npy", Options::default()),
        ][which].clone();
        let mut bytes = fs::read(golden(name)).unwrap();
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("changed");
        fs::write(&path, &bytes).unwrap();
        let _ = import(&path, &options);
    }
}
