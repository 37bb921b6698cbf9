//! The page: everything in one file, for light and dark screens and for paper.

use crate::effect::Effect;
use crate::over_tasks::{DOUBT, LOSS, Overview, Ratio};
use crate::stats::Estimate;
use crate::summary::{ArmSummary, Comparison, Time};
use std::fmt::Write;

/// A picture on the page.
pub(crate) struct Figure {
    /// Its description, which screen readers read out.
    pub(crate) caption: String,
    /// [`crate::plot::inline`].
    pub(crate) svg: String,
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
    /// Each arm on each task.
    pub(crate) arms: &'a [ArmSummary],
    /// Each pair of arms on each task, and on all.
    pub(crate) comparisons: &'a [Comparison],
    /// All arms over all tasks, where there are several.
    pub(crate) overview: Option<&'a Overview>,
}

const STYLE: &str = "
:root { color-scheme: light dark; --paper: #fff; --ink: #1f2024; --faint: #5b5d66; --grid: #dcdde2; --back: #f6f6f8 }
@media (prefers-color-scheme: dark) {
  :root { --paper: #1a1b20; --ink: #e8e8ec; --faint: #a4a6b0; --grid: #3a3c45; --back: #121317 }
}
body { margin: 0 auto; max-width: 96rem; padding: 1.5rem; font: 15px/1.5 system-ui, sans-serif; color: var(--ink);
  background: var(--back) }
h1 { font-size: 1.6rem } h2 { font-size: 1.25rem; margin-top: 2.5rem }
p, li { max-width: 60rem } .faint { color: var(--faint) }
.wide { overflow-x: auto }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: .5rem 0 }
th, td { padding: .25rem .75rem; border-bottom: 1px solid var(--grid); text-align: right; white-space: nowrap }
th { font-weight: 600; vertical-align: bottom } td:first-child, th:first-child, td.name, th.name { text-align: left }
.figures { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 34rem), 1fr)); gap: 1rem }
figure { margin: 0; padding: .5rem; background: var(--paper); border: 1px solid var(--grid); border-radius: 6px }
figure svg { width: 100%; height: auto; display: block }
figcaption { position: absolute; clip-path: inset(50%) }
@media print { figure { break-inside: avoid } }
";

/// The whole page.
pub(crate) fn page(title: &str, tables: &Tables<'_>, sections: &[Section<'_>], notes: &[String]) -> String {
    let title = escape(title);
    let mut body = format!("<h1>{title}</h1>\n");
    // Writing to a String cannot fail.
    let _ = writeln!(
        body,
        "<p class=\"faint\">Medians and their ratios come with 95 % bootstrap intervals, shares with Wilson's. A run \
         that was not solved counts as later than any that was: a median is \"not reached\" where that is so for half \
         of the runs or more. Only runs that have run their whole length are counted; curves show all.</p>"
    );
    if let Some(overview) = tables.overview {
        totals_table(&mut body, overview);
        losses(&mut body, overview);
        ratio_table(&mut body, overview);
    }
    arm_table(&mut body, tables.arms);
    comparison_table(&mut body, tables.comparisons);
    for section in sections {
        let _ = writeln!(
            body,
            "<h2>{}</h2>\n<div class=\"figures\">",
            escape(section.task.unwrap_or("All tasks"))
        );
        for figure in &section.figures {
            let caption = escape(&figure.caption);
            let _ = writeln!(body, "<figure>{}<figcaption>{caption}</figcaption></figure>", figure.svg);
        }
        body.push_str("</div>\n");
    }
    if !notes.is_empty() {
        body.push_str("<h2>What is missing</h2>\n<ul>\n");
        notes.iter().for_each(|note| {
            let _ = writeln!(body, "<li>{}</li>", escape(note));
        });
        body.push_str("</ul>\n");
    }
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" \
         content=\"width=device-width\">\n<title>{title}</title>\n<style>{STYLE}</style>\n<body>\n{body}</body>\n</html>\n"
    )
}

fn totals_table(body: &mut String, overview: &Overview) {
    let baseline = escape(&overview.baseline);
    let _ = writeln!(
        body,
        "<h2>Over tasks, compared with {baseline}</h2>\n<p class=\"faint\">Times are environment steps until solved, over {baseline}'s \
         on the same task. A run that was not solved counts as if it had been with the last step of its budget. So the ratio of a \
         task on which {baseline} was not solved is too high (&le;), and that of a task on which only the arm was not solved is too \
         low (&ge;), and a loss. Other losses are ratios above {LOSS}. In \
         doubt are tasks without a loss whose interval reaches above {DOUBT}.</p>\n<div class=\"wide\"><table>\n<tr><th>tasks</th>\
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
    body.push_str("<h2>Losses</h2>\n");
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
        "<h2>Task by task</h2>\n<div class=\"wide\"><table>\n<tr><th>task</th><th>budget</th><th>{}: median<br>steps to solved</th>",
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

fn arm_table(body: &mut String, arms: &[ArmSummary]) {
    body.push_str(
        "<h2>Arms</h2>\n<div class=\"wide\"><table>\n<tr><th>task</th><th class=\"name\">arm</th><th>complete</th><th>solved</th>\
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
            escape(&arm.arm),
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
        "<h2>Comparisons</h2>\n<div class=\"wide\"><table>\n<tr><th>task</th><th class=\"name\">arm</th><th class=\"name\">with</th>\
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
        let section = Section { task: Some("<script>"), figures: Vec::new() };
        let page = page(
            "a & b",
            &Tables { arms: &[], comparisons: &[], overview: None },
            &[section],
            &["\"x\" < y".into()],
        );
        assert!(!page.contains("<script>") && page.contains("&lt;script&gt;"));
        assert!(page.contains("<h1>a &amp; b</h1>") && page.contains("&quot;x&quot; &lt; y"));
    }
}
