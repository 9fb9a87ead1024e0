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
        } = &record.rest;
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
        if let Some(Pose { q, strength }) = &record.pose {
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
/// Errors: They are damaged, or another version of the program wrote them.
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
        },
        pose: warp.q.map(|q| Pose {
            q,
            strength: warp.strength,
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
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::store::arbitrary::warp_object;
    use crate::store::tests::suite;
    use mlswarp::codec::Subsampling;
    use mlswarp::deform::Handle;
    use mlswarp::geometry::Point;

    fn rich() -> Record {
        let p = vec![
            Handle::Point(Point::new(0.1, -0.0)),
            Handle::Polyline(vec![Point::new(1e-300, 2.5), Point::new(1.0 / 3.0, 1e5)]),
        ];
        let rest = RestSpec {
            p,
            weights: Some(vec![1.0, 0.1 + 0.2]),
            alpha: Some(1.3),
            ..RestSpec::default()
        };
        Record {
            rest,
            created: SystemTime::UNIX_EPOCH + Duration::from_nanos(1_795_000_000_123_456_789),
            ..(*suite::record(7)).clone()
        }
    }

    /// A record none of whose fields is at its default.
    fn nothing_at_its_default() -> Record {
        let rest = RestSpec {
            method: Method::Affine,
            point_mass: Some(7.5),
            coincident: Coincident {
                policy: CoincidentPolicy::Reject,
                within: 1.5,
            },
            units: Units::Normalized,
            grid: GridSpec::Counts {
                columns: 9,
                rows: 7,
            },
            align: Align::Similarity,
            has_unmatched: true,
            ..rich().rest
        };
        let output = OutputSpec {
            format: Format::Jpeg,
            quality: 7,
            subsampling: Some(Subsampling::Full),
            compression: Compression::Best,
            canvas: CanvasSpec::Fit,
            width: Some(5),
            filter: Filter::Nearest,
            outside: Outside::Edge,
            holes: Holes::Transparent,
        };
        Record {
            rest,
            folds: Folds::Reject,
            output,
            ..rich()
        }
    }

    fn layered() -> Record {
        let layer = |kind, digest| StoredLayer {
            kind,
            digest: Digest([digest; 32]),
        };
        let layers = [
            ("depth.v1", layer(LayerKind::Image, 0xab)),
            ("region", layer(LayerKind::Labels, 0xcd)),
        ];
        let layers = layers
            .into_iter()
            .map(|(name, layer)| (LayerName::parse(name).unwrap(), layer))
            .collect();
        Record {
            layers,
            made_with_region: Some(Digest([0xef; 32])),
            ..plain()
        }
    }

    fn plain() -> Record {
        Record {
            rest: base().rest,
            folds: base().folds,
            output: base().output,
            ..rich()
        }
    }

    /// The record with other JSON for its warp object, sealed.
    fn with_warp(record: &Record, warp: &str) -> Vec<u8> {
        let text = String::from_utf8(write(record)).unwrap();
        let (before, _) = text.split_once("\"warp\":").unwrap();
        sealed(format!("{}\"warp\":{warp}}}", &before[CHECKSUM_BYTES..]).as_bytes())
    }

    #[test]
    fn what_is_written_reads_back_to_the_bit() {
        for record in [rich(), plain(), nothing_at_its_default(), layered()] {
            let back = read(&write(&record)).unwrap();
            assert_eq!(*back, record);
            assert_eq!(write(&back), write(&record));
            assert_eq!(made(&back), made(&record));
        }
    }

    #[test]
    fn a_changed_byte_anywhere_is_seen() {
        let bytes = write(&rich());
        for k in 0..bytes.len() {
            let mut bad = bytes.clone();
            bad[k] ^= 1;
            assert!(
                matches!(read(&bad), Err(Unreadable::Damaged(_))),
                "byte {k}"
            );
            assert!(
                matches!(read(&bytes[..k]), Err(Unreadable::Damaged(_))),
                "{k} bytes"
            );
        }
    }

    /// The defaults of the form are frozen: both forms below are in stores.
    #[test]
    fn a_field_at_its_default_is_left_out_and_read_as_the_first_version_wrote_it() {
        let all = r##"{"p":[],"method":"rigid","units":"px","grid":"auto","folds":"report","metric":"euclidean","output":{"format":"png","quality":90,
            "compression":"fast","filter":"bilinear","outside":"transparent","canvas":"same"}}"##;
        let record = plain();
        assert!(
            write(&record).ends_with(b",\"warp\":{}}"),
            "{}",
            String::from_utf8_lossy(&write(&record))
        );
        for warp in ["{}", all] {
            assert_eq!(*read(&with_warp(&record, warp)).unwrap(), record);
        }
        let some = Record {
            output: OutputSpec {
                quality: 85,
                ..record.output
            },
            ..record
        };
        assert!(
            write(&some).ends_with(b",\"warp\":{\"output\":{\"quality\":85}}}"),
            "{}",
            String::from_utf8_lossy(&write(&some))
        );
    }

    /// What the first version of the program computed. A program that computes anything else would
    /// create a session again that a replica has.
    #[test]
    fn the_digest_of_what_a_session_was_made_from_is_the_first_programs() {
        let digest = |record: &Record, warp: &str| {
            Digest::of(format!("[\"{}\",{warp}]", record.image).as_bytes())
        };
        let (plain, full) = (plain(), nothing_at_its_default());
        let warp = r#"{"p":[],"method":"rigid","units":"px","grid":"auto","folds":"report","metric":"euclidean","output":{"format":"png","quality":90,"compression":"fast","filter":"bilinear","outside":"transparent","canvas":"same"}}"#;
        assert_eq!(made(&plain), digest(&plain, warp));
        let warp = r#"{"p":[[0.1,-0.0],[[1e-300,2.5],[0.3333333333333333,100000.0]]],"weights":[1.0,0.30000000000000004],"method":"affine","alpha":1.3,"point_mass":7.5,"units":"normalized","grid":{"columns":9,"rows":7},"folds":"reject","metric":"euclidean","output":{"format":"jpeg","quality":7,"subsampling":"4:4:4","compression":"best","width":5,"filter":"nearest","outside":"edge","canvas":"fit","holes":"transparent"},"coincident":{"policy":"reject","within":1.5},"align":"similarity"}"#;
        assert_eq!(made(&full), digest(&full, warp));
    }

    /// A field of a later version: older programs keep what they cannot read (rule 3), and read
    /// everything else.
    #[test]
    fn smoothing_is_written_and_digested_only_where_it_is_given() {
        let text = |record: &Record| String::from_utf8(write(record)).unwrap();
        assert!(!text(&nothing_at_its_default()).contains("smoothing"));
        let spline = |smoothing| Record {
            rest: RestSpec {
                method: Method::ThinPlateSpline,
                smoothing,
                ..base().rest
            },
            ..plain()
        };
        let (exact, smooth) = (spline(None), spline(Some(0.1)));
        assert!(
            text(&exact).ends_with(r#","warp":{"method":"tps"}}"#),
            "{}",
            text(&exact)
        );
        assert!(
            text(&smooth).ends_with(r#","warp":{"method":"tps","smoothing":0.1}}"#),
            "{}",
            text(&smooth)
        );
        for record in [&exact, &smooth] {
            assert_eq!(*read(&write(record)).unwrap(), *record);
        }
        assert!(made(&exact) != made(&smooth) && !exact.is_made_like(&smooth));
    }

    #[test]
    fn align_is_written_and_digested_only_where_it_is_requested() {
        let text = |record: &Record| String::from_utf8(write(record)).unwrap();
        let aligned = |align| Record {
            rest: RestSpec {
                align,
                ..base().rest
            },
            ..plain()
        };
        assert!(text(&aligned(Align::None)).ends_with(r#","warp":{}}"#));
        assert!(
            text(&aligned(Align::Rigid)).ends_with(r#","warp":{"align":"rigid"}}"#),
            "{}",
            text(&aligned(Align::Rigid))
        );
        for align in [Align::Rigid, Align::Similarity, Align::Affine] {
            let record = aligned(align);
            assert_eq!(*read(&write(&record)).unwrap(), record);
            assert!(made(&record) != made(&plain()) && !record.is_made_like(&plain()));
        }
    }

    #[test]
    fn a_metric_is_written_with_its_threshold_and_a_mask_never() {
        let text = |record: &Record| String::from_utf8(write(record)).unwrap();
        assert!(!text(&rich()).contains("metric") && !text(&rich()).contains("mask"));
        let rest = RestSpec {
            metric: Metric::Geodesic,
            mask_threshold: Some(0.25),
            ..rich().rest
        };
        let inside = Record { rest, ..rich() };
        let written = text(&inside);
        assert!(written.contains("\"metric\":\"geodesic\""), "{written}");
        assert!(
            written.contains("\"mask\":{\"threshold\":0.25}"),
            "{written}"
        );
        assert_eq!(read(written.as_bytes()).unwrap().rest, inside.rest);
        assert_ne!(made(&inside), made(&rich()));
    }

    #[test]
    fn layers_are_written_where_there_are_any_and_are_not_what_a_session_was_made_from() {
        let text = |record: &Record| String::from_utf8(write(record)).unwrap();
        let (none, some) = (plain(), layered());
        assert!(!text(&none).contains("layer") && !text(&none).contains("region"));
        let (ab, cd, ef) = ("ab".repeat(32), "cd".repeat(32), "ef".repeat(32));
        let layers = format!(
            r#""layers":{{"depth.v1":{{"kind":"image","file":"{ab}"}},"region":{{"kind":"labels","file":"{cd}"}}}}"#
        );
        assert!(
            text(&some).contains(&format!(r#",{layers},"made_with_region":"{ef}","#)),
            "{}",
            text(&some)
        );
        let named = named_files(&write(&some));
        assert!(some.files().count() == 3 && some.files().all(|digest| named.contains(&digest)));
        let without = Record {
            made_with_region: None,
            ..some.clone()
        };
        assert!(made(&without) == made(&none) && without.is_made_like(&none));
        assert!(made(&some) != made(&none) && !some.is_made_like(&none));
        let other = text(&some)[CHECKSUM_BYTES..].replace("\"image\",", "\"video\",");
        assert!(matches!(
            read(&sealed(other.as_bytes())),
            Err(Unreadable::OtherVersion(_))
        ));
    }

    #[test]
    fn what_this_program_does_not_know_is_of_another_version_and_not_damaged() {
        let record = rich();
        let text = String::from_utf8(write(&record)[CHECKSUM_BYTES..].to_vec()).unwrap();
        let changed = |old: &str, new: &str| {
            assert!(text.contains(old));
            sealed(text.replace(old, new).as_bytes())
        };
        let others = [
            changed("\"version\":1", "\"version\":2"),
            changed("\"version\":1", "\"version\":1,\"frames\":{}"),
            with_warp(&record, r#"{"region":1}"#),
            with_warp(&record, r#"{"method":"lattice"}"#),
            with_warp(&record, r#"{"method":"auto"}"#),
            with_warp(&record, r#"{"output":{"filter":"lanczos"}}"#),
            with_warp(&record, r#"{"strength":2}"#),
            sealed(b"{\"version\":3}"),
            sealed(b"\x82\xa7version\x04"),
        ];
        for bytes in others {
            assert!(
                matches!(read(&bytes), Err(Unreadable::OtherVersion(_))),
                "{}",
                String::from_utf8_lossy(&bytes)
            );
        }
    }

    #[test]
    fn the_files_of_a_record_of_any_version_are_known() {
        let record = rich();
        assert!(named_files(&write(&record)).contains(&record.image));
        let other = Digest([0xab; 32]);
        let json = format!(
            "{{\"version\":2,\"files\":[\"{}\",\"sha256:{}\"]}}",
            record.image, other
        );
        let mut named = [record.image, other];
        named.sort_unstable_by_key(|digest| digest.0);
        assert_eq!(named_files(&sealed(json.as_bytes())), named);
        assert!(named_files(b"0123456789abcdef").is_empty());
    }

    proptest! {
        #[test]
        fn any_record_reads_back(warp in warp_object()) {
            let WarpObject { rest, folds, output, .. } = warp;
            let record = Record { rest, folds, output, ..rich() };
            prop_assert_eq!(&*read(&write(&record)).unwrap(), &record);
            let all = serde_json::to_string(&Warp(&record, Defaults::Written)).unwrap();
            prop_assert_eq!(&*read(&with_warp(&record, &all)).unwrap(), &record);
        }
    }
}
