//! The job of a sweep for Kubernetes: an Indexed Job with a pod a run, which share a volume.

use super::options::Options;
use super::tasks;
use crate::output::say;
use anyhow::{Context, Result, bail, ensure};
use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};
use trestle_proto::regular_file;

/// Where pods find the volume of runs, and the configuration of this sweep.
const RUNS: &str = "/runs";
const CONFIG: &str = "/config/config.toml";
/// Largest configuration file, bytes: Kubernetes takes no larger ConfigMap.
const MAX_CONFIG: u64 = 1 << 20;
/// Longest name of a job, so that the names of its pods and their index fit into 63 letters.
const MAX_NAME: usize = 45;
/// Options that are known, and their values where they are not typed.
const KNOWN: [(&str, &str); 7] = [
    ("image", concat!("trestle:", env!("CARGO_PKG_VERSION"))),
    ("claim", "trestle-runs"),
    ("namespace", ""),
    ("name", ""),
    ("cpus", "1"),
    ("memory", "2Gi"),
    ("shm", "256Mi"),
];

/// A job to submit.
#[derive(Debug)]
pub(crate) struct Job<'a> {
    /// The arguments of `sweep` as they were typed, but for those that say where and how it runs.
    pub(crate) typed: &'a [String],
    /// Preset or configuration file, as it was typed.
    pub(crate) source: &'a str,
    /// The sweep's directory as it was typed, whose last part is its name on the volume.
    pub(crate) out: &'a Path,
    /// Runs of the sweep.
    pub(crate) runs: usize,
    /// Bytes of shared memory that a run needs.
    pub(crate) shared_memory: u64,
    /// Pods at once; all of them if not given.
    pub(crate) at_once: Option<u16>,
    /// See [`KNOWN`].
    pub(crate) options: &'a Options,
}

impl Job<'_> {
    /// The job, and the ConfigMap of its configuration where that is a file.
    ///
    /// # Errors
    /// An unknown option, or a file that cannot be read.
    pub(crate) fn manifest(&self) -> Result<String> {
        for (key, value) in self.options.iter() {
            let known: Vec<&str> = KNOWN.iter().map(|(known, _)| *known).collect();
            ensure!(known.contains(&key), "--kubernetes {key}={value}; accepted: {}", known.join(", "));
        }
        let option = |key: &str| {
            let default = KNOWN.iter().find(|(known, _)| *known == key).map_or("", |(_, default)| default);
            self.options.get(key).unwrap_or(default)
        };
        let directory = self.out.file_name().context("--out has no name; accepted: a directory's path")?;
        let directory = directory.to_string_lossy();
        let name = match option("name") {
            "" => format!("trestle-{directory}"),
            name => name.into(),
        };
        let name = label(&name);
        let namespace = match option("namespace") {
            "" => String::new(),
            namespace => format!("\n  namespace: {}", text(namespace)),
        };
        let shm = match self.options.get("shm") {
            Some(typed) => typed.into(),
            // Twice the need: whole pages, and what is made anew beside the old.
            None => format!("{}Mi", (2 * self.shared_memory).div_ceil(1 << 20).max(64)),
        };
        let file = match Path::new(self.source).is_file() {
            true => Some(regular_file::read_to_string(Path::new(self.source), MAX_CONFIG)?),
            false => None,
        };
        let mut words = vec!["sweep".to_string()];
        words.extend(self.typed.iter().cloned());
        if file.is_some() {
            let place = words.iter_mut().find(|word| *word == self.source);
            *place.context("the configuration is none of the arguments")? = CONFIG.into();
        }
        let tasks = tasks(self.runs);
        let share = format!("$(JOB_COMPLETION_INDEX)/{tasks}");
        let out = format!("{RUNS}/{directory}");
        // Kubernetes takes $(NAME) for a variable, and $$ for a dollar sign.
        let escaped = words.iter().map(|word| word.replace("$(", "$$("));
        let own = ["--resume", "--out", &out, "--share", &share, "--quiet"].map(ToString::to_string);
        let args: String =
            escaped.chain(own).map(|word| format!("\n            - {}", text(&word))).collect();
        let at_once = self.at_once.map_or(tasks, usize::from).min(tasks);
        let (mount, volume, config) = match file {
            None => (String::new(), String::new(), String::new()),
            Some(file) => (
                "\n            - name: config\n              mountPath: /config\n              readOnly: true".into(),
                format!("\n        - name: config\n          configMap:\n            name: {name}"),
                format!(
                    "apiVersion: v1\nkind: ConfigMap\nmetadata:\n  name: {name}{namespace}\ndata:\n  config.toml: {}\n---\n",
                    text(&file)
                ),
            ),
        };
        let [image, claim, cpus, memory] = ["image", "claim", "cpus", "memory"].map(|key| text(option(key)));
        let shm = text(&shm);
        Ok(format!(
            r#"{config}apiVersion: batch/v1
kind: Job
metadata:
  name: {name}{namespace}
  labels:
    app.kubernetes.io/name: trestle
spec:
  completionMode: Indexed
  completions: {tasks}
  parallelism: {at_once}
  # Of each index, so that a run that fails does not end the others.
  backoffLimitPerIndex: 3
  # A pod that is to be replaced is gone first: two of them must not train one run.
  podReplacementPolicy: Failed
  podFailurePolicy:
    rules:
      # The node went away, or a more important pod came: not the run's fault.
      - action: Ignore
        onPodConditions:
          - type: DisruptionTarget
            status: "True"
      # Saved after a signal: the next pod goes on.
      - action: Ignore
        onExitCodes:
          containerName: trestle
          operator: In
          values: [130]
      # Wrong arguments, which the next pod would have as well.
      - action: FailIndex
        onExitCodes:
          containerName: trestle
          operator: In
          values: [2]
  template:
    metadata:
      labels:
        app.kubernetes.io/name: trestle
    spec:
      restartPolicy: Never
      # SIGTERM comes first, and the run saves.
      terminationGracePeriodSeconds: 120
      automountServiceAccountToken: false
      securityContext:
        runAsNonRoot: true
        runAsUser: 1000
        runAsGroup: 1000
        fsGroup: 1000
        fsGroupChangePolicy: OnRootMismatch
        seccompProfile:
          type: RuntimeDefault
      containers:
        - name: trestle
          image: {image}
          args:{args}
          resources:
            requests:
              cpu: {cpus}
              memory: {memory}
            limits:
              memory: {memory}
          securityContext:
            allowPrivilegeEscalation: false
            readOnlyRootFilesystem: true
            capabilities:
              drop: [ALL]
          volumeMounts:
            - name: runs
              mountPath: {RUNS}
            - name: shm
              mountPath: /dev/shm
            - name: tmp
              mountPath: /tmp{mount}
      volumes:
        - name: runs
          persistentVolumeClaim:
            claimName: {claim}
        # Counts as memory of the container.
        - name: shm
          emptyDir:
            medium: Memory
            sizeLimit: {shm}
        - name: tmp
          emptyDir: {{}}{volume}
"#
        ))
    }

    /// Hands the job to `kubectl`.
    ///
    /// # Errors
    /// There is none, or it does not take the job.
    pub(crate) fn submit(&self) -> Result<()> {
        let manifest = self.manifest()?;
        let mut kubectl = Command::new("kubectl")
            .args(["apply", "--filename", "-"])
            .stdin(Stdio::piped())
            .spawn()
            .context("cannot start kubectl; accepted: a host that has it, or --dry-run")?;
        let mut stdin = kubectl.stdin.take().context("kubectl has no standard input")?;
        // Where kubectl reads no more, its status says why.
        let _ = stdin.write_all(manifest.as_bytes());
        drop(stdin);
        let status = kubectl.wait().context("cannot wait for kubectl")?;
        if !status.success() {
            bail!("kubectl ended with {status}; --dry-run prints the job");
        }
        say(&format!("{} pods; `kubectl get jobs` shows how far they are", tasks(self.runs)));
        Ok(())
    }
}

/// `value` as YAML has text: every string of JSON is one of YAML.
fn text(value: &str) -> String {
    serde_json::Value::from(value).to_string()
}

/// A name that Kubernetes takes: small letters, digits and `-`, a letter first.
fn label(name: &str) -> String {
    let letter = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' };
    let plain: String = name.chars().map(letter).take(MAX_NAME).collect();
    let plain = plain.trim_matches('-');
    match plain.starts_with(|c: char| c.is_ascii_lowercase()) {
        true => plain.into(),
        false => format!("trestle-{plain}").trim_end_matches('-').into(),
    }
}

/// `args` without the flags in `flags`, each with its value if it has one.
pub(crate) fn without(args: &[String], flags: &[(&str, bool)]) -> Vec<String> {
    let mut kept = Vec::new();
    let mut args = args.iter();
    while let Some(arg) = args.next() {
        let (name, joined) = arg.split_once('=').map_or((arg.as_str(), false), |(name, _)| (name, true));
        match flags.iter().find(|(flag, _)| *flag == name) {
            Some((_, true)) if !joined => _ = args.next(),
            Some(_) => {}
            None => kept.push(arg.clone()),
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn words(text: &str) -> Vec<String> {
        text.split(' ').map(Into::into).collect()
    }

    #[test]
    fn flags_go_with_their_values() {
        let typed = words("maze30 --out x --seeds 0..3 --submit=kubernetes --dry-run --set a=--out --jobs 2");
        let flags = [("--out", true), ("--submit", true), ("--dry-run", false), ("--jobs", true)];
        assert_eq!(without(&typed, &flags), words("maze30 --seeds 0..3 --set a=--out"));
    }

    #[test]
    fn names_are_those_that_kubernetes_takes() {
        assert_eq!(label("trestle-My Sweep_7"), "trestle-my-sweep-7");
        assert_eq!(label("7up-"), "trestle-7up");
        assert!(label(&"x".repeat(99)).len() == MAX_NAME && label("äöü") == "trestle");
    }

    #[test]
    fn what_is_typed_stays_text() {
        let dir = tempfile::tempdir().unwrap();
        let config = dir.path().join("c.toml");
        std::fs::write(&config, "[run]\nname = \"x: &y\"\n").unwrap();
        let source = config.to_str().unwrap();
        let typed = vec![source.to_string(), "--set".into(), "mentor.demo=\"$(X)\"".into()];
        let options = Options::default();
        let job = Job {
            typed: &typed,
            source,
            out: Path::new("runs/Small"),
            runs: 6,
            shared_memory: 40 << 20,
            at_once: Some(2),
            options: &options,
        };
        let text = job.manifest().unwrap();
        for line in [
            "  name: trestle-small",
            "            - \"/config/config.toml\"",
            "            - \"mentor.demo=\\\"$$(X)\\\"\"",
            "            - \"/runs/Small\"",
            "            - \"$(JOB_COMPLETION_INDEX)/6\"",
            "  config.toml: \"[run]\\nname = \\\"x: &y\\\"\\n\"",
            "            sizeLimit: \"80Mi\"",
            "  parallelism: 2",
        ] {
            assert!(text.lines().any(|written| written == line), "{line}\n{text}");
        }
        let unknown = "gpus=1".parse().unwrap();
        let error = Job { options: &unknown, ..job }.manifest().unwrap_err().to_string();
        assert!(error.contains("--kubernetes gpus=1; accepted: image, claim"), "{error}");
    }
}
