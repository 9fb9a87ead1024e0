//! Values to JSON in the form in which they are read: what is written parses to an equal value. f64 is written with the fewest digits
//! that read back to the same bits. Defaults are written out, so that a client sees what was assumed; what has no default is left out.

use mlswarp::codec::{Compression, Format};
use mlswarp::deform::{Handle, Method};
use mlswarp::geometry::Point;
use mlswarp::render::{Filter, Outside};
use mlswarp::warp::{Folds, GridSpec, OutputSpec, Units};
use serde::ser::{Serialize, SerializeMap, SerializeSeq, Serializer};

use super::enum_name::{Canvas, EnumName};

/// A value in its wire form: `AsJson(&spec)` serialises as a client would write it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AsJson<T>(pub T);

macro_rules! words_are_strings {
    ($($type:ty),+) => {
        $(impl Serialize for AsJson<$type> {
            fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
                s.serialize_str(self.0.word())
            }
        })+
    };
}

words_are_strings!(Method, Units, Folds, Format, Compression, Filter);

impl Serialize for AsJson<Point> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        [self.0.x, self.0.y].serialize(s)
    }
}

impl Serialize for AsJson<&[Point]> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let mut array = s.serialize_seq(Some(self.0.len()))?;
        self.0.iter().try_for_each(|place| array.serialize_element(&AsJson(*place)))?;
        array.end()
    }
}

impl Serialize for AsJson<&Handle> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        match self.0 {
            Handle::Point(place) => AsJson(*place).serialize(s),
            Handle::Polyline(places) => AsJson(places.as_slice()).serialize(s),
        }
    }
}

impl Serialize for AsJson<&[Handle]> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let mut array = s.serialize_seq(Some(self.0.len()))?;
        self.0.iter().try_for_each(|handle| array.serialize_element(&AsJson(handle)))?;
        array.end()
    }
}

impl Serialize for AsJson<GridSpec> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        match self.0 {
            GridSpec::Auto => s.serialize_str("auto"),
            GridSpec::Pixel => s.serialize_str("pixel"),
            GridSpec::Cell(cell) => {
                let mut object = s.serialize_map(Some(1))?;
                object.serialize_entry("cell", &cell)?;
                object.end()
            }
            GridSpec::Counts { columns, rows } => {
                let mut object = s.serialize_map(Some(2))?;
                object.serialize_entry("columns", &columns)?;
                object.serialize_entry("rows", &rows)?;
                object.end()
            }
        }
    }
}

impl Serialize for AsJson<Outside> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        match self.0 {
            Outside::Transparent => s.serialize_str("transparent"),
            Outside::Edge => s.serialize_str("edge"),
            Outside::Colour([r, g, b, a]) => s.collect_str(&format_args!("#{r:02x}{g:02x}{b:02x}{a:02x}")),
        }
    }
}

impl Serialize for AsJson<&OutputSpec> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let OutputSpec { format, quality, compression, width, filter, outside } = *self.0;
        let mut object = s.serialize_map(None)?;
        object.serialize_entry("format", &AsJson(format))?;
        object.serialize_entry("quality", &quality)?;
        object.serialize_entry("compression", &AsJson(compression))?;
        if let Some(width) = width {
            object.serialize_entry("width", &width)?;
        }
        object.serialize_entry("filter", &AsJson(filter))?;
        object.serialize_entry("outside", &AsJson(outside))?;
        object.serialize_entry("canvas", Canvas::Same.word())?;
        object.end()
    }
}
