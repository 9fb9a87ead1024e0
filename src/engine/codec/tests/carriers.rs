//! Files with one carrier of metadata each, and what becomes of it in every format.

use super::made::{Jpeg, Png, exif_block, iccp, profile, riff, vp8x, webp_lossless};
use super::tiff::Tiff;
use super::*;

/// What tells a carrier's content in any file.
pub(super) const TOKEN: &[u8] = b"the-token-of-the-carrier";
pub(super) const ASCII: u16 = 2;
pub(super) const RATIONAL: u16 = 5;
pub(super) const UNDEFINED: u16 = 7;

pub(super) fn grey_profile() -> Vec<u8> {
    let mut profile = profile(400);
    profile[16..20].copy_from_slice(b"GRAY");
    profile
}

pub(super) fn xmp(more: &str) -> Vec<u8> {
    format!(
        "<x:xmpmeta>{more}{}</x:xmpmeta>",
        std::str::from_utf8(TOKEN).unwrap()
    )
    .into_bytes()
}

/// A block of EXIF with the token, and everything that must not be kept.
pub(super) fn rich_exif(little: bool) -> Vec<u8> {
    let short = |n: u16| {
        if little {
            n.to_le_bytes()
        } else {
            n.to_be_bytes()
        }
    };
    let (six, size) = (short(6), short(4_000));
    let main = [
        (0x0112, 3, 1, &six[..]),
        (0x013B, ASCII, TOKEN.len() as u32, TOKEN),
    ];
    let photo = vec![
        (0xA002, 3, 1, &size[..]),
        (0x9003, ASCII, 20, b"2024:01:02 03:04:05\0".as_slice()),
    ];
    let gps = vec![(0x001D, ASCII, 11, b"2024:01:02\0".as_slice())];
    exif_block(
        little,
        &main,
        &[(0x8769, photo), (0x8825, gps)],
        b"\xFF\xD8 the thumbnail \xFF\xD9",
    )
}

pub(super) fn png(grey: bool) -> Png {
    if grey {
        Png::new(2, 1, 8, 0, &[9, 99])
    } else {
        Png::new(2, 1, 8, 2, &[9; 6])
    }
}

pub(super) fn jpeg(grey: bool) -> Jpeg {
    if grey {
        Jpeg::flat(8, 8, &[(1, 1)], &[9])
    } else {
        Jpeg::flat(8, 8, &[(1, 1); 3], &[9, 0, 0])
    }
}

pub(super) fn tiff(grey: bool) -> Tiff {
    if grey {
        Tiff::new(2, 1, &[8], 1, &[9, 99])
    } else {
        Tiff::new(2, 1, &[8; 3], 2, &[9; 6])
    }
}

pub(super) fn webp(
    flags: u8,
    before: &[(&[u8; 4], &[u8])],
    after: &[(&[u8; 4], &[u8])],
) -> Vec<u8> {
    let simple = webp_lossless(2, 1, Channels::Rgb, &[9; 6]);
    let head = vp8x(flags, (2, 1));
    let picture = (simple[12..16].try_into().unwrap(), &simple[20..]);
    riff(&[&[(b"VP8X", &head[..])], before, &[picture], after].concat())
}

/// A GIF with an extension before its frame: the label and the sub-blocks.
pub(super) fn gif(label: u8, blocks: &[&[u8]]) -> Vec<u8> {
    let mut file = few_formats::gif(&[(3, 2)], None);
    let extension = blocks
        .iter()
        .flat_map(|block| [&[block.len() as u8], *block].concat());
    let extension: Vec<u8> = [0x21, label]
        .into_iter()
        .chain(extension)
        .chain([0])
        .collect();
    file.splice(25..25, extension);
    file
}

/// A BMP of version 4 or 5 of one pixel, with a colour space; a profile is appended.
pub(super) fn bmp(size: u32, space: [u8; 4], gamma: u32, icc: &[u8]) -> Vec<u8> {
    let mut header = vec![0; size as usize];
    let mut put =
        |at: usize, number: u32| header[at..at + 4].copy_from_slice(&number.to_le_bytes());
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

/// A carrier: its name, a file with it, how the content is recognised in an output, and what
/// becomes of it in PNG, JPEG, WebP and TIFF: `k`ept, `d`ropped by the name that follows, `p`: the
/// colours lose their meaning, `-`: nothing that the format does not say by itself.
pub(super) type Carrier = (&'static str, Vec<u8>, Sign, &'static str, &'static str);

#[derive(Clone)]
pub(super) enum Sign {
    Token,
    Bytes(Vec<u8>),
    Icc(Vec<u8>),
    Resolution,
}

pub(super) fn chunk(kind: [u8; 4], data: &[u8]) -> Sign {
    Sign::Bytes([&kind[..], data].concat())
}

pub(super) fn png_carriers() -> Vec<Carrier> {
    let colour =
        |kind: [u8; 4], data: &[u8]| (png(false).with(kind, data).bytes(), chunk(kind, data));
    let mut carriers = Vec::new();
    let adobe = [
        31_270_u32, 32_900, 64_000, 33_000, 21_000, 71_000, 15_000, 6_000,
    ]
    .map(u32::to_be_bytes);
    let bt709 = [
        31_270_u32, 32_900, 64_000, 33_000, 30_000, 60_000, 15_000, 6_000,
    ]
    .map(u32::to_be_bytes);
    for (name, kind, data, want) in [
        ("sRGB", *b"sRGB", &[0][..], "k---"),
        ("gAMA of sRGB", *b"gAMA", &45_455_u32.to_be_bytes(), "k---"),
        (
            "gAMA of linear light",
            *b"gAMA",
            &100_000_u32.to_be_bytes(),
            "kppp",
        ),
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
    carriers.push((
        "mDCV",
        hdr.clone().with(*b"mDCV", &[7; 24]).bytes(),
        chunk(*b"mDCV", &[7; 24]),
        "kppp",
        "",
    ));
    carriers.push((
        "cLLI",
        hdr.with(*b"cLLI", &[7; 8]).bytes(),
        chunk(*b"cLLI", &[7; 8]),
        "kppp",
        "",
    ));
    carriers.push((
        "gAMA of the wrong length",
        png(false).with(*b"gAMA", &[1, 2]).bytes(),
        Sign::Token,
        "pppp",
        "",
    ));
    carriers.push((
        "iCCP",
        png(false).with(*b"iCCP", &iccp(&profile(400))).bytes(),
        Sign::Icc(profile(400)),
        "kkkk",
        "",
    ));
    let grey = png(true).with(*b"iCCP", &iccp(&grey_profile()));
    carriers.push((
        "iCCP of grey",
        grey.bytes(),
        Sign::Icc(grey_profile()),
        "kkpk",
        "",
    ));
    carriers.push((
        "iCCP of RGB on grey",
        png(true).with(*b"iCCP", &iccp(&profile(400))).bytes(),
        Sign::Token,
        "pppp",
        "",
    ));
    carriers.push((
        "eXIf",
        png(false).with(*b"eXIf", &rich_exif(true)).bytes(),
        Sign::Token,
        "kkkk",
        "",
    ));
    let keyword = b"XML:com.adobe.xmp\0";
    let text = [&keyword[..], &[0; 4], &xmp("")].concat();
    carriers.push((
        "XMP",
        png(false).with(*b"iTXt", &text).bytes(),
        Sign::Token,
        "kkkk",
        "",
    ));
    let deflated = [&keyword[..], &[1, 0, 0, 0], &made::deflate(&xmp(""))].concat();
    carriers.push((
        "XMP, compressed",
        png(false).with(*b"iTXt", &deflated).bytes(),
        Sign::Token,
        "kkkk",
        "",
    ));
    carriers.push((
        "tEXt",
        png(false)
            .with(*b"tEXt", &[b"Author\0", TOKEN].concat())
            .bytes(),
        Sign::Token,
        "kddd",
        "text",
    ));
    let deflated = [b"Author\0\0".as_slice(), &made::deflate(TOKEN)].concat();
    carriers.push((
        "zTXt",
        png(false).with(*b"zTXt", &deflated).bytes(),
        chunk(*b"zTXt", &deflated),
        "kddd",
        "text",
    ));
    let text = [b"Title\0\0\0de\0Titel\0".as_slice(), TOKEN].concat();
    carriers.push((
        "iTXt",
        png(false).with(*b"iTXt", &text).bytes(),
        Sign::Token,
        "kddd",
        "text",
    ));
    carriers.push((
        "a comment",
        png(false)
            .with(*b"tEXt", &[b"Comment\0", TOKEN].concat())
            .bytes(),
        Sign::Token,
        "kkdd",
        "text",
    ));
    let raw = png(false).with(
        *b"zTXt",
        &[
            b"Raw profile type exif\0\0".as_slice(),
            &made::deflate(TOKEN),
        ]
        .concat(),
    );
    carriers.push(("a raw profile", raw.bytes(), Sign::Token, "dddd", "text"));
    carriers.push((
        "pHYs",
        png(false)
            .with(*b"pHYs", b"\0\0\x2E\x23\0\0\x17\x11\x01")
            .bytes(),
        Sign::Resolution,
        "kkkk",
        "",
    ));
    carriers.push((
        "sBIT",
        png(false).with(*b"sBIT", &[5, 6, 5]).bytes(),
        Sign::Token,
        "dddd",
        "significant bits",
    ));
    carriers.push((
        "sBIT of every bit",
        png(false).with(*b"sBIT", &[8, 8, 8]).bytes(),
        Sign::Token,
        "----",
        "",
    ));
    carriers.push((
        "sCAL",
        png(false).with(*b"sCAL", b"\x011\x001").bytes(),
        Sign::Token,
        "dddd",
        "calibration",
    ));
    carriers.push((
        "caBX",
        png(false).with(*b"caBX", TOKEN).bytes(),
        Sign::Token,
        "dddd",
        "C2PA",
    ));
    carriers.push((
        "a private chunk",
        png(false).with(*b"prVt", TOKEN).bytes(),
        Sign::Token,
        "dddd",
        "application data",
    ));
    carriers.push((
        "tIME",
        png(false).with(*b"tIME", &[7, 232, 1, 2, 3, 4, 5]).bytes(),
        Sign::Token,
        "----",
        "",
    ));
    carriers
}

pub(super) fn jpeg_carriers() -> Vec<Carrier> {
    let with = |marker: u8, head: &[u8], data: &[u8]| {
        jpeg(false)
            .with_segment(marker, &[head, data].concat())
            .bytes()
    };
    let icc = |profile: &[u8]| [b"ICC_PROFILE\0\x01\x01".as_slice(), profile].concat();
    let resource = |id: u16| {
        [
            b"8BIM".as_slice(),
            &id.to_be_bytes(),
            &[0; 2],
            &24_u32.to_be_bytes(),
            TOKEN,
        ]
        .concat()
    };
    let photoshop = |id: u16| with(0xED, b"Photoshop 3.0\0", &resource(id));
    vec![
        (
            "JFIF",
            with(0xE0, b"JFIF\0\x01\x02", b"\x01\x01\x2C\0\x96\0\0"),
            Sign::Resolution,
            "kkkk",
            "",
        ),
        (
            "EXIF",
            with(0xE1, b"Exif\0\0", &rich_exif(false)),
            Sign::Token,
            "kkkk",
            "",
        ),
        (
            "XMP",
            with(0xE1, b"http://ns.adobe.com/xap/1.0/\0", &xmp("")),
            Sign::Token,
            "kkkk",
            "",
        ),
        (
            "extended XMP",
            with(0xE1, b"http://ns.adobe.com/xmp/extension/\0", TOKEN),
            Sign::Token,
            "dddd",
            "extended XMP",
        ),
        (
            "ICC",
            with(0xE2, b"", &icc(&profile(400))),
            Sign::Icc(profile(400)),
            "kkkk",
            "",
        ),
        (
            "ICC of grey",
            jpeg(true).with_segment(0xE2, &icc(&grey_profile())).bytes(),
            Sign::Icc(grey_profile()),
            "kkpk",
            "",
        ),
        (
            "ICC of grey on RGB",
            with(0xE2, b"", &icc(&grey_profile())),
            Sign::Token,
            "pppp",
            "",
        ),
        (
            "MPF",
            with(0xE2, b"MPF\0", TOKEN),
            Sign::Token,
            "dddd",
            "further images",
        ),
        ("IPTC", photoshop(0x0404), Sign::Token, "dddd", "IPTC"),
        ("a path", photoshop(2_000), Sign::Token, "dddd", "paths"),
        (
            "settings of Photoshop",
            photoshop(0x03F3),
            Sign::Token,
            "----",
            "",
        ),
        (
            "C2PA",
            with(0xEB, b"JP\0\x01", TOKEN),
            Sign::Token,
            "dddd",
            "C2PA",
        ),
        (
            "another application",
            with(0xE5, b"", TOKEN),
            Sign::Token,
            "dddd",
            "application data",
        ),
        (
            "a comment",
            with(0xFE, b"", TOKEN),
            Sign::Token,
            "kkdd",
            "comment",
        ),
    ]
}

pub(super) fn tiff_carriers() -> Vec<Carrier> {
    let with = |tag: u16, kind: u16, data: &[u8]| {
        let size = if kind == RATIONAL { 8 } else { 1 };
        tiff(false).with_tag(tag, kind, data.len() / size, data)
    };
    let ratio = |n: u32, d: u32| [n.to_le_bytes(), d.to_le_bytes()].concat();
    let resolution = with(282, RATIONAL, &ratio(5, 2))
        .with_tag(283, RATIONAL, 1, &ratio(7, 2))
        .with(296, &[3]);
    let ome = [b"<?xml version='1.0'?><OME>".as_slice(), TOKEN].concat();
    let shape = [b"{\"shape\": [1, 2]}".as_slice(), TOKEN].concat();
    let resource = [b"8BIM\x04\x04\0\0\0\0\0\x18".as_slice(), TOKEN].concat();
    let grey = tiff(true).with_tag(34_675, UNDEFINED, 400, &grey_profile());
    vec![
        (
            "XResolution",
            resolution.bytes(),
            Sign::Resolution,
            "kkkk",
            "",
        ),
        (
            "ICC",
            with(34_675, UNDEFINED, &profile(400)).bytes(),
            Sign::Icc(profile(400)),
            "kkkk",
            "",
        ),
        (
            "ICC of grey",
            grey.bytes(),
            Sign::Icc(grey_profile()),
            "kkpk",
            "",
        ),
        (
            "TransferFunction",
            tiff(false).with(301, &[7; 768]).bytes(),
            Sign::Token,
            "pppp",
            "",
        ),
        (
            "WhitePoint",
            with(318, RATIONAL, &ratio(1, 3).repeat(2)).bytes(),
            Sign::Token,
            "pppp",
            "",
        ),
        (
            "PrimaryChromaticities",
            with(319, RATIONAL, &ratio(1, 3).repeat(6)).bytes(),
            Sign::Token,
            "pppp",
            "",
        ),
        (
            "WhitePoint beside ICC",
            with(318, RATIONAL, &ratio(1, 3).repeat(2))
                .with_tag(34_675, UNDEFINED, 400, &profile(400))
                .bytes(),
            Sign::Icc(profile(400)),
            "kkkk",
            "",
        ),
        (
            "ImageDescription",
            with(270, ASCII, TOKEN).bytes(),
            Sign::Token,
            "kkkk",
            "",
        ),
        (
            "Artist",
            with(315, ASCII, TOKEN).bytes(),
            Sign::Token,
            "kkkk",
            "",
        ),
        (
            "PageName",
            with(285, ASCII, TOKEN).bytes(),
            Sign::Token,
            "kkkk",
            "",
        ),
        (
            "OME-XML",
            with(270, ASCII, &ome).bytes(),
            Sign::Token,
            "dddd",
            "OME-XML",
        ),
        (
            "the shape of an array",
            with(270, ASCII, &shape).bytes(),
            Sign::Token,
            "----",
            "",
        ),
        (
            "XMP",
            with(700, 1, &xmp("")).bytes(),
            Sign::Token,
            "kkkk",
            "",
        ),
        (
            "IPTC",
            with(33_723, UNDEFINED, TOKEN).bytes(),
            Sign::Token,
            "dddd",
            "IPTC",
        ),
        (
            "IPTC of Photoshop",
            with(34_377, UNDEFINED, &resource).bytes(),
            Sign::Token,
            "dddd",
            "IPTC",
        ),
        (
            "layers of Photoshop",
            with(37_724, UNDEFINED, TOKEN).bytes(),
            Sign::Token,
            "dddd",
            "Photoshop layers",
        ),
        (
            "GeoTIFF",
            with(34_737, ASCII, TOKEN).bytes(),
            Sign::Token,
            "dddd",
            "GeoTIFF",
        ),
        (
            "ImageJ",
            with(50_839, UNDEFINED, TOKEN).bytes(),
            Sign::Token,
            "dddd",
            "ImageJ tags",
        ),
        (
            "a private tag",
            with(65_000, UNDEFINED, TOKEN).bytes(),
            Sign::Token,
            "dddd",
            "application data",
        ),
        (
            "a mask",
            Tiff {
                more: vec![4],
                ..tiff(false)
            }
            .bytes(),
            Sign::Token,
            "dddd",
            "transparency mask",
        ),
    ]
}

pub(super) fn other_carriers() -> Vec<Carrier> {
    let with = |flags: u8, after: &[(&[u8; 4], &[u8])]| webp(flags, &[], after);
    let packet = [
        xmp("").as_slice(),
        &[1],
        &(0..=255).rev().collect::<Vec<u8>>(),
        &[0],
    ]
    .concat();
    let mut gif_xmp = few_formats::gif(&[(3, 2)], None);
    gif_xmp.splice(
        25..25,
        [b"\x21\xFF\x0BXMP DataXMP".as_slice(), &packet].concat(),
    );
    let icc = profile(400);
    let (first, second) = icc.split_at(255);
    let sized = {
        let mut file = few_formats::bmp(5, 4, &[9; 60]);
        file[38..46].copy_from_slice(&[0x23, 0x2E, 0, 0, 0x11, 0x17, 0, 0]);
        file
    };
    vec![
        (
            "WebP: ICCP",
            webp(0x20, &[(b"ICCP", &icc)], &[]),
            Sign::Icc(icc.clone()),
            "kkkk",
            "",
        ),
        (
            "WebP: EXIF",
            with(0x08, &[(b"EXIF", &rich_exif(true))]),
            Sign::Token,
            "kkkk",
            "",
        ),
        (
            "WebP: XMP",
            with(0x04, &[(b"XMP ", &xmp(""))]),
            Sign::Token,
            "kkkk",
            "",
        ),
        (
            "WebP: C2PA",
            with(0, &[(b"C2PA", TOKEN)]),
            Sign::Token,
            "dddd",
            "C2PA",
        ),
        (
            "WebP: another chunk",
            with(0, &[(b"ABCD", TOKEN)]),
            Sign::Token,
            "dddd",
            "application data",
        ),
        (
            "GIF: a comment",
            gif(0xFE, &[TOKEN]),
            Sign::Token,
            "kkdd",
            "comment",
        ),
        ("GIF: XMP", gif_xmp, Sign::Token, "kkkk", ""),
        (
            "GIF: ICC",
            gif(0xFF, &[b"ICCRGBG1012", first, second]),
            Sign::Icc(icc.clone()),
            "kkkk",
            "",
        ),
        (
            "GIF: loops",
            gif(0xFF, &[b"NETSCAPE2.0", &[1, 0, 0]]),
            Sign::Token,
            "----",
            "",
        ),
        (
            "GIF: another application",
            gif(0xFF, &[b"ABCDEFGH1.0", TOKEN]),
            Sign::Token,
            "dddd",
            "application data",
        ),
        ("BMP: pixels per metre", sized, Sign::Resolution, "kkkk", ""),
        (
            "BMP: a profile",
            bmp(124, *b"MBED", 0, &icc),
            Sign::Icc(icc.clone()),
            "kkkk",
            "",
        ),
        (
            "BMP: a profile elsewhere",
            bmp(124, *b"LINK", 0, TOKEN),
            Sign::Token,
            "pppp",
            "",
        ),
        (
            "BMP: calibrated",
            bmp(108, [0; 4], 1 << 16, &[]),
            Sign::Token,
            "pppp",
            "",
        ),
        (
            "BMP: not calibrated",
            bmp(108, [0; 4], 0, &[]),
            Sign::Token,
            "----",
            "",
        ),
        (
            "BMP: sRGB",
            bmp(108, *b"sRGB", 1 << 16, &[]),
            Sign::Token,
            "----",
            "",
        ),
    ]
}
