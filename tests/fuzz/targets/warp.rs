//! Any bytes as the JSON of each route. The first byte chooses the route. What is read is warped,
//! on a small picture and behind small limits; what is refused is refused by a whole problem
//! document. Fields whose value is `null` change nothing.

use std::fmt::Debug;
use std::ops::ControlFlow;
use std::sync::{Arc, LazyLock};

use bytes::Bytes;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{
    CoordinateFrame, CoordinateMap, Folds, Image, ImageLimits, Limits, MapFormat, OutputSpec,
    PosedMesh, Quality, RasterSource, RenderJob, ResolvedRest, Units,
};
use mlswarp_server::problem::Problem;
use mlswarp_server::wire::{
    BatchObject, Cursor, DragObject, MapObject, PointsObject, PosePatch, ReportAnswer,
    ReportObject, Reserved, WarningEntry, WarpObject,
};

use serde_json::{Map, Value};

use super::assert_is_problem;

const LIMITS: Limits = Limits {
    image: ImageLimits {
        max_pixels: 1 << 14,
        max_side: 1 << 9,
    },
    columns: 64,
    plan_bytes: 1 << 20,
    work: 1 << 32,
};

static DOCUMENT: LazyLock<Value> = LazyLock::new(|| {
    serde_json::from_str(include_str!("../../../api/openapi.json")).expect("the document is JSON")
});

static IMAGE: LazyLock<Arc<Image>> = LazyLock::new(|| {
    let file = include_bytes!("../seeds/image/png-6-8");
    Arc::new(Image::decode(file, &LIMITS.image, &|| false).expect("a seed that is read"))
});

pub(super) fn parse(bytes: &[u8]) {
    let Some((route, json)) = bytes.split_first() else {
        return;
    };
    let refused = match route % 11 {
        0..=2 => as_with_nulls("WarpObject", json, |json| {
            value(Reserved::<WarpObject, _>::parse(json, free))
        })
        .and_then(|object| warped(&object))
        .err(),
        3 => as_with_nulls("Drag", json, |json| {
            value(Reserved::<DragObject, _>::parse(json, 64, free))
        })
        .err(),
        4 => as_with_nulls("Points", json, points)
            .and_then(|object| mapped(&object))
            .err(),
        5 => as_with_nulls("PosedPoints", json, posed_points).err(),
        6 => as_with_nulls("Map", json, |json| {
            value(Reserved::<MapObject, _>::parse(json, free))
        })
        .and_then(|object| inverted(&object))
        .err(),
        7 => as_with_nulls("PosedMap", json, |json| {
            value(Reserved::<MapObject, _>::parse_posed(json, free))
        })
        .err(),
        8 => as_with_nulls("Batch", json, batch).err(),
        9 => as_with_nulls("Report", json, |json| {
            value(Reserved::<ReportObject, _>::parse(json, free))
        })
        .and_then(|object| measured(&object))
        .err(),
        _ => as_with_nulls("PosedReport", json, |json| {
            value(Reserved::<DragObject, _>::parse_for_report(json, 64, free))
        })
        .err(),
    };
    if let Some(problem) = refused {
        assert_is_problem(&problem.to_json("", None));
    }
}

fn free(_: u64) -> Result<(), Problem> {
    Ok(())
}

fn value<T>(read: Result<Reserved<T, ()>, Problem>) -> Result<T, Problem> {
    read.map(|read| read.into_parts().0)
}

/// What the text is read as, which must not change when the fields of the schema that it does not
/// have are added as `null`.
fn as_with_nulls<T: PartialEq + Debug>(
    schema: &str,
    json: &[u8],
    parse: fn(&[u8]) -> Result<T, Problem>,
) -> Result<T, Problem> {
    let read = parse(json);
    if let Ok(given) = serde_json::from_slice::<Map<String, Value>>(json) {
        let end = json
            .iter()
            .rposition(|byte| *byte == b'}')
            .expect("the end of an object");
        let known = DOCUMENT["components"]["schemas"][schema]["properties"]
            .as_object()
            .expect("a schema of an object");
        let mut more = json[..end].to_vec();
        for (n, name) in known
            .keys()
            .filter(|name| !given.contains_key(*name))
            .enumerate()
        {
            let comma = if n > 0 || !given.is_empty() { "," } else { "" };
            more.extend_from_slice(format!("{comma}\"{name}\":null").as_bytes());
        }
        more.push(b'}');
        assert_eq!(parse(&more), read, "{}", String::from_utf8_lossy(&more));
    }
    read
}

/// The poses of a batch that the request gives: their number, and each until one is refused.
type Poses = (u32, Vec<Result<PosePatch, Problem>>);

fn batch(json: &[u8]) -> Result<Poses, Problem> {
    let source = CoordinateFrame::of_source(Extent::new(40, 30).expect("a size"), Units::Px);
    let object = value(Reserved::<BatchObject, _>::parse(
        &Bytes::copy_from_slice(json),
        1 << 20,
        1 << 16,
        source,
        &|| false,
        free,
    ))?;
    let count = object.poses.count();
    assert!((1..=10_000).contains(&count), "{count}");
    Ok((
        count,
        (0..count.min(100))
            .map(|frame| value(object.poses.requested_frames(frame, free)))
            .collect(),
    ))
}

fn measured(object: &ReportObject) -> Result<(), Problem> {
    let (mut warp, extent) = (object.warp.clone(), object.extent);
    let alignment = warp.settle_pose(extent)?;
    let setup = ResolvedRest::new(&warp.rest, extent, &LIMITS, &|| false)?;
    let (q, never) = (warp.posed()?, || false);
    let pose = setup.pose(q)?;
    warp.output.check(extent, &LIMITS)?;
    let posed = PosedMesh::new(
        &setup,
        &setup.plan(&|| false)?,
        &pose,
        Folds::Report,
        &never,
    )?;
    let quality = Quality::of(
        &setup,
        q,
        &pose,
        &posed,
        &posed,
        warp.output.canvas.of(extent, &posed, &never)?,
        &never,
    )?;
    assert_eq!(quality.residuals.len(), warp.rest.p.len());
    assert!(
        (0.0..=1.0).contains(&quality.covered) && (0.0..=1.0 + 1e-9).contains(&quality.folds.share),
        "{quality:?}"
    );
    let warnings: Vec<_> = posed
        .report()
        .warnings
        .iter()
        .map(WarningEntry::from)
        .collect();
    let answer = ReportAnswer {
        quality: &quality,
        alignment,
        warnings: &warnings,
        picture: None,
    };
    let text = serde_json::to_vec(&answer).expect("a report is JSON");
    assert!(text.len() <= answer.text_bytes(), "{} bytes", text.len());
    Ok(())
}

fn warped(object: &WarpObject) -> Result<(), Problem> {
    let mut object = object.clone();
    object.settle_pose(IMAGE.extent())?;
    let setup = ResolvedRest::new(&object.rest, IMAGE.extent(), &LIMITS, &|| false)?;
    let pose = setup.pose(object.posed()?)?;
    object.output.check(IMAGE.extent(), &LIMITS)?;
    let posed = PosedMesh::new(
        &setup,
        &setup.plan(&|| false)?,
        &pose,
        object.folds,
        &|| false,
    )?;
    assert!(posed.report().residual.is_finite(), "{:?}", posed.report());
    assert!(
        posed.vertices().flatten().all(f64::is_finite),
        "a vertex is nowhere"
    );
    let mut bytes = 0;
    let warp = RenderJob::new(
        RasterSource::Image(&IMAGE),
        &posed,
        &object.output,
        &LIMITS,
        &|| false,
    )?;
    let _ = warp.write(0, &(), &mut |strip| {
        bytes += strip.len();
        ControlFlow::Continue(())
    });
    assert!(bytes > 0, "a picture has bytes");
    Ok(())
}

/// Every number of a map is a place or NaN, and the file has as many bytes as it says.
fn inverted(object: &MapObject) -> Result<(), Problem> {
    let Some((mut warp, extent)) = object.warp.clone() else {
        return Ok(());
    };
    warp.settle_pose(extent)?;
    for format in MapFormat::ALL {
        let spec = object.spec(&warp.output, format);
        spec.check(extent, &LIMITS)?;
        let setup = ResolvedRest::new(&warp.rest, extent, &LIMITS, &|| false)?;
        let posed = PosedMesh::new(
            &setup,
            &setup.plan(&|| false)?,
            &setup.pose(warp.posed()?)?,
            warp.folds,
            &|| false,
        )?;
        let map = CoordinateMap::new(
            &spec,
            &posed,
            spec.target(&posed, extent, &LIMITS, &|| false)?,
        )?;
        let bands = (0..map.bands()).map(|band| Ok(map.band(band, &|| false)?.len() as u64));
        let bytes: u64 = bands.sum::<Result<_, Problem>>()?;
        assert_eq!(bytes, map.file_bytes());
    }
    Ok(())
}

fn mapped(object: &PointsObject) -> Result<(), Problem> {
    let Some((mut warp, extent)) = object.warp.clone() else {
        return Ok(());
    };
    warp.settle_pose(extent)?;
    let setup = ResolvedRest::new(&warp.rest, extent, &LIMITS, &|| false)?;
    let pose = setup.pose(warp.posed()?)?;
    let posed = PosedMesh::coarse(&setup, &setup.plan(&|| false)?, &pose, warp.folds, &|| {
        false
    })?;
    let transform = if object.annotations.is_inverse {
        setup.inverse(&pose, &posed)
    } else {
        setup.transform_of(&pose, &posed)
    };
    let transform = transform.onto(CoordinateFrame::requested(
        &object.output,
        extent,
        warp.rest.units,
    ));
    let (mut cursor, mut out) = (Cursor::default(), Vec::new());
    while object.annotations.map_part(
        &mut cursor,
        &transform,
        &|| false,
        &mut |_| Ok(()),
        &mut out,
    )? {}
    let _: Value = serde_json::from_slice(&out).expect("JSON");
    Ok(())
}

fn points(json: &[u8]) -> Result<PointsObject, Problem> {
    value(Reserved::<PointsObject, _>::parse(
        &Bytes::copy_from_slice(json),
        1 << 20,
        &|| false,
        free,
    ))
}

fn posed_points(json: &[u8]) -> Result<PointsObject, Problem> {
    let of_session = (Extent::new(40, 30).expect("a size"), Units::Px);
    let (body, output) = (Bytes::copy_from_slice(json), OutputSpec::default());
    value(Reserved::<PointsObject, _>::parse_posed(
        &body,
        1 << 20,
        of_session,
        &output,
        &|| false,
        free,
    ))
}
