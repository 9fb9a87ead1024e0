//! Annotations of CVAT, "CVAT for images 1.1", XML:
//! `<annotations><image name="..."><points label="..." points="x,y;x,y"/>`. Points become points,
//! polylines and polygons lines, as those of labelme. The label is the name; of several points in
//! one element the label and a number. A skeleton is an item of its own, whose elements that are
//! `outside` are missing; all other shapes of an image are one item. Boxes, ellipses, masks,
//! cuboids and tags are no landmarks.
//!
//! Source: CVAT, "XML annotation format". The corner of the image is 0, 0, as in the contract:
//! nothing is added.

use mlswarp::deform::Handle;
use mlswarp::geometry::Point;

use super::bad::Bad;
use super::collect::{Collector, Landmark, Located};
use super::item::ImageNames;
use super::xml::{Tag, Tags, root};
use super::{Format, FormatReader, SourceText};
use crate::problem::words::quote;

pub(super) const FORMAT: Format = Format {
    name: "cvat",
    title: "CVAT XML",
    items: "objects",
    form: FormatReader::Head(is_cvat, read),
};

fn is_cvat(head: &str) -> bool {
    root(head) == Some("annotations")
}

fn read(source: SourceText<'_>, out: &mut Collector) -> Result<usize, Bad> {
    let mut tags = Tags::new(source);
    // Whether the item is wanted: of the loose shapes of the image, known at the first, and of a
    // skeleton.
    let (mut skeletons, mut loose, mut skeleton) = (0_usize, None, None);
    let (mut image, mut names) = (String::new(), ImageNames::default());
    while let Some(tag) = tags.next_tag()? {
        match (tag.name, tag.is_end) {
            ("track", false) => {
                let detail = "expected `CVAT for images`; found a track of a video: export the \
                    task as `CVAT for images 1.1`";
                return Err(Bad::new(tag.at, detail));
            }
            ("image", false) => {
                let [name] = tag.required(["name"])?;
                (image, skeletons, loose) = (name.unescaped()?.into_owned(), 0, None);
                names = ImageNames::new(&image, out.items());
            }
            ("skeleton", false) => {
                let part = skeletons.to_string();
                skeleton = Some(out.item_of(tag.at, names, (&image, &part))?);
                skeletons += 1;
            }
            ("skeleton", true) => skeleton = None,
            ("points" | "polyline" | "polygon", false) => {
                let is_wanted = match (skeleton, loose) {
                    (Some(is_wanted), _) | (None, Some(is_wanted)) => is_wanted,
                    (None, None) => *loose.insert(out.item_of(tag.at, names, (&image, ""))?),
                };
                if is_wanted {
                    shape(&tag, skeleton.is_some(), out)?;
                }
            }
            _ => {}
        }
    }
    Ok(source.text.len())
}

fn shape(tag: &Tag<'_>, is_of_skeleton: bool, out: &mut Collector) -> Result<(), Bad> {
    let ([label, points], [outside]) = (
        tag.required(["label", "points"])?,
        tag.attributes(["outside"])?,
    );
    let text = label.unescaped()?;
    if is_of_skeleton && outside.is_some_and(|outside| outside.text.trim() == "1") {
        return out.point(
            tag.at,
            None,
            Some(Located {
                at: label.at,
                text: &text,
            }),
        );
    }
    let positions = points.text.split(';');
    let count = positions.clone().count();
    let mut places = positions.map(|place| position(points, place));
    if tag.name == "points" {
        return places.enumerate().try_for_each(|(k, place)| {
            let name = if count == 1 {
                text.to_string()
            } else {
                format!("{text} {k}")
            };
            out.point(
                points.at,
                Some(place?),
                Some(Located {
                    at: label.at,
                    text: &name,
                }),
            )
        });
    }
    if count < 2 {
        return Err(Bad::new(
            points.at,
            format!(
                "expected at least 2 positions in a {}; found {}",
                tag.name,
                quote(points.text)
            ),
        ));
    }
    out.count(tag.at, count + usize::from(tag.name == "polygon"))?;
    let mut line = Vec::with_capacity(count + 1);
    places.try_for_each(|place| {
        let [x, y] = place?;
        line.push(Point::new(x, y));
        Ok::<_, Bad>(())
    })?;
    if tag.name == "polygon" && line.first() != line.last() {
        line.extend(line.first().copied());
    }
    out.push(Landmark {
        at: tag.at,
        p: Handle::Polyline(line),
        q: None,
        name: Some(Located {
            at: label.at,
            text: &text,
        }),
    })
}

/// A position in a list of them, `x,y`.
fn position(list: Located<'_>, place: &str) -> Result<[f64; 2], Bad> {
    let at = |part: &str| list.at + (part.as_ptr().addr() - list.text.as_ptr().addr());
    let (x, y) = place.split_once(',').ok_or_else(|| {
        Bad::new(
            at(place),
            format!("expected a position, x,y; found {}", quote(place)),
        )
    })?;
    let number = |text: &str| Located { at: at(text), text }.number();
    Ok([number(x)?, number(y)?])
}
