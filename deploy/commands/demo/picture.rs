//! Two features of a demonstration as a picture: characters for a terminal, or SVG.

use anyhow::{Result, ensure};
use std::fmt::Write;
use std::ops::Range;
use trestle_algorithm::demonstration::Demonstration;

/// Characters of a picture in a terminal; one is about twice as high as wide.
const COLUMNS: usize = 64;
const ROWS: usize = 24;
/// Longest side of an SVG's drawing, and its margin, pixels.
const SIDE: f64 = 640.0;
const MARGIN: f64 = 24.0;
/// About the most points that an SVG has; of more states, every second, third, ... one is drawn.
const MAX_POINTS: usize = 50_000;

/// Which features are drawn: the first two, or the only one over the number of its step.
pub(super) struct Picture<'a> {
    demonstration: &'a Demonstration,
    /// Feature to the right, none for the step, and feature upwards.
    axes: (Option<usize>, usize),
    /// Whether the second feature grows downwards, as rows do.
    down: bool,
    /// Smallest values and extents.
    low: [f64; 2],
    extent: [f64; 2],
}

impl<'a> Picture<'a> {
    /// `axes` are features of the demonstration, two of them; `down` if the second grows downwards.
    pub(super) fn new(
        demonstration: &'a Demonstration,
        axes: Option<[usize; 2]>,
        down: bool,
    ) -> Result<Self> {
        let dim = demonstration.dim();
        let axes = match axes {
            Some(axes) => {
                for axis in axes {
                    ensure!(axis < dim, "--axes: there is no feature {axis}; accepted: 0 to {}", dim - 1);
                }
                (Some(axes[0]), axes[1])
            }
            None if dim == 1 => (None, 0),
            None => (Some(0), 1),
        };
        let picture = Self { demonstration, axes, down, low: [0.0; 2], extent: [1.0; 2] };
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for point in (0..demonstration.n_trajectories()).flat_map(|i| picture.points(i, 1)) {
            for axis in 0..2 {
                low[axis] = low[axis].min(point[axis]);
                high[axis] = high[axis].max(point[axis]);
            }
        }
        let extent = [0, 1].map(|axis: usize| (high[axis] - low[axis]).max(f64::MIN_POSITIVE));
        Ok(Self { low, extent, ..picture })
    }

    /// The points of a trajectory, of `every` states one, and its last.
    fn points(&self, trajectory: usize, every: usize) -> impl Iterator<Item = [f64; 2]> {
        let (demonstration, (x, y)) = (self.demonstration, self.axes);
        let Range { start, end } = demonstration.trajectory(trajectory);
        let drawn = move |m: &usize| (m - start).is_multiple_of(every) || m + 1 == end;
        (start..end).filter(drawn).map(move |m| {
            let state = demonstration.state(m);
            [x.map_or((m - start) as f64, |x| state[x].into()), state[y].into()]
        })
    }

    /// A point's place, 0 to 1 to the right and downwards.
    fn place(&self, point: [f64; 2]) -> [f64; 2] {
        let [x, y] = [0, 1].map(|axis: usize| (point[axis] - self.low[axis]) / self.extent[axis]);
        [x, if self.down { y } else { 1.0 - y }]
    }

    fn names(&self) -> [&str; 2] {
        let names = self.demonstration.names();
        [self.axes.0.map_or("step", |x| names[x].as_str()), names[self.axes.1].as_str()]
    }

    /// For a terminal: `*` states, `S` first and `E` last states of trajectories.
    pub(super) fn text(&self) -> String {
        let mut letters = vec![vec![' '; COLUMNS]; ROWS];
        for i in 0..self.demonstration.n_trajectories() {
            let n = self.demonstration.trajectory(i).len();
            for (at, point) in self.points(i, 1).enumerate() {
                let [x, y] = self.place(point);
                let cell = &mut letters[(y * (ROWS - 1) as f64).round() as usize]
                    [(x * (COLUMNS - 1) as f64).round() as usize];
                // Ends stay to be seen.
                *cell = match (at, *cell) {
                    (_, 'E') => 'E',
                    (at, _) if at + 1 == n => 'E',
                    (0, _) | (_, 'S') => 'S',
                    _ => '*',
                };
            }
        }
        let bar = "-".repeat(COLUMNS);
        let [x, y] = self.names();
        // As the demonstration has them: 32 bits.
        let [left, low] = self.low.map(|x| x as f32);
        let [right, up] = [0, 1].map(|axis: usize| (self.low[axis] + self.extent[axis]) as f32);
        let mut out = format!("+{bar}+\n");
        for line in letters {
            out.extend(['|'].into_iter().chain(line).chain(['|', '\n']));
        }
        let direction = if self.down { "down" } else { "up" };
        // Writing to a string cannot fail.
        let _ = write!(
            out,
            "+{bar}+\nright: {x}, {left} to {right}; {direction}: {y}, {low} to {up}; S first, E last states"
        );
        out
    }

    /// A drawing that keeps the proportions of two features: a line a trajectory, a ring where it begins, a dot where
    /// it ends, filled if that is a terminal state.
    pub(super) fn svg(&self) -> String {
        let longest = self.extent[0].max(self.extent[1]);
        let [width, height] = match self.axes.0 {
            // In proportion, but never a mere line.
            Some(_) => self.extent.map(|extent| SIDE * (extent / longest).max(0.05)),
            None => [SIDE, SIDE / 2.0],
        };
        let every = self.demonstration.n_states().div_ceil(MAX_POINTS);
        let at = |point: [f64; 2]| {
            let [x, y] = self.place(point);
            [MARGIN + x * width, MARGIN + y * height]
        };
        let (full_width, full_height) = (width + 2.0 * MARGIN, height + 2.0 * MARGIN);
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {full_width:.1} {full_height:.1}\" \
             font-family=\"sans-serif\" font-size=\"12\">\n<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n"
        );
        for i in 0..self.demonstration.n_trajectories() {
            let points: Vec<[f64; 2]> = self.points(i, every).map(at).collect();
            let line: Vec<String> = points.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect();
            let ([x0, y0], [x1, y1]) = (points[0], points[points.len() - 1]);
            let fill = if self.demonstration.terminal(i) { "#c33" } else { "#fff" };
            // Writing to a string cannot fail.
            let _ = write!(
                out,
                "<polyline fill=\"none\" stroke=\"#36c\" stroke-opacity=\"0.6\" points=\"{}\"/>\n\
                 <circle cx=\"{x0:.1}\" cy=\"{y0:.1}\" r=\"4\" fill=\"none\" stroke=\"#393\"/>\n\
                 <circle cx=\"{x1:.1}\" cy=\"{y1:.1}\" r=\"4\" fill=\"{fill}\" stroke=\"#c33\"/>\n",
                line.join(" ")
            );
        }
        let [x, y] = self.names().map(escape);
        let _ = write!(
            out,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{x}</text>\n<text x=\"4\" y=\"14\">{y}</text>\n</svg>\n",
            full_width - 4.0,
            full_height - 6.0
        );
        out
    }
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn square() -> Demonstration {
        let mut demonstration = Demonstration::new(vec!["x".into(), "a<b".into()]).unwrap();
        demonstration.push_trajectory(&[0.0, 0.0, 4.0, 0.0, 4.0, 2.0], true).unwrap();
        demonstration
    }

    #[test]
    fn a_terminal_shows_first_and_last_states() {
        let demonstration = square();
        let text = Picture::new(&demonstration, None, false).unwrap().text();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), ROWS + 3);
        assert!(
            lines[1].ends_with("E|") && lines[ROWS].starts_with("|S ") && lines[ROWS].ends_with("*|"),
            "{text}"
        );
        assert!(text.ends_with("right: x, 0 to 4; up: a<b, 0 to 2; S first, E last states"), "{text}");
        let down = Picture::new(&demonstration, None, true).unwrap().text();
        assert!(down.lines().nth(1).unwrap().starts_with("|S "), "{down}");
        let error = Picture::new(&demonstration, Some([0, 2]), true).err().unwrap();
        assert_eq!(error.to_string(), "--axes: there is no feature 2; accepted: 0 to 1");
    }

    #[test]
    fn a_drawing_keeps_proportions_and_thins_long_lines() {
        let svg = Picture::new(&square(), None, false).unwrap().svg();
        assert!(svg.contains("viewBox=\"0 0 688.0 368.0\""), "{svg}");
        assert!(svg.contains("points=\"24.0,344.0 664.0,344.0 664.0,24.0\""), "{svg}");
        assert!(svg.contains("a&lt;b") && svg.contains("fill=\"#c33\""), "{svg}");
        let mut long = Demonstration::new(vec!["x".into()]).unwrap();
        long.push_trajectory(&(0..200_001).map(|i| i as f32).collect::<Vec<_>>(), false).unwrap();
        let svg = Picture::new(&long, None, false).unwrap().svg();
        let points = svg.split("points=\"").nth(1).unwrap().split('"').next().unwrap().split(' ').count();
        assert!((40_000..=50_001).contains(&points), "{points}");
        let mut still = Demonstration::new(vec!["x".into(), "y".into()]).unwrap();
        still.push_trajectory(&[1.0; 4], false).unwrap();
        let picture = Picture::new(&still, None, false).unwrap();
        assert!(!picture.svg().contains("NaN") && picture.text().contains('E'));
    }
}
