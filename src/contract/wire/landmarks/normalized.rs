//! Lists of normalised landmarks in JSON, as programs write the results of MediaPipe and ARKit:
//! objects with `x` and `y` (further fields such as `z` and `visibility` are ignored; `name` is the
//! name), or arrays `[x, y]`, from 0 to 1, y down. Nothing is added: 0 and 1 are the edges of the
//! image.
//!
//! Sources: MediaPipe's `NormalizedLandmark` (`mediapipe/framework/formats/landmark.proto`) and the
//! results of its tasks, "in normalized image coordinates" (`faceLandmarks`, a list for each face);
//! ARKit's `ARSkeleton2D.jointLandmarks` ("where 0 is the upper left, and 1 is the bottom right").
//! Apple's Vision framework counts y from the bottom and has no file format: convert it before.

use super::bad::{Bad, BadJson};
use super::collect::{Collector, CoordinateConvention, Located};
use super::json::ObjectMembers;
use super::own::read_names;
use super::{Format, FormatReader, offset};
use crate::problem::Problem;
use crate::wire::json::{Kind, Node};
use crate::wire::number::number;

pub(super) const MEDIAPIPE: Format = Format {
    name: "mediapipe",
    title: "MediaPipe",
    items: "lists",
    form: FormatReader::Json(is_mediapipe, read),
};
pub(super) const ARKIT: Format = Format {
    name: "arkit",
    title: "ARKit",
    items: "lists",
    form: FormatReader::Json(is_arkit, read),
};
/// The fields of an object that contain a list. ARKit's stand last, with the names of its joints.
const LISTS: [&str; 16] = [
    "landmarks",
    "landmark",
    "faceLandmarks",
    "face_landmarks",
    "multiFaceLandmarks",
    "multi_face_landmarks",
    "poseLandmarks",
    "pose_landmarks",
    "handLandmarks",
    "hand_landmarks",
    "leftHandLandmarks",
    "left_hand_landmarks",
    "rightHandLandmarks",
    "right_hand_landmarks",
    "jointLandmarks",
    "jointNames",
];
const LIST: &str = "a list of landmarks {\"x\", \"y\"}";
const ARRAY: &str = "at least 2 numbers, x and y";
const SHARE: &str = "a share of the image, 0 to 1";

fn is_arkit(fields: &ObjectMembers<'_>) -> bool {
    !fields.is_list && fields.has("jointLandmarks")
}

/// A list without a field that says what it is, or an object with such a field.
fn is_mediapipe(fields: &ObjectMembers<'_>) -> bool {
    fields.is_list || LISTS.iter().any(|name| fields.has(name))
}

fn read(text: &str, root: &Node<'_, '_>, out: &mut Collector) -> Result<usize, BadJson> {
    out.set_frame(CoordinateConvention::Normalized);
    if root.kind() == Kind::Array {
        return read_lists(text, root, None, true, out);
    }
    let [lists @ .., names] = root.find(&LISTS)?;
    let mut given = lists
        .iter()
        .zip(LISTS)
        .filter_map(|(list, name)| Some((list.as_ref()?, name)));
    match (given.next(), given.next()) {
        (None, _) => Err(Bad::new(
            offset(text, root),
            "expected a list of landmarks; found none",
        )
        .into()),
        (Some((_, first)), Some((list, second))) => {
            let detail = format!(
                "expected one list of landmarks; found `{first}` and `{second}`: send one of them"
            );
            Err(Bad::new(offset(text, list), detail).into())
        }
        (Some((list, _)), None) => read_lists(text, list, names.as_ref(), false, out),
    }
}

/// Reads a list, or one of the lists of several faces, hands or bodies. `is_bare`: without a field
/// that says what it is.
fn read_lists(
    text: &str,
    list: &Node<'_, '_>,
    names: Option<&Node<'_, '_>>,
    is_bare: bool,
    out: &mut Collector,
) -> Result<usize, BadJson> {
    if is_list_of_lists(list) {
        list.items::<BadJson>(LIST, |_, inner| {
            if out.item(offset(text, &inner), &[])? {
                read_list(text, &inner, names, is_bare, out)?;
            }
            Ok(())
        })?;
    } else {
        read_list(text, list, names, is_bare, out)?;
    }
    Ok(offset(text, list))
}

fn read_list(
    text: &str,
    list: &Node<'_, '_>,
    names: Option<&Node<'_, '_>>,
    is_bare: bool,
    out: &mut Collector,
) -> Result<(), BadJson> {
    let mut count = 0;
    let mut places = Vec::new();
    list.items::<BadJson>(LIST, |_, item| {
        let at = offset(text, &item);
        out.require_below(at, count + 1)?;
        count += 1;
        if item.kind() == Kind::Array && is_bare {
            let detail = "expected objects {\"x\", \"y\"}; found arrays, which may be px: send \
                {\"p\": [[x, y], ...], \"units\": \"px\"} or \"normalized\"";
            return Err(Bad::new(at, detail).into());
        }
        places.push((at, read_item(&item)?));
        Ok(())
    })?;
    let names = names
        .map(|names| read_names(text, names, count))
        .transpose()?;
    for (index, (at, (place, name))) in places.into_iter().enumerate() {
        let own = name.map(|name| (at, name));
        let name = own
            .as_ref()
            .or_else(|| names.as_ref().and_then(|names| names.get(index)));
        out.point(
            at,
            place,
            name.map(|(at, name)| Located {
                at: *at,
                text: name,
            }),
        )?;
    }
    Ok(())
}

/// `[[{...}], ...]`: the lists of several faces.
fn is_list_of_lists(list: &Node<'_, '_>) -> bool {
    list.first().is_some_and(|first| {
        first.kind() == Kind::Array
            && first
                .first()
                .is_some_and(|inner| inner.kind() == Kind::Object)
    })
}

/// The position of a landmark, `None` if it is `null`, and its name.
fn read_item(item: &Node<'_, '_>) -> Result<(Option<[f64; 2]>, Option<String>), BadJson> {
    if item.kind() == Kind::Null {
        return Ok((None, None));
    }
    if item.kind() == Kind::Array {
        // Further numbers are the depth and the like.
        let (mut place, mut count) = ([0.0; 2], 0);
        item.items::<Problem>(ARRAY, |index, value| {
            if let Some(coordinate) = place.get_mut(index) {
                *coordinate = number(&value, SHARE)?;
            }
            count += 1;
            Ok(())
        })?;
        return if count < 2 {
            Err(item.unexpected(ARRAY, count).into())
        } else {
            Ok((Some(place), None))
        };
    }
    let [x, y, name] = item.find(&["x", "y", "name"])?;
    let x = number(&x.ok_or_else(|| item.missing("x", SHARE))?, SHARE)?;
    let y = number(&y.ok_or_else(|| item.missing("y", SHARE))?, SHARE)?;
    Ok((
        Some([x, y]),
        name.map(|name| name.string("a name")).transpose()?,
    ))
}
