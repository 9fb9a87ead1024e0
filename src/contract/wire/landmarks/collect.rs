//! What every reader collects: handles and names, checked as they come.

use mlswarp::deform::Handle;
use mlswarp::geometry::Point;

use super::Format;
use super::bad::Bad;
use super::item::{ImageNames, Item, ItemAction, ItemName, Items};
use crate::problem::words::quote;

/// The largest coordinate of the contract, px.
const MAX_PX: f64 = 1e6;
/// The largest normalised coordinate: a landmark may lie outside of the image, but not this far.
const MAX_NORMALIZED: f64 = 4.0;
/// The longest name, bytes.
const LONGEST_NAME: usize = 256;

/// A text of the file and its place, bytes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Located<'a> {
    pub(super) at: usize,
    pub(super) text: &'a str,
}

impl Located<'_> {
    /// A finite number within the range of coordinates in px.
    pub(super) fn number(self) -> Result<f64, Bad> {
        self.parse(false)
    }

    /// Whether this cell has no value: it is empty, or not a number by its own account.
    pub(super) fn is_missing(self) -> bool {
        ["", "nan", "na", "n/a"]
            .iter()
            .any(|missing| self.text.trim().eq_ignore_ascii_case(missing))
    }

    /// As [`Located::number`]; `decimal_comma`: as spreadsheets of many countries write it.
    pub(super) fn parse(self, decimal_comma: bool) -> Result<f64, Bad> {
        let text = self.text.trim();
        let value = match text.parse() {
            Err(_) if decimal_comma && text.contains(',') && text.len() <= 64 => {
                text.replacen(',', ".", 1).parse()
            }
            parsed => parsed,
        };
        let found = if text.is_empty() {
            "nothing".to_owned()
        } else {
            quote(text)
        };
        let value: f64 =
            value.map_err(|_| Bad::new(self.at, format!("expected a number; found {found}")))?;
        in_range(self.at, value, MAX_PX, &found)
    }
}

fn in_range(at: usize, value: f64, max: f64, found: &str) -> Result<f64, Bad> {
    match value {
        _ if !value.is_finite() => Err(Bad::new(
            at,
            format!("expected a finite number; found {found}"),
        )),
        _ if value.abs() > max => Err(Bad::new(
            at,
            format!("expected a coordinate from -{max} to {max}; found {found}"),
        )),
        _ => Ok(value),
    }
}

/// The coordinates of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CoordinateConvention {
    /// Those of the contract.
    Px,
    /// As [`CoordinateConvention::Px`], but y points up from the lower edge of the image.
    PxUp,
    /// Shares of the size of the image.
    Normalized,
}

impl CoordinateConvention {
    /// The largest coordinate.
    fn max(self) -> f64 {
        if self == Self::Normalized {
            MAX_NORMALIZED
        } else {
            MAX_PX
        }
    }
}

/// Names that only one side has; their landmarks are left out.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Unmatched {
    pub(super) p: Vec<String>,
    pub(super) q: Vec<String>,
}

impl Unmatched {
    /// Whether every landmark has two sides.
    pub(super) fn is_empty(&self) -> bool {
        self.p.is_empty() && self.q.is_empty()
    }
}

/// What one file holds.
#[derive(Debug)]
pub(super) struct LandmarkFile {
    pub(super) p: Vec<Handle>,
    pub(super) q: Option<Vec<Handle>>,
    /// All handles have names, or none has: where each is in the file, bytes, and its text. Names
    /// may be repeated.
    pub(super) names: Option<Vec<(usize, String)>>,
    /// Where each handle is in the file, bytes.
    pub(super) at: Vec<usize>,
    pub(super) frame: CoordinateConvention,
    pub(super) format: &'static str,
    /// Names of landmarks that the file gives for one side only.
    pub(super) unmatched: Unmatched,
}

/// A landmark: its handle on each side, and its place in the file.
#[derive(Debug)]
pub(super) struct Landmark<'a> {
    pub(super) at: usize,
    pub(super) p: Handle,
    pub(super) q: Option<Handle>,
    pub(super) name: Option<Located<'a>>,
}

/// Collects the landmarks of a file.
#[derive(Debug)]
pub(super) struct Collector {
    max_columns: usize,
    columns: usize,
    p: Vec<Handle>,
    q: Vec<Handle>,
    at: Vec<usize>,
    names: Vec<(usize, Option<String>)>,
    frame: CoordinateConvention,
    unmatched: Unmatched,
    items: Items,
}

/// A position as a point; `None` is a landmark without one.
fn point(place: Option<[f64; 2]>) -> Handle {
    place.map_or(Handle::Missing, |[x, y]| Handle::Point(Point::new(x, y)))
}

impl Collector {
    pub(super) fn new(max_columns: usize, item: Option<Item>) -> Self {
        let (p, q, at, names) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let (frame, unmatched, items) = (
            CoordinateConvention::Px,
            Unmatched::default(),
            Items::new(item),
        );
        Self {
            max_columns,
            columns: 0,
            p,
            q,
            at,
            names,
            frame,
            unmatched,
            items,
        }
    }

    pub(super) fn set_frame(&mut self, frame: CoordinateConvention) {
        self.frame = frame;
    }

    /// The items of the file until now.
    pub(super) fn items(&self) -> &Items {
        &self.items
    }

    /// As [`Collector::named_item`], of an item whose names no other one begins with.
    pub(super) fn item(&mut self, at: usize, names: &[&str]) -> Result<bool, Bad> {
        let pieces: Vec<[&str; 1]> = names.iter().map(|name| [*name]).collect();
        let name = |pieces| ItemName {
            pieces,
            part: "",
            rest: self.items.rest(pieces),
        };
        let names: Vec<ItemName<'_>> = pieces.iter().map(|pieces| name(pieces)).collect();
        self.named_item(at, &names)
    }

    /// As [`Collector::named_item`], of an item of an image; `file` and `part` as there.
    pub(super) fn item_of(
        &mut self,
        at: usize,
        image: ImageNames,
        (file, part): (&str, &str),
    ) -> Result<bool, Bad> {
        image.with(file, part, |names| self.named_item(at, names))
    }

    /// The next item of the file begins, which has these names. Whether its landmarks are wanted;
    /// those that were collected before may be forgotten. Errors: A second item with the wanted
    /// name.
    pub(super) fn named_item(&mut self, at: usize, names: &[ItemName<'_>]) -> Result<bool, Bad> {
        let action = self.items.next(at, names)?;
        if action == ItemAction::ReadInstead {
            (self.columns, self.unmatched) = (0, Unmatched::default());
            (self.p, self.q, self.at, self.names) =
                (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        }
        Ok(action != ItemAction::Skip)
    }

    /// Counts the columns of a handle with this number of positions, before memory is allocated for
    /// it. Errors: Too many.
    pub(super) fn count(&mut self, at: usize, positions: usize) -> Result<(), Bad> {
        self.columns = self.columns.saturating_add(if positions < 2 {
            1
        } else {
            2 * (positions - 1)
        });
        if self.columns > self.max_columns {
            Err(Bad::too_many(at, self.max_columns))
        } else {
            Ok(())
        }
    }

    /// Errors: More positions than columns, for a list that is not counted yet.
    pub(super) fn require_below(&self, at: usize, positions: usize) -> Result<(), Bad> {
        if positions > self.max_columns {
            Err(Bad::too_many(at, self.max_columns))
        } else {
            Ok(())
        }
    }

    /// Adds a point of one side, or a landmark without a position; it is counted here.
    pub(super) fn point(
        &mut self,
        at: usize,
        p: Option<[f64; 2]>,
        name: Option<Located<'_>>,
    ) -> Result<(), Bad> {
        self.count(at, 1)?;
        self.push(Landmark {
            at,
            p: point(p),
            q: None,
            name,
        })
    }

    /// Adds a point of both sides, or a landmark without a position on one; it is counted here.
    pub(super) fn pair(
        &mut self,
        at: usize,
        sides: [Option<[f64; 2]>; 2],
        name: Option<Located<'_>>,
    ) -> Result<(), Bad> {
        self.count(at, 1)?;
        let [p, q] = sides.map(point);
        self.push(Landmark {
            at,
            p,
            q: Some(q),
            name,
        })
    }

    /// Adds a landmark that has been counted.
    pub(super) fn push(&mut self, landmark: Landmark<'_>) -> Result<(), Bad> {
        let Landmark { at, p, q, name } = landmark;
        for handle in [Some(&p), q.as_ref()].into_iter().flatten() {
            for place in handle.places() {
                for value in [place.x, place.y] {
                    in_range(at, value, self.frame.max(), &format!("`{value}`"))?;
                }
            }
        }
        let name = name
            .map(|name| Located {
                text: name.text.trim(),
                ..name
            })
            .filter(|name| !name.text.is_empty());
        let (name_at, name) = match name {
            Some(name) => (name.at, Some(checked_name(name)?)),
            None => (at, None),
        };
        self.names.push((name_at, name));
        self.p.push(p);
        self.q.extend(q);
        self.at.push(at);
        Ok(())
    }

    /// Counts a landmark that is left out: rows without effect are limited as those that count.
    pub(super) fn pass(&mut self, at: usize) -> Result<(), Bad> {
        self.count(at, 1)
    }

    /// Notes a landmark that has a position on one side only.
    pub(super) fn one_sided(
        &mut self,
        at: usize,
        has_p: bool,
        name: Located<'_>,
    ) -> Result<(), Bad> {
        self.count(at, 1)?;
        let side = if has_p {
            &mut self.unmatched.p
        } else {
            &mut self.unmatched.q
        };
        side.push(checked_name(name)?);
        Ok(())
    }

    /// The file. `end`: where a missing landmark would be.
    /// Errors: No landmarks, or names of some of them only; several items and none was chosen.
    pub(super) fn finish(self, format: &'static Format, end: usize) -> Result<LandmarkFile, Bad> {
        let Self {
            p,
            q,
            at,
            names,
            frame,
            unmatched,
            items,
            ..
        } = self;
        items.check(format.items, end)?;
        if p.iter().all(|handle| *handle == Handle::Missing) {
            let found = if p.is_empty() {
                "none"
            } else {
                "landmarks without positions only"
            };
            return Err(Bad::new(
                end,
                format!("expected at least one landmark; found {found}"),
            ));
        }
        let q = (!q.is_empty()).then_some(q);
        Ok(LandmarkFile {
            p,
            q,
            names: all_or_none(names)?,
            at,
            frame,
            format: format.name,
            unmatched,
        })
    }
}

fn checked_name(name: Located<'_>) -> Result<String, Bad> {
    if name.text.len() > LONGEST_NAME {
        return Err(Bad::new(
            name.at,
            format!(
                "expected a name of at most {LONGEST_NAME} bytes; found {}",
                quote(name.text)
            ),
        ));
    }
    Ok(name.text.to_owned())
}

/// All names with their places, or none if no landmark has one.
fn all_or_none(names: Vec<(usize, Option<String>)>) -> Result<Option<Vec<(usize, String)>>, Bad> {
    if names.iter().all(|(_, name)| name.is_none()) {
        return Ok(None);
    }
    let named = |(at, name): (usize, Option<String>)| match name {
        Some(name) => Ok((at, name)),
        None => Err(Bad::new(
            at,
            "expected a name, because other landmarks have names; found none",
        )),
    };
    names
        .into_iter()
        .map(named)
        .collect::<Result<_, _>>()
        .map(Some)
}
