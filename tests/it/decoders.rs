//! Every kind of picture that the service answers with is read by two decoders that share no code,
//! and says the same however it was compressed: all compressions, depths and channels, whole
//! answers and ones in strips, sizes on either side of where strips begin.

use std::cell::Cell;

use mlswarp::codec::{self, CodecError, ImageLimits, StepCounter};
use serde_json::json;

use crate::support::Server;
use crate::support::picture::{decoded, png_of};
use crate::support::server::png;

/// From one strip to many: pictures are divided above 96 KiB of rows, and a strip has half a
/// mebibyte at most.
const SIZES: [(u32, u32); 6] = [
    (1, 1),
    (64, 48),
    (127, 190),
    (127, 196),
    (331, 410),
    (700, 520),
];

/// Samples with a wave, noise, and holes in the alpha channel.
fn samples(width: u32, height: u32, channels: u32, wide: bool) -> Vec<u8> {
    let mut samples = Vec::new();
    for k in 0..width * height * channels {
        let (x, y, channel) = (k / channels % width, k / channels / width, k % channels);
        let wave = (f64::from(x) * 0.05 + f64::from(channel)).sin() * (f64::from(y) * 0.08).cos();
        #[expect(clippy::cast_sign_loss, reason = "the wave is above zero here")]
        let value =
            (32_000.0 + 24_000.0 * wave) as u16 + (k.wrapping_mul(2_654_435_761) >> 23) as u16;
        let value = if channel == 3 {
            if (x / 9 + y / 7) % 3 == 0 { 0 } else { 0xffff }
        } else {
            value
        };
        if wide {
            samples.extend_from_slice(&value.to_be_bytes())
        } else {
            samples.push(value.to_be_bytes()[0])
        }
    }
    samples
}

#[tokio::test]
async fn decoders_agree_on_every_kind_of_answer() {
    let server = Server::start(&[]).await;
    for (width, height) in SIZES {
        for (color, channels) in [(png::ColorType::Rgb, 3), (png::ColorType::Rgba, 4)] {
            for depth in [png::BitDepth::Eight, png::BitDepth::Sixteen] {
                let wide = depth == png::BitDepth::Sixteen;
                let file = png_of(
                    width,
                    height,
                    color,
                    depth,
                    &samples(width, height, channels, wide),
                );
                let (w, h) = (f64::from(width), f64::from(height));
                let id = server
                    .session(
                        &file,
                        &json!({"p": [[0.1 * w, 0.2 * h], [0.9 * w, 0.3 * h], [0.4 * w, 0.9 * h]]}),
                    )
                    .await;
                let q = json!([[0.15 * w, 0.2 * h], [0.9 * w, 0.25 * h], [0.4 * w, 0.8 * h]]);
                for outside in ["transparent", "edge"] {
                    let mut pictures = Vec::new();
                    for compression in ["none", "fast", "best"] {
                        let output = json!({"compression": compression, "outside": outside});
                        let answer = server.drag(&id, &json!({"q": q, "output": output})).await;
                        pictures.push(decoded(&png(answer).await));
                    }
                    let what = format!("{width} x {height} {color:?} {depth:?} {outside}");
                    assert_eq!(
                        (pictures[0].width, pictures[0].height, pictures[0].depth),
                        (width as usize, height as usize, depth),
                        "{what}"
                    );
                    assert!(
                        pictures[1] == pictures[0] && pictures[2] == pictures[0],
                        "{what}"
                    );
                    if color == png::ColorType::Rgba || outside == "edge" {
                        assert_eq!(pictures[0].color, color, "{what}");
                    }
                }
            }
        }
    }
}

/// Label images whose samples are copied, and a picture of many pixels with a frame of one: both
/// ask as often as their pixels take time whether they are wanted, and end when they are not.
#[test]
fn decoding_asks_for_each_part_of_its_pixels_whether_it_is_wanted() {
    /// A part of labels, pixels, and of samples that no frame covers.
    const LABELS: usize = 1 << 17;
    const SAMPLES: usize = 1 << 23;
    const SIDES: [usize; 2] = [1200, 4000];
    let (of_png, samples) = (SIDES[0] as u32, vec![7; 8 * SIDES[0].pow(2)]);
    let wide = (png::ColorType::Rgba, png::BitDepth::Sixteen);
    let labels = png_of(of_png, of_png, wide.0, wide.1, &samples);
    let side = (SIDES[1] as u16).to_le_bytes();
    let screen = [
        &b"GIF89a"[..],
        &side,
        &side,
        &[0x80, 0, 0],
        &[0, 0, 0, 255, 255, 255],
    ];
    let frame: [&[u8]; 2] = [
        &[0x2C, 0, 0, 0, 0, 1, 0, 1, 0, 0],
        &[2, 2, 0x44, 1, 0, 0x3B],
    ];
    let gif = [&screen[..], &frame].concat().concat();
    let limits = ImageLimits::default();
    let questions = |read: &dyn Fn(&StepCounter<'_>) -> Result<(), CodecError>, most: usize| {
        let asked = Cell::new(0);
        let count = || asked.replace(asked.get() + 1) >= most;
        let read = read(&StepCounter::new(&count));
        (asked.get(), read)
    };
    let of_labels = |work: &StepCounter<'_>| {
        let opened = codec::open_labels(&labels, &limits, work)?;
        opened.decode_labels().map(drop)
    };
    let of_samples =
        |work: &StepCounter<'_>| codec::open(&labels, &limits, work)?.decode().map(drop);
    let of_gif = |work: &StepCounter<'_>| codec::open(&gif, &limits, work)?.decode().map(drop);
    let (copied, read) = questions(&of_labels, usize::MAX);
    let (decoded, _) = questions(&of_samples, usize::MAX);
    assert!(
        read.is_ok() && copied >= decoded + SIDES[0].pow(2) / LABELS,
        "{copied}, {decoded}"
    );
    let (asked, read) = questions(&of_gif, usize::MAX);
    assert!(
        read.is_ok() && asked >= 4 * SIDES[1].pow(2) / SAMPLES,
        "{asked} {read:?}"
    );
    for ended in [
        questions(&of_labels, copied - 1),
        questions(&of_gif, asked - 1),
    ] {
        assert!(
            matches!(ended, (_, Err(CodecError::Cancelled))),
            "{ended:?}"
        );
    }
}
