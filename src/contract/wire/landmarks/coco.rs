//! COCO keypoints, JSON:
//! `{"images", "annotations": [{"image_id", "category_id", "keypoints": [x, y, v, ...]}],
//! "categories"}`,
//! and lists of results, which are annotations alone. An annotation with a keypoint that is
//! labelled is an item, named by the file of its image; the names of the keypoints are those of its
//! category. Where v is 0, a keypoint is missing.
//!
//! Sources: COCO, "Data format" ("each keypoint has a 0-indexed location x,y and a visibility flag
//! v"); detectron2, `detectron2/data/datasets/coco.py`, which takes them for indices of pixels,
//! too. 1/2 is added.

use std::collections::HashMap;

use super::bad::{Bad, BadJson};
use super::collect::{Collector, Located};
use super::item::{ImageNames, Items, name_in};
use super::json::ObjectMembers;
use super::own::read_names;
use super::{Format, FormatReader, offset};
use crate::problem::Problem;
use crate::wire::json::{At, Kind, Node, optional};
use crate::wire::number::number;

pub(super) const FORMAT: Format = Format {
    name: "coco",
    title: "COCO keypoints",
    items: "annotations",
    form: FormatReader::Json(is_coco, read),
};
const CENTRE: f64 = 0.5;
const ANNOTATIONS: &str = "an array of annotations";
const KEYPOINTS: &str = "an array of numbers, x, y and v of each keypoint";
/// The most images: their names are in memory together.
const MOST_IMAGES: usize = 1 << 16;

fn is_coco(fields: &ObjectMembers<'_>) -> bool {
    if fields.is_list {
        fields.has("keypoints")
    } else {
        fields.has("annotations") && (fields.has("images") || fields.has("categories"))
    }
}

fn read(text: &str, root: &Node<'_, '_>, out: &mut Collector) -> Result<usize, BadJson> {
    if root.kind() == Kind::Array {
        return people(text, root, [None, None], out);
    }
    let [images, annotations, categories] = root.find(&["images", "annotations", "categories"])?;
    people(
        text,
        &annotations.ok_or_else(|| root.missing("annotations", ANNOTATIONS))?,
        [images, categories],
        out,
    )
}

fn people(
    text: &str,
    list: &Node<'_, '_>,
    [images, categories]: [Option<Node<'_, '_>>; 2],
    out: &mut Collector,
) -> Result<usize, BadJson> {
    let files = images
        .map(|images| files(text, &images, out.items()))
        .transpose()?
        .unwrap_or_default();
    list.items::<BadJson>(ANNOTATIONS, |_, person| {
        let at = offset(text, &person);
        let [keypoints, image, id, category] =
            person.find(&["keypoints", "image_id", "id", "category_id"])?;
        // Others are boxes and outlines.
        let Some(keypoints) = keypoints else {
            return Ok(());
        };
        let (count, labelled) = count(text, &keypoints)?;
        if labelled == 0 {
            return Ok(());
        }
        let (file, names) = match image {
            None => (None, Some(ImageNames::new("", out.items()))),
            Some(image) => match files.get(image.text) {
                Some((file, names)) => (Some(Node::new(file, At::Root)), *names),
                None => (Some(image), names_of(&image, out.items())),
            },
        };
        // Many annotations may have one image with a long name.
        let file = file.filter(|_| names.is_none() || out.items().may_name_next());
        let file = optional(file, name_in)?.unwrap_or_default();
        let part = optional(id, name_in)?.unwrap_or_default();
        if !out.item_of(at, names.unwrap_or_default(), (&file, &part))? {
            return Ok(());
        }
        out.require_below(offset(text, &keypoints), count)?;
        let labels = match (categories, category) {
            (Some(categories), Some(category)) => labels(text, &categories, category.text, count)?,
            _ => Vec::new(),
        };
        let (mut values, mut k) = ([0.0; 3], 0);
        keypoints.items::<BadJson>(KEYPOINTS, |index, value| {
            values[index % 3] = number(&value, "a number")?;
            if index % 3 == 2 {
                let [x, y, v] = values;
                let name = labels.get(k).map(|(at, name)| Located {
                    at: *at,
                    text: name,
                });
                out.point(
                    offset(text, &value),
                    (v > 0.0).then_some([x + CENTRE, y + CENTRE]),
                    name,
                )?;
                k += 1;
            }
            Ok(())
        })
    })?;
    Ok(offset(text, list))
}

/// The number of keypoints, and of those that are labelled.
fn count(text: &str, keypoints: &Node<'_, '_>) -> Result<(usize, usize), BadJson> {
    let (mut numbers, mut labelled) = (0, 0);
    keypoints.items::<Problem>(KEYPOINTS, |index, value| {
        numbers += 1;
        labelled += usize::from(index % 3 == 2 && number(&value, "a number")? > 0.0);
        Ok(())
    })?;
    if numbers % 3 != 0 {
        return Err(Bad::new(
            offset(text, keypoints),
            format!("expected {KEYPOINTS}; found {numbers} numbers"),
        )
        .into());
    }
    Ok((numbers / 3, labelled))
}

/// The names of the items of an image; `None` if the name of its file cannot be read, which is an
/// error where an item has it.
fn names_of(file: &Node<'_, '_>, items: &Items) -> Option<ImageNames> {
    let file = name_in(file).ok()?;
    Some(ImageNames::new(&file, items))
}

/// The names of files as they are written, and those of their items, by the ids of images.
type ImageFiles<'j> = HashMap<&'j str, (&'j str, Option<ImageNames>)>;

fn files<'j>(text: &str, images: &Node<'j, '_>, items: &Items) -> Result<ImageFiles<'j>, BadJson> {
    let mut files = HashMap::new();
    images.items::<BadJson>("an array of images", |index, image| {
        if index == MOST_IMAGES {
            let detail = format!(
                "expected at most {MOST_IMAGES} images; found more: send the \
                part of the file with the wanted ones"
            );
            return Err(Bad::new(offset(text, &image), detail).into());
        }
        if let [Some(id), Some(file)] = image.find(&["id", "file_name"])? {
            files.insert(id.text, (file.text, names_of(&file, items)));
        }
        Ok(())
    })?;
    Ok(files)
}

/// The names of the keypoints of a category.
fn labels(
    text: &str,
    categories: &Node<'_, '_>,
    wanted: &str,
    count: usize,
) -> Result<Vec<(usize, String)>, BadJson> {
    let mut labels = Vec::new();
    categories.items::<BadJson>("an array of categories", |_, category| {
        let [id, keypoints] = category.find(&["id", "keypoints"])?;
        if let (Some(id), Some(keypoints)) = (id, keypoints)
            && id.text == wanted
        {
            labels = read_names(text, &keypoints, count)?;
        }
        Ok(())
    })?;
    Ok(labels)
}
