//! Metadata: every carrier of every format that is read, in every format that is written, is kept or named; the length of a pixel; what
//! describes the stored pixels is left out; and what hostile metadata cost.

use std::sync::Arc;

use super::made::{Jpeg, Png, exif_block, iccp, profile, riff, vp8x, webp_lossless};
use super::tiff::Tiff;
use super::*;
use crate::pixmap::Extent;

/// What tells a carrier's content in any file.
const TOKEN: &[u8] = b"the-token-of-the-carrier";
const ASCII: u16 = 2;
const RATIONAL: u16 = 5;
const UNDEFINED: u16 = 7;

const OUTPUTS: [(Encoding, Format); 4] = [
    (Encoding::Png(Compression::Fast), Format::Png),
    (Encoding::Jpeg { quality: 90, subsampling: Subsampling::Full, ground: [255; 3] }, Format::Jpeg),
    (Encoding::WebP, Format::WebP),
    (Encoding::Tiff(Compression::Fast), Format::Tiff),
];

fn token_in(file: &[u8]) -> bool {
    file.windows(TOKEN.len()).any(|window| window == TOKEN)
}

fn grey_profile() -> Vec<u8> {
    let mut profile = profile(400);
    profile[16..20].copy_from_slice(b"GRAY");
    profile
}

fn xmp(more: &str) -> Vec<u8> {
    format!("<x:xmpmeta>{more}{}</x:xmpmeta>", std::str::from_utf8(TOKEN).unwrap()).into_bytes()
}

/// A block of EXIF with the token, and everything that must not be kept.
fn rich_exif(little: bool) -> Vec<u8> {
    let short = |n: u16| if little { n.to_le_bytes() } else { n.to_be_bytes() };
    let (six, size) = (short(6), short(4_000));
    let main = [(0x0112, 3, 1, &six[..]), (0x013B, ASCII, TOKEN.len() as u32, TOKEN)];
    let photo = vec![(0xA002, 3, 1, &size[..]), (0x9003, ASCII, 20, b"2024:01:02 03:04:05\0".as_slice())];
    let gps = vec![(0x001D, ASCII, 11, b"2024:01:02\0".as_slice())];
    exif_block(little, &main, &[(0x8769, photo), (0x8825, gps)], b"\xFF\xD8 the thumbnail \xFF\xD9")
}

fn png(grey: bool) -> Png {
    if grey { Png::new(2, 1, 8, 0, &[9, 99]) } else { Png::new(2, 1, 8, 2, &[9; 6]) }
}

fn jpeg(grey: bool) -> Jpeg {
    if grey { Jpeg::flat(8, 8, &[(1, 1)], &[9]) } else { Jpeg::flat(8, 8, &[(1, 1); 3], &[9, 0, 0]) }
}

fn tiff(grey: bool) -> Tiff {
    if grey { Tiff::new(2, 1, &[8], 1, &[9, 99]) } else { Tiff::new(2, 1, &[8; 3], 2, &[9; 6]) }
}

fn webp(flags: u8, before: &[(&[u8; 4], &[u8])], after: &[(&[u8; 4], &[u8])]) -> Vec<u8> {
    let simple = webp_lossless(2, 1, Channels::Rgb, &[9; 6]);
    let head = vp8x(flags, (2, 1));
    let picture = (simple[12..16].try_into().unwrap(), &simple[20..]);
    riff(&[&[(b"VP8X", &head[..])], before, &[picture], after].concat())
}

/// A GIF with an extension before its frame: the label and the sub-blocks.
fn gif(label: u8, blocks: &[&[u8]]) -> Vec<u8> {
    let mut file = few_formats::gif(&[(3, 2)], None);
    let extension = blocks.iter().flat_map(|block| [&[block.len() as u8], *block].concat());
    let extension: Vec<u8> = [0x21, label].into_iter().chain(extension).chain([0]).collect();
    file.splice(25..25, extension);
    file
}

/// A BMP of version 4 or 5 of one pixel, with a colour space; a profile is appended.
fn bmp(size: u32, space: [u8; 4], gamma: u32, icc: &[u8]) -> Vec<u8> {
    let mut header = vec![0; size as usize];
    let mut put = |at: usize, number: u32| header[at..at + 4].copy_from_slice(&number.to_le_bytes());
    put(0, size);
    put(4, 1);
    put(8, 1);
    put(12, 1 | 24 << 16);
    put(56, u32::from_be_bytes(space));
    put(96, gamma);
    if size >= 124 {
        put(112, size + 4);
        put(116, icc.len() as u32);
    }
    let mut file = b"BM".to_vec();
    file.extend((14 + size + 4 + icc.len() as u32).to_le_bytes());
    file.extend([0; 4]);
    file.extend((14 + size).to_le_bytes());
    [file, header, vec![9, 9, 9, 0], icc.to_vec()].concat()
}

/// A carrier: its name, a file with it, how the content is recognised in an output, and what becomes of it in PNG, JPEG, WebP and TIFF:
/// `k`ept, `d`ropped by the name that follows, `p`: the colours lose their meaning, `-`: nothing that the format does not say by itself.
type Carrier = (&'static str, Vec<u8>, Sign, &'static str, &'static str);

#[derive(Clone)]
enum Sign {
    Token,
    Bytes(Vec<u8>),
    Icc(Vec<u8>),
    Resolution,
}

fn chunk(kind: [u8; 4], data: &[u8]) -> Sign {
    Sign::Bytes([&kind[..], data].concat())
}

fn png_carriers() -> Vec<Carrier> {
    let colour = |kind: [u8; 4], data: &[u8]| (png(false).with(kind, data).bytes(), chunk(kind, data));
    let mut carriers = Vec::new();
    let adobe = [31_270_u32, 32_900, 64_000, 33_000, 21_000, 71_000, 15_000, 6_000].map(u32::to_be_bytes);
    let bt709 = [31_270_u32, 32_900, 64_000, 33_000, 30_000, 60_000, 15_000, 6_000].map(u32::to_be_bytes);
    for (name, kind, data, want) in [
        ("sRGB", *b"sRGB", &[0][..], "k---"),
        ("gAMA of sRGB", *b"gAMA", &45_455_u32.to_be_bytes(), "k---"),
        ("gAMA of linear light", *b"gAMA", &100_000_u32.to_be_bytes(), "kppp"),
        ("cHRM of sRGB", *b"cHRM", bt709.as_flattened(), "k---"),
        ("cHRM of Adobe RGB", *b"cHRM", adobe.as_flattened(), "kppp"),
        ("cICP of sRGB", *b"cICP", &[1, 13, 0, 1], "k---"),
        ("cICP of Display P3", *b"cICP", &[12, 13, 0, 1], "kppp"),
        ("cICP of PQ", *b"cICP", &[9, 16, 0, 1], "kppp"),
    ] {
        let (file, sign) = colour(kind, data);
        carriers.push((name, file, sign, want, ""));
    }
    let hdr = png(false).with(*b"cICP", &[9, 16, 0, 1]);
    carriers.push(("mDCV", hdr.clone().with(*b"mDCV", &[7; 24]).bytes(), chunk(*b"mDCV", &[7; 24]), "kppp", ""));
    carriers.push(("cLLI", hdr.with(*b"cLLI", &[7; 8]).bytes(), chunk(*b"cLLI", &[7; 8]), "kppp", ""));
    carriers.push(("gAMA of the wrong length", png(false).with(*b"gAMA", &[1, 2]).bytes(), Sign::Token, "pppp", ""));
    carriers.push(("iCCP", png(false).with(*b"iCCP", &iccp(&profile(400))).bytes(), Sign::Icc(profile(400)), "kkkk", ""));
    let grey = png(true).with(*b"iCCP", &iccp(&grey_profile()));
    carriers.push(("iCCP of grey", grey.bytes(), Sign::Icc(grey_profile()), "kkpk", ""));
    carriers.push(("iCCP of RGB on grey", png(true).with(*b"iCCP", &iccp(&profile(400))).bytes(), Sign::Token, "pppp", ""));
    carriers.push(("eXIf", png(false).with(*b"eXIf", &rich_exif(true)).bytes(), Sign::Token, "kkkk", ""));
    let keyword = b"XML:com.adobe.xmp\0";
    let text = [&keyword[..], &[0; 4], &xmp("")].concat();
    carriers.push(("XMP", png(false).with(*b"iTXt", &text).bytes(), Sign::Token, "kkkk", ""));
    let deflated = [&keyword[..], &[1, 0, 0, 0], &made::deflate(&xmp(""))].concat();
    carriers.push(("XMP, compressed", png(false).with(*b"iTXt", &deflated).bytes(), Sign::Token, "kkkk", ""));
    carriers.push(("tEXt", png(false).with(*b"tEXt", &[b"Author\0", TOKEN].concat()).bytes(), Sign::Token, "kddd", "text"));
    let deflated = [b"Author\0\0".as_slice(), &made::deflate(TOKEN)].concat();
    carriers.push(("zTXt", png(false).with(*b"zTXt", &deflated).bytes(), chunk(*b"zTXt", &deflated), "kddd", "text"));
    let text = [b"Title\0\0\0de\0Titel\0".as_slice(), TOKEN].concat();
    carriers.push(("iTXt", png(false).with(*b"iTXt", &text).bytes(), Sign::Token, "kddd", "text"));
    carriers.push(("a comment", png(false).with(*b"tEXt", &[b"Comment\0", TOKEN].concat()).bytes(), Sign::Token, "kkdd", "text"));
    let raw = png(false).with(*b"zTXt", &[b"Raw profile type exif\0\0".as_slice(), &made::deflate(TOKEN)].concat());
    carriers.push(("a raw profile", raw.bytes(), Sign::Token, "dddd", "text"));
    carriers.push(("pHYs", png(false).with(*b"pHYs", b"\0\0\x2E\x23\0\0\x17\x11\x01").bytes(), Sign::Resolution, "kkkk", ""));
    carriers.push(("sBIT", png(false).with(*b"sBIT", &[5, 6, 5]).bytes(), Sign::Token, "dddd", "significant bits"));
    carriers.push(("sBIT of every bit", png(false).with(*b"sBIT", &[8, 8, 8]).bytes(), Sign::Token, "----", ""));
    carriers.push(("sCAL", png(false).with(*b"sCAL", b"\x011\x001").bytes(), Sign::Token, "dddd", "calibration"));
    carriers.push(("caBX", png(false).with(*b"caBX", TOKEN).bytes(), Sign::Token, "dddd", "C2PA"));
    carriers.push(("a private chunk", png(false).with(*b"prVt", TOKEN).bytes(), Sign::Token, "dddd", "application data"));
    carriers.push(("tIME", png(false).with(*b"tIME", &[7, 232, 1, 2, 3, 4, 5]).bytes(), Sign::Token, "----", ""));
    carriers
}

fn jpeg_carriers() -> Vec<Carrier> {
    let with = |marker: u8, head: &[u8], data: &[u8]| jpeg(false).with_segment(marker, &[head, data].concat()).bytes();
    let icc = |profile: &[u8]| [b"ICC_PROFILE\0\x01\x01".as_slice(), profile].concat();
    let resource = |id: u16| [b"8BIM".as_slice(), &id.to_be_bytes(), &[0; 2], &24_u32.to_be_bytes(), TOKEN].concat();
    let photoshop = |id: u16| with(0xED, b"Photoshop 3.0\0", &resource(id));
    vec![
        ("JFIF", with(0xE0, b"JFIF\0\x01\x02", b"\x01\x01\x2C\0\x96\0\0"), Sign::Resolution, "kkkk", ""),
        ("EXIF", with(0xE1, b"Exif\0\0", &rich_exif(false)), Sign::Token, "kkkk", ""),
        ("XMP", with(0xE1, b"http://ns.adobe.com/xap/1.0/\0", &xmp("")), Sign::Token, "kkkk", ""),
        ("extended XMP", with(0xE1, b"http://ns.adobe.com/xmp/extension/\0", TOKEN), Sign::Token, "dddd", "extended XMP"),
        ("ICC", with(0xE2, b"", &icc(&profile(400))), Sign::Icc(profile(400)), "kkkk", ""),
        ("ICC of grey", jpeg(true).with_segment(0xE2, &icc(&grey_profile())).bytes(), Sign::Icc(grey_profile()), "kkpk", ""),
        ("ICC of grey on RGB", with(0xE2, b"", &icc(&grey_profile())), Sign::Token, "pppp", ""),
        ("MPF", with(0xE2, b"MPF\0", TOKEN), Sign::Token, "dddd", "further images"),
        ("IPTC", photoshop(0x0404), Sign::Token, "dddd", "IPTC"),
        ("a path", photoshop(2_000), Sign::Token, "dddd", "paths"),
        ("settings of Photoshop", photoshop(0x03F3), Sign::Token, "----", ""),
        ("C2PA", with(0xEB, b"JP\0\x01", TOKEN), Sign::Token, "dddd", "C2PA"),
        ("another application", with(0xE5, b"", TOKEN), Sign::Token, "dddd", "application data"),
        ("a comment", with(0xFE, b"", TOKEN), Sign::Token, "kkdd", "comment"),
    ]
}

fn tiff_carriers() -> Vec<Carrier> {
    let with = |tag: u16, kind: u16, data: &[u8]| {
        let size = if kind == RATIONAL { 8 } else { 1 };
        tiff(false).with_tag(tag, kind, data.len() / size, data)
    };
    let ratio = |n: u32, d: u32| [n.to_le_bytes(), d.to_le_bytes()].concat();
    let resolution = with(282, RATIONAL, &ratio(5, 2)).with_tag(283, RATIONAL, 1, &ratio(7, 2)).with(296, &[3]);
    let ome = [b"<?xml version='1.0'?><OME>".as_slice(), TOKEN].concat();
    let shape = [b"{\"shape\": [1, 2]}".as_slice(), TOKEN].concat();
    let resource = [b"8BIM\x04\x04\0\0\0\0\0\x18".as_slice(), TOKEN].concat();
    let grey = tiff(true).with_tag(34_675, UNDEFINED, 400, &grey_profile());
    vec![
        ("XResolution", resolution.bytes(), Sign::Resolution, "kkkk", ""),
        ("ICC", with(34_675, UNDEFINED, &profile(400)).bytes(), Sign::Icc(profile(400)), "kkkk", ""),
        ("ICC of grey", grey.bytes(), Sign::Icc(grey_profile()), "kkpk", ""),
        ("TransferFunction", tiff(false).with(301, &[7; 768]).bytes(), Sign::Token, "pppp", ""),
        ("WhitePoint", with(318, RATIONAL, &ratio(1, 3).repeat(2)).bytes(), Sign::Token, "pppp", ""),
        ("PrimaryChromaticities", with(319, RATIONAL, &ratio(1, 3).repeat(6)).bytes(), Sign::Token, "pppp", ""),
        (
            "WhitePoint beside ICC",
            with(318, RATIONAL, &ratio(1, 3).repeat(2)).with_tag(34_675, UNDEFINED, 400, &profile(400)).bytes(),
            Sign::Icc(profile(400)),
            "kkkk",
            "",
        ),
        ("ImageDescription", with(270, ASCII, TOKEN).bytes(), Sign::Token, "kkkk", ""),
        ("Artist", with(315, ASCII, TOKEN).bytes(), Sign::Token, "kkkk", ""),
        ("PageName", with(285, ASCII, TOKEN).bytes(), Sign::Token, "kkkk", ""),
        ("OME-XML", with(270, ASCII, &ome).bytes(), Sign::Token, "dddd", "OME-XML"),
        ("the shape of an array", with(270, ASCII, &shape).bytes(), Sign::Token, "----", ""),
        ("XMP", with(700, 1, &xmp("")).bytes(), Sign::Token, "kkkk", ""),
        ("IPTC", with(33_723, UNDEFINED, TOKEN).bytes(), Sign::Token, "dddd", "IPTC"),
        ("IPTC of Photoshop", with(34_377, UNDEFINED, &resource).bytes(), Sign::Token, "dddd", "IPTC"),
        ("layers of Photoshop", with(37_724, UNDEFINED, TOKEN).bytes(), Sign::Token, "dddd", "Photoshop layers"),
        ("GeoTIFF", with(34_737, ASCII, TOKEN).bytes(), Sign::Token, "dddd", "GeoTIFF"),
        ("ImageJ", with(50_839, UNDEFINED, TOKEN).bytes(), Sign::Token, "dddd", "ImageJ tags"),
        ("a private tag", with(65_000, UNDEFINED, TOKEN).bytes(), Sign::Token, "dddd", "application data"),
        ("a mask", Tiff { more: vec![4], ..tiff(false) }.bytes(), Sign::Token, "dddd", "transparency mask"),
    ]
}

fn other_carriers() -> Vec<Carrier> {
    let with = |flags: u8, after: &[(&[u8; 4], &[u8])]| webp(flags, &[], after);
    let packet = [xmp("").as_slice(), &[1], &(0..=255).rev().collect::<Vec<u8>>(), &[0]].concat();
    let mut gif_xmp = few_formats::gif(&[(3, 2)], None);
    gif_xmp.splice(25..25, [b"\x21\xFF\x0BXMP DataXMP".as_slice(), &packet, &[0]].concat());
    let icc = profile(400);
    let (first, second) = icc.split_at(255);
    let sized = {
        let mut file = few_formats::bmp(5, 4, &[9; 60]);
        file[38..46].copy_from_slice(&[0x23, 0x2E, 0, 0, 0x11, 0x17, 0, 0]);
        file
    };
    vec![
        ("WebP: ICCP", webp(0x20, &[(b"ICCP", &icc)], &[]), Sign::Icc(icc.clone()), "kkkk", ""),
        ("WebP: EXIF", with(0x08, &[(b"EXIF", &rich_exif(true))]), Sign::Token, "kkkk", ""),
        ("WebP: XMP", with(0x04, &[(b"XMP ", &xmp(""))]), Sign::Token, "kkkk", ""),
        ("WebP: C2PA", with(0, &[(b"C2PA", TOKEN)]), Sign::Token, "dddd", "C2PA"),
        ("WebP: another chunk", with(0, &[(b"ABCD", TOKEN)]), Sign::Token, "dddd", "application data"),
        ("GIF: a comment", gif(0xFE, &[TOKEN]), Sign::Token, "kkdd", "comment"),
        ("GIF: XMP", gif_xmp, Sign::Token, "kkkk", ""),
        ("GIF: ICC", gif(0xFF, &[b"ICCRGBG1012", first, second]), Sign::Icc(icc.clone()), "kkkk", ""),
        ("GIF: loops", gif(0xFF, &[b"NETSCAPE2.0", &[1, 0, 0]]), Sign::Token, "----", ""),
        ("GIF: another application", gif(0xFF, &[b"ABCDEFGH1.0", TOKEN]), Sign::Token, "dddd", "application data"),
        ("BMP: pixels per metre", sized, Sign::Resolution, "kkkk", ""),
        ("BMP: a profile", bmp(124, *b"MBED", 0, &icc), Sign::Icc(icc.clone()), "kkkk", ""),
        ("BMP: a profile elsewhere", bmp(124, *b"LINK", 0, TOKEN), Sign::Token, "pppp", ""),
        ("BMP: calibrated", bmp(108, [0; 4], 1 << 16, &[]), Sign::Token, "pppp", ""),
        ("BMP: not calibrated", bmp(108, [0; 4], 0, &[]), Sign::Token, "----", ""),
        ("BMP: sRGB", bmp(108, *b"sRGB", 1 << 16, &[]), Sign::Token, "----", ""),
    ]
}

/// A decoded file, written in a format as a picture of another size would be: the file, and what is lost.
fn written(file: &[u8], encoding: Encoding, format: Format, scale: (u32, u32)) -> (Vec<u8>, (bool, Dropped), Arc<Metadata>) {
    let work = StepCounter::new(&|| false);
    let opened = open(file, &Limits::default(), &work).unwrap();
    let Decoded { pixmap, metadata, .. } = opened.decode().unwrap();
    let metadata = Arc::new(metadata);
    let times = |factor: u32| Extent::new(7 * factor, 5 * factor).unwrap();
    let (target, canvas) = if scale == (1, 1) { (pixmap.extent(), pixmap.extent()) } else { (times(scale.0), times(scale.1)) };
    let carried = Carried::new(&metadata, target, canvas);
    let grey = opened.header().grey;
    let shape = PngShape { extent: target, channels: Channels::Rgb, grey, depth: Depth::Eight };
    let writer = Writer::new(shape, encoding, Some(&carried));
    let mut out = writer.head();
    let samples = vec![77; 3 * target.pixels() as usize];
    let strip = |k: usize, out: &mut Vec<u8>| {
        let rows = writer.rows(k).len() * target.width() as usize * 3;
        writer.strip_into(k, &mut samples[..rows].to_vec(), out, &|| true)
    };
    let sums: Vec<_> = (0..writer.strips()).map(|k| strip(k, &mut out)).collect();
    out.extend(writer.tail(&sums));
    assert!(out.len() as u64 <= writer.max_bytes());
    (out, carried.losses(format, grey && encoding.is_grey()), metadata)
}

fn read_metadata(file: &[u8]) -> Metadata {
    decode(file, &Limits::default()).unwrap().metadata
}

#[test]
fn every_carrier_is_kept_or_named_in_every_format() {
    for (source, carriers) in [("PNG", png_carriers()), ("JPEG", jpeg_carriers()), ("TIFF", tiff_carriers()), ("other", other_carriers())] {
        for (name, file, sign, want, dropped_as) in carriers {
            for ((encoding, format), want) in OUTPUTS.into_iter().zip(want.chars()) {
                let case = format!("{source}: {name} as {}", format.name());
                let (out, (profile, dropped), metadata) = written(&file, encoding, format, (1, 1));
                let names: Vec<&str> = dropped.names().collect();
                let is_kept = match &sign {
                    Sign::Token => token_in(&out),
                    Sign::Bytes(bytes) => out.windows(bytes.len()).any(|window| window == bytes),
                    Sign::Icc(icc) => read_metadata(&out).icc() == Some(icc.as_slice()),
                    Sign::Resolution => {
                        let [before, after] = [Some(metadata.resolution()), Some(read_metadata(&out).resolution())]
                            .map(|resolution| resolution.flatten().expect(&case).per_millimetre());
                        before.iter().zip(after).all(|(a, b)| (a / b - 1.0).abs() < 1e-4)
                    }
                };
                assert_eq!(is_kept, want == 'k', "{case}: {names:?}");
                assert_eq!(profile, want == 'p', "{case}");
                assert_eq!(names, if want == 'd' { vec![dropped_as] } else { vec![] }, "{case}");
                // What is kept once is kept again: nothing is lost on the second way.
                if want == 'k' {
                    let (again, (profile, dropped), _) = written(&out, encoding, format, (1, 1));
                    assert!(!profile && dropped.is_empty(), "{case}, again: {:?}", dropped.names().collect::<Vec<_>>());
                    assert!(again == out, "{case}: the second way gives other bytes");
                }
            }
        }
    }
}

#[test]
fn what_describes_the_stored_pixels_is_left_out_of_exif() {
    for (name, file) in [
        ("PNG", png(false).with(*b"eXIf", &rich_exif(true)).bytes()),
        ("JPEG", jpeg(false).with_segment(0xE1, &[b"Exif\0\0".as_slice(), &rich_exif(false)].concat()).bytes()),
    ] {
        for (encoding, format) in OUTPUTS {
            let (out, ..) = written(&file, encoding, format, (1, 1));
            let has = |text: &[u8]| out.windows(text.len()).any(|window| window == text);
            assert!(token_in(&out) && has(b"2024:01:02 03:04:05") && has(b"2024:01:02\0"), "{name} as {}", format.name());
            assert!(!has(b"thumbnail"), "{name} as {}", format.name());
            // Six would turn it once more; the width was 4000.
            let header = probe(&out).unwrap().extent;
            assert_eq!(header, decoded(&file).extent(), "{name} as {}", format.name());
            assert!(!has(&[0x0F, 0xA0]) && !has(&[0xA0, 0x0F]), "{name} as {}: the old width", format.name());
        }
    }
}

/// A maker's note keeps its place, because its offsets may count from the beginning of the block; one with a picture is dropped.
#[test]
fn a_makers_note_stays_at_its_place() {
    let note: Vec<u8> = [b"MAKER\0".as_slice(), TOKEN].concat();
    let with = |note: &[u8], little: bool| {
        let photo = vec![(0x927C, UNDEFINED, note.len() as u32, note), (0x9003, ASCII, 20, b"2024:01:02 03:04:05\0".as_slice())];
        exif_block(little, &[(0x0131, ASCII, 24, &[b'x'; 24])], &[(0x8769, photo)], &[])
    };
    for little in [true, false] {
        let block = with(&note, little);
        let place = |file: &[u8], start: &[u8]| {
            let start = file.windows(start.len()).position(|window| window == start).unwrap();
            file[start..].windows(note.len()).position(|window| window == note)
        };
        let head: &[u8] = if little { b"II*\0" } else { b"MM\0*" };
        let file = png(false).with(*b"eXIf", &block).bytes();
        for (encoding, format) in OUTPUTS {
            let (out, (_, dropped), _) = written(&file, encoding, format, (1, 1));
            if format == Format::Tiff {
                assert_eq!(dropped.names().collect::<Vec<_>>(), ["maker note"]);
                assert!(!token_in(&out));
            } else {
                assert!(dropped.is_empty());
                assert_eq!(place(&out, head), place(&block, head), "{}", format.name());
            }
        }
        let preview = [note.as_slice(), &[0xFF, 0xD8, 0xFF, 0xE0]].concat();
        let file = png(false).with(*b"eXIf", &with(&preview, little)).bytes();
        let (out, (_, dropped), _) = written(&file, OUTPUTS[0].0, Format::Png, (1, 1));
        assert_eq!(dropped.names().collect::<Vec<_>>(), ["maker note"]);
        assert!(!token_in(&out) && out.windows(19).any(|window| window == b"2024:01:02 03:04:05"));
    }
}

/// Files of a known resolution: its form, and px per mm (or px without a unit).
fn resolutions() -> Vec<(&'static str, Vec<u8>, [f64; 2])> {
    let ratio = |n: u32, d: u32| [n.to_le_bytes(), d.to_le_bytes()].concat();
    let tiff_of = |x: (u32, u32), y: (u32, u32), unit: u32| {
        let file = tiff(false).with_tag(282, RATIONAL, 1, &ratio(x.0, x.1)).with_tag(283, RATIONAL, 1, &ratio(y.0, y.1));
        file.with(296, &[unit]).bytes()
    };
    let png_of = |x: u32, y: u32, unit: u8| png(false).with(*b"pHYs", &[&x.to_be_bytes()[..], &y.to_be_bytes(), &[unit]].concat()).bytes();
    let jpeg_of = |unit: u8, x: u16, y: u16| {
        jpeg(false).with_segment(0xE0, &[b"JFIF\0\x01\x02", &[unit][..], &x.to_be_bytes(), &y.to_be_bytes(), &[0; 2]].concat()).bytes()
    };
    let by_exif = {
        let (x, y) = (ratio(350, 1), ratio(2_001, 10));
        let block = exif_block(true, &[(282, RATIONAL, 1, &x), (283, RATIONAL, 1, &y), (296, 3, 1, &[2, 0])], &[], &[]);
        jpeg(false).with_segment(0xE1, &[b"Exif\0\0".as_slice(), &block].concat()).bytes()
    };
    vec![
        ("300 dpi in PNG", png_of(11_811, 11_811, 1), [11.811; 2]),
        ("a microscope in PNG", png_of(4_000_000, 2_000_000, 1), [4_000.0, 2_000.0]),
        ("300 x 150 dpi in JPEG", jpeg_of(1, 300, 150), [300.0 / 25.4, 150.0 / 25.4]),
        ("120 per cm in JPEG", jpeg_of(2, 120, 120), [12.0; 2]),
        ("EXIF", by_exif, [350.0 / 25.4, 200.1 / 25.4]),
        ("2.5 per cm in TIFF", tiff_of((5, 2), (7, 2), 3), [0.25, 0.35]),
        ("a microscope in TIFF", tiff_of((40_000, 1), (40_000, 1), 3), [4_000.0; 2]),
        ("an aerial photograph in TIFF", tiff_of((1, 50), (1, 50), 3), [0.002; 2]),
        ("per micrometre, as ImageJ says it", tiff_of((25, 10), (25, 10), 1), [2.5; 2]),
    ]
}

/// px per mm, divided by the scale, are those of the source, in every format.
#[test]
fn a_pixel_keeps_its_length() {
    for (name, file, known) in resolutions() {
        for (encoding, format) in OUTPUTS {
            for scale in [(1, 1), (1, 2), (3, 1), (2, 7)] {
                let (out, (_, dropped), _) = written(&file, encoding, format, scale);
                let got = read_metadata(&out).resolution().unwrap_or_else(|| panic!("{name} as {}", format.name())).per_millimetre();
                for (got, known) in got.into_iter().zip(known) {
                    let want = known * f64::from(scale.0) / f64::from(scale.1);
                    assert!((got / want - 1.0).abs() < 2e-4, "{name} as {} at {scale:?}: {got} for {want}", format.name());
                }
                assert!(dropped.is_empty());
            }
        }
    }
}

#[test]
fn the_same_format_and_size_keep_the_same_numbers() {
    let kept = |file: &[u8], encoding, format| read_metadata(&written(file, encoding, format, (1, 1)).0).resolution();
    for (name, file, _) in resolutions() {
        let format = match SourceFormat::of(&file).unwrap() {
            SourceFormat::Written(format) => format,
            other => panic!("{other:?}"),
        };
        let (encoding, _) = OUTPUTS.into_iter().find(|(_, output)| *output == format).unwrap();
        let before = read_metadata(&file).resolution();
        assert_eq!(kept(&file, encoding, format), before, "{name}");
    }
    // Nothing known: a TIFF must say something, which means nothing.
    let plain = written(&png(false).bytes(), OUTPUTS[3].0, Format::Tiff, (1, 1)).0;
    assert_eq!(read_metadata(&plain).resolution(), None);
    let mut theirs = ::tiff::decoder::Decoder::new(std::io::Cursor::new(&plain)).unwrap();
    let tag = |theirs: &mut ::tiff::decoder::Decoder<_>, tag| theirs.get_tag(tag).unwrap();
    assert_eq!(tag(&mut theirs, ::tiff::tags::Tag::XResolution), ::tiff::decoder::ifd::Value::Rational(1, 1));
    assert_eq!(tag(&mut theirs, ::tiff::tags::Tag::ResolutionUnit).into_u16().unwrap(), 1);
}

#[test]
fn a_turned_picture_has_its_resolutions_swapped() {
    for (number, swaps) in [(1, false), (3, false), (5, true), (6, true), (7, true), (8, true)] {
        let file = png(false).with(*b"pHYs", b"\0\0\0\x64\0\0\0\xC8\x01").with(*b"eXIf", &exif(number, true)).bytes();
        let resolution = read_metadata(&file).resolution().unwrap();
        let [x, y] = if swaps { [200, 100] } else { [100, 200] };
        assert_eq!(resolution, Resolution::whole(x, y, Unit::Metre).unwrap(), "{number}");
    }
}

/// Other readers find what is written.
#[test]
fn other_readers_find_the_metadata() {
    use image::ImageDecoder as _;
    let ratio = |n: u32| [n.to_le_bytes(), 1_u32.to_le_bytes()].concat();
    let source = tiff(false).with_tag(282, RATIONAL, 1, &ratio(300)).with_tag(283, RATIONAL, 1, &ratio(300)).with(296, &[2]);
    let source = source.with_tag(315, ASCII, TOKEN.len(), TOKEN).with_tag(34_675, UNDEFINED, 400, &profile(400)).bytes();
    let out = |k: usize| std::io::Cursor::new(written(&source, OUTPUTS[k].0, OUTPUTS[k].1, (1, 1)).0);
    let check = |exif: Option<Vec<u8>>, icc: Option<Vec<u8>>| {
        assert!(exif.is_some_and(|exif| token_in(&exif)));
        assert_eq!(icc.as_deref(), Some(profile(400).as_slice()));
    };
    let mut png = image::codecs::png::PngDecoder::new(out(0)).unwrap();
    check(png.exif_metadata().unwrap(), png.icc_profile().unwrap());
    let mut jpeg = image::codecs::jpeg::JpegDecoder::new(out(1)).unwrap();
    check(jpeg.exif_metadata().unwrap(), jpeg.icc_profile().unwrap());
    let mut webp = image::codecs::webp::WebPDecoder::new(out(2)).unwrap();
    check(webp.exif_metadata().unwrap(), webp.icc_profile().unwrap());
    let mut theirs = ::tiff::decoder::Decoder::new(out(3)).unwrap();
    use ::tiff::tags::Tag;
    assert_eq!(theirs.get_tag_ascii_string(Tag::Artist).unwrap().as_bytes(), TOKEN);
    assert_eq!(theirs.get_tag(Tag::XResolution).unwrap(), ::tiff::decoder::ifd::Value::Rational(300, 1));
    assert_eq!(theirs.get_tag_u8_vec(Tag::IccProfile).unwrap(), profile(400));
}

/// Files whose metadata are made to cost more than their size.
pub(super) fn hostile() -> Vec<(&'static str, Vec<u8>)> {
    let keyword = b"XML:com.adobe.xmp\0\x01\0\0\0";
    let bomb = made::deflate(&vec![b' '; 64 << 20]);
    let many = |kind: [u8; 4], data: &[u8], count: usize| {
        let mut png = png(false);
        png.before = vec![(kind, data.to_vec()); count];
        png.bytes()
    };
    // Each directory leads to itself, and each value is the whole block.
    let looped = {
        let mut block = b"II*\0\x08\0\0\0".to_vec();
        let count = 5_000_u16;
        block.extend(count.to_le_bytes());
        for tag in 0..count {
            let (tag, kind, count, at) = match tag {
                0 => (0x8769_u16, 4_u16, 1_u32, 8_u32),
                1 => (0x8825, 4, 1, 8),
                2 => (0xA005, 4, 1, 8),
                _ => (0x9000 + tag, UNDEFINED, 60_000, 8),
            };
            block.extend([&tag.to_le_bytes()[..], &kind.to_le_bytes(), &count.to_le_bytes(), &at.to_le_bytes()].concat());
        }
        block.extend(8_u32.to_le_bytes());
        block.resize(64_000, 0);
        block
    };
    let properties = "<tiff:Orientation/>".repeat(3_000);
    vec![
        ("a profile that inflates", png(false).with(*b"iCCP", &iccp(&vec![0; 64 << 20])).bytes()),
        ("XMP that inflates", png(false).with(*b"iTXt", &[&keyword[..], &bomb].concat()).bytes()),
        ("texts that inflate", many(*b"zTXt", &[b"a\0\0".as_slice(), &bomb[..30_000]].concat(), 40)),
        ("thousands of texts", many(*b"tEXt", b"a\0b", 20_000)),
        ("thousands of empty texts", many(*b"iTXt", b"", 20_000)),
        ("thousands of chunks", many(*b"prVt", b"", 50_000)),
        ("thousands of profiles", many(*b"iCCP", &iccp(&profile(400)), 3_000)),
        ("directories that lead to themselves", png(false).with(*b"eXIf", &looped).bytes()),
        ("the same in a JPEG", jpeg(false).with_segment(0xE1, &[b"Exif\0\0".as_slice(), &looped].concat()).bytes()),
        (
            "thousands of properties",
            jpeg(false).with_segment(0xE1, &[b"http://ns.adobe.com/xap/1.0/\0", properties.as_bytes()].concat()).bytes(),
        ),
        ("thousands of comments", (0..5_000).fold(jpeg(false), |jpeg, _| jpeg.with_segment(0xFE, b"a")).bytes()),
        ("many zeros between segments", {
            let mut file = jpeg(false).with_segment(0xFE, b"a").bytes();
            file.splice(7..7, vec![0; 1 << 20]);
            file
        }),
        ("thousands of tags", (0..20_000).fold(tiff(false), |tiff, k| tiff.with_tag(40_000 + k, ASCII, 3, b"ab\0")).bytes()),
        ("thousands of extensions", {
            let mut file = few_formats::gif(&[(3, 2)], None);
            file.splice(25..25, b"\x21\xFE\x01a\0".repeat(50_000));
            file
        }),
    ]
}

#[test]
fn hostile_metadata_cost_little_memory() {
    for (name, file) in hostile() {
        let metadata = read_metadata(&file);
        let held = metadata.bytes() as u64;
        assert!(held <= METADATA_BYTES + PROFILE_BYTES, "{name}: {held}");
        let carried = Carried::new(&Arc::new(metadata), Extent::new(1, 1).unwrap(), Extent::new(1, 1).unwrap());
        for (encoding, format) in OUTPUTS {
            let shape = PngShape { extent: Extent::new(8, 8).unwrap(), channels: Channels::Rgb, grey: false, depth: Depth::Eight };
            let writer = Writer::new(shape, encoding, Some(&carried));
            let mut out = writer.head();
            let sum = writer.strip_into(0, &mut vec![0; 192], &mut out, &|| true);
            out.extend(writer.tail(&[sum]));
            assert!(out.len() as u64 <= writer.max_bytes().min(METADATA_BYTES + PROFILE_BYTES), "{name} as {}", format.name());
            assert!(decode(&out, &Limits::default()).is_ok(), "{name} as {}", format.name());
        }
    }
}
