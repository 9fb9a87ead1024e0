//! A source image and its derived copies, each made on first use: box-reduced images for small
//! targets, and 8-bit texels packed for the bilinear kernels. `[height][width]` grows by one column
//! and one row that repeat the last ones, so that a kernel may load a pair of texels at any pixel.
//! Each sample is stored minus 128, as the signed operand of a byte product.

use std::sync::{Mutex, OnceLock, TryLockError};
use std::time::Duration;

use crate::pixmap::{Channels, Depth, Extent, Pixmap, Samples, sample_bytes};

/// A sample of 0 as it is stored in [`Packed`].
pub(super) const STORED_ZERO: u32 = 0x8080_8080;

/// A source image and the copies that the samplers read (packed, reduced), each made on first
/// use.
#[derive(Debug)]
pub struct Source {
    pixmap: Pixmap,
    packed: OnceLock<Packed>,
    /// Reduced by 2, 4, 8, ...
    reduced: Vec<OnceLock<Box<Self>>>,
    /// Held while a copy is made, so that it is made once.
    making: Mutex<()>,
}

const NEVER: &dyn Fn() -> bool = &|| false;
/// How long a thread waits for another one's copy before it looks whether it is cancelled.
const LOOK_AGAIN: Duration = Duration::from_millis(1);

impl Source {
    /// Wraps a decoded image.
    #[must_use]
    pub fn new(pixmap: Pixmap) -> Self {
        let reduced = (0..deepest(pixmap.extent()))
            .map(|_| OnceLock::new())
            .collect();
        Self {
            pixmap,
            packed: OnceLock::new(),
            reduced,
            making: Mutex::new(()),
        }
    }

    /// The image as decoded.
    #[must_use]
    pub const fn pixmap(&self) -> &Pixmap {
        &self.pixmap
    }

    /// Upper bound of the memory that a source of this shape takes with all its copies, bytes.
    #[must_use]
    pub fn bytes(extent: Extent, channels: Channels, depth: Depth) -> u64 {
        (0..=deepest(extent))
            .map(|k| {
                let extent = extent.reduced(k);
                let packed = match depth {
                    Depth::Eight => Packed::texels(extent).saturating_mul(4),
                    Depth::Sixteen => 0,
                };
                sample_bytes(extent, channels, depth).saturating_add(packed)
            })
            .fold(0, u64::saturating_add)
    }

    /// Number of halvings for a target: the reduced image is not smaller than the target along
    /// either axis.
    pub(super) fn level_for(&self, target: Extent) -> u32 {
        let extent = self.pixmap.extent();
        let fits = |k: &u32| {
            target.width() <= extent.width() >> k && target.height() <= extent.reduced(*k).height()
        };
        (1..=deepest(extent)).take_while(fits).last().unwrap_or(0)
    }

    /// The image reduced by `2^k`, as [`Source::make_copies`] has made it.
    pub(super) fn level(&self, k: u32) -> &Self {
        self.make_level(k, NEVER).expect("nothing gives it up")
    }

    /// Reduces the image by `2^k`, once; `None` when cancelled.
    fn make_level(&self, k: u32, cancelled: &dyn Fn() -> bool) -> Option<&Self> {
        let Some(cell) = (k as usize)
            .checked_sub(1)
            .and_then(|index| self.reduced.get(index))
        else {
            return Some(self);
        };
        let level = self.copy(cell, cancelled, || {
            let pixmap = self.pixmap.reduced(k, cancelled)?;
            Some(Box::new(Self {
                pixmap,
                packed: OnceLock::new(),
                reduced: Vec::new(),
                making: Mutex::new(()),
            }))
        })?;
        Some(level)
    }

    /// A copy, made now if it has not been made. Who waits for another thread that makes one looks
    /// at its own cancellation.
    fn copy<'a, T>(
        &self,
        cell: &'a OnceLock<T>,
        cancelled: &dyn Fn() -> bool,
        make: impl FnOnce() -> Option<T>,
    ) -> Option<&'a T> {
        let _making = loop {
            if let Some(copy) = cell.get() {
                return Some(copy);
            }
            match self.making.try_lock() {
                Ok(making) => break making,
                // A panic while a copy is made leaves no part of it behind.
                Err(TryLockError::Poisoned(making)) => break making.into_inner(),
                Err(TryLockError::WouldBlock) if cancelled() => return None,
                Err(TryLockError::WouldBlock) => std::thread::sleep(LOOK_AGAIN),
            }
        };
        match cell.get() {
            Some(copy) => Some(copy),
            None => make().map(|copy| cell.get_or_init(|| copy)),
        }
    }

    /// Whether a drawing at this size of the whole image has to make copies first.
    pub(super) fn lacks_copies(&self, size: Extent, is_packed: bool) -> bool {
        let reduced = match self.level_for(size) as usize {
            0 => Some(self),
            k => self
                .reduced
                .get(k - 1)
                .and_then(OnceLock::get)
                .map(|reduced| &**reduced),
        };
        let is_packed = is_packed && self.pixmap.depth() == Depth::Eight;
        reduced.is_none_or(|reduced| is_packed && reduced.packed.get().is_none())
    }

    /// Makes the copies that a drawing at this size of the whole image reads. Returns the number
    /// of halvings; `None` when cancelled, which is checked for each row.
    pub(super) fn make_copies(
        &self,
        size: Extent,
        is_packed: bool,
        cancelled: &dyn Fn() -> bool,
    ) -> Option<u32> {
        let k = self.level_for(size);
        let reduced = self.make_level(k, cancelled)?;
        if let (true, Samples::Eight(samples)) = (is_packed, reduced.pixmap.samples()) {
            reduced.copy(&reduced.packed, cancelled, || {
                Packed::new(&reduced.pixmap, samples, cancelled)
            })?;
        }
        Some(k)
    }

    /// The packed texels; `None` at 16 bit.
    pub(super) fn packed(&self) -> Option<&Packed> {
        match self.pixmap.samples() {
            Samples::Eight(samples) => {
                let packed = || Packed::new(&self.pixmap, samples, NEVER);
                self.copy(&self.packed, NEVER, packed)
            }
            Samples::Sixteen(_) => None,
        }
    }
}

/// Number of halvings until a image is one pixel.
const fn deepest(extent: Extent) -> u32 {
    let longest = if extent.width() > extent.height() {
        extent.width()
    } else {
        extent.height()
    };
    u32::BITS - (longest - 1).leading_zeros()
}

/// 8-bit texels, straight RGBA minus 128 each, `[height + 1][width + 1]`.
#[derive(Debug)]
pub(super) struct Packed {
    pub(super) texels: Vec<u32>,
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) opaque: bool,
}

impl Packed {
    fn new(pixmap: &Pixmap, samples: &[u8], cancelled: &dyn Fn() -> bool) -> Option<Self> {
        let (width, height) = (
            pixmap.extent().width() as usize,
            pixmap.extent().height() as usize,
        );
        let stride = width + 1;
        let mut texels = Vec::with_capacity(stride * (height + 1));
        let count = pixmap.channels().count();
        for row in samples.chunks_exact(width * count) {
            if cancelled() {
                return None;
            }
            match pixmap.channels() {
                Channels::Rgb => texels.extend(
                    row.chunks_exact(3)
                        .map(|p| u32::from_le_bytes([p[0], p[1], p[2], u8::MAX]) ^ STORED_ZERO),
                ),
                Channels::Rgba => texels.extend(
                    row.chunks_exact(4)
                        .map(|p| u32::from_le_bytes([p[0], p[1], p[2], p[3]]) ^ STORED_ZERO),
                ),
            }
            texels.extend(texels.last().copied());
        }
        texels.extend_from_within(texels.len() - stride..);
        Some(Self {
            texels,
            width,
            height,
            opaque: pixmap.is_opaque(),
        })
    }

    /// Texels per row, including the repeated one.
    pub(super) const fn stride(&self) -> usize {
        self.width + 1
    }

    fn texels(extent: Extent) -> u64 {
        (u64::from(extent.width()) + 1) * (u64::from(extent.height()) + 1)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use super::*;

    #[test]
    fn who_waits_for_a_copy_of_another_thread_can_be_cancelled() {
        let extent = Extent::new(2, 1).unwrap();
        let source = Source::new(Pixmap::new(
            extent,
            Channels::Rgb,
            Samples::Eight(vec![0; 6]),
        ));
        let (source, cell) = (&source, &OnceLock::new());
        let (begins, began) = mpsc::channel();
        let (ends, end) = mpsc::channel();
        std::thread::scope(|scope| {
            let make = move || {
                begins.send(()).unwrap();
                end.recv().ok()
            };
            let maker = scope.spawn(move || source.copy(cell, NEVER, make).copied());
            began.recv().unwrap();
            assert_eq!(source.copy(cell, &|| true, || Some(1)), None);
            ends.send(7).unwrap();
            assert_eq!(source.copy(cell, NEVER, || Some(1)), Some(&7));
            assert_eq!(maker.join().unwrap(), Some(7));
        });
    }
}
