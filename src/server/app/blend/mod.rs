//! `POST /blend`: averages, morphs, caricatures and transforms. The images are taken one after
//! another, each in a place of the queue of its own, and added to one sum; what is drawn of the sum
//! is drawn like any other image.

mod prepare;

use std::sync::Arc;

use bytes::Bytes;
use mlswarp::codec::Format;
use mlswarp::deform::Handle;
use mlswarp::pixmap::Extent;
use mlswarp::render::Canvas;
use mlswarp::warp::blend::{BlendedShape, ImageSum, MirrorPairs};
use mlswarp::warp::{
    CanvasSpec, Digest, Folds, Image, OutputSpec, PosedMesh, RasterSource, RestSpec, Target,
    Warning, WarpError,
};

use super::App;
use super::batch::{BatchForm, DEFAULT_DELAY_MS, Package};
use super::draw::{DrawJob, Drawn};
use super::drawable::DrawnContent;
use super::json_text::cancellable_json;
use super::parts::plans::HeldSetup;
use super::reading::{Held, part};
use crate::cache::{CacheEntry, CacheKey};
use crate::client::Client;
use crate::limits::free::FreedAside;
use crate::limits::memory::{MemoryClass, Reservation};
use crate::observe::stages::Timing;
use crate::pool::{Cancel, QueueKey, Ticket, aside};
use crate::problem::{Code, Problem};
use crate::store::Record;
use crate::wire::blend::{BlendObject, BlendReport};
use crate::wire::formats::Formats;
use crate::wire::{AsJson, Reserved};
use prepare::{in_image, prepare};

/// What a client has uploaded.
#[derive(Debug, Default)]
pub(crate) struct BlendUpload {
    /// The image files, in order.
    pub(crate) images: Vec<Bytes>,
    /// Landmark files: one for each image, in the same order.
    pub(crate) landmarks: Vec<Bytes>,
    /// The object.
    pub(crate) blend: Bytes,
}

/// The response.
pub(crate) enum BlendAnswer {
    /// One image.
    Picture(Box<Drawn>),
    /// A file of several: its first bytes, and the others.
    Package(BatchForm, Bytes, Box<BlendStream>),
}

/// Where the pixels of an image come from.
#[derive(Clone, Debug)]
enum BlendedSource {
    File(Digest, Bytes),
    Session(Arc<Record>),
}

/// One image of a blend, before it is decoded.
#[derive(Debug)]
struct SourceImage {
    pub(super) source: BlendedSource,
    pub(super) extent: Extent,
    /// Its landmarks, px.
    pub(super) p: Vec<Handle>,
    /// Which handles are each other's mirror images, if the mirror image is meant.
    pub(super) pairs: Option<MirrorPairs>,
}

/// A blend whose shapes are known.
#[derive(Debug)]
struct BlendJob {
    pub(super) app: App,
    pub(super) client: Client,
    pub(super) object: Held<BlendObject>,
    pub(super) images: FreedAside<Vec<SourceImage>>,
    pub(super) shapes: FreedAside<BlendedShape>,
    pub(super) canvas: Canvas,
    pub(super) target: Target,
    pub(super) format: Format,
}

/// A finished sum.
struct BlendedFrame {
    image: Arc<CacheEntry<Image>>,
    landmarks: Arc<Vec<Handle>>,
    report: BlendReport,
    warnings: Vec<Warning>,
}

/// The frames of a blend, made as they are taken.
pub(crate) struct BlendStream {
    job: Arc<BlendJob>,
    form: BatchForm,
    done: usize,
    /// `None` after the end.
    package: Option<Package>,
    reports: Vec<BlendReport>,
    warnings: Vec<Warning>,
}

/// Reads a blend and makes its first frame. `form`: a file of several parts, if the client wants
/// one; `takes_archive`: whether it takes an archive where there are several frames.
/// Errors: A wrong object, image or landmark file; images that do not fit together; too little
/// capacity.
pub(crate) async fn once(
    app: &App,
    client: Client,
    upload: BlendUpload,
    formats: Formats,
    (form, takes_archive): (Option<BatchForm>, bool),
) -> Result<BlendAnswer, Problem> {
    let job = Arc::new(prepare(app, client, upload, formats, form).await?);
    let form = match form {
        None if job.object.frames > 1 && takes_archive => Some(BatchForm::Zip),
        None if job.object.frames > 1 => {
            let detail = "a blend of several frames is an archive or an animation: accept \
                `application/zip`, `image/apng` or `image/gif`";
            return Err(Problem::new(Code::NotAcceptable, detail));
        }
        form => form,
    };
    let Some(form) = form else {
        let BlendedFrame {
            image, warnings, ..
        } = job.frame(0).await?;
        let mut drawn = job.draw(image).await?;
        drawn.report.warnings.extend(warnings);
        return Ok(BlendAnswer::Picture(Box::new(drawn)));
    };
    let frames = u32::try_from(job.object.frames).unwrap_or(u32::MAX);
    let mut stream = Box::new(BlendStream {
        package: Some(Package::new(form, frames, DEFAULT_DELAY_MS, 0)),
        job,
        form,
        done: 0,
        reports: Vec::new(),
        warnings: Vec::new(),
    });
    let first = stream
        .next()
        .await
        .unwrap_or_else(|| Err(Problem::new(Code::Internal, "a blend without frames")))?;
    Ok(BlendAnswer::Package(form, first, stream))
}

impl BlendJob {
    /// Makes the sum of one frame.
    async fn frame(self: &Arc<Self>, frame: usize) -> Result<BlendedFrame, Problem> {
        let (shape, colour) = (
            self.object.shape_weights(frame),
            self.object.colour_weights(frame),
        );
        let quota = self.app.admission.response_quota(self.client);
        let bytes = ImageSum::bytes(self.target.extent);
        let mut memory = self
            .app
            .admission
            .reserve_aside(|budget| budget.take_for(MemoryClass::Frame, &quota, bytes))
            .await?;
        let (job, weights) = (Arc::clone(self), (shape.clone(), colour.clone()));
        let begin = move |_: &Cancel| {
            let BlendJob { canvas, target, .. } = &*job;
            (
                Arc::new(job.shapes.target(&weights.0)),
                ImageSum::new(*canvas, target.extent, job.object.space, &weights.1),
            )
        };
        let (target, mut sum) = self.ticket().await?.run(begin).await?;
        let (mut folds, mut warnings) = (Vec::new(), Vec::new());
        for (index, weight) in colour.iter().enumerate() {
            // An image that adds no colour is needed only for the metadata of the result.
            if *weight == 0.0 && index > 0 {
                folds.push(0);
                continue;
            }
            let added = self.add(index, *weight, &target, sum).await;
            let report;
            (sum, report) = added.map_err(|problem| match problem.code {
                Code::Overloaded | Code::Internal => problem,
                _ if problem.pointer.is_some() => problem,
                _ => in_image(index, problem),
            })?;
            folds.push(report.0);
            warnings.extend(report.1);
        }
        let (job, ticket) = (Arc::clone(self), self.ticket().await?);
        let finish = move |cancel: &Cancel| {
            let finished = sum.finish(&|| cancel.is_cancelled())?;
            Ok::<_, WarpError>(finished.map(|finished| (finished, job.shapes.kept().to_vec())))
        };
        let (finished, kept) = ticket
            .run(finish)
            .await??
            .ok_or_else(|| Problem::new(Code::Internal, "a blend without images"))?;
        memory.shrink_to(finished.image.bytes());
        let extent = self.target.extent;
        let report = BlendReport {
            picture: String::new(),
            shape,
            colour,
            clamped: finished.clamped,
            folds,
            width: extent.width(),
            height: extent.height(),
            canvas: AsJson(self.canvas),
            landmarks: kept,
        };
        Ok(BlendedFrame {
            image: Arc::new(CacheEntry::new(finished.image, memory)),
            landmarks: target,
            report,
            warnings: Warning::in_order(warnings),
        })
    }

    async fn ticket(&self) -> Result<Ticket, Problem> {
        let key = QueueKey::client(self.client);
        Ok(self.app.admission.upload(key).await?)
    }

    /// Decodes an image, warps it to the target shape, and adds it to the sum.
    async fn add(
        self: &Arc<Self>,
        index: usize,
        weight: f64,
        target: &Arc<Vec<Handle>>,
        mut sum: ImageSum,
    ) -> Result<(ImageSum, (u64, Vec<Warning>)), Problem> {
        let (app, client) = (&self.app, self.client);
        let ticket = self.ticket().await?;
        let content = match &self.images[index].source {
            BlendedSource::File(digest, file) => {
                let image = app
                    .images
                    .decode_image(client, &ticket, *digest, file.clone());
                let image = image.await?;
                if image.built {
                    let key = CacheKey::new(client.owner, *digest);
                    app.images.images.demote(key);
                }
                DrawnContent::image(image.value, None)
            }
            BlendedSource::Session(record) => {
                let sources = match app.images.fetch(client, record, None).await {
                    Ok(sources) => sources,
                    Err(problem) => return Err(app.sessions.replaced(record, problem).await),
                };
                app.images.decode(client, &ticket, sources).await?
            }
        };
        let setup = self.setup(index, &ticket, &content).await?;
        let planned = app
            .plans
            .plan(client, &ticket, &setup, Timing::default())
            .await?;
        // Later frames need it again, and no other client does.
        if planned.is_built {
            app.plans.demote(client.owner, &setup);
        }
        let (job, target, threads) = (Arc::clone(self), Arc::clone(target), app.pool().clone());
        let add = move |cancel: &Cancel| {
            let is_cancelled = || cancel.is_cancelled();
            let RasterSource::Image(image) = content.raster_source() else {
                return Err(not_an_image());
            };
            let frame = job.images[0].extent.width();
            let pairs = job.images[index].pairs.as_ref();
            let drawn = match pairs {
                Some(pairs) => &pairs.mirrored(&target, f64::from(frame)),
                None => &*target,
            };
            let q = job.shapes.posed(index, drawn);
            let _held = job.app.admission.reserve(
                MemoryClass::Plan,
                setup.posed_bytes() + setup.most_extra_bytes(Folds::Report, false),
            )?;
            let (posed, sum) = threads.run_parallel(|| {
                let pose = setup.pose(&q)?;
                let (plan, folds) = (&planned.plan, Folds::Report);
                let posed = PosedMesh::new(&setup, plan, &pose, folds, &is_cancelled)?;
                let (how, output) = ((weight, pairs.map(|_| frame)), &job.object.output);
                // Drags of the same image may wait for its copies: no giving way meanwhile.
                sum.make_copies(image, &posed, how, output, &|| cancel.is_gone())?;
                sum.add(image, &posed, how, output, &is_cancelled)?;
                Ok::<_, WarpError>((posed, sum))
            })?;
            let report = posed.report();
            let warnings = report.warnings.clone();
            Ok::<_, Problem>((sum, (report.folds, warnings)))
        };
        ticket.run(add).await?
    }

    /// The landmarks of an image, resolved on it.
    async fn setup(
        self: &Arc<Self>,
        index: usize,
        ticket: &Ticket,
        content: &DrawnContent,
    ) -> Result<HeldSetup, Problem> {
        let (job, content) = (Arc::clone(self), content.clone());
        let resolve = move |cancel: &Cancel| {
            let RasterSource::Image(image) = content.raster_source() else {
                return Err(not_an_image());
            };
            RasterSource::Image(image).check(&job.object.output)?;
            let rest = RestSpec {
                p: job.images[index].p.clone(),
                ..job.object.rest.clone()
            };
            let plans = &job.app.plans;
            plans
                .new_setup(&rest, image.extent(), None, cancel)
                .map(Arc::new)
        };
        ticket.run(resolve).await?
    }

    /// What the drawing of a finished sum needs: an image that nothing moves.
    async fn draw_job(
        &self,
        ticket: &Ticket,
        image: Arc<CacheEntry<Image>>,
    ) -> Result<DrawJob, Problem> {
        let (app, extent) = (self.app.clone(), image.extent());
        let setup = ticket
            .run(move |cancel| {
                app.plans
                    .new_setup(&RestSpec::default(), extent, None, cancel)
            })
            .await??;
        let planned = self
            .app
            .plans
            .plan(self.client, ticket, &Arc::new(setup), Timing::default())
            .await?;
        let quota = self.app.admission.response_quota(self.client);
        let reserve = self
            .app
            .admission
            .reserving(MemoryClass::Upload, self.client);
        let mut nothing = Reserved::<BlendObject, Reservation>::parse(EMPTY, reserve)?;
        Ok(DrawJob {
            content: DrawnContent::image(image, None),
            planned,
            q: Arc::new(part(&mut nothing, |_| Vec::new())),
            folds: Folds::Report,
            output: OutputSpec {
                format: self.format,
                canvas: CanvasSpec::Same,
                width: None,
                ..self.object.output
            },
            preview: None,
            force_alpha: self.object.frames > 1 && self.format.info().has_alpha,
            quota,
        })
    }

    async fn draw(&self, image: Arc<CacheEntry<Image>>) -> Result<Drawn, Problem> {
        let ticket = self.ticket().await?;
        let job = self.draw_job(&ticket, image).await?;
        self.app.drawing.draw(ticket, job).await
    }

    /// The file of a finished sum, and its landmarks as JSON.
    async fn files(
        &self,
        image: Arc<CacheEntry<Image>>,
        landmarks: Arc<Vec<Handle>>,
    ) -> Result<(Bytes, Bytes), Problem> {
        let ticket = self.ticket().await?;
        let job = self.draw_job(&ticket, image).await?;
        let app = self.app.clone();
        let write = move |cancel: &Cancel| {
            let drawn = app.drawing.draw_file(&job, cancel)?;
            let object = serde_json::json!({"p": AsJson(&landmarks[..])});
            let json = cancellable_json(cancel, &object, 0)?;
            Ok::<_, Problem>((drawn.first.bytes, json.into()))
        };
        ticket.run(write).await?
    }
}

fn not_an_image() -> Problem {
    Problem::new(Code::Internal, "an image is blended")
}

/// A blend of nothing, whose memory is that of a pose without handles.
const EMPTY: &[u8] = b"{\"images\": [{\"image\": 0}]}";

impl BlendStream {
    /// The number of frames.
    pub(crate) fn frames(&self) -> usize {
        self.job.object.frames
    }

    /// The warnings of the frames that were made.
    pub(crate) fn warnings(&self) -> &[Warning] {
        &self.warnings
    }

    /// The next bytes; `None` at the end, also after an error.
    pub(crate) async fn next(&mut self) -> Option<Result<Bytes, Problem>> {
        let package = self.package.take()?;
        if self.done >= self.frames() {
            let reports = std::mem::take(&mut self.reports);
            let finish = move || {
                let index = serde_json::json!({"frames": reports});
                let index = serde_json::to_vec(&index).unwrap_or_default();
                package.finish("report.json", &index).map(Bytes::from)
            };
            return Some(aside(true, finish).await);
        }
        let made = self.frame(package).await;
        Some(made.map(|(package, bytes)| {
            self.done += 1;
            self.package = Some(package);
            bytes
        }))
    }

    async fn frame(&mut self, mut package: Package) -> Result<(Package, Bytes), Problem> {
        let BlendedFrame {
            image,
            landmarks,
            mut report,
            warnings,
        } = self.job.frame(self.done).await?;
        let (picture, of_landmarks) = if self.frames() == 1 {
            ("image".to_owned(), "landmarks.json".to_owned())
        } else {
            (
                format!("{:04}", self.done),
                format!("{:04}.json", self.done),
            )
        };
        report.picture = format!("{picture}.{}", self.job.format.extension());
        let name = report.picture.clone();
        self.reports.push(report);
        let warnings = self.warnings.drain(..).chain(warnings).collect();
        self.warnings = Warning::in_order(warnings);
        let (file, json) = self.job.files(image, landmarks).await?;
        let form = self.form;
        let append = move || {
            let packed = form.pack(vec![(name, file), (of_landmarks, json)])?;
            let bytes = package.push(packed)?.into();
            Ok((package, bytes))
        };
        aside(true, append).await
    }
}
