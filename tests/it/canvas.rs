//! `output.canvas`: the part of the posed plane that a result shows.

use image::RgbaImage;
use serde_json::{Value, json};

use crate::support::server::{header, png, problem};
use crate::support::{DragClient, Server, photo};

fn decoded(file: &[u8]) -> RgbaImage {
    image::load_from_memory(file).unwrap().to_rgba8()
}

fn turned() -> Value {
    json!({"p": [[20, 20], [300, 200], [350, 40]], "q": [[-15, 60], [280, 280], [390, 90]],
        "method": "affine", "alpha": 1.5})
}

/// A result with its `Warp-Canvas`.
async fn drawn(server: &Server, id: &str, output: Value) -> (RgbaImage, Option<String>) {
    let answer = server
        .drag(id, &json!({"q": turned()["q"], "output": output}))
        .await;
    let canvas = answer
        .headers()
        .get("warp-canvas")
        .map(|text| text.to_str().unwrap().to_owned());
    (decoded(&png(answer).await), canvas)
}

#[tokio::test]
async fn tiles_of_a_canvas_make_up_the_whole() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(400, 300), &turned()).await;
    for outside in ["transparent", "edge"] {
        let tile = |x: u32, y: u32, width: u32, height: u32| {
            let canvas = json!({"x": x.cast_signed() - 60, "y": y.cast_signed() - 50,
                "width": width, "height": height});
            json!({"outside": outside, "canvas": canvas})
        };
        let (whole, canvas) = drawn(&server, &id, tile(0, 0, 520, 440)).await;
        assert_eq!(
            (whole.dimensions(), canvas.as_deref()),
            ((520, 440), Some("-60,-50,520,440"))
        );
        for y in [0, 110, 220, 330] {
            for x in [0, 130, 260, 390] {
                let (part, _) = drawn(&server, &id, tile(x, y, 130, 110)).await;
                assert!(
                    part == image::imageops::crop_imm(&whole, x, y, 130, 110).to_image(),
                    "{outside}: {x}, {y}"
                );
            }
        }
        let (same, canvas) = drawn(&server, &id, json!({"outside": outside})).await;
        assert!(
            same == image::imageops::crop_imm(&whole, 60, 50, 400, 300).to_image()
                && canvas.is_none()
        );
        // At half the size.
        let mut half = tile(0, 0, 520, 440);
        half["width"] = json!(260);
        let (half, canvas) = drawn(&server, &id, half).await;
        assert_eq!(
            (half.dimensions(), canvas.as_deref()),
            ((260, 220), Some("-60,-50,520,440")),
            "the canvas is in px of the source"
        );
    }
}

#[tokio::test]
async fn fit_shows_the_whole_result_and_nothing_else() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(400, 300), &turned()).await;
    let (fit, canvas) = drawn(&server, &id, json!({"canvas": "fit"})).await;
    let canvas = canvas.unwrap();
    let numbers: Vec<i64> = canvas
        .split(',')
        .map(|number| number.parse().unwrap())
        .collect();
    let [x, y, width, height] = numbers[..] else {
        panic!("{canvas}")
    };
    assert_eq!(
        fit.dimensions(),
        (
            u32::try_from(width).unwrap(),
            u32::try_from(height).unwrap()
        )
    );
    let (around, _) = drawn(
        &server,
        &id,
        json!({"canvas": {"x": x - 30, "y": y - 30, "width": width + 60, "height": height + 60}}),
    )
    .await;
    let covered: Vec<_> = around
        .enumerate_pixels()
        .filter(|(.., pixel)| pixel.0[3] > 0)
        .map(|(x, y, _)| (i64::from(x) - 30, i64::from(y) - 30))
        .collect();
    let (left, right) = (
        covered.iter().map(|(x, _)| *x).min().unwrap(),
        covered.iter().map(|(x, _)| *x).max().unwrap(),
    );
    let (top, bottom) = (
        covered.iter().map(|(_, y)| *y).min().unwrap(),
        covered.iter().map(|(_, y)| *y).max().unwrap(),
    );
    // A pixel is covered if its centre is.
    assert!(
        (0..=1).contains(&left) && (0..=1).contains(&top),
        "{left} {top}"
    );
    assert!(
        (width - 2..width).contains(&right) && (height - 2..height).contains(&bottom),
        "{right} {bottom} of {width} x {height}"
    );

    for (q, want) in [
        (json!([[20, 20]]), "0,0,400,300"),
        (json!([[50.5, 7.75]]), "30,-13,401,301"),
        (json!([[10, 20]]), "-10,0,400,300"),
    ] {
        let warp = json!({"p": [[20, 20]], "q": q, "output": {"canvas": "fit"}});
        assert_eq!(
            header(
                &server.upload("/warp", &photo(400, 300), &warp).await,
                "warp-canvas"
            ),
            want,
            "{q}"
        );
    }
}

#[tokio::test]
async fn the_identity_is_copied_on_every_canvas() {
    let server = Server::start(&[]).await;
    let file = photo(64, 48);
    let source = decoded(&file);
    let canvas = json!({"x": -8, "y": 4, "width": 100, "height": 30});
    for (outside, beside) in [
        ("transparent", Some([0; 4])),
        ("#10203040", Some([16, 32, 48, 64])),
        ("edge", None),
    ] {
        let answer = server
            .upload(
                "/warp",
                &file,
                &json!({"output": {"canvas": canvas, "outside": outside}}),
            )
            .await;
        for (x, y, pixel) in decoded(&png(answer).await).enumerate_pixels() {
            let (x, y) = (i64::from(x) - 8, y + 4);
            let near = u32::try_from(x.clamp(0, 63)).unwrap();
            let want = if (0..64).contains(&x) {
                source[(near, y)].0
            } else {
                beside.unwrap_or(source[(near, y)].0)
            };
            assert_eq!(pixel.0, want, "{outside}: {x}, {y}");
        }
    }
}

#[tokio::test]
async fn a_canvas_that_cannot_be_drawn_is_a_problem_with_its_numbers() {
    let server =
        Server::start(&["--max-image-side", "2000", "--max-image-pixels", "1000000"]).await;
    let image = photo(200, 100);
    let upload = async |q: Value, output: Value| {
        server
            .upload(
                "/warp",
                &image,
                &json!({"p": [[0, 0], [200, 100]], "q": q, "method": "similarity",
                "output": output}),
            )
            .await
    };
    let (rest, far) = (
        json!([[0, 0], [200, 100]]),
        json!([[-9000, 0], [9000, 100]]),
    );
    let large = json!({"canvas": {"x": 0, "y": 0, "width": 2001, "height": 3}});
    let wide = json!({"canvas": {"x": 0, "y": 0, "width": 1999, "height": 1000}});
    for (q, output, name, actual) in [
        (&rest, large, "canvas_side", Some(2001)),
        (&rest, wide, "canvas_pixels", Some(1_999_000)),
        (&far, json!({"canvas": "fit"}), "canvas_side", None),
        (
            &rest,
            json!({"canvas": {"x": 0, "y": 0, "width": 1, "height": 1}, "width": 1900}),
            "output_pixels",
            Some(3_610_000),
        ),
    ] {
        let problem = problem(upload(q.clone(), output).await, 413, "too_large").await;
        let pointer = if name == "output_pixels" {
            "/output/width"
        } else {
            "/output/canvas"
        };
        assert_eq!(
            (&problem["limit_name"], &problem["pointer"]),
            (&json!(name), &json!(pointer)),
            "{problem}"
        );
        assert!(
            actual.is_none_or(|actual| problem["actual"] == actual),
            "{problem}"
        );
    }
    // Numbers that would overflow, and a result farther away than a canvas may be.
    let huge = json!({"width": 4_294_967_295_u32,
        "canvas": {"x": 0, "y": 0, "width": 2_000_000, "height": 2_000_000}});
    problem(upload(rest.clone(), huge).await, 413, "too_large").await;
    let beyond = json!({"p": [[10, 10], [10.001, 10]], "q": [[10, 10], [1_000_000, 10]],
        "method": "similarity",
        "output": {"canvas": "fit", "width": 100}});
    let refused = problem(
        server.upload("/warp", &image, &beyond).await,
        413,
        "too_large",
    )
    .await;
    assert!(refused["actual"].as_f64().unwrap() > 1e10, "{refused}");
    let shifted = json!({"p": [[10, 10]], "q": [[999_990, 10]], "output": {"canvas": "fit"}});
    let refused = problem(
        server.upload("/warp", &image, &shifted).await,
        413,
        "too_large",
    )
    .await;
    assert_eq!(
        (
            &refused["limit_name"],
            &refused["limit"],
            &refused["actual"]
        ),
        (&json!("canvas_edge"), &json!(1_000_000), &json!(1_000_180))
    );
    // A zoom at which single cells would be longer than the rasteriser's numbers.
    let pixel = json!({"x": 3, "y": 3, "width": 1, "height": 1});
    let zoom = |width: u32| {
        json!({"p": [[0, 0]], "q": [[0, 0.5]],
        "output": {"canvas": pixel, "width": width}})
    };
    let long = photo(1200, 10);
    let refused = problem(
        server.upload("/warp", &long, &zoom(990)).await,
        413,
        "too_large",
    )
    .await;
    let told = (
        &refused["limit_name"],
        &refused["actual"],
        &refused["pointer"],
    );
    assert_eq!(
        told,
        (
            &json!("scaled_source_side"),
            &json!(1_188_000),
            &json!("/output/width")
        ),
        "{refused}"
    );
    assert_eq!(
        server.upload("/warp", &long, &zoom(870)).await.status(),
        200
    );
    // A session that could never be drawn is not stored.
    let never =
        json!({"p": rest, "output": {"canvas": {"x": 0, "y": 0, "width": 2001, "height": 3}}});
    problem(
        server.upload("/sessions", &image, &never).await,
        413,
        "too_large",
    )
    .await;
    // `width` says how large the result is.
    let small = json!({"canvas": "fit", "width": 50});
    assert_eq!(upload(far, small).await.status(), 200);
    let point = json!([[50, 50], [50, 50]]);
    let nothing = problem(
        upload(point.clone(), json!({"canvas": "fit"})).await,
        422,
        "nothing_visible",
    )
    .await;
    assert_eq!(nothing["pointer"], "/output/canvas");
    assert_eq!(upload(point, json!({})).await.status(), 200);
}

#[tokio::test]
async fn a_session_keeps_its_canvas_and_a_drag_may_give_another() {
    let server = Server::start(&[]).await;
    let mut warp = turned();
    let canvas = json!({"x": 10, "y": -20, "width": 300, "height": 200});
    warp["output"] = json!({"canvas": canvas});
    let id = server.session(&photo(400, 300), &warp).await;
    let session: Value = server
        .get(&format!("/sessions/{id}"))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    assert_eq!(session["output"]["canvas"], canvas, "{session}");
    assert_eq!(
        drawn(&server, &id, json!({})).await.1.as_deref(),
        Some("10,-20,300,200")
    );
    assert_eq!(drawn(&server, &id, json!({"canvas": "same"})).await.1, None);
    // No cell of the posed grid meets the canvas.
    let beside = json!({"q": turned()["q"],
        "output": {"canvas": {"x": 5000, "y": 0, "width": 9, "height": 9}}});
    assert_eq!(
        header(&server.drag(&id, &beside).await, "warp-warning"),
        "nothing_visible"
    );
    let mut drag = DragClient::open(server.address, &id, "?report=true").await;
    drag.pose(1, &turned()["q"]).await;
    let report = drag.text().await;
    assert_eq!(
        (&report["canvas"], &report["width"], &report["height"]),
        (&canvas, &json!(300), &json!(200)),
        "{report}"
    );
    let (_, frame) = drag.frame().await;
    assert_eq!(decoded(&frame).dimensions(), (300, 200));
}

/// The width of `fit` depends on the pose, so it may be narrower or wider than any preview.
#[tokio::test]
async fn a_drag_with_fit_ends_with_the_picture_of_a_request() {
    let server = Server::start(&[]).await;
    let warp =
        json!({"p": [[0, 0], [400, 0]], "method": "similarity", "output": {"canvas": "fit"}});
    let id = server.session(&photo(400, 300), &warp).await;
    for (width, to, posed) in [
        ("400", 800, 800),
        ("auto", 100, 100),
        ("500", 300, 300),
        ("1000", 800, 800),
    ] {
        let q = json!([[0, 0], [to, 0]]);
        let mut drag =
            DragClient::open(server.address, &id, &format!("?report=true&width={width}")).await;
        drag.pose(1, &q).await;
        let preview = drag.text().await;
        let (_, frame) = drag.frame().await;
        let least = width.parse().unwrap_or(400).min(posed);
        assert_eq!(
            (decoded(&frame).width(), &preview["full"]),
            (least, &json!(false)),
            "{width}: {preview}"
        );
        drag.ack(1).await;
        let report = drag.text().await;
        assert_eq!(
            (&report["seq"], &report["full"], &report["width"]),
            (&json!(1), &json!(true), &json!(posed)),
            "{width}: {report}"
        );
        let (_, frame) = drag.frame().await;
        assert!(
            frame == png(server.drag(&id, &json!({"q": q})).await).await,
            "{width}"
        );
    }
}
