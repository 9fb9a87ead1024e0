//! Templates of WebMorph and Psychomorph, `.tem`: the number of points, the points, the number of
//! contours, and for each contour three lines: 1 if it is closed, the number of its points, their
//! indices from 0. `#` begins a comment. What follows the contours is passed over, as webmorphR
//! does: a number, notes in JSON, or a byte that is no text.
//!
//! Source: webmorphR (`R/read_stim.R`; `R/mirror.R` mirrors about (W - 1) / 2, so positions are
//! pixel indices from 0): 1/2 is added. Contours become polylines, a closed one ends where it
//! begins. An index that follows itself counts once, and a contour of one index only, as that of a
//! pupil, says nothing: points on no other contour become points. Points come first, then contours.

use mlswarp::deform::Handle;
use mlswarp::geometry::Point;

use super::bad::Bad;
use super::collect::{Collector, Landmark};
use super::words::Lines;
use super::{Format, FormatReader, SourceText};
use crate::problem::words::quote;

pub(super) const FORMAT: Format = Format {
    name: "tem",
    title: "WebMorph .tem",
    items: "faces",
    form: FormatReader::Lines(is_tem, read),
};
const CENTRE: f64 = 0.5;

/// Whether the first line is that of such a file.
pub(super) fn is_tem(first: &str) -> bool {
    !first.is_empty() && first.bytes().all(|byte| byte.is_ascii_digit())
}

fn read(source: SourceText<'_>, out: &mut Collector) -> Result<usize, Bad> {
    let mut lines = Lines::new(source, true);
    let count = lines
        .line("the number of points")?
        .whole("the number of points")?;
    // Points take no less space than columns, so the limit of columns holds for them too.
    let mut points = Vec::new();
    for _ in 0..count {
        let line = lines.line(&format!("{count} points, as the first line says"))?;
        let [x, y] = line.place()?;
        points.push((line.at, Point::new(x + CENTRE, y + CENTRE)));
        out.require_below(line.at, points.len())?;
    }
    let mut is_free = vec![true; points.len()];
    let mut contours = Vec::new();
    if let Some(line) = lines.next_line()? {
        let declared = line.whole("the number of contours")?;
        for _ in 0..declared {
            contours.extend(contour(&mut lines, &points, &mut is_free, out)?);
        }
    }
    for (at, place) in points
        .iter()
        .zip(&is_free)
        .filter_map(|(point, is_free)| is_free.then_some(*point))
    {
        out.point(at, Some([place.x, place.y]), None)?;
    }
    for (at, contour) in contours {
        out.push(Landmark {
            at,
            p: Handle::Polyline(contour),
            q: None,
            name: None,
        })?;
    }
    Ok(lines.position())
}

/// One contour, counted; `None` if it has one point only.
fn contour(
    lines: &mut Lines<'_>,
    points: &[(usize, Point)],
    is_free: &mut [bool],
    out: &mut Collector,
) -> Result<Option<(usize, Vec<Point>)>, Bad> {
    let line = lines.line("1 for a closed contour or 0 for an open one")?;
    let is_closed = match line.text {
        "0" => false,
        "1" => true,
        other => {
            return Err(Bad::new(
                line.at,
                format!(
                    "expected 1 for a closed contour or 0 for an open one; found {}",
                    quote(other)
                ),
            ));
        }
    };
    let count = lines
        .line("the number of points of the contour")?
        .whole("the number of points of the contour")?;
    let line = lines.line("the indices of the points of the contour")?;
    let found = line.words().count();
    if found != count || count < 2 {
        return Err(Bad::new(
            line.at,
            format!("expected {} indices of points; found {found}", count.max(2)),
        ));
    }
    out.require_below(line.at, count)?;
    let mut indices = Vec::with_capacity(count + 1);
    for word in line.words() {
        let index = word.whole("the index of a point")?;
        let last = points.len().saturating_sub(1);
        if index > last || points.is_empty() {
            return Err(Bad::new(
                word.at,
                format!("expected the index of a point, 0 to {last}; found {index}"),
            ));
        }
        indices.push(index);
    }
    if is_closed {
        indices.extend(indices.first().copied());
    }
    indices.dedup();
    if indices.len() < 2 {
        return Ok(None);
    }
    out.count(line.at, indices.len())?;
    indices.iter().for_each(|index| is_free[*index] = false);
    Ok(Some((
        line.at,
        indices.iter().map(|index| points[*index].1).collect(),
    )))
}
