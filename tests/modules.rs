//! No modules use each other in a circle: of two modules side by side, at most one builds on the other. A module may name what
//! its parent holds, and a parent its children.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// A module's place in its crate, from the root down.
type Place = Vec<String>;
/// For each module the modules beside it that it uses, under the place of their parent.
type Uses = BTreeMap<Place, BTreeMap<String, BTreeSet<String>>>;

#[test]
fn no_modules_use_each_other_in_a_circle() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut crates = Vec::new();
    find_crates(root, &mut crates);
    assert!(crates.len() >= 12, "{crates:?}");
    let mut circles = Vec::new();
    for home in crates {
        for (parent, uses) in uses(&home) {
            for module in uses.keys().filter(|module| reached(&uses, module).contains(*module)) {
                circles.push(format!("{} {}::{module}", home.display(), parent.join("::")));
            }
        }
    }
    assert!(circles.is_empty(), "in a circle: {circles:#?}");
}

/// The directories with a `lib.rs` below `dir`.
fn find_crates(dir: &Path, found: &mut Vec<PathBuf>) {
    if dir.join("lib.rs").exists() {
        found.push(dir.into());
    }
    for path in entries(dir) {
        let hidden = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
        if path.is_dir() && !hidden && path.file_name() != Some("target".as_ref()) {
            find_crates(&path, found);
        }
    }
}

fn entries(dir: &Path) -> Vec<PathBuf> {
    fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().path()).collect()
}

/// What the modules of the crate in `home` use beside themselves.
fn uses(home: &Path) -> Uses {
    let mut files = Vec::new();
    find_modules(home, &mut files);
    let place = |file: &PathBuf| place(file.strip_prefix(home).unwrap());
    let modules: BTreeSet<Place> = files
        .iter()
        .map(place)
        .flat_map(|place| (0..=place.len()).map(move |len| place[..len].to_vec()))
        .collect();
    let mut uses = Uses::new();
    for file in &files {
        let own = place(file);
        for named in named(&fs::read_to_string(file).unwrap(), &own) {
            let known = (0..=named.len()).rev().find(|&len| modules.contains(&named[..len])).unwrap_or(0);
            let shared = own.iter().zip(&named[..known]).take_while(|(a, b)| a == b).count();
            if shared < own.len() && shared < known {
                let beside = uses.entry(own[..shared].to_vec()).or_default();
                beside.entry(own[shared].clone()).or_default().insert(named[shared].clone());
            }
        }
    }
    uses
}

/// The source files of a crate; those of tests may use anything, and a directory with a manifest is another crate's.
fn find_modules(dir: &Path, found: &mut Vec<PathBuf>) {
    for path in entries(dir) {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            if name != "tests" && name != "target" && !path.join("Cargo.toml").exists() {
                find_modules(&path, found);
            }
        } else if name.ends_with(".rs") && !name.ends_with("tests.rs") && name != "testing.rs" {
            found.push(path);
        }
    }
}

fn place(file: &Path) -> Place {
    let mut place: Place = file.with_extension("").iter().map(|part| part.to_string_lossy().into()).collect();
    if ["mod", "lib", "main"].contains(&place[place.len() - 1].as_str()) {
        place.pop();
    }
    place
}

/// What `text`, the file of the module at `own`, names from `crate` or `super` on; not in comments, nor in its tests.
fn named(text: &str, own: &[String]) -> Vec<Place> {
    let code = text.split("#[cfg(test)]\nmod tests").next().unwrap();
    let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
    let code: String = lines.flat_map(|line| [line, "\n"]).collect();
    let mut all = Vec::new();
    for start in ["crate::", "super::"] {
        for (at, _) in code.match_indices(start) {
            let before = code[..at].chars().next_back();
            let within = before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == '$');
            if !within && !code[..at].ends_with("super::") {
                let supers = code[at..].split("super::").take_while(|part| part.is_empty()).count();
                let rest = code[at..].trim_start_matches("super::").trim_start_matches("crate::");
                let base = if start == "crate::" { 0 } else { own.len().saturating_sub(supers) };
                read_paths(rest, own[..base].to_vec(), &mut all);
            }
        }
    }
    all
}

/// Reads a path, or a tree of paths in braces, at the beginning of `text`. Returns what comes after.
fn read_paths<'a>(text: &'a str, mut so_far: Place, all: &mut Vec<Place>) -> &'a str {
    let mut rest = text.trim_start();
    loop {
        if let Some(mut inner) = rest.strip_prefix('{') {
            while !inner.starts_with('}') && !inner.is_empty() {
                inner = read_paths(inner, so_far.clone(), all);
                // The rest of what stands here, such as `as name`.
                let end = inner.find([',', '}']).unwrap_or(inner.len());
                inner = inner[end..].trim_start_matches(',').trim_start();
            }
            return inner.strip_prefix('}').unwrap_or(inner);
        }
        let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
        let (word, after) = rest.split_at(end);
        if word != "self" && !word.is_empty() {
            so_far.push(word.into());
        }
        match after.strip_prefix("::") {
            Some(next) if !word.is_empty() => rest = next,
            _ => {
                all.push(so_far);
                return after;
            }
        }
    }
}

/// The modules that `module` uses, and those that they use in turn.
fn reached(uses: &BTreeMap<String, BTreeSet<String>>, module: &str) -> BTreeSet<String> {
    let (mut reached, mut next) = (BTreeSet::new(), vec![module.to_string()]);
    while let Some(module) = next.pop() {
        for used in uses.get(&module).into_iter().flatten() {
            if reached.insert(used.clone()) {
                next.push(used.clone());
            }
        }
    }
    reached
}

#[test]
fn circles_are_seen() {
    let own = ["a".to_string(), "b".to_string()];
    let text = "use crate::x::{self, y::{Z, W as V}};\nuse super::c::D;\n// use crate::no;\nlet e = super::super::f(1);\n";
    let expected: [&[&str]; 5] = [&["x"], &["x", "y", "Z"], &["x", "y", "W"], &["a", "c", "D"], &["f"]];
    assert_eq!(
        named(text, &own),
        expected.map(|place| place.iter().map(ToString::to_string).collect::<Vec<_>>())
    );
    let uses = [("a", "b"), ("b", "c"), ("c", "a"), ("d", "a")];
    let uses: BTreeMap<_, _> =
        uses.iter().map(|(from, to)| (from.to_string(), BTreeSet::from([to.to_string()]))).collect();
    assert!(["a", "b", "c"].iter().all(|module| reached(&uses, module).contains(*module)));
    assert!(!reached(&uses, "d").contains("d"));
}
