//! Pictures of a maze, of cells or with a ball in it: the mentor's path with the observer's findings about each step, the
//! learnt path, the visits to each cell, and the value of each cell.

use crate::plot::{Area, INK, PAPER, PlotError, View, svg, text};
use plotters::element::{Circle, PathElement, Rectangle};
use plotters::style::text_anchor::{HPos, VPos};
use plotters::style::{Color, RGBColor, ShapeStyle};

/// The observer's finding about a mentor's step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// One of its own actions does the same.
    Feasible,
    /// None does, but a bridge leads back onto the path.
    Bridged,
    /// None does, and no bridge is known.
    Infeasible,
    /// It is only led along, as with learned bridges.
    Led,
}

impl Step {
    /// All of them, with their colours and names.
    const ALL: [(Self, RGBColor, &'static str); 4] = [
        (Self::Feasible, RGBColor(0x00, 0x72, 0xb2), "mentor's step, feasible"),
        (Self::Bridged, RGBColor(0xe6, 0x9f, 0x00), "mentor's step, bridged"),
        (Self::Infeasible, RGBColor(0xcc, 0x79, 0xa7), "mentor's step, infeasible"),
        (Self::Led, RGBColor(0x00, 0x72, 0xb2), "mentor's path"),
    ];

    fn color(self) -> RGBColor {
        Self::ALL.iter().find(|(step, ..)| *step == self).map_or(INK, |(_, color, _)| *color)
    }
}

/// Column and row, from the top left; whole numbers in the middle of a cell.
pub type Place = [f64; 2];

/// One run in its maze.
#[derive(Clone, Debug, PartialEq)]
pub struct Maze {
    /// The heading of the picture.
    pub title: String,
    /// Columns and rows.
    pub size: [usize; 2],
    /// Whether each cell is a wall, row by row.
    pub walls: Vec<bool>,
    /// Start and goal.
    pub ends: [Place; 2],
    /// The mentor's steps.
    pub mentor: Vec<(Place, Place, Step)>,
    /// The path of a greedy episode.
    pub path: Vec<Place>,
    /// Squares along the side of a cell that `visits` and `values` are given for: 1, 2 or 4.
    pub fine: usize,
    /// How often the state of a stored transition lies in each square, row by row; empty if unknown.
    pub visits: Vec<f64>,
    /// The largest Q-value in each square, row by row; empty if unknown.
    pub values: Vec<f64>,
}

/// Left of the map on its picture, and the width of the legend beside it.
const LEFT: i32 = 16;
const LEGEND: i32 = 216;
/// Length and height of the scale below the map on a page, and height of a line of its legend.
const PAGE_SCALE: i32 = 320;
const PAGE_SCALE_HEIGHT: i32 = 80;
const PAGE_LINE: i32 = 28;

/// How a picture is laid out: pixels of the map's longer side, about, where it begins, and the size of letters.
struct Layout {
    longest: usize,
    top: i32,
    letters: u32,
}

/// Heading above the map, legend beside it.
const ON_PAPER: Layout = Layout { longest: 504, top: 56, letters: 12 };
/// Legend beside the map, and no heading.
const AS_FIGURE: Layout = Layout { longest: 504, top: 8, letters: 12 };
/// Legend below the map.
const ON_PAGE: Layout = Layout { longest: 368, top: 8, letters: 18 };

fn layout(view: View) -> &'static Layout {
    match view {
        View::Paper => &ON_PAPER,
        View::Figure => &AS_FIGURE,
        View::Page => &ON_PAGE,
    }
}
/// Dark to light, even steps to the eye and to the colour-blind: seven colours of "viridis" (van der Walt and Smith 2015).
const SHADES: [[f64; 3]; 7] = [
    [68.0, 1.0, 84.0],
    [68.0, 57.0, 131.0],
    [49.0, 104.0, 142.0],
    [33.0, 145.0, 140.0],
    [53.0, 183.0, 121.0],
    [144.0, 215.0, 67.0],
    [253.0, 231.0, 37.0],
];
/// Walls of a heat map, where paper and ink are colours of the scale.
const WALL: RGBColor = RGBColor(0x77, 0x78, 0x80);

/// The colour of `share`, 0 to 1.
fn shade(share: f64) -> RGBColor {
    let at = share.clamp(0.0, 1.0) * (SHADES.len() - 1) as f64;
    let low = (at.floor() as usize).min(SHADES.len() - 2);
    let mix =
        |i: usize| (SHADES[low][i] + (at - low as f64) * (SHADES[low + 1][i] - SHADES[low][i])).round() as u8;
    RGBColor(mix(0), mix(1), mix(2))
}

impl Maze {
    /// What the picture of paths shows.
    pub(crate) fn paths_note(&self) -> &'static str {
        if self.mentor.is_empty() { "the learnt path" } else { "the mentor's path and the learnt one" }
    }

    /// The map with the mentor's steps and the learnt path.
    ///
    /// # Errors
    /// Those of the drawing library.
    pub fn paths_svg(&self, view: View) -> Result<String, PlotError> {
        // A path that is led along has no findings, and without a mentor there are no steps to be explained.
        let led = self.mentor.iter().any(|(.., step)| *step == Step::Led);
        let known =
            Step::ALL.iter().filter(|(step, ..)| (*step == Step::Led) == led && !self.mentor.is_empty());
        let learnt = [(LEARNT, "learnt path (greedy)")];
        let entries: Vec<_> = known.map(|(_, color, name)| (*color, *name)).chain(learnt).collect();
        let below = 16 + PAGE_LINE * entries.len() as i32;
        self.svg(view, self.paths_note(), below, |picture| {
            picture.walls(INK)?;
            picture.mentor()?;
            picture.learnt()?;
            picture.ends()?;
            picture.legend(&entries)
        })
    }

    /// Visits of each square, if they are known: logarithmic.
    ///
    /// # Errors
    /// Those of the drawing library.
    pub fn visits_svg(&self, view: View) -> Option<Result<String, PlotError>> {
        let most = self.visits.iter().copied().fold(f64::NAN, f64::max);
        (most > 0.0).then(|| {
            let share =
                |visits: f64| if visits > 0.0 { (1.0 + visits).ln() / (1.0 + most).ln() } else { f64::NAN };
            let middle = (1.0 + most).sqrt() - 1.0;
            self.heat(
                view,
                ["visits in the stored transitions (logarithmic)", "visits"],
                &self.visits,
                share,
                [0.0, middle.round(), most],
            )
        })
    }

    /// The value max_a Q(s, a) of each square, if it is known.
    ///
    /// # Errors
    /// Those of the drawing library.
    pub fn values_svg(&self, view: View) -> Option<Result<String, PlotError>> {
        let free = || self.values.iter().enumerate().filter(|(at, _)| !self.in_wall(*at)).map(|(_, v)| *v);
        let (low, high) = (free().fold(f64::NAN, f64::min), free().fold(f64::NAN, f64::max));
        (high > low).then(|| {
            let share = |value: f64| (value - low) / (high - low);
            let what = if self.fine > 1 {
                "value: the largest Q at rest"
            } else {
                "value: the largest Q of each cell"
            };
            self.heat(view, [what, "Q"], &self.values, share, [low, (low + high) / 2.0, high])
        })
    }

    /// Column and row of square `index`.
    fn square(&self, index: usize) -> [usize; 2] {
        let columns = self.size[0] * self.fine;
        [index % columns, index / columns]
    }

    /// Whether square `index` is part of a wall.
    fn in_wall(&self, index: usize) -> bool {
        let [column, row] = self.square(index).map(|at| at / self.fine);
        self.walls[row * self.size[0] + column]
    }

    /// Side of a cell, pixels.
    fn side(&self, view: View) -> i32 {
        (layout(view).longest / self.size[0].max(self.size[1]).max(1)).clamp(4, 48) as i32 / 4 * 4
    }

    /// Where `place` is on the picture, pixels from its left and top.
    pub(crate) fn pixel(&self, view: View, place: Place) -> (i32, i32) {
        let side = f64::from(self.side(view));
        let [x, y] = place.map(|at| ((at + 0.5) * side).round() as i32);
        (LEFT + x, layout(view).top + y)
    }

    /// A map of `numbers`, coloured by their `share` (NaN: left blank); `marks` are written at its scale, which is in `unit`.
    fn heat(
        &self,
        view: View,
        [what, unit]: [&str; 2],
        numbers: &[f64],
        share: impl Fn(f64) -> f64,
        marks: [f64; 3],
    ) -> Result<String, PlotError> {
        self.svg(view, what, 16 + PAGE_SCALE_HEIGHT, |picture| {
            for (index, &number) in numbers.iter().enumerate() {
                let share = share(number);
                if share.is_finite() && !self.in_wall(index) {
                    picture.square(self.square(index), self.fine, shade(share))?;
                }
            }
            picture.walls(WALL)?;
            picture.ends()?;
            picture.scale(unit, marks)
        })
    }

    /// A picture of `what`, on a page with `below` pixels under the map.
    fn svg(
        &self,
        view: View,
        what: &str,
        below: i32,
        draw: impl FnOnce(&Picture<'_, '_>) -> Result<(), PlotError>,
    ) -> Result<String, PlotError> {
        let side = self.side(view);
        let Layout { top, .. } = *layout(view);
        let [width, height] = self.size.map(|n| n as i32 * side);
        let size = match view {
            View::Paper | View::Figure => [LEFT + width + LEGEND, (top + height + 16).max(top + 200)],
            View::Page => [2 * LEFT + width.max(PAGE_SCALE), top + height + below],
        };
        svg(size.map(|n| n as u32), |area| {
            let picture = Picture { area, maze: self, view, side, top };
            if view == View::Paper {
                picture.say(&self.title, 16, HPos::Left, (LEFT, 10))?;
                picture.say(what, 12, HPos::Left, (LEFT, 32))?;
            }
            draw(&picture)?;
            picture.frame([(LEFT, top), (LEFT + width, top + height)])
        })
    }
}

/// A maze that is being drawn; cells are `side` pixels wide.
struct Picture<'a, 'b> {
    area: &'a Area<'b>,
    maze: &'a Maze,
    view: View,
    side: i32,
    /// Where the map begins.
    top: i32,
}

impl Picture<'_, '_> {
    fn say(&self, words: &str, size: u32, at: HPos, point: (i32, i32)) -> Result<(), PlotError> {
        self.area.draw_text(words, &text(size, at, VPos::Top), point).map_err(PlotError::draw)
    }

    fn frame(&self, corners: [(i32, i32); 2]) -> Result<(), PlotError> {
        self.area.draw(&Rectangle::new(corners, INK.stroke_width(1))).map_err(PlotError::draw)
    }

    fn path(&self, points: Vec<(i32, i32)>, style: ShapeStyle) -> Result<(), PlotError> {
        self.area.draw(&PathElement::new(points, style)).map_err(PlotError::draw)
    }

    fn dot(&self, at: (i32, i32), radius: i32, style: ShapeStyle) -> Result<(), PlotError> {
        self.area.draw(&Circle::new(at, radius, style)).map_err(PlotError::draw)
    }

    fn point(&self, place: Place) -> (i32, i32) {
        self.maze.pixel(self.view, place)
    }

    /// Fills a square, of which `fine` make up a cell's side.
    fn square(&self, [column, row]: [usize; 2], fine: usize, color: RGBColor) -> Result<(), PlotError> {
        let side = self.side / fine as i32;
        let (x, y) = (LEFT + column as i32 * side, self.top + row as i32 * side);
        let corners = [(x, y), (x + side, y + side)];
        self.area.draw(&Rectangle::new(corners, color.filled())).map_err(PlotError::draw)
    }

    fn walls(&self, color: RGBColor) -> Result<(), PlotError> {
        let columns = self.maze.size[0];
        let walls = self.maze.walls.iter().enumerate().filter(|(_, wall)| **wall);
        walls.map(|(at, _)| [at % columns, at / columns]).try_for_each(|cell| self.square(cell, 1, color))
    }

    /// The mentor's steps, in cells a little beside their middles, so that the learnt path does not hide them.
    fn mentor(&self) -> Result<(), PlotError> {
        let aside = if self.maze.fine > 1 { 0 } else { self.side / 5 };
        for &(from, to, step) in &self.maze.mentor {
            let ends = [from, to].map(|place| self.point(place)).map(|(x, y)| (x - aside, y - aside));
            self.path(ends.to_vec(), step.color().stroke_width(3))?;
            self.dot(ends[0], 2, step.color().filled())?;
        }
        Ok(())
    }

    fn learnt(&self) -> Result<(), PlotError> {
        let points: Vec<_> = self.maze.path.iter().map(|&place| self.point(place)).collect();
        self.path(points, LEARNT.stroke_width(2))
    }

    fn ends(&self) -> Result<(), PlotError> {
        for (place, letter) in self.maze.ends.into_iter().zip(["S", "G"]) {
            let (x, y) = self.point(place);
            let radius = (self.side / 2).clamp(9, 13);
            self.dot((x, y), radius, PAPER.filled())?;
            self.dot((x, y), radius, INK.stroke_width(1))?;
            let letters = layout(self.view).letters;
            let style = text((self.side as u32).clamp(letters, letters + 2), HPos::Center, VPos::Center);
            self.area.draw_text(letter, &style, (x, y)).map_err(PlotError::draw)?;
        }
        Ok(())
    }

    /// Left and top of the legend beside the map, or below it.
    fn beside(&self) -> (i32, i32) {
        let [width, height] = self.maze.size.map(|n| n as i32 * self.side);
        match self.view {
            View::Paper | View::Figure => (LEFT + width + 16, self.top + 8),
            View::Page => (LEFT, self.top + height + 16),
        }
    }

    fn legend(&self, entries: &[(RGBColor, &str)]) -> Result<(), PlotError> {
        let (x, top) = self.beside();
        for (index, (color, name)) in entries.iter().enumerate() {
            let y = top + (layout(self.view).letters as i32 + 10) * index as i32;
            self.path(vec![(x, y), (x + 26, y)], color.stroke_width(3))?;
            self.say(
                name,
                layout(self.view).letters,
                HPos::Left,
                (x + 34, y - layout(self.view).letters as i32 / 2),
            )?;
        }
        Ok(())
    }

    /// The colours from low to high with three numbers and what they are.
    fn scale(&self, unit: &str, marks: [f64; 3]) -> Result<(), PlotError> {
        const LENGTH: i32 = PAGE_SCALE / 2;
        let (x, top) = self.beside();
        let letters = layout(self.view).letters;
        let fill = |corners, style: ShapeStyle| {
            self.area.draw(&Rectangle::new(corners, style)).map_err(PlotError::draw)
        };
        self.say(unit, letters, HPos::Left, (x, top - 8))?;
        let (left, bottom) = (x, top + 18 + LENGTH);
        for step in (0..LENGTH).step_by(2) {
            let color = shade(f64::from(step) / f64::from(LENGTH)).filled();
            match self.view {
                View::Paper | View::Figure => {
                    fill([(left, bottom - step - 2), (left + 18, bottom - step)], color)?
                }
                View::Page => fill([(left + 2 * step, top + 16), (left + 2 * step + 4, top + 34)], color)?,
            }
        }
        for (index, mark) in marks.into_iter().enumerate() {
            let decimals = if mark.abs() >= 100.0 || mark.fract() == 0.0 { 0 } else { 2 };
            let words = format!("{mark:.decimals$}");
            let along = LENGTH / 2 * index as i32;
            match self.view {
                View::Paper | View::Figure => {
                    let y = bottom - along;
                    self.path(vec![(left + 18, y), (left + 23, y)], INK.stroke_width(1))?;
                    self.say(&words, letters, HPos::Left, (left + 28, y - 6))?;
                }
                View::Page => {
                    let at = left + 2 * along;
                    let place = [HPos::Left, HPos::Center, HPos::Right][index];
                    self.path(vec![(at, top + 34), (at, top + 39)], INK.stroke_width(1))?;
                    self.say(&words, letters, place, (at, top + 42))?;
                }
            }
        }
        Ok(())
    }
}

/// The learnt path.
pub(crate) const LEARNT: RGBColor = RGBColor(0x00, 0x9e, 0x73);

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn maze() -> Maze {
        Maze {
            title: "maze".into(),
            size: [3, 2],
            walls: vec![false, true, false, false, false, false],
            ends: [[0.0, 0.0], [2.0, 0.0]],
            mentor: vec![([0.0, 0.0], [0.0, 1.0], Step::Feasible), ([0.0, 1.0], [1.0, 1.0], Step::Bridged)],
            path: vec![[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [2.0, 0.0]],
            fine: 1,
            visits: vec![5.0, 0.0, 0.0, 2.0, 1.0, 1.0],
            values: vec![-1.0, 99.0, 0.5, -0.5, 0.0, 0.2],
        }
    }

    #[test]
    fn each_picture_shows_what_is_known() {
        let maze = maze();
        let paths = maze.paths_svg(View::Paper).unwrap();
        assert!(paths.contains("mentor&apos;s step, bridged") || paths.contains("mentor's step, bridged"));
        let visits = maze.visits_svg(View::Paper).unwrap().unwrap();
        assert!(visits.contains("visits in the stored transitions") && !visits.contains("1.45"));
        // The wall's value is no part of the scale.
        let values = maze.values_svg(View::Paper).unwrap().unwrap();
        assert!(values.contains("0.50") && !values.contains("99.00"));
        // Four squares a cell: the squares of the second cell are a wall's.
        let values =
            (0..24).map(|at| if [2, 3, 8, 9].contains(&at) { 99.0 } else { f64::from(at) }).collect();
        let fine = Maze { fine: 2, values, ..maze.clone() }.values_svg(View::Page).unwrap().unwrap();
        let says = |words: &str| fine.lines().any(|line| line == words);
        assert!(says("0") && says("23") && !says("99"), "{fine}");
        let unknown = Maze { visits: Vec::new(), values: Vec::new(), ..maze };
        assert!(unknown.visits_svg(View::Paper).is_none() && unknown.values_svg(View::Paper).is_none());
    }

    #[test]
    fn the_scale_runs_from_dark_to_light() {
        let light = |share| {
            let RGBColor(r, g, b) = shade(share);
            u32::from(r) + u32::from(g) + u32::from(b)
        };
        assert_eq!((shade(0.0), shade(1.0)), (RGBColor(68, 1, 84), RGBColor(253, 231, 37)));
        assert!(light(0.0) < light(0.5) && light(0.5) < light(1.0));
    }
}
