//! The page: everything in one file, for light and dark screens and for paper.

use crate::apart::settings;
use crate::effect::Effect;
use crate::over_tasks::{DOUBT, LOSS, Overview, Ratio};
use crate::plot::swatch;
use crate::run::Run;
use crate::stats::Estimate;
use crate::summary::{ArmSummary, Comparison, Time};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

/// What a picture is about. The page has these parts in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// Returns over the training.
    Curves,
    /// How long it took, and how many got there.
    Times,
    /// What became of the mentor's transitions.
    Mentor,
    /// Runs on their maps.
    Maps,
}

/// A picture on the page.
pub(crate) struct Figure {
    /// Its heading.
    pub(crate) title: String,
    /// The meaning of its lines and colours.
    pub(crate) note: String,
    /// The name of its files, without their ends.
    pub(crate) file: String,
    /// [`crate::plot::inline`].
    pub(crate) svg: String,
    /// What it is about.
    pub(crate) part: Part,
}

/// The pictures of a task, or of all of them together.
pub(crate) struct Section<'a> {
    /// Name of the environment.
    pub(crate) task: Option<&'a str>,
    /// Its pictures.
    pub(crate) figures: Vec<Figure>,
}

/// The numbers of the tables.
pub(crate) struct Tables<'a> {
    /// All arms in the order of their colours.
    pub(crate) names: &'a [&'a str],
    /// Each arm on each task.
    pub(crate) arms: &'a [ArmSummary],
    /// Each pair of arms on each task, and on all.
    pub(crate) comparisons: &'a [Comparison],
    /// All arms over all tasks, where there are several.
    pub(crate) overview: Option<&'a Overview>,
    /// All runs.
    pub(crate) runs: &'a [Run],
    /// The directory that the page is in.
    pub(crate) from: &'a Path,
}

const STYLE: &str = include_str!("page.css");

/// The whole page.
pub(crate) fn page(title: &str, tables: &Tables<'_>, sections: &[Section<'_>], notes: &[String]) -> String {
    let title = escape(title);
    let mut parts: Vec<(&str, String, String)> = Vec::new();
    let curves = figures(sections, |part| part == Part::Curves);
    if !curves.is_empty() {
        parts.push(("curves", "Learning curves".into(), curves));
    }
    if let Some(overview) = tables.overview {
        let mut text = String::new();
        totals_table(&mut text, overview);
        losses(&mut text, overview);
        ratio_table(&mut text, overview);
        parts.push(("tasks", format!("Over tasks, compared with {}", escape(&overview.baseline)), text));
    }
    let mut text = String::new();
    arm_table(&mut text, tables.arms, tables.names);
    parts.push(("arms", "Arms".into(), text));
    let mut text = String::new();
    comparison_table(&mut text, tables.comparisons);
    if !text.is_empty() {
        parts.push(("comparisons", "Comparisons".into(), text));
    }
    for (part, id, heading) in [
        (Part::Times, "times", "Times and shares"),
        (Part::Mentor, "mentor", "The mentor's transitions"),
        (Part::Maps, "maps", "On the map"),
    ] {
        let text = figures(sections, |of| of == part);
        if !text.is_empty() {
            parts.push((id, heading.into(), text));
        }
    }
    parts.push(("runs", "Runs".into(), run_table(tables.runs, tables.from)));
    let settings = settings_table(tables.runs, tables.names);
    if !settings.is_empty() {
        parts.push(("settings", "Settings".into(), settings));
    }
    if !notes.is_empty() {
        let items: String = notes.iter().map(|note| format!("<li>{}</li>\n", escape(note))).collect();
        parts.push(("missing", "What is missing".into(), format!("<ul>\n{items}</ul>\n")));
    }
    let mut body = format!("<header>\n<h1>{title}</h1>\n{}", made_by(tables.runs));
    body.push_str("<nav aria-label=\"Contents\"><ul>\n");
    // Writing to a String cannot fail.
    for (id, heading, _) in &parts {
        let _ = writeln!(body, "<li><a href=\"#{id}\">{heading}</a></li>");
    }
    let _ = writeln!(body, "</ul></nav>\n</header>\n{}<main>", legend(tables.names));
    for (id, heading, text) in &parts {
        let _ = writeln!(body, "<section id=\"{id}\">\n<h2>{heading}</h2>\n{text}</section>");
    }
    body.push_str("</main>\n");
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" \
         content=\"width=device-width\">\n<title>{title}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n{body}</body>\n</html>\n"
    )
}

/// Who made the runs, and when the last of them was done.
fn made_by(runs: &[Run]) -> String {
    let mut builds: Vec<String> = runs
        .iter()
        .filter(|run| !run.version.is_empty())
        .map(|run| match run.commit.get(..12) {
            Some(commit) => format!("Trestle {}, commit {}", escape(&run.version), escape(commit)),
            None => format!("Trestle {}", escape(&run.version)),
        })
        .collect();
    builds.sort_unstable();
    builds.dedup();
    let newest =
        runs.iter().filter_map(|run| run.finished).max().map(|at| format!("last result of {}", date(at)));
    let all: Vec<String> = builds.into_iter().chain(newest).collect();
    if all.is_empty() { String::new() } else { format!("<p class=\"faint\">{}</p>\n", all.join("; ")) }
}

/// The arms with their colours and dashes, which are the same in all pictures.
fn legend(names: &[&str]) -> String {
    let arm = |(index, name): (usize, &&str)| format!("<li>{}{}</li>", swatch(index), escape(name));
    let arms: String = names.iter().enumerate().map(arm).collect();
    format!("<aside class=\"legend\" aria-label=\"Colours of the arms\"><ul>{arms}</ul></aside>\n")
}

/// The pictures of one part, task by task.
fn figures(sections: &[Section<'_>], of: impl Fn(Part) -> bool) -> String {
    let mut text = String::new();
    for section in sections {
        let mut figures = section.figures.iter().filter(|figure| of(figure.part)).peekable();
        if figures.peek().is_none() {
            continue;
        }
        if sections.len() > 1 {
            let _ = writeln!(text, "<h3>{}</h3>", escape(section.task.unwrap_or("All tasks")));
        }
        text.push_str("<div class=\"figures\">\n");
        let task = section.task.map(|task| format!(": {task}")).unwrap_or_default();
        for Figure { title, note, file, svg, .. } in figures {
            // Its section has the task's name.
            let (title, note) = (escape(title.strip_suffix(&task).unwrap_or(title)), escape(note));
            let svg = svg.replacen("role=\"img\"", &format!("role=\"img\" aria-label=\"{title}\""), 1);
            let _ = writeln!(
                text,
                "<figure><figcaption><b>{title}</b> <span class=\"faint\">{note} (<a href=\"pictures/{file}.svg\">SVG</a>, \
                 <a href=\"pictures/{file}.png\">PNG</a>, <a href=\"pictures/{file}.pdf\">PDF</a>)</span></figcaption>{svg}</figure>"
            );
        }
        text.push_str("</div>\n");
    }
    text
}

/// A line a run, with links to what it has left.
fn run_table(runs: &[Run], from: &Path) -> String {
    let mut text = String::from(
        "<div class=\"wide\" tabindex=\"0\" role=\"region\" aria-label=\"Table of runs\"><table>\n<tr><th>task</th><th class=\"name\">arm</th>\
         <th>seed</th><th>state</th><th>episodes</th><th>steps</th><th>solved at step</th><th>best return</th><th>last return</th>\
         <th>time</th><th>result of</th><th class=\"name\">files</th></tr>\n",
    );
    let number = |value: Option<f64>| value.map_or("-".into(), |value| group(value, 2));
    for run in runs {
        let of = run.result.as_ref();
        let count = |value: Option<u64>| value.map_or("-".into(), |value| group(value as f64, 0));
        let state = match (of, run.complete()) {
            (_, Some(_)) => "complete",
            (Some(_), None) => "interrupted",
            (None, None) => "no result",
        };
        let there = relative(from, &run.path);
        let link = |file: &str| format!("<a href=\"{}\">{file}</a>", escape(&format!("{there}/{file}")));
        let result = of.map(|_| format!(" {}", link("result.json"))).unwrap_or_default();
        let _ = writeln!(
            text,
            "<tr><td>{}</td><td class=\"name\">{}</td><td>{}</td><td>{state}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td>\
             <td>{}</td><td>{}</td><td class=\"name\">{} {}{result}</td></tr>",
            escape(&run.task),
            escape(&run.arm),
            run.config.run.seed,
            count(of.map(|o| o.episodes)),
            count(of.map(|o| o.env_steps)),
            count(of.and_then(|o| o.solved_env_steps)),
            number(of.and_then(|o| o.best_return)),
            number(of.and_then(|o| o.final_return)),
            of.map_or("-".into(), |o| format!("{} s", group(o.wall_s, 1))),
            run.finished.map_or("-".into(), date),
            link("config.toml"),
            link("evals.csv"),
        );
    }
    text.push_str("</table></div>\n");
    text
}

/// The settings in which arms differ, from the first run of each; empty where they do not.
fn settings_table(runs: &[Run], names: &[&str]) -> String {
    let of = |arm: &&str| runs.iter().find(|run| run.arm == **arm).map(|run| settings(&run.config));
    let all: Vec<BTreeMap<String, String>> = names.iter().map(|arm| of(arm).unwrap_or_default()).collect();
    let mut keys: Vec<&String> = all.iter().flat_map(BTreeMap::keys).collect();
    keys.sort_unstable();
    keys.dedup();
    let differing: Vec<&String> = keys
        .into_iter()
        // Seeds are in the table of runs, and files are where each run has put them.
        .filter(|key| !["run.seed", "mentor.demo"].contains(&key.as_str()))
        .filter(|key| all.iter().any(|of| of.get(*key) != all[0].get(*key)))
        .collect();
    if differing.is_empty() {
        return String::new();
    }
    let mut text = String::from(
        "<p class=\"faint\">Settings in which the arms differ, each from the arm's first run; all others are in the runs' config.toml.</p>\n\
         <div class=\"wide\" tabindex=\"0\" role=\"region\" aria-label=\"Table of settings\"><table>\n<tr><th class=\"name\">setting</th>",
    );
    names.iter().for_each(|name| {
        let _ = write!(text, "<th>{}</th>", escape(name));
    });
    text.push_str("</tr>\n");
    for key in differing {
        let _ = write!(text, "<tr><td class=\"name\"><code>{}</code></td>", escape(key));
        for of in &all {
            let value: String = of.get(key).map_or("-".into(), |value| value.chars().take(60).collect());
            let _ = write!(text, "<td>{}</td>", escape(&value));
        }
        text.push_str("</tr>\n");
    }
    text.push_str("</table></div>\n");
    text
}

/// The way from the directory `from` to `path`, for a link.
fn relative(from: &Path, path: &Path) -> String {
    let [from, path] = [from, path].map(|path| std::path::absolute(path).unwrap_or_else(|_| path.into()));
    let common = from.components().zip(path.components()).take_while(|(a, b)| a == b).count();
    let up = from.components().skip(common).map(|_| "..".to_string());
    let down = path.components().skip(common).map(|name| encoded(&name.as_os_str().to_string_lossy()));
    up.chain(down).collect::<Vec<_>>().join("/")
}

/// `name` as part of an address.
fn encoded(name: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.~".contains(&byte);
    name.bytes()
        .map(|byte| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") })
        .collect()
}

/// The day of `seconds` since 1970, as 2026-01-31; by Howard Hinnant's `civil_from_days`.
fn date(seconds: u64) -> String {
    let days = seconds / 86_400 + 719_468;
    let (era, day) = (days / 146_097, days % 146_097);
    let year = (day - day / 1_460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let day = day - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    format!("{:04}-{month:02}-{day:02}", 400 * era + year + u64::from(month <= 2))
}

fn totals_table(body: &mut String, overview: &Overview) {
    let baseline = escape(&overview.baseline);
    let _ = writeln!(
        body,
        "<p class=\"faint\">Times are environment steps until solved, over {baseline}'s \
         on the same task. A run that was not solved counts as if it had been with the last step of its budget. So the ratio of a \
         task on which {baseline} was not solved is too high (&le;), and that of a task on which only the arm was not solved is too \
         low (&ge;), and a loss. Other losses are ratios above {LOSS}. In \
         doubt are tasks without a loss whose interval reaches above {DOUBT}.</p>\n<div class=\"wide\" tabindex=\"0\" \
         role=\"region\" aria-label=\"Table of totals over tasks\"><table>\n<tr><th>tasks</th>\
         <th class=\"name\">arm</th><th>number</th><th>geometric mean<br>of ratios</th><th>interquartile mean<br>over runs</th>\
         <th>probability of<br>fewer steps</th><th>share of runs<br>solved</th><th>{baseline}'s</th><th>faster on</th><th>losses</th>\
         <th>in doubt</th><th>largest ratio</th></tr>"
    );
    for total in &overview.totals {
        let _ = writeln!(
            body,
            "<tr><td>{}</td><td class=\"name\">{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td>\
             <td>{}</td><td>{}</td><td>{:.2}</td></tr>",
            escape(total.group.as_deref().unwrap_or("all")),
            escape(&total.arm),
            total.tasks,
            interval(total.geometric_mean, 2, "-"),
            interval(total.iqm, 2, "-"),
            interval(total.improvement, 2, "-"),
            interval(total.solved_share, 2, "-"),
            interval(total.baseline_solved_share, 2, "-"),
            total.faster,
            total.losses,
            total.doubtful,
            total.worst,
        );
    }
    body.push_str("</table></div>\n");
}

/// The tasks on which an arm loses, by name.
fn losses(body: &mut String, overview: &Overview) {
    let losses: Vec<&Ratio> = overview.ratios.iter().filter(|ratio| ratio.loss).collect();
    body.push_str("<h3>Losses</h3>\n");
    if losses.is_empty() {
        body.push_str("<p>No arm loses on any task.</p>\n");
        return;
    }
    body.push_str("<ul>\n");
    for ratio in losses {
        let _ = writeln!(
            body,
            "<li>{} on {}: {}{}, {} of {} runs solved, of {} {} of {}</li>",
            escape(&ratio.arm),
            escape(&ratio.task),
            ratio.bound.sign(),
            interval(ratio.ratio, 2, "-"),
            ratio.solved,
            ratio.runs,
            escape(&overview.baseline),
            ratio.baseline_solved,
            ratio.baseline_runs,
        );
    }
    body.push_str("</ul>\n");
}

/// A line a task: the baseline's median, then the median and the ratio of each other arm.
fn ratio_table(body: &mut String, overview: &Overview) {
    let mut arms: Vec<&str> = overview.ratios.iter().map(|ratio| &ratio.arm[..]).collect();
    arms.dedup();
    let mut tasks: Vec<&str> = Vec::new();
    for ratio in &overview.ratios {
        if !tasks.contains(&&ratio.task[..]) {
            tasks.push(&ratio.task);
        }
    }
    let median = |steps: f64| if steps.is_finite() { group(steps, 0) } else { "not reached".into() };
    let solved = |solved: usize, runs: usize| format!("<span class=\"faint\">{solved} of {runs}</span>");
    let _ = write!(
        body,
        "<h3>Task by task</h3>\n<div class=\"wide\" tabindex=\"0\" role=\"region\" aria-label=\"Table of ratios by task\"><table>\n<tr><th>task</th><th>budget</th><th>{}: median<br>steps to solved</th>",
        escape(&overview.baseline)
    );
    for arm in &arms {
        let arm = escape(arm);
        let _ = write!(body, "<th>{arm}: median<br>steps to solved</th><th>{arm}:<br>ratio</th>");
    }
    body.push_str("</tr>\n");
    for task in tasks {
        let of = |arm: &str| overview.ratios.iter().find(|ratio| ratio.task == task && ratio.arm == arm);
        let Some(first) = arms.iter().find_map(|arm| of(arm)) else { continue };
        let _ = write!(
            body,
            "<tr><td>{}</td><td>{}</td><td>{} {}</td>",
            escape(task),
            group(first.budget, 0),
            median(first.baseline_median),
            solved(first.baseline_solved, first.baseline_runs)
        );
        for arm in &arms {
            let _ = match of(arm) {
                Some(ratio) => write!(
                    body,
                    "<td>{} {}</td><td>{}{}{}</td>",
                    median(ratio.median),
                    solved(ratio.solved, ratio.runs),
                    ratio.bound.sign(),
                    interval(ratio.ratio, 2, "-"),
                    if ratio.loss { " <strong>loss</strong>" } else { "" }
                ),
                None => write!(body, "<td>-</td><td>-</td>"),
            };
        }
        body.push_str("</tr>\n");
    }
    body.push_str("</table></div>\n");
}

fn arm_table(body: &mut String, arms: &[ArmSummary], names: &[&str]) {
    body.push_str(
        "<p class=\"faint\">Medians and their ratios come with 95 % bootstrap intervals, shares with Wilson's. A run that was not \
         solved counts as later than any that was: a median is \"not reached\" where that is so for half of the runs or more. Only \
         runs that have run their whole length are counted; curves show all.</p>\n<div class=\"wide\" tabindex=\"0\" role=\"region\" aria-label=\"Table of arms\"><table>\n<tr><th>task</th><th class=\"name\">arm</th><th>complete</th><th>solved</th>\
         <th>share solved</th><th>median episodes<br>to solved</th><th>median environment<br>steps to solved</th>\
         <th>optimal</th><th>last return,<br>mean &plusmn; std</th><th>mentor: feasible,<br>bridged, in the loss</th>\
         <th>environment<br>steps/s</th></tr>\n",
    );
    for arm in arms {
        let count = |e: Estimate| interval(e, 0, "not reached");
        let _ = writeln!(
            body,
            "<tr><td>{}</td><td class=\"name\">{}</td><td>{} of {}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td>\
             <td>{}</td><td>{}</td><td>{}</td></tr>",
            escape(&arm.task),
            names.iter().position(|name| *name == arm.arm).map(swatch).unwrap_or_default()
                + &escape(&arm.arm),
            arm.complete,
            arm.runs,
            arm.solved,
            interval(arm.solved_share, 2, "-"),
            count(arm.times[0].median),
            count(arm.times[1].median),
            arm.optimal,
            if arm.final_return_mean.is_finite() {
                format!("{:.2} &plusmn; {:.2}", arm.final_return_mean, arm.final_return_std)
            } else {
                "-".into()
            },
            arm.mentor.map_or("-".into(), shares),
            if arm.wall_s > 0.0 { group(arm.env_steps as f64 / arm.wall_s, 0) } else { "-".into() },
        );
    }
    body.push_str("</table></div>\n");
    for (arm, warning) in arms.iter().filter_map(|arm| Some((arm, arm.mentor?.warning()?))) {
        let _ = writeln!(body, "<p>{}, {}: {}.</p>", escape(&arm.task), escape(&arm.arm), escape(&warning));
    }
}

/// The shares of an effect, as cells of the table have them.
fn shares(effect: Effect) -> String {
    let [feasible, bridged, loss] =
        [effect.feasible_frac, effect.bridged_frac, effect.loss_frac].map(|share| 100.0 * share);
    format!("{feasible:.0} %, {bridged:.0} %, {loss:.1} %")
}

fn comparison_table(body: &mut String, comparisons: &[Comparison]) {
    if comparisons.is_empty() {
        return;
    }
    body.push_str(
        "<div class=\"wide\" tabindex=\"0\" role=\"region\" aria-label=\"Table of comparisons\"><table>\n<tr><th>task</th><th class=\"name\">arm</th><th class=\"name\">with</th>\
         <th>ratio of median<br>episodes to solved</th><th>ratio of median<br>steps to solved</th>\
         <th>probability of<br>fewer steps</th></tr>\n",
    );
    for steps in comparisons.iter().filter(|c| c.time == Time::SolvedEnvSteps) {
        let same = |c: &&Comparison| {
            c.time == Time::SolvedEpisode
                && (&c.task, &c.arm, &c.with) == (&steps.task, &steps.arm, &steps.with)
        };
        let ratio = |c: Option<&Comparison>| {
            c.and_then(|c| c.ratio).map_or("-".into(), |ratio| interval(ratio, 2, "undefined"))
        };
        let _ = writeln!(
            body,
            "<tr><td>{}</td><td class=\"name\">{}</td><td class=\"name\">{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            escape(steps.task.as_deref().unwrap_or("all tasks")),
            escape(&steps.arm),
            escape(&steps.with),
            ratio(comparisons.iter().find(same)),
            ratio(Some(steps)),
            interval(steps.improvement, 2, "-"),
        );
    }
    body.push_str("</table></div>\n");
}

/// An estimate with its interval, or `absent` where it has no finite value.
fn interval(estimate: Estimate, decimals: usize, absent: &str) -> String {
    let end = |x: f64| if x.is_finite() { group(x, decimals) } else { "&infin;".into() };
    let mid = if estimate.mid.is_finite() { group(estimate.mid, decimals) } else { absent.into() };
    match estimate.low.is_nan() {
        true => mid,
        false => {
            format!("{mid} <span class=\"faint\">[{}, {}]</span>", end(estimate.low), end(estimate.high))
        }
    }
}

/// `x` with its thousands apart.
fn group(x: f64, decimals: usize) -> String {
    let text = format!("{x:.decimals$}");
    let (whole, rest) = text.split_at(text.find('.').unwrap_or(text.len()));
    let digits = whole.trim_start_matches('-').len();
    let sign = whole.len() - digits;
    let mut out = String::from(&whole[..sign]);
    for (at, digit) in whole[sign..].chars().enumerate() {
        if at > 0 && (digits - at).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out + rest
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn numbers_are_easy_to_read() {
        assert_eq!(group(1_234_567.0, 0), "1,234,567");
        assert_eq!((group(-999.5, 1), group(-1000.0, 0)), ("-999.5".into(), "-1,000".into()));
        let never = f64::INFINITY;
        let text = interval(Estimate { mid: never, low: 1500.0, high: never }, 0, "not reached");
        assert_eq!(text, "not reached <span class=\"faint\">[1,500, &infin;]</span>");
    }

    #[test]
    fn names_cannot_break_the_page() {
        let figure = Figure {
            title: "<i>".into(),
            note: String::new(),
            file: "f".into(),
            svg: "<svg/>".into(),
            part: Part::Curves,
        };
        let section = Section { task: Some("<script>"), figures: vec![figure] };
        let other = Section { task: None, figures: Vec::new() };
        let tables = Tables {
            names: &["<b>"],
            arms: &[],
            comparisons: &[],
            overview: None,
            runs: &[],
            from: Path::new("report"),
        };
        let page = page("a & b", &tables, &[section, other], &["\"x\" < y".into()]);
        assert!(!page.contains("<script>") && !page.contains("<i>") && !page.contains("<b><"));
        assert!(page.contains("<h3>&lt;script&gt;</h3>") && page.contains("</svg>&lt;b&gt;</li>"));
        assert!(page.contains("<h1>a &amp; b</h1>") && page.contains("&quot;x&quot; &lt; y"));
        let contents = page.find("href=\"#missing\"").unwrap();
        assert!(
            page.find("href=\"#curves\"").unwrap() < contents
                && contents < page.find("id=\"curves\"").unwrap()
        );
    }

    #[test]
    fn a_run_is_found_from_the_page() {
        let way = |from: &str, path: &str| relative(Path::new(from), Path::new(path));
        assert_eq!(way("/s/report", "/s/a/seed-0"), "../a/seed-0");
        assert_eq!(way("/elsewhere", "/s/a b/seed-\"0"), "../s/a%20b/seed-%220");
        assert_eq!(way("s/report", "s"), "..");
    }

    #[test]
    fn days_are_those_of_the_calendar() {
        let days = [
            (0, "1970-01-01"),
            (951_782_400, "2000-02-29"),
            (1_796_083_199, "2026-11-30"),
            (4_107_542_400, "2100-03-01"),
        ];
        for (seconds, day) in days {
            assert_eq!(date(seconds), day);
        }
    }
}
