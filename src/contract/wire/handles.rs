//! Handles and places: `[x, y]` is a point, `[[x, y], [x, y], ...]` a segment or polyline, `null` a
//! handle without a position. Numbers are finite; the engine checks everything else (range, length,
//! pairing). The memory used is at most ten times the text, usually two or three times.

use mlswarp::deform::Handle;
use mlswarp::geometry::Point;

use super::json::{Kind, Node};
use super::number::number;
use crate::problem::{Code, Problem};

const HANDLE: &str = "a handle: [x, y] or [[x, y], [x, y], ...]";
pub(crate) const PLACE: &str = "a position: [x, y]";
const COORDINATE: &str = "a number";

/// Bytes of text of an ordinary `[x, y],`, and of a weight or a depth.
const PLACE_TEXT: usize = 12;
const WEIGHT_TEXT: usize = 4;

pub(crate) fn handles(node: &Node<'_, '_>) -> Result<Vec<Handle>, Problem> {
    node.list("an array of handles", PLACE_TEXT, |index, item| {
        handle(&item).map_err(|problem| problem.handle(index))
    })
}

/// Handles that are as many as those at rest; a list with more is refused before the rest of it is
/// read.
pub(crate) fn posed_handles(node: &Node<'_, '_>, at_rest: usize) -> Result<Vec<Handle>, Problem> {
    node.list("an array of handles", PLACE_TEXT, |index, item| {
        if index >= at_rest {
            let detail = format!("`q` has more handles than `p`, which has {at_rest}");
            return Err(node.problem(Code::ShapeMismatch, detail));
        }
        handle(&item).map_err(|problem| problem.handle(index))
    })
}

/// Memory of handles, bytes.
pub fn handles_bytes(handles: &[Handle]) -> u64 {
    let lines = handles
        .iter()
        .filter(|handle| matches!(handle, Handle::Polyline(_)));
    let places: usize = lines.map(|line| line.places().len() + 1).sum();
    (size_of_val(handles) + places * size_of::<Point>()) as u64
}

pub(crate) fn weights(node: &Node<'_, '_>) -> Result<Vec<f64>, Problem> {
    node.list("an array of numbers", WEIGHT_TEXT, |index, item| {
        number(&item, "a positive number").map_err(|problem| problem.handle(index))
    })
}

pub(crate) fn depths(node: &Node<'_, '_>) -> Result<Vec<f64>, Problem> {
    node.list("an array of numbers", WEIGHT_TEXT, |index, item| {
        number(&item, "a number between -1000 and 1000").map_err(|problem| problem.handle(index))
    })
}

pub(crate) fn handle(node: &Node<'_, '_>) -> Result<Handle, Problem> {
    if node.kind() == Kind::Null {
        return Ok(Handle::Missing);
    }
    let is_line = node
        .text
        .strip_prefix('[')
        .is_some_and(|inside| inside.trim_start().starts_with('['));
    if !is_line {
        return place(node, HANDLE).map(Handle::Point);
    }
    let line = node.list(HANDLE, PLACE_TEXT, |_, item| place(&item, PLACE))?;
    if line.len() == 1 {
        return Err(node
            .problem(
                Code::BadValue,
                "a line needs at least 2 positions; found 1; write a point as [x, y]",
            )
            .actual(1));
    }
    Ok(Handle::Polyline(line))
}

pub(crate) fn place(node: &Node<'_, '_>, expected: &str) -> Result<Point, Problem> {
    let (mut place, mut count) = ([0.0; 2], 0);
    node.items::<Problem>(expected, |index, item| {
        let value = number(&item, COORDINATE)?;
        *place
            .get_mut(index)
            .ok_or_else(|| node.unexpected(expected, "more than 2 numbers"))? = value;
        count += 1;
        Ok(())
    })?;
    match count {
        2 => Ok(Point::new(place[0], place[1])),
        0 => Err(node.unexpected(expected, "an empty array")),
        _ => Err(node.unexpected(expected, "1 number")),
    }
}
