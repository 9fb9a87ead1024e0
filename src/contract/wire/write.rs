//! Values to JSON in the form in which they are read. f64 is written with the fewest digits that
//! read back to the same bits. Defaults are written, so that a client sees them; an option without
//! a default is left out.

use mlswarp::deform::{Coincident, Conflict, Handle, METHODS, Parameters};
use mlswarp::geometry::Point;
use mlswarp::render::{Canvas, Outside};
use mlswarp::warp::{CanvasSpec, GridSpec, OutputSpec};
use serde::ser::{Serialize, SerializeMap, Serializer};

use super::AsJson;

impl Serialize for AsJson<&Handle> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        match self.0 {
            Handle::Point(place) => [place.x, place.y].serialize(s),
            Handle::Polyline(places) => AsJson(places.as_slice()).serialize(s),
            Handle::Missing => s.serialize_unit(),
        }
    }
}

impl Serialize for AsJson<&[Point]> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.collect_seq(self.0.iter().map(|place| [place.x, place.y]))
    }
}

impl Serialize for AsJson<&[Handle]> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.collect_seq(self.0.iter().map(AsJson))
    }
}

/// The objects of methods with the parameters in them, as fields of an object.
///
/// # Errors
/// Those of the serializer.
pub fn serialize_own<M: SerializeMap>(object: &mut M, own: Parameters) -> Result<(), M::Error> {
    for info in METHODS.iter().filter(|info| info.has_object) {
        let values = info.parameters.iter().filter_map(|parameter| {
            let value = own.get(parameter.path)?;
            Some((parameter.name(), value))
        });
        let values: Vec<_> = values.collect();
        if !values.is_empty() {
            object.serialize_entry(info.name, &Named(&values))?;
        }
    }
    Ok(())
}

struct Named<'a>(&'a [(&'static str, f64)]);

impl Serialize for Named<'_> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.collect_map(self.0.iter().copied())
    }
}

impl Serialize for AsJson<Parameters> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let mut object = s.serialize_map(None)?;
        serialize_own(&mut object, self.0)?;
        object.end()
    }
}

impl Serialize for AsJson<GridSpec> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        match self.0 {
            GridSpec::Auto => s.serialize_str("auto"),
            GridSpec::Tolerance(tolerance) => s.collect_map([("tolerance", tolerance)]),
            GridSpec::Pixel => s.serialize_str("pixel"),
            GridSpec::Cell(cell) => s.collect_map([("cell", cell)]),
            GridSpec::Counts { columns, rows } => {
                s.collect_map([("columns", columns), ("rows", rows)])
            }
        }
    }
}

impl Serialize for AsJson<Coincident> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let mut object = s.serialize_map(None)?;
        object.serialize_entry("policy", &AsJson(self.0.policy))?;
        object.serialize_entry("within", &self.0.within)?;
        object.end()
    }
}

impl Serialize for AsJson<&Conflict> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let Conflict {
            handles,
            position,
            spread,
            ..
        } = self.0;
        let mut object = s.serialize_map(None)?;
        object.serialize_entry("handles", handles)?;
        object.serialize_entry("position", &[position.x, position.y])?;
        object.serialize_entry("spread", spread)?;
        object.end()
    }
}

impl Serialize for AsJson<&[Conflict]> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.collect_seq(self.0.iter().map(AsJson))
    }
}

impl Serialize for AsJson<Canvas> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let Canvas { x, y, extent } = self.0;
        s.collect_map([
            ("x", i64::from(x)),
            ("y", i64::from(y)),
            ("width", extent.width().into()),
            ("height", extent.height().into()),
        ])
    }
}

impl Serialize for AsJson<CanvasSpec> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        match self.0 {
            CanvasSpec::Same => s.serialize_str("same"),
            CanvasSpec::Fit => s.serialize_str("fit"),
            CanvasSpec::Box(canvas) => AsJson(canvas).serialize(s),
        }
    }
}

impl Serialize for AsJson<Outside> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        match self.0 {
            Outside::Transparent => s.serialize_str("transparent"),
            Outside::Edge => s.serialize_str("edge"),
            Outside::Reflect => s.serialize_str("reflect"),
            Outside::Colour([r, g, b, a]) => {
                s.collect_str(&format_args!("#{r:02x}{g:02x}{b:02x}{a:02x}"))
            }
            Outside::Value([r, g, b]) if r == g && g == b => s.collect_map([("value", r)]),
            Outside::Value(value) => s.collect_map([("value", value)]),
        }
    }
}

impl Serialize for AsJson<&OutputSpec> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let OutputSpec {
            format,
            quality,
            subsampling,
            compression,
            canvas,
            width,
            filter,
            outside,
            holes,
        } = *self.0;
        let mut object = s.serialize_map(None)?;
        object.serialize_entry("format", &AsJson(format))?;
        object.serialize_entry("quality", &quality)?;
        if let Some(subsampling) = subsampling {
            object.serialize_entry("subsampling", &AsJson(subsampling))?;
        }
        object.serialize_entry("compression", &AsJson(compression))?;
        if let Some(width) = width {
            object.serialize_entry("width", &width)?;
        }
        object.serialize_entry("filter", &AsJson(filter))?;
        object.serialize_entry("outside", &AsJson(outside))?;
        object.serialize_entry("canvas", &AsJson(canvas))?;
        object.serialize_entry("holes", &AsJson(holes))?;
        object.end()
    }
}
