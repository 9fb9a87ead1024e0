//! The pose of a session, and the output that replaces a part of the session's.

use super::*;

#[test]
fn drag_reads_its_fields() {
    let pose = |q| PosePatch {
        q: Some(q),
        strength: None,
    };
    let drag = DragObject::parse(
        b"{\"q\": [[1, 2]], \"seq\": 9007199254740993, \"output\": {\"width\": 9}}",
        usize::MAX,
    )
    .unwrap();
    let output = OutputPatch {
        width: Some(9),
        ..OutputPatch::default()
    };
    assert_eq!(
        drag,
        DragObject {
            pose: pose(vec![point(1.0, 2.0)]),
            seq: Some((1 << 53) + 1),
            layer: None,
            output
        }
    );
    let drag = DragObject::parse(b"{\"q\": []}", usize::MAX).unwrap();
    assert_eq!(
        drag,
        DragObject {
            pose: pose(vec![]),
            seq: None,
            layer: None,
            output: OutputPatch::default()
        }
    );
    let of_session = DragObject::parse(b"{\"q\": null, \"strength\": 2}", usize::MAX)
        .unwrap()
        .pose;
    assert_eq!(
        of_session,
        PosePatch {
            q: None,
            strength: Some(2.0)
        }
    );
    for (text, seq) in [
        ("0", 0),
        ("-0", 0),
        ("7.0", 7),
        ("1e3", 1000),
        ("18446744073709551615", u64::MAX),
    ] {
        assert_eq!(
            DragObject::parse(
                format!("{{\"q\": [], \"seq\": {text}}}").as_bytes(),
                usize::MAX
            )
            .unwrap()
            .seq,
            Some(seq)
        );
    }
}

#[test]
fn drag_refuses() {
    use Code::{BadValue as B, NotFinite as N};
    check(
        |json| DragObject::parse(json, usize::MAX),
        &[
            ("{\"q\": [], \"seq\": -1}", B, Some("/seq"), None),
            ("{\"q\": [], \"seq\": 1.5}", B, Some("/seq"), None),
            ("{\"q\": [], \"seq\": \"1\"}", B, Some("/seq"), None),
            (
                "{\"q\": [], \"seq\": 18446744073709551616}",
                B,
                Some("/seq"),
                None,
            ),
            ("{\"q\": [], \"seq\": 1e999}", N, Some("/seq"), None),
        ],
    );
}

#[test]
fn output_patch_replaces_only_what_it_gives() {
    let base = OutputSpec {
        format: Format::Jpeg,
        quality: 40,
        subsampling: Some(Subsampling::Half),
        compression: Compression::None,
        canvas: CanvasSpec::Fit,
        width: Some(7),
        filter: Filter::Nearest,
        outside: Outside::Edge,
        holes: Holes::Transparent,
    };
    assert_eq!(OutputPatch::default().merge_onto(&base), base);
    let (format, quality, subsampling, compression, width) = (
        Format::WebP,
        70,
        Some(Subsampling::Full),
        Compression::Best,
        8,
    );
    let (filter, outside, canvas, holes) = (
        Filter::Bilinear,
        Outside::Colour([1, 2, 3, 4]),
        CanvasSpec::Same,
        Holes::Keep,
    );
    let all = OutputPatch {
        format: Some(format),
        quality: Some(quality),
        subsampling,
        compression: Some(compression),
        canvas: Some(canvas),
        width: Some(width),
        filter: Some(filter),
        outside: Some(outside),
        holes: Some(holes),
    };
    assert_eq!(
        all.merge_onto(&base),
        OutputSpec {
            format,
            quality,
            subsampling,
            compression,
            canvas,
            width: Some(width),
            filter,
            outside,
            holes
        }
    );
    assert_eq!(
        OutputPatch {
            width: Some(8),
            ..OutputPatch::default()
        }
        .merge_onto(&base),
        OutputSpec {
            width: Some(8),
            ..base
        }
    );
}
