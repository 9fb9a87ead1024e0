//! Every kind of picture that the service answers with is read by two decoders that share no code,
//! and says the same however it was compressed: all compressions, depths and channels, whole
//! answers and ones in strips, sizes on either side of where strips begin.

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
