//! Landmarks of dlib's imglab, XML:
//! `<dataset><images><image file='...'><box ...><part name='0' x='...' y='...'/></box>
//! </image></images>`.
//! A box with parts is an item, named by the file of its image; the name of a part is the name of
//! its landmark.
//!
//! Source: dlib, `dlib/data_io/image_dataset_metadata.cpp`. Parts are `dlib::point`, indices of
//! pixels from 0: 1/2 is added.

use super::bad::Bad;
use super::collect::Collector;
use super::item::ImageNames;
use super::xml::{Tags, root};
use super::{Format, FormatReader, SourceText};

pub(super) const FORMAT: Format = Format {
    name: "dlib",
    title: "dlib XML",
    items: "boxes",
    form: FormatReader::Head(is_dlib, read),
};
const CENTRE: f64 = 0.5;

fn is_dlib(head: &str) -> bool {
    root(head) == Some("dataset")
}

/// The box whose parts are read.
struct DlibBox {
    at: usize,
    /// Among those of its image.
    index: usize,
    /// Known at its first part: a box without parts is no item.
    is_wanted: Option<bool>,
}

fn read(source: SourceText<'_>, out: &mut Collector) -> Result<usize, Bad> {
    let mut tags = Tags::new(source);
    let (mut image, mut names) = (String::new(), ImageNames::default());
    let (mut boxes, mut object) = (0, None::<DlibBox>);
    while let Some(tag) = tags.next_tag()? {
        match (tag.name, tag.is_end) {
            ("image", false) => {
                let [file] = tag.required(["file"])?;
                (image, boxes) = (file.unescaped()?.into_owned(), 0);
                names = ImageNames::new(&image, out.items());
            }
            ("box", false) => {
                object = Some(DlibBox {
                    at: tag.at,
                    index: boxes,
                    is_wanted: None,
                });
                boxes += 1;
            }
            ("box", true) => object = None,
            ("part", false) => {
                let Some(object) = &mut object else {
                    return Err(Bad::new(
                        tag.at,
                        "expected <part> in a <box>; found it elsewhere",
                    ));
                };
                if object.is_wanted.is_none() {
                    let part = object.index.to_string();
                    object.is_wanted = Some(out.item_of(object.at, names, (&image, &part))?);
                }
                if object.is_wanted == Some(true) {
                    let [name, x, y] = tag.required(["name", "x", "y"])?;
                    let text = name.unescaped()?;
                    let name = super::collect::Located {
                        at: name.at,
                        text: &text,
                    };
                    out.point(
                        tag.at,
                        Some([x.number()? + CENTRE, y.number()? + CENTRE]),
                        Some(name),
                    )?;
                }
            }
            _ => {}
        }
    }
    Ok(source.text.len())
}
