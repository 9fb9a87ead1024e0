//! JPEG, WebP and TIFF: asked for by the request or by `Accept`, and the same picture as the PNG.

use image::{
    ColorType, DynamicImage, ImageBuffer, ImageFormat, Luma, LumaA, load_from_memory_with_format,
};
use reqwest::Response;
use serde_json::{Value, json};

use crate::support::server::{form, header, problem};
use crate::support::{Server, photo};

const P: [[f64; 2]; 3] = [[20.0, 15.0], [60.0, 20.0], [40.0, 45.0]];
const Q: [[f64; 2]; 3] = [[24.0, 12.0], [57.0, 22.0], [40.0, 52.0]];

async fn picture(response: Response, format: ImageFormat) -> DynamicImage {
    assert_eq!(response.status(), 200);
    assert_eq!(
        (header(&response, "content-type"), header(&response, "vary")),
        (format.to_mime_type(), "accept")
    );
    load_from_memory_with_format(&response.bytes().await.unwrap(), format).unwrap()
}

async fn warped(server: &Server, output: Value, accept: &'static str) -> Response {
    let warp = json!({"p": P, "q": Q, "output": output}).to_string();
    server
        .post("/warp")
        .header("accept", accept)
        .multipart(form(&photo(90, 60), warp))
        .send()
        .await
        .unwrap()
}

#[tokio::test]
async fn every_format_shows_the_same_picture() {
    let server = Server::start(&[]).await;
    let png = picture(warped(&server, json!({}), "*/*").await, ImageFormat::Png)
        .await
        .into_rgba8();
    let webp = picture(
        warped(&server, json!({"format": "webp"}), "*/*").await,
        ImageFormat::WebP,
    )
    .await
    .into_rgba8();
    assert!(webp == png, "WebP is lossless");
    for compression in ["none", "fast", "best"] {
        let tiff = json!({"format": "tiff", "compression": compression});
        assert!(
            picture(warped(&server, tiff, "*/*").await, ImageFormat::Tiff)
                .await
                .into_rgba8()
                == png,
            "TIFF is lossless"
        );
    }

    // What is transparent stands on white, or on the colour outside.
    for (outside, ground) in [
        (json!("transparent"), [255; 3]),
        (json!("#204060"), [32, 64, 96]),
    ] {
        let output = |format: &str| json!({"format": format, "quality": 100, "outside": outside});
        let flat = picture(
            warped(&server, output("png"), "*/*").await,
            ImageFormat::Png,
        )
        .await
        .into_rgba8();
        let jpeg = picture(
            warped(&server, output("jpeg"), "*/*").await,
            ImageFormat::Jpeg,
        )
        .await;
        assert_eq!(jpeg.color(), ColorType::Rgb8);
        let mut far = 0_u64;
        for (want, got) in flat.pixels().zip(jpeg.into_rgb8().pixels()) {
            let alpha = f64::from(want[3]) / 255.0;
            for c in 0..3 {
                let want = f64::from(want[c]) * alpha + f64::from(ground[c]) * (1.0 - alpha);
                far += u64::from((want - f64::from(got[c])).abs() > 12.0);
            }
        }
        assert!(far < 90 * 60 / 100, "{far} samples are far off");
    }
}

#[tokio::test]
async fn the_request_names_a_format_or_accept_does() {
    let server = Server::start(&[]).await;
    for (output, accept, format) in [
        (json!({}), "image/webp", ImageFormat::WebP),
        (json!({}), "image/tiff", ImageFormat::Tiff),
        (json!({}), "image/jpeg, image/png;q=0.5", ImageFormat::Jpeg),
        (
            json!({}),
            "image/avif,image/webp,image/apng,image/*,*/*;q=0.8",
            ImageFormat::Png,
        ),
        (
            json!({"format": "jpeg"}),
            "image/png, */*;q=0.1",
            ImageFormat::Jpeg,
        ),
    ] {
        picture(warped(&server, output, accept).await, format).await;
    }
    problem(
        warped(&server, json!({"format": "jpeg"}), "image/png").await,
        406,
        "not_acceptable",
    )
    .await;
    problem(
        warped(&server, json!({"format": "gif"}), "*/*").await,
        422,
        "bad_value",
    )
    .await;
    problem(
        warped(&server, json!({"quality": 0}), "*/*").await,
        422,
        "bad_value",
    )
    .await;
}

#[tokio::test]
async fn a_session_has_a_format_and_a_drag_another() {
    let server = Server::start(&[]).await;
    let id = server
        .session(
            &photo(90, 60),
            &json!({"p": P, "output": {"format": "jpeg", "quality": 70}}),
        )
        .await;
    let drag = |body: Value| {
        server
            .post(&format!("/sessions/{id}/warp"))
            .header("accept", "image/*")
            .json(&body)
            .send()
    };
    let session: Value = server
        .get(&format!("/sessions/{id}"))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    assert_eq!(
        (&session["output"]["format"], &session["output"]["quality"]),
        (&json!("jpeg"), &json!(70))
    );
    let jpeg = drag(json!({"q": Q})).await.unwrap();
    let tag = header(&jpeg, "etag").to_owned();
    let small = jpeg.content_length();
    picture(jpeg, ImageFormat::Jpeg).await;
    picture(
        drag(json!({"q": Q, "output": {"format": "webp", "width": 45}}))
            .await
            .unwrap(),
        ImageFormat::WebP,
    )
    .await;
    let fine = drag(json!({"q": Q, "output": {"quality": 98}}))
        .await
        .unwrap();
    assert_ne!(header(&fine, "etag"), tag);
    assert!(
        fine.content_length() > small,
        "a higher quality takes more bytes"
    );
}

#[tokio::test]
async fn a_picture_too_long_for_its_format_is_refused_before_it_is_drawn() {
    let server = Server::start(&["--max-image-side", "70000"]).await;
    let strip = photo(16_385, 2);
    let ask = |format: &str| {
        let warp = json!({"p": [[1, 1]], "q": [[2, 1]], "output": {"format": format}}).to_string();
        server.post("/warp").multipart(form(&strip, warp)).send()
    };
    let refused = problem(ask("webp").await.unwrap(), 413, "too_large").await;
    assert_eq!(
        (&refused["limit"], &refused["actual"]),
        (&json!(16_384), &json!(16_385))
    );
    picture(ask("jpeg").await.unwrap(), ImageFormat::Jpeg).await;
}

fn file(image: impl Into<DynamicImage>, format: ImageFormat) -> Vec<u8> {
    let mut file = std::io::Cursor::new(Vec::new());
    image.into().write_to(&mut file, format).unwrap();
    file.into_inner()
}

async fn output_of(
    server: &Server,
    source: &[u8],
    q: Value,
    output: Value,
    format: ImageFormat,
) -> DynamicImage {
    let warp = json!({"p": P, "q": q, "output": output}).to_string();
    let response = server
        .post("/warp")
        .header("accept", format.to_mime_type())
        .multipart(form(source, warp))
        .send()
        .await
        .unwrap();
    picture(response, format).await
}

/// A grey picture is grey in every format that has grey, as long as nothing adds a colour; the
/// renderer draws the same values.
#[tokio::test]
async fn grey_pictures_stay_grey() {
    let server = Server::start(&[]).await;
    let ramp = ImageBuffer::from_fn(90, 60, |x, y| Luma([(x * 700 + y * 30) as u16]));
    let deep = DynamicImage::from(ramp.clone());
    let flat = DynamicImage::from(deep.to_luma8());
    let clear = DynamicImage::from(ImageBuffer::from_fn(90, 60, |x, y| {
        LumaA([(x * 2) as u8, (y * 4) as u8])
    }));
    for (source, with_alpha) in [
        (file(deep.clone(), ImageFormat::Png), false),
        (file(deep.clone(), ImageFormat::Tiff), false),
        (file(flat.clone(), ImageFormat::Png), false),
        (file(flat.clone(), ImageFormat::Jpeg), false),
        (file(flat, ImageFormat::Tiff), false),
        (file(clear, ImageFormat::Png), true),
    ] {
        let is_deep = load_from_memory_with_format(&source, image::guess_format(&source).unwrap())
            .unwrap()
            .color()
            .bytes_per_pixel()
            == 2;
        let is_deep = is_deep && !with_alpha;
        let ask = |outside: &str, format| {
            output_of(
                &server,
                &source,
                json!(Q),
                json!({"outside": outside}),
                format,
            )
        };
        let (opaque, alpha, colour) = if is_deep {
            (ColorType::L16, ColorType::La16, ColorType::Rgb16)
        } else {
            (ColorType::L8, ColorType::La8, ColorType::Rgb8)
        };
        let usual = ask("transparent", ImageFormat::Png).await;
        assert_eq!(usual.color(), alpha, "the corners are uncovered");
        let edge = ask("edge", ImageFormat::Png).await;
        assert_eq!(edge.color(), if with_alpha { alpha } else { opaque });
        assert_eq!(
            ask("#333333", ImageFormat::Png).await.color(),
            if with_alpha { alpha } else { opaque }
        );
        let red = ask("#ff0000", ImageFormat::Png).await;
        assert!(red.color().has_color());
        if !with_alpha {
            assert_eq!(red.color(), colour);
            assert!(
                ask("edge", ImageFormat::Tiff).await == edge,
                "TIFF and PNG have the same samples"
            );
        }
        assert_eq!(
            ask("transparent", ImageFormat::Jpeg).await.color(),
            ColorType::L8
        );
        assert_eq!(
            ask("#ff0000", ImageFormat::Jpeg).await.color(),
            ColorType::Rgb8
        );
        assert!(
            ask("transparent", ImageFormat::WebP)
                .await
                .color()
                .has_color()
        );
        let same = output_of(&server, &source, json!(P), json!({}), ImageFormat::Png).await;
        assert!(
            same == image::load_from_memory(&source).unwrap(),
            "the identity changes nothing and adds no alpha"
        );
    }

    // A deep ramp through a warp that only stretches: 16 bit, monotone, and finer than 8 bit.
    let source = file(ramp, ImageFormat::Tiff);
    let stretched = json!([[20.0, 15.0], [70.0, 20.0], [42.0, 45.0]]);
    for format in [ImageFormat::Png, ImageFormat::Tiff] {
        let DynamicImage::ImageLuma16(got) = output_of(
            &server,
            &source,
            stretched.clone(),
            json!({"outside": "edge"}),
            format,
        )
        .await
        else {
            panic!("grey of 16 bit expected")
        };
        let row: Vec<u16> = (0..90).map(|x| got.get_pixel(x, 30)[0]).collect();
        assert!(row.is_sorted(), "{row:?}");
        assert!(
            row.iter().filter(|value| *value % 257 != 0).count() > 60,
            "{row:?}"
        );
    }
}

/// Black and white next to what is transparent stay black and white: no halo.
#[tokio::test]
async fn grey_with_alpha_has_no_halo() {
    let server = Server::start(&[]).await;
    for colour in [0, 255] {
        let disc = ImageBuffer::from_fn(90, 60, |x, y| {
            let inside = (f64::from(x) - 45.0).hypot(f64::from(y) - 30.0) < 20.0;
            if inside {
                LumaA([colour, 255_u8])
            } else {
                LumaA([255 - colour, 0])
            }
        });
        let source = file(disc, ImageFormat::Png);
        let got = output_of(&server, &source, json!(Q), json!({}), ImageFormat::Png).await;
        let DynamicImage::ImageLumaA8(got) = got else {
            panic!("grey with alpha expected")
        };
        let seen = || got.pixels().filter(|pixel| pixel[1] > 0);
        assert!(seen().count() > 1_000 && seen().all(|pixel| pixel[0] == colour));
        assert!(seen().any(|pixel| pixel[1] < 255), "the edge is soft");
    }
}

#[tokio::test]
async fn gif_bmp_and_tiff_are_sources() {
    let server = Server::start(&[]).await;
    let colours = DynamicImage::from(image::RgbImage::from_fn(90, 60, |x, y| {
        image::Rgb([(x / 30) as u8 * 90, (y / 30) as u8 * 200, 40])
    }));
    for format in [ImageFormat::Gif, ImageFormat::Bmp, ImageFormat::Tiff] {
        let source = file(DynamicImage::from(colours.to_rgba8()), format);
        let same = output_of(&server, &source, json!(P), json!({}), ImageFormat::Png).await;
        assert!(same.into_rgb8() == colours.to_rgb8(), "{format:?}");
    }
    let strict = Server::start(&["--max-image-side", "80"]).await;
    for format in [ImageFormat::Gif, ImageFormat::Bmp, ImageFormat::Tiff] {
        let warp = json!({"p": P, "q": Q}).to_string();
        let sent = strict
            .post("/warp")
            .multipart(form(&file(colours.clone(), format), warp))
            .send()
            .await
            .unwrap();
        let refused = problem(sent, 413, "too_large").await;
        assert_eq!(
            (&refused["limit"], &refused["actual"]),
            (&json!(80), &json!(90))
        );
    }
}
