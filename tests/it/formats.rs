//! JPEG and WebP: asked for by the request or by `Accept`, and the same picture as the PNG.

use image::{DynamicImage, ImageFormat, load_from_memory_with_format};
use reqwest::Response;
use serde_json::{Value, json};

use crate::support::server::{form, header, problem};
use crate::support::{Server, photo};

const P: [[f64; 2]; 3] = [[20.0, 15.0], [60.0, 20.0], [40.0, 45.0]];
const Q: [[f64; 2]; 3] = [[24.0, 12.0], [57.0, 22.0], [40.0, 52.0]];

async fn picture(response: Response, format: ImageFormat) -> DynamicImage {
    assert_eq!(response.status(), 200);
    assert_eq!((header(&response, "content-type"), header(&response, "vary")), (format.to_mime_type(), "accept"));
    load_from_memory_with_format(&response.bytes().await.unwrap(), format).unwrap()
}

async fn warped(server: &Server, output: Value, accept: &'static str) -> Response {
    let warp = json!({"p": P, "q": Q, "output": output}).to_string();
    server.post("/warp").header("accept", accept).multipart(form(&photo(90, 60), warp)).send().await.unwrap()
}

#[tokio::test]
async fn every_format_shows_the_same_picture() {
    let server = Server::start(&[]).await;
    let png = picture(warped(&server, json!({}), "*/*").await, ImageFormat::Png).await.into_rgba8();
    let webp = picture(warped(&server, json!({"format": "webp"}), "*/*").await, ImageFormat::WebP).await.into_rgba8();
    assert!(webp == png, "WebP is lossless");

    // What is transparent stands on white, or on the colour outside.
    for (outside, ground) in [(json!("transparent"), [255; 3]), (json!("#204060"), [32, 64, 96])] {
        let output = |format: &str| json!({"format": format, "quality": 100, "outside": outside});
        let flat = picture(warped(&server, output("png"), "*/*").await, ImageFormat::Png).await.into_rgba8();
        let jpeg = picture(warped(&server, output("jpeg"), "*/*").await, ImageFormat::Jpeg).await;
        assert_eq!(jpeg.color(), image::ColorType::Rgb8);
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
        (json!({}), "image/jpeg, image/png;q=0.5", ImageFormat::Jpeg),
        (json!({}), "image/avif,image/webp,image/apng,image/*,*/*;q=0.8", ImageFormat::Png),
        (json!({"format": "jpeg"}), "image/png, */*;q=0.1", ImageFormat::Jpeg),
    ] {
        picture(warped(&server, output, accept).await, format).await;
    }
    problem(warped(&server, json!({"format": "jpeg"}), "image/png").await, 406, "not_acceptable").await;
    problem(warped(&server, json!({"format": "gif"}), "*/*").await, 422, "bad_value").await;
    problem(warped(&server, json!({"quality": 0}), "*/*").await, 422, "bad_value").await;
}

#[tokio::test]
async fn a_session_has_a_format_and_a_drag_another() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(90, 60), &json!({"p": P, "output": {"format": "jpeg", "quality": 70}})).await;
    let drag = |body: Value| server.post(&format!("/sessions/{id}/warp")).header("accept", "image/*").json(&body).send();
    let session: Value = server.get(&format!("/sessions/{id}")).send().await.unwrap().json().await.unwrap();
    assert_eq!((&session["output"]["format"], &session["output"]["quality"]), (&json!("jpeg"), &json!(70)));
    let jpeg = drag(json!({"q": Q})).await.unwrap();
    let tag = header(&jpeg, "etag").to_owned();
    let small = jpeg.content_length();
    picture(jpeg, ImageFormat::Jpeg).await;
    picture(drag(json!({"q": Q, "output": {"format": "webp", "width": 45}})).await.unwrap(), ImageFormat::WebP).await;
    let fine = drag(json!({"q": Q, "output": {"quality": 98}})).await.unwrap();
    assert_ne!(header(&fine, "etag"), tag);
    assert!(fine.content_length() > small, "a higher quality takes more bytes");
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
    assert_eq!((&refused["limit"], &refused["actual"]), (&json!(16_384), &json!(16_385)));
    picture(ask("jpeg").await.unwrap(), ImageFormat::Jpeg).await;
}
