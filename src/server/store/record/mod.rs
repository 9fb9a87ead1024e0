//! The stored form of a record: a checksum and a JSON object. Floating-point numbers are restored
//! exactly.
//!
//! Programs of several versions use one store, during a rolling update and after a rollback. Four
//! rules keep their sessions safe:
//!
//! 1. A field at its default is left out of the record and of the digest `made`. The defaults are
//!    those of the stored form (`base`) and never change; those of the HTTP contract may.
//! 2. One exception: the fields of the first version are always in the digest `made`. So every
//!    version computes the same digest of the same request, and a repeated `PUT` is one session
//!    whichever replica it reaches. A later field is in the digest only if it is not at its
//!    default: then the older program cannot read the record anyway.
//! 3. A record with a correct checksum that this program cannot read in full (another version, an
//!    unknown field or value) was written by another version. It is kept: not served, not replaced,
//!    and deleted only by its owner.
//! 4. In every version a record names each file that it needs by the 64 lower-case hexadecimal
//!    digits of its digest. A program that cannot read the rest keeps the files named like this
//!    (`named_files`), and the Redis store removes no layer's file that is, unless only the fields
//!    `image` and `made_with_region` name it.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use data_encoding::HEXLOWER;
use mlswarp::codec::{Compression, Format};
use mlswarp::deform::{Coincident, CoincidentPolicy, Parameters};
use mlswarp::pixmap::Extent;
use mlswarp::render::{Filter, Outside};
use mlswarp::warp::{
    Align, CanvasSpec, Digest, Folds, GridSpec, Holes, Method, Metric, OutputSpec, RestSpec, Units,
};
use serde::ser::{Serialize, SerializeMap, Serializer};
use serde::{Deserialize, Serialize as Derived};
use serde_json::value::RawValue;

use super::{Record, StoredLayer};
use crate::layer::{LayerKind, LayerName, MAX_LAYERS};
use crate::session::{Revision, SessionId};
use crate::wire::{AsJson, EnumName as _, Pose, Reserved, WarpObject, WarpPatch, serialize_own};

/// The version of the form. It changes when older programs would misunderstand a record.
const RECORD_VERSION: u32 = 1;
/// Bytes of the checksum: eight hexadecimal digits and a line break.
const CHECKSUM_BYTES: usize = 9;

/// Why a record cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unreadable {
    /// No program has written these bytes.
    #[error("{0}")]
    Damaged(&'static str),
    /// Another version of the program has written it.
    #[error("{0}")]
    OtherVersion(String),
}

/// The defaults of the stored form. They never change.
fn base() -> WarpObject {
    WarpObject {
        rest: RestSpec {
            p: Vec::new(),
            weights: None,
            depth: None,
            method: Method::Rigid,
            alpha: None,
            point_mass: None,
            smoothing: None,
            own: Parameters::default(),
            metric: Metric::Euclidean,
            mask_threshold: None,
            mask: None,
            coincident: Coincident {
                policy: CoincidentPolicy::Mean,
                within: 0.0,
            },
            units: Units::Px,
            grid: GridSpec::Auto,
            align: Align::None,
            has_unmatched: false,
        },
        q: None,
        folds: Folds::Report,
        output: OutputSpec {
            format: Format::Png,
            quality: 90,
            subsampling: None,
            compression: Compression::Fast,
            canvas: CanvasSpec::Same,
            width: None,
            filter: Filter::Bilinear,
            outside: Outside::Transparent,
            holes: Holes::Keep,
        },
        strength: 1.0,
        is_auto: false,
    }
}

/// What happens to fields of the first version that are at their defaults.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Defaults {
    /// Written, as in the digest.
    Written,
    /// Left out, as in the record.
    LeftOut,
}

impl Defaults {
    fn field<M: SerializeMap, T: PartialEq>(
        self,
        object: &mut M,
        name: &'static str,
        value: T,
        default: &T,
    ) -> Result<(), M::Error>
    where
        AsJson<T>: Serialize,
    {
        if self == Self::LeftOut && value == *default {
            Ok(())
        } else {
            object.serialize_entry(name, &AsJson(value))
        }
    }
}

/// The warp object of a record. The order of the fields is a part of the digest.
struct Warp<'a>(&'a Record, Defaults);

impl Serialize for Warp<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let (base, &Self(record, defaults)) = (base(), self);
        let RestSpec {
            p,
            weights,
            depth,
            method,
            alpha,
            point_mass,
            smoothing,
            own,
            metric,
            mask_threshold,
            // It is made from files that the record names.
            mask: _,
            coincident,
            units,
            grid,
            align,
            has_unmatched: _,
        } = &*record.rest;
        let mut object = serializer.serialize_map(None)?;
        defaults.field(&mut object, "p", p.as_slice(), &base.rest.p.as_slice())?;
        if let Some(weights) = weights {
            object.serialize_entry("weights", weights)?;
        }
        defaults.field(&mut object, "method", *method, &base.rest.method)?;
        if let Some(alpha) = alpha {
            object.serialize_entry("alpha", alpha)?;
        }
        if let Some(mass) = point_mass {
            object.serialize_entry("point_mass", mass)?;
        }
        if let Some(smoothing) = smoothing {
            object.serialize_entry("smoothing", smoothing)?;
        }
        defaults.field(&mut object, "units", *units, &base.rest.units)?;
        defaults.field(&mut object, "grid", *grid, &base.rest.grid)?;
        defaults.field(&mut object, "folds", record.folds, &base.folds)?;
        defaults.field(&mut object, "metric", *metric, &base.rest.metric)?;
        if defaults == Defaults::Written || record.output != base.output {
            object.serialize_entry("output", &Output(&record.output, defaults))?;
        }
        // Later fields (rule 2).
        Defaults::LeftOut.field(
            &mut object,
            "coincident",
            *coincident,
            &base.rest.coincident,
        )?;
        Defaults::LeftOut.field(&mut object, "align", *align, &base.rest.align)?;
        serialize_own(&mut object, *own)?;
        if let Some(threshold) = mask_threshold {
            object.serialize_entry("mask", &BTreeMap::from([("threshold", threshold)]))?;
        }
        if let Some(depth) = depth {
            object.serialize_entry("depth", depth)?;
        }
        if let Some(Pose { q, strength }) = record.pose.as_deref() {
            object.serialize_entry("q", &AsJson(q.as_slice()))?;
            if strength.to_bits() != base.strength.to_bits() {
                object.serialize_entry("strength", strength)?;
            }
        }
        object.end()
    }
}

struct Output<'a>(&'a OutputSpec, Defaults);

impl Serialize for Output<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let (base, &Self(output, defaults)) = (base().output, self);
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
        } = *output;
        let mut object = serializer.serialize_map(None)?;
        defaults.field(&mut object, "format", format, &base.format)?;
        if defaults == Defaults::Written || quality != base.quality {
            object.serialize_entry("quality", &quality)?;
        }
        if let Some(subsampling) = subsampling {
            object.serialize_entry("subsampling", &AsJson(subsampling))?;
        }
        defaults.field(&mut object, "compression", compression, &base.compression)?;
        if let Some(width) = width {
            object.serialize_entry("width", &width)?;
        }
        defaults.field(&mut object, "filter", filter, &base.filter)?;
        defaults.field(&mut object, "outside", outside, &base.outside)?;
        defaults.field(&mut object, "canvas", canvas, &base.canvas)?;
        // A later field.
        Defaults::LeftOut.field(&mut object, "holes", holes, &base.holes)?;
        object.end()
    }
}

/// The version, which is read first.
#[derive(Deserialize)]
struct Version {
    version: u32,
}

/// The JSON object. `W` is the warp object, or its text.
#[derive(Derived, Deserialize)]
#[serde(deny_unknown_fields)]
struct Document<W> {
    version: u32,
    id: String,
    revision: String,
    image: String,
    width: u32,
    height: u32,
    /// Nanoseconds since 1970.
    created: u64,
    /// Later fields (rule 1).
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    layers: BTreeMap<String, LayerRecord>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    made_with_region: Option<String>,
    /// Whether the rest handles lack landmarks that one side has.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    has_unmatched: bool,
    warp: W,
}

#[derive(Derived, Deserialize)]
#[serde(deny_unknown_fields)]
struct LayerRecord {
    kind: String,
    file: String,
}

impl LayerRecord {
    fn write((name, layer): (&LayerName, &StoredLayer)) -> (String, Self) {
        (
            name.to_string(),
            Self {
                kind: layer.kind.as_str().to_owned(),
                file: layer.digest.to_string(),
            },
        )
    }

    fn read((name, layer): (String, Self)) -> Option<(LayerName, StoredLayer)> {
        let kind = LayerKind::ALL
            .iter()
            .find(|kind| kind.as_str() == layer.kind)?;
        Some((
            LayerName::parse(&name)?,
            StoredLayer {
                kind: *kind,
                digest: Digest(unhex(&layer.file)?),
            },
        ))
    }
}

/// Writes a record.
pub fn write(record: &Record) -> Vec<u8> {
    let created = record
        .created
        .duration_since(SystemTime::UNIX_EPOCH)
        .unwrap_or_default();
    let document = Document {
        version: RECORD_VERSION,
        id: HEXLOWER.encode(&record.id.to_bytes()),
        revision: HEXLOWER.encode(record.revision.as_bytes()),
        image: record.image.to_string(),
        width: record.extent.width(),
        height: record.extent.height(),
        created: u64::try_from(created.as_nanos()).unwrap_or(u64::MAX),
        layers: record.layers.iter().map(LayerRecord::write).collect(),
        made_with_region: record.made_with_region.map(|digest| digest.to_string()),
        has_unmatched: record.rest.has_unmatched,
        warp: Warp(record, Defaults::LeftOut),
    };
    sealed(&serde_json::to_vec(&document).expect("an object of numbers and words"))
}

/// Prefixes JSON with its checksum.
pub(crate) fn sealed(json: &[u8]) -> Vec<u8> {
    let mut bytes = format!("{:08x}\n", crc32fast::hash(json)).into_bytes();
    bytes.extend_from_slice(json);
    bytes
}

/// Reads a record.
/// Errors: the bytes are damaged, or another version of the program wrote them.
pub fn read(bytes: &[u8]) -> Result<Arc<Record>, Unreadable> {
    let (sum, json) = bytes
        .split_at_checked(CHECKSUM_BYTES)
        .ok_or(Unreadable::Damaged("it is too short"))?;
    if sum != format!("{:08x}\n", crc32fast::hash(json)).as_bytes() {
        return Err(Unreadable::Damaged("its checksum is another"));
    }
    // The checksum is right: another version has written what cannot be read from here on.
    let other = |why: &str| Unreadable::OtherVersion(why.to_owned());
    let Version { version } = serde_json::from_slice(json).map_err(|e| other(&e.to_string()))?;
    if version != RECORD_VERSION {
        return Err(Unreadable::OtherVersion(format!(
            "its form is version {version}; this program knows {RECORD_VERSION}"
        )));
    }
    let read: Document<&RawValue> =
        serde_json::from_slice(json).map_err(|e| other(&e.to_string()))?;
    // The store counts records by itself.
    let patch = Reserved::<WarpPatch, _>::parse(read.warp.get().as_bytes(), |_| Ok(()));
    let (patch, ()) = patch
        .map_err(|problem| Unreadable::OtherVersion(problem.detail))?
        .into_parts();
    let warp = patch.merge_onto(base());
    if warp.q.is_none() && warp.strength.to_bits() != base().strength.to_bits() {
        return Err(other("it has a strength without posed handles"));
    }
    if warp.is_auto {
        return Err(other("its method is not chosen"));
    }
    let layers = read
        .layers
        .into_iter()
        .map(LayerRecord::read)
        .collect::<Option<BTreeMap<_, _>>>();
    let layers = layers
        .filter(|layers| layers.len() <= MAX_LAYERS)
        .ok_or_else(|| other("its layers are in another form"))?;
    let region = read.made_with_region.map(|digest| {
        unhex(&digest)
            .map(Digest)
            .ok_or_else(|| other("its mask's digest is in another form"))
    });
    Ok(Arc::new(Record {
        id: SessionId::from_bytes(
            &unhex(&read.id).ok_or_else(|| other("its name is in another form"))?,
        ),
        revision: Revision::from_bytes(
            unhex(&read.revision).ok_or_else(|| other("its revision is in another form"))?,
        ),
        image: Digest(
            unhex(&read.image).ok_or_else(|| other("its picture's digest is in another form"))?,
        ),
        layers,
        made_with_region: region.transpose()?,
        extent: Extent::new(read.width, read.height)
            .ok_or_else(|| other("its picture has no size"))?,
        rest: RestSpec {
            has_unmatched: read.has_unmatched,
            ..warp.rest
        }
        .into(),
        pose: warp.q.map(|q| {
            let strength = warp.strength;
            Pose { q, strength }.into()
        }),
        folds: warp.folds,
        output: warp.output,
        created: SystemTime::UNIX_EPOCH + Duration::from_nanos(read.created),
    }))
}

/// The file digests that a record of any version may name (rule 4). A session's name looks the same
/// and is among them.
pub(crate) fn named_files(bytes: &[u8]) -> Vec<Digest> {
    let words = bytes.split(|byte| !matches!(byte, b'0'..=b'9' | b'a'..=b'f'));
    let mut named: Vec<Digest> = words
        .filter_map(|word| std::str::from_utf8(word).ok().and_then(unhex).map(Digest))
        .collect();
    named.sort_unstable_by_key(|digest| digest.0);
    named.dedup();
    named
}

/// The digest of what a session was made from, the same in every version of the program (rule 2).
/// Layers that were added since are not in it.
pub(crate) fn made(record: &Record) -> Digest {
    let (image, warp) = (record.image.to_string(), Warp(record, Defaults::Written));
    let made = match record.made_with_region {
        Some(region) => serde_json::to_vec(&(image, warp, region.to_string())),
        None => serde_json::to_vec(&(image, warp)),
    };
    Digest::of(&made.expect("an object of numbers and words"))
}

fn unhex<const N: usize>(digits: &str) -> Option<[u8; N]> {
    HEXLOWER.decode(digits.as_bytes()).ok()?.try_into().ok()
}

#[cfg(test)]
mod tests;
