//! Values with their intervals, one below the other.

use super::scale::label;
use super::{Area, Axis, GRID, INK, PlotError, color, svg, text};
use crate::stats::Estimate;
use plotters::element::{Circle, PathElement, Rectangle};
use plotters::style::text_anchor::{HPos, VPos};
use plotters::style::{Color, ShapeStyle};

const WIDTH: u32 = 720;
const LEFT: i32 = 210;
const RIGHT: i32 = 610;
const TOP: i32 = 56;
const ROW: i32 = 26;

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
    /// Draws it.
    ///
    /// # Errors
    /// Those of the drawing library.
    pub fn svg(&self) -> Result<String, PlotError> {
        let height = TOP + ROW * self.rows.len() as i32 + 48;
        svg([WIDTH, height as u32], |area| self.draw(area, height))
    }

    fn pixel(&self, x: f64) -> i32 {
        let [at, low, high] = [x, self.x.low, self.x.high].map(|v| self.x.position(v));
        LEFT + (f64::from(RIGHT - LEFT) * ((at - low) / (high - low)).clamp(0.0, 1.0)).round() as i32
    }

    fn draw(&self, area: &Area<'_>, height: i32) -> Result<(), PlotError> {
        let bottom = TOP + ROW * self.rows.len() as i32;
        let say = |words: &str, style, at| area.draw_text(words, &style, at).map_err(PlotError::draw);
        let path = |points: &[(i32, i32)], style: ShapeStyle| {
            area.draw(&PathElement::new(points.to_vec(), style)).map_err(PlotError::draw)
        };
        say(&self.title, text(16, HPos::Left, VPos::Top), (12, 10))?;
        say(&self.note, text(11, HPos::Left, VPos::Top), (12, 31))?;
        say(&self.x.label, text(13, HPos::Center, VPos::Bottom), ((LEFT + RIGHT) / 2, height - 6))?;
        for x in self.x.ticks() {
            let at = self.pixel(x);
            path(&[(at, TOP), (at, bottom)], GRID.into())?;
            say(&label(x), text(12, HPos::Center, VPos::Top), (at, bottom + 6))?;
        }
        if let Some(at) = self.rule.map(|x| self.pixel(x)) {
            path(&[(at, TOP), (at, bottom)], INK.stroke_width(1))?;
        }
        for (index, row) in self.rows.iter().enumerate() {
            let y = TOP + ROW * index as i32 + ROW / 2;
            let bar = color(row.arm).stroke_width(3);
            let Estimate { mid, low, high } = row.estimate;
            say(&row.name, text(12, HPos::Right, VPos::Center), (LEFT - 8, y))?;
            say(&row.note, text(11, HPos::Left, VPos::Center), (RIGHT + 10, y))?;
            if low.is_finite() {
                let (from, to) = (self.pixel(low), self.pixel(high));
                path(&[(from, y), (to, y)], bar)?;
                path(&[(from, y - 5), (from, y + 5)], bar)?;
                match high.is_finite() {
                    true => path(&[(to, y - 5), (to, y + 5)], bar)?,
                    false => path(&[(to - 7, y - 6), (to, y), (to - 7, y + 6)], bar)?,
                }
            }
            if mid.is_finite() {
                area.draw(&Circle::new((self.pixel(mid), y), 5, color(row.arm).filled()))
                    .map_err(PlotError::draw)?;
            }
        }
        let frame = Rectangle::new([(LEFT, TOP), (RIGHT, bottom)], INK.stroke_width(1));
        area.draw(&frame).map_err(PlotError::draw)
    }
}
