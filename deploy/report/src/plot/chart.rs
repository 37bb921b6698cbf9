//! Lines with bands over two axes.

use super::scale::{every, label};
use super::{Area, Axis, GRID, INK, PlotError, View, beyond, color, dashes, say_on_lines, svg, text, upward};
use plotters::element::{PathElement, Polygon, Rectangle};
use plotters::series::DashedLineSeries;
use plotters::style::text_anchor::{HPos, VPos};
use plotters::style::{Color, ShapeStyle};

/// How a chart is laid out.
struct Layout {
    /// Width and height of the picture.
    size: [u32; 2],
    /// Where the axes are: left, top, right, bottom.
    frame: [i32; 4],
    /// Size of the letters at the axes.
    letters: u32,
    /// Whether heading and note, and whether legend and name of the vertical axis are part of the picture.
    head: bool,
    legend: bool,
}

/// A picture that stands for itself.
const PAPER: Layout =
    Layout { size: [720, 420], frame: [76, 52, 548, 362], letters: 12, head: true, legend: true };
/// The same without its head.
const FIGURE: Layout =
    Layout { size: [720, 376], frame: [76, 8, 548, 318], letters: 12, head: false, legend: true };
/// A picture of a page, which says the rest: narrow, so that its letters can be read on a phone.
const PAGE: Layout =
    Layout { size: [400, 300], frame: [72, 12, 386, 240], letters: 18, head: false, legend: false };

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
        let names = self.lines.iter().filter(|line| layout.legend && !line.points.is_empty());
        let [width, height] = layout.size;
        let more = beyond(names.map(|line| &line.name[..]), 12, width as i32 - layout.frame[2] - 50);
        svg([width + more as u32, height], |area| self.draw(area, layout))
    }

    /// The pixel of (x, y).
    fn pixel(&self, layout: &Layout, x: f64, y: f64) -> (i32, i32) {
        let [left, top, right, bottom] = layout.frame;
        let along = |axis: &Axis, value: f64| {
            let [at, low, high] = [value, axis.low, axis.high].map(|v| axis.position(v));
            ((at - low) / (high - low)).clamp(0.0, 1.0)
        };
        let across = f64::from(right - left) * along(&self.x, x);
        let down = f64::from(bottom - top) * (1.0 - along(&self.y, y));
        (left + across.round() as i32, top + down.round() as i32)
    }

    fn draw(&self, area: &Area<'_>, layout: &Layout) -> Result<(), PlotError> {
        let [left, top, right, bottom] = layout.frame;
        let (letters, height) = (layout.letters, layout.size[1] as i32);
        let say = |words: &str, style, at| area.draw_text(words, &style, at).map_err(PlotError::draw);
        if layout.head {
            say(&self.title, text(16, HPos::Left, VPos::Top), (left, 10))?;
            say(&self.note, text(12, HPos::Left, VPos::Top), (left, 31))?;
        }
        if layout.legend {
            // On a page it is the heading.
            say(&self.y.label, upward(letters + 1), (8, (top + bottom) / 2))?;
        }
        say(&self.x.label, text(letters + 1, HPos::Center, VPos::Bottom), ((left + right) / 2, height - 6))?;
        let ticks = self.x.ticks();
        let labels: Vec<String> = ticks.iter().map(|&x| label(x)).collect();
        let places: Vec<i32> = ticks.iter().map(|&x| self.pixel(layout, x, self.y.low).0).collect();
        let apart = places.windows(2).map(|pair| pair[1] - pair[0]).min().unwrap_or(right - left);
        let shown = every(&labels, apart, letters);
        for (index, (words, &at)) in labels.iter().zip(&places).enumerate() {
            self.path(area, vec![(at, top), (at, bottom)], GRID.into())?;
            if index.is_multiple_of(shown) {
                say(words, text(letters, HPos::Center, VPos::Top), (at, bottom + 6))?;
            }
        }
        // Places of a logarithmic axis come close to each other.
        let mut last = i32::MAX;
        for y in self.y.ticks() {
            let at = self.pixel(layout, self.x.low, y).1;
            self.path(area, vec![(left, at), (right, at)], GRID.into())?;
            if last.saturating_sub(at) > letters as i32 {
                say(&label(y), text(letters, HPos::Right, VPos::Center), (left - 6, at))?;
                last = at;
            }
        }
        for (index, line) in self.lines.iter().enumerate() {
            let lower = line.points.iter().map(|&(x, _, low, _)| self.pixel(layout, x, low));
            let upper = line.points.iter().rev().map(|&(x, .., high)| self.pixel(layout, x, high));
            let band = Polygon::new(lower.chain(upper).collect::<Vec<_>>(), color(index).mix(0.18));
            area.draw(&band).map_err(PlotError::draw)?;
        }
        for (at, _) in &self.rules {
            let y = self.pixel(layout, self.x.low, *at).1;
            self.dashed(area, &[(left, y), (right, y)], (2, 4), INK.stroke_width(1))?;
        }
        for (index, line) in self.lines.iter().enumerate() {
            let path: Vec<_> = line.points.iter().map(|&(x, y, ..)| self.pixel(layout, x, y)).collect();
            self.dashed(area, &path, dashes(index), color(index).stroke_width(2))?;
        }
        for (at, name) in &self.rules {
            let y = self.pixel(layout, self.x.low, *at).1;
            let (place, beside) = if y < top + 16 { (VPos::Top, y + 3) } else { (VPos::Bottom, y - 3) };
            say_on_lines(area, name, &text(letters, HPos::Right, place), (right - 4, beside))?;
        }
        let frame = Rectangle::new([(left, top), (right, bottom)], INK.stroke_width(1));
        area.draw(&frame).map_err(PlotError::draw)?;
        // An arm without a line here has no entry either.
        let drawn =
            self.lines.iter().enumerate().filter(|(_, line)| layout.legend && !line.points.is_empty());
        for (place, (index, line)) in drawn.enumerate() {
            let y = top + 8 + 20 * place as i32;
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
