//! Handles and places: `[x, y]` is a point, `[[x, y], [x, y], ...]` a segment or polyline. Numbers are finite; everything else about
//! them (range, length, pairing) is the mathematics' to judge. Memory: one list, and one a polyline; for the shortest
//! handles that can be written ten times the text at most, for ordinary ones two or three times.

use mlswarp::deform::Handle;
use mlswarp::geometry::Point;

use super::json::{Kind, Node};
use super::number::number;
use crate::problem::{Code, Problem};

const HANDLE: &str = "a handle: [x, y] or [[x, y], [x, y], ...]";
const PLACE: &str = "a place: [x, y]";
const COORDINATE: &str = "a number";

/// Bytes of text that an ordinary `[x, y],` takes. Lists begin with room for so many: one allocation for most, and no more than
/// twice the text when the text promises what it does not hold.
const PLACE_TEXT: usize = 12;
/// The same of a weight.
const WEIGHT_TEXT: usize = 4;

/// An array of handles.
pub(crate) fn handles(node: &Node<'_, '_>) -> Result<Vec<Handle>, Problem> {
    let mut handles = Vec::with_capacity(1 + node.text().len() / PLACE_TEXT);
    node.items("an array of handles", |index, item| {
        handles.push(handle(&item).map_err(|problem| problem.handle(index))?);
        Ok(())
    })?;
    Ok(handles)
}

/// An array of numbers, one a handle.
pub(crate) fn weights(node: &Node<'_, '_>) -> Result<Vec<f64>, Problem> {
    let mut weights = Vec::with_capacity(1 + node.text().len() / WEIGHT_TEXT);
    node.items("an array of numbers", |index, item| {
        weights.push(number(&item, "a positive number").map_err(|problem| problem.handle(index))?);
        Ok(())
    })?;
    Ok(weights)
}

/// An array of places.
pub(crate) fn places(node: &Node<'_, '_>) -> Result<Vec<Point>, Problem> {
    let mut places = Vec::with_capacity(1 + node.text().len() / PLACE_TEXT);
    node.items("an array of places", |_, item| {
        places.push(place(&item)?);
        Ok(())
    })?;
    Ok(places)
}

fn handle(node: &Node<'_, '_>) -> Result<Handle, Problem> {
    let mut point = Coordinates::default();
    let mut line = Vec::new();
    node.items(HANDLE, |_, item| match item.kind() {
        Kind::Number if line.is_empty() => point.push(number(&item, COORDINATE)?, node, HANDLE),
        Kind::Array if point.count == 0 => {
            line.push(place(&item)?);
            Ok(())
        }
        _ => Err(item.wrong_kind(if line.is_empty() { COORDINATE } else { PLACE })),
    })?;
    match line.len() {
        0 => point.end(node, HANDLE).map(Handle::Point),
        1 => Err(node.problem(Code::BadValue, "a line needs 2 places or more; found 1; a point is [x, y]").actual(1)),
        _ => Ok(Handle::Polyline(line)),
    }
}

fn place(node: &Node<'_, '_>) -> Result<Point, Problem> {
    let mut place = Coordinates::default();
    node.items(PLACE, |_, item| place.push(number(&item, COORDINATE)?, node, PLACE))?;
    place.end(node, PLACE)
}

/// The numbers of a place so far.
#[derive(Default)]
struct Coordinates {
    values: [f64; 2],
    count: usize,
}

impl Coordinates {
    /// `node`: the place itself, at fault when it has a third number.
    fn push(&mut self, value: f64, node: &Node<'_, '_>, expected: &str) -> Result<(), Problem> {
        let Some(slot) = self.values.get_mut(self.count) else {
            return Err(node.problem(Code::BadValue, format!("expected {expected}; found more than 2 numbers")));
        };
        *slot = value;
        self.count += 1;
        Ok(())
    }

    fn end(self, node: &Node<'_, '_>, expected: &str) -> Result<Point, Problem> {
        let [x, y] = self.values;
        match self.count {
            2 => Ok(Point::new(x, y)),
            0 => Err(node.problem(Code::BadValue, format!("expected {expected}; found an empty array"))),
            _ => Err(node.problem(Code::BadValue, format!("expected {expected}; found 1 number"))),
        }
    }
}
