//! The service on a real socket of the loopback, in this process, so that its counters can be read.

use std::net::{SocketAddr, TcpListener};

use mlswarp_server::app::App;
use mlswarp_server::config::Config;
use mlswarp_server::http::connection::{listen, serve};
use reqwest::multipart::{Form, Part};
use reqwest::{Client, RequestBuilder, Response};
use serde_json::{Value, json};
use tokio::sync::oneshot;

use super::picture::decoded;

/// Options as on the command line. No test that is not about waiting depends on how fast this
/// machine is.
pub(crate) fn config(options: &[&str]) -> Config {
    let usual = [
        "mlswarp",
        "--listen",
        "127.0.0.1:0",
        "--drag-wait",
        "10m",
        "--upload-wait",
        "10m",
    ];
    Config::read([&usual, options].concat()).unwrap()
}

/// As which client the requests of a test are counted.
pub(crate) fn this_client() -> mlswarp_server::client::Client {
    mlswarp_server::client::Client {
        address: std::net::Ipv4Addr::LOCALHOST.into(),
        ..Default::default()
    }
}

/// A running server and a client.
pub(crate) struct Server {
    pub(crate) app: App,
    pub(crate) address: SocketAddr,
    pub(crate) client: Client,
    _stop: oneshot::Sender<()>,
}

impl Server {
    pub(crate) async fn start(options: &[&str]) -> Self {
        let config = config(options);
        let listener = listen(config.listen).unwrap();
        Self::of(App::new(config).unwrap(), listener)
    }

    /// A server of an application, on an open listener.
    pub(crate) fn of(app: App, listener: TcpListener) -> Self {
        let address = listener.local_addr().unwrap();
        let (stop, stopped) = oneshot::channel();
        tokio::spawn(serve(app.clone(), listener, async {
            let _ = stopped.await;
        }));
        Self {
            app,
            address,
            client: Client::new(),
            _stop: stop,
        }
    }

    /// A server with a key, which its client sends.
    pub(crate) async fn with_key() -> Self {
        const KEY: &str = "a-key-of-the-tests";
        let key = format!("Bearer {KEY}").parse().unwrap();
        let headers = [(reqwest::header::AUTHORIZATION, key)];
        let client = Client::builder().default_headers(headers.into_iter().collect());
        Self {
            client: client.build().unwrap(),
            ..Self::start(&["--keys", &format!("ann {KEY}")]).await
        }
    }

    pub(crate) fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.address)
    }

    pub(crate) fn post(&self, path: &str) -> RequestBuilder {
        self.client.post(self.url(path))
    }

    pub(crate) fn get(&self, path: &str) -> RequestBuilder {
        self.client.get(self.url(path))
    }

    pub(crate) async fn upload(&self, path: &str, image: &[u8], warp: &Value) -> Response {
        self.post(path)
            .multipart(form(image, warp.to_string()))
            .send()
            .await
            .unwrap()
    }

    /// The id of a new session.
    pub(crate) async fn session(&self, image: &[u8], warp: &Value) -> String {
        let response = self.upload("/sessions", image, warp).await;
        assert_eq!(response.status(), 201, "{:?}", response.text().await);
        response.json::<Value>().await.unwrap()["id"]
            .as_str()
            .unwrap()
            .to_owned()
    }

    pub(crate) async fn drag(&self, id: &str, body: &Value) -> Response {
        self.post(&format!("/sessions/{id}/warp"))
            .json(body)
            .send()
            .await
            .unwrap()
    }

    /// A request that must succeed, whatever happened before.
    pub(crate) async fn is_well(&self) {
        let response = self
            .upload(
                "/warp",
                &super::photo(16, 12),
                &json!({"p": [[2, 2]], "q": [[3, 2]]}),
            )
            .await;
        png(response).await;
        assert_eq!(self.get("/readyz").send().await.unwrap().status(), 200);
    }
}

/// A form with the images of a blend and its object.
pub(crate) fn blend_form(images: &[&[u8]], blend: &Value) -> Form {
    let part = |bytes: &[u8]| Part::bytes(bytes.to_vec()).file_name("image");
    let form = Form::new().text("blend", blend.to_string());
    images
        .iter()
        .fold(form, |form, image| form.part("image", part(image)))
}

/// The two parts.
pub(crate) fn form(image: &[u8], warp: impl Into<String>) -> Form {
    Form::new()
        .part("image", Part::bytes(image.to_vec()).file_name("picture"))
        .text("warp", warp.into())
}

/// The file of an answer that must be a picture, read by both decoders.
pub(crate) async fn png(response: Response) -> Vec<u8> {
    assert_eq!(response.status(), 200, "{:?}", response.text().await);
    assert_eq!(header(&response, "content-type"), "image/png");
    let file = response.bytes().await.unwrap().to_vec();
    decoded(&file);
    file
}

/// A header as text.
pub(crate) fn header<'a>(response: &'a Response, name: &str) -> &'a str {
    response
        .headers()
        .get(name)
        .unwrap_or_else(|| panic!("{name} in {:?}", response.headers()))
        .to_str()
        .unwrap()
}

/// Checks that the answer is a whole problem document with this status and code, and gives it back.
pub(crate) async fn problem(response: Response, status: u16, code: &str) -> Value {
    let request_id = header(&response, "x-request-id").to_owned();
    let got = response.status().as_u16();
    let media_type = header(&response, "content-type").to_owned();
    let text = response.text().await.unwrap();
    assert_eq!(
        got,
        status,
        "{code}: {}",
        text.chars().take(300).collect::<String>()
    );
    assert_eq!(media_type, "application/problem+json");
    let document: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(document["code"], code, "{text}");
    assert_eq!(document["status"], status);
    assert_eq!(document["type"], format!("/problems/{code}"));
    assert_eq!(document["request_id"], request_id);
    for field in ["title", "detail"] {
        assert!(
            document[field].as_str().is_some_and(|s| !s.is_empty()),
            "{field} in {text}"
        );
    }
    document
}
