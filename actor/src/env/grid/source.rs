//! Where a map comes from: compiled in, a file, or the generator.

use super::GridError;
use super::generate::Generator;
use super::map::{Map, MapError, MapFault};
use std::path::Path;
use trestle_proto::limits::{MAX_MAP_SIDE, MAX_TEXT_BYTES};
use trestle_proto::names;
use trestle_proto::regular_file::{self, NotText};

/// The maps that are compiled in: name and text. `maze30` is the paper's; `maze-small` is ours, with shortest paths of
/// 34 (regular) and 35 (irregular) moves. `umaze`, `medium` and `large` are D4RL's mazes with its goals, the starts ours.
const BUILTIN: [(&str, &str); 5] = [
    ("maze30", include_str!("../../../maps/maze30.txt")),
    ("maze-small", include_str!("../../../maps/maze-small.txt")),
    ("umaze", include_str!("../../../maps/umaze.txt")),
    ("medium", include_str!("../../../maps/medium.txt")),
    ("large", include_str!("../../../maps/large.txt")),
];

/// Names of the compiled-in maps, for people.
pub(super) fn builtin_names() -> String {
    BUILTIN.map(|(name, _)| name).join(", ")
}

/// What `env.map` accepts.
pub const ACCEPTED: &str = "maze30, maze-small, umaze, medium, large, a file, or `random:<seed>:<columns>x<rows>`; in the place \
    of `random` also corridors-1, corridors-2, corridors-3, serpentine-1, serpentine-2, serpentine-3, rooms, cave, blocks, gap";

/// Names of the generators, for people.
pub(super) fn generator_names() -> String {
    Generator::ALL.map(|(_, name, _)| name).join(", ")
}

/// The map of resolved settings: that of `text`, which `name` names.
///
/// # Errors
/// There is no text, or it is no map.
pub fn map_of(name: &str, text: Option<&str>) -> Result<Map, GridError> {
    Ok(Map::parse(name, text.ok_or(GridError::Unresolved)?)?)
}

/// Reads or generates the map called `name` and writes its text to `text`. `seed` is the run's seed, for maps that are random
/// by it.
///
/// A text that is already there, because the settings were resolved before, is checked against the map: a built-in or random
/// map, or a file that still exists, must be the same. Where the file is gone the text stands.
///
/// # Errors
/// An unknown name, an unreadable file, a text that is no map, or a text that is another map.
pub fn resolve(name: &str, text: &mut Option<String>, seed: u64) -> Result<(), GridError> {
    if let Some(text) = text {
        let given = Map::parse("env.map_text", text)?;
        let gone = generated(name, seed)?.is_none() && !Path::new(name).exists();
        if !gone && load(name, seed)? != given {
            return Err(GridError::Text { name: name.into() });
        }
        return Ok(());
    }
    *text = Some(load(name, seed)?.to_string());
    Ok(())
}

/// The map called `name`.
fn load(name: &str, seed: u64) -> Result<Map, GridError> {
    match generated(name, seed)? {
        Some(map) => Ok(map),
        None => Ok(Map::parse(name, &read(name)?)?),
    }
}

/// The map called `name` if it is compiled in or random.
fn generated(name: &str, seed: u64) -> Result<Option<Map>, GridError> {
    if let Some((_, text)) = BUILTIN.iter().find(|(known, _)| *known == name) {
        return Ok(Some(Map::parse(name, text)?));
    }
    let Some((kind, description)) = name.split_once(':') else { return Ok(None) };
    let Some(generator) = Generator::of_name(kind) else { return Ok(None) };
    let (seed, columns, rows) = random(generator, description, seed)
        .ok_or_else(|| GridError::RandomMap { name: name.into(), least: generator.min_side() })?;
    Ok(Some(generator.generate(seed, columns, rows)))
}

/// Seed, columns and rows in `<seed>:<columns>x<rows>`; the seed `run` is the run's.
fn random(generator: Generator, description: &str, run_seed: u64) -> Option<(u64, usize, usize)> {
    let (seed, size) = description.split_once(':')?;
    let (columns, rows) = size.split_once('x')?;
    let seed = if seed == "run" { run_seed } else { seed.parse().ok()? };
    let sides = generator.min_side()..=MAX_MAP_SIDE;
    let side = |text: &str| text.parse().ok().filter(|side| sides.contains(side));
    Some((seed, side(columns)?, side(rows)?))
}

/// The text of the map file `name`.
fn read(name: &str) -> Result<String, GridError> {
    let bytes = regular_file::read(Path::new(name), MAX_TEXT_BYTES).map_err(|error| match error {
        error if error.is_not_found() => {
            let generator = || {
                let (typed, rest) = name.split_once(':')?;
                let meant = names::nearest(typed, Generator::ALL.map(|(_, known, _)| known))?;
                Some(format!("; did you mean `{meant}:{rest}`?"))
            };
            let hint = generator().unwrap_or_else(|| names::hint(name, BUILTIN.map(|(known, _)| known)));
            GridError::UnknownMap { name: name.into(), hint }
        }
        error => GridError::ReadMap(error),
    })?;
    regular_file::decode(bytes).map_err(|NotText { line, column }| {
        MapError { origin: name.into(), line, column, fault: MapFault::NotText }.into()
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::fs;

    fn refused(map: &str) -> String {
        resolve(map, &mut None, 0).unwrap_err().to_string()
    }

    #[test]
    fn all_built_in_maps_are_named_as_accepted() {
        assert!(ACCEPTED.starts_with(&builtin_names()));
        assert!(Generator::ALL.iter().all(|(_, name, _)| ACCEPTED.contains(name)));
        assert!(refused("maze-smal").ends_with("did you mean `maze-small`?"));
        assert!(refused("radnom:1:10x10").ends_with("did you mean `random:1:10x10`?"));
        assert!(refused("serpentine-4:run:9x9").ends_with("did you mean `serpentine-1:run:9x9`?"));
    }

    #[test]
    fn every_kind_of_map_is_found() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("mine.txt");
        fs::write(&path, "S.\r\n.G").unwrap();
        let layout = |map: &str, seed| {
            let mut text = None;
            resolve(map, &mut text, seed).unwrap();
            text.unwrap()
        };
        assert_eq!(layout("maze30", 0), BUILTIN[0].1);
        assert_eq!(layout("maze-small", 0), BUILTIN[1].1);
        assert_eq!(layout(path.to_str().unwrap(), 0), "S.\n.G\n");
        // As editors on other systems save it.
        let wide: Vec<u8> = "\u{feff}S.\r\n.G\r\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
        fs::write(&path, wide).unwrap();
        assert_eq!(layout(path.to_str().unwrap(), 0), "S.\n.G\n");
        assert_eq!(layout("random:7:9x5", 1), layout("random:7:9x5", 2));
        assert_eq!(layout("random:run:9x5", 7), layout("random:7:9x5", 0));
        assert_eq!(layout("cave:run:9x12", 7), Generator::Cave.generate(7, 9, 12).to_string());
        assert_eq!(Map::parse("m", &layout("random:7:9x5", 0)).unwrap().columns(), 9);
    }

    #[test]
    fn what_is_no_map_is_refused() {
        assert!(refused("no-such.txt").contains(
            "accepted: maze30, maze-small, umaze, medium, large, an existing file, or <generator>:"
        ));
        for bad in [
            "random:",
            "random:1",
            "random:x:9x9",
            "random:1:9",
            "random:1:3x9",
            "random:1:9x1001",
            "random:-1:9x9",
        ] {
            assert!(refused(bad).contains("accepted: <generator>:<seed>:<columns>x<rows>"), "{bad}");
        }
        assert!(refused("rooms:1:7x9").contains("8 to 1000 columns and rows"));
        assert!(refused("labyrinth:1:9x9").contains("env.map = labyrinth:1:9x9; accepted: maze30"));
        let dir = tempfile::tempdir().unwrap();
        assert!(refused(dir.path().to_str().unwrap()).contains("is a directory; accepted: a regular file"));
        let path = dir.path().join("bytes.txt");
        fs::write(&path, b"S.\n.\xff").unwrap();
        let name = path.to_str().unwrap();
        assert!(refused(name).contains(&format!("map {name}, line 2, column 2: bytes that are not UTF-8")));
        fs::write(&path, "S.\n.?\n").unwrap();
        assert!(refused(name).contains(&format!("map {name}, line 2, column 2: '?'")));
        fs::File::create(&path).unwrap().set_len(MAX_TEXT_BYTES + 1).unwrap();
        assert!(refused(name).contains("accepted: up to 16777216"));
    }

    #[test]
    fn a_text_must_agree_with_its_map() {
        let mut text = None;
        resolve("maze-small", &mut text, 0).unwrap();
        let first = text.clone();
        resolve("maze-small", &mut text, 0).unwrap();
        assert_eq!(text, first);
        let other = resolve("maze30", &mut text, 0).unwrap_err().to_string();
        assert!(other.contains("not the map that env.map = maze30 names"), "{other}");
        resolve("gone.txt", &mut text, 0).unwrap();
        assert_eq!(text, first);
        let broken = resolve("gone.txt", &mut Some("S.".into()), 0).unwrap_err().to_string();
        assert!(broken.starts_with("map env.map_text, line 1, column 2"), "{broken}");
    }
}
