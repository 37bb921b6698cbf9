//! An episode of an environment that draws itself: a film, or a strip of some of its moments.

use crate::film::{COLORS, DELAY, LAST_DELAY, Palette, changed};
use crate::plot::{PlotError, raster};
use gif::{Encoder, Repeat};
use resvg::tiny_skia::{Pixmap, PixmapPaint, Transform};
use std::fmt::Write;

/// Pictures that are kept of an episode, at most; of a longer one every second, fourth, ... is.
const MAX_FRAMES: usize = 120;
/// Longest side of a picture, pixels.
const MAX_SIDE: usize = 2048;
/// Moments of a strip, and how many are in a row.
const MOMENTS: usize = 6;
const COLUMNS: usize = 3;
/// Gap between moments, and the height of the line below each, pixels.
const GAP: usize = 12;
const LINE: usize = 24;

/// The pictures of an episode, thinned out evenly.
#[derive(Debug, Default)]
pub struct Footage {
    size: [usize; 2],
    /// Number of the step, and its pixels, `[height * width * 3]`.
    kept: Vec<(usize, Vec<u8>)>,
    stride: usize,
    last: Option<(usize, Vec<u8>)>,
    fault: Option<PlotError>,
}

impl Footage {
    /// Takes the next picture of the episode, `width` x `height` pixels of red, green and blue. One of another size than the first is a
    /// fault that [`Footage::gif`] and the others tell.
    pub fn push(&mut self, width: usize, height: usize, rgb: Vec<u8>) {
        if self.last.is_none() {
            (self.size, self.stride) = ([width, height], 1);
        }
        let fits = (1..=MAX_SIDE).contains(&width) && (1..=MAX_SIDE).contains(&height);
        if self.size != [width, height] || !fits || rgb.len() != width * height * 3 {
            let text = format!(
                "a picture of {width} x {height} pixels; accepted: all of one size, up to {MAX_SIDE} a side"
            );
            self.fault.get_or_insert(PlotError::Raster(text));
            return;
        }
        let number = self.last.as_ref().map_or(0, |(number, _)| number + 1);
        if let Some((before, pixels)) = self.last.replace((number, rgb))
            && before.is_multiple_of(self.stride)
        {
            if self.kept.len() == MAX_FRAMES {
                self.stride *= 2;
                let stride = self.stride;
                self.kept.retain(|(number, _)| number.is_multiple_of(stride));
            }
            if before.is_multiple_of(self.stride) {
                self.kept.push((before, pixels));
            }
        }
    }

    /// All pictures that are kept, the last one of the episode included.
    fn frames(&self) -> Result<Vec<&(usize, Vec<u8>)>, PlotError> {
        if let Some(fault) = &self.fault {
            return Err(PlotError::Raster(fault.to_string()));
        }
        if self.last.is_none() {
            return Err(PlotError::Raster("an episode without pictures".into()));
        }
        Ok(self.kept.iter().chain(&self.last).collect())
    }

    /// A film as the bytes of a GIF.
    ///
    /// # Errors
    /// No pictures, or pictures of several sizes.
    pub fn gif(&self) -> Result<Vec<u8>, PlotError> {
        let frames = self.frames()?;
        let [width, height] = self.size.map(|side| side as u16);
        let all = frames.iter().flat_map(|(_, pixels)| pixels.chunks_exact(3));
        let mut palette = Palette::new(all.map(|pixel| [pixel[0], pixel[1], pixel[2]]), COLORS);
        let fault = |error: gif::EncodingError| PlotError::Raster(error.to_string());
        let mut bytes = Vec::new();
        let mut encoder = Encoder::new(&mut bytes, width, height, &palette.bytes()).map_err(fault)?;
        encoder.set_repeat(Repeat::Infinite).map_err(fault)?;
        let mut shown: Option<Vec<u8>> = None;
        for (at, (_, pixels)) in frames.iter().enumerate() {
            let indices: Vec<u8> =
                pixels.chunks_exact(3).map(|pixel| palette.index([pixel[0], pixel[1], pixel[2]])).collect();
            let mut frame = changed(shown.as_deref(), &indices, width, height);
            frame.delay = if at + 1 == frames.len() { LAST_DELAY } else { DELAY };
            encoder.write_frame(&frame).map_err(fault)?;
            shown = Some(indices);
        }
        drop(encoder);
        Ok(bytes)
    }

    /// Moments of the strip, evenly over the episode: place of each from the top left, number of its step, pixels.
    #[allow(clippy::type_complexity, reason = "a row a moment, used twice below")]
    fn moments(&self) -> Result<Vec<([usize; 2], usize, &[u8])>, PlotError> {
        let frames = self.frames()?;
        let count = frames.len().min(MOMENTS);
        let [width, height] = self.size;
        let moment = |at: usize| {
            let (number, pixels) = frames[at * (frames.len() - 1) / (count - 1).max(1)];
            let place = [at % COLUMNS * (width + GAP), at / COLUMNS * (height + LINE + GAP)];
            (place, *number, pixels.as_slice())
        };
        Ok((0..count).map(moment).collect())
    }

    /// The strip as SVG, with or without the pictures themselves.
    fn strip(&self, with_pictures: bool) -> Result<String, PlotError> {
        let moments = self.moments()?;
        let [width, height] = self.size;
        let (columns, rows) = (moments.len().min(COLUMNS), moments.len().div_ceil(COLUMNS));
        let whole = [columns * (width + GAP) - GAP, rows * (height + LINE + GAP) - GAP];
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\">\
             <rect width=\"{w}\" height=\"{h}\" fill=\"white\"/>",
            w = whole[0],
            h = whole[1],
        );
        for ([x, y], number, pixels) in moments {
            if with_pictures {
                let png =
                    picture(self.size, pixels)?.encode_png().map_err(|e| PlotError::Raster(e.to_string()))?;
                let data = base64(&png);
                let _ = write!(
                    svg,
                    "<image x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" href=\"data:image/png;base64,{data}\"/>"
                );
            }
            let (middle, base) = (x + width / 2, y + height + LINE - 7);
            let _ = write!(
                svg,
                "<text x=\"{middle}\" y=\"{base}\" font-family=\"DejaVu Sans, sans-serif\" font-size=\"14\" \
                 text-anchor=\"middle\" fill=\"#222\">step {number}</text>"
            );
        }
        Ok(svg + "</svg>\n")
    }

    /// Six moments of the episode side by side, as SVG.
    ///
    /// # Errors
    /// As [`Footage::gif`].
    pub fn svg(&self) -> Result<String, PlotError> {
        self.strip(true)
    }

    /// The same as the bytes of a PNG.
    ///
    /// # Errors
    /// As [`Footage::gif`].
    pub fn png(&self) -> Result<Vec<u8>, PlotError> {
        let mut strip = raster(&self.strip(false)?, 1.0)?;
        for ([x, y], _, pixels) in self.moments()? {
            let picture = picture(self.size, pixels)?;
            let paint = PixmapPaint::default();
            strip.draw_pixmap(x as i32, y as i32, picture.as_ref(), &paint, Transform::identity(), None);
        }
        strip.encode_png().map_err(|e| PlotError::Raster(e.to_string()))
    }
}

/// A picture of `size` from its pixels.
fn picture(size: [usize; 2], rgb: &[u8]) -> Result<Pixmap, PlotError> {
    let [width, height] = size.map(|side| side as u32);
    let mut picture = Pixmap::new(width, height)
        .ok_or_else(|| PlotError::Raster(format!("no picture has {width} x {height} pixels")))?;
    for (to, from) in picture.data_mut().chunks_exact_mut(4).zip(rgb.chunks_exact(3)) {
        to[..3].copy_from_slice(from);
        to[3] = u8::MAX;
    }
    Ok(picture)
}

/// `bytes` in letters that a URL can hold.
fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for part in bytes.chunks(3) {
        let byte = |at: usize| u32::from(part.get(at).copied().unwrap_or(0));
        let bits = byte(0) << 16 | byte(1) << 8 | byte(2);
        for at in 0..4 {
            let letter = LETTERS[(bits >> (18 - 6 * at)) as usize & 63];
            text.push(if at <= part.len() { char::from(letter) } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// An episode in which a red column goes to the right over a picture of 8 x 4 pixels.
    fn footage(steps: usize) -> Footage {
        let mut footage = Footage::default();
        for step in 0..steps {
            let pixel = |at: usize| if at % 8 == step % 8 { [255, 0, 0] } else { [250, 250, 250] };
            footage.push(8, 4, (0..32).flat_map(pixel).collect());
        }
        footage
    }

    #[test]
    fn a_film_is_even_and_ends_with_the_last_step() {
        for steps in [1, 7, MAX_FRAMES, 10 * MAX_FRAMES + 7] {
            let footage = footage(steps);
            let frames = footage.frames().unwrap();
            let numbers: Vec<usize> = frames.iter().map(|(number, _)| *number).collect();
            assert_eq!((numbers[0], *numbers.last().unwrap()), (0, steps - 1));
            assert!(
                numbers.len() <= MAX_FRAMES + 1 && numbers.len() >= steps.min(MAX_FRAMES / 2),
                "{numbers:?}"
            );
            let film = footage.gif().unwrap();
            let mut options = gif::DecodeOptions::new();
            options.set_color_output(gif::ColorOutput::RGBA);
            let mut decoder = options.read_info(film.as_slice()).unwrap();
            let first = decoder.read_next_frame().unwrap().unwrap();
            assert_eq!(
                (first.width, first.height, &first.buffer[..8]),
                (8, 4, &[255, 0, 0, 255, 250, 250, 250, 255][..])
            );
        }
    }

    #[test]
    fn a_strip_has_six_moments() {
        let svg = footage(51).svg().unwrap();
        assert_eq!(svg.matches("<image").count(), 6);
        for number in [0, 10, 20, 30, 40, 50] {
            assert!(svg.contains(&format!(">step {number}</text>")), "{svg}");
        }
        let strip = Pixmap::decode_png(&footage(51).png().unwrap()).unwrap();
        assert_eq!((strip.width(), strip.height()), (3 * 8 + 2 * 12, 2 * (4 + 24) + 12));
        let pixel = strip.pixel(0, 0).unwrap();
        assert_eq!([pixel.red(), pixel.green(), pixel.blue()], [255, 0, 0]);
    }

    #[test]
    fn pictures_of_several_sizes_are_refused() {
        let mut footage = footage(3);
        footage.push(9, 4, vec![0; 9 * 4 * 3]);
        assert!(footage.gif().unwrap_err().to_string().contains("9 x 4 pixels; accepted: all of one size"));
        assert!(Footage::default().png().is_err());
    }

    #[test]
    fn letters_are_those_of_the_standard() {
        let cases = [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foobar", "Zm9vYmFy"),
            ("\u{3ff}", "z78="),
        ];
        for (bytes, letters) in cases {
            assert_eq!(base64(bytes.as_bytes()), letters);
        }
    }
}
