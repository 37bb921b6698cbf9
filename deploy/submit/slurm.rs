//! The job of a sweep for SLURM: an array with a task a run.
//!
//! Before its time limit a task gets SIGUSR1. Its runs then save, and it asks to be put into the queue again, where it goes on
//! from there. `scancel` sends SIGTERM: the runs save, and the task is over.

use super::options::Options;
use super::tasks;
use crate::output::say;
use crate::prepare::quoted;
use crate::sweep::arms::SUBMIT;
use anyhow::{Context, Result, bail, ensure};
use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

/// Seconds between the warning and the time limit.
const WARNING_S: u64 = 90;
/// What the script says itself.
const OWN: [&str; 10] =
    ["array", "chdir", "error", "export", "help", "open-mode", "output", "parsable", "requeue", "wrap"];
/// Short names, and the options that they stand for.
const SHORT: [(&str, &str); 2] = [("cpus", "cpus-per-task"), ("name", "job-name")];

/// A job to submit.
#[derive(Debug)]
pub(crate) struct Job<'a> {
    /// The words that start this program, on every host.
    pub(crate) program: &'a [String],
    /// The sweep's directory, from the root.
    pub(crate) out: &'a Path,
    /// The working directory, in which names of files mean the same as here.
    pub(crate) here: &'a Path,
    /// Runs of the sweep.
    pub(crate) runs: usize,
    /// Tasks that have something left to do, ascending; not empty.
    pub(crate) left: &'a [usize],
    /// Tasks at once; as many as the cluster has room for if not given.
    pub(crate) at_once: Option<u16>,
    /// Options of `sbatch`.
    pub(crate) options: &'a Options,
}

impl Job<'_> {
    /// The job's script.
    ///
    /// # Errors
    /// An option that the script sets itself, or a path that it cannot name.
    pub(crate) fn script(&self) -> Result<String> {
        let name = self.out.file_name().map_or_else(|| "sweep".into(), |name| name.to_string_lossy());
        let mut options = vec![
            ("job-name".to_string(), format!("trestle-{name}")),
            ("signal".into(), format!("B:USR1@{WARNING_S}")),
        ];
        for (key, value) in self.options.iter() {
            let key = SHORT.iter().find(|(short, _)| *short == key).map_or(key, |(_, long)| long);
            ensure!(
                !OWN.contains(&key),
                "--slurm {key}={value}; accepted: options of sbatch but for {}",
                OWN.join(", ")
            );
            let warns = value.strip_prefix("B:USR1@").is_some_and(|s| s.parse::<u32>().is_ok());
            ensure!(
                key != "signal" || warns,
                "--slurm signal={value}; accepted: B:USR1@SECONDS, the time before the limit at which runs save"
            );
            options.retain(|(known, _)| known != key);
            options.push((key.into(), value.into()));
        }
        let at_once = self.at_once.map(|n| format!("%{n}")).unwrap_or_default();
        options.extend([
            ("array".into(), ranges(self.left) + &at_once),
            ("chdir".into(), text(self.here)?.into()),
            // %A and %a are the job and the task. A percent sign of the path itself is doubled.
            ("output".into(), format!("{}/{SUBMIT}/%A_%a.log", text(self.out)?.replace('%', "%%"))),
            ("open-mode".into(), "append".into()),
        ]);
        let options: String =
            options.iter().map(|(key, value)| format!("#SBATCH --{key}={}\n", word(value))).collect();
        let program: Vec<String> = self.program.iter().map(|word| quoted(word)).collect();
        Ok(format!(
            r#"#!/bin/bash
# The runs of a sweep of Trestle's, a task each. Made by `trestle sweep --submit slurm`.
{options}#SBATCH --requeue

# SIGUSR1 comes before the time limit: the runs save, and the task goes back into the queue. After SIGTERM they save as well.
warned=
runs=
trap 'told=1 warned=1; [[ -n $runs ]] && kill -USR1 "$runs" 2>/dev/null' USR1
trap 'told=1; [[ -n $runs ]] && kill -TERM "$runs" 2>/dev/null' TERM

{program} sweep --resume --out {out} --share "$SLURM_ARRAY_TASK_ID/{tasks}" --quiet &
runs=$!
# A signal ends `wait` before the runs have ended.
told=1
while [[ -n $told ]]; do
    told=
    wait "$runs"
    status=$?
done
# 130: saved. 138: it had not begun.
if [[ -n $warned && ( $status -eq 130 || $status -eq 138 ) ]]; then
    exec scontrol requeue "${{SLURM_ARRAY_JOB_ID}}_$SLURM_ARRAY_TASK_ID"
fi
exit "$status"
"#,
            program = program.join(" "),
            out = quoted(text(self.out)?),
            tasks = tasks(self.runs),
        ))
    }

    /// Writes the script into the sweep's directory and hands it to `sbatch`. Returns the job's number.
    ///
    /// # Errors
    /// It cannot be written, or SLURM does not take it.
    pub(crate) fn submit(&self) -> Result<String> {
        let script = self.script()?;
        let dir = self.out.join(SUBMIT);
        fs::create_dir_all(&dir).with_context(|| format!("cannot make {}", dir.display()))?;
        let path = dir.join("slurm.sh");
        fs::write(&path, &script).with_context(|| format!("cannot write {}", path.display()))?;
        let mut sbatch = Command::new("sbatch")
            .arg("--parsable")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .context("cannot start sbatch; accepted: a host that submits to SLURM, or --dry-run")?;
        let mut stdin = sbatch.stdin.take().context("sbatch has no standard input")?;
        // Where sbatch reads no more, its status says why.
        let _ = stdin.write_all(script.as_bytes());
        drop(stdin);
        let done = sbatch.wait_with_output().context("cannot wait for sbatch")?;
        if !done.status.success() {
            bail!("sbatch ended with {}; the job is in {}", done.status, path.display());
        }
        // JOB, or JOB;CLUSTER
        let job =
            String::from_utf8_lossy(&done.stdout).trim().split(';').next().unwrap_or_default().to_string();
        say(&format!(
            "job {job}, {} tasks; `squeue --job {job}` shows them, `scancel {job}` ends them",
            self.left.len()
        ));
        Ok(job)
    }
}

/// `path` as text on one line.
fn text(path: &Path) -> Result<&str> {
    let text = path.to_str().filter(|text| !text.chars().any(char::is_control));
    text.with_context(|| format!("the path {}; accepted for SLURM: text on one line", path.display()))
}

/// `value` as a word of a line with options.
fn word(value: &str) -> String {
    let plain = |c: char| c.is_ascii_graphic() && !"\"'\\#".contains(c);
    match value.chars().all(plain) {
        true => value.into(),
        false => format!("\"{}\"", value.replace('\\', r"\\").replace('"', "\\\"")),
    }
}

/// Ascending numbers as SLURM has them: `0-2,5`.
fn ranges(numbers: &[usize]) -> String {
    let mut ranges: Vec<(usize, usize)> = Vec::new();
    for &number in numbers {
        match ranges.last_mut() {
            Some((_, last)) if *last + 1 == number => *last = number,
            _ => ranges.push((number, number)),
        }
    }
    let words: Vec<String> = ranges
        .into_iter()
        .map(|(first, last)| if first == last { format!("{first}") } else { format!("{first}-{last}") })
        .collect();
    words.join(",")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn script(out: &str, options: &str) -> Result<String> {
        let options = Options::joined(&[options.parse().unwrap()]);
        let program = ["/opt/my programs/trestle".to_string()];
        let job = Job {
            program: &program,
            out: Path::new(out),
            here: Path::new("/home/me"),
            runs: 6,
            left: &[0, 1, 2, 5],
            at_once: Some(2),
            options: &options,
        };
        job.script()
    }

    #[test]
    fn options_and_commands_are_those_that_were_asked_for() {
        let script = script("/scratch/it's 5%", "partition=x,time=4:00:00,cpus=4,comment=two words").unwrap();
        for line in [
            "#SBATCH --job-name=\"trestle-it's 5%\"",
            "#SBATCH --signal=B:USR1@90",
            "#SBATCH --partition=x",
            "#SBATCH --time=4:00:00",
            "#SBATCH --cpus-per-task=4",
            "#SBATCH --comment=\"two words\"",
            "#SBATCH --array=0-2,5%2",
            "#SBATCH --chdir=/home/me",
            "#SBATCH --output=\"/scratch/it's 5%%/submit/%A_%a.log\"",
            "#SBATCH --requeue",
            "'/opt/my programs/trestle' sweep --resume --out '/scratch/it'\\''s 5%' \
             --share \"$SLURM_ARRAY_TASK_ID/6\" --quiet &",
        ] {
            assert!(script.lines().any(|written| written == line), "{line}\n{script}");
        }
    }

    #[test]
    fn what_the_script_says_itself_is_refused() {
        let said = |options: &str| format!("{:#}", script("/out", options).unwrap_err());
        assert!(said("array=0-9").contains("accepted: options of sbatch but for array"));
        assert!(said("signal=TERM@5").contains("accepted: B:USR1@SECONDS"));
        assert!(script("/out", "signal=B:USR1@30").unwrap().contains("--signal=B:USR1@30\n"));
        assert!(script("/a\nb", "time=1").is_err());
    }

    #[test]
    fn numbers_that_follow_each_other_are_a_range() {
        assert_eq!(ranges(&[0, 1, 2, 5, 7, 8]), "0-2,5,7-8");
        assert_eq!(ranges(&[3]), "3");
    }
}
