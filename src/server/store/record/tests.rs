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
        rest: rest.into(),
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
        ..(*rich().rest).clone()
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
        rest: rest.into(),
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
        rest: base().rest.into(),
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
        }
        .into(),
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
        }
        .into(),
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
        ..(*rich().rest).clone()
    };
    let inside = Record {
        rest: rest.into(),
        ..rich()
    };
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
        let record = Record { rest: rest.into(), folds, output, ..rich() };
        prop_assert_eq!(&*read(&write(&record)).unwrap(), &record);
        let all = serde_json::to_string(&Warp(&record, Defaults::Written)).unwrap();
        prop_assert_eq!(&*read(&with_warp(&record, &all)).unwrap(), &record);
    }
}
