//! `POST /blend` against an independent sum of warped images, and what it takes: memory does not
//! grow with the number of images, and work is refused before it is done.

use image::{DynamicImage, Rgba};
use serde_json::{Value, json};

use crate::support::bombs;
use crate::support::counters::Counted as _;
use crate::support::picture::{bmp, png_of};
use crate::support::program::Program;
use crate::support::server::{blend_form, form, problem};
use crate::support::{Server, photo};

const SHAPES: [[[f64; 2]; 4]; 3] = [
    [[10.0, 10.0], [50.0, 12.0], [15.0, 38.0], [45.0, 40.0]],
    [[14.0, 8.0], [47.0, 15.0], [18.0, 33.0], [50.0, 37.0]],
    [[8.0, 14.0], [55.0, 10.0], [12.0, 40.0], [40.0, 44.0]],
];

/// Waves with noise; with alpha, a soft disc around which nothing is.
fn picture(seed: u32, depth: png::BitDepth, has_alpha: bool) -> Vec<u8> {
    let (width, height) = (64 + 8 * seed, 48);
    let mut samples = Vec::new();
    for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
        let noise = |c: u32| f64::from((x * 31 + y * 17 + c * 101 + seed * 57) % 29) / 40.0;
        let mut pixel: Vec<f64> = (0..3)
            .map(|c| 0.5 + 0.4 * f64::from(x * (c + 1) + seed * 9).sin() * noise(c))
            .collect();
        let away = f64::from(x.abs_diff(width / 2)).hypot(f64::from(y.abs_diff(height / 2)));
        pixel.extend(has_alpha.then_some(((26.0 - away) / 8.0).clamp(0.0, 1.0)));
        for value in pixel {
            match depth {
                png::BitDepth::Sixteen => {
                    samples.extend(((value * 65_535.0).round() as u16).to_be_bytes());
                }
                _ => samples.push((value * 255.0).round() as u8),
            }
        }
    }
    let color = if has_alpha {
        png::ColorType::Rgba
    } else {
        png::ColorType::Rgb
    };
    png_of(width, height, color, depth, &samples)
}

/// Pixels as shares of the largest value, and that value.
fn shares(file: &[u8]) -> (Vec<[f64; 4]>, f64) {
    let image = image::load_from_memory(file).unwrap();
    let is_deep = matches!(
        image,
        DynamicImage::ImageRgb16(_) | DynamicImage::ImageRgba16(_)
    );
    let largest = if is_deep { 65_535.0 } else { 255.0 };
    let pixels = image.to_rgba16();
    let share = |Rgba(pixel): &Rgba<u16>| pixel.map(|value| f64::from(value) / 65_535.0);
    (pixels.pixels().map(share).collect(), largest)
}

fn to_light(value: f64) -> f64 {
    if value <= 0.04045 {
        value / 12.92
    } else {
        ((value + 0.055) / 1.055).powf(2.4)
    }
}

fn of_light(value: f64) -> f64 {
    if value <= 0.003_130_8 {
        value * 12.92
    } else {
        1.055 * value.powf(1.0 / 2.4) - 0.055
    }
}

/// The sum of warped images in double precision, by the two rules of the contract.
fn sum(warped: &[Vec<[f64; 4]>], weights: &[f64], is_linear: bool) -> Vec<[f64; 4]> {
    let decode = |value| if is_linear { to_light(value) } else { value };
    let encode = |value| if is_linear { of_light(value) } else { value };
    let is_difference = weights.iter().any(|weight| *weight < 0.0);
    let pixel = |k: usize| {
        let (mut colour, mut alpha) = ([0.0; 3], f64::from(u8::from(is_difference)));
        for (image, weight) in warped.iter().zip(weights) {
            let [r, g, b, own] = image[k];
            let share = if is_difference { *weight } else { weight * own };
            for (sum, value) in colour.iter_mut().zip([r, g, b]) {
                *sum += share * decode(value);
            }
            alpha = if is_difference {
                alpha.min(own)
            } else {
                alpha + share
            };
        }
        let whole = if is_difference || alpha == 0.0 {
            1.0
        } else {
            alpha
        };
        let [r, g, b] = colour.map(|value| encode((value / whole).max(0.0)).clamp(0.0, 1.0));
        [r, g, b, alpha.min(1.0)]
    };
    (0..warped[0].len()).map(pixel).collect()
}

#[tokio::test]
async fn a_blend_is_the_weighted_sum_of_what_warp_draws() {
    let server = Server::start(&[]).await;
    let deep = png::BitDepth::Sixteen;
    let shallow = png::BitDepth::Eight;
    for (depth, has_alpha, space, colour) in [
        (shallow, false, "srgb", [0.2, 0.3, 0.5]),
        (shallow, true, "linear", [0.2, 0.3, 0.5]),
        (shallow, true, "srgb", [1.5, -0.25, -0.25]),
        (deep, false, "linear", [0.5, 0.5, 0.0]),
        (deep, true, "srgb", [0.2, 0.3, 0.5]),
        (deep, true, "linear", [1.4, -0.6, 0.2]),
    ] {
        let shape = [0.5, 0.3, 0.2];
        let t: Vec<[f64; 2]> = (0..4)
            .map(|k| [0, 1].map(|axis| (0..3).map(|n| shape[n] * SHAPES[n][k][axis]).sum()))
            .collect();
        let files: Vec<Vec<u8>> = (0..3).map(|k| picture(k, depth, has_alpha)).collect();
        let mut warped = Vec::new();
        for (k, file) in files.iter().enumerate().filter(|(k, _)| colour[*k] != 0.0) {
            let canvas = json!({"x": 0, "y": 0, "width": 64, "height": 48});
            let warp = json!({"p": SHAPES[k], "q": t,
                "output": {"canvas": canvas, "compression": "none"}});
            let request = server.post("/warp").multipart(form(file, warp.to_string()));
            let response = request.send().await.unwrap();
            assert_eq!(response.status(), 200);
            warped.push(shares(&response.bytes().await.unwrap()).0);
        }
        let entry = |k: usize| {
            json!({"image": k, "p": SHAPES[k], "shape": shape[k],
            "colour": colour[k]})
        };
        let blend = json!({"images": [entry(0), entry(1), entry(2)], "align": "none",
            "space": space, "output": {"compression": "none"}});
        let parts: Vec<&[u8]> = files.iter().map(|file| &**file).collect();
        let request = server.post("/blend").multipart(blend_form(&parts, &blend));
        let response = request.send().await.unwrap();
        assert_eq!(response.status(), 200);
        let (found, largest) = shares(&response.bytes().await.unwrap());
        let weights: Vec<f64> = colour.into_iter().filter(|weight| *weight != 0.0).collect();
        let expected = sum(&warped, &weights, space == "linear");
        let mut worst = 0.0_f64;
        for (a, b) in found.iter().zip(&expected) {
            // Nobody sees a colour without alpha.
            let seen = if (b[3] * largest).round() > 0.0 { 0 } else { 3 };
            for c in seen..4 {
                worst = worst.max((a[c] - b[c]).abs() * largest);
            }
        }
        assert!(
            worst <= 1.0 && worst > 0.0,
            "{worst}: {depth:?} {has_alpha} {space}"
        );
    }
}

/// Points on a circle, which no two images have alike.
fn points(k: u32) -> Value {
    let point = |n: u32| {
        let angle = f64::from(n) + f64::from(k) / 50.0;
        [200.0 + 90.0 * angle.cos(), 150.0 + 90.0 * angle.sin()]
    };
    json!([point(0), point(1), point(2), point(3), point(4), point(5)])
}

async fn blended(program: &Program, images: u32) -> usize {
    let files: Vec<Vec<u8>> = (0..images).map(|k| bmp(400, 300, k)).collect();
    let entries: Vec<Value> = (0..images)
        .map(|k| json!({"image": k, "p": points(k)}))
        .collect();
    let parts: Vec<&[u8]> = files.iter().map(|file| &**file).collect();
    let response = reqwest::Client::new()
        .post(format!("http://{}/blend", program.address))
        .multipart(blend_form(&parts, &json!({"images": entries})))
        .send()
        .await
        .unwrap();
    assert_eq!(response.status(), 200, "{:?}", response.text().await);
    files.iter().map(Vec::len).sum()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn many_images_take_the_memory_of_a_few() {
    // Sixty decoded images would not fit.
    let program = Program::start(&["--memory-bytes", "64MiB", "--workers", "2"]);
    blended(&program, 4).await;
    let mut peaks = Vec::new();
    for images in [4, 60] {
        program.forget_peak();
        let files = blended(&program, images).await;
        let peak = program.peak();
        eprintln!(
            "{images} images: peak {peak} MiB, of which {} MiB are their files",
            files >> 20
        );
        peaks.push(peak.saturating_sub(files as u64 >> 20));
    }
    assert!(peaks[1] < peaks[0] + 48, "{peaks:?}");
}

#[tokio::test]
async fn coefficients_of_sessions_and_of_frames_are_computed_once() {
    let server = Server::start(&[]).await;
    let file = picture(0, png::BitDepth::Eight, false);
    let mut ids = Vec::new();
    for p in &SHAPES[..2] {
        let id = server.session(&file, &json!({"p": p})).await;
        let drawn = server.post(&format!("/sessions/{id}/warp"));
        let drawn = drawn.json(&json!({"q": SHAPES[2]})).send().await.unwrap();
        assert_eq!(drawn.status(), 200);
        ids.push(id);
    }
    let blend = |body: &Value| {
        let request = server.post("/blend").json(body);
        async {
            let response = request.send().await.unwrap();
            assert_eq!(response.status(), 200);
            response.bytes().await.unwrap();
        }
    };
    // What is drawn of a sum has a plan without handles.
    let before = server.app.counters().plans_built;
    blend(&json!({"images": [{"session": ids[0]}, {"session": ids[1]}]})).await;
    assert_eq!(server.app.counters().plans_built, before + 1);
    // Another method has other coefficients.
    let images = json!([{"session": ids[0]}, {"session": ids[1]}]);
    for _ in 0..2 {
        blend(&json!({"images": images, "method": "affine"})).await;
        assert_eq!(server.app.counters().plans_built, before + 3);
    }
    let entries = [0, 1].map(|k| json!({"image": k, "p": SHAPES[k]}));
    let morph = json!({"images": entries, "steps": 5, "method": "similarity"});
    let request = server.post("/blend").header("accept", "application/zip");
    let upload = blend_form(&[&file, &file], &morph);
    let response = request.multipart(upload).send().await.unwrap();
    assert_eq!(response.status(), 200);
    response.bytes().await.unwrap();
    assert_eq!(server.app.counters().plans_built, before + 5);
}

#[tokio::test]
async fn a_sum_that_does_not_fit_is_refused() {
    let server = Server::start(&["--memory-bytes", "16MiB"]).await;
    let image = json!({"image": 0, "p": [[10, 10], [50, 12], [30, 20]]});
    let blend = json!({"images": [image, image], "output": {"width": 1200}});
    let form = blend_form(&[&photo(64, 48)], &blend);
    let response = server.post("/blend").multipart(form).send().await.unwrap();
    problem(response, 413, "too_large").await;
}

#[tokio::test]
async fn two_hundred_of_the_largest_images_are_refused_by_their_heads() {
    let server = Server::start(&[]).await;
    let file = bombs::png(&[
        (b"IHDR", bombs::ihdr(7000, 7000)),
        (b"IDAT", bombs::deflated_zeros(1 << 20)),
        (b"IEND", Vec::new()),
    ]);
    let entries: Vec<Value> = (0..200)
        .map(|k| json!({"image": k, "p": [[10, 10], [50, 12], [30, 20]]}))
        .collect();
    let parts = vec![&*file; 200];
    for output in [json!({}), json!({"width": 10})] {
        let blend = json!({"images": entries, "output": output});
        let request = server.post("/blend").multipart(blend_form(&parts, &blend));
        let told = problem(request.send().await.unwrap(), 413, "too_large").await;
        assert_eq!(told["pointer"], "/images", "{told}");
    }
    server.is_well().await;
}
