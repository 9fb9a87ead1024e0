//! The walk of one request through the warp: file and handles to all that a picture is made of. CPU work runs on the pool, under one ticket a
//! request; a warm drag is handed over once, to be posed and drawn (`picture`).

use std::io;
use std::sync::Arc;
use std::time::{Instant, SystemTime};

use bytes::Bytes;
use mlswarp::codec::{self, CodecError, Format};
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Digest, Image, Limits, OutputSpec, Plan, Setup, WarpError};
use serde::Serialize;

use super::App;
use super::causes::Origin;
use super::draw::{DrawJob, Drawn};
use crate::cache::{CacheEntry, Fetched, Key};
use crate::client::{Client, Owner};
use crate::limits::memory::Purpose;
use crate::observe::scope::stage;
use crate::observe::stages::Timing;
use crate::pool::{Cancel, PoolError, QueueKey, Ticket, Work};
use crate::problem::{Code, Problem};
use crate::session::{Revision, SessionId};
use crate::store::Record;
use crate::wire::formats::Formats;
use crate::wire::{WarpObject, WarpPatch};

/// Attempts of a request to work on a session that others change at the same time.
pub(crate) const ATTEMPTS: usize = 8;
/// What stands for a value that takes next to nothing: nothing is kept for nothing.
const LEAST_KEPT: u64 = 1024;

/// What a warp is made of, and what a session keeps.
#[derive(Debug)]
pub struct PreparedWarp {
    file: Bytes,
    pub(crate) digest: Digest,
    object: WarpObject,
    /// Of this picture; a session keeps what was asked for.
    format: Format,
    image: Arc<CacheEntry<Image>>,
    setup: Arc<Setup>,
}

impl PreparedWarp {
    /// As a session keeps it: the record, the file, and what they resolve to.
    pub(crate) fn recorded(self, id: SessionId) -> (Arc<Record>, Bytes, Arc<Setup>) {
        let Self { file, digest, object, image, setup, .. } = self;
        let record = Record {
            id,
            revision: Revision::random(),
            image: digest,
            extent: image.extent(),
            rest: object.rest,
            folds: object.folds,
            output: object.output,
            created: SystemTime::now(),
        };
        (Arc::new(record), file, setup)
    }
}

/// What a session's picture comes from.
pub(crate) enum Source {
    Image(Arc<CacheEntry<Image>>),
    File(File),
}

/// A file that was fetched from the store, with the memory that it takes.
pub(crate) struct File(Arc<CacheEntry<Bytes>>);

impl AsRef<[u8]> for File {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

impl App {
    /// A picture from a file and a warp object with `q`.
    ///
    /// # Errors
    /// Whatever is wrong with either, or no room.
    pub async fn warp_once(&self, client: Client, file: Bytes, json: Bytes, formats: Formats) -> Result<(Drawn, PreparedWarp), Problem> {
        let ticket = self.0.pool.admit(Work::Upload, QueueKey::client(client)).await?;
        let (material, plan, timing, plan_built) = self.prepare(client.owner, &ticket, file, json, Some(formats)).await?;
        let q = material.object.q.clone().unwrap_or_default();
        let (folds, output) = (material.object.folds, OutputSpec { format: material.format, ..material.object.output });
        let (image, setup) = (Arc::clone(&material.image), Arc::clone(&material.setup));
        let drawn =
            self.draw(ticket, DrawJob { image, setup, plan, q, folds, output, share: self.share(client) }, timing, plan_built).await?;
        Ok((drawn, material))
    }

    /// The session's resolved setup.
    ///
    /// # Errors
    /// No room.
    pub async fn session_setup(&self, client: Client, record: &Arc<Record>) -> Result<Arc<Setup>, Problem> {
        let (app, theirs) = (self.clone(), Arc::clone(record));
        let build = async move {
            let ticket = app.0.pool.admit(Work::Upload, QueueKey::session(client, theirs.id)).await?;
            let held = app.reserve(Purpose::Plan, weight(&theirs))?;
            let limits = app.0.config.limits;
            let new = move |cancel: &Cancel| Setup::new_unless(&theirs.rest, theirs.extent, &limits, &|| cancel.is_cancelled());
            let setup = app.0.pool.run(&ticket, new).await??;
            Ok(CacheEntry::new(Arc::new(setup), held))
        };
        let known = self.0.setups.get(setup_key(record), build, build_aborted).await?;
        Ok(Arc::clone(&known.value))
    }

    /// Reads the object, decodes the file, resolves the handles, checks q, fills the table. `draws`: what a picture may be written as, and that q is
    /// needed for it.
    pub(crate) async fn prepare(
        &self,
        owner: Owner,
        ticket: &Ticket,
        file: Bytes,
        json: Bytes,
        draws: Option<Formats>,
    ) -> Result<(PreparedWarp, Arc<CacheEntry<Plan>>, Timing, bool), Problem> {
        let mut timing = Timing { queue: ticket.waited(), ..Timing::default() };
        let began = Instant::now();
        let read = {
            let file = file.clone();
            move |_: &_| {
                let patch = WarpPatch::parse(&json).map_err(of_the_part)?;
                let asked = patch.output.format;
                let object = patch.merge_onto(WarpObject::default());
                let format = draws.unwrap_or(Formats::ANY).choose(asked, object.output.format)?;
                Ok::<_, Problem>((object, format, Image::digest_of(&file)))
            }
        };
        let (object, format, digest) = self.0.pool.run(ticket, read).await??;
        if draws.is_some() && object.q.is_none() && !object.rest.p.is_empty() {
            return Err(q_is_missing());
        }
        let Fetched { value: image, built } = self.image(owner, ticket, digest, file.clone()).await?;
        if draws.is_some() && built {
            // Pictures that are bent once must not drive those of sessions out.
            self.0.images.demote(Key::new(owner, digest));
        }
        timing.decode = began.elapsed();
        stage("decode", began);
        let (limits, extent) = (self.0.config.limits, image.extent());
        let (object, setup) = self.0.pool.run(ticket, move |cancel| resolve(object, extent, &limits, cancel)).await??;
        let (plan, plan_built) = self.plan(owner, ticket, &setup, Origin::Handles, &mut timing).await?;
        Ok((PreparedWarp { file, digest, object, format, image, setup }, plan, timing, plan_built))
    }

    async fn image(
        &self,
        owner: Owner,
        ticket: &Ticket,
        digest: Digest,
        file: impl AsRef<[u8]> + Send + 'static,
    ) -> Result<Fetched<Image>, Problem> {
        let (app, ticket, limits) = (self.clone(), ticket.clone(), self.0.config.limits.image);
        let decode = async move {
            let theirs = app.clone();
            let decode = move |cancel: &Cancel| {
                let gone = || cancel.is_cancelled();
                let work = codec::StepCounter::new(&gone);
                let opened = codec::open(file.as_ref(), &limits, &work).map_err(WarpError::from)?;
                let mut held = theirs.reserve(Purpose::Image, Image::peak_bytes(&opened))?;
                let image = Image::decode_as(digest, &opened)?;
                held.shrink_to(image.bytes());
                Ok(CacheEntry::new(image, held))
            };
            match app.0.pool.run(&ticket, decode).await {
                // Decoders are known to panic on hostile files: the file is at fault, not the request's other parts.
                Err(PoolError::Panicked) => {
                    Err(WarpError::Codec(CodecError::Bad { format: "image", detail: "its decoder gave up".to_owned() }).into())
                }
                Err(error) => Err(error.into()),
                Ok(decoded) => decoded,
            }
        };
        self.0.images.get(Key::new(owner, digest), decode, build_aborted).await
    }

    /// The session's picture, or the file that it is decoded from when the cache has dropped it. The store is asked here and under no ticket: a store
    /// that is slow keeps no worker from others.
    pub(crate) async fn session_source(&self, client: Client, record: &Arc<Record>) -> Result<Source, Problem> {
        if let Some(image) = self.0.images.peek(image_key(record)) {
            return Ok(Source::Image(image));
        }
        let (app, theirs) = (self.clone(), Arc::clone(record));
        let fetch = async move {
            let _turn = app.0.pool.admit(Work::Transfer, QueueKey::session(client, theirs.id)).await?;
            let bytes = app.0.store.image_bytes(theirs.id, theirs.image).await?;
            let mut held = app.reserve(Purpose::Image, bytes.max(LEAST_KEPT))?;
            let file = app.0.store.image(theirs.id, theirs.image).await?;
            held.shrink_to((file.len() as u64).max(LEAST_KEPT));
            Ok(CacheEntry::new(file, held))
        };
        Ok(Source::File(File(self.0.files.get(setup_key(record), fetch, build_aborted).await?.value)))
    }

    /// The picture of its source.
    pub(crate) async fn session_image(&self, ticket: &Ticket, record: &Record, source: Source) -> Result<Arc<CacheEntry<Image>>, Problem> {
        match source {
            Source::Image(image) => Ok(image),
            Source::File(file) => Ok(self.image(record.id.owner(), ticket, record.image, file).await?.value),
        }
    }

    pub(crate) async fn plan(
        &self,
        owner: Owner,
        ticket: &Ticket,
        setup: &Arc<Setup>,
        origin: Origin,
        timing: &mut Timing,
    ) -> Result<(Arc<CacheEntry<Plan>>, bool), Problem> {
        let began = Instant::now();
        let (app, ticket, theirs) = (self.clone(), ticket.clone(), Arc::clone(setup));
        let key = Key::new(owner, setup.plan_key());
        let build = async move {
            let held = app.reserve(Purpose::Plan, theirs.plan_bytes().unwrap_or_default().max(LEAST_KEPT))?;
            let threads = app.0.pool.clone();
            let fill = move |cancel: &Cancel| threads.run_parallel(|| theirs.plan_unless(&|| cancel.is_cancelled()));
            let plan = app.0.pool.run(&ticket, fill).await??;
            let cause = app.0.causes.built(key, origin);
            tracing::debug!(cause = cause.name(), "a plan was built");
            Ok(CacheEntry::new(plan, held))
        };
        let fetched = self.0.plans.get(key, build, build_aborted).await?;
        timing.plan = began.elapsed();
        stage("plan", began);
        Ok((fetched.value, fetched.built))
    }
}

/// Of two parts only one is JSON: which one cannot be read is said where the text has no place to point to.
fn of_the_part(mut problem: Problem) -> Problem {
    if problem.code == Code::MalformedRequest && problem.pointer.is_none() {
        problem.detail.insert_str(0, "the part `warp`: ");
    }
    problem
}

/// A warp of handles needs to know where they go.
pub(crate) fn q_is_missing() -> Problem {
    Problem::new(Code::BadValue, "q is missing: where do the handles go?").pointer("/q")
}

/// The task that built a cached value was torn down: the runtime is stopping.
pub(crate) fn build_aborted() -> Problem {
    PoolError::Panicked.into()
}

/// The setup of the handles on a picture of that size; q is checked when it is there.
pub(crate) fn resolve(object: WarpObject, extent: Extent, limits: &Limits, cancel: &Cancel) -> Result<(WarpObject, Arc<Setup>), WarpError> {
    let setup = Setup::new_unless(&object.rest, extent, limits, &|| cancel.is_cancelled())?;
    object.q.as_deref().map(|q| setup.pose(q)).transpose()?;
    Ok((object, Arc::new(setup)))
}

/// A value as JSON, in a buffer of that capacity at first; given up when it is cancelled.
pub(crate) fn json_unless(cancel: &Cancel, value: &impl Serialize, capacity: usize) -> Result<Vec<u8>, WarpError> {
    struct Text<'a>(Vec<u8>, &'a Cancel);
    impl io::Write for Text<'_> {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if self.1.is_cancelled() {
                return Err(io::ErrorKind::BrokenPipe.into());
            }
            self.0.write(bytes)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }
    let mut text = Text(Vec::with_capacity(capacity), cancel);
    serde_json::to_writer(&mut text, value).map_err(|_| WarpError::Cancelled)?;
    Ok(text.0)
}

/// Records never change, so name and revision stand for the setup.
pub(crate) fn setup_key(record: &Record) -> Key {
    Key::new(record.id.owner(), Digest::of(&[&record.id.to_bytes()[..], record.revision.as_bytes()].concat()))
}

/// The session's picture.
pub(crate) fn image_key(record: &Record) -> Key {
    Key::new(record.id.owner(), record.image)
}

/// Columns of a session's plan: what its drags may send follows from it.
#[must_use]
pub fn columns(record: &Record) -> u64 {
    record.rest.p.iter().map(|h| h.columns() as u64).sum()
}

/// About what a setup holds: a few copies of each column's place and weight.
pub(crate) fn weight(record: &Record) -> u64 {
    1024 + 256 * columns(record)
}
