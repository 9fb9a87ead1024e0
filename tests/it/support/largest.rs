//! The largest requests of every operation of the OpenAPI document, for tests of what one client
//! can cause for others. An operation that has none here fails those tests.

use std::io::{Read as _, Write as _};
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, TcpStream};
use std::time::Duration;

use serde_json::{Value, json};
use socket2::{Domain, Socket, Type};

use super::photo;

/// In place of the id of a session that no other request has.
pub(crate) const NEW: &str = "{new}";
const EXTENT: (u32, u32) = (200, 150);
const PATIENCE: Duration = Duration::from_secs(60);

/// How large requests are.
#[derive(Clone, Copy)]
pub(crate) struct Sizes {
    /// Handles of a session.
    pub(crate) handles: u32,
    /// Bytes of a warp object, and of any body.
    pub(crate) json: usize,
    pub(crate) body: usize,
}

/// A request, and the status of its response.
pub(crate) struct Request {
    pub(crate) what: String,
    method: String,
    path: String,
    head: String,
    body: Vec<u8>,
    /// What is sent after the handshake of a socket.
    message: Vec<u8>,
    pub(crate) status: u16,
}

impl Request {
    pub(crate) fn new(method: &str, path: impl Into<String>, status: u16) -> Self {
        let (head, body, message) = (String::new(), Vec::new(), Vec::new());
        Self {
            what: String::new(),
            method: method.to_owned(),
            path: path.into(),
            head,
            body,
            message,
            status,
        }
    }

    fn called(mut self, what: &str) -> Self {
        what.clone_into(&mut self.what);
        self
    }

    fn header(mut self, name: &str, value: &str) -> Self {
        self.head += &format!("{name}: {value}\r\n");
        self
    }

    fn body(mut self, media_type: &str, body: impl Into<Vec<u8>>) -> Self {
        self.body = body.into();
        self.header("content-type", media_type)
    }

    fn json(self, body: impl ToString) -> Self {
        self.body("application/json", body.to_string())
    }

    fn form(self, parts: &[(&str, &[u8])]) -> Self {
        let mut body = Vec::new();
        for (name, bytes) in parts {
            body.extend_from_slice(
                format!("--b\r\nContent-Disposition: form-data; name=\"{name}\"\r\n\r\n")
                    .as_bytes(),
            );
            body.extend_from_slice(bytes);
            body.extend_from_slice(b"\r\n");
        }
        body.extend_from_slice(b"--b--\r\n");
        self.body("multipart/form-data; boundary=b", body)
    }

    /// The same, of a session that was just opened.
    pub(crate) fn of(&self, session: &str) -> Self {
        let Self {
            what,
            method,
            path,
            head,
            body,
            message,
            status,
        } = self;
        let (what, method, path) = (what.clone(), method.clone(), path.replace(NEW, session));
        Self {
            what,
            method,
            path,
            head: head.clone(),
            body: body.clone(),
            message: message.clone(),
            status: *status,
        }
    }

    /// Whether it needs a session that no other request has.
    pub(crate) fn needs_session(&self) -> bool {
        self.path.contains(NEW)
    }

    /// `GET` as `HEAD`, whose response has the same status.
    fn as_head(&self) -> Option<Self> {
        let is_get = self.method == "GET" && self.message.is_empty();
        is_get.then(|| Self {
            method: "HEAD".to_owned(),
            what: format!("{} (HEAD)", self.what),
            ..self.of(NEW)
        })
    }

    /// Sends it from an address of the loopback; the response is still to be read, by little and
    /// little.
    pub(crate) fn send(&self, from: Ipv4Addr, to: SocketAddr) -> std::io::Result<TcpStream> {
        const RECEIVE_BUFFER: usize = 16 << 10;
        self.send_by(from, to, |socket| {
            socket.set_recv_buffer_size(RECEIVE_BUFFER)
        })
    }

    fn send_by(
        &self,
        from: Ipv4Addr,
        to: SocketAddr,
        prepare: impl FnOnce(&Socket) -> std::io::Result<()>,
    ) -> std::io::Result<TcpStream> {
        let socket = Socket::new(Domain::IPV4, Type::STREAM, None)?;
        prepare(&socket)?;
        socket.bind(&SocketAddrV4::new(from, 0).into())?;
        socket.connect(&to.into())?;
        let mut stream = TcpStream::from(socket);
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        stream.set_write_timeout(Some(PATIENCE))?;
        let Self {
            method,
            path,
            head,
            body,
            ..
        } = self;
        let length = if body.is_empty() {
            String::new()
        } else {
            format!("content-length: {}\r\n", body.len())
        };
        let close = if self.message.is_empty() {
            "connection: close\r\n"
        } else {
            ""
        };
        stream.write_all(
            format!("{method} {path} HTTP/1.1\r\nhost: localhost\r\n{close}{length}{head}\r\n")
                .as_bytes(),
        )?;
        // It may be answered before its body is read.
        let _ = stream.write_all(body);
        Ok(stream)
    }

    /// The status of the response, and the first part of what follows it.
    pub(crate) fn status(&self, stream: &mut TcpStream) -> std::io::Result<(u16, Vec<u8>)> {
        let mut read = vec![0; 1 << 10];
        let length = stream.read(&mut read)?;
        read.truncate(length);
        let status = String::from_utf8_lossy(&read)
            .split(' ')
            .nth(1)
            .and_then(|status| status.parse().ok());
        if status == Some(101) {
            stream.write_all(&self.message)?;
        }
        Ok((status.unwrap_or_default(), read))
    }

    /// Sends it and reads the whole response; of a socket, until there is a frame.
    pub(crate) fn exchange(&self, to: SocketAddr) -> (u16, Vec<u8>) {
        // With the system's buffer: a client with a small one is passed packet after packet within
        // the calls of the sender, and would be measured as its time.
        let sent = self.send_by(Ipv4Addr::LOCALHOST, to, |_| Ok(()));
        let mut stream = sent.unwrap();
        let (status, mut read) = self.status(&mut stream).unwrap();
        if self.message.is_empty() {
            let _ = stream.read_to_end(&mut read);
        } else {
            // Anything that is longer than the hello.
            let mut frame = [0; 2 << 10];
            while read.len() < frame.len() {
                let length = stream.read(&mut frame).unwrap();
                assert_ne!(length, 0, "the socket was closed");
                read.extend_from_slice(&frame[..length]);
            }
        }
        (status, read)
    }
}

/// What requests refer to.
pub(crate) struct Material {
    sizes: Sizes,
    picture: Vec<u8>,
    /// Has the most handles.
    many: String,
    /// Has two handles, a layer of the largest size, and the finest grid that is sent as JSON.
    few: String,
    /// Has one handle and hardly a grid.
    least: String,
    etag: String,
}

/// Points at places of their own.
fn points(count: u32, by: f64) -> Value {
    let place = |k: u32| {
        let (x, y) = (
            f64::from(k % 100) * 1.9 + 3.25,
            f64::from(k / 100) * 1.4 + 2.5,
        );
        json!([x + by * f64::from(k % 7), y - by * f64::from(k % 5)])
    };
    (0..count).map(place).collect()
}

/// A list of about this number of bytes.
fn list(item: &str, bytes: usize) -> String {
    let count = bytes.saturating_sub(200) / (item.len() + 1);
    format!("[{}]", vec![item; count.max(1)].join(","))
}

impl Material {
    /// Without sessions, to which nothing can be sent.
    pub(crate) fn unopened(sizes: Sizes) -> Self {
        let (many, few, least, etag) = (String::new(), String::new(), String::new(), String::new());
        Self {
            sizes,
            picture: photo(EXTENT.0, EXTENT.1),
            many,
            few,
            least,
            etag,
        }
    }

    /// Opens the sessions that requests refer to.
    pub(crate) fn prepare(server: SocketAddr, sizes: Sizes) -> Self {
        let mut made = Self::unopened(sizes);
        made.many = made.session(server);
        let few = r#"{"p": [[20, 20], [90, 60]], "grid": {"columns": 500, "rows": 400}}"#;
        made.few = made.open(server, few.as_bytes());
        made.least = made.open(
            server,
            br#"{"p": [[20, 20]], "grid": {"columns": 2, "rows": 2}}"#,
        );
        let layer = Request::new("PUT", format!("/sessions/{}/layers/large", made.few), 201)
            .body("image/png", made.large_picture());
        assert_eq!(layer.exchange(server).0, 201);
        let (_, plan) = Request::new(
            "GET",
            format!("/sessions/{}/plan?columns=2&rows=2", made.many),
            200,
        )
        .exchange(server);
        let plan = String::from_utf8_lossy(&plan).into_owned();
        plan.lines()
            .find_map(|line| line.strip_prefix("etag: "))
            .unwrap()
            .clone_into(&mut made.etag);
        // Measured is what replaces something.
        for request in ["putSession", "putLayer"]
            .into_iter()
            .flat_map(|name| made.of_operation(name))
        {
            let (status, _) = request.exchange(server);
            assert!(
                status == request.status || status == 201,
                "{status}: {}",
                request.what
            );
        }
        made
    }

    /// A session of its own, with the most handles and a layer.
    pub(crate) fn session(&self, server: SocketAddr) -> String {
        let id = self.open(server, self.rest().to_string().as_bytes());
        let layer = Request::new("PUT", format!("/sessions/{id}/layers/depth"), 201)
            .body("image/png", self.picture.clone());
        assert_eq!(layer.exchange(server).0, 201);
        id
    }

    fn open(&self, server: SocketAddr, warp: &[u8]) -> String {
        let request = Request::new("POST", "/sessions", 201)
            .form(&[("image", &self.picture), ("warp", warp)]);
        let (status, read) = request.exchange(server);
        let text = String::from_utf8_lossy(&read);
        assert_eq!(status, 201, "{text}");
        let (_, body) = text.split_once("\r\n\r\n").unwrap();
        serde_json::from_str::<Value>(body).unwrap()["id"]
            .as_str()
            .unwrap()
            .to_owned()
    }

    /// A small picture in a file of the largest size.
    fn large_picture(&self) -> Vec<u8> {
        let mut file = self.picture.clone();
        file.resize(self.sizes.body - 1000, 7);
        file
    }

    fn rest(&self) -> Value {
        json!({"p": points(self.sizes.handles, 0.0), "grid": {"columns": 4, "rows": 4}})
    }

    /// A whole warp object, with more fields.
    fn warp(&self, more: &Value) -> Value {
        let mut object = self.rest();
        object["q"] = points(self.sizes.handles, 0.1);
        for (name, value) in more.as_object().unwrap() {
            object[name] = value.clone();
        }
        object
    }

    /// Requests of every operation of the document.
    pub(crate) fn requests(&self) -> Vec<Request> {
        let document: Value =
            serde_json::from_str(include_str!("../../../api/openapi.json")).unwrap();
        let paths = document["paths"].as_object().unwrap();
        let operations = paths
            .values()
            .flat_map(|path| path.as_object().unwrap().values());
        let names: Vec<&str> = operations
            .filter_map(|operation| operation["operationId"].as_str())
            .collect();
        assert!(names.len() > 20, "{names:?}");
        let of_operation = |name: &&str| {
            let requests = self.of_operation(name);
            let named = requests.into_iter().map(|request| Request {
                what: format!("{name} {}", request.what),
                ..request
            });
            named.collect::<Vec<_>>()
        };
        let requests: Vec<_> = names.iter().flat_map(of_operation).collect();
        let heads: Vec<_> = requests.iter().filter_map(Request::as_head).collect();
        requests.into_iter().chain(heads).collect()
    }

    fn of_operation(&self, name: &str) -> Vec<Request> {
        let (many, few) = (
            format!("/sessions/{}", self.many),
            format!("/sessions/{}", self.few),
        );
        let posed = json!({"q": points(self.sizes.handles, 0.1), "strength": 0.5});
        let drag = json!({"q": points(self.sizes.handles, 0.1)});
        let two = json!({"q": [[21, 20], [90, 60]]});
        let extent = json!({"extent": [EXTENT.0, EXTENT.1]});
        match name {
            "warp" => self.uploads("POST", "/warp", 200, &self.warp(&json!({}))),
            "createSession" => self.uploads("POST", "/sessions", 201, &self.rest()),
            "putSession" => {
                let path = "/sessions/0f8fad5b-d9cb-469f-a165-70867728950e";
                let known = self
                    .uploads("PUT", &many, 200, &self.rest())
                    .swap_remove(0)
                    .called("known");
                self.uploads("PUT", path, 200, &self.rest())
                    .into_iter()
                    .chain([known])
                    .collect()
            }
            "getSession" => vec![Request::new("GET", many, 200)],
            "deleteSession" => vec![Request::new("DELETE", format!("/sessions/{NEW}"), 204)],
            "putHandles" => vec![
                Request::new("PUT", format!("{many}/handles"), 200).json(self.rest()),
                Request::new("PUT", format!("{many}/handles"), 413)
                    .called("over")
                    .json(self.over("p", "[0,0]", "")),
            ],
            "putLayer" => vec![
                Request::new("PUT", format!("{few}/layers/large"), 200)
                    .called("known")
                    .body("image/png", self.large_picture()),
                Request::new("PUT", format!("{few}/layers/labels?kind=labels"), 200)
                    .called("labels")
                    .body("image/png", self.labels()),
            ],
            "getLayer" => vec![Request::new("GET", format!("{few}/layers/large"), 200)],
            "deleteLayer" => vec![Request::new(
                "DELETE",
                format!("/sessions/{NEW}/layers/depth"),
                204,
            )],
            "warpSession" => vec![
                Request::new("POST", format!("{many}/warp"), 200).json(&drag),
                Request::new("POST", format!("{many}/warp"), 200)
                    .called("strength")
                    .json(&posed),
                Request::new("POST", format!("{many}/warp"), 422)
                    .called("over")
                    .json(self.over_drag()),
                Request::new("POST", format!("{few}/warp"), 200)
                    .called("picture")
                    .json(of(&two, &self.output(1000))),
            ],
            "poseMesh" => vec![
                Request::new("POST", format!("{many}/mesh"), 200).json(&drag),
                Request::new("POST", format!("{many}/mesh"), 422)
                    .called("over")
                    .json(self.over_drag()),
                Request::new("POST", format!("{few}/mesh"), 200)
                    .called("fine")
                    .json(&two),
            ],
            "openDragSocket" => vec![self.socket(&many)],
            "getPlan" => vec![
                Request::new("GET", format!("{many}/plan?columns=20&rows=20"), 200),
                Request::new("GET", format!("{many}/plan?columns=2&rows=2"), 304)
                    .called("known")
                    .header("if-none-match", &self.etag),
            ],
            "readLandmarks" => self.landmarks(),
            "mapPoints" => vec![
                Request::new("POST", "/points", 200).json(of(
                    &self.warp(&extent),
                    &json!({"points": points(100, 0.0)}),
                )),
                Request::new("POST", "/points", 200)
                    .called("geojson")
                    .json(self.geojson(&self.warp(&extent))),
                Request::new("POST", "/points", 422)
                    .called("over")
                    .json(self.over("p", "null", "\"extent\": [200, 150]")),
            ],
            "mapSessionPoints" => vec![
                Request::new("POST", format!("{many}/points"), 200).json(self.geojson(&drag)),
                Request::new("POST", format!("{few}/points"), 422)
                    .called("over")
                    .json(self.over("q", "[0,0]", "")),
            ],
            "report" => vec![
                Request::new("POST", "/report", 200).json(self.warp(&extent)),
                Request::new("POST", "/report", 422)
                    .called("over")
                    .json(self.over("names", "\"\"", "\"p\": [[1, 1]], \"extent\": [9, 9]")),
            ],
            "sessionReport" => vec![
                Request::new("POST", format!("{many}/report"), 200).json(&posed),
                Request::new("POST", format!("{many}/report"), 422)
                    .called("over")
                    .json(self.over_drag()),
            ],
            "coordinateMap" => vec![
                Request::new("POST", "/map", 200).json(self.warp(&extent)),
                Request::new("POST", "/map", 422)
                    .called("over")
                    .json(self.over("weights", "1", "\"p\": [[1, 1]], \"extent\": [9, 9]")),
            ],
            "sessionMap" => vec![
                Request::new("POST", format!("{many}/map"), 200).json(&posed),
                Request::new("POST", format!("{few}/map"), 422)
                    .called("over")
                    .json(self.over("q", "[0,0]", "")),
            ],
            "fit" => vec![
                Request::new("POST", "/fit", 413).json(of(
                    &json!({"p": points(self.sizes.handles, 0.0)}),
                    &of(&drag, &extent),
                )),
                Request::new("POST", "/fit", 413)
                    .called("over")
                    .json(self.over_fit()),
            ],
            // The server of these requests has no keys, for which tokens stand.
            "mintToken" => vec![Request::new("POST", format!("{many}/tokens"), 403).json("{}")],
            "blend" => self.blends(&many),
            "fitSession" => vec![
                Request::new("POST", format!("{many}/fit"), 413).json(&drag),
                Request::new("POST", format!("{few}/fit"), 422)
                    .called("over")
                    .json(self.over("q", "[0,0]", "")),
            ],
            "batchSession" => self.batches(&many, &few),
            "getHealth" => vec![Request::new("GET", "/healthz", 200)],
            "getReadiness" => vec![Request::new("GET", "/readyz", 200)],
            "getMetrics" => vec![Request::new("GET", "/metrics", 200)],
            "getOpenapi" => vec![Request::new("GET", "/openapi.json", 200)],
            "getDocs" => vec![Request::new("GET", "/docs", 200)],
            "getProblem" => vec![Request::new("GET", "/problems/too_large", 200)],
            _ => panic!("{name} has no largest request: add one to tests/it/support/largest.rs"),
        }
    }

    fn uploads(&self, method: &str, path: &str, status: u16, warp: &Value) -> Vec<Request> {
        let few = br#"{"p": [[1, 1]], "q": [[2, 2]]}"#;
        let over = self.over("p", "[0,0]", "\"q\": [[0, 0]]");
        let request = |status| Request::new(method, path, status);
        vec![
            request(status).form(&[
                ("image", &self.picture),
                ("warp", warp.to_string().as_bytes()),
            ]),
            request(status)
                .called("file")
                .form(&[("image", &self.large_picture()), ("warp", few)]),
            request(413)
                .called("over")
                .form(&[("image", &self.picture), ("warp", over.as_bytes())]),
        ]
    }

    /// A warp object of the largest size, mostly one list.
    fn over(&self, name: &str, item: &str, more: &str) -> String {
        let comma = if more.is_empty() { "" } else { ", " };
        format!(
            "{{{more}{comma}\"{name}\": {}}}",
            list(item, self.sizes.json)
        )
    }

    /// More handles than the session has, in a body of the largest size of a drag.
    fn over_drag(&self) -> String {
        format!(
            "{{\"q\": {}}}",
            list("[0,0]", (64 << 10) + 64 * self.sizes.handles as usize)
        )
    }

    fn over_fit(&self) -> String {
        let half = list("[0,0]", self.sizes.json / 2);
        format!("{{\"extent\": [9, 9], \"p\": {half}, \"q\": {half}}}")
    }

    /// A feature with a member of the largest size.
    fn geojson(&self, object: &Value) -> String {
        let text = object.to_string();
        let geometry = r#"{"type": "Point", "coordinates": [1, 1]}"#;
        let member = list("0", self.sizes.body - text.len());
        let feature = format!(
            r#"{{"type": "Feature", "geometry": {geometry}, "properties": {{}}, "x": {member}}}"#
        );
        format!(
            "{}, \"geojson\": {feature}}}",
            text.strip_suffix('}').unwrap()
        )
    }

    fn output(&self, width: u32) -> Value {
        json!({"output": {"width": width, "compression": "none"}})
    }

    fn labels(&self) -> Vec<u8> {
        let samples: Vec<u8> = (0..EXTENT.0 * EXTENT.1)
            .map(|k| u8::try_from(k % 200).unwrap())
            .collect();
        super::picture::png(EXTENT.0, EXTENT.1, png::ColorType::Grayscale, &samples)
    }

    fn landmarks(&self) -> Vec<Request> {
        let row = |k: u32| format!("{}.5,{}.25,{}.5,{}.5\n", k % 100, k / 100, k % 100, k / 100);
        let csv: String = (0..self.sizes.handles).map(row).collect();
        let unused = "0,0,0,0,0\r".repeat(self.sizes.body / 10 - 100);
        let unused = format!("mapX,mapY,sourceX,sourceY,enable\r{unused}1,1,1,1,1\r");
        vec![
            Request::new("POST", "/landmarks", 200).body("text/csv", csv),
            Request::new("POST", "/landmarks?extent_p=9,9", 413)
                .called("unused")
                .body("text/csv", unused),
        ]
    }

    fn blends(&self, many: &str) -> Vec<Request> {
        let session = many.rsplit('/').next().unwrap();
        let image = json!({"session": session});
        let images: Vec<&Value> = std::iter::repeat_n(&image, 20).collect();
        let small = json!({"width": 64, "compression": "none"});
        let pairs = format!(
            "\"images\": [{{\"image\": 0, \"mirror\": true, \"pairs\": {}}}]",
            list("0", self.sizes.json - 100)
        );
        vec![
            Request::new("POST", "/blend", 200).json(json!({"images": images, "output": small})),
            Request::new("POST", "/blend", 422)
                .called("over")
                .json(format!("{{{pairs}}}")),
        ]
    }

    fn batches(&self, many: &str, few: &str) -> Vec<Request> {
        let batch = |of: &str| Request::new("POST", format!("{of}/batch"), 200);
        let two = json!({"q": [[21, 20], [90, 60]], "steps": 3});
        let frames: Value = (0..1000_u32)
            .map(|k| json!({"q": [[21 + k % 9, 20]]}))
            .collect();
        let least = format!("/sessions/{}", self.least);
        let small = json!({"output": {"width": 16}});
        vec![
            batch(many).json(of(
                &json!({"q": points(self.sizes.handles, 0.1), "steps": 4}),
                &small,
            )),
            batch(few)
                .called("geojson")
                .json(self.geojson(&json!({"q": [[21, 20], [90, 60]], "steps": 2}))),
            batch(&least)
                .called("frames")
                .json(json!({"frames": frames, "output": {"width": 1}})),
            batch(few)
                .called("pictures")
                .json(of(&two, &self.output(400))),
            batch(few)
                .called("animation")
                .header("accept", "image/apng")
                .json(of(&two, &self.output(400))),
        ]
    }

    fn socket(&self, session: &str) -> Request {
        let handshake = "connection: upgrade\r\nupgrade: websocket\r\nsec-websocket-version: 13\r\n\
                         sec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
        let text = json!({"seq": 1, "q": points(self.sizes.handles, 0.1)}).to_string();
        // A whole text message with a mask that changes nothing.
        let mut message = vec![0x81, 0xff];
        message.extend_from_slice(&(text.len() as u64).to_be_bytes());
        message.extend_from_slice(&[0; 4]);
        message.extend_from_slice(text.as_bytes());
        Request {
            head: handshake.to_owned(),
            message,
            ..Request::new("GET", format!("{session}/drag?frames=png"), 101)
        }
    }
}

/// An object with the fields of two.
fn of(object: &Value, more: &Value) -> Value {
    let mut all = object.clone();
    for (name, value) in more.as_object().unwrap() {
        all[name] = value.clone();
    }
    all
}
