//! A client of the drag socket.

use std::net::SocketAddr;
use std::time::Duration;

use futures_util::{SinkExt as _, StreamExt as _};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{WebSocketStream, client_async_with_config};

/// Longer than anything that must come takes.
const PATIENCE: Duration = Duration::from_secs(60);

/// A message of the server.
#[derive(Debug)]
pub(crate) enum Received {
    Text(Value),
    Frame(u64, Vec<u8>),
    Closed(u16),
}

/// A drag socket after the first message of the server.
pub(crate) struct DragClient {
    pub(crate) socket: WebSocketStream<TcpStream>,
    pub(crate) hello: Value,
}

impl DragClient {
    pub(crate) async fn open(address: SocketAddr, session: &str, query: &str) -> Self {
        Self::over(TcpStream::connect(address).await.unwrap(), session, query).await
    }

    pub(crate) async fn over(stream: TcpStream, session: &str, query: &str) -> Self {
        stream.set_nodelay(true).unwrap();
        let url = format!(
            "ws://{}/sessions/{session}/drag{query}",
            stream.peer_addr().unwrap()
        );
        // Frames may be larger than the crate expects.
        let config = WebSocketConfig::default()
            .max_message_size(None)
            .max_frame_size(None);
        let (socket, response) = client_async_with_config(url, stream, Some(config))
            .await
            .unwrap();
        assert_eq!(response.status(), 101);
        let mut client = Self {
            socket,
            hello: Value::Null,
        };
        match client.next().await {
            Received::Text(hello) => client.hello = hello,
            other => panic!("a hello was expected: {other:?}"),
        }
        client
    }

    pub(crate) async fn say(&mut self, message: &Value) {
        self.socket
            .send(Message::text(message.to_string()))
            .await
            .unwrap();
    }

    /// A text message as it stands.
    pub(crate) async fn socket_text(&mut self, text: &str) {
        self.socket.send(Message::text(text)).await.unwrap();
    }

    pub(crate) async fn socket_binary(&mut self, bytes: Vec<u8>) {
        self.socket.send(Message::binary(bytes)).await.unwrap();
    }

    pub(crate) async fn pose(&mut self, seq: u64, q: &Value) {
        self.say(&json!({"seq": seq, "q": q})).await;
    }

    pub(crate) async fn ack(&mut self, seq: u64) {
        self.say(&json!({"ack": seq})).await;
    }

    /// The next thing that the server says, within a long time.
    pub(crate) async fn next(&mut self) -> Received {
        self.next_within(PATIENCE)
            .await
            .expect("the server says something")
    }

    /// The next thing that the server says, if it says one in time.
    pub(crate) async fn next_within(&mut self, time: Duration) -> Option<Received> {
        tokio::time::timeout(time, async {
            loop {
                match self.socket.next().await {
                    Some(Ok(Message::Text(text))) => {
                        return Received::Text(serde_json::from_str(&text).unwrap());
                    }
                    Some(Ok(Message::Binary(frame))) => {
                        return Received::Frame(
                            u64::from_le_bytes(frame[..8].try_into().unwrap()),
                            frame[8..].to_vec(),
                        );
                    }
                    Some(Ok(Message::Close(close))) => {
                        return Received::Closed(close.map_or(0, |close| close.code.into()));
                    }
                    Some(Ok(_)) => {}
                    None
                    | Some(Err(
                        Error::Io(_)
                        | Error::Protocol(_)
                        | Error::ConnectionClosed
                        | Error::AlreadyClosed,
                    )) => {
                        return Received::Closed(0);
                    }
                    Some(Err(error)) => panic!("{error}"),
                }
            }
        })
        .await
        .ok()
    }

    /// The next frame; nothing else may come before it.
    pub(crate) async fn frame(&mut self) -> (u64, Vec<u8>) {
        match self.next().await {
            Received::Frame(seq, bytes) => (seq, bytes),
            other => panic!("a frame was expected: {other:?}"),
        }
    }

    /// The next frame must be this one; it is acknowledged.
    pub(crate) async fn ack_of_next_frame(&mut self, seq: u64) {
        assert_eq!(self.frame().await.0, seq);
        self.ack(seq).await;
    }

    pub(crate) async fn text(&mut self) -> Value {
        match self.next().await {
            Received::Text(text) => text,
            other => panic!("a text message was expected: {other:?}"),
        }
    }

    /// The problem object that must come next.
    pub(crate) async fn problem(&mut self, code: &str) -> Value {
        let problem = self.text().await;
        assert_eq!(problem["code"], code, "{problem}");
        assert_eq!(problem["type"], format!("/problems/{code}"));
        assert!(
            problem["status"].is_u64()
                && problem["title"].is_string()
                && problem["detail"].is_string(),
            "{problem}"
        );
        problem
    }

    /// Reads until the server closes; says with which code.
    pub(crate) async fn closed(&mut self) -> u16 {
        loop {
            if let Received::Closed(code) = self.next().await {
                return code;
            }
        }
    }

    /// Acknowledges every frame until that of `seq` has come at full size: nothing more comes after
    /// it. The frames.
    pub(crate) async fn show_until(&mut self, seq: u64) -> Vec<(u64, Vec<u8>)> {
        let mut frames = Vec::new();
        loop {
            let (shown, bytes) = self.frame().await;
            self.ack(shown).await;
            frames.push((shown, bytes));
            if shown == seq {
                return frames;
            }
        }
    }
}
