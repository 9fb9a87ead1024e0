//! Values that are words of the contract: which this build has, which the contract has and this build has not, and how each is spelled.
//! One table for reading, for writing, and for the enums of the OpenAPI document (tested).

use mlswarp::codec::{Compression, Format};
use mlswarp::deform::Method;
use mlswarp::render::Filter;
use mlswarp::warp::{Folds, Units};

use super::json::{Kind, Node, list, quote};
use crate::problem::{Code, Problem};

/// An enum whose values are words.
pub(crate) trait EnumName: Copy + 'static {
    /// What this build has; the default first.
    const ALL: &'static [Self];
    /// What the contract has and this build has not.
    const LATER: &'static [&'static str];
    /// The word.
    fn word(self) -> &'static str;
}

/// Reads a word; one that is in the contract but not in this build is `not_supported`.
pub(crate) fn word<T: EnumName>(node: &Node<'_, '_>) -> Result<T, Problem> {
    let names = || list(&T::ALL.iter().map(|v| v.word()).collect::<Vec<_>>());
    if node.kind() != Kind::String {
        return Err(node.wrong_kind(&format!("one of {}", names())));
    }
    let text = node.string("a word")?;
    match T::ALL.iter().find(|v| v.word() == text) {
        Some(value) => Ok(*value),
        None => Err(refuse(node, &text, T::LATER, &names())),
    }
}

/// The problem of a word that is none of the `supported` ones.
pub(crate) fn refuse(node: &Node<'_, '_>, text: &str, later: &[&str], supported: &str) -> Problem {
    if later.contains(&text) {
        node.problem(Code::NotSupported, format!("not supported by this version: `{text}`; supported: {supported}"))
    } else {
        node.problem(Code::BadValue, format!("expected one of {supported}; found {}", quote(text)))
    }
}

macro_rules! words {
    ($type:ty, later $later:expr, $($value:path = $word:literal),+) => {
        impl EnumName for $type {
            const ALL: &'static [Self] = &[$($value),+];
            const LATER: &'static [&'static str] = &$later;

            fn word(self) -> &'static str {
                match self { $($value => $word),+ }
            }
        }
    };
}

/// Distances between places: along straight lines.
#[derive(Clone, Copy)]
pub(crate) enum Metric {
    Euclidean,
}

/// The rectangle that the answer shows: the source's.
#[derive(Clone, Copy)]
pub(crate) enum Canvas {
    Same,
}

words!(Method, later ["tps", "beier_neely", "arap"], Method::Rigid = "rigid", Method::Similarity = "similarity", Method::Affine = "affine");
words!(Units, later [], Units::Px = "px", Units::Normalized = "normalized");
words!(Folds, later["remove"], Folds::Report = "report", Folds::Reject = "reject");
words!(Compression, later [], Compression::Fast = "fast", Compression::None = "none", Compression::Best = "best");
words!(Filter, later["bicubic"], Filter::Bilinear = "bilinear", Filter::Nearest = "nearest");
words!(Metric, later["geodesic"], Metric::Euclidean = "euclidean");
words!(Format, later [], Format::Png = "png", Format::Jpeg = "jpeg", Format::WebP = "webp");
words!(Canvas, later["fit"], Canvas::Same = "same");
