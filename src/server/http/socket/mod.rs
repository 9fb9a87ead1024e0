//! `GET /sessions/{id}/drag`: the drag socket. Errors of the request are answered before the
//! upgrade; afterwards a task carries messages between the connection and the drag.

pub(crate) mod handshake;
mod query;
pub(crate) mod websocket;

use std::pin::pin;
use std::time::Instant;

use axum::extract::{Path, Request};
use axum::response::{IntoResponse as _, Response};
use bytes::Bytes;
use hyper_util::rt::TokioIo;
use tokio_tungstenite::tungstenite::protocol::frame::coding::CloseCode;

use super::connection::transport::{Transport, without_write_timeout};
use super::connection::turns::RequestTurns;
use super::middleware::authentication::Caller;
use super::routes::sessions::session_id;
use super::routes::warp::drag_limit;
use crate::app::App;
use crate::app::drag_socket::{self, Drag, Outgoing};
use crate::app::parts::plans::columns;
use crate::auth::keys::Credential;
use crate::config::Config;
use crate::http::response::Refusal;
use crate::limits::bucket::Bucket;
use crate::observe::Scope;
use crate::problem::{Code, Problem};
use websocket::{Ending, Event, WebSocketConnection};

/// Messages per second that a client may send, and in one burst: enough for a pointer at 1000 Hz.
const MESSAGE_RATE_AND_BURST: (f64, f64) = (1000.0, 2000.0);

/// Opens the socket.
pub(crate) async fn drag_socket(
    Caller { app, client }: Caller,
    Path(id): Path<String>,
    mut request: Request,
) -> Result<Response, Response> {
    let response = handshake::accept(&request, &app.config().auth.cors_origin)?;
    let options = query::options(request.uri().query(), app.config().limits().image.max_side)
        .map_err(|problem| Refusal(problem).into_response())?;
    let id = session_id(client, &id).map_err(|problem| Refusal(problem).into_response())?;
    let drag = drag_socket::open(&app, client, id, options)
        .await
        .map_err(|problem| Refusal(problem).into_response())?;
    let credential = request
        .extensions()
        .get::<Credential>()
        .copied()
        .unwrap_or(Credential::ANYBODY);
    let turns = request
        .extensions()
        .get::<RequestTurns>()
        .map(|turns| turns.turns.of(client.address))
        .unwrap_or_default();
    let upgrade = hyper::upgrade::on(&mut request);
    // Log lines of the socket have the id of the handshake.
    tokio::spawn(turns.take(Scope::current().answered().wrap(async move {
        // If the client has left already, the drag ends here.
        let Ok(upgraded) = upgrade.await else { return };
        match upgraded.downcast::<TokioIo<Transport>>() {
            Ok(parts) => {
                let max_message =
                    usize::try_from(drag_limit(columns(drag.record()))).unwrap_or(usize::MAX);
                let transport = without_write_timeout(parts.io.into_inner());
                run(
                    &app,
                    credential,
                    drag,
                    WebSocketConnection::new(transport, parts.read_buf, max_message).await,
                )
                .await;
            }
            Err(_) => tracing::error!("an upgraded connection has an unknown type"),
        }
    })));
    Ok(response)
}

/// Carries messages until either side ends the socket.
async fn run(app: &App, credential: Credential, mut drag: Drag, mut socket: WebSocketConnection) {
    let began = Instant::now();
    let ending = exchange(app, credential, &mut drag, &mut socket).await;
    let (code, reason) = match &ending {
        Ending::Disconnected => (0, "the client left"),
        Ending::Close(code, reason) => (u16::from(*code), *reason),
    };
    let seconds = began.elapsed().as_secs_f64();
    tracing::info!(target: "mlswarp::http", code, reason, seconds = format_args!("{seconds:.1}"),
        "drag ended");
    // Cancels the frame; the socket's slot is kept until the connection is closed.
    drag.stop();
    socket.close(ending).await;
}

async fn exchange(
    app: &App,
    credential: Credential,
    drag: &mut Drag,
    socket: &mut WebSocketConnection,
) -> Ending {
    let mut heard = Instant::now();
    let mut pinged = None;
    let mut bucket = Bucket::new(MESSAGE_RATE_AND_BURST.0, MESSAGE_RATE_AND_BURST.1, heard);
    let access = app.access();
    let (mut stopping, mut revoked, mut expired) = (
        pin!(app.lifecycle.stopping()),
        pin!(access.revoked(credential)),
        pin!(access.expired(credential)),
    );
    loop {
        let due = drag.act(Instant::now());
        while let Some(outgoing) = drag.next_outgoing() {
            match outgoing {
                Outgoing::Text(text) => socket.send_text(text),
                Outgoing::Frame(seq, pieces) => {
                    socket.send_binary(Bytes::copy_from_slice(&seq.to_le_bytes()), pieces)
                }
            }
        }
        if drag.is_over() {
            return Ending::Close(CloseCode::Normal, "the session has ended");
        }
        let (deadline, _) = next_deadline(heard, pinged, drag, socket, app.config());
        let wake = due.map_or(deadline, |due| due.min(deadline));
        tokio::select! {
            event = socket.next(!drag.is_reading()) => {
                (heard, pinged) = (Instant::now(), None);
                if !matches!(event, Event::Ended(_)) && !bucket.take(heard) {
                    return Ending::Close(CloseCode::Policy, "too many messages a second");
                }
                match event {
                    Event::Text(text) => drag.on_text(text.into(), heard),
                    Event::Binary(bytes) => drag.on_binary(&bytes, heard),
                    Event::Ping => {}
                    Event::Ended(ending) => return ending,
                }
            }
            () = drag.work() => {}
            () = &mut stopping => return Ending::Close(CloseCode::Restart,
                "the service is stopping"),
            () = &mut revoked => {
                let detail = "the key of this socket was revoked";
                return refused(drag, socket, Code::Forbidden, detail, "the key was revoked");
            }
            () = &mut expired => {
                let detail = "the session token of this socket has expired: open another socket \
                    with a new one";
                let code = Code::TokenExpired;
                return refused(drag, socket, code, detail, code.as_str());
            }
            () = tokio::time::sleep_until(wake.into()) => {
                let now = Instant::now();
                // What was written meanwhile has moved the deadline.
                match next_deadline(heard, pinged, drag, socket, app.config()) {
                    (deadline, _) if now < deadline => {}
                    (_, Action::Ping) => {
                        socket.send_ping();
                        pinged = Some(now);
                        drag.check_session().await;
                    }
                    (_, Action::Close(reason)) => return Ending::Close(CloseCode::Policy, reason),
                }
            }
        }
    }
}

/// The end of a socket whose client may no longer use it; a problem is the last message.
fn refused(
    drag: &mut Drag,
    socket: &mut WebSocketConnection,
    code: Code,
    detail: &str,
    reason: &'static str,
) -> Ending {
    drag.send_problem(None, &Problem::new(code, detail));
    while let Some(outgoing) = drag.next_outgoing() {
        if let Outgoing::Text(text) = outgoing {
            socket.send_before_close(text);
        }
    }
    Ending::Close(CloseCode::Policy, reason)
}

/// What to do when a deadline has passed.
#[derive(Clone, Copy, Debug)]
enum Action {
    Ping,
    Close(&'static str),
}

/// The next deadline of a client: to read what it is sent, to acknowledge a frame, to send
/// something or to answer a ping.
fn next_deadline(
    heard: Instant,
    pinged: Option<Instant>,
    drag: &Drag,
    socket: &WebSocketConnection,
    config: &Config,
) -> (Instant, Action) {
    if let Some(since) = socket.blocked_since() {
        return (
            since + config.timeouts.socket,
            Action::Close("the client reads nothing"),
        );
    }
    let written = socket.last_written();
    let silence = match pinged {
        // A client that reads is connected, and receives a ping only after what is queued.
        None => (
            heard.max(written) + config.timeouts.socket_idle,
            Action::Ping,
        ),
        Some(pinged) => (
            pinged.max(written) + config.timeouts.socket_idle,
            Action::Close("no answer to a ping"),
        ),
    };
    match drag
        .owed_since()
        .filter(|_| socket.is_idle())
        .map(|since| since.max(written) + config.timeouts.socket)
    {
        Some(owed) if owed < silence.0 => {
            (owed, Action::Close("a frame was not acknowledged in time"))
        }
        _ => silence,
    }
}
