//! Annotations are mapped part by part: as many of them as have a bounded text are read, mapped and
//! written, so that memory depends on a part and not on all of them.

use std::ops::Range;

use mlswarp::deform::IsCancelled;
use mlswarp::warp::{MappedOutline, Outline, Taken, Transform, WarpError};

use super::super::json::{At, Node, next_value};
use super::super::work::Work;
use super::geojson::{GeoJsonShape, read_collection};
use super::reader::{Line, PartContents, Reader};
use super::write::{
    Bounds, Tail, items, write_head, write_items, write_objects, write_place, write_places,
    write_tail,
};
use super::{Annotation, AnnotationKind, Annotations};
use crate::problem::Problem;

/// Distance of mapped outlines from the exact map, px of their image.
const OUTLINE_WITHIN: f64 = 0.1;
/// The same of the outlines whose bounding boxes are taken.
const BOX_WITHIN: f64 = 0.01;
/// Text of annotations that are mapped together, bytes; a single annotation may have more.
const PART_BYTES: usize = 256 << 10;
/// Longest text of a mapped position, bytes: two numbers of 24 characters, brackets, commas.
const PLACE_TEXT: usize = 52;
/// Memory of a position, of a list of positions, and of an object, read and mapped, bytes.
const PLACE_BYTES: u64 = 256;
const LIST_BYTES: u64 = 320;
const OBJECT_BYTES: u64 = 448;

/// Reserves further bytes.
pub type ReserveMore<'a> = &'a mut dyn FnMut(u64) -> Result<(), Problem>;

/// How far annotations have been mapped.
#[derive(Clone, Debug, Default)]
pub struct Cursor {
    kind: usize,
    /// Where the next annotation is in the text; `None` before the first.
    next: Option<usize>,
    has_fields: bool,
    is_bare: bool,
    tail: Tail,
    /// What the annotations before have taken.
    pub taken: Taken,
}

/// How a part is mapped.
struct Mapping<'a> {
    transform: &'a Transform<'a>,
    is_refined: bool,
    cancelled: IsCancelled<'a>,
}

impl Cursor {
    /// Continues an object that has fields and no last bracket.
    pub fn after_fields() -> Self {
        Self {
            has_fields: true,
            ..Self::default()
        }
    }

    /// Writes the value of the field in place of an object, if there is only one.
    pub fn bare() -> Self {
        Self {
            is_bare: true,
            ..Self::default()
        }
    }
}

impl Annotations {
    /// Maps a part of the annotations and appends its text; false after the last one. CPU work, in
    /// parallel on the current rayon pool.
    /// Errors: Too many positions to examine, too little memory, cancelled.
    pub fn map_part(
        &self,
        cursor: &mut Cursor,
        transform: &Transform<'_>,
        cancelled: IsCancelled<'_>,
        reserve: ReserveMore<'_>,
        out: &mut Vec<u8>,
    ) -> Result<bool, Problem> {
        let mapping = Mapping {
            transform,
            is_refined: self.is_refined,
            cancelled,
        };
        let is_bare = cursor.is_bare && self.kinds.len() == 1;
        if let (Some(kind), 0, None) = (self.kinds.first(), cursor.kind, cursor.next) {
            // What would take too long is refused before anything is written.
            transform
                .check_positions(self.positions)
                .map_err(|error| kind.problem(error))?;
        }
        if !(is_bare || cursor.has_fields) {
            out.push(b'{');
        }
        let mut length = 0;
        while let Some(kind) = self.kinds.get(cursor.kind) {
            let at = match cursor.next {
                Some(at) => at,
                None => {
                    reserve(kind.around_bytes())?;
                    if !is_bare {
                        let comma = if cursor.has_fields { "," } else { "" };
                        out.extend(format!("{comma}\"{}\":", kind.name()).bytes());
                        cursor.has_fields = true;
                    }
                    cursor.tail = kind.begin(&mapping, out)?;
                    kind.items.start
                }
            };
            let part = kind.part(at, &mapping)?;
            if part.is_empty() {
                kind.end(at, &cursor.tail, out);
                (cursor.kind, cursor.next) = (cursor.kind + 1, None);
                continue;
            }
            length += part.len();
            cursor.next = Some(part.end);
            kind.map(part, &mapping, reserve, &mut cursor.tail, out)?;
            if length >= PART_BYTES {
                return Ok(true);
            }
        }
        if !is_bare {
            out.push(b'}');
        }
        Ok(false)
    }
}

impl Annotation {
    fn node<'a>(&'a self, text: &'a str, work: &'a Work<'a>) -> Node<'a, 'a> {
        Node {
            work: Some(work),
            ..Node::new(text, At::Field(&At::Root, self.name()))
        }
    }

    fn str(&self, range: Range<usize>) -> &str {
        // It was read as text.
        std::str::from_utf8(self.text.get(range).unwrap_or_default()).unwrap_or_default()
    }

    /// Where the next annotations are, with the text before them; empty after the last one.
    /// Errors: Cancelled; a single annotation may be long.
    fn part(&self, from: usize, mapping: &Mapping<'_>) -> Result<Range<usize>, Problem> {
        let (text, mut end) = (&self.text[..self.items.end], from);
        let work = Work::new(mapping.cancelled);
        while end - from < PART_BYTES
            && let Some(item) = next_value(text, end, Some(&work))
        {
            end = item.end;
        }
        work.believe(Ok(from..end))
    }

    /// The memory for the text around the annotations.
    fn around_bytes(&self) -> u64 {
        let around = self.text.len() - self.items.len();
        // Once as it is read, and its copies.
        reading_bytes(&self.text[..self.items.start])
            + reading_bytes(&self.text[self.items.end..])
            + 2 * around as u64
    }

    /// Writes the text before the annotations.
    fn begin(&self, mapping: &Mapping<'_>, out: &mut Vec<u8>) -> Result<Tail, Problem> {
        match (self.kind, self.shape) {
            (AnnotationKind::GeoJson, GeoJsonShape::FeatureCollection) => {
                let text = self.str(0..self.text.len());
                let (mut reader, work) = (Reader::keeping(), Work::new(mapping.cancelled));
                work.believe(read_collection(&self.node(text, &work), &mut reader))?;
                let kept = reader.kept.unwrap_or_default();
                let mapped = self.map_lines(&kept, mapping)?;
                Ok(write_head(text, self.items.clone(), &kept, &mapped, out))
            }
            (AnnotationKind::GeoJson, _) => {
                out.extend(&self.text[..self.items.start]);
                Ok(Tail::default())
            }
            _ => {
                out.push(b'[');
                Ok(Tail::default())
            }
        }
    }

    /// Writes the text after the annotations, the last of which ends `at` this byte.
    fn end(&self, at: usize, tail: &Tail, out: &mut Vec<u8>) {
        match (self.kind, self.shape) {
            (AnnotationKind::GeoJson, GeoJsonShape::FeatureCollection) => {
                out.extend(&self.text[at..self.items.end]);
                write_tail(tail, out);
            }
            (AnnotationKind::GeoJson, _) => out.extend(&self.text[at..]),
            _ => out.push(b']'),
        }
    }

    /// Maps a part and writes it.
    fn map(
        &self,
        part: Range<usize>,
        mapping: &Mapping<'_>,
        reserve: ReserveMore<'_>,
        tail: &mut Tail,
        out: &mut Vec<u8>,
    ) -> Result<(), Problem> {
        let (text, is_first) = (self.str(part.clone()), part.start == self.items.start);
        reserve(reading_bytes(text.as_bytes()))?;
        let (mut reader, work) = (Reader::keeping(), Work::new(mapping.cancelled));
        for item in items(text) {
            work.believe(self.kind.read_item(&self.node(item, &work), &mut reader))?;
        }
        let kept = reader.kept.unwrap_or_default();
        if self.kind == AnnotationKind::Points {
            let mapped = mapping.transform.map(&kept.places, mapping.cancelled);
            let mut mapped = mapped.map_err(|error| self.problem(error))?.into_iter();
            reserve_text(text.len() + PLACE_TEXT * kept.places.len(), reserve, out)?;
            write_items(text, is_first, out, |out| match mapped.next().flatten() {
                Some(place) => write_place(place, "", out),
                None => out.extend(b"null"),
            });
            return Ok(());
        }
        let mapped = self.map_lines(&kept, mapping)?;
        let vertices: usize = mapped.iter().flatten().map(|line| line.places.len()).sum();
        let more = kept
            .more
            .iter()
            .map(|more| more.len())
            .max()
            .unwrap_or_default();
        reserve_text(text.len() + (PLACE_TEXT + more) * vertices, reserve, out)?;
        let mut lines = mapped.iter();
        match self.kind {
            AnnotationKind::GeoJson => {
                let bounds = write_objects(text, &kept, &mapped, out);
                tail.bounds.merge(bounds);
            }
            AnnotationKind::Boxes => write_items(text, is_first, out, |out| match lines.next() {
                Some(Some(line)) => Bounds::of(line).write(out),
                _ => out.extend(b"null"),
            }),
            _ => write_items(text, is_first, out, |out| match lines.next() {
                Some(Some(line)) => write_places(line, |_| "".into(), out),
                _ => out.extend(b"null"),
            }),
        }
        Ok(())
    }

    fn map_lines(
        &self,
        kept: &PartContents<'_>,
        Mapping {
            transform,
            is_refined,
            cancelled,
        }: &Mapping<'_>,
    ) -> Result<Vec<Option<MappedOutline>>, Problem> {
        let tolerance = match self.kind {
            AnnotationKind::Boxes => Some(BOX_WITHIN),
            _ => is_refined.then_some(OUTLINE_WITHIN),
        };
        let outline = |line: &Line<'_>| {
            let places = &kept.places[line.places.clone()];
            Outline {
                places,
                edges: line.edges,
            }
        };
        let outlines: Vec<Outline<'_>> = kept.lines.iter().map(outline).collect();
        let mapped = transform.map_outlines(&outlines, tolerance, *cancelled);
        mapped.map_err(|error| self.problem(error))
    }

    fn problem(&self, error: WarpError) -> Problem {
        match error {
            WarpError::BadPlace { .. } | WarpError::TooLarge { .. } => {
                Problem::from(error).pointer(format!("/{}", self.name()))
            }
            error => error.into(),
        }
    }
}

/// Upper bound of the memory in which a part is read and mapped if nothing is added to it, bytes.
fn reading_bytes(text: &[u8]) -> u64 {
    let of = |pair: &[u8]| match pair {
        [b'[', b'[' | b']' | b' ' | b'\t' | b'\n' | b'\r', ..] => LIST_BYTES,
        [b'[', ..] => PLACE_BYTES,
        [b'{', ..] => OBJECT_BYTES,
        _ => 0,
    };
    // A last byte has nothing after it.
    text.windows(2).map(of).sum::<u64>() + OBJECT_BYTES
}

fn reserve_text(bytes: usize, reserve: ReserveMore<'_>, out: &mut Vec<u8>) -> Result<(), Problem> {
    reserve(bytes as u64)?;
    out.reserve(bytes);
    Ok(())
}
