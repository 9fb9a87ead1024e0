//! What a blend needs before its first image is decoded: its object, the sizes and landmarks of all
//! images, and the aligned shapes.

use std::sync::Arc;

use mlswarp::codec::{self, StepCounter};
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Digest, WarpError};

use super::{BlendJob, BlendUpload, BlendedSource, SourceImage};
use crate::app::App;
use crate::app::batch::BatchForm;
use crate::client::Client;
use crate::limits::free::FreedAside;
use crate::limits::memory::MemoryClass;
use crate::pool::{Cancel, QueueKey};
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::store::Record;
use crate::wire::Reserved;
use crate::wire::blend::{AlignedShapes, BlendObject, BlendSource, NamedShape};
use crate::wire::formats::Formats;
use crate::wire::landmarks::{Choice, LandmarkFiles};

/// Operations for a pixel of an image that is added: its samples, its curve and four sums.
const OPERATIONS_PER_PIXEL: u64 = 30;
/// Operations for a pixel of a file that is decoded.
const OPERATIONS_TO_DECODE: u64 = 3;

/// Parses the object and the landmarks, and aligns the shapes. No image is decoded yet.
pub(super) async fn prepare(
    app: &App,
    client: Client,
    upload: BlendUpload,
    formats: Formats,
    form: Option<BatchForm>,
) -> Result<BlendJob, Problem> {
    let ticket = app.admission.upload(QueueKey::client(client)).await?;
    let reserve = app.admission.reserving(MemoryClass::Upload, client);
    let json = upload.blend.clone();
    let object = ticket
        .run(move |_| Reserved::<BlendObject, _>::parse(&json, reserve))
        .await??;
    let mut records = Vec::with_capacity(object.images.len());
    for (index, entry) in object.images.iter().enumerate() {
        records.push(match &entry.source {
            BlendSource::Part(_) => None,
            BlendSource::Session(id) => {
                let at = |problem: Problem| problem.pointer(format!("/images/{index}/session"));
                let id = SessionId::parse(client.owner, id).ok_or_else(|| {
                    at(Problem::new(
                        Code::NoSuchSession,
                        "this is not the id of a session",
                    ))
                })?;
                let session = app.sessions.touch(id, None).await;
                Some(session.map_err(|error| at(error.into()))?.record)
            }
        });
    }
    let (of_job, limits) = (app.clone(), app.plans.limits);
    let settle = move |cancel: &Cancel| {
        let read = read_images(&of_job, client, &upload, &object, records, cancel)?;
        let (mut images, named): (Vec<SourceImage>, Vec<_>) = read.into_iter().unzip();
        let first = images[0].extent;
        let shapes = AlignedShapes::new(&object, named, first.width(), &|| cancel.is_cancelled())?;
        let matched = shapes.p.into_iter().zip(shapes.pairs);
        for (image, (p, pairs)) in images.iter_mut().zip(matched) {
            (image.p, image.pairs) = (p, pairs);
        }
        let (canvas, target) = object.target(first, &limits)?;
        require_work(&images, target.extent, limits.work)?;
        let format = match form {
            Some(form) => form.frame_format().unwrap_or(object.output.format),
            None => formats.choose(Some(object.output.format), object.output.format)?,
        };
        Ok::<_, Problem>(BlendJob {
            app: of_job,
            client,
            object,
            images: FreedAside::new(images),
            shapes: FreedAside::new(shapes.blended),
            canvas,
            target,
            format,
        })
    };
    ticket.run(settle).await?
}

/// Errors: decoding these images and adding them at this size, for one frame, would take too many
/// operations. The estimate alone decides, so that every replica gives the same answer whatever it
/// has cached. Later frames are not counted: each is made only when the client has read the one
/// before.
fn require_work(images: &[SourceImage], extent: Extent, limit: u64) -> Result<(), Problem> {
    let decoded: u64 = images.iter().map(|image| image.extent.pixels()).sum();
    let count = images.len() as u64;
    let added = (count * OPERATIONS_PER_PIXEL).saturating_mul(extent.pixels());
    let actual = added.saturating_add(decoded.saturating_mul(OPERATIONS_TO_DECODE));
    if actual <= limit {
        return Ok(());
    }
    let (width, height) = (extent.width(), extent.height());
    let detail = format!(
        "decoding {count} images and adding them at {width} x {height} px would take {actual} \
         operations; the limit is {limit}; send fewer or smaller images, or a smaller \
         `output.width`"
    );
    Err(Problem::new(Code::TooLarge, detail)
        .pointer("/images")
        .limit("work", limit, actual))
}

/// Reads the sizes and the landmarks of all images, which are not matched yet.
fn read_images(
    app: &App,
    client: Client,
    upload: &BlendUpload,
    object: &BlendObject,
    records: Vec<Option<Arc<Record>>>,
    cancel: &Cancel,
) -> Result<Vec<(SourceImage, NamedShape)>, Problem> {
    let mut images = Vec::with_capacity(records.len());
    for (index, (entry, record)) in object.images.iter().zip(records).enumerate() {
        let at = |field: &str| format!("/images/{index}{field}");
        let (source, extent, of_session) = match (&entry.source, record) {
            (BlendSource::Part(number), _) => {
                let Some(file) = upload.images.get(*number) else {
                    let detail = format!(
                        "`image` is {number}, but the request has {} parts `image`, counted from 0",
                        upload.images.len()
                    );
                    return Err(Problem::new(Code::BadValue, detail).pointer(at("/image")));
                };
                let is_cancelled = || cancel.is_cancelled();
                let header = codec::probe(file, &StepCounter::new(&is_cancelled))
                    .map_err(|error| in_image(index, WarpError::from(error).into()))?;
                let limits = app.plans.limits.image;
                limits
                    .check(header.extent)
                    .map_err(|error| in_image(index, WarpError::from(error).into()))?;
                let source = BlendedSource::File(Digest::of(file), file.clone());
                (source, header.extent, None)
            }
            (BlendSource::Session(_), Some(record)) => {
                let p = record.rest.p_in_px(record.extent);
                (
                    BlendedSource::Session(Arc::clone(&record)),
                    record.extent,
                    Some(p),
                )
            }
            (BlendSource::Session(_), None) => {
                return Err(Problem::new(Code::Internal, "a session without a record"));
            }
        };
        let file = match entry.source {
            BlendSource::Part(number) => upload.landmarks.get(number),
            BlendSource::Session(_) => None,
        };
        if entry.item.is_some() && file.is_none() {
            let detail = "`item` belongs to a landmark file, which this image does not have";
            return Err(Problem::new(Code::BadValue, detail).pointer(at("/item")));
        }
        if entry.names.is_some() && entry.p.is_none() && file.is_some() {
            let detail = "`names` belongs to `p`: a landmark file has names of its own";
            return Err(Problem::new(Code::BadValue, detail).pointer(at("/names")));
        }
        let shape = match (&entry.p, file, &of_session) {
            (Some(p), None, _) | (None, None, Some(p)) if !p.is_empty() => {
                if let Some(names) = entry.names.as_ref().filter(|names| names.len() != p.len()) {
                    let (names, p) = (names.len(), p.len());
                    let detail = format!("`names` has {names}, but there are {p} handles");
                    return Err(Problem::new(Code::ShapeMismatch, detail).pointer(at("/names")));
                }
                NamedShape {
                    p: p.clone(),
                    names: entry.names.clone(),
                }
            }
            (Some(_), Some(_), _) => {
                let detail = "this image has landmarks in `p` and in a file: send one of them";
                return Err(Problem::new(Code::BadValue, detail).pointer(at("/p")));
            }
            (None, Some(file), _) => {
                let files = LandmarkFiles {
                    both: Some(file.clone()),
                    choice: Choice {
                        item: entry.item.clone(),
                        ..Choice::default()
                    },
                    ..LandmarkFiles::default()
                };
                read_shape(app, client, &files, extent, cancel)
                    .map_err(|problem| in_image(index, problem))?
            }
            _ => {
                let detail = "this image has no landmarks: send one part `landmarks` for each part \
                    `image`, or `p` here; a session needs handles";
                return Err(Problem::new(Code::BadValue, detail).pointer(at("")));
            }
        };
        let image = SourceImage {
            source,
            extent,
            p: Vec::new(),
            pairs: None,
        };
        images.push((image, shape));
    }
    Ok(images)
}

/// The landmarks of a file, px of an image of this size.
fn read_shape(
    app: &App,
    client: Client,
    files: &LandmarkFiles,
    extent: Extent,
    cancel: &Cancel,
) -> Result<NamedShape, Problem> {
    let reserve = app.admission.reserving(MemoryClass::Upload, client);
    let columns = app.plans.limits.columns;
    let is_cancelled = || cancel.is_cancelled();
    let landmarks = Reserved::of_files(files, columns, &is_cancelled, reserve)?;
    NamedShape::of_file(landmarks.into_parts().0, extent)
}

/// Names the image in the problem of its files.
pub(super) fn in_image(index: usize, mut problem: Problem) -> Problem {
    problem.detail = format!("image {index}: {}", problem.detail);
    problem.pointer = Some(format!("/images/{index}"));
    problem
}
