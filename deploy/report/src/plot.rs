//! Pictures: a chart of lines with bands, and a chart of intervals. Each is drawn once, as SVG; the PNG is that SVG
//! rasterised, with a font that is part of the program, so that pictures are the same on every machine.
//!
//! The colours of Okabe and Ito (2008) are used, which the colour-blind can tell apart. Lines differ in their dashes as
//! well. Ink, grid and paper are named apart, so that a page can have them follow its own colours ([`inline`]).

mod chart;
mod intervals;
mod pdf;
mod scale;

pub use chart::{Chart, Line};
pub use intervals::{Intervals, Row};
pub use pdf::pdf;
pub use scale::{Axis, Scale};

use plotters::backend::SVGBackend;
use plotters::coord::Shift;
use plotters::drawing::{DrawingArea, IntoDrawingArea};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{FontTransform, IntoFont, IntoTextStyle, RGBColor, TextStyle};
use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{Options, Tree};
use std::sync::Arc;

/// A picture that cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum PlotError {
    /// Drawing.
    #[error("cannot draw a picture: {0}")]
    Draw(String),
    /// Turning it into a PNG.
    #[error("cannot rasterise a picture: {0}")]
    Raster(String),
}

impl PlotError {
    pub(crate) fn draw(error: impl std::fmt::Display) -> Self {
        Self::Draw(error.to_string())
    }
}

/// Text and axes.
pub(crate) const INK: RGBColor = RGBColor(0x1f, 0x20, 0x24);
/// Lines of the grid.
pub(crate) const GRID: RGBColor = RGBColor(0xdc, 0xdd, 0xe2);
/// Background.
pub(crate) const PAPER: RGBColor = RGBColor(0xff, 0xff, 0xfe);

/// Okabe and Ito's colours without black and yellow, which vanish on one paper or the other.
const COLORS: [RGBColor; 6] = [
    RGBColor(0x00, 0x72, 0xb2),
    RGBColor(0xe6, 0x9f, 0x00),
    RGBColor(0x00, 0x9e, 0x73),
    RGBColor(0xd5, 0x5e, 0x00),
    RGBColor(0xcc, 0x79, 0xa7),
    RGBColor(0x56, 0xb4, 0xe9),
];
/// Lengths of dash and gap, pixels; a gap of 0 is a solid line.
const DASHES: [(u32, u32); 4] = [(1, 0), (9, 4), (3, 3), (14, 4)];

/// Where a picture is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum View {
    /// By itself, with heading, note and legend.
    Paper,
    /// By itself in a text that has the heading and the note below it, as a paper has.
    Figure,
    /// On a page that says the rest: narrow, so that its letters can be read on a phone.
    Page,
}

/// A line of the `index`-th arm for a legend of a page, as SVG.
pub(crate) fn swatch(index: usize) -> String {
    let RGBColor(r, g, b) = color(index);
    let (dash, gap) = dashes(index);
    let dashes = if gap == 0 { String::new() } else { format!(" stroke-dasharray=\"{dash} {gap}\"") };
    format!(
        "<svg class=\"swatch\" viewBox=\"0 0 30 10\" aria-hidden=\"true\"><path d=\"M1 5H29\" stroke=\"#{r:02X}{g:02X}{b:02X}\" \
         stroke-width=\"2.5\" fill=\"none\"{dashes}/></svg>"
    )
}

/// The colour of the `index`-th arm.
pub(crate) fn color(index: usize) -> RGBColor {
    COLORS[index % COLORS.len()]
}

/// Dashes of the `index`-th arm: two arms of one colour have different ones, and so have neighbours.
fn dashes(index: usize) -> (u32, u32) {
    DASHES[(index + index / COLORS.len()) % DASHES.len()]
}

/// Areas side by side show no seam between them. A page says it once.
const CRISP: &str = "<style>rect{shape-rendering:crispEdges}</style>";

/// A place to draw on.
pub(crate) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// An SVG of `width` x `height` pixels, drawn by `draw` on paper.
pub(crate) fn svg(
    [width, height]: [u32; 2],
    draw: impl FnOnce(&Area<'_>) -> Result<(), PlotError>,
) -> Result<String, PlotError> {
    let mut text = String::new();
    {
        let area = SVGBackend::with_string(&mut text, (width, height)).into_drawing_area();
        area.fill(&PAPER).map_err(PlotError::draw)?;
        draw(&area)?;
        area.present().map_err(PlotError::draw)?;
    }
    let head = text.find("<svg").and_then(|start| Some(start + text[start..].find('>')? + 1)).unwrap_or(0);
    text.insert_str(head, CRISP);
    Ok(text)
}

/// `svg` for a page that defines the colours `--paper` and `--grid` and whose text has the colour of ink.
pub fn inline(svg: &str) -> String {
    let hex = |RGBColor(r, g, b): RGBColor| format!("\"#{r:02X}{g:02X}{b:02X}\"");
    // The size becomes the page's affair.
    let start = svg.find("<svg").unwrap_or(0);
    let (head, rest) = svg[start..].split_at(svg[start..].find('>').unwrap_or(0));
    let size = |name: &str| {
        let from = head.find(&format!("{name}=\""))? + name.len() + 2;
        head[from..].split('"').next()
    };
    let view = format!("0 0 {} {}", size(" width").unwrap_or("1"), size(" height").unwrap_or("1"));
    format!("<svg viewBox=\"{view}\" xmlns=\"http://www.w3.org/2000/svg\" role=\"img\"{rest}")
        .replace(&hex(INK), "\"currentColor\"")
        .replace(&hex(GRID), "\"var(--grid)\"")
        .replace(&hex(PAPER), "\"var(--paper)\"")
        .replacen(CRISP, "", 1)
}

/// The PNG of `svg`, twice as many pixels each way.
///
/// # Errors
/// An SVG that is none, or memory.
pub fn png(svg: &str) -> Result<Vec<u8>, PlotError> {
    raster(svg, 2.0)?.encode_png().map_err(|e| PlotError::Raster(e.to_string()))
}

/// `svg` as it is read, its letters in the font that is part of the program.
fn tree(svg: &str) -> Result<Tree, PlotError> {
    let mut options = Options::default();
    let fonts = Arc::make_mut(&mut options.fontdb);
    fonts.load_font_data(include_bytes!("../font/DejaVuSans-subset.ttf").to_vec());
    fonts.set_sans_serif_family("DejaVu Sans");
    Tree::from_str(svg, &options).map_err(|e| PlotError::Raster(e.to_string()))
}

/// `svg` as pixels, `zoom` for each of its own.
pub(crate) fn raster(svg: &str, zoom: f32) -> Result<Pixmap, PlotError> {
    let tree = tree(svg)?;
    let size = tree.size();
    let pixels = |side: f32| (side * zoom).ceil() as u32;
    let mut pixmap = Pixmap::new(pixels(size.width()), pixels(size.height()))
        .ok_or_else(|| PlotError::Raster(format!("no picture has {size:?} pixels")))?;
    resvg::render(&tree, Transform::from_scale(zoom, zoom), &mut pixmap.as_mut());
    Ok(pixmap)
}

/// Text of `size` pixels, its anchor point at `horizontal` and `vertical` of it.
pub(crate) fn text(size: u32, horizontal: HPos, vertical: VPos) -> TextStyle<'static> {
    ("sans-serif", size).into_font().color(&INK).pos(Pos::new(horizontal, vertical))
}

/// Writes `words` with paper around the letters, so that they can be read upon lines.
fn say_on_lines(
    area: &Area<'_>,
    words: &str,
    style: &TextStyle<'_>,
    (x, y): (i32, i32),
) -> Result<(), PlotError> {
    let say = |style: &TextStyle<'_>, at| area.draw_text(words, style, at).map_err(PlotError::draw);
    for (dx, dy) in [(-2, 0), (2, 0), (0, -2), (0, 2), (-1, -1), (-1, 1), (1, -1), (1, 1)] {
        say(&style.clone().color(&PAPER), (x + dx, y + dy))?;
    }
    say(style, (x, y))
}

/// By how many pixels the longest of `names`, if there are any, is wider than `room` in letters of `size` pixels.
fn beyond<'a>(names: impl Iterator<Item = &'a str>, size: u32, room: i32) -> i32 {
    let longest = names.map(|name| name.chars().count()).max();
    longest.map_or(0, |longest| ((0.62 * f64::from(size) * longest as f64).ceil() as i32 - room).max(0))
}

/// [`text`] that reads upwards.
fn upward(size: u32) -> TextStyle<'static> {
    let font = ("sans-serif", size).into_font().transform(FontTransform::Rotate270);
    font.into_text_style(&(0, 0)).color(&INK).pos(Pos::new(HPos::Center, VPos::Top))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn chart() -> Chart {
        let line = |name: &str, slope: f64| Line {
            name: name.into(),
            points: (0..50)
                .map(|x| (f64::from(x), slope * f64::from(x), -1.0, slope * f64::from(x) + 2.0))
                .collect(),
        };
        Chart {
            title: "Returns & <costs>".into(),
            x: Axis::fit("environment steps", Scale::Linear, 0.0, 49.0),
            y: Axis::fit("return", Scale::SignedLog, -3000.0, 5.0),
            lines: vec![line("dqn", -60.0), line("ha-diiqn", -1.0)],
            rules: vec![(-3.4, "best".into())],
            note: "mean and standard deviation".into(),
        }
    }

    #[test]
    fn a_picture_is_drawn_the_same_every_time() {
        let svg = chart().svg(View::Paper).unwrap();
        assert_eq!(svg, chart().svg(View::Paper).unwrap());
        for text in ["Returns &amp; &lt;costs&gt;", "environment steps", "ha-diiqn", "best"] {
            assert!(svg.contains(text), "{text}");
        }
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
        let png = png(&svg).unwrap();
        assert!(png.starts_with(b"\x89PNG"));
    }

    #[test]
    fn a_page_can_have_its_own_colours() {
        let svg = inline(&chart().svg(View::Page).unwrap());
        assert!(svg.starts_with("<svg viewBox=\"0 0 400 300\""), "{}", &svg[..80]);
        assert!(svg.contains("currentColor") && svg.contains("var(--grid)") && svg.contains("var(--paper)"));
        for fixed in ["#1F2024", "#DCDDE2", "#FFFFFE"] {
            assert!(!svg.contains(fixed), "{fixed}");
        }
    }

    #[test]
    fn long_names_have_room() {
        let width = |svg: &str| -> u32 {
            svg.split("width=\"").nth(1).unwrap().split('"').next().unwrap().parse().unwrap()
        };
        let long = "x".repeat(60);
        let mut chart = chart();
        assert_eq!(width(&chart.svg(View::Paper).unwrap()), 720);
        chart.lines[1].name.clone_from(&long);
        assert!(width(&chart.svg(View::Figure).unwrap()) > 548 + 50 + 60 * 7);
        // A page has its legend elsewhere.
        assert_eq!(width(&chart.svg(View::Page).unwrap()), 400);
        let estimate = crate::stats::Estimate { mid: 1.0, low: 0.5, high: 2.0 };
        let row = |name: &str| Row { name: name.into(), arm: 0, estimate, note: "1".into() };
        let intervals = |name: &str| Intervals {
            title: "t".into(),
            note: "n".into(),
            x: Axis::fit("x", Scale::Linear, 0.0, 2.0),
            rows: vec![row(name)],
            rule: None,
        };
        let [short, long] = ["dqn", &long].map(|name| width(&intervals(name).svg(View::Paper).unwrap()));
        assert!(short == 720 && long > 720 - 210 + 60 * 7, "{short} {long}");
    }

    #[test]
    fn the_font_has_the_letters() {
        // With the letters missing nothing would be drawn: a picture of text alone is not blank.
        let written = svg([60, 20], |area| {
            area.draw_text("e_KL µ", &text(12, HPos::Left, VPos::Top), (2, 2)).map_err(PlotError::draw)
        });
        let blank = svg([60, 20], |_| Ok(()));
        assert_ne!(png(&written.unwrap()).unwrap(), png(&blank.unwrap()).unwrap());
    }
}
