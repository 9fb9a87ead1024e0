//! The marker segments around the entropy-coded data (T.81, Annex B; JFIF 1.02).

use super::strip::Components;
use super::tables::{AC, BLOCK, DC, Huffman, ZIGZAG};
use crate::codec::{Carried, Profile};
use crate::pixmap::Extent;

/// Most bytes of a profile in one segment (ICC.1, Annex B.4).
const PROFILE_BYTES: usize = 65_519;

/// Ends an image.
pub(super) const END: [u8; 2] = [0xff, 0xd9];

/// The marker before a strip, which is a restart interval; none before the first.
pub(super) fn restart(strip: usize) -> Option<[u8; 2]> {
    let count = u8::try_from(strip.checked_sub(1)? % 8).expect("0 to 7");
    Some([0xff, 0xd0 | count])
}

/// Everything before the first strip. `interval`: macroblocks of a strip if there are several.
pub(super) fn head(
    extent: Extent,
    components: Components,
    steps: &[[u8; BLOCK]; 2],
    interval: Option<u16>,
    metadata: Option<&Carried>,
) -> Vec<u8> {
    let mut head = vec![0xff, 0xd8];
    // Without a known resolution: square pixels of unknown size. No thumbnail.
    let (unit, density, says_resolution) = metadata.map_or((0, [1; 2], true), Carried::density);
    let [across, down] = density.map(u16::to_be_bytes);
    segment(
        &mut head,
        0xe0,
        &[b"JFIF\0\x01\x02", &[unit], &across, &down, &[0; 2]],
    );
    for (marker, content) in
        metadata.map_or_else(Vec::new, |metadata| metadata.segments(says_resolution))
    {
        segment(&mut head, marker, &[&content]);
    }
    let icc = metadata
        .and_then(|metadata| metadata.profile(components == Components::Grey))
        .map(Profile::icc);
    let parts = icc.unwrap_or_default().chunks(PROFILE_BYTES);
    let count = u8::try_from(parts.len()).expect("a profile is smaller than 255 segments hold");
    for (number, part) in (1..=count).zip(parts) {
        segment(&mut head, 0xe2, &[b"ICC_PROFILE\0", &[number, count], part]);
    }
    let tables = if components == Components::Grey { 1 } else { 2 };
    for (number, steps) in (0..).zip(&steps[..tables]) {
        segment(
            &mut head,
            0xdb,
            &[&[number], &ZIGZAG.map(|place| steps[usize::from(place)])],
        );
    }
    let [height, width] = [extent.height(), extent.width()].map(|side| {
        u16::try_from(side)
            .expect("the target fits the format")
            .to_be_bytes()
    });
    // Number, horizontal and vertical resolution, and quantisation table of each component.
    let described: &[u8] = match components {
        Components::Grey => &[1, 1, 0x11, 0],
        Components::Full => &[3, 1, 0x11, 0, 2, 0x11, 1, 3, 0x11, 1],
        Components::Half => &[3, 1, 0x22, 0, 2, 0x11, 1, 3, 0x11, 1],
    };
    segment(&mut head, 0xc0, &[&[8], &height, &width, described]);
    for (class, both) in [(0x00, &DC), (0x10, &AC)] {
        for (number, Huffman { lengths, symbols }) in (0..).zip(&both[..tables]) {
            segment(&mut head, 0xc4, &[&[class | number], lengths, symbols]);
        }
    }
    if let Some(interval) = interval {
        segment(&mut head, 0xdd, &[&interval.to_be_bytes()]);
    }
    // Huffman tables of each component, then the whole spectrum in one scan.
    let scanned: &[u8] = if tables == 1 {
        &[1, 1, 0x00]
    } else {
        &[3, 1, 0x00, 2, 0x11, 3, 0x11]
    };
    segment(&mut head, 0xda, &[scanned, &[0, 63, 0]]);
    head
}

fn segment(head: &mut Vec<u8>, marker: u8, parts: &[&[u8]]) {
    let length = 2 + parts.iter().map(|part| part.len()).sum::<usize>();
    head.extend([0xff, marker]);
    head.extend(
        u16::try_from(length)
            .expect("a segment is shorter than 64 KiB")
            .to_be_bytes(),
    );
    parts.iter().for_each(|part| head.extend_from_slice(part));
}
