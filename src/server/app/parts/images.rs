//! Images, layers and masks: read from the store, decoded on the pool, and cached.

use std::sync::Arc;

use bytes::Bytes;
use mlswarp::codec::{self, CodecError, StepCounter};
use mlswarp::pixmap::Extent;
use mlswarp::warp::{CanvasSpec, Digest, Image, ImageLimits, LabelImage, WarpError};

use super::admission::Admission;
use crate::app::MIN_WEIGHT;
use crate::app::drawable::{
    CachedFile, ContentSources, Drawable, DrawableSource, DrawnContent, Mask, find_layer,
};
use crate::cache::{Cache, CacheEntry, CacheKey, Fetched};
use crate::client::{Client, Owner};
use crate::layer::{LayerKind, LayerName, LayerRef, check_extent};
use crate::limits::memory::{Budget, BudgetExceeded, MemoryClass, Reservation};
use crate::observe::scope::in_stage;
use crate::pool::{Cancel, PoolError, QueueKey, Ticket};
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::store::{Record, Store};

/// Decoded files.
#[derive(Debug)]
pub(crate) struct Images {
    pub(crate) admission: Arc<Admission>,
    pub(crate) store: Arc<dyn Store>,
    pub(crate) limits: ImageLimits,
    pub(crate) images: Cache<Image>,
    pub(crate) labels: Cache<LabelImage>,
    /// Caches nothing; simultaneous requests for one session's file share one read of the store.
    pub(crate) files: Cache<Bytes>,
}

impl Images {
    /// The sources of a session's image or of a layer, and those of its region.
    /// Errors: There is no such layer; holes without a region; too little capacity.
    pub(crate) async fn fetch(
        self: &Arc<Self>,
        client: Client,
        record: &Record,
        layer: Option<&LayerRef>,
    ) -> Result<ContentSources, Problem> {
        let region = record.layers.get(&LayerName::region());
        let drawn = match layer {
            None => Some(
                self.fetch_source(client, record, LayerKind::Image, record.image)
                    .await?,
            ),
            Some(LayerRef::Coverage) => {
                Some(DrawableSource::Decoded(Drawable::Coverage(record.extent)))
            }
            Some(LayerRef::Holes) if region.is_none() => {
                let detail =
                    "`@holes` needs a region; store its mask with PUT /sessions/{id}/layers/region";
                return Err(Problem::new(Code::BadValue, detail).pointer("/layer"));
            }
            Some(LayerRef::Holes) => None,
            Some(LayerRef::Stored(name)) => {
                let (_, layer) = find_layer(record, name.as_str())
                    .map_err(|problem| problem.pointer("/layer"))?;
                Some(
                    self.fetch_source(client, record, layer.kind, layer.digest)
                        .await?,
                )
            }
        };
        let region = match region {
            Some(region) => Some(
                self.fetch_source(client, record, LayerKind::Image, region.digest)
                    .await?,
            ),
            None => None,
        };
        Ok(ContentSources { drawn, region })
    }

    /// Something with the region of a session, if there is one and the canvas depends on it: with a
    /// region, `fit` contains what stays.
    pub(crate) async fn region_of(
        self: &Arc<Self>,
        client: Client,
        record: &Record,
        canvas: CanvasSpec,
    ) -> Result<Option<DrawnContent>, Problem> {
        if canvas != CanvasSpec::Fit || !record.layers.contains_key(&LayerName::region()) {
            return Ok(None);
        }
        let sources = self.fetch(client, record, Some(&LayerRef::Holes)).await?;
        let key = QueueKey::session(client, record.id);
        let ticket = self.admission.upload(key).await?;
        self.decode(client, &ticket, sources).await.map(Some)
    }

    /// The image of a session and its region, decoded.
    /// Errors: Too little capacity; the files are gone.
    pub(crate) async fn content(
        self: &Arc<Self>,
        client: Client,
        record: &Record,
    ) -> Result<DrawnContent, Problem> {
        let sources = self.fetch(client, record, None).await?;
        let key = QueueKey::session(client, record.id);
        let ticket = self.admission.upload(key).await?;
        self.decode(client, &ticket, sources).await
    }

    /// A file of a session in decoded form, if that is cached, or its bytes.
    async fn fetch_source(
        self: &Arc<Self>,
        client: Client,
        record: &Record,
        kind: LayerKind,
        digest: Digest,
    ) -> Result<DrawableSource, Problem> {
        let key = CacheKey::new(record.id.owner(), digest);
        let cached = match kind {
            LayerKind::Image => self.images.peek(key).map(Drawable::Image),
            LayerKind::Labels => self.labels.peek(key).map(Drawable::Labels),
        };
        if let Some(drawable) = cached {
            return Ok(DrawableSource::Decoded(drawable));
        }
        let (images, id) = (Arc::clone(self), record.id);
        let fetch = async move {
            let take = |budget: &Budget, bytes| budget.take(MemoryClass::Image, bytes);
            let (file, reservation) = images.read_file(client, id, digest, take).await?;
            Ok(CacheEntry::new(file, reservation))
        };
        let key = CacheKey::new(
            id.owner(),
            Digest::of(&[&id.to_bytes()[..], &digest.0].concat()),
        );
        let file = self.files.get(key, client.payer(), fetch);
        Ok(DrawableSource::File {
            kind,
            digest,
            file: file.await?.value,
        })
    }

    /// Reads a file of a session from the store, into memory that is taken before.
    pub(crate) async fn read_file(
        &self,
        client: Client,
        id: SessionId,
        digest: Digest,
        take: impl Fn(&Budget, u64) -> Result<Reservation, BudgetExceeded>,
    ) -> Result<(Bytes, Reservation), Problem> {
        let _ticket = self
            .admission
            .transfer(QueueKey::session(client, id))
            .await?;
        let bytes = in_stage("store", self.store.file_bytes(id, digest)).await?;
        let bytes = bytes.max(MIN_WEIGHT);
        let mut reservation = self
            .admission
            .reserve_aside(|budget| take(budget, bytes))
            .await?;
        let file = in_stage("store", self.store.file(id, digest)).await?;
        reservation.shrink_to((file.len() as u64).max(MIN_WEIGHT));
        Ok((file, reservation))
    }

    /// Decodes what is not decoded yet.
    pub(crate) async fn decode(
        &self,
        client: Client,
        ticket: &Ticket,
        sources: ContentSources,
    ) -> Result<DrawnContent, Problem> {
        let mask = match sources.region {
            Some(source) => match self.decode_source(client, ticket, source).await? {
                Drawable::Image(image) => Some(Mask::new(image)),
                _ => None,
            },
            None => None,
        };
        let drawable = match (sources.drawn, &mask) {
            (Some(source), _) => self.decode_source(client, ticket, source).await?,
            (None, Some(mask)) => Drawable::Holes(mask.clone()),
            (None, None) => return Err(Problem::new(Code::Internal, "holes without a region")),
        };
        Ok(DrawnContent { drawable, mask })
    }

    async fn decode_source(
        &self,
        client: Client,
        ticket: &Ticket,
        source: DrawableSource,
    ) -> Result<Drawable, Problem> {
        match source {
            DrawableSource::Decoded(drawable) => Ok(drawable),
            DrawableSource::File { kind, digest, file } => {
                self.decode_file(client, ticket, kind, digest, CachedFile(file))
                    .await
            }
        }
    }

    /// Checks the size of a layer's file by its header, before it is decoded; returns its digest.
    pub(crate) async fn check_layer(
        &self,
        ticket: &Ticket,
        file: Bytes,
        expected: Extent,
    ) -> Result<Digest, Problem> {
        let limits = self.limits;
        let open = move |cancel: &Cancel| {
            let is_cancelled = || cancel.is_cancelled();
            let steps = StepCounter::new(&is_cancelled);
            let extent = codec::probe(&file, &steps).map_err(WarpError::from)?.extent;
            limits.check(extent).map_err(WarpError::from)?;
            check_extent(extent, expected)?;
            Ok::<_, Problem>(Digest::of(&file))
        };
        ticket.run(open).await?
    }

    /// The file of an image or layer in decoded form, from the cache or decoded now.
    pub(crate) async fn decode_file(
        &self,
        client: Client,
        ticket: &Ticket,
        kind: LayerKind,
        digest: Digest,
        file: impl AsRef<[u8]> + Send + 'static,
    ) -> Result<Drawable, Problem> {
        Ok(match kind {
            LayerKind::Image => {
                let image = self.decode_image(client, ticket, digest, file).await?;
                Drawable::Image(image.value)
            }
            LayerKind::Labels => {
                Drawable::Labels(self.decode_labels(client, ticket, digest, file).await?)
            }
        })
    }

    async fn decode_labels(
        &self,
        client: Client,
        ticket: &Ticket,
        digest: Digest,
        file: impl AsRef<[u8]> + Send + 'static,
    ) -> Result<Arc<CacheEntry<LabelImage>>, Problem> {
        let limits = self.limits;
        let decode = move |admission: &Admission, cancel: &Cancel| {
            let is_cancelled = || cancel.is_cancelled();
            let steps = StepCounter::new(&is_cancelled);
            let opened =
                codec::open_labels(file.as_ref(), &limits, &steps).map_err(WarpError::from)?;
            let mut reservation =
                admission.reserve(MemoryClass::Image, LabelImage::peak_bytes(&opened))?;
            let labels = LabelImage::decode_as(digest, &opened)?;
            reservation.shrink_to(labels.bytes());
            Ok(CacheEntry::new(labels, reservation))
        };
        let (key, build) = (
            CacheKey::new(client.owner, digest),
            self.decoding(ticket, decode),
        );
        let labels = self.labels.get(key, client.payer(), build);
        Ok(labels.await?.value)
    }

    /// The image of a file, from the cache or decoded now.
    pub(crate) async fn decode_image(
        &self,
        client: Client,
        ticket: &Ticket,
        digest: Digest,
        file: impl AsRef<[u8]> + Send + 'static,
    ) -> Result<Fetched<Image>, Problem> {
        let limits = self.limits;
        let decode = move |admission: &Admission, cancel: &Cancel| {
            let is_cancelled = || cancel.is_cancelled();
            let steps = StepCounter::new(&is_cancelled);
            let opened = codec::open(file.as_ref(), &limits, &steps).map_err(WarpError::from)?;
            let mut reservation =
                admission.reserve(MemoryClass::Image, Image::peak_bytes(&opened))?;
            let image = Image::decode_as(digest, &opened)?;
            reservation.shrink_to(image.bytes());
            Ok(CacheEntry::new(image, reservation))
        };
        let (key, build) = (
            CacheKey::new(client.owner, digest),
            self.decoding(ticket, decode),
        );
        self.images.get(key, client.payer(), build).await
    }

    /// Runs a decoder on the pool.
    fn decoding<T, F>(
        &self,
        ticket: &Ticket,
        decode: F,
    ) -> impl Future<Output = Result<T, Problem>> + Send + use<T, F>
    where
        T: Send + 'static,
        F: FnOnce(&Admission, &Cancel) -> Result<T, Problem> + Send + 'static,
    {
        let (admission, ticket) = (Arc::clone(&self.admission), ticket.clone());
        async move {
            let decode = move |cancel: &Cancel| decode(&admission, cancel);
            match ticket.run(decode).await {
                // Decoders may panic on a malicious file: then the file is at fault.
                Err(PoolError::Panicked) => Err(WarpError::Codec(CodecError::Bad {
                    format: "image",
                    detail: "the decoder failed".to_owned(),
                })
                .into()),
                Err(error) => Err(error.into()),
                Ok(decoded) => decoded,
            }
        }
    }

    /// Evicts what was decoded from a file, unless a session of the owner still uses it.
    pub(crate) fn evict_unused(&self, owner: Owner, digest: Digest) -> bool {
        let is_unused = !self.store.names(owner, digest);
        if is_unused {
            self.images.drop_value(CacheKey::new(owner, digest));
            self.labels.drop_value(CacheKey::new(owner, digest));
        }
        is_unused
    }
}
