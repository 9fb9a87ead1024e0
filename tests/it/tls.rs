//! TLS: both versions of HTTP and the drag socket through it, a certificate that changes, mistakes
//! that name their file.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use futures_util::{SinkExt as _, StreamExt as _};
use mlswarp_server::app::sessions;
use mlswarp_server::app::upload::Upload;
use mlswarp_server::auth::tls::TlsFiles;
use mlswarp_server::client::Client;
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use tokio_rustls::rustls::pki_types::ServerName;
use tokio_tungstenite::client_async;
use tokio_tungstenite::tungstenite::Message;

use crate::support::program::{Program, mlswarp};
use crate::support::{Server, photo};

/// A directory with a new certificate and its key.
pub(crate) struct Folder(PathBuf);

impl Folder {
    pub(crate) fn new(name: &str) -> Self {
        let path =
            std::env::temp_dir().join(format!("mlswarp-test-tls-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        let folder = Self(path);
        folder.renew();
        folder
    }

    fn renew(&self) {
        let made =
            rcgen::generate_simple_self_signed(["localhost".to_owned(), "127.0.0.1".to_owned()])
                .unwrap();
        for (name, text) in [
            ("cert.pem", made.cert.pem()),
            ("key.pem", made.signing_key.serialize_pem()),
        ] {
            std::fs::write(self.0.join("new"), text).unwrap();
            std::fs::rename(self.0.join("new"), self.0.join(name)).unwrap();
        }
    }

    fn path(&self, name: &str) -> String {
        self.0.join(name).to_str().unwrap().to_owned()
    }

    pub(crate) fn files(&self) -> TlsFiles {
        TlsFiles {
            cert: self.path("cert.pem").into(),
            key: self.path("key.pem").into(),
        }
    }

    pub(crate) fn options(&self) -> [String; 4] {
        [
            "--tls-cert".to_owned(),
            self.path("cert.pem"),
            "--tls-key".to_owned(),
            self.path("key.pem"),
        ]
    }

    pub(crate) async fn server(&self, others: &[&str]) -> Server {
        let options = self.options();
        Server::start(&[&options.each_ref().map(String::as_str)[..], others].concat()).await
    }

    /// A connection to the server that has this folder's certificate.
    pub(crate) async fn connect(
        &self,
        address: SocketAddr,
        alpn: &[&[u8]],
    ) -> std::io::Result<TlsStream<TcpStream>> {
        let files = TlsFiles {
            cert: Path::new(&self.path("cert.pem")).to_owned(),
            key: PathBuf::new(),
        };
        let mut config = (*files.trusting_it_alone().unwrap()).clone();
        config.alpn_protocols = alpn.iter().map(|name| name.to_vec()).collect();
        let stream = TcpStream::connect(address).await?;
        TlsConnector::from(Arc::new(config))
            .connect(ServerName::IpAddress(address.ip().into()), stream)
            .await
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

async fn get(stream: &mut TlsStream<TcpStream>, path: &str) -> String {
    stream
        .write_all(
            format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
                .as_bytes(),
        )
        .await
        .unwrap();
    let mut answer = String::new();
    // A peer that closes without a farewell of TLS has said everything before.
    let _ = stream.read_to_string(&mut answer).await;
    answer
}

#[tokio::test]
async fn http_1_and_2_and_the_drag_socket_go_through_it() {
    let folder = Folder::new("versions");
    let server = folder.server(&[]).await;
    let mut stream = folder
        .connect(server.address, &[b"http/1.1"])
        .await
        .unwrap();
    let answer = get(&mut stream, "/healthz").await;
    assert!(
        answer.starts_with("HTTP/1.1 200")
            && answer
                .to_lowercase()
                .contains("strict-transport-security: max-age="),
        "{answer}"
    );
    // Who names no protocol is served HTTP/1.1.
    assert!(
        get(
            &mut folder.connect(server.address, &[]).await.unwrap(),
            "/healthz"
        )
        .await
        .starts_with("HTTP/1.1 200")
    );
    let mut stream = folder
        .connect(server.address, &[b"h2", b"http/1.1"])
        .await
        .unwrap();
    assert_eq!(stream.get_ref().1.alpn_protocol(), Some(&b"h2"[..]));
    stream
        .write_all(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0")
        .await
        .unwrap();
    let mut frame = [0; 9];
    stream.read_exact(&mut frame).await.unwrap();
    assert_eq!(frame[3], 4, "SETTINGS");

    let upload = Upload::new(photo(16, 12), r#"{"p": [[2, 2]]}"#);
    let (shown, _) = sessions::create(&server.app, Client::default(), upload)
        .await
        .unwrap();
    let url = format!(
        "wss://{}/sessions/{}/drag",
        server.address, shown.session.record.id
    );
    let stream = folder
        .connect(server.address, &[b"http/1.1"])
        .await
        .unwrap();
    let (mut socket, _) = client_async(url, stream).await.unwrap();
    assert!(matches!(socket.next().await, Some(Ok(Message::Text(_)))));
    socket
        .send(Message::text(json!({"seq": 7, "q": [[3, 2]]}).to_string()))
        .await
        .unwrap();
    let Some(Ok(Message::Binary(frame))) = socket.next().await else {
        panic!("a frame")
    };
    assert_eq!(frame[..8], 7_u64.to_le_bytes());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn plain_http_is_told_that_tls_is_missing() {
    let folder = Folder::new("plain");
    let server = folder.server(&[]).await;
    // Also a client that sends all of its picture before it reads.
    let picture = vec![b'x'; 20_000_000];
    let post = format!(
        "POST /warp HTTP/1.1\r\nHost: localhost\r\nContent-Length: {}\r\n\r\n",
        picture.len()
    );
    for (head, body) in [
        ("GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n", &[][..]),
        (&post, &picture),
    ] {
        let mut stream = TcpStream::connect(server.address).await.unwrap();
        stream.write_all(head.as_bytes()).await.unwrap();
        stream.write_all(body).await.unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).await.unwrap();
        assert!(
            answer.starts_with("HTTP/1.1 400 ")
                && answer.contains("content-type: application/problem+json"),
            "{answer}"
        );
        let document: Value =
            serde_json::from_str(answer.rsplit_once("\r\n\r\n").unwrap().1).unwrap();
        assert_eq!(document["code"], "malformed_request");
        assert!(
            document["detail"].as_str().unwrap().contains("https://"),
            "{document}"
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_new_certificate_needs_no_restart() {
    let folder = Folder::new("renewed");
    let server = folder.server(&[]).await;
    assert!(folder.connect(server.address, &[]).await.is_ok());
    // Half of a pair changes nothing.
    let whole = std::fs::read(folder.path("key.pem")).unwrap();
    std::fs::write(folder.path("key.pem"), "no key").unwrap();
    tokio::time::sleep(Duration::from_millis(1500)).await;
    assert!(folder.connect(server.address, &[]).await.is_ok());
    std::fs::write(folder.path("key.pem"), whole).unwrap();
    folder.renew();
    let began = Instant::now();
    while folder.connect(server.address, &[]).await.is_err() {
        assert!(
            began.elapsed() < Duration::from_secs(30),
            "the new certificate is not served"
        );
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_program_asks_itself_through_it() {
    let folder = Folder::new("health");
    let options = folder.options();
    let options: Vec<&str> = options.iter().map(String::as_str).collect();
    let program = Program::start(&options);
    let address = program.address.to_string();
    let ask = |options: &[&str]| {
        mlswarp(&[&["health", "--listen", &address], options].concat())
            .output()
            .unwrap()
    };
    let said = ask(&options);
    assert!(said.status.success(), "{said:?}");
    let told = |output: std::process::Output| {
        assert_eq!(output.status.code(), Some(1));
        String::from_utf8(output.stderr).unwrap()
    };
    let said = told(ask(&[]));
    assert!(
        said.contains(&format!(
            "the server at {address} serves HTTPS: give --tls-cert (MLSWARP_TLS_CERT) and --tls-key"
        )),
        "{said}"
    );
    // The other way round.
    let plain = Program::start(&[]);
    let listen = plain.address.to_string();
    let said = told(
        mlswarp(&[&["health", "--listen", &listen], &options[..]].concat())
            .output()
            .unwrap(),
    );
    assert!(
        said.contains(&format!(
            "the server at {listen} serves plain HTTP: leave out --tls-cert (MLSWARP_TLS_CERT)"
        )),
        "{said}"
    );
    // Another certificate than the server's own is not taken.
    let other = Folder::new("other");
    let others = other.options();
    let said = told(ask(&others.each_ref().map(String::as_str)));
    assert!(
        said.contains("does not answer GET /readyz") && !said.contains("plain HTTP"),
        "{said}"
    );
}

#[test]
fn mistakes_name_their_file() {
    let folder = Folder::new("mistakes");
    let other = Folder::new("mistakes-other");
    std::fs::write(folder.path("empty.pem"), "").unwrap();
    for (cert, key, told) in [
        (
            folder.path("none.pem"),
            folder.path("key.pem"),
            "none.pem: No such file",
        ),
        (
            folder.path("empty.pem"),
            folder.path("key.pem"),
            "empty.pem: no certificate",
        ),
        (
            folder.path("cert.pem"),
            folder.path("cert.pem"),
            "cert.pem: no private key",
        ),
        (
            folder.path("cert.pem"),
            other.path("key.pem"),
            "do not go together",
        ),
    ] {
        let ended = mlswarp(&[
            "--listen",
            "127.0.0.1:0",
            "--tls-cert",
            &cert,
            "--tls-key",
            &key,
        ])
        .output()
        .unwrap();
        let said = String::from_utf8(ended.stderr).unwrap();
        assert_eq!(ended.status.code(), Some(2), "{said}");
        assert!(
            said.contains("--tls-cert (MLSWARP_TLS_CERT)") && said.contains(told),
            "{told} in {said}"
        );
    }
}
