//! The names of enum values: those of this version, and those that only the contract has. One table
//! serves reading, writing and the OpenAPI document (tested).

use mlswarp::deform::{CoincidentPolicy, METHODS};
use mlswarp::format::{Compression, Format, Subsampling};
use mlswarp::render::Filter;
use mlswarp::warp::blend::BlendSpace;
use mlswarp::warp::{Align, Easing, Folds, Holes, MapDirection, Method, Metric, Units};
use serde::{Serialize, Serializer};

use super::AsJson;
use super::json::{Kind, Node};
use super::suggest;
use crate::layer::LayerKind;
use crate::problem::words::{did_you_mean, list, quote};
use crate::problem::{Code, Problem};

/// An enum of the library whose values have names in the contract.
pub trait EnumName: Copy + 'static {
    /// The values of this version; the default first.
    const ALL: &'static [Self];
    /// Names of the contract that this version does not support.
    const UNSUPPORTED: &'static [&'static str];

    /// The name of the value.
    fn as_str(self) -> &'static str;
}

/// Reads a name.
pub(crate) fn enum_name<T: EnumName>(node: &Node<'_, '_>) -> Result<T, Problem> {
    let names = || T::ALL.iter().map(|v| v.as_str()).collect::<Vec<_>>();
    if node.kind() != Kind::String {
        return Err(node.wrong_kind(&format!("one of {}", list(&names()))));
    }
    let text = node.string("a name")?;
    let value = T::ALL.iter().find(|v| v.as_str() == text);
    value
        .copied()
        .ok_or_else(|| unknown_name(node, &text, T::UNSUPPORTED, &names(), &list(&names())))
}

/// The problem of a name that is not `supported`; `names`: the names among what is supported.
pub(crate) fn unknown_name(
    node: &Node<'_, '_>,
    text: &str,
    unsupported: &[&str],
    names: &[&str],
    supported: &str,
) -> Problem {
    if unsupported.contains(&text) {
        node.problem(
            Code::NotSupported,
            format!("not supported by this version: `{text}`; supported: {supported}"),
        )
    } else {
        let hint = did_you_mean(suggest::value(text, names));
        node.unexpected(
            &format!("one of {supported}"),
            format_args!("{}{hint}", quote(text)),
        )
    }
}

macro_rules! enum_names {
    ($type:ty, unsupported $unsupported:expr, $($value:path = $name:literal),+) => {
        impl EnumName for $type {
            const ALL: &'static [Self] = &[$($value),+];
            const UNSUPPORTED: &'static [&'static str] = &$unsupported;

            fn as_str(self) -> &'static str {
                match self { $($value => $name),+ }
            }
        }

        impl Serialize for AsJson<$type> {
            fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
                s.serialize_str(self.0.as_str())
            }
        }
    };
}

/// A method, or that one is to be chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RequestedMethod {
    /// This one.
    Named(Method),
    /// The one that fits best.
    Auto,
}

impl RequestedMethod {
    /// `None` of `auto`.
    pub const fn method(self) -> Option<Method> {
        match self {
            Self::Named(method) => Some(method),
            Self::Auto => None,
        }
    }
}

impl EnumName for Method {
    const ALL: &'static [Self] = &{
        let mut all = [METHODS[0].method; METHODS.len()];
        let mut k = 0;
        while k < all.len() {
            all[k] = METHODS[k].method;
            k += 1;
        }
        all
    };
    const UNSUPPORTED: &'static [&'static str] = &[];

    fn as_str(self) -> &'static str {
        self.info().name
    }
}

impl EnumName for RequestedMethod {
    const ALL: &'static [Self] = &{
        let mut all = [Self::Auto; METHODS.len() + 1];
        let mut k = 0;
        while k < METHODS.len() {
            all[k] = Self::Named(METHODS[k].method);
            k += 1;
        }
        all
    };
    const UNSUPPORTED: &'static [&'static str] = &[];

    fn as_str(self) -> &'static str {
        self.method().map_or("auto", Method::as_str)
    }
}

impl Serialize for AsJson<Method> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.serialize_str(self.0.as_str())
    }
}

/// How the landmarks of two files are matched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Matching {
    /// Those of one name; landmarks that only one file has are left out.
    Name,
    /// The first with the first.
    Order,
}

enum_names!(CoincidentPolicy, unsupported [], CoincidentPolicy::Mean = "mean",
    CoincidentPolicy::Reject = "reject");
enum_names!(Metric, unsupported [], Metric::Euclidean = "euclidean",
    Metric::Geodesic = "geodesic");
enum_names!(Units, unsupported [], Units::Px = "px", Units::Normalized = "normalized");
enum_names!(
    Align, unsupported [],
    Align::None = "none", Align::Rigid = "rigid", Align::Similarity = "similarity",
        Align::Affine = "affine"
);
enum_names!(
    Folds,
    unsupported [],
    Folds::Report = "report",
    Folds::Reject = "reject",
    Folds::Remove = "remove"
);
enum_names!(Holes, unsupported [], Holes::Keep = "keep", Holes::Transparent = "transparent");
enum_names!(Compression, unsupported [], Compression::Fast = "fast", Compression::None = "none",
    Compression::Best = "best");
enum_names!(Subsampling, unsupported [], Subsampling::Half = "4:2:0", Subsampling::Full = "4:4:4");
enum_names!(Filter, unsupported [], Filter::Bilinear = "bilinear", Filter::Nearest = "nearest",
    Filter::Bicubic = "bicubic");
enum_names!(LayerKind, unsupported [], LayerKind::Image = "image", LayerKind::Labels = "labels");
enum_names!(MapDirection, unsupported [], MapDirection::Inverse = "inverse",
    MapDirection::Forward = "forward");
enum_names!(Easing, unsupported [], Easing::Linear = "linear", Easing::EaseInOut = "ease-in-out");
enum_names!(BlendSpace, unsupported [], BlendSpace::Srgb = "srgb",
    BlendSpace::Linear = "linear");
enum_names!(Matching, unsupported [], Matching::Name = "name", Matching::Order = "order");

/// Without the format of animations, which is requested by `Accept`.
impl EnumName for Format {
    const ALL: &'static [Self] = &Self::ALL;
    const UNSUPPORTED: &'static [&'static str] = &[];

    fn as_str(self) -> &'static str {
        self.info().word
    }
}

impl Serialize for AsJson<Format> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.serialize_str(self.0.as_str())
    }
}
