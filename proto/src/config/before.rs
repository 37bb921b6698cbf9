//! Configurations as they were written before. Version 0.1.0: `[env]` had the settings of all environments side by side, and
//! `kind` chose one. Later, one of `trestle` named its guide, which went along when the file was used with another algorithm.

use toml::{Table, Value};

/// Settings of an environment whose name has changed.
const RENAMED: [(&str, &str); 1] = [("layout", "map_text")];
/// Settings that all environments share, then as now.
const SHARED: [&str; 3] = ["step_limit", "encoding", "hazard"];

/// Settings that are gone, by table.
const REMOVED: [(&str, &str); 1] = [("supervise", "one_cpu")];

/// Gives `config` today's form if it has a former one.
pub(super) fn translate(config: &mut Table) {
    free_guide(config);
    // Without it, a file that leaves the environment to its base or to the default reads the same in either form.
    let Some(Value::String(kind)) = config.get("env").and_then(|env| env.get("kind")).cloned() else {
        return;
    };
    for (table, key) in REMOVED {
        config.get_mut(table).and_then(Value::as_table_mut).map(|table| table.remove(key));
    }
    let Some(Value::Table(env)) = config.get_mut("env") else { return };
    env.remove("kind");
    // An environment's table had its name with underscores; where it had one, it wins over `[env]`.
    let table = kind.replace('-', "_");
    let mut own = Table::new();
    let keys: Vec<String> = env.keys().filter(|key| !SHARED.contains(&key.as_str())).cloned().collect();
    let mut inner = Table::new();
    for key in keys {
        match env.remove(&key) {
            Some(Value::Table(values)) if key == table => inner = values,
            // The table of an environment that was not chosen.
            Some(Value::Table(_)) if key != "action_sets" => {}
            Some(value) => {
                let name =
                    RENAMED.iter().find(|(former, _)| *former == key).map_or(key.as_str(), |(_, now)| now);
                own.insert(name.into(), value);
            }
            None => {}
        }
    }
    own.extend(inner);
    env.insert("name".into(), Value::String(kind.clone()));
    env.insert(kind, Value::Table(own));
}

/// `trestle` accepts one guide, so that its name says nothing there: other algorithms are not to take it over.
fn free_guide(config: &mut Table) {
    let of = |table: &str, key: &str| config.get(table)?.get(key)?.as_str();
    if of("run", "algo") == Some("trestle") && of("exploration", "guide") == Some("learned") {
        let exploration = config.get_mut("exploration").and_then(Value::as_table_mut);
        exploration.map(|exploration| exploration.insert("guide".into(), "auto".into()));
    }
}
