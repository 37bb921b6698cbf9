//! A whole report in a directory: the page, the pictures, and every number that is drawn.
//!
//! ```text
//! report.html            everything, in one file that needs nothing else
//! report.json            the same numbers for programs; see docs/reports.md
//! runs.csv               a line a run
//! pictures/<name>.svg    every picture, and as .png and .pdf
//! data/<name>.csv        the numbers behind it
//! ```

use crate::curves::{self, Axis};
use crate::maze::Maze;
use crate::over_tasks::{self, Bound, Overview, Ratio};
use crate::page::{self, Figure, Part, Section, Tables};
use crate::plot::{self, Chart, Intervals, Line, PlotError, Scale, View, pdf, png};
use crate::run::{Run, Series};
use crate::stats::Estimate;
use crate::summary::{self, ArmSummary, Comparison, Group, Task, Time, order};
use serde::Serialize;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use trestle_proto::own_file;

/// Version of the layout of report.json.
const FORMAT: u32 = 1;
/// Tasks whose pictures are drawn, at most. Where there are more, none is.
pub const MAX_DRAWN: usize = 16;
/// Spread of returns above which they are drawn on a logarithmic scale.
const WIDE: f64 = 50.0;

/// A report that cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// A picture.
    #[error(transparent)]
    Plot(#[from] PlotError),
    /// A file.
    #[error("cannot write {path}")]
    Io {
        /// The file or directory.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Numbers that have no form as text, which ours all have.
    #[error("cannot put the report's numbers into {what}: {reason}")]
    Encode {
        /// The format.
        what: &'static str,
        /// Why.
        reason: String,
    },
}

/// The input of a report.
#[derive(Clone, Debug)]
pub struct Report<'a> {
    /// Its heading.
    pub title: String,
    /// The runs, as [`crate::read::read_runs`] orders them.
    pub runs: &'a [Run],
    /// Notes about everything that is missing.
    pub notes: Vec<String>,
    /// Whether the files of pictures have headings and notes.
    pub titles: bool,
    /// Name of task and arm, and one of its runs in its maze.
    pub mazes: Vec<(String, String, Maze)>,
}

/// report.json.
#[derive(Serialize)]
struct Json<'a> {
    format: u32,
    title: &'a str,
    arms: &'a [ArmSummary],
    comparisons: &'a [Comparison],
    over_tasks: Option<&'a Overview>,
    notes: &'a [String],
}

/// A line of runs.csv.
#[derive(Serialize)]
struct RunRow<'a> {
    task: &'a str,
    arm: &'a str,
    seed: u64,
    complete: bool,
    episodes: Option<u64>,
    env_steps: Option<u64>,
    grad_steps: Option<u64>,
    wall_s: Option<f64>,
    solved_episode: Option<u64>,
    solved_env_steps: Option<u64>,
    optimal_episode: Option<u64>,
    optimal_env_steps: Option<u64>,
    threshold: Option<f64>,
    best_return: Option<f64>,
    final_return: Option<f64>,
    mentor_feasible_frac: Option<f64>,
    mentor_bridged_frac: Option<f64>,
    mentor_loss_frac: Option<f64>,
    path: String,
}

/// A line of a chart's CSV.
#[derive(Serialize)]
struct ChartRow<'a> {
    arm: &'a str,
    x: f64,
    runs: usize,
    value: f64,
    low: f64,
    high: f64,
}

/// Writes `report` into the directory `out`, which is made if it is absent. Files of an earlier report are replaced. Gives the
/// figures over tasks, where there are several.
///
/// # Errors
/// A picture that cannot be drawn or a file that cannot be written.
pub fn write(report: &Report<'_>, out: &Path) -> Result<Option<Overview>, WriteError> {
    let tasks = summary::tasks(report.runs);
    let (arms, comparisons) = (summary::arms(&tasks), summary::comparisons(&tasks));
    let overview = over_tasks::overview(&tasks);
    let mut output = Output { dir: out, figures: Vec::new(), part: Part::Times, titles: report.titles };
    for dir in [out.to_path_buf(), out.join("pictures"), out.join("data")] {
        fs::create_dir_all(&dir).map_err(|source| WriteError::Io { path: dir, source })?;
    }
    let names = arm_names(&tasks);
    let mut sections = Vec::new();
    if let Some(overview) = &overview {
        between_tasks(&mut output, overview, &names)?;
    }
    if comparisons.iter().any(|c| c.task.is_none()) {
        improvement(&mut output, None, "all", &comparisons, &names)?;
    }
    if !output.figures.is_empty() {
        sections.push(Section { task: None, figures: std::mem::take(&mut output.figures) });
    }
    let drawn = if tasks.len() > MAX_DRAWN { &[] } else { &tasks[..] };
    for (index, task) in drawn.iter().enumerate() {
        let drawing =
            Drawing { task, prefix: format!("{:02}-{}", index + 1, slug(task.name)), names: &names };
        output.part = Part::Curves;
        drawing.returns(&mut output)?;
        output.part = Part::Times;
        drawing.times(&mut output, &arms, &comparisons)?;
        output.part = Part::Mentor;
        drawing.knowledge(&mut output)?;
        output.part = Part::Maps;
        drawing.mazes(&mut output, &report.mazes)?;
        sections.push(Section { task: Some(task.name), figures: std::mem::take(&mut output.figures) });
    }
    output.csv("runs.csv", report.runs.iter().map(run_row))?;
    let json = Json {
        format: FORMAT,
        title: &report.title,
        arms: &arms,
        comparisons: &comparisons,
        over_tasks: overview.as_ref(),
        notes: &report.notes,
    };
    let text = serde_json::to_string_pretty(&json)
        .map_err(|e| WriteError::Encode { what: "report.json", reason: e.to_string() })?;
    output.file("report.json", text.as_bytes())?;
    let page = page::page(
        &report.title,
        &Tables {
            names: &names,
            arms: &arms,
            comparisons: &comparisons,
            overview: overview.as_ref(),
            runs: report.runs,
            from: out,
        },
        &sections,
        &report.notes,
    );
    output.file("report.html", page.as_bytes())?;
    Ok(overview)
}

/// All arms in the order of their colours, which are the same for every task.
fn arm_names<'a>(tasks: &[Task<'a>]) -> Vec<&'a str> {
    let mut names: Vec<&str> = tasks.iter().flat_map(|t| t.groups.iter().map(|g| g.arm)).collect();
    names.sort_by_key(|arm| order(arm));
    names.dedup();
    names
}

/// `name` as part of a file's name.
fn slug(name: &str) -> String {
    let kept: String =
        name.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' }).collect();
    let parts: Vec<&str> = kept.split('-').filter(|part| !part.is_empty()).collect();
    parts.join("-").chars().take(60).collect()
}

fn run_row(run: &Run) -> RunRow<'_> {
    let of = run.result.as_ref();
    RunRow {
        task: &run.task,
        arm: &run.arm,
        seed: run.config.run.seed,
        complete: run.complete().is_some(),
        episodes: of.map(|o| o.episodes),
        env_steps: of.map(|o| o.env_steps),
        grad_steps: of.map(|o| o.grad_steps),
        wall_s: of.map(|o| o.wall_s),
        solved_episode: of.and_then(|o| o.solved_episode),
        solved_env_steps: of.and_then(|o| o.solved_env_steps),
        optimal_episode: of.and_then(|o| o.optimal_episode),
        optimal_env_steps: of.and_then(|o| o.optimal_env_steps),
        threshold: of.and_then(|o| o.threshold),
        best_return: of.and_then(|o| o.best_return),
        final_return: of.and_then(|o| o.final_return),
        mentor_feasible_frac: of.and_then(|o| o.mentor_feasible_frac),
        mentor_bridged_frac: of.and_then(|o| o.mentor_bridged_frac),
        mentor_loss_frac: of.and_then(|o| o.mentor_loss_frac),
        path: run.path.display().to_string(),
    }
}

/// Where everything goes.
struct Output<'a> {
    dir: &'a Path,
    /// The pictures of the present section.
    figures: Vec<Figure>,
    /// What the pictures that come next are about.
    part: Part,
    /// Whether files of pictures have headings and notes.
    titles: bool,
}

impl Output<'_> {
    fn file(&self, name: &str, bytes: &[u8]) -> Result<(), WriteError> {
        let path = self.dir.join(name);
        own_file::create(&path)
            .and_then(|mut file| file.write_all(bytes))
            .map_err(|source| WriteError::Io { path, source })
    }

    fn csv<R: Serialize>(&self, name: &str, rows: impl IntoIterator<Item = R>) -> Result<(), WriteError> {
        let fault = |e: &dyn std::fmt::Display| WriteError::Encode { what: "CSV", reason: e.to_string() };
        let mut writer = csv::Writer::from_writer(Vec::new());
        for row in rows {
            writer.serialize(row).map_err(|e| fault(&e))?;
        }
        self.file(name, &writer.into_inner().map_err(|e| fault(&e))?)
    }

    /// Keeps picture `name` as SVG and PNG, and for the page, with a heading and a note there.
    fn picture(
        &mut self,
        name: &str,
        [title, note]: [&str; 2],
        draw: impl Fn(View) -> Result<String, PlotError>,
    ) -> Result<(), WriteError> {
        let svg = draw(if self.titles { View::Paper } else { View::Figure })?;
        self.file(&format!("pictures/{name}.svg"), svg.as_bytes())?;
        self.file(&format!("pictures/{name}.png"), &png(&svg)?)?;
        self.file(&format!("pictures/{name}.pdf"), &pdf(&svg)?)?;
        let (title, note, svg) = (title.into(), note.into(), plot::inline(&draw(View::Page)?));
        self.figures.push(Figure { title, note, file: name.into(), svg, part: self.part });
        Ok(())
    }

    /// Keeps a chart, unless it would be an empty box.
    fn chart(&mut self, name: &str, chart: &Chart, counts: &[Vec<usize>]) -> Result<(), WriteError> {
        if chart.lines.iter().all(|line| line.points.len() < 2) {
            return Ok(());
        }
        let rows = chart.lines.iter().zip(counts).flat_map(|(line, counts)| {
            line.points.iter().zip(counts).map(|(&(x, value, low, high), &runs)| ChartRow {
                arm: &line.name,
                x,
                runs,
                value,
                low,
                high,
            })
        });
        self.csv(&format!("data/{name}.csv"), rows)?;
        self.picture(name, [&chart.title, &chart.note], |view| chart.svg(view))
    }

    /// The same of intervals.
    fn intervals(&mut self, name: &str, chart: &Intervals) -> Result<(), WriteError> {
        if chart.rows.iter().all(|row| !row.estimate.mid.is_finite()) {
            return Ok(());
        }
        #[derive(Serialize)]
        struct IntervalRow<'a> {
            name: &'a str,
            value: f64,
            low: f64,
            high: f64,
            note: &'a str,
        }
        let rows = chart.rows.iter().map(|row| {
            let Estimate { mid, low, high } = row.estimate;
            IntervalRow { name: &row.name, value: mid, low, high, note: &row.note }
        });
        self.csv(&format!("data/{name}.csv"), rows)?;
        self.picture(name, [&chart.title, &chart.note], |view| chart.svg(view))
    }
}

/// The pictures of one task.
struct Drawing<'a> {
    task: &'a Task<'a>,
    /// Beginning of the names of its files.
    prefix: String,
    /// All arms of the report.
    names: &'a [&'a str],
}

/// The smallest and the largest finite number.
fn range(numbers: impl IntoIterator<Item = f64>) -> (f64, f64) {
    let finite = numbers.into_iter().filter(|x| x.is_finite());
    finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)))
}

impl Drawing<'_> {
    fn number(&self, arm: &str) -> usize {
        self.names.iter().position(|name| *name == arm).unwrap_or(0)
    }

    fn name(&self, what: &str) -> String {
        format!("{}-{what}", self.prefix)
    }

    /// How long it took, and how many got there.
    fn times(
        &self,
        output: &mut Output<'_>,
        arms: &[ArmSummary],
        comparisons: &[Comparison],
    ) -> Result<(), WriteError> {
        let arms: Vec<&ArmSummary> =
            arms.iter().filter(|arm| arm.task == self.task.name && arm.complete > 0).collect();
        if arms.is_empty() {
            return Ok(());
        }
        let row = |arm: &ArmSummary, estimate, note| plot::Row {
            name: arm.arm.clone(),
            arm: self.number(&arm.arm),
            estimate,
            note,
        };
        output.intervals(
            &self.name("solved-share"),
            &Intervals {
                title: format!("Share of runs solved: {}", self.task.name),
                note: "Wilson's 95 % intervals".into(),
                x: plot::Axis::exact("share of runs", 0.0, 1.0),
                rows: arms
                    .iter()
                    .map(|arm| row(arm, arm.solved_share, format!("{} of {}", arm.solved, arm.complete)))
                    .collect(),
                rule: None,
            },
        )?;
        for (index, time) in Time::ALL.into_iter().enumerate() {
            let rows: Vec<plot::Row> = arms
                .iter()
                .map(|arm| {
                    let median = arm.times[index].median;
                    let note = if median.mid.is_finite() {
                        format!("{:.0}", median.mid)
                    } else {
                        "not reached".into()
                    };
                    row(arm, median, note)
                })
                .collect();
            let ends = rows.iter().flat_map(|r| [r.estimate.mid, r.estimate.low, r.estimate.high]);
            let (_, latest) = range(ends);
            // Where nobody got there the axis is as long as the longest run.
            let high = if latest.is_finite() { latest } else { time.longest(self.task) };
            let chart = Intervals {
                title: format!("Median {}: {}", time.label(), self.task.name),
                note: "with 95 % bootstrap intervals; an arrow: beyond the runs' length".into(),
                x: plot::Axis::fit(time.label(), Scale::Linear, 0.0, high),
                rows,
                rule: None,
            };
            output.intervals(&self.name(time.name()), &chart)?;
        }
        self.shares_over_time(output)?;
        for time in [Time::SolvedEpisode, Time::SolvedEnvSteps] {
            self.ratios(output, comparisons, time)?;
        }
        improvement(output, Some(self.task.name), &self.prefix, comparisons, self.names)
    }

    fn shares_over_time(&self, output: &mut Output<'_>) -> Result<(), WriteError> {
        for (axis, time) in [(Axis::Episodes, Time::SolvedEpisode), (Axis::EnvSteps, Time::SolvedEnvSteps)] {
            // A picture of nobody is an empty box.
            if !self.task.groups.iter().flat_map(|group| group.times(time)).any(f64::is_finite) {
                continue;
            }
            let end = time.longest(self.task);
            let mut counts = Vec::new();
            let lines = self.lines(|group| {
                let times = group.times(time);
                let steps = if times.is_empty() { Vec::new() } else { curves::share_over_time(&times, end) };
                counts.push(vec![times.len(); steps.len()]);
                steps.into_iter().map(|(x, share)| (x, share, share, share)).collect()
            });
            let chart = Chart {
                title: format!("Runs solved so far: {}", self.task.name),
                x: plot::Axis::fit(axis.label(), Scale::Linear, 0.0, end),
                y: plot::Axis::exact("share of runs", 0.0, 1.0),
                lines,
                rules: Vec::new(),
                note: "a run counts from the first of the three evaluations that make it solved".into(),
            };
            output.chart(&self.name(&format!("solved-by-{}", axis.name())), &chart, &counts)?;
        }
        Ok(())
    }

    fn ratios(
        &self,
        output: &mut Output<'_>,
        comparisons: &[Comparison],
        time: Time,
    ) -> Result<(), WriteError> {
        let of_task =
            comparisons.iter().filter(|c| c.time == time && c.task.as_deref() == Some(self.task.name));
        let rows: Vec<plot::Row> = of_task
            .filter_map(|c| {
                let ratio = c.ratio?;
                let note =
                    if ratio.mid.is_finite() { format!("{:.2}", ratio.mid) } else { "undefined".into() };
                let name = format!("{} / {}", c.arm, c.with);
                Some(plot::Row { name, arm: self.number(&c.arm), estimate: ratio, note })
            })
            .collect();
        if rows.is_empty() {
            return Ok(());
        }
        let (_, high) = range(rows.iter().flat_map(|r| [r.estimate.mid, r.estimate.high]));
        let chart = Intervals {
            title: format!("Ratio of median {}: {}", time.label(), self.task.name),
            note: "below 1 the first arm is faster; 95 % bootstrap intervals".into(),
            x: plot::Axis::fit("ratio of medians", Scale::Linear, 0.0, high.max(1.2)),
            rows,
            rule: Some(1.0),
        };
        output.intervals(&self.name(&format!("ratio-{}", time.name())), &chart)
    }

    /// The result of `of` for each arm, in the order of all arms, so that each has its colour. An arm without runs on this
    /// task is an empty group.
    fn each<T>(&self, mut of: impl FnMut(&Group<'_>) -> T) -> Vec<T> {
        let arms = self.names.iter().map(|name| {
            let group = self.task.groups.iter().find(|group| group.arm == *name);
            of(group.unwrap_or(&Group { arm: name, runs: Vec::new() }))
        });
        arms.collect()
    }

    /// One line an arm.
    fn lines(&self, points: impl FnMut(&Group<'_>) -> Vec<(f64, f64, f64, f64)>) -> Vec<Line> {
        let lines = self.names.iter().zip(self.each(points));
        lines.map(|(name, points)| Line { name: (*name).into(), points }).collect()
    }

    /// Learning curves.
    fn returns(&self, output: &mut Output<'_>) -> Result<(), WriteError> {
        let threshold = self.task.groups.iter().flat_map(Group::results).find_map(|o| o.threshold);
        // Where no threshold was set, it is the best return that there can be.
        let set = self
            .task
            .groups
            .iter()
            .flat_map(|group| &group.runs)
            .any(|run| run.config.eval.threshold.is_some());
        let best = threshold.filter(|_| !set);
        let evaluations: Source = ("evaluation", "return of greedy evaluations", |run| &run.evaluations);
        let training: Source = ("training", "mean return of 100 training episodes", |run| &run.training);
        for source in [evaluations, training] {
            for axis in Axis::ALL {
                self.curve(output, source, axis, &[Band::Iqm, Band::Deviation], [threshold, best])?;
            }
        }
        Ok(())
    }

    fn curve(
        &self,
        output: &mut Output<'_>,
        source: Source,
        axis: Axis,
        bands: &[Band],
        rule_and_best: [Option<f64>; 2],
    ) -> Result<(), WriteError> {
        let arms = self.each(|group| {
            let series: Vec<&Series> = group.runs.iter().map(|run| (source.2)(run)).collect();
            curves::curve(&series, axis)
        });
        if arms.iter().all(Vec::is_empty) {
            return Ok(());
        }
        bands.iter().try_for_each(|band| self.band(output, source, axis, (*band, &arms), rule_and_best))
    }

    /// One picture of the curves of all `arms`.
    fn band(
        &self,
        output: &mut Output<'_>,
        (what, label, _): Source,
        axis: Axis,
        (band, arms): (Band, &[Vec<curves::Row>]),
        [rule, best]: [Option<f64>; 2],
    ) -> Result<(), WriteError> {
        let counts: Vec<Vec<usize>> =
            arms.iter().map(|rows| rows.iter().map(|row| row.runs).collect()).collect();
        let mut arms = arms.iter();
        let most = best.unwrap_or(f64::INFINITY);
        let drawn = |row| {
            let (x, value, low, high) = band.of(row);
            // A deviation is no bound: nobody has had a return above the best one.
            (x, value, low, high.min(most.max(value)))
        };
        let lines = self.lines(|_| arms.next().into_iter().flatten().map(drawn).collect());
        let (low, high) = range(lines.iter().flat_map(|l| l.points.iter().map(|p| p.1)).chain(rule));
        let (_, end) = range(lines.iter().flat_map(|l| l.points.iter().map(|p| p.0)));
        let wide = high - low > WIDE;
        let chart = Chart {
            title: format!("{}: {}", capital(label), self.task.name),
            x: plot::Axis::fit(axis.label(), Scale::Linear, 0.0, end),
            y: plot::Axis::fit(label, if wide { Scale::SignedLog } else { Scale::Linear }, low, high),
            lines,
            rules: rule
                .map(|at| (at, format!("threshold {}", (100.0 * at).round() / 100.0)))
                .into_iter()
                .collect(),
            note: format!("{}{}", band.note(), if wide { "; logarithmic scale" } else { "" }),
        };
        output.chart(&self.name(&format!("{what}-{}-{}", band.name(), axis.name())), &chart, &counts)
    }

    /// Curves of the findings about the mentor's steps.
    fn knowledge(&self, output: &mut Output<'_>) -> Result<(), WriteError> {
        let sources: [Source; 3] = [
            ("feasible", "share of mentor transitions that are feasible", |run| &run.feasible),
            ("bridged", "share of mentor transitions with a bridge", |run| &run.bridged),
            ("e_kl", "mean e_KL of mentor transitions", |run| &run.e_kl),
        ];
        sources.into_iter().try_for_each(|source| {
            self.curve(output, source, Axis::EnvSteps, &[Band::Deviation], [None, None])
        })
    }

    fn mazes(&self, output: &mut Output<'_>, mazes: &[(String, String, Maze)]) -> Result<(), WriteError> {
        for (_, arm, maze) in mazes.iter().filter(|(task, ..)| task == self.task.name) {
            let name = |what: &str| self.name(&format!("maze-{}-{what}", slug(arm)));
            let paths = [&maze.title[..], maze.paths_note()];
            output.picture(&name("paths"), paths, |view| maze.paths_svg(view))?;
            // What is not known for one view is not known for the other.
            let heats: [(&str, &str, Heat); 2] = [
                ("visits", "visits in the stored transitions, logarithmic", Maze::visits_svg),
                ("values", "value: the largest Q of each square", Maze::values_svg),
            ];
            for (what, note, heat) in heats {
                if heat(maze, View::Paper).is_some() {
                    let draw = |view| heat(maze, view).unwrap_or_else(|| Ok(String::new()));
                    output.picture(&name(what), [&maze.title, note], draw)?;
                }
            }
        }
        Ok(())
    }
}

/// A picture of numbers on a map, where they are known.
type Heat = fn(&Maze, View) -> Option<Result<String, PlotError>>;

/// A series of runs: its name in files, on pictures, and where it is.
type Source = (&'static str, &'static str, fn(&Run) -> &Series);

/// The meaning of a line and its band.
#[derive(Clone, Copy)]
enum Band {
    /// Mean and standard deviation, as in the paper's figures.
    Deviation,
    /// Interquartile mean and bootstrap interval.
    Iqm,
}

impl Band {
    fn of(self, row: &curves::Row) -> (f64, f64, f64, f64) {
        match self {
            Self::Deviation => (row.x, row.mean, row.mean - row.std, row.mean + row.std),
            Self::Iqm => (row.x, row.iqm.mid, row.iqm.low, row.iqm.high),
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Deviation => "mean",
            Self::Iqm => "iqm",
        }
    }

    fn note(self) -> &'static str {
        match self {
            Self::Deviation => "mean over runs; band: standard deviation",
            Self::Iqm => "interquartile mean over runs; band: 95 % stratified bootstrap interval",
        }
    }
}

fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}

/// Who is there first.
fn improvement(
    output: &mut Output<'_>,
    task: Option<&str>,
    prefix: &str,
    comparisons: &[Comparison],
    names: &[&str],
) -> Result<(), WriteError> {
    let wanted = comparisons.iter().filter(|c| c.time == Time::SolvedEnvSteps && c.task.as_deref() == task);
    let rows: Vec<plot::Row> = wanted
        .map(|c| plot::Row {
            name: format!("{} before {}", c.arm, c.with),
            arm: names.iter().position(|name| *name == c.arm).unwrap_or(0),
            estimate: c.improvement,
            note: format!("{:.2}", c.improvement.mid),
        })
        .collect();
    if rows.is_empty() {
        return Ok(());
    }
    let chart = Intervals {
        title: format!("Probability of improvement: {}", task.unwrap_or("all tasks")),
        note: "that a run is solved in fewer environment steps, ties half; 95 % bootstrap intervals".into(),
        x: plot::Axis::exact("probability", 0.0, 1.0),
        rows,
        rule: Some(0.5),
    };
    output.intervals(&format!("{prefix}-improvement"), &chart)
}

/// A line of data/over-tasks-ratios.csv.
#[derive(Serialize)]
struct RatioRow<'a> {
    group: &'a str,
    task: &'a str,
    arm: &'a str,
    baseline: &'a str,
    budget: f64,
    runs: usize,
    solved: usize,
    baseline_runs: usize,
    baseline_solved: usize,
    median: f64,
    baseline_median: f64,
    ratio: f64,
    low: f64,
    high: f64,
    bound: Bound,
    loss: bool,
}

/// A line of data/over-tasks-totals.csv.
#[derive(Serialize)]
struct TotalRow<'a> {
    group: &'a str,
    arm: &'a str,
    baseline: &'a str,
    tasks: usize,
    geometric_mean: f64,
    geometric_mean_low: f64,
    geometric_mean_high: f64,
    iqm: f64,
    iqm_low: f64,
    iqm_high: f64,
    improvement: f64,
    improvement_low: f64,
    improvement_high: f64,
    solved_share: f64,
    baseline_solved_share: f64,
    faster: usize,
    losses: usize,
    doubtful: usize,
    worst: f64,
}

/// The numbers and pictures over all tasks.
fn between_tasks(output: &mut Output<'_>, overview: &Overview, names: &[&str]) -> Result<(), WriteError> {
    let baseline = &overview.baseline;
    output.csv(
        "data/over-tasks-ratios.csv",
        overview.ratios.iter().map(|r| RatioRow {
            group: &r.group,
            task: &r.task,
            arm: &r.arm,
            baseline,
            budget: r.budget,
            runs: r.runs,
            solved: r.solved,
            baseline_runs: r.baseline_runs,
            baseline_solved: r.baseline_solved,
            median: r.median,
            baseline_median: r.baseline_median,
            ratio: r.ratio.mid,
            low: r.ratio.low,
            high: r.ratio.high,
            bound: r.bound,
            loss: r.loss,
        }),
    )?;
    output.csv(
        "data/over-tasks-totals.csv",
        overview.totals.iter().map(|t| TotalRow {
            group: t.group.as_deref().unwrap_or("all"),
            arm: &t.arm,
            baseline,
            tasks: t.tasks,
            geometric_mean: t.geometric_mean.mid,
            geometric_mean_low: t.geometric_mean.low,
            geometric_mean_high: t.geometric_mean.high,
            iqm: t.iqm.mid,
            iqm_low: t.iqm.low,
            iqm_high: t.iqm.high,
            improvement: t.improvement.mid,
            improvement_low: t.improvement.low,
            improvement_high: t.improvement.high,
            solved_share: t.solved_share.mid,
            baseline_solved_share: t.baseline_solved_share.mid,
            faster: t.faster,
            losses: t.losses,
            doubtful: t.doubtful,
            worst: t.worst,
        }),
    )?;
    profiles(output, overview, names)?;
    let mut parts: Vec<(&str, &str)> = overview.ratios.iter().map(|r| (&r.arm[..], &r.group[..])).collect();
    parts.dedup();
    for (arm, group) in parts {
        let ratios = overview.ratios.iter().filter(|r| (&r.arm[..], &r.group[..]) == (arm, group));
        task_ratios(output, [arm, group, baseline], &ratios.collect::<Vec<_>>(), names)?;
    }
    Ok(())
}

/// Performance profiles.
fn profiles(output: &mut Output<'_>, overview: &Overview, names: &[&str]) -> Result<(), WriteError> {
    let of = |name: &&str| {
        let profile = overview.profiles.iter().find(|profile| profile.arm == *name);
        Line { name: (*name).into(), points: profile.map_or_else(Vec::new, |profile| profile.points.clone()) }
    };
    // Without a solved run all of them are zero.
    if !overview.profiles.iter().flat_map(|profile| &profile.points).any(|point| point.1 > 0.0) {
        return Ok(());
    }
    let lines: Vec<Line> = names.iter().map(of).collect();
    let counts: Vec<Vec<usize>> =
        lines.iter().map(|line| vec![overview.ratios.len(); line.points.len()]).collect();
    let (low, high) = range(lines.iter().flat_map(|line| line.points.iter().map(|point| point.0)));
    let chart = Chart {
        title: "Performance profiles over all tasks".into(),
        x: plot::Axis::exact(
            &format!("log2(steps / {}'s median)", overview.baseline),
            low,
            high,
        ),
        y: plot::Axis::exact("share of runs solved, mean over tasks", 0.0, 1.0),
        lines,
        rules: Vec::new(),
        note: "environment steps over the baseline's median on the task; band: 95 % stratified bootstrap interval"
            .into(),
    };
    output.chart("over-tasks-profiles", &chart, &counts)
}

/// The ratio of `arm` on each task of `group`.
fn task_ratios(
    output: &mut Output<'_>,
    [arm, group, baseline]: [&str; 3],
    ratios: &[&Ratio],
    names: &[&str],
) -> Result<(), WriteError> {
    let number = names.iter().position(|name| *name == arm).unwrap_or(0);
    let row = |r: &&Ratio| plot::Row {
        name: r
            .task
            .strip_prefix(group)
            .unwrap_or(&r.task)
            .trim_start_matches('/')
            .chars()
            .take(34)
            .collect(),
        arm: number,
        estimate: r.ratio,
        note: format!("{}{:.2}{}", r.bound.sign(), r.ratio.mid, if r.loss { " loss" } else { "" }),
    };
    let rows: Vec<plot::Row> = ratios.iter().map(row).collect();
    let (_, high) = range(rows.iter().flat_map(|r| [r.estimate.mid, r.estimate.high]));
    let of_group = if group.is_empty() { String::new() } else { format!(", {group}") };
    let chart = Intervals {
        title: format!("{arm} / {baseline}{of_group}: ratio of median steps to solved"),
        note: "times cut off at the budget; 95 % bootstrap intervals; below 1 the arm is faster".into(),
        x: plot::Axis::fit("ratio of medians", Scale::Linear, 0.0, high.clamp(1.2, 4.0)),
        rows,
        rule: Some(1.0),
    };
    output.intervals(&format!("over-tasks-ratio-{}", slug(&format!("{arm}-{group}"))), &chart)
}
