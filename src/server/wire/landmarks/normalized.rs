//! Lists of normalised landmarks in JSON, as programs write the results of MediaPipe and ARKit: objects with `x` and `y` (further fields
//! such as `z` and `visibility` are ignored; `name` is the name), or arrays `[x, y]`, from 0 to 1, y down. Nothing is added: 0 and 1 are the
//! edges of the image.
//!
//! Sources: MediaPipe's `NormalizedLandmark` (`mediapipe/framework/formats/landmark.proto`) and the results of its tasks, "in normalized
//! image coordinates" (`faceLandmarks`, a list for each face); ARKit's `ARSkeleton2D.jointLandmarks` ("where 0 is the upper left, and 1 is
//! the bottom right"). Apple's Vision framework counts y from the bottom and has no file format: convert it before.

use mlswarp::warp::Units;

use super::bad::{Bad, BadJson};
use super::collect::{Collector, Located};
use super::own::read_names;
use super::{File, offset};
use crate::problem::Problem;
use crate::wire::json::{Kind, Node};
use crate::wire::number::number;

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

pub(super) fn read(text: &str, root: &Node<'_, '_>, mut out: Collector) -> Result<File, BadJson> {
    out.set_units(Units::Normalized);
    if root.kind() != Kind::Object {
        return read_list(text, root, None, true, "mediapipe", out);
    }
    let [lists @ .., names] = root.find(&LISTS)?;
    let mut given = lists.iter().zip(LISTS).filter_map(|(list, name)| Some((list.as_ref()?, name)));
    match (given.next(), given.next()) {
        (None, _) => {
            let detail = "expected `p` (our JSON), `shapes` (labelme) or a list of landmarks such as `landmarks` or `faceLandmarks`";
            Err(Bad::new(offset(text, root), format!("{detail}; found an object without any of them")).into())
        }
        (Some((_, first)), Some((list, second))) => {
            let detail = format!("expected one list of landmarks; found `{first}` and `{second}`: send one of them");
            Err(Bad::new(offset(text, list), detail).into())
        }
        (Some((list, name)), None) => {
            let format = if name == "jointLandmarks" { "arkit" } else { "mediapipe" };
            read_list(text, list, names.as_ref(), false, format, out)
        }
    }
}

/// Reads a list, or the only one in a list of lists. `is_bare`: without a field that says what it is.
fn read_list(
    text: &str,
    list: &Node<'_, '_>,
    names: Option<&Node<'_, '_>>,
    is_bare: bool,
    format: &'static str,
    mut out: Collector,
) -> Result<File, BadJson> {
    if is_list_of_lists(list) {
        let mut inner = None;
        list.items::<BadJson>(LIST, |index, item| {
            if index > 0 {
                return Err(Bad::new(offset(text, &item), "expected the landmarks of one face, hand or body; found a second list").into());
            }
            inner = Some(item.text);
            Ok(())
        })?;
        if let Some(inner) = inner {
            let inner = Node { text: inner, ..*list };
            return read_list(text, &inner, names, is_bare, format, out);
        }
    }
    let mut count = 0;
    let mut places = Vec::new();
    list.items::<BadJson>(LIST, |_, item| {
        let at = offset(text, &item);
        out.require_below(at, count + 1)?;
        count += 1;
        if item.kind() == Kind::Array && is_bare {
            let detail = "expected objects {\"x\", \"y\"}; found arrays, which may be px: send {\"p\": [[x, y], ...], \"units\": \"px\"} or \"normalized\"";
            return Err(Bad::new(at, detail).into());
        }
        places.push((at, read_item(&item)?));
        Ok(())
    })?;
    let names = names.map(|names| read_names(text, names, count)).transpose()?;
    for (index, (at, (place, name))) in places.into_iter().enumerate() {
        let own = name.map(|name| (at, name));
        let name = own.as_ref().or_else(|| names.as_ref().and_then(|names| names.get(index)));
        out.point(at, place, None, name.map(|(at, name)| Located { at: *at, text: name }))?;
    }
    Ok(out.finish(format, offset(text, list))?)
}

/// `[[{...}], ...]`: the lists of several faces.
fn is_list_of_lists(list: &Node<'_, '_>) -> bool {
    let inside = list.text.strip_prefix('[').and_then(|inside| inside.trim_start().strip_prefix('['));
    inside.is_some_and(|inside| inside.trim_start().starts_with('{'))
}

fn read_item(item: &Node<'_, '_>) -> Result<([f64; 2], Option<String>), BadJson> {
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
        return if count < 2 { Err(item.unexpected(ARRAY, count).into()) } else { Ok((place, None)) };
    }
    let [x, y, name] = item.find(&["x", "y", "name"])?;
    let x = number(&x.ok_or_else(|| item.missing("x", SHARE))?, SHARE)?;
    let y = number(&y.ok_or_else(|| item.missing("y", SHARE))?, SHARE)?;
    Ok(([x, y], name.map(|name| name.string("a name")).transpose()?))
}
