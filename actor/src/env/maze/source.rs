//! Where a map comes from: compiled in, a file, or the generator.

use super::generate::{MIN_SIDE, generate};
use super::map::{Map, MapError, MapFault};
use crate::env::EnvError;
use std::fs;
use std::path::Path;
use trestle_proto::config;
use trestle_proto::limits::{MAX_MAP_SIDE, MAX_TEXT_BYTES};
use trestle_proto::rng::{Purpose, stream};

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
pub(in crate::env) fn builtin_names() -> String {
    BUILTIN.map(|(name, _)| name).join(", ")
}

/// Reads or generates the map that `env.map` names and writes its text to `env.layout`; see
/// [`crate::env::resolve`].
///
/// A layout that is already there, because the configuration was resolved before, is checked against the map: a
/// built-in or random map, or a file that still exists, must be the same. Where the file is gone the layout stands.
///
/// # Errors
/// An unknown name, an unreadable file, a text that is no map, or a layout that is another map.
pub fn resolve(env: &mut config::Env, seed: u64) -> Result<(), EnvError> {
    if let Some(text) = &env.layout {
        let given = Map::parse("env.layout", text)?;
        let gone = generated(&env.map, seed)?.is_none() && !Path::new(&env.map).exists();
        if !gone && load(&env.map, seed)? != given {
            return Err(EnvError::Layout { name: env.map.clone() });
        }
        return Ok(());
    }
    env.layout = Some(load(&env.map, seed)?.to_string());
    Ok(())
}

/// The map called `name`.
fn load(name: &str, seed: u64) -> Result<Map, EnvError> {
    match generated(name, seed)? {
        Some(map) => Ok(map),
        None => Ok(Map::parse(name, &read(name)?)?),
    }
}

/// The map called `name` if it is compiled in or random.
fn generated(name: &str, seed: u64) -> Result<Option<Map>, EnvError> {
    if let Some((_, text)) = BUILTIN.iter().find(|(known, _)| *known == name) {
        return Ok(Some(Map::parse(name, text)?));
    }
    let Some(description) = name.strip_prefix("random:") else { return Ok(None) };
    let (seed, columns, rows) =
        random(description, seed).ok_or_else(|| EnvError::RandomMap { name: name.into() })?;
    Ok(Some(generate(columns, rows, &mut stream(seed, Purpose::Map, 0))))
}

/// Seed, columns and rows in `<seed>:<columns>x<rows>`; the seed `run` is the run's.
fn random(description: &str, run_seed: u64) -> Option<(u64, usize, usize)> {
    let (seed, size) = description.split_once(':')?;
    let (columns, rows) = size.split_once('x')?;
    let seed = if seed == "run" { run_seed } else { seed.parse().ok()? };
    let side = |text: &str| text.parse().ok().filter(|side| (MIN_SIDE..=MAX_MAP_SIDE).contains(side));
    Some((seed, side(columns)?, side(rows)?))
}

/// The text of the map file `name`.
fn read(name: &str) -> Result<String, EnvError> {
    let path = Path::new(name);
    let fault = |message: String| EnvError::ReadMap { path: path.into(), message };
    let meta = fs::metadata(path).map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => EnvError::UnknownMap { name: name.into() },
        _ => fault(e.to_string()),
    })?;
    if !meta.is_file() {
        return Err(fault("not a file; accepted: a text file".into()));
    }
    if meta.len() > MAX_TEXT_BYTES {
        return Err(EnvError::MapBytes { path: path.into(), bytes: meta.len() });
    }
    let bytes = fs::read(path).map_err(|e| fault(e.to_string()))?;
    String::from_utf8(bytes).map_err(|e| not_text(name, &e).into())
}

/// Where the first bytes that are no text lie.
fn not_text(name: &str, error: &std::string::FromUtf8Error) -> MapError {
    let sound = String::from_utf8_lossy(&error.as_bytes()[..error.utf8_error().valid_up_to()]);
    let line = sound.split('\n').count();
    let column = sound.rsplit('\n').next().map_or(0, |last| last.chars().count()) + 1;
    MapError { origin: name.into(), line, column, fault: MapFault::NotText }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn env(map: &str) -> config::Env {
        config::Env { map: map.into(), ..config::Env::default() }
    }

    fn refused(map: &str) -> String {
        resolve(&mut env(map), 0).unwrap_err().to_string()
    }

    #[test]
    fn every_kind_of_map_is_found() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("mine.txt");
        fs::write(&path, "S.\r\n.G").unwrap();
        let layout = |map: &str, seed| {
            let mut env = env(map);
            resolve(&mut env, seed).unwrap();
            env.layout.unwrap()
        };
        assert_eq!(layout("maze30", 0), BUILTIN[0].1);
        assert_eq!(layout("maze-small", 0), BUILTIN[1].1);
        assert_eq!(layout(path.to_str().unwrap(), 0), "S.\n.G\n");
        assert_eq!(layout("random:7:9x5", 1), layout("random:7:9x5", 2));
        assert_eq!(layout("random:run:9x5", 7), layout("random:7:9x5", 0));
        assert_eq!(Map::parse("m", &layout("random:7:9x5", 0)).unwrap().columns(), 9);
    }

    #[test]
    fn what_is_no_map_is_refused() {
        assert!(
            refused("no-such.txt")
                .contains("accepted: maze30, maze-small, umaze, medium, large, an existing file, or random:")
        );
        for bad in [
            "random:",
            "random:1",
            "random:x:9x9",
            "random:1:9",
            "random:1:3x9",
            "random:1:9x1001",
            "random:-1:9x9",
        ] {
            assert!(refused(bad).contains("accepted: random:<seed>:<columns>x<rows>"), "{bad}");
        }
        let dir = tempfile::tempdir().unwrap();
        assert!(refused(dir.path().to_str().unwrap()).contains("not a file"));
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
    fn a_layout_must_agree_with_its_map() {
        let mut again = env("maze-small");
        resolve(&mut again, 0).unwrap();
        let first = again.clone();
        resolve(&mut again, 0).unwrap();
        assert_eq!(again, first);
        let mut other = config::Env { map: "maze30".into(), ..first.clone() };
        assert!(
            resolve(&mut other, 0)
                .unwrap_err()
                .to_string()
                .contains("not the map that env.map = maze30 names")
        );
        let mut gone = config::Env { map: "gone.txt".into(), ..first.clone() };
        resolve(&mut gone, 0).unwrap();
        assert_eq!(gone.layout, first.layout);
        gone.layout = Some("S.".into());
        assert!(
            resolve(&mut gone, 0).unwrap_err().to_string().starts_with("map env.layout, line 1, column 2")
        );
    }
}
