//! An episode in motion: an animated GIF of a maze in which a dot walks the learnt path and leaves it behind as a line.

use crate::maze::{LEARNT, Maze, Place};
use crate::plot::{PlotError, View, raster};
use gif::{Encoder, Frame, Repeat};
use resvg::tiny_skia::{Color, FillRule, LineCap, LineJoin, Paint, PathBuilder, Pixmap, Stroke, Transform};
use std::collections::BTreeMap;

/// Pictures of a film beside its last, at most; of a longer path every second, third, ... state is shown.
const MAX_FRAMES: usize = 160;
/// How long a picture is shown, and the last one, hundredths of a second.
pub(crate) const DELAY: u16 = 6;
pub(crate) const LAST_DELAY: u16 = 200;
/// Colours of a film.
pub(crate) const COLORS: usize = 256;
/// Colours that are told apart before similar ones become one.
const MANY_COLORS: usize = 4096;
/// Radius of the dot and width of the line, pixels.
const DOT: f32 = 6.0;
const LINE: f32 = 2.5;

pub(crate) type Rgb = [u8; 3];

/// The film of `maze` as the bytes of a GIF.
///
/// # Errors
/// Those of the drawing library, or a picture that is too large for the format.
pub fn gif(maze: &Maze) -> Result<Vec<u8>, PlotError> {
    let still = Maze { path: Vec::new(), ..maze.clone() };
    let mut trail = raster(&still.paths_svg(View::Paper)?, 1.0)?;
    let stride = maze.path.len().div_ceil(MAX_FRAMES).max(1);
    let last = maze.path.len().saturating_sub(1);
    let points: Vec<(f32, f32)> = maze
        .path
        .iter()
        .enumerate()
        .filter(|(at, _)| at.is_multiple_of(stride) || *at == last)
        .map(|(_, &place)| pixel(maze, place))
        .collect();
    let [width, height] = [trail.width(), trail.height()]
        .map(|side| u16::try_from(side).map_err(|_| PlotError::Raster(format!("a GIF of {side} pixels"))));
    let (width, height) = (width?, height?);
    // The last picture has every colour that there is.
    let mut whole = trail.clone();
    points.windows(2).for_each(|pair| line(&mut whole, pair[0], pair[1]));
    points.iter().for_each(|&point| dot(&mut whole, point));
    let mut palette = Palette::new(colors(&whole), COLORS);
    let mut bytes = Vec::new();
    let fault = |error: gif::EncodingError| PlotError::Raster(error.to_string());
    let mut encoder = Encoder::new(&mut bytes, width, height, &palette.bytes()).map_err(fault)?;
    encoder.set_repeat(Repeat::Infinite).map_err(fault)?;
    let mut shown: Option<Vec<u8>> = None;
    let moments = points.len().max(1);
    for at in 0..moments {
        if at > 0 {
            line(&mut trail, points[at - 1], points[at]);
        }
        let mut picture = trail.clone();
        if let Some(&point) = points.get(at) {
            dot(&mut picture, point);
        }
        let indices = palette.indices(&picture);
        let mut frame = changed(shown.as_deref(), &indices, width, height);
        frame.delay = if at + 1 == moments { LAST_DELAY } else { DELAY };
        encoder.write_frame(&frame).map_err(fault)?;
        shown = Some(indices);
    }
    drop(encoder);
    Ok(bytes)
}

fn pixel(maze: &Maze, place: Place) -> (f32, f32) {
    let (x, y) = maze.pixel(View::Paper, place);
    (x as f32, y as f32)
}

fn paint(color: Color) -> Paint<'static> {
    let mut paint = Paint::default();
    paint.set_color(color);
    paint
}

fn green() -> Color {
    Color::from_rgba8(LEARNT.0, LEARNT.1, LEARNT.2, 255)
}

fn line(picture: &mut Pixmap, from: (f32, f32), to: (f32, f32)) {
    let mut path = PathBuilder::new();
    path.move_to(from.0, from.1);
    path.line_to(to.0, to.1);
    let stroke =
        Stroke { width: LINE, line_cap: LineCap::Round, line_join: LineJoin::Round, ..Stroke::default() };
    // A line of no length is none.
    if let Some(path) = path.finish() {
        picture.stroke_path(&path, &paint(green()), &stroke, Transform::identity(), None);
    }
}

fn dot(picture: &mut Pixmap, (x, y): (f32, f32)) {
    for (radius, color) in [(DOT + 1.5, Color::WHITE), (DOT, green())] {
        if let Some(circle) = PathBuilder::from_circle(x, y, radius) {
            picture.fill_path(&circle, &paint(color), FillRule::Winding, Transform::identity(), None);
        }
    }
}

/// The smallest rectangle in which `indices` differ from what is `shown`, as a frame.
pub(crate) fn changed(shown: Option<&[u8]>, indices: &[u8], width: u16, height: u16) -> Frame<'static> {
    let columns = usize::from(width);
    let (mut low, mut high) = ([columns, usize::from(height)], [0, 0]);
    for (at, index) in indices.iter().enumerate() {
        if shown.is_none_or(|shown| shown[at] != *index) {
            for (axis, place) in [at % columns, at / columns].into_iter().enumerate() {
                low[axis] = low[axis].min(place);
                high[axis] = high[axis].max(place + 1);
            }
        }
    }
    if high == [0, 0] {
        // The dot stands still: any one pixel again.
        (low, high) = ([0, 0], [1, 1]);
    }
    let rows = (low[1]..high[1]).flat_map(|row| &indices[row * columns..][low[0]..high[0]]);
    // All four are within the picture, whose sides fit.
    let [left, top, right, bottom] = [low[0], low[1], high[0], high[1]].map(|side| side as u16);
    Frame {
        left,
        top,
        width: right - left,
        height: bottom - top,
        buffer: rows.copied().collect::<Vec<u8>>().into(),
        ..Frame::default()
    }
}

/// The colours of a film: the most frequent ones. Others, on the edges of letters and lines, become the nearest of them.
pub(crate) struct Palette {
    colors: Vec<Rgb>,
    known: BTreeMap<Rgb, u8>,
}

impl Palette {
    /// The `most` most frequent of `colors`.
    pub(crate) fn new(colors: impl Iterator<Item = Rgb>, most: usize) -> Self {
        let mut counts: BTreeMap<Rgb, usize> = BTreeMap::new();
        colors.for_each(|color| *counts.entry(coarse(color, counts.len())).or_default() += 1);
        let mut colors: Vec<(Rgb, usize)> = counts.into_iter().collect();
        colors.sort_by_key(|&(color, count)| (std::cmp::Reverse(count), color));
        let colors = colors.into_iter().take(most).map(|(color, _)| color).collect();
        Self { colors, known: BTreeMap::new() }
    }

    pub(crate) fn bytes(&self) -> Vec<u8> {
        self.colors.concat()
    }

    fn indices(&mut self, picture: &Pixmap) -> Vec<u8> {
        colors(picture).map(|color| self.index(color)).collect()
    }

    /// Number of the colour nearest to `color`.
    pub(crate) fn index(&mut self, color: Rgb) -> u8 {
        let Self { colors, known } = self;
        let color = coarse(color, known.len());
        *known.entry(color).or_insert_with(|| {
            let far = |other: &Rgb| -> i32 {
                color.iter().zip(other).map(|(a, b)| (i32::from(*a) - i32::from(*b)).pow(2)).sum()
            };
            let nearest = colors.iter().enumerate().min_by_key(|(_, other)| far(other));
            nearest.map_or(0, |(at, _)| at as u8)
        })
    }
}

/// `color`, or where `known` colours are a great many already, as in photographs, one like it: there are 32,768 of these.
fn coarse(color: Rgb, known: usize) -> Rgb {
    if known < MANY_COLORS { color } else { color.map(|part| part & 0xf8 | part >> 5) }
}

/// The colours of a picture without transparency, row by row.
fn colors(picture: &Pixmap) -> impl Iterator<Item = Rgb> {
    picture.pixels().iter().map(|pixel| [pixel.red(), pixel.green(), pixel.blue()])
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::maze::Step;

    fn maze(path: Vec<Place>) -> Maze {
        Maze {
            title: "maze".into(),
            size: [3, 2],
            walls: vec![false, true, false, false, false, false],
            ends: [[0.0, 0.0], [2.0, 0.0]],
            mentor: vec![([0.0, 0.0], [0.0, 1.0], Step::Feasible)],
            path,
            fine: 1,
            visits: Vec::new(),
            values: Vec::new(),
        }
    }

    #[test]
    fn a_film_has_a_picture_a_state_and_is_the_same_every_time() {
        let maze = maze(vec![[0.0, 0.0], [0.0, 1.0], [0.0, 1.0], [1.0, 1.0], [2.0, 1.0], [2.0, 0.0]]);
        let bytes = gif(&maze).unwrap();
        assert_eq!(bytes, gif(&maze).unwrap());
        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::RGBA);
        let mut decoder = options.read_info(bytes.as_slice()).unwrap();
        let mut frames = Vec::new();
        while let Some(frame) = decoder.read_next_frame().unwrap() {
            frames.push((frame.width, frame.height, frame.delay));
        }
        assert_eq!(frames.len(), 6);
        // The first is whole, the others are what has changed, and the one that stands still is a pixel.
        assert!(frames[0].0 > 300 && frames[1].0 < 60 && frames[1].1 < 80, "{frames:?}");
        assert_eq!((frames[2].0, frames[2].1), (1, 1));
        assert_eq!((frames[4].2, frames[5].2), (DELAY, LAST_DELAY));
    }

    #[test]
    fn a_long_path_is_no_longer_a_film_and_no_path_is_a_picture() {
        let long = gif(&maze((0..10_000).map(|at| [f64::from(at % 3), 1.0]).collect())).unwrap();
        let count = |bytes: &[u8]| {
            let mut decoder = gif::DecodeOptions::new().read_info(bytes).unwrap();
            let mut count = 0;
            while decoder.read_next_frame().unwrap().is_some() {
                count += 1;
            }
            count
        };
        assert!((MAX_FRAMES / 2..=MAX_FRAMES + 1).contains(&count(&long)), "{}", count(&long));
        assert_eq!(count(&gif(&maze(Vec::new())).unwrap()), 1);
    }
}
