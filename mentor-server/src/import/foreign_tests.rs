//! Files with traits that readers trip over, written by h5py and NumPy: see `tests/golden/foreign.py`.

#![allow(clippy::unwrap_used)]
use super::*;
use flate2::Compression;
use flate2::write::GzEncoder;
use nix::sys::stat::Mode;
use nix::unistd::mkfifo;
use std::fs;
use std::io::Write;

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/golden/foreign").join(name)
}

fn keyed(key: &str) -> Options {
    Options { key: Some(key.into()), ..Options::default() }
}

fn columns(text: &str) -> Options {
    Options { columns: Some(text.parse().unwrap()), ..Options::default() }
}

fn refused(name: &str, options: &Options) -> String {
    import(&golden(name), options).unwrap_err().to_string()
}

/// The states of each trajectory, and whether its last is terminal.
type Trajectories = Vec<(Vec<f32>, bool)>;

fn trajectories(imported: &Imported) -> Trajectories {
    let demo = &imported.demonstration;
    let of = |i: usize| (demo.trajectory(i).flat_map(|m| demo.state(m).to_vec()).collect(), demo.terminal(i));
    (0..demo.n_trajectories()).map(of).collect()
}

fn of(name: &str, options: &Options) -> (Trajectories, Vec<String>) {
    let imported = import(&golden(name), options).unwrap();
    (trajectories(&imported), imported.notes)
}

fn numbers(range: std::ops::Range<u8>) -> Vec<f32> {
    range.map(f32::from).collect()
}

/// Two episodes of three states, as most files hold them.
fn two() -> Trajectories {
    vec![(numbers(0..6), false), (numbers(6..12), false)]
}

#[test]
fn valid_hdf5_is_read_however_it_is_stored() {
    for name in [
        "user-block",
        "user-block-latest",
        "float16",
        "float16-big-endian",
        "float64-big-endian",
        "enumeration",
        "soft-link-needed-earliest",
        "soft-link-needed-latest",
        "external-link-earliest",
        "external-link-latest",
        "flat-episode_id",
    ] {
        assert_eq!(of(&format!("{name}.hdf5"), &Options::default()).0, two(), "{name}");
    }
    // Episodes in groups of both styles, some of them behind soft links: so many that a heap and a tree hold their names.
    for name in ["many-links-earliest", "many-links-latest"] {
        let (found, notes) = of(&format!("{name}.hdf5"), &Options::default());
        assert!(found.len() == 300 && notes.is_empty(), "{name}: {} episodes", found.len());
        for (i, (states, terminal)) in found.into_iter().enumerate() {
            let first = (i % 5) as f32;
            assert_eq!(
                (states, terminal),
                (vec![first, first + 1.0, first + 2.0, first + 3.0], true),
                "{name}"
            );
        }
    }
    // Through a link to a group, one of whose own links leads back to it.
    assert_eq!(of("soft-link-to-group.hdf5", &keyed("joints")).0, two());
    assert_eq!(of("soft-link-to-group.hdf5", &keyed("kept/again/demo_*/obs/joints")).0, two());
}

#[test]
fn what_the_library_cannot_read_is_named_with_a_way_out() {
    for (name, words) in [
        ("virtual", &["virtual dataset", "h5py", "plain.hdf5"][..]),
        (
            "newest-layout",
            &["part of HDF5 that is not known here (invalid data layout version: 5)", "h5py.File"],
        ),
        ("external-storage", &["another file (external storage)"]),
        ("filter", &["compressed with Blosc (filter 32001)", "hdf5plugin"]),
        (
            "external-link-needed-earliest",
            &[
                "`/observations` is a link to `/observations` in the file `states.hdf5`",
                "h5py.File(\"plain.hdf5\"",
            ],
        ),
        (
            "external-link-needed-latest",
            &[
                "`/observations` is a link to `/observations` in the file `states.hdf5`",
                "h5py.File(\"plain.hdf5\"",
            ],
        ),
        // Two episodes are there, but not all.
        ("external-episode-earliest", &["`/episode_2` is a link to `/episode_2` in the file `others.hdf5`"]),
        ("external-episode-latest", &["`/episode_2` is a link to `/episode_2` in the file `others.hdf5`"]),
        (
            "soft-link-dangling",
            &["/observations is a soft link to `/nothing`, which is not in the file; accepted: a link"],
        ),
        ("soft-link-loop", &["is a soft link that leads to itself"]),
        ("flat-without-flags", &["what ends an episode is missing", "--key takes all rows as one episode"]),
    ] {
        let message = refused(&format!("{name}.hdf5"), &Options::default());
        assert!(words.iter().all(|word| message.contains(word)), "{name}: {message}");
        assert!(!message.contains("damaged"), "{name}: {message}");
    }
    let records = refused("records.hdf5", &keyed("log/steps"));
    assert!(records.contains("records (compound{x: f32") && records.contains("[\"log/steps\"]"), "{records}");
    let (one, notes) = of("flat-without-flags.hdf5", &keyed("observations"));
    assert_eq!(one, [(numbers(0..12), false)]);
    assert_eq!(notes, ["no flags in the file: all rows are one episode"]);
}

#[test]
fn flags_end_episodes_whatever_they_are_called() {
    for name in ["dones", "is_last"] {
        let (found, notes) = of(&format!("flat-{name}.hdf5"), &Options::default());
        assert_eq!(found, two(), "{name}");
        assert!(notes[0].contains("2 episodes end with a flag that does not say whether"), "{notes:?}");
    }
    let (found, notes) = of("dones.npz", &Options::default());
    assert_eq!(found, two());
    assert!(notes[0].contains("does not say whether"), "{notes:?}");
}

#[test]
fn episodes_end_where_positions_or_lengths_say() {
    for name in ["ends", "last-rows", "starts", "lengths"] {
        let (found, notes) = of(&format!("{name}.npz"), &Options::default());
        assert_eq!(found, two(), "{name}");
        assert!(notes[0].contains("says where episodes end, but not how") && notes.len() == 1, "{notes:?}");
    }
    assert_eq!(of("ends-in-meta.hdf5", &keyed("data/state")).0, two());
    let wrong = refused("wrong-lengths.npz", &Options::default());
    assert!(wrong.contains("episode_lengths is 2 numbers, for 6 states"), "{wrong}");
    // The state after the last step is there.
    let one = vec![(numbers(0..12), true)];
    assert_eq!(of("one-more.npz", &Options::default()).0, one);
    let several = refused("one-more-of-several.npz", &Options::default());
    assert!(several.contains("terminals is 5 numbers, for 6 states; accepted: one a state"), "{several}");
    // Flags beside the states, in a folder of their own.
    assert_eq!(of("folders.npz", &keyed("a/obs")).0, two());
    assert_eq!(of("folders.npz", &keyed("b/obs")).0, [(numbers(0..12), false)]);
    assert_eq!(of("trajectory.npz", &keyed("traj")).0, [(numbers(0..12), false)]);
    let (axes, notes) = of("axes.hdf5", &Options::default());
    assert_eq!(axes, two());
    assert_eq!(notes, ["each of the 6 rows is an array of 1 x 2: its 2 numbers are the features of a state"]);
    let table = refused("pandas-table.hdf5", &Options::default());
    assert!(table.contains("a table of pandas") && table.contains("pandas.read_hdf(\""), "{table}");
}

#[test]
fn other_layouts_are_known_or_reached_by_their_paths() {
    // The first episode knows its last state from the next observations.
    let whole = (vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0], false);
    for key in ["joints", "data/demo_*/obs/joints", "data.demo_*.obs.joints", "/data/demo_*/obs/joints/"] {
        let (found, notes) = of("robomimic.hdf5", &keyed(key));
        assert_eq!(found, [whole.clone(), (numbers(6..12), false)], "{key}");
        assert!(
            notes.iter().any(|note| note.starts_with("1 episodes have as many observations as steps")),
            "{notes:?}"
        );
    }
    assert!(refused("robomimic.hdf5", &Options::default()).contains(
        "--key is missing, and the observations are a dictionary; accepted: one of joints, object"
    ));
    assert!(
        refused("robomimic.hdf5", &keyed("data/demo_*/actions")).contains("actions and rewards are no part")
    );
    let nothing = refused("robomimic.hdf5", &keyed("data/demo_*/obs/nothing"));
    assert!(
        nothing.contains("which matches nothing") && nothing.contains("data/demo_*/obs/joints"),
        "{nothing}"
    );
    for key in ["observations/qpos", "/observations/qpos", "observations.qpos"] {
        assert_eq!(of("aloha.hdf5", &keyed(key)).0, [(numbers(0..12), false)], "{key}");
    }
    let missing = refused("aloha.hdf5", &Options::default());
    assert!(missing.ends_with("accepted: a path, such as observations/qpos, observations/qvel"), "{missing}");
    // A dataset beside the observations, by its path in an episode.
    for key in ["next_obs/joints", "data/demo_*/next_obs/joints"] {
        let one = Options { episodes: Some("0".parse().unwrap()), ..keyed(key) };
        assert_eq!(of("robomimic.hdf5", &one).0, [(numbers(2..8), false)], "{key}");
    }
    for key in ["agent/qpos", "obs/agent/qpos", "traj_*/obs/agent/qpos"] {
        assert_eq!(
            of("maniskill.hdf5", &keyed(key)).0,
            [(numbers(0..6), true), (numbers(6..12), false)],
            "{key}"
        );
    }
    // Zeros before the numbers of episodes, in the order of the numbers.
    let (padded, notes) = of("padded-names.hdf5", &Options::default());
    assert!(
        padded.len() == 11 && padded[10].0[0] == 100.0 && padded[10].1 && !padded[9].1 && notes.is_empty()
    );
    let some = Options { episodes: Some("0..2,9".parse().unwrap()), ..Options::default() };
    assert_eq!(
        of("padded-names.hdf5", &some).0.iter().map(|(states, _)| states[0]).collect::<Vec<_>>(),
        [0.0, 10.0, 90.0]
    );
}

#[test]
fn arrays_of_every_kind_are_read_or_named() {
    assert_eq!(of("float16.npy", &Options::default()).0, [(numbers(0..12), false)]);
    let (records, notes) = of("records.npy", &columns("x,y"));
    assert_eq!(records, two());
    assert!(notes[0].starts_with("`done` ends episodes, but does not say"), "{notes:?}");
    assert_eq!(of("records.npy", &columns("v_1,v_0")).0[0].0, [0.0, 1.0, 0.0, 5.0, 0.0, 9.0]);
    assert!(refused("records.npy", &Options::default()).contains("--columns is missing"));
    for (name, words) in [
        ("long-double", &["more than 64 bits", "astype(\"f8\")"][..]),
        ("fortran", &["Fortran's order", "ascontiguousarray"]),
        ("flat", &["the number of axes is 1", "a[:, None]"]),
        ("text", &["an array of texts", "astype(\"f4\")"]),
    ] {
        let message = refused(&format!("{name}.npy"), &Options::default());
        assert!(words.iter().all(|word| message.contains(word)), "{name}: {message}");
    }
    assert_eq!(of("flat.npz", &Options::default()), (two(), vec![]));
    let ends = |first: u8| -> Vec<f32> { (first..first + 8).map(f32::from).collect() };
    let (successors, notes) = of("successors.npz", &Options::default());
    assert_eq!((successors, notes), (vec![(ends(0), true), (ends(6), true)], vec![]));
    assert_eq!(of("episodes.npz", &keyed("arr_*")).0, two());
    assert!(
        refused("episodes.npz", &Options::default())
            .contains("--key is missing; accepted: one of arr_0, arr_1")
    );
    assert_eq!(of("batched.npz", &Options::default()).0, two());
    assert_eq!(grid(&golden("gym-maze.npy"), 9).unwrap(), [[0.0, 2.0], [8.0, 1.0]]);
    assert_eq!(grid(&golden("grid.npy"), 9).unwrap().len(), 3);
    assert!(grid(&golden("grid.npy"), 3).unwrap_err().to_string().contains("1 to 3 each"));
    let drawn = grid(&golden("text.npy"), 9).unwrap_err().to_string();
    assert!(drawn.contains("numpy.savetxt(\"map.txt\", numpy.load(\"") && !drawn.contains("f4"), "{drawn}");
}

#[test]
fn tables_in_every_writing_give_the_same_demonstration() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("t.csv");
    let with = |bytes: &[u8], options: &Options| {
        fs::write(&path, bytes).unwrap();
        import(&path, options)
            .map(|imported| (trajectories(&imported), imported.notes))
            .map_err(|e| e.to_string())
    };
    let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
    packed.write_all(b"x,y\n0,1\n2,3\n").unwrap();
    let wide: Vec<u8> = "\u{feff}x;y\r\n0;1\r\n2;3".encode_utf16().flat_map(u16::to_le_bytes).collect();
    for bytes in [
        &packed.finish().unwrap()[..],
        &wide,
        b"# x y\n0 1\n2 3\n",
        b"x\ty\n0,0\t1,0\n2,0\t3,0\n",
        b"\n\nx,y\n\n0,1\n2,3\n",
    ] {
        assert_eq!(with(bytes, &columns("x,y")).unwrap().0, [(numbers(0..4), false)], "{bytes:?}");
    }
    // A flag of any name, and a first row of an episode, end the one before.
    for (text, terminal) in [
        ("x,done\n0,0\n1,1\n5,0\n6,1\n", false),
        ("x,is_first\n0,1\n1,0\n5,True\n6,False\n", false),
        ("x,terminated,truncated\n0,0,0\n1,1,0\n5,0,0\n6,1,0\n", true),
        ("x,done,timeout\n0,0,0\n1,1,0\n5,0,0\n6,1,0\n", true),
        ("t,x\n0,0\n1,1\n0,5\n1,6\n", false),
        ("episode_index;x\n0;0\n0;1\n1;5\n1;6\n", false),
    ] {
        let expected = vec![(vec![0.0, 1.0], terminal), (vec![5.0, 6.0], terminal)];
        assert_eq!(with(text.as_bytes(), &columns("x")).unwrap().0, expected, "{text}");
    }
    for (text, options, words) in [
        ("x,y,x\n1,2,3\n", columns("y"), "`x` is the name of columns 0, 2; accepted: each name once"),
        (
            "x,done,dones,terminal,terminated\n1,0,0,0,0\n",
            columns("x"),
            "columns `terminal` and `terminated`",
        ),
        ("episode,x,done\n0,1,1\n0,2,0\n", columns("x"), "row 2: done is 1; accepted: 0 before the last row"),
        ("x;y\n0,5;1.5\n", columns("x,y"), "y is `1.5`; accepted: a finite"),
        ("0,1\n1,1\n", columns("0,1"), "accepted: --header yes, or --header no"),
        ("{\"x\": 1}\n{\"x\": 2}\n", columns("x"), "this is JSON, which is not read; `python3"),
    ] {
        let message = with(text.as_bytes(), &options).unwrap_err();
        assert!(message.contains(words), "{message}");
    }
    // A message is short whatever the file is.
    let wide = format!("{}\n{}\n", vec!["name"; 100_000].join("x,"), "1,".repeat(99_999) + "1");
    let message = with(wide.as_bytes(), &columns("y")).unwrap_err();
    assert!(message.len() < 2000, "{} bytes", message.len());
}

#[test]
fn only_regular_files_are_read() {
    let dir = tempfile::tempdir().unwrap();
    let (fifo, sparse) = (dir.path().join("fifo"), dir.path().join("sparse"));
    mkfifo(&fifo, Mode::S_IRWXU).unwrap();
    let message = |path: &Path| import(path, &Options::default()).unwrap_err().to_string();
    assert!(message(&fifo).ends_with(
        "is a pipe (FIFO); accepted: a regular file; write what comes out of the pipe into a file first"
    ));
    assert!(message(Path::new("/dev/zero")).contains("/dev/zero is a device"));
    fs::File::create(&sparse).unwrap().set_len(MAX_SOURCE_BYTES + 1).unwrap();
    assert!(message(&sparse).contains("accepted: up to 1099511627776"));
    fs::File::create(&sparse).unwrap().set_len(1 << 36).unwrap();
    assert!(message(&sparse).contains("neither text nor a format that is known"));
}
