//! TIFF as archives, microscopes and scanners write it: group 4, JPEG, planes, `BigTIFF`, labels of
//! many bits.

use ::tiff::encoder::{TiffEncoder, colortype};
use fax::encoder::Encoder;
use fax::{Color, VecWriter};

use super::made::Jpeg;
use super::tiff::Tiff;
use super::*;

const UNDEFINED: u16 = 7;

fn samples(tiff: &Tiff) -> Vec<u8> {
    eight(&decoded(&tiff.bytes())).to_vec()
}

fn refusal(file: &[u8]) -> String {
    decode(file, &ImageLimits::default())
        .unwrap_err()
        .to_string()
}

fn labels_of(file: &[u8]) -> Result<Labels, CodecError> {
    let work = StepCounter::new(&|| false);
    let decoded = open_labels(file, &ImageLimits::default(), &work)?.decode_labels()?;
    Ok(decoded.labels)
}

/// Black where the sum of the coordinates is divisible by three.
fn fax_lines(width: u16, height: u16) -> (Vec<u8>, Vec<u8>) {
    let is_black = |x: u16, y: u16| (x + y).is_multiple_of(3);
    let mut encoder = Encoder::new(VecWriter::new());
    for y in 0..height {
        encoder
            .encode_line(
                (0..width).map(|x| {
                    if is_black(x, y) {
                        Color::Black
                    } else {
                        Color::White
                    }
                }),
                width,
            )
            .unwrap();
    }
    let data = encoder.finish().unwrap().finish();
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    (
        data,
        pixels
            .flat_map(|(x, y)| [if is_black(x, y) { 0 } else { 255 }; 3])
            .collect(),
    )
}

#[test]
fn group_4_is_read_in_both_orders_of_bits() {
    let (data, rgb) = fax_lines(37, 11);
    let tiff = Tiff::new(37, 11, &[1], 0, &data).with(259, &[4]);
    assert_eq!(samples(&tiff), rgb);
    let reversed: Vec<u8> = data.iter().map(|byte| byte.reverse_bits()).collect();
    let reversed = Tiff::new(37, 11, &[1], 0, &reversed)
        .with(259, &[4])
        .with(266, &[2]);
    assert_eq!(samples(&reversed), rgb);
    // Lines that are missing are not made up.
    let longer = Tiff::new(37, 12, &[1], 0, &data).with(259, &[4]);
    assert!(refusal(&longer.bytes()).contains("damaged or end too early"));
    // Not compressed, in reverse order.
    let plain = Tiff::new(3, 2, &[1], 1, &[0b0000_0101, 0b0000_0010]).with(266, &[2]);
    let grey: Vec<u8> = [255, 0, 255, 0, 255, 0]
        .into_iter()
        .flat_map(|value| [value; 3])
        .collect();
    assert_eq!(samples(&plain), grey);
}

/// A JPEG divided into its tables and its data, as TIFF stores them.
fn divided(jpeg: &[u8]) -> (Vec<u8>, Vec<u8>) {
    let (mut tables, mut data, mut at) = (vec![0xFF, 0xD8], vec![0xFF, 0xD8], 2);
    while jpeg[at + 1] != 0xDA {
        let end = at + 2 + usize::from(u16::from_be_bytes([jpeg[at + 2], jpeg[at + 3]]));
        let into = if matches!(jpeg[at + 1], 0xC4 | 0xDB) {
            &mut tables
        } else {
            &mut data
        };
        into.extend(&jpeg[at..end]);
        at = end;
    }
    data.extend(&jpeg[at..]);
    tables.extend([0xFF, 0xD9]);
    (tables, data)
}

#[test]
fn jpeg_in_strips_and_tiles_is_read_with_its_common_tables() {
    let letters = Jpeg::letters().bytes();
    let (tables, data) = divided(&letters);
    let grey = Tiff::new(24, 16, &[8], 1, &data).with(259, &[7]).with_tag(
        347,
        UNDEFINED,
        tables.len(),
        &tables,
    );
    assert_eq!(samples(&grey), eight(&decoded(&letters)));
    // Two tiles, of which the second is narrower in the picture.
    let mut tiles = Tiff::new(40, 16, &[8], 1, &[]).with(259, &[7]).with_tag(
        347,
        UNDEFINED,
        tables.len(),
        &tables,
    );
    tiles.tiled = true;
    tiles.parts = vec![data.clone(), data.clone()];
    let tiles = samples(&tiles.with(322, &[24]).with(323, &[16]));
    let pixel = |x: usize, y: usize| tiles[3 * (40 * y + x)];
    assert_eq!(
        [pixel(0, 0), pixel(23, 15), pixel(24, 0), pixel(39, 15)],
        [b'a', b'f', b'a', b'e']
    );
    // The same components are brightness and colours, or the colours themselves.
    let colours = Jpeg::flat(16, 8, &[(1, 1); 3], &[40, 0, -20]).bytes();
    let file = |photometric: u32| Tiff::new(16, 8, &[8; 3], photometric, &colours).with(259, &[7]);
    assert_eq!(samples(&file(6)), eight(&decoded(&colours)));
    assert_eq!(samples(&file(2))[..3], [168, 128, 108]);
    // Another size, cut off, and tables without end.
    assert!(
        refusal(&Tiff::new(32, 16, &[8], 1, &letters).with(259, &[7]).bytes())
            .contains("another size")
    );
    let cut = Tiff::new(24, 16, &[8], 1, &letters[..letters.len() - 4]).with(259, &[7]);
    assert!(matches!(
        decode(&cut.bytes(), &ImageLimits::default()),
        Err(CodecError::Bad { format: "TIFF", .. })
    ));
    let long = Tiff::new(24, 16, &[8], 1, &data).with(259, &[7]).with_tag(
        347,
        UNDEFINED,
        60_000,
        &[0; 60_000],
    );
    assert!(refusal(&long.bytes()).contains("JPEG tables of 60000 bytes"));
    // Without its last two bytes it is whole.
    let open = Tiff::new(24, 16, &[8], 1, &letters[..letters.len() - 2]).with(259, &[7]);
    let Decoded {
        pixmap, repairs, ..
    } = decode(&open.bytes(), &ImageLimits::default()).unwrap();
    assert!(repairs.end && pixmap == decoded(&letters));
}

#[test]
fn planes_are_put_together() {
    let planes = |photometric: u32, parts: &[&[u8]]| {
        let mut tiff = Tiff::new(2, 1, &vec![8; parts.len()], photometric, &[]).with(284, &[2]);
        tiff.parts = parts.iter().map(|part| part.to_vec()).collect();
        tiff
    };
    assert_eq!(
        samples(&planes(2, &[&[1, 2], &[3, 4], &[5, 6]])),
        [1, 3, 5, 2, 4, 6]
    );
    let alpha = planes(2, &[&[50, 9], &[25, 9], &[0, 9], &[100, 0]]);
    assert_eq!(
        samples(&alpha.with(338, &[1])),
        [128, 64, 0, 100, 0, 0, 0, 0]
    );
    let grey = || planes(0, &[&[50, 9], &[100, 0]]);
    assert_eq!(
        samples(&grey().with(338, &[2])),
        [205, 205, 205, 100, 246, 246, 246, 0]
    );
    assert!(refusal(&grey().bytes()).contains("2 samples per pixel"));
    // Two strips of each plane.
    let mut strips = Tiff::new(1, 2, &[8; 3], 2, &[])
        .with(284, &[2])
        .with(278, &[1]);
    strips.parts = [1, 2, 3, 4, 5, 6].map(|sample| vec![sample]).to_vec();
    assert_eq!(samples(&strips), [1, 3, 5, 2, 4, 6]);
}

#[test]
fn a_big_tiff_is_read_as_any_other() {
    let rgb: Vec<u8> = (0..40 * 30 * 3_u32).map(|n| (n * 7) as u8).collect();
    let mut file = std::io::Cursor::new(Vec::new());
    TiffEncoder::new_big(&mut file)
        .unwrap()
        .write_image::<colortype::RGB8>(40, 30, &rgb)
        .unwrap();
    let file = file.into_inner();
    assert_eq!((file[2], eight(&decoded(&file))), (43, rgb.as_slice()));
    for length in 0..file.len() {
        assert!(
            decode(&file[..length], &ImageLimits::default()).is_err() || length > file.len() - 16,
            "{length}"
        );
    }
    let mut huge = file;
    huge[8..16].fill(0xFF);
    assert!(matches!(
        decode(&huge, &ImageLimits::default()),
        Err(CodecError::Bad { .. })
    ));
}

/// A label image of one row: bits, format of the samples, predictor.
fn label_row(bits: u32, format: u32, predictor: u32, labels: &[i64]) -> Vec<u8> {
    let mut last = 0;
    let stored = labels.iter().map(|label| {
        let stored = if predictor == 2 {
            label.wrapping_sub(last)
        } else {
            *label
        };
        last = *label;
        stored
    });
    let data: Vec<u8> = stored
        .flat_map(|stored| stored.to_le_bytes()[..bits as usize / 8].to_vec())
        .collect();
    Tiff::new(labels.len() as u32, 1, &[bits], 1, &data)
        .with(339, &[format])
        .with(317, &[predictor])
        .bytes()
}

#[test]
fn labels_of_many_bits_are_read_if_their_values_fit() {
    let labels = [0, 1, 65_535, 300, 2];
    for bits in [32, 64] {
        for format in [1, 2] {
            for predictor in [1, 2] {
                let file = label_row(bits, format, predictor, &labels);
                let read = labels_of(&file).unwrap();
                assert_eq!(
                    (read.shape.depth, read.shape.samples()),
                    (Depth::Sixteen, 1)
                );
                let values: Vec<i64> = read
                    .values
                    .as_chunks()
                    .0
                    .iter()
                    .map(|value| u16::from_be_bytes(*value).into())
                    .collect();
                assert_eq!(values, labels, "{bits} {format} {predictor}");
                assert!(refusal(&file).contains("kind=labels"));
                let too_large = labels_of(&label_row(bits, format, predictor, &[0, 65_536]))
                    .unwrap_err()
                    .to_string();
                assert!(too_large.contains("label 65536"), "{too_large}");
            }
        }
    }
    for (bits, most) in [(8, 127), (16, 32_767), (32, 65_535), (64, 65_535)] {
        for predictor in [1, 2] {
            let read = labels_of(&label_row(bits, 2, predictor, &[0, most, 5])).unwrap();
            assert_eq!(
                read.shape.depth,
                if bits == 8 {
                    Depth::Eight
                } else {
                    Depth::Sixteen
                }
            );
            let negative = labels_of(&label_row(bits, 2, predictor, &[3, -1]))
                .unwrap_err()
                .to_string();
            assert!(negative.contains("negative"), "{bits}: {negative}");
        }
    }
}
