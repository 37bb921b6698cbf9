//! A picture as PDF, for papers: its lines, areas and letters as vectors.
//!
//! Our pictures are made of few things: paths that are filled or stroked in one colour, and text, which the SVG reader turns into
//! outlines. So a page with one stream of operators is enough, and no library is needed that would bring a second reader of SVG.

use super::{PlotError, tree};
use flate2::Compression;
use flate2::write::ZlibEncoder;
use resvg::tiny_skia::{PathSegment, Transform};
use resvg::usvg::{FillRule, Group, LineCap, LineJoin, Node, Paint, Path, Stroke};
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::io::Write as _;

/// Points of paper for a pixel.
const SCALE: f32 = 0.75;

/// The PDF of `svg`, three quarters of a point for each of its pixels.
///
/// # Errors
/// An SVG that is none.
pub fn pdf(svg: &str) -> Result<Vec<u8>, PlotError> {
    let tree = tree(svg)?;
    let (width, height) = (tree.size().width() * SCALE, tree.size().height() * SCALE);
    let mut page = Page { operators: String::new(), opacities: BTreeSet::new() };
    // PDF counts from the bottom.
    let flip = Transform::from_row(SCALE, 0.0, 0.0, -SCALE, 0.0, height);
    page.group(tree.root(), flip, 1.0);
    let mut stream = ZlibEncoder::new(Vec::new(), Compression::default());
    let packed = stream.write_all(page.operators.as_bytes()).and_then(|()| stream.finish());
    let packed = packed.map_err(|e| PlotError::Raster(e.to_string()))?;
    let states: String = page
        .opacities
        .iter()
        .map(|percent| {
            let share = f64::from(*percent) / 100.0;
            format!("/O{percent} << /Type /ExtGState /ca {share} /CA {share} >> ")
        })
        .collect();
    let mut file = File { bytes: b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n".to_vec(), offsets: Vec::new() };
    file.object("<< /Type /Catalog /Pages 2 0 R >>", None);
    file.object("<< /Type /Pages /Kids [3 0 R] /Count 1 >>", None);
    file.object(
        &format!(
            "<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width} {height}] /Contents 4 0 R /Resources << /ExtGState << {states}>> >> >>"
        ),
        None,
    );
    file.object(&format!("<< /Length {} /Filter /FlateDecode >>", packed.len()), Some(&packed));
    Ok(file.end())
}

/// The operators of the page, and the opacities that they name, in hundredths.
struct Page {
    operators: String,
    opacities: BTreeSet<u8>,
}

impl Page {
    /// What is in a group, with a share of the `opacity` that it has itself. Ours with an opacity have one child, so nothing shows
    /// through another part of the same group.
    fn group(&mut self, group: &Group, flip: Transform, opacity: f32) {
        let opacity = opacity * group.opacity().get();
        for node in group.children() {
            match node {
                Node::Group(group) => self.group(group, flip, opacity),
                Node::Path(path) => self.path(path, flip, opacity),
                Node::Text(text) => self.group(text.flattened(), flip, opacity),
                // Ours have none.
                Node::Image(_) => {}
            }
        }
    }

    fn path(&mut self, path: &Path, flip: Transform, opacity: f32) {
        let place = path.abs_transform().post_concat(flip);
        let Some(data) = path.data().clone().transform(place) else { return };
        let color = |paint: &Paint| match paint {
            Paint::Color(color) => {
                Some([color.red, color.green, color.blue].map(|part| f32::from(part) / 255.0))
            }
            _ => None,
        };
        if let Some((fill, [r, g, b])) = path.fill().and_then(|fill| Some((fill, color(fill.paint())?))) {
            self.opacity(opacity * fill.opacity().get());
            self.say(&format!("{r:.4} {g:.4} {b:.4} rg"));
            self.segments(&data);
            self.say(if fill.rule() == FillRule::EvenOdd { "f*" } else { "f" });
        }
        if let Some((stroke, [r, g, b])) =
            path.stroke().and_then(|stroke| Some((stroke, color(stroke.paint())?)))
        {
            self.opacity(opacity * stroke.opacity().get());
            self.say(&format!("{r:.4} {g:.4} {b:.4} RG"));
            self.stroke(stroke, place.sx.hypot(place.ky));
            self.segments(&data);
            self.say("S");
        }
    }

    fn say(&mut self, operator: &str) {
        self.operators.push_str(operator);
        self.operators.push('\n');
    }

    fn opacity(&mut self, share: f32) {
        let percent = (100.0 * share).round() as u8;
        self.opacities.insert(percent);
        self.say(&format!("/O{percent} gs"));
    }

    fn stroke(&mut self, stroke: &Stroke, scale: f32) {
        let cap = match stroke.linecap() {
            LineCap::Butt => 0,
            LineCap::Round => 1,
            LineCap::Square => 2,
        };
        let join = match stroke.linejoin() {
            LineJoin::Round => 1,
            LineJoin::Bevel => 2,
            _ => 0,
        };
        let dashes: Vec<String> = stroke
            .dasharray()
            .unwrap_or_default()
            .iter()
            .map(|dash| format!("{:.2}", dash * scale))
            .collect();
        let (width, offset) = (stroke.width().get() * scale, stroke.dashoffset() * scale);
        self.say(&format!("{width:.3} w {cap} J {join} j [{}] {offset:.2} d", dashes.join(" ")));
    }

    fn segments(&mut self, data: &resvg::tiny_skia::Path) {
        let mut last = (0.0, 0.0);
        let mut text = String::new();
        for segment in data.segments() {
            // Writing to a string cannot fail.
            let _ = match segment {
                PathSegment::MoveTo(p) => writeln!(text, "{:.3} {:.3} m", p.x, p.y),
                PathSegment::LineTo(p) => writeln!(text, "{:.3} {:.3} l", p.x, p.y),
                PathSegment::QuadTo(c, p) => {
                    // PDF has cubic curves alone.
                    let near = |from: f32, control: f32| from + (control - from) * 2.0 / 3.0;
                    let (a, b) = ((near(last.0, c.x), near(last.1, c.y)), (near(p.x, c.x), near(p.y, c.y)));
                    writeln!(text, "{:.3} {:.3} {:.3} {:.3} {:.3} {:.3} c", a.0, a.1, b.0, b.1, p.x, p.y)
                }
                PathSegment::CubicTo(a, b, p) => {
                    writeln!(text, "{:.3} {:.3} {:.3} {:.3} {:.3} {:.3} c", a.x, a.y, b.x, b.y, p.x, p.y)
                }
                PathSegment::Close => writeln!(text, "h"),
            };
            if let PathSegment::MoveTo(p)
            | PathSegment::LineTo(p)
            | PathSegment::QuadTo(_, p)
            | PathSegment::CubicTo(_, _, p) = segment
            {
                last = (p.x, p.y);
            }
        }
        self.operators.push_str(&text);
    }
}

/// A file that is being put together: numbered objects, and a table of where they begin.
struct File {
    bytes: Vec<u8>,
    offsets: Vec<usize>,
}

impl File {
    fn object(&mut self, dictionary: &str, stream: Option<&[u8]>) {
        self.offsets.push(self.bytes.len());
        let number = self.offsets.len();
        self.bytes.extend_from_slice(format!("{number} 0 obj\n{dictionary}\n").as_bytes());
        if let Some(stream) = stream {
            self.bytes.extend_from_slice(b"stream\n");
            self.bytes.extend_from_slice(stream);
            self.bytes.extend_from_slice(b"\nendstream\n");
        }
        self.bytes.extend_from_slice(b"endobj\n");
    }

    fn end(mut self) -> Vec<u8> {
        let (table, count) = (self.bytes.len(), self.offsets.len() + 1);
        let mut text = format!("xref\n0 {count}\n0000000000 65535 f \n");
        for offset in &self.offsets {
            let _ = writeln!(text, "{offset:010} 00000 n ");
        }
        let _ = write!(text, "trailer\n<< /Size {count} /Root 1 0 R >>\nstartxref\n{table}\n%%EOF\n");
        self.bytes.extend_from_slice(text.as_bytes());
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_pdf_has_the_size_of_its_picture_and_the_table_finds_its_objects() {
        let svg = "<svg width=\"400\" height=\"200\" xmlns=\"http://www.w3.org/2000/svg\"><rect width=\"10\" height=\"10\" opacity=\"0.18\" \
            fill=\"#E69F00\"/><path d=\"M0 0Q5 5 9 0\" fill=\"none\" stroke=\"#000\" stroke-dasharray=\"3 3\"/><text x=\"9\" y=\"9\">S</text></svg>";
        let bytes = pdf(svg).unwrap();
        assert_eq!(bytes, pdf(svg).unwrap());
        let text = String::from_utf8_lossy(&bytes);
        assert!(text.starts_with("%PDF-1.4") && text.ends_with("%%EOF\n"));
        assert!(text.contains("/MediaBox [0 0 300 150]"), "{text}");
        assert!(text.contains("/O18 << /Type /ExtGState /ca 0.18") && text.contains("/O100 <<"), "{text}");
        let find = |what: &[u8]| bytes.windows(what.len()).position(|window| window == what).unwrap();
        for number in 1..=4 {
            let at = find(format!("\n{number} 0 obj").as_bytes()) + 1;
            assert!(text.contains(&format!("{at:010} 00000 n ")), "object {number} at {at}");
        }
        assert!(pdf("no picture").is_err());
    }
}
