//! Values with their intervals, one below the other.

use super::scale::{every, label};
use super::{Area, Axis, GRID, INK, PlotError, View, beyond, color, say_on_lines, svg, text};
use crate::stats::Estimate;
use plotters::element::{Circle, PathElement, Rectangle};
use plotters::style::text_anchor::{HPos, VPos};
use plotters::style::{Color, ShapeStyle};

/// How a chart is laid out: its width, the ends of its bars, where its rows begin, and the size of its letters.
struct Layout {
    width: u32,
    left: i32,
    right: i32,
    top: i32,
    letters: u32,
    /// Whether heading and note are part of the picture.
    head: bool,
    /// Height of a row.
    row: i32,
    /// Whether names stand beside the bars, and not above them.
    beside: bool,
}

/// A picture that stands for itself.
const PAPER: Layout =
    Layout { width: 720, left: 210, right: 610, top: 56, letters: 12, head: true, row: 26, beside: true };
/// The same without its head.
const FIGURE: Layout = Layout { top: 12, head: false, ..PAPER };
/// A picture of a page, which says the rest: narrow, so that its letters can be read on a phone.
const PAGE: Layout =
    Layout { width: 400, left: 8, right: 290, top: 8, letters: 18, head: false, row: 50, beside: false };
/// A line of the chart.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// The name at its left.
    pub name: String,
    /// Number of the arm, for its colour.
    pub arm: usize,
    /// The value. Infinite ends are drawn as arrows, an undefined or infinite value not at all.
    pub estimate: Estimate,
    /// The text at its right end.
    pub note: String,
}

/// A chart of intervals.
#[derive(Clone, Debug, PartialEq)]
pub struct Intervals {
    /// The heading of the picture.
    pub title: String,
    /// The meaning of points and bars.
    pub note: String,
    /// Horizontal axis; all finite numbers lie within it.
    pub x: Axis,
    /// The rows, from above.
    pub rows: Vec<Row>,
    /// A vertical line at a value of interest.
    pub rule: Option<f64>,
}

impl Intervals {
    /// Draws it for `view`.
    ///
    /// # Errors
    /// Those of the drawing library.
    pub fn svg(&self, view: View) -> Result<String, PlotError> {
        let layout = match view {
            View::Paper => &PAPER,
            View::Figure => &FIGURE,
            View::Page => &PAGE,
        };
        let height = layout.top + layout.row * self.rows.len() as i32 + 3 * layout.letters as i32 + 8;
        // Names that are longer than their column push the bars to the right.
        let names = self.rows.iter().filter(|_| layout.beside).map(|row| &row.name[..]);
        let more = beyond(names, layout.letters, layout.left - 16);
        let layout = Layout {
            width: layout.width + more as u32,
            left: layout.left + more,
            right: layout.right + more,
            ..*layout
        };
        svg([layout.width, height as u32], |area| self.draw(area, &layout, height))
    }

    fn pixel(&self, layout: &Layout, x: f64) -> i32 {
        let [at, low, high] = [x, self.x.low, self.x.high].map(|v| self.x.position(v));
        let share = ((at - low) / (high - low)).clamp(0.0, 1.0);
        layout.left + (f64::from(layout.right - layout.left) * share).round() as i32
    }

    fn draw(&self, area: &Area<'_>, layout: &Layout, height: i32) -> Result<(), PlotError> {
        let Layout { left, right, top, letters, .. } = *layout;
        let bottom = top + layout.row * self.rows.len() as i32;
        let say = |words: &str, style, at| area.draw_text(words, &style, at).map_err(PlotError::draw);
        let path = |points: &[(i32, i32)], style: ShapeStyle| {
            area.draw(&PathElement::new(points.to_vec(), style)).map_err(PlotError::draw)
        };
        if layout.head {
            say(&self.title, text(16, HPos::Left, VPos::Top), (12, 10))?;
            say(&self.note, text(12, HPos::Left, VPos::Top), (12, 31))?;
        }
        say(&self.x.label, text(letters + 1, HPos::Center, VPos::Bottom), ((left + right) / 2, height - 6))?;
        let ticks = self.x.ticks();
        let labels: Vec<String> = ticks.iter().map(|&x| label(x)).collect();
        let places: Vec<i32> = ticks.iter().map(|&x| self.pixel(layout, x)).collect();
        let apart = places.windows(2).map(|pair| pair[1] - pair[0]).min().unwrap_or(right - left);
        let shown = every(&labels, apart, letters);
        for (index, (words, &at)) in labels.iter().zip(&places).enumerate() {
            path(&[(at, top), (at, bottom)], GRID.into())?;
            if index.is_multiple_of(shown) {
                say(words, text(letters, HPos::Center, VPos::Top), (at, bottom + 6))?;
            }
        }
        if let Some(at) = self.rule.map(|x| self.pixel(layout, x)) {
            path(&[(at, top), (at, bottom)], INK.stroke_width(1))?;
        }
        for (index, row) in self.rows.iter().enumerate() {
            let begin = top + layout.row * index as i32;
            let y = begin + if layout.beside { layout.row / 2 } else { layout.row - 12 };
            let bar = color(row.arm).stroke_width(3);
            let Estimate { mid, low, high } = row.estimate;
            match layout.beside {
                true => say(&row.name, text(letters, HPos::Right, VPos::Center), (left - 8, y))?,
                false => {
                    let style = text(letters, HPos::Left, VPos::Top);
                    say_on_lines(area, &row.name, &style, (left + 6, begin + 4))?
                }
            }
            say(&row.note, text(letters, HPos::Left, VPos::Center), (right + 10, y))?;
            if low.is_finite() {
                let (from, to) = (self.pixel(layout, low), self.pixel(layout, high));
                path(&[(from, y), (to, y)], bar)?;
                path(&[(from, y - 5), (from, y + 5)], bar)?;
                match high.is_finite() {
                    true => path(&[(to, y - 5), (to, y + 5)], bar)?,
                    false => path(&[(to - 7, y - 6), (to, y), (to - 7, y + 6)], bar)?,
                }
            }
            if mid.is_finite() {
                area.draw(&Circle::new((self.pixel(layout, mid), y), 5, color(row.arm).filled()))
                    .map_err(PlotError::draw)?;
            }
        }
        let frame = Rectangle::new([(left, top), (right, bottom)], INK.stroke_width(1));
        area.draw(&frame).map_err(PlotError::draw)
    }
}
