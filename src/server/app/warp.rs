//! `POST /warp` with an image, and what other use cases share with it: decoding the image,
//! resolving the handles, building the plan. All computation runs on the pool with one ticket per
//! request.

use std::sync::Arc;
use std::time::{Instant, SystemTime};

use bytes::Bytes;
use mlswarp::codec::Format;
use mlswarp::deform::Handle;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Alignment, Digest, Image, OutputSpec, RasterSource, ResolvedRest, RestSpec};

use super::draw::{DrawJob, Drawn, HeldSetup, Planned};
use super::drawable::{DrawnContent, check_extent};
use super::reading::{Held, part};
use super::{App, MIN_WEIGHT, build_aborted};
use crate::cache::{CacheEntry, CacheKey, Fetched};
use crate::client::Client;
use crate::layer::{LayerKind, LayerName};
use crate::limits::memory::MemoryClass;
use crate::observe::scope::stage;
use crate::observe::stages::Timing;
use crate::pool::{Cancel, QueueKey, Ticket, WorkClass};
use crate::problem::{Code, Problem};
use crate::session::{Revision, SessionId};
use crate::store::{NamedFile, Record, StoredLayer};
use crate::wire::formats::Formats;
use crate::wire::landmarks::Landmarks;
use crate::wire::{Pose, Reserved, WarpObject, WarpPatch, method_text};

/// Attempts of a request at a session that other requests change at the same time.
pub(crate) const SESSION_ATTEMPTS: usize = 8;

/// What a client has uploaded.
#[derive(Debug)]
pub struct Upload {
    /// The image file.
    pub(crate) image: Bytes,
    /// The warp object.
    pub(crate) warp: Bytes,
    /// The mask of what moves, if it is not the whole picture.
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

/// A resolved upload: what a warp is drawn from, and what a session keeps.
#[derive(Debug)]
pub struct PreparedWarp {
    file: Bytes,
    pub(crate) digest: Digest,
    object: Held<WarpObject>,
    /// The pose as it was sent, in the memory of the object.
    pose: Option<Pose>,
    q: Arc<Held<Vec<Handle>>>,
    /// The format of this response; a session keeps the requested one.
    format: Format,
    image: Arc<CacheEntry<Image>>,
    region: Option<(NamedFile, Arc<CacheEntry<Image>>)>,
    setup: HeldSetup,
}

/// What is stored of a new session, and its setup.
pub(crate) struct NewSession {
    pub(crate) record: Arc<Record>,
    pub(crate) files: Vec<NamedFile>,
    pub(crate) setup: HeldSetup,
}

impl PreparedWarp {
    /// The digests of its files.
    pub(crate) fn files(&self) -> impl Iterator<Item = Digest> {
        std::iter::once(self.digest).chain(self.region.as_ref().map(|(file, _)| file.digest))
    }

    /// The method that was chosen, if that was requested, as a header shows it.
    pub(crate) fn chosen_method(&self) -> Option<String> {
        self.object.is_auto.then(|| method_text(&self.object.rest))
    }

    /// The record, files and setup of a session.
    pub(crate) fn into_session(self, id: SessionId) -> NewSession {
        let Self {
            file,
            digest,
            object,
            pose,
            image,
            region,
            setup,
            ..
        } = self;
        let (object, _held) = object.into_parts();
        let region = region.map(|(file, _)| file);
        let made_with_region = region.as_ref().map(|file| file.digest);
        let layer = |digest| {
            (
                LayerName::region(),
                StoredLayer {
                    kind: LayerKind::Image,
                    digest,
                },
            )
        };
        let record = Record {
            id,
            revision: Revision::random(),
            image: digest,
            layers: made_with_region.map(layer).into_iter().collect(),
            made_with_region,
            extent: image.extent(),
            rest: object.rest,
            pose,
            folds: object.folds,
            output: object.output,
            created: SystemTime::now(),
        };
        let files = std::iter::once(NamedFile {
            digest,
            bytes: file,
        })
        .chain(region)
        .collect();
        NewSession {
            record: Arc::new(record),
            files,
            setup,
        }
    }
}

impl App {
    /// Settles the pose, chooses the method if that was requested, resolves the handles on an image
    /// of this extent, and checks `q` if it was sent. Runs on the pool. Errors: Wrong handles, or
    /// too little memory.
    pub(crate) fn resolve(
        &self,
        mut object: Held<WarpObject>,
        extent: Extent,
        cancel: &Cancel,
    ) -> Result<Resolved, Problem> {
        object.output.check(extent, &self.0.config.limits())?;
        object.leave_out_missing();
        let q = object.q.clone().filter(|_| !object.rest.p.is_empty());
        let pose = q.map(|q| Pose {
            q,
            strength: object.strength,
        });
        let alignment = object.settle_pose(extent)?;
        self.choose_method(&mut object, extent, cancel)?;
        let setup = self.new_setup(&object.rest, extent, cancel)?;
        object.q.as_deref().map(|q| setup.pose(q)).transpose()?;
        let q = part(&mut object, |object| object.q.take().unwrap_or_default());
        Ok(Resolved {
            object,
            pose,
            q,
            alignment,
            setup: Arc::new(setup),
        })
    }

    /// Resolves rest handles in memory that is reserved before. Runs on the pool.
    /// Errors: Wrong handles, or too little memory.
    pub(crate) fn new_setup(
        &self,
        rest: &RestSpec,
        extent: Extent,
        cancel: &Cancel,
    ) -> Result<CacheEntry<ResolvedRest>, Problem> {
        let held = self.reserve(MemoryClass::Plan, setup_weight(rest))?;
        let setup = ResolvedRest::new_unless(rest, extent, &self.0.config.limits(), &|| {
            cancel.is_cancelled()
        })?;
        Ok(CacheEntry::new(setup, held))
    }

    /// Draws an image from a file and a warp object with `q`.
    /// Errors: A wrong file or object, or too little capacity.
    pub async fn warp_once(
        &self,
        client: Client,
        upload: Upload,
        formats: Formats,
    ) -> Result<(Drawn, PreparedWarp), Problem> {
        let ticket = self
            .0
            .pool
            .admit(WorkClass::Upload, QueueKey::client(client))
            .await?;
        let (prepared, planned) = self.prepare(client, &ticket, upload, Some(formats)).await?;
        let q = Arc::clone(&prepared.q);
        let (folds, output) = (
            prepared.object.folds,
            OutputSpec {
                format: prepared.format,
                ..prepared.object.output
            },
        );
        let job = DrawJob {
            content: DrawnContent::image(
                &prepared.image,
                prepared.region.as_ref().map(|(_, mask)| mask),
            ),
            planned,
            q,
            folds,
            output,
            preview: None,
            force_alpha: false,
            quota: self.response_quota(client),
        };
        Ok((self.draw(ticket, job).await?, prepared))
    }

    /// The resolved setup of a session.
    /// Errors: Too little capacity.
    pub(crate) async fn session_setup(
        &self,
        client: Client,
        record: &Arc<Record>,
    ) -> Result<HeldSetup, Problem> {
        let (app, build_record) = (self.clone(), Arc::clone(record));
        let build = async move {
            let record = build_record;
            let ticket = app
                .0
                .pool
                .admit(WorkClass::Upload, QueueKey::session(client, record.id))
                .await?;
            let pool = app.0.pool.clone();
            pool.run(&ticket, move |cancel| {
                app.new_setup(&record.rest, record.extent, cancel)
            })
            .await?
        };
        let setup = self
            .0
            .setups
            .get(revision_key(record), client.payer(), build, build_aborted)
            .await?;
        Ok(setup.value)
    }

    /// Parses the object, decodes the file, resolves the handles, checks `q` and builds the plan.
    /// `formats`: the formats that the client accepts, if an image is drawn, for which `q` is
    /// required.
    pub(crate) async fn prepare(
        &self,
        client: Client,
        ticket: &Ticket,
        upload: Upload,
        formats: Option<Formats>,
    ) -> Result<(PreparedWarp, Planned), Problem> {
        let Upload {
            image: file,
            warp: json,
            region,
            landmarks,
        } = upload;
        let has_landmarks = landmarks.is_some();
        let mut timing = Timing {
            queue: ticket.waited(),
            ..Timing::default()
        };
        let began = Instant::now();
        let (hashed_file, reserve) = (file.clone(), self.reserving(MemoryClass::Upload, client));
        let parse = move |_: &_| {
            let mut patch =
                Reserved::<WarpPatch, _>::parse(&json, reserve).map_err(in_part_warp)?;
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
        let (object, format, digest) = self.0.pool.run(ticket, parse).await??;
        if formats.is_some() {
            match &landmarks {
                Some(landmarks) => landmarks.require_q()?,
                None => drop(object.posed()?),
            }
        }
        let Fetched {
            value: image,
            built,
        } = self
            .decode_image(client, ticket, digest, file.clone())
            .await?;
        if formats.is_some() && built {
            // An image that is warped once, and its mask, are evicted before those of sessions.
            self.0.images.demote(CacheKey::new(client.owner, digest));
        }
        let region = match region {
            Some(bytes) => {
                let digest = self
                    .check_layer(ticket, bytes.clone(), image.extent())
                    .await
                    .map_err(in_part_region)?;
                let Fetched { value: mask, built } = self
                    .decode_image(client, ticket, digest, bytes.clone())
                    .await
                    .map_err(in_part_region)?;
                check_extent(mask.extent(), image.extent()).map_err(in_part_region)?;
                if formats.is_some() && built {
                    self.0.images.demote(CacheKey::new(client.owner, digest));
                }
                Some((NamedFile { digest, bytes }, mask))
            }
            None => None,
        };
        timing.decode = began.elapsed();
        stage("decode", began);
        RasterSource::Image(&image).check(&object.output)?;
        let (app, extent) = (self.clone(), image.extent());
        let resolve = move |cancel: &Cancel| {
            let mut object = object;
            if let Some(landmarks) = landmarks {
                object = place_in(landmarks, object, extent)?;
            }
            app.resolve(object, extent, cancel)
        };
        let Resolved {
            object,
            pose,
            q,
            setup,
            ..
        } = self.0.pool.run(ticket, resolve).await??;
        let planned = self.plan(client, ticket, &setup, timing).await?;
        let q = Arc::new(q);
        Ok((
            PreparedWarp {
                file,
                digest,
                object,
                pose,
                q,
                format,
                image,
                region,
                setup,
            },
            planned,
        ))
    }

    /// The plan of a setup, from the cache or built now; adds its cost to `timing`.
    pub(crate) async fn plan(
        &self,
        client: Client,
        ticket: &Ticket,
        setup: &HeldSetup,
        mut timing: Timing,
    ) -> Result<Planned, Problem> {
        let began = Instant::now();
        let (app, ticket, build_setup) = (self.clone(), ticket.clone(), Arc::clone(setup));
        let build = async move {
            let bytes = build_setup.plan_bytes().unwrap_or_default().max(MIN_WEIGHT);
            let reservation = app
                .reserve_aside(|budget| budget.take(MemoryClass::Plan, bytes))
                .await?;
            let threads = app.0.pool.clone();
            let fill = move |cancel: &Cancel| {
                threads.run_parallel(|| build_setup.plan_unless(&|| cancel.is_cancelled()))
            };
            let plan = app.0.pool.run(&ticket, fill).await??;
            tracing::debug!("a plan was built");
            Ok(CacheEntry::new(plan, reservation))
        };
        let key = CacheKey::new(client.owner, setup.plan_key());
        let Fetched { value: plan, built } = self
            .0
            .plans
            .get(key, client.payer(), build, build_aborted)
            .await?;
        timing.plan = began.elapsed();
        stage("plan", began);
        Ok(Planned {
            setup: Arc::clone(setup),
            plan,
            timing,
            is_built: built,
        })
    }
}

/// Adds the name of the part to an error without a JSON pointer.
fn in_part_warp(mut problem: Problem) -> Problem {
    if problem.code == Code::MalformedRequest && problem.pointer.is_none() {
        problem.detail.insert_str(0, "the part `warp`: ");
    }
    problem
}

/// Adds the name of the part.
fn in_part_region(mut problem: Problem) -> Problem {
    problem.detail.insert_str(0, "the part `region`: ");
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

/// A resolved warp object without its posed handles, and those; none of them if there were none.
#[derive(Debug)]
pub(crate) struct Resolved {
    pub(crate) object: Held<WarpObject>,
    /// The pose as it was sent, if there are handles, in the memory of the object.
    pub(crate) pose: Option<Pose>,
    pub(crate) q: Held<Vec<Handle>>,
    /// How q was aligned, if that was requested.
    pub(crate) alignment: Option<Alignment>,
    pub(crate) setup: HeldSetup,
}

/// The cache key of what belongs to one revision of a session: its setup. Records never change.
pub(crate) fn revision_key(record: &Record) -> CacheKey {
    CacheKey::new(
        record.id.owner(),
        Digest::of(&[&record.id.to_bytes()[..], record.revision.as_bytes()].concat()),
    )
}

/// The number of columns of a session's plan, which limits the size of its drags.
pub fn columns(record: &Record) -> u64 {
    columns_of(&record.rest)
}

fn columns_of(rest: &RestSpec) -> u64 {
    rest.p.iter().map(|h| h.columns() as u64).sum()
}

/// The approximate size of a setup: a few copies of each column's position and weight, and the
/// system of a spline.
pub(crate) fn setup_weight(rest: &RestSpec) -> u64 {
    1024 + 256 * columns_of(rest) + rest.field_bytes()
}
