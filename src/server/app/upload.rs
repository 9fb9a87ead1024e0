//! An image file and a warp object, as `POST /warp` and `/sessions` have them: parsed, decoded and
//! resolved, with a plan. All computation runs on the pool with one ticket per request.

use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Image, OutputSpec, RasterSource};
use mlswarp_contract::file::in_part_region;

use super::App;
use super::draw::DrawJob;
use super::drawable::DrawnContent;
use super::reading::Held;
use super::resolved::{Resolved, resolve};
use crate::cache::{CacheEntry, CacheKey, Fetched};
use crate::client::Client;
use crate::layer::check_extent;
use crate::limits::memory::MemoryClass;
use crate::observe::scope::stage;
use crate::observe::stages::Timing;
use crate::pool::{Cancel, Ticket};
use crate::problem::{Code, Problem};
use crate::store::NamedFile;
use crate::wire::formats::Formats;
use crate::wire::landmarks::Landmarks;
use crate::wire::{Reserved, WarpObject, WarpPatch};

/// What a client has uploaded.
#[derive(Debug)]
pub struct Upload {
    /// The image file.
    pub(crate) image: Bytes,
    /// The warp object.
    pub(crate) warp: Bytes,
    /// The mask of what moves, if it is not the whole image.
    pub(crate) region: Option<Bytes>,
    /// The handles, if they are in landmark files.
    pub(crate) landmarks: Option<Held<Landmarks>>,
}

impl Upload {
    /// An image file and a warp object.
    pub fn new(image: impl Into<Bytes>, warp: impl Into<Bytes>) -> Self {
        Self {
            image: image.into(),
            warp: warp.into(),
            region: None,
            landmarks: None,
        }
    }
}

/// Parses the object, decodes the file, resolves the handles, checks `q` and builds the plan.
/// `formats`: the formats that the client accepts, if an image is drawn, for which `q` is required.
pub(super) async fn prepare(
    app: &App,
    client: Client,
    ticket: &Ticket,
    upload: Upload,
    formats: Option<Formats>,
) -> Result<(Resolved, DrawJob), Problem> {
    let Upload {
        image: file,
        warp: json,
        region,
        landmarks,
    } = upload;
    let has_landmarks = landmarks.is_some();
    let mut timing = Timing::queued(ticket.waited());
    let began = Instant::now();
    let hashed_file = file.clone();
    let reserve = app.admission.reserving(MemoryClass::Upload, client);
    let parse = move |_: &_| {
        let mut patch = Reserved::<WarpPatch, _>::parse(&json, reserve).map_err(in_part_warp)?;
        if has_landmarks {
            patch.require_no_handles()?;
        }
        let requested = patch.output.format;
        let object = patch.try_map(WarpPatch::into_object)?;
        let format = formats
            .unwrap_or(Formats::ANY)
            .choose(requested, object.output.format)?;
        Ok::<_, Problem>((object, format, Image::digest_of(&hashed_file)))
    };
    let (object, format, digest) = ticket.run(parse).await??;
    if formats.is_some() {
        match &landmarks {
            Some(landmarks) => landmarks.require_q()?,
            None => drop(object.posed()?),
        }
    }
    let (is_kept, bytes) = (formats.is_none(), file);
    let mut files = vec![NamedFile { digest, bytes }];
    let image = decode(app, client, ticket, &files[0], is_kept).await?;
    let mask = match region {
        Some(bytes) => {
            let digest = app
                .images
                .check_layer(ticket, bytes.clone(), image.extent())
                .await
                .map_err(in_part_region)?;
            let file = NamedFile { digest, bytes };
            let mask = decode(app, client, ticket, &file, is_kept)
                .await
                .map_err(in_part_region)?;
            check_extent(mask.extent(), image.extent()).map_err(in_part_region)?;
            files.push(file);
            Some(mask)
        }
        None => None,
    };
    timing.decode = began.elapsed();
    stage("decode", began);
    RasterSource::Image(&image).check(&object.output)?;
    let (of_job, extent) = (app.clone(), image.extent());
    let content = DrawnContent::image(image, mask);
    let shape = content.clone();
    let settle = move |cancel: &Cancel| {
        let mut object = object;
        if let Some(landmarks) = landmarks {
            object = place_in(landmarks, object, extent)?;
        }
        resolve(&of_job, object, extent, Some(&shape), cancel)
    };
    let resolved = Resolved {
        files,
        ..ticket.run(settle).await??
    };
    let job = DrawJob {
        content,
        planned: app
            .plans
            .plan(client, ticket, &resolved.setup, timing)
            .await?,
        q: Arc::clone(&resolved.q),
        folds: resolved.object.folds,
        output: OutputSpec {
            format,
            ..resolved.object.output
        },
        preview: None,
        force_alpha: false,
        quota: app.admission.response_quota(client),
    };
    Ok((resolved, job))
}

/// Decodes a file of an upload. One that no session keeps is evicted before those of sessions.
async fn decode(
    app: &App,
    client: Client,
    ticket: &Ticket,
    NamedFile { digest, bytes }: &NamedFile,
    is_kept: bool,
) -> Result<Arc<CacheEntry<Image>>, Problem> {
    let Fetched { value, built } = app
        .images
        .decode_image(client, ticket, *digest, bytes.clone())
        .await?;
    if built && !is_kept {
        app.images
            .images
            .demote(CacheKey::new(client.owner, *digest));
    }
    Ok(value)
}

/// Adds the name of the part to an error without a JSON pointer.
fn in_part_warp(mut problem: Problem) -> Problem {
    if problem.code == Code::MalformedRequest && problem.pointer.is_none() {
        problem.detail.insert_str(0, "the part `warp`: ");
    }
    problem
}

/// Puts landmarks into a warp object; their memory follows them.
fn place_in(
    landmarks: Held<Landmarks>,
    object: Held<WarpObject>,
    extent: Extent,
) -> Result<Held<WarpObject>, Problem> {
    // The text had no handles.
    let (mut object, _) = object.into_parts();
    landmarks.try_map(|landmarks| landmarks.place_in(&mut object, extent).map(|()| object))
}
