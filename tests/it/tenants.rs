//! What one name learns of another: nothing. All that Bob sees is compared between a server where
//! Ann has stored the file that he sends, and one where she has stored another file of the same
//! length: statuses, headers, problems, sessions and metrics.

use mlswarp_server::limits::memory::MemoryClass;
use reqwest::{Client, RequestBuilder, Response};
use serde_json::{Value, json};

use crate::support::picture::bmp;
use crate::support::server::form;
use crate::support::{Scratch, Server, eventually};

const ANN: &str = "ann-s-key-0123456789";
const BOB: &str = "bob-s-key-9876543210";
/// Of nobody.
const CAROL: &str = "carol-s-key-0123456789";

/// Headers that differ between any two requests.
const OF_ITS_TIME: [&str; 4] = ["date", "location", "x-request-id", "server-timing"];

struct Name<'a> {
    server: &'a Server,
    key: &'static str,
    /// All that was seen.
    seen: Vec<String>,
}

impl<'a> Name<'a> {
    fn new(server: &'a Server, key: &'static str) -> Self {
        Self {
            server,
            key,
            seen: Vec::new(),
        }
    }

    /// Sends a request, and notes what differs only by what others have stored.
    async fn ask(&mut self, what: &str, request: RequestBuilder) -> Value {
        let response: Response = request.bearer_auth(self.key).send().await.unwrap();
        let status = response.status();
        let mut headers: Vec<String> = response
            .headers()
            .iter()
            .filter(|(name, _)| !OF_ITS_TIME.contains(&name.as_str()))
            .map(|(name, value)| format!("{name}: {}", value.to_str().unwrap()))
            .collect();
        headers.sort_unstable();
        let is_json = headers.iter().any(|header| {
            header.starts_with("content-type: application/") && header.contains("json")
        });
        let body = response.bytes().await.unwrap();
        let mut told: Value = if is_json {
            serde_json::from_slice(&body).unwrap()
        } else {
            Value::Null
        };
        let answer = told.clone();
        if let Some(members) = told.as_object_mut() {
            members.retain(|name, _| {
                !["id", "request_id", "created", "expires", "rest_revision"]
                    .contains(&name.as_str())
            });
        }
        self.seen
            .push(format!("{what}: {status} {headers:?} {told}"));
        answer
    }

    /// Notes the metrics, without those of times.
    async fn scrape(&mut self, what: &str) {
        let budget = self.server.app.budget();
        eventually("answers have left", || {
            budget.taken_for(MemoryClass::Frame) == 0
        })
        .await;
        let request = self.server.get("/metrics").bearer_auth(self.key);
        let text = request.send().await.unwrap().text().await.unwrap();
        let is_of_time = |line: &&str| {
            ["_seconds", "resident", "connections", "busy"]
                .iter()
                .any(|name| line.contains(name))
        };
        let mut lines: Vec<&str> = text
            .lines()
            .filter(|line| !line.starts_with('#') && !is_of_time(line))
            .collect();
        lines.sort_unstable();
        assert!(
            lines.len() > 40 && text.contains("mlswarp_store_size_bytes"),
            "{text}"
        );
        self.seen.push(format!("{what}: {}", lines.join("\n")));
    }
}

fn rest() -> Value {
    json!({"p": [[20, 20], [60, 40]]})
}

/// Ann stores a picture, a layer and a mask; Bob then does all that he can do with these files.
/// What he has seen.
async fn seen_by_bob(store: &str, anns: [&[u8]; 2], bobs: [&[u8]; 2]) -> Vec<String> {
    // For the two files of each, and little more.
    let room = (4 * anns[0].len() + 6144).to_string();
    let keys = format!("ann {ANN},bob {BOB},carol {CAROL}");
    let options = [
        "--store",
        store,
        "--keys",
        &keys,
        "--store-bytes",
        &room,
        "--max-client-share",
        "100",
        "--workers",
        "1",
    ];
    let server = Server::start(&options).await;
    let mut ann = Name::new(&server, ANN);
    let id = ann
        .ask(
            "ann",
            server
                .post("/sessions")
                .multipart(form(anns[0], rest().to_string())),
        )
        .await;
    let id = id["id"].as_str().unwrap().to_owned();
    let layer = |client: &Client, id: &str, name: &str, file: &[u8]| {
        client
            .put(server.url(&format!("/sessions/{id}/layers/{name}")))
            .body(file.to_vec())
    };
    ann.ask("ann", layer(&server.client, &id, "depth", anns[1]))
        .await;

    let mut bob = Name::new(&server, BOB);
    bob.scrape("before").await;
    let opened = bob
        .ask(
            "open",
            server
                .post("/sessions")
                .multipart(form(bobs[0], rest().to_string())),
        )
        .await;
    let id = opened["id"].as_str().unwrap().to_owned();
    bob.scrape("with a session").await;
    bob.ask("layer", layer(&server.client, &id, "depth", bobs[1]))
        .await;
    bob.scrape("with a layer").await;
    let drag = json!({"q": [[22, 20], [60, 41]]});
    bob.ask(
        "drag",
        server.post(&format!("/sessions/{id}/warp")).json(&drag),
    )
    .await;
    bob.ask("session", server.get(&format!("/sessions/{id}")))
        .await;
    // A store without room for it says how full it would be.
    let large = bmp(400, 300, 7);
    bob.ask(
        "too much",
        server
            .post("/sessions")
            .multipart(form(&large, rest().to_string())),
    )
    .await;
    bob.ask(
        "too much",
        layer(&server.client, &id, "more", &bmp(80, 60, 9)),
    )
    .await;
    bob.scrape("refused").await;
    bob.ask(
        "layer gone",
        server
            .client
            .delete(server.url(&format!("/sessions/{id}/layers/depth"))),
    )
    .await;
    bob.scrape("without the layer").await;
    // As a layer the picture, and as a picture the layer.
    bob.ask("exchanged", layer(&server.client, &id, "depth", bobs[0]))
        .await;
    bob.ask(
        "exchanged",
        server
            .post("/sessions")
            .multipart(form(bobs[1], rest().to_string())),
    )
    .await;
    bob.scrape("exchanged").await;
    bob.ask(
        "gone",
        server.client.delete(server.url(&format!("/sessions/{id}"))),
    )
    .await;
    bob.scrape("gone").await;
    bob.seen
}

/// The same files as Ann's, and others of their length.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_file_of_another_name_changes_nothing_that_is_seen() {
    let [one, two, three, four] = [1, 2, 3, 4].map(|seed| bmp(80, 60, seed));
    for is_file in [false, true] {
        let scratch = Scratch::new();
        let store = |name: &str| {
            if is_file {
                format!("file:{}", scratch.path(name))
            } else {
                "memory".to_owned()
            }
        };
        let shared = seen_by_bob(&store("a"), [&one, &two], [&one, &two]).await;
        let foreign = seen_by_bob(&store("b"), [&three, &four], [&one, &two]).await;
        assert_eq!(shared.len(), foreign.len());
        for (shared, foreign) in shared.iter().zip(&foreign) {
            let lines = |text: &str| {
                text.lines()
                    .map(str::to_owned)
                    .collect::<std::collections::BTreeSet<_>>()
            };
            let (shared, foreign) = (lines(shared), lines(foreign));
            let differ: Vec<&String> = shared.symmetric_difference(&foreign).collect();
            assert!(
                differ.is_empty(),
                "the store in a file: {is_file}; {differ:#?}"
            );
        }
        assert!(
            shared.iter().any(|seen| seen.contains("503")
                && seen.contains("store_bytes")
                && seen.contains("actual")),
            "{shared:?}"
        );
    }
}

/// A share protects other names. While all keys belong to one name, there is no share. The keys may
/// change.
#[tokio::test]
async fn the_only_name_has_no_share() {
    let scratch = Scratch::new();
    let keys = scratch.path("keys");
    std::fs::write(&keys, format!("ann {ANN}\nann {CAROL}\n")).unwrap();
    let server = Server::start(&[
        "--keys-file",
        &keys,
        "--max-sessions",
        "3",
        "--max-sockets",
        "2",
    ])
    .await;
    let open = async |key: &str| {
        let request = server
            .post("/sessions")
            .bearer_auth(key)
            .multipart(form(&bmp(16, 12, 1), json!({"p": [[2, 2]]}).to_string()));
        let response = request.send().await.unwrap();
        (
            response.status().as_u16(),
            response.json::<Value>().await.unwrap(),
        )
    };
    let mut ids = Vec::new();
    for key in [ANN, CAROL, ANN] {
        let (status, opened) = open(key).await;
        assert_eq!(status, 201, "{opened}");
        ids.push(opened["id"].as_str().unwrap().to_owned());
    }
    // The store's own limit applies.
    let (status, refused) = open(ANN).await;
    assert_eq!((status, &refused["limit_name"]), (503, &json!("sessions")));
    let delete = async |id: &str| {
        server
            .client
            .delete(server.url(&format!("/sessions/{id}")))
            .bearer_auth(ANN)
            .send()
            .await
            .unwrap()
    };
    delete(&ids[0]).await;
    // Another name: the share is two of three.
    std::fs::write(&keys, format!("ann {ANN}\nbob {BOB}\n")).unwrap();
    let began = std::time::Instant::now();
    while open(BOB).await.0 != 201 {
        assert!(
            began.elapsed() < std::time::Duration::from_secs(30),
            "keys are read again"
        );
        tokio::time::sleep(std::time::Duration::from_millis(100)).await;
    }
    let (status, refused) = open(ANN).await;
    assert_eq!(
        (status, &refused["limit_name"], &refused["limit"]),
        (429, &json!("client_sessions"), &json!(2))
    );
    assert!(
        refused["detail"]
            .as_str()
            .unwrap()
            .contains("--max-client-share"),
        "{refused}"
    );
}
