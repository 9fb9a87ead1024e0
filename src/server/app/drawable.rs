//! What a request draws: the image of a session, one of its layers, the coverage or the holes;
//! and the mask of the region that moves.
//!
//! [`Images`] makes it in two steps, so that a slow store blocks no worker: `fetch` reads the files
//! whose decoded form is not cached, without a ticket, and `decode` decodes them on the pool.
//!
//! [`Images`]: super::parts::images::Images

use std::sync::Arc;

use bytes::Bytes;
use mlswarp::codec::Format;
use mlswarp::pixmap::Extent;
use mlswarp::render::Outside;
use mlswarp::warp::{Digest, Image, LabelImage, OutputSpec, RasterSource, Region};

use crate::cache::CacheEntry;
use crate::layer::{LayerKind, LayerName};
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

/// What a request draws, and the region whose content moves if it is not the whole image.
#[derive(Clone, Debug)]
pub(crate) struct DrawnContent {
    pub(crate) drawable: Drawable,
    pub(crate) mask: Option<Mask>,
}

impl Drawable {
    /// What the engine draws.
    pub(crate) fn raster_source(&self) -> RasterSource<'_> {
        match self {
            Self::Image(image) => RasterSource::Image(image),
            Self::Labels(labels) => RasterSource::Labels(labels),
            Self::Coverage(extent) => RasterSource::Coverage(*extent),
            Self::Holes(mask) => RasterSource::Holes(&mask.region),
        }
    }
}

impl Mask {
    pub(crate) fn new(image: Arc<CacheEntry<Image>>) -> Self {
        Self {
            region: Region::new(&image),
            _image: image,
        }
    }
}

impl DrawnContent {
    /// An image, and the mask of what moves.
    pub(crate) fn image(
        image: Arc<CacheEntry<Image>>,
        mask: Option<Arc<CacheEntry<Image>>>,
    ) -> Self {
        Self {
            drawable: Drawable::Image(image),
            mask: mask.map(Mask::new),
        }
    }

    /// The same, of which only the content of this mask moves.
    pub(crate) fn within(self, mask: Arc<CacheEntry<Image>>) -> Self {
        Self {
            mask: Some(Mask::new(mask)),
            ..self
        }
    }

    /// What the engine draws.
    pub(crate) fn raster_source(&self) -> RasterSource<'_> {
        self.drawable.raster_source()
    }

    /// The image and the region whose mask shows what is connected; none of labels and coverage.
    pub(crate) fn shape(&self) -> Option<(&Image, Option<&Region>)> {
        match &self.drawable {
            Drawable::Image(image) => Some((image, self.region())),
            Drawable::Labels(_) | Drawable::Coverage(_) | Drawable::Holes(_) => None,
        }
    }

    /// The region whose content moves, if it is not the whole image.
    pub(crate) fn region(&self) -> Option<&Region> {
        self.mask.as_ref().map(|mask| &mask.region)
    }

    /// The output of this where only that of images is known. JPEG and WebP would change labels and
    /// coverage, which become PNG; an outside value is one of images, and becomes transparent.
    pub(crate) fn output_beside(&self, of_images: OutputSpec) -> OutputSpec {
        if matches!(self.drawable, Drawable::Image(_)) {
            return of_images;
        }
        let format = if of_images.format.keeps_labels() {
            of_images.format
        } else {
            Format::default()
        };
        let outside = if matches!(of_images.outside, Outside::Value(_)) {
            Outside::Transparent
        } else {
            of_images.outside
        };
        OutputSpec {
            format,
            outside,
            ..of_images
        }
    }

    /// Whether alpha is added where nothing is drawn.
    pub(crate) fn may_gain_alpha(&self) -> bool {
        matches!(&self.drawable, Drawable::Image(image) if !image.has_alpha())
    }
}

/// A drawable, or the file that it has to be decoded from.
pub(crate) enum DrawableSource {
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
    pub(crate) drawn: Option<DrawableSource>,
    pub(crate) region: Option<DrawableSource>,
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
pub(crate) struct CachedFile(pub(crate) Arc<CacheEntry<Bytes>>);

impl AsRef<[u8]> for CachedFile {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

/// The stored layer of that name.
pub(crate) fn find_layer(record: &Record, name: &str) -> Result<(LayerName, StoredLayer), Problem> {
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
