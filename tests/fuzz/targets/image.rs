//! Any bytes as a picture's file, behind limits. What is decoded is what the header said, and
//! neither takes more memory or work than follows from the file's bytes and the pixels that it
//! claims within the limits.

use mlswarp::codec::{self, DecodedLabels, ImageLimits, StepCounter, probe};

const LIMITS: ImageLimits = ImageLimits {
    max_pixels: 1 << 20,
    max_side: 1 << 12,
};
/// Most bytes that decoding a picture within the limits may be predicted to take beside five times
/// the file: 16 a pixel, its tables, 2 MiB.
const MAX_BYTES: u64 = (16 << 20) + (128 << 20) + (2 << 20);

/// The steps of `read` are at most `most`.
fn within<T>(most: u64, read: impl FnOnce(&StepCounter<'_>) -> T) -> T {
    let work = StepCounter::new(&|| false);
    let result = read(&work);
    assert!(
        work.steps() <= most,
        "{} steps of at most {most}",
        work.steps()
    );
    result
}

pub(super) fn decode(bytes: &[u8]) {
    let length = bytes.len() as u64;
    // The bounds are those of the codec's own test of its corpus, with the whole file in the place
    // of its header. A TIFF's directory is searched for each of some twenty tags; an entry has
    // twelve bytes.
    let header = within(64 + 2 * length, |work| probe(bytes, work));
    let pixels = header
        .as_ref()
        .ok()
        .filter(|header| LIMITS.check(header.extent).is_ok())
        .map_or(0, |header| header.extent.pixels());
    within(256 + 64 * length, |work| {
        drop(codec::open(bytes, &LIMITS, work))
    });
    let decoded = within(4_096 + 66 * length + 2 * pixels, |work| {
        codec::open(bytes, &LIMITS, work)?.decode()
    });
    // The pixels of labels are read once more as they are stored; the palette of a BMP takes its
    // header again.
    let labels = within(8_192 + 132 * length + 3 * pixels, |work| {
        codec::open_labels(bytes, &LIMITS, work)?.decode_labels()
    });
    assert!(
        labels.is_err()
            || labels.is_ok_and(|DecodedLabels { labels, .. }| {
                labels.values.len() as u64 == labels.shape.sample_bytes()
            })
    );
    let Ok(decoded) = decoded else { return };
    let header = header.expect("what is decoded has a header");
    let pixmap = &decoded.pixmap;
    assert_eq!(
        (header.extent, header.channels, header.depth),
        (pixmap.extent(), pixmap.channels(), pixmap.depth())
    );
    assert!(header.decode_bytes > pixmap.bytes() as u64);
    assert!(
        header.decode_bytes <= MAX_BYTES + 5 * length,
        "{} bytes",
        header.decode_bytes
    );
}
