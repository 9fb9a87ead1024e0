//! Multipart uploads: the parts `image` (the file), `warp` (the warp object), `region` (a mask) and
//! landmark files, each once, in any order.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Poll, ready};

use axum::body::Body;
use axum::extract::multipart::Field;
use axum::extract::{DefaultBodyLimit, FromRequest as _, MatchedPath, Multipart, Request};
use bytes::Bytes;
use futures_util::StreamExt as _;
use futures_util::stream::poll_fn;

use super::body::{self, BodyBuffer, read_problem, sent};
use super::headers::{content_length, media_type};
use super::middleware::authentication::Caller;
use crate::app::blend::BlendUpload;
use crate::app::landmarks;
use crate::app::upload::Upload;
use crate::limits::memory::MemoryClass;
use crate::problem::words::{self, nearest, quote};
use crate::problem::{Code, Problem};
use crate::store::Record;
use crate::wire::blend::MOST_IMAGES;
use crate::wire::fields;
use crate::wire::landmarks::{Choice, LandmarkFiles, Target, extent};

/// Bytes that the parser may buffer without a result: the head of a part, and what precedes the
/// first part.
const MAX_OVERHEAD: u64 = 16 << 10;
/// Memory of the parser: that, a frame before, a frame after, and capacity to grow.
const PARSER_BYTES: u64 = 128 << 10;

/// The parts of an upload, and those of landmark files alone, which are its last ones.
const UPLOAD: [&str; 10] = [
    "image",
    "warp",
    "region",
    "landmarks",
    "landmarks_p",
    "landmarks_q",
    "extent_p",
    "extent_q",
    "match",
    "item",
];
const UPLOAD_ADVICE: &str = "the parts are `image`, `warp` and `region`; landmark files are \
    `landmarks`, or `landmarks_p` and `landmarks_q`, with `extent_p`, `extent_q`, `match` and \
    `item`";
const LANDMARKS_ADVICE: &str = "the parts are `landmarks`, or `landmarks_p` and `landmarks_q`; \
    and `extent_p`, `extent_q`, `match`, `item`";
/// The parts of a request without an image: the other fields, and landmark files; of a session,
/// those of its pose.
const FORM: [&str; 8] = [
    "warp",
    "landmarks",
    "landmarks_p",
    "landmarks_q",
    "extent_p",
    "extent_q",
    "match",
    "item",
];
const FORM_ADVICE: &str = "the parts are `warp`, the JSON without handles; `landmarks`, or \
    `landmarks_p` and `landmarks_q`; and `extent_p`, `extent_q`, `match`, `item`";
const POSE: [&str; 4] = ["warp", "landmarks_q", "extent_q", "item"];
const POSE_ADVICE: &str = "the session has its handles at rest: the parts are `landmarks_q`, the \
    file with the posed positions; `warp`, the JSON without `q`; `extent_q` and `item`";
/// The parts of a blend: as many images and landmark files as it has, and the object once.
const BLEND: [&str; 3] = ["image", "landmarks", "blend"];
const BLEND_ADVICE: &str = "the parts are `image` and `landmarks`, as often as there are images \
    and in the same order, and `blend`, the JSON";
/// Parts that only the limit of the whole body applies to.
const NO_LIMIT: &str = "body_bytes";
/// Longest text of an extent, and of the name of an item, bytes.
const EXTENT_BYTES: u64 = 64;
const ITEM_BYTES: u64 = 1024;

const NO_BOUNDARY: &str = "`Content-Type` has no valid `boundary`: do not set `Content-Type` \
    yourself; the client library adds the boundary";
/// Ends of the names of files that people send, beside those of the pictures that are read:
/// landmarks and annotations, and pictures that are not read.
const OTHER_EXTENSIONS: [&str; 17] = [
    "json", "geojson", "txt", "csv", "tsv", "pts", "tem", "points", "tps", "xml", "fcsv", "heic",
    "heif", "avif", "svg", "psd", "pdf",
];

/// Reads an upload. The limit of the whole body is checked before; `warp` has a limit of its own.
pub(crate) async fn read(caller: &Caller, request: Request) -> Result<Upload, Problem> {
    if !is_multipart(&request) {
        let route = request
            .extensions()
            .get::<MatchedPath>()
            .map_or("", MatchedPath::as_str);
        let of_session =
            "; to warp the picture of a session, send JSON to POST /sessions/{id}/warp";
        let hint = if route == "/warp" { of_session } else { "" };
        let sent = sent(request.headers());
        let detail = format!(
            "{} {route} expects multipart/form-data with the parts `image` and `warp`; \
             {sent}{hint}",
            request.method()
        );
        return Err(Problem::new(Code::UnsupportedMediaType, detail));
    }
    let limit = ("warp_json_bytes", caller.app.config().max_warp_json_bytes);
    let [image, warp, region, files @ ..] =
        read_parts(caller, request, &UPLOAD, UPLOAD_ADVICE, limit).await?;
    let files = landmark_files(files)?;
    files.require_files()?;
    // Every field of a warp object has a default, except for the handles.
    let warp = if files.is_empty() {
        warp
    } else {
        warp.or(Some(Bytes::from_static(b"{}")))
    };
    match (image, warp) {
        (Some(image), Some(warp)) => {
            require_contents(&[
                ("image", Code::UnsupportedFormat, Some(&image)),
                ("warp", Code::MalformedRequest, Some(&warp)),
            ])?;
            require_contents(&[("region", Code::UnsupportedFormat, region.as_ref())])?;
            let mut upload = Upload::new(image, warp);
            upload.region = region;
            if !files.is_empty() {
                let warp = upload.warp.clone();
                upload.landmarks =
                    Some(landmarks::read(&caller.app, caller.client, files, warp).await?);
            }
            Ok(upload)
        }
        (None, None) => Err(malformed("the parts `image` and `warp` are missing")),
        (None, _) => Err(malformed("the part `image` is missing")),
        (_, None) => Err(malformed("the part `warp` is missing")),
    }
}

/// Reads the images and landmark files of a blend; or its JSON alone, if all images are those of
/// sessions.
pub(crate) async fn read_blend(caller: &Caller, request: Request) -> Result<BlendUpload, Problem> {
    let limit = ("blend_json_bytes", caller.app.config().max_warp_json_bytes);
    if !is_multipart(&request) {
        let (what, most) = limit;
        let blend = body::json(caller, request, MemoryClass::Upload, what, most).await?;
        return Ok(BlendUpload {
            blend,
            ..BlendUpload::default()
        });
    }
    let most = |name: &str| if name == "blend" { 1 } else { MOST_IMAGES };
    let mut upload = BlendUpload::default();
    let mut is_given = false;
    for (name, bytes) in read_all(caller, request, &BLEND, BLEND_ADVICE, limit, most).await? {
        let code = match name {
            "image" => Code::UnsupportedFormat,
            "landmarks" => Code::BadLandmarks,
            _ => Code::MalformedRequest,
        };
        require_contents(&[(name, code, Some(&bytes))])?;
        match name {
            "image" => upload.images.push(bytes),
            "landmarks" => upload.landmarks.push(bytes),
            _ => (upload.blend, is_given) = (bytes, true),
        }
    }
    if is_given {
        Ok(upload)
    } else {
        Err(malformed("the part `blend` is missing"))
    }
}

/// Reads the parts of landmark files alone.
pub(crate) async fn read_landmark_parts(
    caller: &Caller,
    request: Request,
) -> Result<LandmarkFiles, Problem> {
    let [_, _, _, files @ ..] = read_parts(
        caller,
        request,
        &UPLOAD[3..],
        LANDMARKS_ADVICE,
        (NO_LIMIT, u64::MAX),
    )
    .await?;
    landmark_files(files)
}

/// Reads the JSON of a request whose handles may be in landmark files: then it is the part `warp`
/// of a form. `limit`: its name, and the most bytes of JSON.
pub(crate) async fn json_or_form(
    caller: &Caller,
    request: Request,
    purpose: MemoryClass,
    (what, limit): (&'static str, u64),
    target: Target,
) -> Result<Bytes, Problem> {
    if !is_multipart(&request) {
        return body::json(caller, request, purpose, what, limit).await;
    }
    let (names, advice) = if let Target::Pose(..) = target {
        (&POSE[..], POSE_ADVICE)
    } else {
        (&FORM[..], FORM_ADVICE)
    };
    let [_, json, _, files @ ..] =
        read_parts(caller, request, names, advice, (what, limit)).await?;
    let files = landmark_files(files)?;
    files.require_files()?;
    let json = json.unwrap_or(Bytes::from_static(b"{}"));
    require_contents(&[("warp", Code::MalformedRequest, Some(&json))])?;
    if files.is_empty() {
        Ok(json)
    } else {
        landmarks::fields(&caller.app, caller.client, files, json, target).await
    }
}

/// As [`json_or_form`], of the size of a warp object.
pub(crate) async fn warp_json_or_form(
    caller: &Caller,
    request: Request,
    target: Target,
) -> Result<Bytes, Problem> {
    let limit = caller.app.config().max_warp_json_bytes;
    json_or_form(
        caller,
        request,
        MemoryClass::Upload,
        ("json_bytes", limit),
        target,
    )
    .await
}

/// As [`json_or_form`], with annotations or frames, which may be as large as any body.
pub(crate) async fn large_json_or_form(
    caller: &Caller,
    request: Request,
    target: Target,
) -> Result<Bytes, Problem> {
    let limit = caller.app.config().max_body_bytes;
    json_or_form(
        caller,
        request,
        MemoryClass::Upload,
        ("body_bytes", limit),
        target,
    )
    .await
}

/// What landmark files mean in a request about a session.
pub(crate) fn pose_of(record: &Record) -> Target {
    Target::Pose(record.extent, record.rest.units)
}

fn landmark_files(
    [both, p, q, extent_p, extent_q, matching, item]: [Option<Bytes>; 7],
) -> Result<LandmarkFiles, Problem> {
    let names = [
        ("landmarks", &both),
        ("landmarks_p", &p),
        ("landmarks_q", &q),
    ];
    require_contents(&names.map(|(name, part)| (name, Code::BadLandmarks, part.as_ref())))?;
    let extent = |name: &str, part: Option<Bytes>| {
        part.map(|part| extent(name, &String::from_utf8_lossy(&part)))
            .transpose()
    };
    let mut choice = Choice::default();
    for (name, part) in [("match", matching), ("item", item)] {
        part.map_or(Ok(()), |part| {
            choice.add_text(name, &String::from_utf8_lossy(&part))
        })?;
    }
    Ok(LandmarkFiles {
        extent_p: extent("extent_p", extent_p)?,
        extent_q: extent("extent_q", extent_q)?,
        both,
        p,
        q,
        choice,
    })
}

pub(crate) fn is_multipart(request: &Request) -> bool {
    media_type(request.headers()).as_deref() == Some("multipart/form-data")
}

/// Reads the parts of these names, each once, in any order.
async fn read_parts(
    caller: &Caller,
    request: Request,
    names: &[&'static str],
    advice: &str,
    of_warp: (&'static str, u64),
) -> Result<[Option<Bytes>; UPLOAD.len()], Problem> {
    let mut read: [Option<Bytes>; UPLOAD.len()] = Default::default();
    for (name, bytes) in read_all(caller, request, names, advice, of_warp, |_| 1).await? {
        if let Some(index) = UPLOAD.iter().position(|known| *known == name) {
            read[index] = Some(bytes);
        }
    }
    Ok(read)
}

/// Reads the parts of these names in any order. `most`: how often a part may occur.
async fn read_all(
    caller: &Caller,
    mut request: Request,
    names: &[&'static str],
    advice: &str,
    of_warp: (&'static str, u64),
    most: fn(&str) -> usize,
) -> Result<Vec<(&'static str, Bytes)>, Problem> {
    // axum's default limit is lower than that of `LimitedBody`.
    DefaultBodyLimit::disable().apply(&mut request);
    let Caller { app, client } = caller;
    let quota = app.admission.request_quota(*client);
    let _parser = app
        .admission
        .reserve_aside(|budget| budget.take_for(MemoryClass::Upload, &quota, PARSER_BYTES))
        .await?;
    let announced = content_length(request.headers());
    let buffered = Arc::new(AtomicU64::new(0));
    let request = request.map(|body| gated(body, Arc::clone(&buffered)));
    let mut parts = Multipart::from_request(request, &())
        .await
        .map_err(|_| malformed(NO_BOUNDARY))?;
    let mut read: Vec<(&'static str, Bytes)> = Vec::new();
    while let Some(part) = parts.next_field().await.map_err(unreadable)? {
        buffered.store(0, Ordering::Relaxed);
        let name = part.name().unwrap_or_default().to_owned();
        let Some(known) = names.iter().find(|known| **known == name) else {
            if fields::is_unsupported(&name, names) {
                return Err(fields::unsupported(&name, names));
            }
            let hint = nearest(&name, names.iter().copied())
                .map(|meant| format!("did you mean `{meant}`?"));
            return Err(malformed(format!(
                "unknown part: {}{}",
                quote(&name),
                words::advice(hint, advice)
            )));
        };
        let most = most(known);
        if read.iter().filter(|(other, _)| other == known).count() >= most {
            return Err(malformed(if most == 1 {
                format!("the part `{name}` occurs twice")
            } else {
                format!("the part `{name}` occurs more than {most} times")
            }));
        }
        let (what, limit) = match name.as_str() {
            "warp" | "blend" => of_warp,
            "extent_p" | "extent_q" => ("extent_bytes", EXTENT_BYTES),
            "match" | "item" => ("item_bytes", ITEM_BYTES),
            _ => (NO_LIMIT, u64::MAX),
        };
        let bytes = read_part(caller, part, what, limit, &buffered, announced).await?;
        read.push((known, bytes));
    }
    Ok(read)
}

/// Rejects parts that contain a URL, or the path of a file instead of its contents, as curl sends
/// it without `@`.
fn require_contents(parts: &[(&str, Code, Option<&Bytes>)]) -> Result<(), Problem> {
    for (name, code, part) in parts {
        let Some(text) = part.and_then(|part| as_line(part)) else {
            continue;
        };
        let hint = match text {
            _ if is_url(text) => {
                "a URL; the server fetches no URLs: send the file itself".to_owned()
            }
            _ if is_path(text) => {
                format!("which looks like a path; curl sends a file with `-F {name}=@path`")
            }
            _ => continue,
        };
        return Err(Problem::new(
            *code,
            format!("the part `{name}` is the text {}, {hint}", quote(text)),
        ));
    }
    Ok(())
}

/// A part that is one short line of text.
fn as_line(part: &[u8]) -> Option<&str> {
    const LONGEST_LINE: usize = 1024;
    let text = std::str::from_utf8(Some(part).filter(|part| part.len() <= LONGEST_LINE)?)
        .ok()?
        .trim();
    (!text.contains(char::is_control)).then_some(text)
}

fn is_url(text: &str) -> bool {
    text.split_once("://").is_some_and(|(scheme, _)| {
        ["http", "https", "ftp", "file", "s3"]
            .iter()
            .any(|known| scheme.eq_ignore_ascii_case(known))
    })
}

/// Whether a line ends with the extension of a file that people send, without characters that JSON
/// has.
fn is_path(text: &str) -> bool {
    let extension = text.rsplit_once('.').map_or("", |(_, extension)| extension);
    !text.contains(['{', '}', '<', '>', '"'])
        && mlswarp::format::source_extensions()
            .chain(OTHER_EXTENSIONS)
            .any(|known| extension.eq_ignore_ascii_case(known))
}

fn malformed(detail: impl Into<String>) -> Problem {
    Problem::new(Code::MalformedRequest, detail)
}

fn unreadable(error: axum::extract::multipart::MultipartError) -> Problem {
    read_problem(&error, "the multipart body could not be read")
}

async fn read_part(
    caller: &Caller,
    mut part: Field<'_>,
    what: &'static str,
    limit: u64,
    buffered: &AtomicU64,
    announced: Option<u64>,
) -> Result<Bytes, Problem> {
    let mut buffer =
        BodyBuffer::new(&caller.app, caller.client, MemoryClass::Upload, announced).await?;
    while let Some(chunk) = part.chunk().await.map_err(unreadable)? {
        buffered.store(0, Ordering::Relaxed);
        buffer.push(&chunk, what, limit).await?;
    }
    Ok(buffer.finish_exact().await)
}

/// Passes data to the multipart parser one frame at a time, and fails when the parser buffers too
/// much: it keeps everything that it cannot parse yet. `buffered`: bytes passed to the parser since
/// its last result.
fn gated(body: Body, buffered: Arc<AtomicU64>) -> Body {
    let mut frames = body.into_data_stream();
    // The parser polls until nothing is ready, and only then looks at what it has.
    let mut has_new_frame = false;
    Body::from_stream(poll_fn(move |cx| {
        if std::mem::take(&mut has_new_frame) {
            cx.waker().wake_by_ref();
            return Poll::Pending;
        }
        if buffered.load(Ordering::Relaxed) > MAX_OVERHEAD {
            let detail = format!(
                "the heads of the parts, and what lies between the parts, are longer than \
                    {MAX_OVERHEAD} bytes"
            );
            return Poll::Ready(Some(Err(axum::Error::new(malformed(detail)))));
        }
        let frame = ready!(frames.poll_next_unpin(cx));
        if let Some(Ok(data)) = &frame {
            buffered.fetch_add(data.len() as u64, Ordering::Relaxed);
            has_new_frame = true;
        }
        Poll::Ready(frame)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_that_is_a_path_or_a_url_is_recognised() {
        for (part, path) in [
            ("photo.jpg", true),
            ("warp.json\n", true),
            ("@warp.json", true),
            ("/home/ann/My pictures/cat.PNG", true),
            ("C:\\Users\\ann\\w.json", true),
            ("", false),
            ("hello", false),
            ("1.5", false),
            ("[[1,2],3.5", false),
            ("0.5,0.5", false),
            ("p=1.5", false),
            ("See example.com", false),
            ("{}", false),
            ("{\"a\": 1.5e3}", false),
            ("two\nlines.txt", false),
            ("no extension.", false),
        ] {
            assert_eq!(
                as_line(part.as_bytes()).is_some_and(is_path),
                path,
                "{part:?}"
            );
        }
        assert_eq!(as_line(b"\x89PNG.png"), None);
        assert_eq!(
            as_line(format!("{}.png", "x".repeat(2000)).as_bytes()),
            None
        );
        for (text, url) in [
            ("https://example.com/a.png", true),
            ("HTTP://x", true),
            ("http", false),
            ("see https://x", false),
        ] {
            assert_eq!(is_url(text), url, "{text}");
        }
    }
}
