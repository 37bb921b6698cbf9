//! Lines with bands over two axes.

use super::scale::label;
use super::{Area, Axis, GRID, INK, PlotError, color, dashes, svg, text, upward};
use plotters::element::{PathElement, Polygon, Rectangle};
use plotters::series::DashedLineSeries;
use plotters::style::text_anchor::{HPos, VPos};
use plotters::style::{Color, ShapeStyle};

const WIDTH: u32 = 720;
const HEIGHT: u32 = 420;
/// Where the axes are: left, top, right, bottom.
const FRAME: [i32; 4] = [76, 52, 548, 362];

/// A line with a band around it.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Name of the arm.
    pub name: String,
    /// x, y, and the band's lower and upper edge, by ascending x.
    pub points: Vec<(f64, f64, f64, f64)>,
}

/// A chart of lines.
#[derive(Clone, Debug, PartialEq)]
pub struct Chart {
    /// The heading of the picture.
    pub title: String,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis. A point outside it is drawn at its edge.
    pub y: Axis,
    /// The lines, one an arm; their order decides on colours and dashes.
    pub lines: Vec<Line>,
    /// Horizontal lines with a name.
    pub rules: Vec<(f64, String)>,
    /// The meaning of lines and bands.
    pub note: String,
}

impl Chart {
    /// Draws it.
    ///
    /// # Errors
    /// Those of the drawing library.
    pub fn svg(&self) -> Result<String, PlotError> {
        svg([WIDTH, HEIGHT], |area| self.draw(area))
    }

    /// The pixel of (x, y).
    fn pixel(&self, x: f64, y: f64) -> (i32, i32) {
        let [left, top, right, bottom] = FRAME;
        let along = |axis: &Axis, value: f64| {
            let [at, low, high] = [value, axis.low, axis.high].map(|v| axis.position(v));
            ((at - low) / (high - low)).clamp(0.0, 1.0)
        };
        let across = f64::from(right - left) * along(&self.x, x);
        let down = f64::from(bottom - top) * (1.0 - along(&self.y, y));
        (left + across.round() as i32, top + down.round() as i32)
    }

    fn draw(&self, area: &Area<'_>) -> Result<(), PlotError> {
        let [left, top, right, bottom] = FRAME;
        let say = |words: &str, style, at| area.draw_text(words, &style, at).map_err(PlotError::draw);
        say(&self.title, text(16, HPos::Left, VPos::Top), (left, 10))?;
        say(&self.note, text(11, HPos::Left, VPos::Top), (left, 31))?;
        say(&self.x.label, text(13, HPos::Center, VPos::Bottom), ((left + right) / 2, HEIGHT as i32 - 8))?;
        say(&self.y.label, upward(13), (8, (top + bottom) / 2))?;
        for x in self.x.ticks() {
            let at = self.pixel(x, self.y.low).0;
            self.path(area, vec![(at, top), (at, bottom)], GRID.into())?;
            say(&label(x), text(12, HPos::Center, VPos::Top), (at, bottom + 6))?;
        }
        for y in self.y.ticks() {
            let at = self.pixel(self.x.low, y).1;
            self.path(area, vec![(left, at), (right, at)], GRID.into())?;
            say(&label(y), text(12, HPos::Right, VPos::Center), (left - 6, at))?;
        }
        for (index, line) in self.lines.iter().enumerate() {
            let lower = line.points.iter().map(|&(x, _, low, _)| self.pixel(x, low));
            let upper = line.points.iter().rev().map(|&(x, .., high)| self.pixel(x, high));
            let band = Polygon::new(lower.chain(upper).collect::<Vec<_>>(), color(index).mix(0.18));
            area.draw(&band).map_err(PlotError::draw)?;
        }
        for (at, name) in &self.rules {
            let y = self.pixel(self.x.low, *at).1;
            self.dashed(area, &[(left, y), (right, y)], (2, 4), INK.stroke_width(1))?;
            let (place, beside) = if y < top + 16 { (VPos::Top, y + 3) } else { (VPos::Bottom, y - 3) };
            say(name, text(11, HPos::Right, place), (right - 4, beside))?;
        }
        for (index, line) in self.lines.iter().enumerate() {
            let path: Vec<_> = line.points.iter().map(|&(x, y, ..)| self.pixel(x, y)).collect();
            self.dashed(area, &path, dashes(index), color(index).stroke_width(2))?;
        }
        let frame = Rectangle::new([(left, top), (right, bottom)], INK.stroke_width(1));
        area.draw(&frame).map_err(PlotError::draw)?;
        for (index, line) in self.lines.iter().enumerate() {
            let y = top + 8 + 20 * index as i32;
            self.dashed(
                area,
                &[(right + 14, y), (right + 44, y)],
                dashes(index),
                color(index).stroke_width(2),
            )?;
            say(&line.name, text(12, HPos::Left, VPos::Center), (right + 50, y))?;
        }
        Ok(())
    }

    fn path(&self, area: &Area<'_>, path: Vec<(i32, i32)>, style: ShapeStyle) -> Result<(), PlotError> {
        area.draw(&PathElement::new(path, style)).map_err(PlotError::draw)
    }

    fn dashed(
        &self,
        area: &Area<'_>,
        path: &[(i32, i32)],
        (dash, gap): (u32, u32),
        style: ShapeStyle,
    ) -> Result<(), PlotError> {
        if gap == 0 {
            return self.path(area, path.to_vec(), style);
        }
        let pieces = DashedLineSeries::new(path.iter().copied(), dash, gap, style);
        pieces.into_iter().try_for_each(|piece| area.draw(&piece).map_err(PlotError::draw))
    }
}
