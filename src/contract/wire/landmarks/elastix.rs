//! Points of elastix and transformix: `index` or `point`, the number of points, and one in a line.
//!
//! Source: `itkTransformixInputPointFileReader.hxx` of elastix: `index` are image indices, and
//! `point` world coordinates. The index of the first pixel is 0, 0: 1/2 is added. World coordinates
//! depend on the origin and the spacing of the image, which the file does not have.

use super::bad::Bad;
use super::collect::Collector;
use super::words::Lines;
use super::{Format, FormatReader, SourceText};

pub(super) const FORMAT: Format = Format {
    name: "elastix",
    title: "elastix points",
    items: "sets",
    form: FormatReader::Lines(is_elastix, read),
};
const CENTRE: f64 = 0.5;

fn is_elastix(first: &str) -> bool {
    let mut words = first.split_whitespace();
    matches!(words.next(), Some("index" | "point"))
        && words.all(|word| word.parse::<usize>().is_ok())
}

fn read(source: SourceText<'_>, out: &mut Collector) -> Result<usize, Bad> {
    let mut lines = Lines::new(source, false);
    let head = lines.line("`index`")?;
    let mut words = head.words();
    if let Some(word) = words.next().filter(|word| word.text == "point") {
        let detail = "expected `index`, positions in pixels; found `point`, world coordinates: \
            subtract the origin of the image, divide by its \
                      spacing, and write `index`";
        return Err(Bad::new(word.at, detail));
    }
    let count = words
        .next()
        .map_or_else(|| lines.line("the number of points"), Ok)?
        .whole("the number of points")?;
    for _ in 0..count {
        let line = lines.line(&format!("{count} points, as the file says"))?;
        let [x, y] = line.place()?;
        out.point(line.at, Some([x + CENTRE, y + CENTRE]), None)?;
    }
    lines.end()?;
    Ok(lines.position())
}
