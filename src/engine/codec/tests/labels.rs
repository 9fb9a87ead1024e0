//! Label images: numbers are read and written as they are stored.

use super::made::Png;
use super::*;
use crate::pixmap::Extent;

fn labels(file: &[u8]) -> Labels {
    open_labels(file, &ImageLimits::default(), &StepCounter::new(&|| false))
        .unwrap()
        .decode_labels()
        .unwrap()
        .labels
}

/// Packs numbers of a few bits, row by row.
fn packed(values: &[u8], width: usize, bits: usize) -> Vec<u8> {
    let row = |row: &[u8]| {
        let mut bytes = vec![0; (width * bits).div_ceil(8)];
        row.iter()
            .enumerate()
            .for_each(|(k, value)| bytes[k * bits / 8] |= value << (8 - bits - k * bits % 8));
        bytes
    };
    values.chunks(width).flat_map(row).collect()
}

/// 13 x 3 numbers of a depth.
fn numbers(bits: usize) -> Vec<u8> {
    (0..39)
        .map(|k| (k * 7 % (1 << bits.min(8))) as u8)
        .collect()
}

#[test]
fn indices_of_a_palette_keep_their_numbers_and_colours() {
    for bits in [1_usize, 2, 4, 8] {
        let colours: Vec<[u8; 3]> = (0..1_u32 << bits)
            .map(|k| [k as u8, 200 - (k % 200) as u8, (k * 5) as u8])
            .collect();
        let (values, alpha) = (numbers(bits), vec![0, 90]);
        let stored = packed(&values, 13, bits);
        // Passes of an interlaced picture are packed each by itself.
        let mut interlaced = Png::interlaced(13, 3, 8, 3, &values);
        if bits < 8 {
            let mut rows = interlaced.rows.as_slice();
            let mut pass = Vec::new();
            for width in [2, 2, 3, 7, 6, 6, 13] {
                let Some((row, rest)) = rows.split_at_checked(1 + width) else {
                    break;
                };
                pass.push(0);
                pass.extend(packed(&row[1..], width, bits));
                rows = rest;
            }
            (interlaced.rows, interlaced.ihdr[8]) = (pass, bits as u8);
        }
        for mut png in [Png::new(13, 3, bits as u8, 3, &stored), interlaced] {
            png.before.push((*b"PLTE", colours.as_flattened().to_vec()));
            png.before.push((*b"tRNS", alpha.clone()));
            let file = png.bytes();
            let read = labels(&file);
            assert_eq!(read.values, values, "{bits} bits");
            assert_eq!(
                read.palette,
                Some(Palette {
                    colours: colours.clone(),
                    alpha: alpha.clone()
                })
            );
            assert_eq!(
                (
                    read.shape.samples(),
                    read.shape.depth,
                    read.shape.extent.width()
                ),
                (1, Depth::Eight, 13)
            );
            assert_eq!(
                decoded(&file).channels(),
                Channels::Rgba,
                "as a picture it is in colour"
            );
        }
    }
}

#[test]
fn grey_keeps_its_numbers_whatever_their_bits() {
    for bits in [1_usize, 2, 4, 8] {
        let values = numbers(bits);
        let mut png = Png::new(13, 3, bits as u8, 0, &packed(&values, 13, bits));
        // A colour that would be transparent.
        png.before.push((*b"tRNS", vec![0, 1]));
        let read = labels(&png.bytes());
        assert_eq!(
            (read.values, read.palette, read.shape.channels),
            (values.clone(), None, Channels::Rgb),
            "{bits} bits"
        );
        if bits < 8 {
            let tiff = tiff::grey(13, 3, bits as u32, &packed(&values, 13, bits));
            assert_eq!(labels(&tiff).values, values, "TIFF of {bits} bits");
        }
    }
    let sixteen: Vec<u8> = (0..78).map(|k| (k * 37) as u8).collect();
    let read = labels(&Png::new(13, 3, 16, 0, &sixteen).bytes());
    assert_eq!(
        (read.values, read.shape.depth, read.shape.samples()),
        (sixteen, Depth::Sixteen, 1)
    );
}

#[test]
fn colours_are_whole_labels_and_alpha_stays() {
    let rgba: Vec<u8> = (0..13 * 3 * 4).map(|k| (k * 11) as u8).collect();
    let read = labels(&Png::new(13, 3, 8, 6, &rgba).bytes());
    assert_eq!((read.values, read.shape.samples()), (rgba.clone(), 4));
    let grey_alpha = &rgba[..78];
    let read = labels(&Png::new(13, 3, 8, 4, grey_alpha).bytes());
    assert_eq!(
        (read.values.as_slice(), read.shape.samples()),
        (grey_alpha, 2)
    );
}

#[test]
fn a_tiff_and_a_bmp_keep_their_palettes() {
    let tiff = tiff::palette_in_tiles();
    let read = labels(&tiff.bytes());
    let tile = |k: usize| (k % 20 / 16 + k / 20 / 16 * 2) as u8;
    assert_eq!(read.values, (0..20 * 18).map(tile).collect::<Vec<_>>());
    let palette = read.palette.unwrap();
    assert_eq!(
        (palette.colours.len(), palette.colours[3]),
        (256, [0x33; 3])
    );

    for bits in [1_usize, 4, 8] {
        let values = numbers(bits);
        let colours: Vec<[u8; 3]> = (0..1_u32 << bits)
            .map(|k| [k as u8, 7, (k * 3) as u8])
            .collect();
        let read = labels(&bmp(&values, 13, bits, &colours));
        assert_eq!(
            (read.values, read.shape.samples()),
            (values, 1),
            "BMP of {bits} bits"
        );
        assert_eq!(read.palette.unwrap().colours, colours);
    }
}

/// A BMP with a palette, rows from below.
fn bmp(values: &[u8], width: usize, bits: usize, colours: &[[u8; 3]]) -> Vec<u8> {
    let mut rows = packed(values, width, bits);
    let row = rows.len() / (values.len() / width);
    rows = rows
        .chunks(row)
        .rev()
        .flat_map(|row| [row, &vec![0; row.len().next_multiple_of(4) - row.len()]].concat())
        .collect();
    let offset = 54 + 4 * colours.len();
    let mut file = b"BM".to_vec();
    for value in [
        (offset + rows.len()) as u32,
        0,
        offset as u32,
        40,
        width as u32,
        (values.len() / width) as u32,
    ] {
        file.extend(value.to_le_bytes());
    }
    file.extend([1, 0, bits as u8, 0]);
    for value in [0, rows.len() as u32, 2835, 2835, colours.len() as u32, 0] {
        file.extend(value.to_le_bytes());
    }
    file.extend(colours.iter().flat_map(|[r, g, b]| [*b, *g, *r, 0]));
    file.extend(rows);
    file
}

#[test]
fn labels_are_turned_upright() {
    for (number, width, upright) in UPRIGHT {
        let mut png = Png::new(3, 2, 8, 3, b"abcdef");
        png.before.push((*b"PLTE", vec![9; 768]));
        png.before.push((*b"eXIf", exif(number, false)));
        let read = labels(&png.bytes());
        assert_eq!(
            (read.values.as_slice(), read.shape.extent.width() as usize),
            (upright.as_slice(), width),
            "{number}"
        );
    }
}

#[test]
fn a_palette_that_is_missing_or_damaged_is_an_error() {
    let work = StepCounter::new(&|| false);
    for palette in [None, Some(vec![]), Some(vec![1, 2, 3, 4])] {
        let mut png = Png::new(13, 3, 8, 3, &numbers(8));
        palette
            .into_iter()
            .for_each(|palette| png.before.push((*b"PLTE", palette)));
        let file = png.bytes();
        let read = open_labels(&file, &ImageLimits::default(), &work)
            .and_then(|opened| opened.decode_labels());
        assert!(
            matches!(read, Err(CodecError::Bad { format: "PNG", .. })),
            "{read:?}"
        );
    }
}

/// What is written is read as it was, with its palette; formats that would change labels have no
/// writer.
#[test]
fn labels_survive_being_written() {
    let extent = Extent::new(131, 97).unwrap();
    let palette = Palette {
        colours: (0..=255).map(|k| [k, 255 - k, k / 2]).collect(),
        alpha: vec![0, 1, 2],
    };
    for (channels, grey, depth, palette) in [
        (Channels::Rgb, true, Depth::Eight, Some(palette)),
        (Channels::Rgb, true, Depth::Eight, None),
        (Channels::Rgb, true, Depth::Sixteen, None),
        (Channels::Rgb, false, Depth::Eight, None),
        (Channels::Rgba, false, Depth::Sixteen, None),
        (Channels::Rgba, true, Depth::Eight, None),
    ] {
        let shape = PixelLayout {
            extent,
            channels,
            grey,
            depth,
        };
        let values: Vec<u8> = (0..shape.sample_bytes() as u32)
            .map(|k| (k.wrapping_mul(2_654_435_761) >> 24) as u8)
            .collect();
        for encoding in [
            Encoding::Png(Compression::Fast),
            Encoding::Png(Compression::Best),
            Encoding::Tiff(Compression::Fast),
        ] {
            let writer = Writer::of_labels(shape, encoding, palette.as_ref(), None).unwrap();
            let mut file = writer.head();
            let mut checksums = Vec::new();
            for strip in 0..writer.strips() {
                let rows = writer.rows(strip);
                let row = values.len() / 97;
                let mut samples =
                    values[rows.start as usize * row..rows.end as usize * row].to_vec();
                checksums.push(writer.strip_into(strip, &mut samples, &mut file, &|| true));
            }
            file.extend(writer.tail(&checksums));
            assert!(file.len() as u64 <= writer.max_bytes());
            let back = labels(&file);
            assert!(
                back.values == values && back.shape == shape,
                "{shape:?} {encoding:?}"
            );
            let want = palette.clone().map(|palette| match encoding {
                // Its palettes have no alpha.
                Encoding::Tiff(_) => Palette {
                    alpha: Vec::new(),
                    ..palette
                },
                _ => palette,
            });
            assert_eq!(back.palette, want);
            // Another decoder.
            if let Encoding::Png(_) = encoding {
                assert!(image::load_from_memory(&file).is_ok());
            }
        }
        for encoding in [
            Encoding::WebP,
            Encoding::Jpeg {
                quality: 100,
                subsampling: Subsampling::Half,
                ground: [0; 3],
            },
        ] {
            assert!(Writer::of_labels(shape, encoding, None, None).is_none());
        }
    }
}

#[test]
fn files_of_every_kind_open_as_labels() {
    for (name, file) in zoo() {
        let read = labels(&file);
        let picture = decoded(&file);
        assert_eq!(read.shape.extent, picture.extent(), "{name}");
        assert_eq!(
            read.values.len() as u64,
            read.shape.sample_bytes(),
            "{name}"
        );
    }
}
