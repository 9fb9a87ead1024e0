//! `strength`: the handles are moved to `p + strength (q - p)`, with every `q`.

use serde_json::{Value, json};

use crate::support::server::{form, header, png, problem};
use crate::support::{Server, photo};

const SIZE: (u32, u32) = (64, 48);

/// Handles at rest and posed: a point and a line.
fn rest() -> Value {
    json!([[10, 10], [[40, 30], [50, 12]]])
}

fn posed() -> Value {
    json!([[14, 6], [[44, 30], [48, 20]]])
}

/// The posed handles at a strength that needs no rounding.
fn at(strength: f64) -> Value {
    fn lerp(p: &Value, q: &Value, t: f64) -> Value {
        match (p, q) {
            (Value::Array(p), Value::Array(q)) => {
                p.iter().zip(q).map(|(p, q)| lerp(p, q, t)).collect()
            }
            _ => json!(p.as_f64().unwrap() + t * (q.as_f64().unwrap() - p.as_f64().unwrap())),
        }
    }
    lerp(&rest(), &posed(), strength)
}

#[tokio::test]
async fn a_strength_is_the_pose_of_that_strength_with_every_q() {
    let server = Server::start(&[]).await;
    let image = photo(SIZE.0, SIZE.1);
    let opened = server
        .post("/sessions")
        .multipart(form(&image, json!({"p": rest()}).to_string()))
        .send()
        .await
        .unwrap();
    let id = opened.json::<Value>().await.unwrap()["id"]
        .as_str()
        .unwrap()
        .to_owned();
    for strength in [-2.0, 0.0, 0.5, 1.0, 1.5] {
        let (q, strong) = (
            json!({"q": at(strength)}),
            json!({"q": posed(), "strength": strength}),
        );
        // Every route that takes q.
        for (path, more) in [
            ("warp", json!({})),
            ("mesh", json!({})),
            (
                "points",
                json!({"points": [[3, 4]], "boxes": [[1, 2, 9, 9]]}),
            ),
        ] {
            let send = |body: &Value| {
                let mut body = body.as_object().unwrap().clone();
                body.extend(more.as_object().unwrap().clone());
                server
                    .post(&format!("/sessions/{id}/{path}"))
                    .json(&body)
                    .send()
            };
            let (one, other) = (send(&q).await.unwrap(), send(&strong).await.unwrap());
            assert_eq!(
                (one.status(), other.status()),
                (200.try_into().unwrap(), 200.try_into().unwrap()),
                "{path}"
            );
            assert_eq!(one.headers().get("etag"), other.headers().get("etag"));
            assert!(
                one.bytes().await.unwrap() == other.bytes().await.unwrap(),
                "{path} at {strength}"
            );
        }
        let upload = async |body: Value| {
            let mut warp = json!({"p": rest()});
            warp.as_object_mut()
                .unwrap()
                .extend(body.as_object().unwrap().clone());
            png(server
                .post("/warp")
                .multipart(form(&image, warp.to_string()))
                .send()
                .await
                .unwrap())
            .await
        };
        assert!(upload(q).await == upload(strong).await, "{strength}");
    }
    let still = json!({"q": posed(), "strength": 0, "output": {"format": "png"}});
    let response = server
        .post(&format!("/sessions/{id}/warp"))
        .json(&still)
        .send()
        .await
        .unwrap();
    assert_eq!(
        header(&response, "warp-residual").parse::<f64>().unwrap(),
        0.0
    );
    let same = |file: &[u8]| crate::support::picture::decoded(file).samples;
    assert!(
        same(&png(response).await) == same(&image),
        "a strength of 0 is the picture at rest"
    );
}

#[tokio::test]
async fn landmark_files_have_a_strength_too() {
    let server = Server::start(&[]).await;
    let image = photo(SIZE.0, SIZE.1);
    let upload = async |csv: &str, warp: Value| {
        let form = form(&image, warp.to_string()).text("landmarks", csv.to_owned());
        png(server.post("/warp").multipart(form).send().await.unwrap()).await
    };
    let half = upload(
        "px,py,qx,qy\n10,10,14,6\n40,30,44,30\n",
        json!({"strength": 0.5}),
    )
    .await;
    assert!(half == upload("px,py,qx,qy\n10,10,12,8\n40,30,42,30\n", json!({})).await);
}

#[tokio::test]
async fn a_strength_without_a_pose_is_refused() {
    let server = Server::start(&[]).await;
    let image = photo(SIZE.0, SIZE.1);
    let refused = async |response| {
        let refused = problem(response, 422, "bad_value").await;
        assert_eq!(refused["pointer"], "/strength", "{refused}");
    };
    let warp = json!({"p": rest(), "strength": 0.5});
    refused(
        server
            .post("/sessions")
            .multipart(form(&image, warp.to_string()))
            .send()
            .await
            .unwrap(),
    )
    .await;
    let landmarks =
        form(&image, json!({"strength": 0.5}).to_string()).text("landmarks", "x,y\n10,10\n40,30\n");
    refused(
        server
            .post("/sessions")
            .multipart(landmarks)
            .send()
            .await
            .unwrap(),
    )
    .await;
    let id = server
        .session(&image, &json!({"p": rest(), "strength": 1}))
        .await;
    let put = async |body: Value| {
        server
            .client
            .put(server.url(&format!("/sessions/{id}/handles")))
            .json(&body)
            .send()
            .await
            .unwrap()
    };
    refused(put(json!({"alpha": 2, "strength": 2})).await).await;
    assert_eq!(
        put(json!({"q": posed(), "strength": 2})).await.status(),
        200
    );
}

#[tokio::test]
async fn a_strength_out_of_range_is_named() {
    let server = Server::start(&[]).await;
    for strength in [json!(10.5), json!(-11), json!("1"), json!([1])] {
        let warp = json!({"p": rest(), "q": posed(), "strength": strength});
        let response = server
            .post("/warp")
            .multipart(form(&photo(16, 12), warp.to_string()))
            .send()
            .await
            .unwrap();
        assert_eq!(
            problem(response, 422, "bad_value").await["pointer"],
            "/strength"
        );
    }
    let far = json!({"p": [[0, 0]], "q": [[9e5, 0]], "strength": 2});
    let response = server
        .post("/warp")
        .multipart(form(&photo(16, 12), far.to_string()))
        .send()
        .await
        .unwrap();
    assert_eq!(problem(response, 422, "bad_value").await["pointer"], "/q/0");
}
