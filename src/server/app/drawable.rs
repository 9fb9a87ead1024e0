//! What a request draws: the picture of a session, one of its layers, the coverage or the holes;
//! and the mask of the region that moves.
//!
//! It is made in two steps, so that a slow store blocks no worker: [`App::fetch_sources`] reads the
//! files whose decoded form is not cached, without a ticket, and [`App::decode_content`] decodes
//! them on the pool.

use std::sync::Arc;

use bytes::Bytes;
use mlswarp::codec::{self, CodecError, Format, StepCounter};
use mlswarp::pixmap::Extent;
use mlswarp::render::Outside;
use mlswarp::warp::{
    CanvasSpec, Digest, Image, LabelImage, OutputSpec, RasterSource, Region, WarpError,
};

use super::{App, MIN_WEIGHT, build_aborted};
use crate::cache::{CacheEntry, CacheKey, Fetched};
use crate::client::Client;
use crate::layer::{LayerKind, LayerName, LayerRef};
use crate::limits::memory::MemoryClass;
use crate::observe::scope::in_stage;
use crate::pool::{Cancel, PoolError, QueueKey, Ticket, WorkClass};
use crate::problem::words::{list, quote};
use crate::problem::{Code, Problem};
use crate::store::{Record, StoredLayer};

/// A [`RasterSource`] that owns what it is drawn from.
#[derive(Clone, Debug)]
pub(crate) enum Drawable {
    Image(Arc<CacheEntry<Image>>),
    Labels(Arc<CacheEntry<LabelImage>>),
    Coverage(Extent),
    Holes(Mask),
}

/// A region, and the memory of its mask.
#[derive(Clone, Debug)]
pub(crate) struct Mask {
    region: Region,
    _image: Arc<CacheEntry<Image>>,
}

/// What a request draws, and the region whose content moves if it is not the whole picture.
#[derive(Clone, Debug)]
pub(crate) struct DrawnContent {
    drawable: Drawable,
    mask: Option<Mask>,
}

impl Drawable {
    /// What the engine draws.
    pub(crate) fn subject(&self) -> RasterSource<'_> {
        match self {
            Self::Image(image) => RasterSource::Image(image),
            Self::Labels(labels) => RasterSource::Labels(labels),
            Self::Coverage(extent) => RasterSource::Coverage(*extent),
            Self::Holes(mask) => RasterSource::Holes(&mask.region),
        }
    }
}

impl Mask {
    fn new(image: Arc<CacheEntry<Image>>) -> Self {
        Self {
            region: Region::new(&image),
            _image: image,
        }
    }
}

impl DrawnContent {
    /// A picture, and the mask of what moves.
    pub(super) fn image(
        image: &Arc<CacheEntry<Image>>,
        mask: Option<&Arc<CacheEntry<Image>>>,
    ) -> Self {
        Self {
            drawable: Drawable::Image(Arc::clone(image)),
            mask: mask.map(|mask| Mask::new(Arc::clone(mask))),
        }
    }

    /// What the engine draws.
    pub(crate) fn subject(&self) -> RasterSource<'_> {
        self.drawable.subject()
    }

    /// The region whose content moves, if it is not the whole picture.
    pub(crate) fn region(&self) -> Option<&Region> {
        self.mask.as_ref().map(|mask| &mask.region)
    }

    /// The output where only that of pictures is known. JPEG and WebP would change labels and
    /// coverage: then it is PNG. A value outside is one of pictures.
    pub(crate) fn output_beside(&self, pictures: OutputSpec) -> OutputSpec {
        if matches!(self.drawable, Drawable::Image(_)) {
            return pictures;
        }
        let format = if pictures.format == Format::Tiff {
            Format::Tiff
        } else {
            Format::Png
        };
        let outside = if matches!(pictures.outside, Outside::Value(_)) {
            Outside::Transparent
        } else {
            pictures.outside
        };
        OutputSpec {
            format,
            outside,
            ..pictures
        }
    }

    /// Whether alpha is added where nothing is drawn.
    pub(crate) fn may_gain_alpha(&self) -> bool {
        matches!(&self.drawable, Drawable::Image(image) if !image.has_alpha())
    }
}

/// A drawable, or the file that it has to be decoded from.
enum DrawableSource {
    Decoded(Drawable),
    File {
        kind: LayerKind,
        digest: Digest,
        file: Arc<CacheEntry<Bytes>>,
    },
}

/// The sources of a [`DrawnContent`].
pub(crate) struct ContentSources {
    /// `None`: the holes of the region.
    drawn: Option<DrawableSource>,
    region: Option<DrawableSource>,
}

impl ContentSources {
    /// Whether nothing has to be decoded.
    pub(crate) fn is_decoded(&self) -> bool {
        [&self.drawn, &self.region]
            .into_iter()
            .flatten()
            .all(|source| matches!(source, DrawableSource::Decoded(_)))
    }
}

/// A cached file as bytes.
struct CachedFile(Arc<CacheEntry<Bytes>>);

impl AsRef<[u8]> for CachedFile {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

impl App {
    /// The sources of a session's picture or of a layer, and those of its region.
    /// Errors: There is no such layer; holes without a region; too little capacity.
    pub(crate) async fn fetch_sources(
        &self,
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
        &self,
        client: Client,
        record: &Record,
        canvas: CanvasSpec,
    ) -> Result<Option<DrawnContent>, Problem> {
        if canvas != CanvasSpec::Fit || !record.layers.contains_key(&LayerName::region()) {
            return Ok(None);
        }
        let sources = self
            .fetch_sources(client, record, Some(&LayerRef::Holes))
            .await?;
        let ticket = self
            .0
            .pool
            .admit(WorkClass::Upload, QueueKey::session(client, record.id))
            .await?;
        self.decode_content(client, &ticket, sources)
            .await
            .map(Some)
    }

    /// A file of a session in decoded form, if that is cached, or its bytes.
    async fn fetch_source(
        &self,
        client: Client,
        record: &Record,
        kind: LayerKind,
        digest: Digest,
    ) -> Result<DrawableSource, Problem> {
        let key = CacheKey::new(record.id.owner(), digest);
        let cached = match kind {
            LayerKind::Image => self.0.images.peek(key).map(Drawable::Image),
            LayerKind::Labels => self.0.labels.peek(key).map(Drawable::Labels),
        };
        if let Some(drawable) = cached {
            return Ok(DrawableSource::Decoded(drawable));
        }
        Ok(DrawableSource::File {
            kind,
            digest,
            file: self.fetch_file(client, record, digest).await?,
        })
    }

    /// The bytes of a file of a session.
    async fn fetch_file(
        &self,
        client: Client,
        record: &Record,
        digest: Digest,
    ) -> Result<Arc<CacheEntry<Bytes>>, Problem> {
        let (app, id) = (self.clone(), record.id);
        let fetch = async move {
            let _ticket = app
                .0
                .pool
                .admit(WorkClass::Transfer, QueueKey::session(client, id))
                .await?;
            let bytes = in_stage("store", app.0.store.file_bytes(id, digest)).await?;
            let bytes = bytes.max(MIN_WEIGHT);
            let mut reservation = app
                .reserve_aside(|budget| budget.take(MemoryClass::Image, bytes))
                .await?;
            let file = in_stage("store", app.0.store.file(id, digest)).await?;
            reservation.shrink_to((file.len() as u64).max(MIN_WEIGHT));
            Ok(CacheEntry::new(file, reservation))
        };
        let key = CacheKey::new(
            id.owner(),
            Digest::of(&[&id.to_bytes()[..], &digest.0].concat()),
        );
        Ok(self
            .0
            .files
            .get(key, client.payer(), fetch, build_aborted)
            .await?
            .value)
    }

    /// Decodes what is not decoded yet.
    pub(crate) async fn decode_content(
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
    pub(super) async fn check_layer(
        &self,
        ticket: &Ticket,
        file: Bytes,
        expected: Extent,
    ) -> Result<Digest, Problem> {
        let limits = self.0.config.limits().image;
        let open = move |cancel: &Cancel| {
            let is_cancelled = || cancel.is_cancelled();
            let steps = StepCounter::new(&is_cancelled);
            let extent = codec::probe(&file, &steps).map_err(WarpError::from)?.extent;
            limits.check(extent).map_err(WarpError::from)?;
            check_extent(extent, expected)?;
            Ok::<_, Problem>(Digest::of(&file))
        };
        self.0.pool.run(ticket, open).await?
    }

    /// The file of a picture or layer in decoded form, from the cache or decoded now.
    pub(super) async fn decode_file(
        &self,
        client: Client,
        ticket: &Ticket,
        kind: LayerKind,
        digest: Digest,
        file: impl AsRef<[u8]> + Send + 'static,
    ) -> Result<Drawable, Problem> {
        match kind {
            LayerKind::Image => Ok(Drawable::Image(
                self.decode_image(client, ticket, digest, file).await?.value,
            )),
            LayerKind::Labels => {
                let limits = self.0.config.limits().image;
                let decode = move |app: &Self, cancel: &Cancel| {
                    let is_cancelled = || cancel.is_cancelled();
                    let steps = StepCounter::new(&is_cancelled);
                    let opened = codec::open_labels(file.as_ref(), &limits, &steps)
                        .map_err(WarpError::from)?;
                    let mut reservation =
                        app.reserve(MemoryClass::Image, LabelImage::peak_bytes(&opened))?;
                    let labels = LabelImage::decode_as(digest, &opened)?;
                    reservation.shrink_to(labels.bytes());
                    Ok(CacheEntry::new(labels, reservation))
                };
                let build = self.decoding(ticket, decode);
                let key = CacheKey::new(client.owner, digest);
                Ok(Drawable::Labels(
                    self.0
                        .labels
                        .get(key, client.payer(), build, build_aborted)
                        .await?
                        .value,
                ))
            }
        }
    }

    /// The image of a file, from the cache or decoded now.
    pub(super) async fn decode_image(
        &self,
        client: Client,
        ticket: &Ticket,
        digest: Digest,
        file: impl AsRef<[u8]> + Send + 'static,
    ) -> Result<Fetched<Image>, Problem> {
        let limits = self.0.config.limits().image;
        let decode = move |app: &Self, cancel: &Cancel| {
            let is_cancelled = || cancel.is_cancelled();
            let steps = StepCounter::new(&is_cancelled);
            let opened = codec::open(file.as_ref(), &limits, &steps).map_err(WarpError::from)?;
            let mut reservation = app.reserve(MemoryClass::Image, Image::peak_bytes(&opened))?;
            let image = Image::decode_as(digest, &opened)?;
            reservation.shrink_to(image.bytes());
            Ok(CacheEntry::new(image, reservation))
        };
        let (key, build) = (
            CacheKey::new(client.owner, digest),
            self.decoding(ticket, decode),
        );
        self.0
            .images
            .get(key, client.payer(), build, build_aborted)
            .await
    }

    /// Runs a decoder on the pool.
    fn decoding<T, F>(
        &self,
        ticket: &Ticket,
        decode: F,
    ) -> impl Future<Output = Result<T, Problem>> + Send + use<T, F>
    where
        T: Send + 'static,
        F: FnOnce(&Self, &Cancel) -> Result<T, Problem> + Send + 'static,
    {
        let (app, ticket) = (self.clone(), ticket.clone());
        async move {
            let pool = app.0.pool.clone();
            match pool
                .run(&ticket, move |cancel: &Cancel| decode(&app, cancel))
                .await
            {
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
}

/// The stored layer of that name.
pub(super) fn find_layer(record: &Record, name: &str) -> Result<(LayerName, StoredLayer), Problem> {
    let found = LayerName::parse(name).and_then(|name| {
        record
            .layers
            .get_key_value(&name)
            .map(|(name, layer)| (name.clone(), *layer))
    });
    found.ok_or_else(|| {
        let names: Vec<&str> = record.layers.keys().map(LayerName::as_str).collect();
        let stored = if names.is_empty() {
            "it has no layers".to_owned()
        } else {
            format!("its layers: {}", list(&names))
        };
        Problem::new(
            Code::NoSuchLayer,
            format!("the session has no stored layer {}; {stored}", quote(name)),
        )
    })
}

/// Checks that a layer or region has the size of its picture.
pub(crate) fn check_extent(found: Extent, expected: Extent) -> Result<(), Problem> {
    if found == expected {
        return Ok(());
    }
    let [found, expected] =
        [found, expected].map(|extent| format!("{}x{}", extent.width(), extent.height()));
    let detail = format!(
        "the file has {found} px after EXIF orientation; a layer or region must have the size of \
            the picture, {expected} px"
    );
    Err(Problem::new(Code::BadValue, detail).limit("layer_size", expected, found))
}
