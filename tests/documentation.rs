//! The tables of docs/configuration.md are those of the settings' declarations, and docs/algorithm.md has the table of selection
//! rules. docs/protocol.md has the version of each message, and the quoted refusals are those of the program.
//!
//! `TRESTLE_WRITE_DOCS=1 cargo test --test integration documentation` writes them anew.

use crate::util::{Place, trestle};
use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use trestle_actor::env::registry;
use trestle_hosts::message::{GRANT_KIND, HELLO_KIND};
use trestle_learner::checkpoint;
use trestle_proto::acting::ActingHeader;
use trestle_proto::batch::BatchHeader;
use trestle_proto::codec::{self, Kind};
use trestle_proto::config::{self, Environments, Setting, Table, declared, listed};
use trestle_proto::message::Message;
use trestle_proto::observe::{ObserveAnswer, ObserveRequest};
use trestle_proto::orders::Orders;
use trestle_proto::plan::{PLAN_KIND, RunPlan};
use trestle_proto::query::{QueryAnswer, QueryRequest};
use trestle_proto::reply::{EVALUATION_KIND, ReplyHeader};

const PATH: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/configuration.md");
/// What stands before a table, with the key of the settings' table, and after it.
const BEGIN: &str = "<!-- settings of ";
const END: &str = "<!-- end of settings -->\n";

/// Settings as rows of a table.
fn rows<'a>(settings: impl Iterator<Item = &'a Setting>) -> String {
    let mut text = "\n| key | default | accepted | meaning |\n|---|---|---|---|\n".to_string();
    for setting in settings {
        let meanings = setting.choices.iter().fold(String::new(), |text, (word, meaning)| {
            format!("{text}<br>`{word}`: {}", meaning.strip_suffix('.').unwrap_or(meaning))
        });
        let cells = [
            format!("`{}`", setting.name()),
            match setting.default.as_str() {
                "none" => "none".into(),
                default => format!("`{default}`"),
            },
            setting.accepted.clone(),
            format!("{}{meanings}", setting.help),
        ];
        let cells = cells.map(|cell| cell.replace('|', "\\|"));
        writeln!(text, "| {} |", cells.join(" | ")).unwrap();
    }
    text + "\n"
}

#[test]
fn every_setting_is_documented_as_it_is_declared() {
    let settings = declared(registry());
    let text = fs::read_to_string(PATH).unwrap();
    let mut parts = text.split(BEGIN);
    let mut written = parts.next().unwrap().to_string();
    let mut tables = BTreeSet::new();
    for part in parts {
        let (table, rest) = part.split_once(" -->\n").unwrap();
        let (_, after) = rest.split_once(END).unwrap();
        let of_table = settings.iter().filter(|setting| setting.table() == table);
        assert!(of_table.clone().next().is_some() && tables.insert(table), "{table}");
        write!(written, "{BEGIN}{table} -->\n{}{END}{after}", rows(of_table)).unwrap();
    }
    let missing: Vec<_> = settings.iter().filter(|setting| !tables.contains(setting.table())).collect();
    assert!(missing.is_empty(), "no table for {missing:?}");
    if std::env::var_os("TRESTLE_WRITE_DOCS").is_some() {
        return fs::write(PATH, &written).unwrap();
    }
    assert!(written == text, "docs/configuration.md is out of date: see the head of tests/documentation.rs");
}

#[test]
fn the_table_of_selection_rules_is_documented() {
    const PATH: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/algorithm.md");
    const BEGIN: &str = "<!-- selection rules -->\n";
    const END: &str = "<!-- end of selection rules -->\n";
    let text = fs::read_to_string(PATH).unwrap();
    let (before, rest) = text.split_once(BEGIN).unwrap();
    let (_, after) = rest.split_once(END).unwrap();
    let mut table =
        "\n| rule | loss | it remembers | `draw` | `combine` | `reward` |\n|---|---|---|---|---|---|\n"
            .to_string();
    for rule in registry().selections() {
        let (draws, combines, rewards) = (listed(rule.draws), listed(rule.combines), listed(rule.rewards));
        let (about, remembers) = (rule.about.trim_end_matches('.'), rule.remembers);
        writeln!(table, "| `{}` | {about} | {remembers} | {draws} | {combines} | {rewards} |", rule.name)
            .unwrap();
    }
    let written = format!("{before}{BEGIN}{table}\n{END}{after}");
    if std::env::var_os("TRESTLE_WRITE_DOCS").is_some() {
        return fs::write(PATH, &written).unwrap();
    }
    assert!(written == text, "docs/algorithm.md is out of date: see the head of tests/documentation.rs");
}

#[test]
fn every_preset_is_documented() {
    let text = fs::read_to_string(PATH).unwrap();
    for preset in registry().presets() {
        let row = format!("| `{}` | {} |", preset.name, preset.about());
        assert!(text.contains(&row), "docs/configuration.md lacks: {row}");
    }
}

fn page(name: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs").join(name)).unwrap()
}

/// The page has the type name of `M`, with its version, and the size of `M` in the heading of its layout.
fn is_documented<M: Message>(page: &str) {
    let name = M::TYPE_NAME.split('.').nth(1).unwrap();
    let heading = format!("\n### `{name}`, {} bytes\n", size_of::<M>());
    assert!(page.contains(&format!("`{}`", M::TYPE_NAME)), "docs/protocol.md lacks {}", M::TYPE_NAME);
    assert!(page.contains(&heading), "docs/protocol.md lacks: {heading}");
}

#[test]
fn every_message_is_documented_with_its_version_and_size() {
    let page = page("protocol.md");
    is_documented::<BatchHeader>(&page);
    is_documented::<ActingHeader>(&page);
    is_documented::<Orders>(&page);
    is_documented::<ReplyHeader>(&page);
    is_documented::<ObserveRequest>(&page);
    is_documented::<ObserveAnswer>(&page);
    is_documented::<QueryRequest>(&page);
    is_documented::<QueryAnswer>(&page);
    for Kind { magic, version } in [EVALUATION_KIND, PLAN_KIND, HELLO_KIND, GRANT_KIND] {
        let frame = format!("`{}`, version {version}", String::from_utf8_lossy(&magic).replace('\0', "\\0"));
        assert!(page.contains(&frame), "docs/protocol.md lacks: {frame}");
    }
}

#[test]
fn refusals_are_quoted_as_they_are_said() {
    let reliability = page("reliability.md");
    let said = |text: String| assert!(reliability.contains(&text), "docs/reliability.md lacks: {text}");
    let wrong: [&[&str]; 4] = [
        &["learner.gamma=1.5"],
        &["learner.lr=fast"],
        &["learner.gama=0.9"],
        &["env.hazard.kind=abort", "env.hazard.after=0"],
    ];
    for sets in wrong {
        let sets: Vec<String> = sets.iter().copied().chain(["run.episodes=1"]).map(String::from).collect();
        said(config::from_table(registry(), Table::new(), &sets).unwrap_err().to_string());
    }
    said(RunPlan::decode(b"rubbish").unwrap_err().to_string());
    let newer = Kind { version: PLAN_KIND.version + 1, ..PLAN_KIND };
    let newer = RunPlan::decode(&codec::encode(newer, &()).unwrap()).unwrap_err().to_string();
    let formats = format!("accepted: 4 to {}", checkpoint::FORMAT);
    let versions = page("versions.md");
    assert!(versions.contains(&newer) && versions.contains(&formats), "{newer} {formats}");
    said(newer);
    said(formats);
}

/// The program of docs/own-environment.md is the one that a documentation test compiles.
#[test]
fn the_environment_of_the_page_compiles() {
    let read = |path: &str| fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).unwrap();
    let (page, source) = (read("docs/own-environment.md"), read("deploy/program.rs"));
    let between = |text: &str, begin: &str, end: &str| {
        let (_, rest) = text.split_once(begin).unwrap();
        rest.split_once(end).unwrap().0.to_string()
    };
    let compiled = between(&source, "/// ```no_run\n", "/// ```\n");
    let compiled: String =
        compiled.lines().map(|line| format!("{}\n", line[3..].trim_start_matches(' '))).collect();
    let shown = between(&page, "```rust\n", "```\n");
    let shown: String = shown.lines().map(|line| format!("{}\n", line.trim_start_matches(' '))).collect();
    assert_eq!(shown, compiled);
}

/// An environment is its folder and a line of the registry: nothing else names its modules.
#[test]
fn nothing_but_the_registry_names_an_environment() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let modules: Vec<String> = registry().names().iter().map(|name| name.replace('-', "_")).collect();
    let mut sources = Vec::new();
    for part in [
        "actor",
        "algorithm",
        "benches",
        "deploy",
        "examples",
        "learner",
        "mentor-server",
        "proto",
        "qnet",
        "tests",
    ] {
        rust_files(&root.join(part), &mut sources);
    }
    assert!(sources.len() > 100, "{}", sources.len());
    for path in sources {
        let text = fs::read_to_string(&path).unwrap();
        let below = path.strip_prefix(root.join("actor/src/env"));
        for module in &modules {
            let own = below.as_ref().is_ok_and(|path| path.starts_with(module));
            let home = below.as_ref().is_ok_and(|path| *path == Path::new("mod.rs"));
            let named = text.contains(&format!("env::{module}")) || text.contains(&format!(" {module}::"));
            assert!(own || home || !named, "{} names the environment `{module}`", path.display());
        }
    }
}

fn rust_files(dir: &Path, found: &mut Vec<PathBuf>) {
    let Ok(entries) = fs::read_dir(dir) else { return };
    for path in entries.map(|entry| entry.unwrap().path()) {
        if path.ends_with("deploy/python") {
            // The half of an environment that is a project of its own.
        } else if path.is_dir() {
            rust_files(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

#[test]
fn settings_are_listed_and_found() {
    let _place = Place::new();
    let all = trestle(&["config", "list"]).ok().stdout;
    assert!(declared(registry()).iter().all(|setting| all.contains(&format!("{}: ", setting.key))), "{all}");
    let one = trestle(&["config", "list", "run.mode"]).ok().stdout;
    assert!(
        one.starts_with("run.mode: choice, default \"lockstep\", accepted: lockstep, free, reference\n"),
        "{one}"
    );
    assert!(
        one.contains("    reference: The same algorithm in one process") && !one.contains("run.actors"),
        "{one}"
    );
    let table = trestle(&["config", "list", "eval"]).ok().stdout;
    assert!(table.contains("eval.tolerance: number, default 0.5, accepted: 0 or more\n"), "{table}");
    let changed = trestle(&["config", "list", "gym"]).ok().stdout;
    assert!(
        changed.contains("env.step_limit: whole number, 10000 with gym, elsewhere default 4000"),
        "{changed}"
    );
    assert!(changed.contains("run.algo:") && !changed.contains("learner.gamma:"), "{changed}");
    trestle(&["config", "list", "lerner"]).refused(&["lerner", "did you mean `learner`?"]);
    trestle(&["config", "list", "gamma"]).refused(&["gamma", "did you mean `learner.gamma`?"]);
}

#[test]
fn help_names_presets_defaults_and_choices() {
    let _place = Place::new();
    let help = trestle(&["train", "--help"]).ok().stdout;
    for words in ["maze-small   A 12 x 12 maze", "[run.seed, default 0]", "dqn:", "Deep Q-network, no mentor"]
    {
        assert!(help.contains(words), "{words}: {help}");
    }
    for (args, near) in [
        (["train", "maze-small", "--algo", "ha-diqn"], "ha-diiqn"),
        (["train", "maze-small", "--mode", "lock-step"], "lockstep"),
        (["train", "mazesmall", "--algo", "dqn"], "maze-small"),
        (["train", "maze-small", "--set", "lerner.lr=1"], "learner"),
        (["train", "maze-small", "--set", "env.encoding=onehot"], "one-hot"),
    ] {
        trestle(&args).refused(&[&format!("did you mean `{near}`?")]);
    }
}
