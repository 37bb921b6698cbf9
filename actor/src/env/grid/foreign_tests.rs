//! Each form against maps that are known.

#![allow(clippy::unwrap_used)]

use super::*;
use proptest::prelude::*;

const NONE: Choices = Choices { start: None, goal: None, zero_is_wall: false };

fn ends(start: Cell, goal: Cell) -> Choices {
    Choices { start: Some(start), goal: Some(goal), ..NONE }
}

fn map(text: &str, choices: &Choices) -> String {
    of_text("m", text, choices).unwrap().map.to_string()
}

fn refused(text: &str, choices: &Choices) -> String {
    of_text("m", text, choices).unwrap_err().to_string()
}

#[test]
fn grids_of_characters_and_digits() {
    let expected = "#####\n#S..#\n#.#G#\n#####\n";
    let with_ends = ends([1, 1], [3, 2]);
    for text in [
        "11111\n10001\n10101\n11111\n",
        "1 1 1 1 1\r\n1 0 0 0 1\r\n1 0 1 0 1\r\n1 1 1 1 1",
        "1,1,1,1,1\n1,0,0,0,1\n1,0,1,0,1\n1,1,1,1,1\n",
        "\u{feff}\n1;1;1;1;1\n1;0;0;0;1\n1;0;1;0;1\n1;1;1;1;1\n\n",
        "1.0e+00 1.0 1 1 1\n1 0.000e+00 0 0 1\n1 0 1 0 1\n1 1 1 1 1\n",
        "#####\n#   #\n# # #\n#####\n",
        "XXXXX\nX...X\nX.X.X\nXXXXX\n",
    ] {
        assert_eq!(map(text, &with_ends), expected, "{text:?}");
    }
    assert_eq!(map("#####\n#S..#\n#.#G#\n#####", &NONE), expected);
    assert_eq!(map("1 1 1 1 1\n1 S 0 0 1\n1 0 1 G 1\n1 1 1 1 1", &NONE), expected);
    // Blanks at the ends of lines are mostly cut off.
    assert_eq!(map("#####\n#S  \n# #G#\n#####", &NONE), "#####\n#S...\n#.#G#\n#####\n");
    let turned = Choices { zero_is_wall: true, ..with_ends };
    assert_eq!(map("00000\n01110\n01010\n00000\n", &turned), expected);
    let notes = of_text("m", "01\n00", &ends([0, 0], [1, 1])).unwrap().notes;
    assert_eq!(notes, ["1 is a wall and 0 is free; --walls 0 takes them the other way round"]);
}

#[test]
fn strings_of_d4rl() {
    let expected = "#####\n#G..#\n###.#\n#S..#\n#####\n";
    let start = Choices { start: Some([1, 3]), ..NONE };
    for text in [
        r"#####\#GOO#\###O#\#OOO#\#####",
        "\"#####\\\\#GOO#\\\\###O#\\\\#OOO#\\\\#####\"",
        "U_MAZE = \\\n        \"#####\\\\\"+\\\n        \"#GOO#\\\\\"+\\\n        \"###O#\\\\\"+\\\n        \"#OOO#\\\\\"+\\\n        \"#####\"\n",
    ] {
        assert_eq!(map(text, &start), expected, "{text}");
    }
    assert!(refused("A = \"##\"\nB = \"##\"\n", &NONE).contains("several maps in one file"));
}

#[test]
fn lists_of_gymnasium_robotics() {
    let expected = "#####\n#S..#\n###.#\n#G..#\n#####\n";
    for text in [
        "[[1, 1, 1, 1, 1], [1, \"r\", 0, 0, 1], [1, 1, 1, 0, 1], [1, \"g\", 0, 0, 1], [1, 1, 1, 1, 1]]",
        "U_MAZE = [[1, 1, 1, 1, 1],\n          [1, R, 0, 0, 1],  # [a row]\n          [1, 1, 1, 0, 1],\n          [1, G, 0, 0, 1],\n          [1, 1, 1, 1, 1]]\n",
        "[\"#####\", \"#S..#\", \"###.#\", \"#G..#\", \"#####\"]",
        "((1, 1, 1, 1, 1), [1, 'r', 0, 0, 1], [1, 1, 1, 0, 1], [1, 'g', 0, 0, 1], [1, 1, 1, 1, 1])",
    ] {
        assert_eq!(map(text, &NONE), expected, "{text}");
    }
    // Cells for either, of which two are the ends.
    let both = "[[1, 1, 1, 1], [1, \"c\", \"c\", 1], [1, 1, 1, 1]]";
    assert!(
        refused(both, &NONE).contains("start is at 1,1, then 2,1; accepted: --start COLUMN,ROW, from 0,0")
    );
    assert_eq!(map(both, &Choices { start: Some([2, 1]), ..NONE }), "####\n#GS#\n####\n");
    assert!(refused("[[[1]]]", &NONE).contains("more than two brackets"));
    assert!(refused("A = [[1]]\nB = [[1]]", &NONE).contains("several maps"));
    assert!(refused("[[1, 2]]", &NONE).contains("line 1: a cell is `2`"));
    assert!(refused("[[1, 1], [1]]", &NONE).contains("the number of cells is 1"));
}

#[test]
fn drawings_of_micromouse_mazes() {
    let text = "+---+---+\n|S      |\n+---+   +\n|     G |\n+---+---+\n";
    let expected = "#####\n#S..#\n###.#\n#..G#\n#####\n";
    assert_eq!(map(text, &NONE), expected);
    assert_eq!(map(&text.replace('+', "o").replace('\n', "\r\n"), &NONE), expected);
    // Two characters a cell, blanks cut off, indented.
    assert_eq!(map("\n  +--+--+\n  |S    |\n  +--+  +\n  |    G|\n  +--+--+\n\n", &NONE), expected);
    // Ends are cells of the drawing.
    let bare = text.replace(['S', 'G'], " ");
    assert_eq!(map(&bare, &ends([0, 0], [1, 1])), expected);
    assert!(
        refused(&bare, &NONE)
            .contains("start is missing; accepted: --start COLUMN,ROW, from 0,0 at the top left to 1,1")
    );
    assert!(refused(&bare, &ends([0, 0], [2, 1])).contains("goal is 2,1, outside of the map"));
    let imported = of_text("m", text, &NONE).unwrap();
    assert!(
        imported.notes[0].contains("2 x 2 cells: its cell c,r is the map's 2c+1,2r+1"),
        "{:?}",
        imported.notes
    );
    // The four cells in the middle of a contest's maze are all the goal.
    let centre = "+---+---+\n| G   G |\n+   +   +\n|S    G |\n+---+---+\n";
    assert!(refused(centre, &NONE).contains("goal is at 0,0, then 1,0, then 1,1"));
    assert!(refused("+---+\n| 7 |\n+---+\n", &NONE).contains("line 2: a cell is `7`"));
    assert!(refused("+---+\n|   |\n", &NONE).contains("without its last row of corners"));
}

#[test]
fn walls_of_gym_maze() {
    // From the top left to the right, then down: the second cell was entered from the west, the fourth from the north. Only
    // the cell that was entered says so; the first axis is the column.
    let cells = [vec![0.0, 2.0], vec![8.0, 1.0]];
    let imported = of_numbers("m", &cells, &NONE).unwrap();
    assert_eq!(imported.map.to_string(), "#####\n#S..#\n###.#\n#..G#\n#####\n");
    assert!(imported.notes[0].contains("the start is 0,0, as is usual"));
    assert_eq!(imported.form, "gym-maze's walls");
    assert!(
        of_numbers("m", &[vec![0.0, 2.0], vec![0.0, 0.0]], &NONE)
            .unwrap_err()
            .to_string()
            .contains("neither 0 and 1 alone")
    );
    let grid = [vec![1.0, 0.0, 0.0], vec![1.0, 1.0, 0.0]];
    assert_eq!(of_numbers("m", &grid, &ends([1, 0], [2, 1])).unwrap().map.to_string(), "#S.\n##G\n");
    assert!(of_numbers("m", &[vec![0.0, 16.0]], &NONE).unwrap_err().to_string().contains("a number is 16"));
    assert!(of_numbers("m", &[vec![0.5]], &NONE).unwrap_err().to_string().contains("a number is 0.5"));
}

#[test]
fn ends_must_be_there_once_and_free() {
    assert!(
        refused("000\n000", &NONE)
            .contains("m: start is missing; accepted: --start COLUMN,ROW, from 0,0 at the top left to 2,1")
    );
    assert!(refused("000\n000", &Choices { start: Some([0, 0]), ..NONE }).contains("m: goal is missing"));
    assert!(refused("010\n000", &ends([1, 0], [2, 1])).contains("start is 1,0, a wall"));
    assert!(refused("S.S\n..G", &NONE).contains("start is at 0,0, then 2,0"));
    assert!(refused("", &NONE).contains("it is empty"));
    assert!(refused("S?\n.G", &NONE).contains("line 1: a cell is `?`"));
    assert!(of_text("m", "000\n000", &ends([0, 0], [0, 0])).is_err());
}

proptest! {
    /// Whatever it is, it is a map or a refusal.
    #[test]
    fn any_text_is_survived(text in "[#.SG01rgc,; \\[\\]()\"'\\\\+o|=\n-]{0,80}") {
        if let Ok(imported) = of_text("m", &text, &NONE) {
            prop_assert_eq!(Map::parse("m", &imported.map.to_string()).unwrap(), imported.map);
        }
    }

    #[test]
    fn our_own_maps_come_back(map in crate::env::grid::tests::any_map()) {
        let lists: Vec<Vec<String>> =
            map.to_string().lines().map(|line| line.chars().map(String::from).collect()).collect();
        let drawn = map.to_string();
        prop_assert_eq!(&of_text("m", &drawn, &NONE).unwrap().map, &map);
        let nested = format!("{lists:?}");
        prop_assert_eq!(&of_text("m", &nested, &NONE).unwrap().map, &map);
    }
}
