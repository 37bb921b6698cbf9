//! The page: everything in one file, for light and dark screens and for paper.

use crate::effect::Effect;
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
pub(crate) fn page(
    title: &str,
    arms: &[ArmSummary],
    comparisons: &[Comparison],
    sections: &[Section<'_>],
    notes: &[String],
) -> String {
    let title = escape(title);
    let mut body = format!("<h1>{title}</h1>\n");
    // Writing to a String cannot fail.
    let _ = writeln!(
        body,
        "<p class=\"faint\">Medians and their ratios come with 95 % bootstrap intervals, shares with Wilson's. A run \
         that was not solved counts as later than any that was: a median is \"not reached\" where that is so for half \
         of the runs or more. Only runs that have run their whole length are counted; curves show all.</p>"
    );
    arm_table(&mut body, arms);
    comparison_table(&mut body, comparisons);
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
        let page = page("a & b", &[], &[], &[section], &["\"x\" < y".into()]);
        assert!(!page.contains("<script>") && page.contains("&lt;script&gt;"));
        assert!(page.contains("<h1>a &amp; b</h1>") && page.contains("&quot;x&quot; &lt; y"));
    }
}
