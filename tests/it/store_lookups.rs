//! One request for a session asks the store for it once, on every route.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use bytes::Bytes;
use mlswarp::warp::Digest;
use mlswarp_server::app::App;
use mlswarp_server::client::Owner;
use mlswarp_server::http::connection::listen;
use mlswarp_server::http::paths;
use mlswarp_server::session::{Revision, SessionId};
use mlswarp_server::store::{
    NamedFile, Put, Record, Session, Store, StoreFuture, StoreStats, open,
};
use reqwest::Method;
use serde_json::json;

use crate::support::server::{config, form};
use crate::support::{DragClient, Server, photo};

/// A store that counts how often a session is looked up.
#[derive(Debug)]
struct Counting {
    store: Arc<dyn Store>,
    lookups: AtomicUsize,
}

impl Counting {
    fn taken(&self) -> usize {
        self.lookups.swap(0, Ordering::Relaxed)
    }
}

impl Store for Counting {
    fn put(&self, record: Arc<Record>, files: Vec<NamedFile>) -> StoreFuture<'_, Put> {
        self.store.put(record, files)
    }
    fn revise(
        &self,
        old: Revision,
        new: Arc<Record>,
        layer: Option<NamedFile>,
    ) -> StoreFuture<'_, Option<Session>> {
        self.store.revise(old, new, layer)
    }
    fn peek(&self, id: SessionId) -> StoreFuture<'_, Session> {
        self.lookups.fetch_add(1, Ordering::Relaxed);
        self.store.peek(id)
    }
    fn touch(&self, id: SessionId, seq: Option<u64>) -> StoreFuture<'_, Session> {
        self.lookups.fetch_add(1, Ordering::Relaxed);
        self.store.touch(id, seq)
    }
    fn delete(&self, id: SessionId) -> StoreFuture<'_, ()> {
        self.store.delete(id)
    }
    fn was_deleted(&self, id: SessionId) -> StoreFuture<'_, bool> {
        self.store.was_deleted(id)
    }
    fn file_bytes(&self, id: SessionId, digest: Digest) -> StoreFuture<'_, u64> {
        self.store.file_bytes(id, digest)
    }
    fn file(&self, id: SessionId, digest: Digest) -> StoreFuture<'_, Bytes> {
        self.store.file(id, digest)
    }
    fn local_record(&self, id: SessionId) -> Option<Arc<Record>> {
        self.store.local_record(id)
    }
    fn names(&self, owner: Owner, digest: Digest) -> bool {
        self.store.names(owner, digest)
    }
    fn sweep(&self) -> StoreFuture<'_, usize> {
        self.store.sweep()
    }
    fn ready(&self) -> StoreFuture<'_, ()> {
        self.store.ready()
    }
    fn figures(&self) -> StoreStats {
        self.store.figures()
    }
}

/// A server, and its store.
fn start(options: &[&str]) -> (Server, Arc<Counting>) {
    let config = config(options);
    let listener = listen(config.listen).unwrap();
    let counting = Arc::new(Counting {
        store: open(&config.store.url, config.store.bounds()).unwrap(),
        lookups: AtomicUsize::new(0),
    });
    let store = Arc::clone(&counting) as Arc<dyn Store>;
    let app = App::with_store(config, store).unwrap();
    (Server::of(app, listener), counting)
}

/// A token is of a session, and only keys make them.
#[tokio::test]
async fn a_token_asks_the_store_once_too() {
    let (server, counting) = start(&["--keys", "ann a-key-of-the-tests"]);
    let key = "Bearer a-key-of-the-tests";
    let open = server.post("/sessions").header("authorization", key);
    let upload = form(&photo(16, 12), json!({"p": [[2, 2]]}).to_string());
    let opened = open.multipart(upload).send().await.unwrap();
    let id = opened.json::<serde_json::Value>().await.unwrap()["id"].clone();
    assert_eq!(counting.taken(), 0);
    let minting = server.post(&format!("/sessions/{}/tokens", id.as_str().unwrap()));
    let minting = minting.header("authorization", key);
    let minted = minting
        .json(&json!({"ops": ["drag"]}))
        .send()
        .await
        .unwrap();
    assert_eq!((minted.status().as_u16(), counting.taken()), (201, 1));
}

#[tokio::test]
async fn one_request_for_a_session_asks_the_store_once() {
    let (server, counting) = start(&[]);
    let p = json!([[2, 2], [12, 2], [2, 9], [12, 9], [7, 5]]);
    let q = json!([[3, 2], [12, 3], [2, 8], [13, 9], [7, 6]]);
    let id = server.session(&photo(16, 12), &json!({"p": p})).await;
    assert_eq!(counting.taken(), 0);

    let layer = "/sessions/{id}/layers/{name}";
    let json = |value: serde_json::Value| Some(value.to_string());
    // The route, the body, and how often the store is asked.
    let requests = [
        (Method::GET, "/sessions/{id}", None, 1),
        (Method::HEAD, "/sessions/{id}", None, 1),
        (
            Method::PUT,
            "/sessions/{id}/handles",
            json(json!({"p": p})),
            1,
        ),
        (Method::PUT, layer, None, 1),
        (Method::GET, layer, None, 1),
        (
            Method::POST,
            "/sessions/{id}/warp",
            json(json!({"q": q})),
            1,
        ),
        (
            Method::POST,
            "/sessions/{id}/warp",
            json(json!({"q": q, "seq": 4, "layer": "depth"})),
            1,
        ),
        (
            Method::POST,
            "/sessions/{id}/mesh",
            json(json!({"q": q})),
            1,
        ),
        (
            Method::POST,
            "/sessions/{id}/mesh",
            json(json!({"q": q, "seq": 5})),
            1,
        ),
        (Method::GET, "/sessions/{id}/plan", None, 1),
        (
            Method::POST,
            "/sessions/{id}/batch",
            json(json!({"q": q, "steps": 3, "layers": ["depth"]})),
            1,
        ),
        (
            Method::POST,
            "/sessions/{id}/points",
            json(json!({"q": q, "points": [[1, 1]]})),
            1,
        ),
        (Method::POST, "/sessions/{id}/map", json(json!({"q": q})), 1),
        (
            Method::POST,
            "/sessions/{id}/report",
            json(json!({"q": q})),
            1,
        ),
        (Method::POST, "/sessions/{id}/fit", json(json!({"q": q})), 1),
        (Method::DELETE, layer, None, 1),
    ];
    for (method, path, body, lookups) in &requests {
        // Nothing that is cached hides a question.
        server.app.clear_caches();
        let url = server.url(&path.replace("{id}", &id).replace("{name}", "depth"));
        let request = server.client.request(method.clone(), url);
        let request = match body {
            Some(body) => request
                .header("content-type", "application/json")
                .body(body.clone()),
            None if *method == Method::PUT => request.body(photo(16, 12)),
            None => request,
        };
        let response = request.send().await.unwrap();
        let status = response.status();
        let body = response.bytes().await.unwrap();
        assert!(status.is_success(), "{method} {path} {status}: {body:?}");
        assert_eq!(counting.taken(), *lookups, "{method} {path}");
    }

    // The socket asks when it is opened, and once for each frame.
    let mut drag = DragClient::open(server.address, &id, "").await;
    assert_eq!(counting.taken(), 1);
    drag.say(&json!({"seq": 1, "q": q})).await;
    drag.next().await;
    assert_eq!(counting.taken(), 1);
    drop(drag);

    // What replaces or ends a session asks for nothing but that.
    let path = server.url(&format!("/sessions/{id}"));
    let other = form(&photo(16, 12), json(json!({"p": [[3, 3]]})).unwrap());
    let put = server.client.put(&path).multipart(other);
    assert_eq!(put.send().await.unwrap().status(), 200);
    assert_eq!(
        server.client.delete(&path).send().await.unwrap().status(),
        204
    );
    assert_eq!(counting.taken(), 0);

    let asked = |path: &str| {
        ["/sessions/{id}/drag", "/sessions/{id}/tokens"].contains(&path)
            || requests.iter().any(|(_, other, ..)| *other == path)
    };
    for (path, _) in paths(&server.app) {
        assert!(
            !path.contains("{id}") || asked(path),
            "{path} is not asked for"
        );
    }
}
