//! Two features of a demonstration as a picture: characters for a terminal, or SVG.

use anyhow::{Result, ensure};
use std::fmt::Write;
use std::ops::Range;
use trestle_actor::env::Ground;
use trestle_algorithm::demonstration::Demonstration;

/// Characters of a picture in a terminal; one is about twice as high as wide.
const COLUMNS: usize = 64;
const ROWS: usize = 24;
/// Longest side of an SVG's drawing, and the room around it, pixels.
const SIDE: f64 = 640.0;
const MARGIN: f64 = 16.0;
const LEFT: f64 = 64.0;
const BELOW: f64 = 48.0;
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

    /// A drawing that keeps the proportions of two features, with their names and ticks: a line a trajectory, a ring where it
    /// begins, a dot where it ends, filled if that is a terminal state. The walls of `ground` are drawn where there is one.
    pub(super) fn svg(&self, ground: Option<&dyn Ground>) -> String {
        let walls = ground.map_or_else(Vec::new, walls);
        // All of the map is shown, half a cell around its outer places.
        let corners = ground.map_or_else(Vec::new, |ground| {
            let [columns, rows] = ground.size().map(|size| size as f64);
            vec![corner(ground, [-0.5, -0.5]), corner(ground, [columns - 0.5, rows - 0.5])]
        });
        let (mut low, mut high) = (self.low, [0, 1].map(|axis: usize| self.low[axis] + self.extent[axis]));
        for point in &corners {
            for axis in 0..2 {
                low[axis] = low[axis].min(point[axis]);
                high[axis] = high[axis].max(point[axis]);
            }
        }
        // A state that stays where it is has none.
        let extent = [0, 1].map(|axis: usize| (high[axis] - low[axis]).max(f64::MIN_POSITIVE));
        let whole = Picture { low, extent, ..*self };
        let longest = extent[0].max(extent[1]);
        let [width, height] = match self.axes.0 {
            // In proportion, but never a mere line.
            Some(_) => extent.map(|extent| SIDE * (extent / longest).max(0.05)),
            None => [SIDE, SIDE / 2.0],
        };
        let every = self.demonstration.n_states().div_ceil(MAX_POINTS);
        let at = |point: [f64; 2]| {
            let [x, y] = whole.place(point);
            [LEFT + x * width, MARGIN + y * height]
        };
        let (full_width, full_height) = (LEFT + width + MARGIN, MARGIN + height + BELOW);
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {full_width:.1} {full_height:.1}\" \
             font-family=\"sans-serif\" font-size=\"13\">\n<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n"
        );
        // Writing to a string cannot fail.
        for wall in &walls {
            // Rounded as they are written, so that neighbours meet.
            let [[x0, y0], [x1, y1]] = wall.map(|corner| at(corner).map(|at| (10.0 * at).round() / 10.0));
            let (x, y, w, h) = (x0.min(x1), y0.min(y1), (x1 - x0).abs(), (y1 - y0).abs());
            let _ = writeln!(
                out,
                "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{w:.1}\" height=\"{h:.1}\" fill=\"#3c3e46\" shape-rendering=\"crispEdges\"/>"
            );
        }
        let (right, bottom) = (LEFT + width, MARGIN + height);
        for x in ticks(low[0], high[0]) {
            let [x0, _] = at([x, low[1]]);
            let _ = writeln!(
                out,
                "<path d=\"M{x0:.1} {bottom:.1}v5\" stroke=\"#1f2024\"/><text x=\"{x0:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{x}</text>",
                bottom + 19.0
            );
        }
        for y in ticks(low[1], high[1]) {
            let [_, y0] = at([low[0], y]);
            let _ = writeln!(
                out,
                "<path d=\"M{LEFT} {y0:.1}h-5\" stroke=\"#1f2024\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{y}</text>",
                LEFT - 8.0,
                y0 + 4.5
            );
        }
        let _ = writeln!(
            out,
            "<rect x=\"{LEFT}\" y=\"{MARGIN}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"none\" stroke=\"#1f2024\"/>"
        );
        for i in 0..self.demonstration.n_trajectories() {
            let points: Vec<[f64; 2]> = self.points(i, every).map(at).collect();
            let line: Vec<String> = points.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect();
            let ([x0, y0], [x1, y1]) = (points[0], points[points.len() - 1]);
            let fill = if self.demonstration.terminal(i) { "#c04e00" } else { "#fff" };
            let _ = write!(
                out,
                "<polyline fill=\"none\" stroke=\"#0072b2\" stroke-width=\"1.5\" stroke-opacity=\"0.7\" points=\"{}\"/>\n\
                 <circle cx=\"{x0:.1}\" cy=\"{y0:.1}\" r=\"4\" fill=\"none\" stroke=\"#009e73\" stroke-width=\"2\"/>\n\
                 <circle cx=\"{x1:.1}\" cy=\"{y1:.1}\" r=\"4\" fill=\"{fill}\" stroke=\"#c04e00\"/>\n",
                line.join(" ")
            );
        }
        let [x, y] = self.names().map(escape);
        let (middle, half) = ((LEFT + right) / 2.0, MARGIN + height / 2.0);
        let _ = write!(
            out,
            "<text x=\"{middle:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{x}</text>\n<text x=\"14\" y=\"{half:.1}\" \
             text-anchor=\"middle\" transform=\"rotate(-90 14 {half:.1})\">{y}</text>\n</svg>\n",
            full_height - 8.0
        );
        out
    }
}

/// Two opposite corners of each wall, as the first two features say them.
fn walls(ground: &dyn Ground) -> Vec<[[f64; 2]; 2]> {
    let [columns, rows] = ground.size();
    let cells = (0..rows).flat_map(|row| (0..columns).map(move |column| [column, row]));
    cells
        .filter(|&cell| !ground.is_free(cell))
        .map(|cell| cell.map(|at| at as f64))
        .map(|[column, row]| {
            [corner(ground, [column - 0.5, row - 0.5]), corner(ground, [column + 0.5, row + 0.5])]
        })
        .collect()
}

/// The first two features at `place`.
fn corner(ground: &dyn Ground, place: [f64; 2]) -> [f64; 2] {
    let state = ground.state(place);
    [f64::from(state[0]), f64::from(state[1])]
}

/// Round numbers from `low` to `high`, some five of them.
fn ticks(low: f64, high: f64) -> Vec<f64> {
    let rough = (high - low) / 5.0;
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|unit| unit * power).find(|&step| step >= rough);
    let Some(step) = step.filter(|step| step.is_normal()) else { return Vec::new() };
    let first = (low / step).ceil() as i64;
    // Multiples of a step have its digits and no more.
    let digits = (-step.log10().floor()).max(0.0) as usize;
    let round = |x: f64| format!("{x:.digits$}").parse().unwrap_or(x);
    (first..).map(|n| round(n as f64 * step)).take_while(|&x| x <= high + 1e-9 * step).take(20).collect()
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
    fn ticks_are_round_numbers_within_the_bounds() {
        assert_eq!(ticks(0.0, 4.0), [0.0, 1.0, 2.0, 3.0, 4.0]);
        assert_eq!(ticks(-0.3, 0.31), [-0.2, 0.0, 0.2]);
        assert_eq!(ticks(12.0, 1012.0), [200.0, 400.0, 600.0, 800.0, 1000.0]);
        assert!(ticks(1.0, 1.0).is_empty() && ticks(0.0, f64::MIN_POSITIVE).is_empty());
    }

    #[test]
    fn walls_are_drawn_where_the_map_has_them() {
        struct Wall;
        impl Ground for Wall {
            fn size(&self) -> [usize; 2] {
                [3, 1]
            }
            fn is_free(&self, cell: [usize; 2]) -> bool {
                cell[0] != 1
            }
            fn ends(&self) -> [[f64; 2]; 2] {
                [[0.0; 2], [2.0, 0.0]]
            }
            fn places(&self, states: &[f32]) -> Vec<[f64; 2]> {
                states.chunks_exact(2).map(|state| [state[0].into(), state[1].into()]).collect()
            }
            fn state(&self, place: [f64; 2]) -> Vec<f32> {
                place.map(|x| x as f32).to_vec()
            }
        }
        let svg = Picture::new(&square(), None, true).unwrap().svg(Some(&Wall));
        // From 0.5 to 1.5 of -0.5 to 4, and from -0.5 to 0.5 of -0.5 to 2.
        assert!(
            svg.contains("x=\"206.2\" y=\"16.0\" width=\"142.2\" height=\"142.2\" fill=\"#3c3e46\""),
            "{svg}"
        );
    }

    #[test]
    fn a_drawing_keeps_proportions_and_thins_long_lines() {
        let svg = Picture::new(&square(), None, false).unwrap().svg(None);
        assert!(svg.contains("viewBox=\"0 0 720.0 384.0\""), "{svg}");
        assert!(svg.contains("points=\"64.0,336.0 704.0,336.0 704.0,16.0\""), "{svg}");
        assert!(svg.contains("a&lt;b") && svg.contains("fill=\"#c04e00\""), "{svg}");
        assert!(svg.contains(">4</text>") && svg.contains(">0.5</text>"), "{svg}");
        let mut long = Demonstration::new(vec!["x".into()]).unwrap();
        long.push_trajectory(&(0..200_001).map(|i| i as f32).collect::<Vec<_>>(), false).unwrap();
        let svg = Picture::new(&long, None, false).unwrap().svg(None);
        let points = svg.split("points=\"").nth(1).unwrap().split('"').next().unwrap().split(' ').count();
        assert!((40_000..=50_001).contains(&points), "{points}");
        let mut still = Demonstration::new(vec!["x".into(), "y".into()]).unwrap();
        still.push_trajectory(&[1.0; 4], false).unwrap();
        let picture = Picture::new(&still, None, false).unwrap();
        assert!(!picture.svg(None).contains("NaN") && picture.text().contains('E'));
    }
}
