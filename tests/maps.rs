//! `trestle map import`: from other people's maps to one that a run can start with.

use crate::util::{Place, trestle};
use nix::sys::stat::Mode;
use nix::unistd::mkfifo;
use std::fs;
use std::path::Path;

fn golden(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/foreign").join(name).display().to_string()
}

#[test]
fn every_form_becomes_a_map_that_a_run_can_start_with() {
    let place = Place::new();
    let expected = "#####\n#S..#\n###.#\n#G..#\n#####\n";
    let ends = ["--start", "1,1", "--goal", "1,3"];
    let sources: [(&str, &str, &[&str]); 6] = [
        ("grid.txt", "1 1 1 1 1\n1 0 0 0 1\n1 1 1 0 1\n1 0 0 0 1\n1 1 1 1 1\n", &ends),
        (
            "other.txt",
            "\u{feff}\n00000\n01110\n00010\n01110\n00000\n\n",
            &["--walls", "0", "--start", "1,1", "--goal", "1,3"],
        ),
        ("d4rl.txt", "\"#####\\\\#OOO#\\\\###O#\\\\#GOO#\\\\#####\"", &["--start", "1,1"]),
        (
            "lists.py",
            "MAP = [[1, 1, 1, 1, 1], [1, R, 0, 0, 1], [1, 1, 1, 0, 1], [1, G, 0, 0, 1], [1, 1, 1, 1, 1]]",
            &[],
        ),
        ("mouse.txt", "o---o---o\n|S      |\no---o   o\n| G     |\no---o---o\n", &[]),
        ("own.txt", expected, &[]),
    ];
    for (name, text, args) in sources {
        let (source, out) = (place.write(name, text), place.path(&format!("{name}.map")));
        let said = trestle(&[&["map", "import", &source, "--out", &out], args].concat()).ok();
        assert_eq!(fs::read_to_string(&out).unwrap(), expected, "{name}");
        assert!(said.stdout.contains("5 columns, 5 rows, 7 free cells, start 1,1, goal 1,3"), "{said:?}");
        let set = format!("env.map={out}");
        trestle(&["config", "check", "maze-small", "--set", &set, "--set", "env.actions=regular"]).ok();
    }
    let out = place.path("gym.map");
    let said = trestle(&["map", "import", &golden("gym-maze.npy"), "--out", &out]).ok();
    assert!(
        said.stdout.contains("gym-maze's walls") && said.stdout.contains("the start is 0,0, as is usual"),
        "{said:?}"
    );
    assert_eq!(fs::read_to_string(&out).unwrap(), "#####\n#S..#\n###.#\n#..G#\n#####\n");
    let args = ["map", "import", &golden("grid.npy"), "--out", &out, "--start", "1,1", "--goal", "2,1"];
    trestle(&args).refused(&["gym.map exists", "--overwrite"]);
    trestle(&[&args[..], &["--overwrite"]].concat()).ok();
    assert_eq!(fs::read_to_string(&out).unwrap(), "####\n#SG#\n####\n");
}

#[test]
fn what_is_missing_or_unknown_is_said_and_nothing_is_written() {
    let place = Place::new();
    let out = place.path("out.txt");
    let import =
        |source: &str, args: &[&str]| trestle(&[&["map", "import", source, "--out", &out], args].concat());
    let grid = place.write("grid.txt", "000\n010\n000\n");
    import(&grid, &[]).refused(&["start is missing", "--start COLUMN,ROW", "0,0 at the top left to 2,2"]);
    import(&grid, &["--start", "0,0", "--goal", "1,1"]).refused(&["goal is 1,1, a wall"]);
    import(&grid, &["--start", "0"]).refused(&["--start", "accepted: two whole numbers"]);
    import(&place.write("odd.txt", "..?\nS.G\n"), &[]).refused(&["odd.txt, line 1", "`?`"]);
    import(&golden("float16.npy"), &[]).refused(&["0 and 1 alone"]);
    import(&golden("records.npy"), &[]).refused(&["an array of numbers"]);
    let fifo = place.path("fifo");
    mkfifo(Path::new(&fifo), Mode::S_IRWXU).unwrap();
    import(&fifo, &[]).refused(&["fifo is a pipe (FIFO); accepted: a regular file"]);
    import("/dev/zero", &[]).refused(&["/dev/zero is a device"]);
    // The same where a map, a demonstration or a table is read.
    let map = format!("env.map={fifo}");
    trestle(&["config", "check", "maze-small", "--set", &map]).refused(&["is a pipe (FIFO)"]);
    let demo = format!("mentor.demo={fifo}");
    trestle(&["config", "check", "maze-small", "--set", &demo]).refused(&["is a pipe (FIFO)"]);
    trestle(&["demo", "import", &fifo, "--out", &out]).refused(&["is a pipe (FIFO)"]);
    // A goal that is out of reach is no reason not to write, but to warn.
    let apart = place.write("apart.txt", "S#.\n##.\n..G\n");
    let said = import(&apart, &[]).ok();
    assert!(said.stdout.contains("warning: map") && said.stdout.contains("cannot be reached"), "{said:?}");
}
