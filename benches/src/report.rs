//! What a benchmark found, as JSON and as a table.

use serde::ser::{Serialize, SerializeMap, Serializer};
use serde_json::Value;
use std::fs;
use trestle_qnet::Isa;

/// One benchmark's outcome.
#[derive(serde::Serialize)]
pub(super) struct Report {
    pub(super) name: String,
    pub(super) machine: Machine,
    pub(super) rows: Vec<Row>,
}

/// Where it was measured.
#[derive(serde::Serialize)]
pub(super) struct Machine {
    cpu: String,
    cores: usize,
    isa: String,
    kernel: String,
    profile: &'static str,
    /// Mean number of processes that wanted a core during the minute before.
    load_average: Option<f64>,
}

/// One line: names and values, in the order in which they are shown.
pub(super) struct Row(Vec<(&'static str, Value)>);

impl Row {
    pub(super) fn new() -> Self {
        Self(Vec::new())
    }

    /// With one more column.
    pub(super) fn with(mut self, name: &'static str, value: impl Into<Value>) -> Self {
        self.0.push((name, value.into()));
        self
    }

    /// With one more column, a measured number, to four digits; null if there is none.
    pub(super) fn measured(self, name: &'static str, value: impl Into<Option<f64>>) -> Self {
        let value = value.into().map(|x: f64| format!("{x:.3e}").parse().unwrap_or(x));
        self.with(name, value)
    }
}

impl Serialize for Row {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.0.len()))?;
        for (name, value) in &self.0 {
            map.serialize_entry(name, value)?;
        }
        map.end()
    }
}

impl Machine {
    pub(super) fn new() -> Self {
        let read = |path: &str| fs::read_to_string(path).unwrap_or_default();
        let cpu = read("/proc/cpuinfo");
        let model = cpu.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
        let unknown = || std::env::consts::ARCH.to_string();
        Self {
            cpu: model.map_or_else(unknown, |(_, name)| name.trim().into()),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            isa: Isa::detect().to_string(),
            kernel: read("/proc/sys/kernel/osrelease").trim().into(),
            profile: if cfg!(debug_assertions) { "dev" } else { "release" },
            load_average: read("/proc/loadavg").split(' ').next().and_then(|load| load.parse().ok()),
        }
    }
}

impl Report {
    /// The table, under a line that names the machine.
    pub(super) fn table(&self) -> String {
        let Machine { cpu, cores, isa, kernel, profile, load_average } = &self.machine;
        let load = load_average.map_or("unknown".into(), |load| load.to_string());
        let mut text = format!(
            "{}  ({cpu}, {cores} cores, {isa}, Linux {kernel}, {profile} build, load average {load})\n",
            self.name
        );
        let Some(first) = self.rows.first() else { return text };
        let header = first.0.iter().map(|(name, _)| name.to_string()).collect();
        let mut lines: Vec<Vec<String>> = vec![header];
        lines.extend(self.rows.iter().map(|row| row.0.iter().map(|(_, value)| cell(value)).collect()));
        let width = |column: usize| {
            lines.iter().filter_map(|line| Some(line.get(column)?.chars().count())).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..first.0.len()).map(width).collect();
        for line in &lines {
            for (value, width) in line.iter().zip(&widths) {
                text += &format!("  {value:>width$}");
            }
            text.push('\n');
        }
        text
    }
}

/// A value for people.
fn cell(value: &Value) -> String {
    match value {
        Value::Null => "-".into(),
        Value::String(text) => text.clone(),
        Value::Array(values) => values.iter().map(cell).collect::<Vec<_>>().join("x"),
        Value::Number(number) if number.is_f64() => match number.as_f64().unwrap_or(f64::NAN) {
            x if x.abs() >= 100.0 => format!("{x:.0}"),
            x if x.abs() >= 10.0 => format!("{x:.1}"),
            x => format!("{x:.2}"),
        },
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn columns_keep_their_order_and_align() {
        let row = Row::new().with("hidden", vec![64, 64]).measured("us", 12.34567).measured("naive_ns", None);
        let report = Report { name: "step".into(), machine: Machine::new(), rows: vec![row] };
        let json = serde_json::to_string(&report).unwrap();
        assert!(json.starts_with(r#"{"name":"step","machine":{"cpu":"#), "{json}");
        assert!(json.ends_with(r#""rows":[{"hidden":[64,64],"us":12.35,"naive_ns":null}]}"#), "{json}");
        let table = report.table();
        let lines: Vec<&str> = table.lines().collect();
        assert_eq!(lines[1..], ["  hidden    us  naive_ns", "   64x64  12.3         -"]);
    }
}
