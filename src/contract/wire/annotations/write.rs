//! Mapped annotations as JSON. The text of GeoJSON is copied around what is replaced: positions,
//! and the bounding boxes of objects and geometries.

use std::borrow::Cow;
use std::ops::Range;

use mlswarp::geometry::Point;
use mlswarp::warp::MappedOutline;

use super::super::json::next_value;
use super::reader::{GeoJsonObject, Geometry, Line, PartContents};

/// Numbers in a box of two dimensions.
const BOX_NUMBERS: usize = 4;

/// What follows the features of a FeatureCollection.
#[derive(Clone, Debug, Default)]
pub(super) struct Tail {
    text: Vec<u8>,
    /// Where its bounding box belongs in the text, and the box of the client.
    bbox: Option<(usize, String)>,
    /// The box around what has been written.
    pub(super) bounds: Bounds,
}

/// The smallest box that contains positions: left, top, right, bottom.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds([f64; BOX_NUMBERS]);

/// What stands in place of a text.
enum New {
    Nothing,
    Null,
    /// The line of this index.
    Line(usize),
    Bounds(Bounds),
}

/// Texts that are replaced.
type Replaced<'j> = Vec<(&'j str, New)>;
type Mapped = [Option<MappedOutline>];

impl Default for Bounds {
    fn default() -> Self {
        Self([
            f64::INFINITY,
            f64::INFINITY,
            f64::NEG_INFINITY,
            f64::NEG_INFINITY,
        ])
    }
}

impl Bounds {
    pub(super) fn of(line: &MappedOutline) -> Self {
        let mut bounds = Self::default();
        line.places
            .iter()
            .for_each(|p| bounds.merge(Self([p.x, p.y, p.x, p.y])));
        bounds
    }

    fn of_lines(lines: &Mapped) -> Self {
        let mut bounds = Self::default();
        lines
            .iter()
            .flatten()
            .for_each(|line| bounds.merge(Self::of(line)));
        bounds
    }

    pub(super) const fn merge(&mut self, Self([left, top, right, bottom]): Self) {
        let Self(own) = self;
        *own = [
            own[0].min(left),
            own[1].min(top),
            own[2].max(right),
            own[3].max(bottom),
        ];
    }

    /// `null` if it is empty.
    pub(super) fn write(self, out: &mut Vec<u8>) {
        if self.0[0] <= self.0[2] {
            write_json(&self.0, out)
        } else {
            out.extend(b"null")
        }
    }

    /// The box in place of one with these numbers, of which further dimensions stay.
    fn write_like(self, text: &str, out: &mut Vec<u8>) {
        let sides: Vec<&str> = text
            .strip_prefix('[')
            .map_or_else(Vec::new, |inside| items(inside).collect());
        let half = sides.len() / 2;
        if sides.len() <= BOX_NUMBERS || !sides.len().is_multiple_of(2) || self.0[0] > self.0[2] {
            return self.write(out);
        }
        for (k, side) in sides.iter().enumerate() {
            out.push(if k == 0 { b'[' } else { b',' });
            match (k / half, k % half) {
                (corner, axis @ 0..2) => write_json(&self.0[2 * corner + axis], out),
                _ => out.extend(side.bytes()),
            }
        }
        out.push(b']');
    }
}

/// The values in the inside of an array.
pub(super) fn items(text: &str) -> impl Iterator<Item = &str> {
    let mut at = 0;
    std::iter::from_fn(move || {
        let item = next_value(text.as_bytes(), at, None)?;
        at = item.end;
        text.get(item)
    })
}

/// Writes values in place of those in a text; `null` stays.
pub(super) fn write_items(
    text: &str,
    mut is_first: bool,
    out: &mut Vec<u8>,
    mut each: impl FnMut(&mut Vec<u8>),
) {
    for item in items(text) {
        if !std::mem::take(&mut is_first) {
            out.push(b',');
        }
        if item == "null" {
            out.extend(b"null")
        } else {
            each(out)
        }
    }
}

fn write_json(value: &impl serde::Serialize, out: &mut Vec<u8>) {
    serde_json::to_writer(out, value).expect("memory takes every byte, and numbers have a text");
}

/// Writes a position; `more`: what follows its two numbers.
pub(super) fn write_place(place: Point, more: &str, out: &mut Vec<u8>) {
    write_json(&[place.x, place.y], out);
    if !more.is_empty() {
        out.pop();
        out.extend(more.bytes());
        out.push(b']');
    }
}

/// Writes a list of positions.
pub(super) fn write_places<'a>(
    line: &MappedOutline,
    more: impl Fn(f64) -> Cow<'a, str>,
    out: &mut Vec<u8>,
) {
    out.push(b'[');
    for (k, (place, at)) in line.places.iter().zip(&line.at).enumerate() {
        if k > 0 {
            out.push(b',');
        }
        write_place(*place, &more(*at), out);
    }
    out.push(b']');
}

/// Writes a text of GeoJSON objects; returns the box around those that a bounding box is about.
pub(super) fn write_objects(
    text: &str,
    kept: &PartContents<'_>,
    mapped: &Mapped,
    out: &mut Vec<u8>,
) -> Bounds {
    let (mut replaced, mut all) = (Vec::new(), Bounds::default());
    for object in &kept.objects {
        add_geometries(object, kept, mapped, &mut replaced);
        let own = mapped.get(object.own.clone()).unwrap_or_default();
        // A geometry that is null has no box.
        let bounds = if own.iter().all(Option::is_some) {
            Bounds::of_lines(own)
        } else {
            Bounds::default()
        };
        all.merge(bounds);
        replaced.extend(object.bbox.map(|bbox| (bbox, New::Bounds(bounds))));
    }
    write_replaced(text, 0..text.len(), replaced, (kept, mapped), out);
    all
}

/// Writes a FeatureCollection up to its features; returns the rest. Its bounding box is known when
/// they have been mapped: one that stands before them is moved to the end.
pub(super) fn write_head(
    text: &str,
    features: Range<usize>,
    kept: &PartContents<'_>,
    mapped: &Mapped,
    out: &mut Vec<u8>,
) -> Tail {
    let (mut before, mut tail) = (Vec::new(), Tail::default());
    kept.objects
        .iter()
        .for_each(|object| add_geometries(object, kept, mapped, &mut before));
    let split = |(old, _): &(&str, New)| offset(text, old) < features.start;
    let (mut before, after): (Replaced<'_>, Replaced<'_>) = before.into_iter().partition(split);
    let bbox = kept.objects.iter().find_map(|object| object.bbox);
    let lines = (kept, mapped);
    let at = bbox.map(|bbox| offset(text, bbox));
    match (bbox, at) {
        (Some(bbox), Some(at)) if at > features.end => {
            let (first, second): (Replaced<'_>, Replaced<'_>) = after
                .into_iter()
                .partition(|(old, _)| offset(text, old) < at);
            write_replaced(text, features.end..at, first, lines, &mut tail.text);
            tail.bbox = Some((tail.text.len(), bbox.to_owned()));
            write_replaced(
                text,
                at + bbox.len()..text.len(),
                second,
                lines,
                &mut tail.text,
            );
        }
        (Some(bbox), Some(at)) => {
            before.push((
                text.get(pair_of(text, at)).unwrap_or_default(),
                New::Nothing,
            ));
            write_replaced(
                text,
                features.end..text.len() - 1,
                after,
                lines,
                &mut tail.text,
            );
            tail.text.extend(b",\"bbox\":");
            tail.bbox = Some((tail.text.len(), bbox.to_owned()));
            tail.text.push(b'}');
        }
        _ => write_replaced(text, features.end..text.len(), after, lines, &mut tail.text),
    }
    write_replaced(text, 0..features.start, before, lines, out);
    tail
}

/// Writes what follows the features.
pub(super) fn write_tail(Tail { text, bbox, bounds }: &Tail, out: &mut Vec<u8>) {
    let at = bbox.as_ref().map_or(0, |(at, _)| *at);
    out.extend(&text[..at]);
    if let Some((_, like)) = bbox {
        bounds.write_like(like, out);
    }
    out.extend(&text[at..]);
}

/// The lines and boxes of the geometries of an object; `null` for a geometry of which a position
/// has no image.
fn add_geometries<'j>(
    object: &GeoJsonObject<'j>,
    kept: &PartContents<'j>,
    mapped: &Mapped,
    replaced: &mut Replaced<'j>,
) {
    for Geometry { text, lines, boxes } in &kept.geometries[object.geometries.clone()] {
        if mapped[lines.clone()].iter().any(Option::is_none) {
            replaced.push((text, New::Null));
            continue;
        }
        replaced.extend(
            lines
                .clone()
                .map(|line| (kept.lines[line].text, New::Line(line))),
        );
        let bounds = |lines: &Range<usize>| New::Bounds(Bounds::of_lines(&mapped[lines.clone()]));
        replaced.extend(boxes.iter().map(|(text, lines)| (*text, bounds(lines))));
    }
}

/// Writes a range of a text with the replacements in it.
fn write_replaced(
    text: &str,
    range: Range<usize>,
    mut replaced: Replaced<'_>,
    (kept, mapped): (&PartContents<'_>, &Mapped),
    out: &mut Vec<u8>,
) {
    replaced.sort_by_key(|(old, _)| offset(text, old));
    let mut at = range.start;
    for (old, new) in replaced {
        let start = offset(text, old);
        out.extend(&text.as_bytes()[at..start]);
        at = start + old.len();
        match new {
            New::Nothing => {}
            New::Null => out.extend(b"null"),
            New::Bounds(bounds) => bounds.write_like(old, out),
            New::Line(line) => write_line(&kept.lines[line], mapped[line].as_ref(), kept, out),
        }
    }
    out.extend(&text.as_bytes()[at..range.end]);
}

fn write_line(
    line: &Line<'_>,
    mapped: Option<&MappedOutline>,
    kept: &PartContents<'_>,
    out: &mut Vec<u8>,
) {
    let Some(mapped) = mapped else {
        return out.extend(b"null");
    };
    let more = |k: usize| kept.more(line.places.start + k);
    if line.is_single {
        let place = mapped.places.first().copied().unwrap_or_default();
        return write_place(place, more(0), out);
    }
    let vertex_and_share = |at: f64| {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "an index"
        )]
        let vertex = at as usize;
        (vertex, at.fract())
    };
    write_places(
        mapped,
        |at| {
            let (k, t) = vertex_and_share(at);
            if t > 0.0 {
                between(more(k), more(k + 1), t)
            } else {
                more(k).into()
            }
        },
        out,
    );
}

/// What an added vertex has after its two numbers: numbers between those of both ends of its edge.
fn between<'j>(from: &'j str, to: &'j str, t: f64) -> Cow<'j, str> {
    let numbers = |text: &str| {
        items(text)
            .map(|number| number.parse::<f64>().ok())
            .collect::<Option<Vec<_>>>()
    };
    match (numbers(from), numbers(to)) {
        (Some(from), Some(to)) if from != to && from.len() == to.len() => {
            let number = |(a, b): (&f64, &f64)| format!(",{}", (1.0 - t) * a + t * b);
            from.iter().zip(&to).map(number).collect::<String>().into()
        }
        _ => from.into(),
    }
}

/// Where a part of a text begins in it.
fn offset(text: &str, part: &str) -> usize {
    part.as_ptr() as usize - text.as_ptr() as usize
}

/// The member of an object whose value begins at a byte, up to the next member.
fn pair_of(text: &str, value: usize) -> Range<usize> {
    let (bytes, mut at) = (text.as_bytes(), 1);
    while let Some(name) = next_value(bytes, at, None) {
        let Some(found) = next_value(bytes, name.end, None) else {
            break;
        };
        if found.start == value {
            let next = next_value(bytes, found.end, None).map_or(found.end, |next| next.start);
            return name.start..next;
        }
        at = found.end;
    }
    value..value
}
