//! `GET /sessions/{id}/drag`: the drag socket. Errors of the request are answered before the upgrade; afterwards a task carries messages
//! between the connection and the drag.

pub(crate) mod handshake;
pub(crate) mod websocket;

use std::pin::pin;
use std::time::Instant;

use axum::extract::{Path, Request};
use axum::response::{IntoResponse as _, Response};
use bytes::Bytes;
use hyper_util::rt::TokioIo;
use mlswarp::codec::Format;
use tokio_tungstenite::tungstenite::protocol::frame::coding::CloseCode;

use super::connection::transport::{Transport, without_write_timeout};
use super::headers::{bad_query_value, query_bool, query_fields};
use super::middleware::authentication::Caller;
use super::routes::sessions::session_id;
use super::routes::warp::drag_limit;
use crate::app::App;
use crate::app::drag_socket::{Drag, DragOptions, Form, MAX_WINDOW, Outgoing, PreviewWidth, Window};
use crate::app::warp::columns;
use crate::auth::keys::Credential;
use crate::config::Config;
use crate::limits::bucket::Bucket;
use crate::observe::Scope;
use crate::problem::{Code, Problem};
use websocket::{Ending, Event, WebSocketConnection};

/// Messages per second that a client may send, and in one burst: enough for a pointer at 1000 Hz.
const MESSAGES: (f64, f64) = (1000.0, 2000.0);

/// Opens the socket.
pub(crate) async fn drag(Caller { app, client }: Caller, Path(id): Path<String>, mut request: Request) -> Result<Response, Response> {
    let response = handshake::accept(&request, &app.config().auth.cors_origin)?;
    let options = options(request.uri().query(), app.config().limits().image.max_side).map_err(Problem::into_response)?;
    let id = session_id(client, &id).map_err(Problem::into_response)?;
    let drag = app.open_drag(client, id, options).await.map_err(Problem::into_response)?;
    let credential = request.extensions().get::<Credential>().copied().unwrap_or(Credential::ANYBODY);
    let upgrade = hyper::upgrade::on(&mut request);
    // Log lines of the socket have the id of the handshake.
    tokio::spawn(Scope::current().answered().wrap(async move {
        // If the client has left already, the drag ends here.
        let Ok(upgraded) = upgrade.await else { return };
        match upgraded.downcast::<TokioIo<Transport>>() {
            Ok(parts) => {
                let max_message = usize::try_from(drag_limit(columns(drag.record()))).unwrap_or(usize::MAX);
                let transport = without_write_timeout(parts.io.into_inner());
                run(&app, credential, drag, WebSocketConnection::new(transport, parts.read_buf, max_message).await).await;
            }
            Err(_) => tracing::error!("an upgraded connection has an unknown type"),
        }
    }));
    Ok(response)
}

/// Accepted tolerances of compact meshes, px.
const TOLERANCES: std::ops::RangeInclusive<f64> = 0.1..=16.0;
/// The tolerance if the query has none, px.
const TOLERANCE: f64 = 0.5;

/// Reads `?frames=auto|png|jpeg|webp|tiff|mesh&mesh=f32|compact&tolerance=PX&width=auto|N&window=auto|N&report=true|false`. Unknown fields
/// are rejected.
fn options(query: Option<&str>, max_side: u32) -> Result<DragOptions, Problem> {
    let mut options = DragOptions { form: Form::Picture(None), width: PreviewWidth::Auto, report: false, window: Window::Auto };
    let [frames, mesh, tolerance, width, window, report] =
        query_fields(query, ["frames", "mesh", "tolerance", "width", "window", "report"])?;
    if let Some(value) = frames.or(mesh.and(Some("mesh"))) {
        options.form = form(value)?;
    }
    if let Some(value) = mesh {
        options.form = match (options.form, value) {
            (Form::Mesh, "f32") => Form::Mesh,
            (Form::Mesh, "compact") => Form::CompactMesh(TOLERANCE),
            (Form::Mesh, _) => return Err(bad_query_value("mesh", value, "`f32` or `compact`")),
            _ => {
                return Err(Problem::new(
                    Code::BadValue,
                    "`mesh` in the query needs meshes as frames: send `frames=mesh`, or remove `mesh`",
                ));
            }
        };
    }
    if let Some(value) = tolerance {
        let Form::CompactMesh(tolerance) = &mut options.form else {
            return Err(Problem::new(
                Code::BadValue,
                "`tolerance` in the query needs compact meshes: add `mesh=compact`, or remove `tolerance`",
            ));
        };
        let read = value.parse().ok().filter(|px| TOLERANCES.contains(px));
        let expected = || format!("a number of px, {} to {}", TOLERANCES.start(), TOLERANCES.end());
        *tolerance = read.ok_or_else(|| bad_query_value("tolerance", value, &expected()))?;
    }
    if let Some(value) = width.filter(|value| *value != "auto") {
        let width = value.parse().ok().filter(|width| (1..=max_side).contains(width));
        let expected = || format!("`auto` or a whole number of 1 to {max_side}");
        options.width = PreviewWidth::Fixed(width.ok_or_else(|| bad_query_value("width", value, &expected()))?);
    }
    if let Some(value) = window.filter(|value| *value != "auto") {
        let window = value.parse().ok().filter(|window| (1..=MAX_WINDOW).contains(window));
        let expected = || format!("`auto` or a whole number of 1 to {MAX_WINDOW}");
        options.window = Window::Fixed(window.ok_or_else(|| bad_query_value("window", value, &expected()))?);
    }
    if let Some(value) = report {
        options.report = query_bool("report", value)?;
    }
    if options.form.is_mesh() && options.width != PreviewWidth::Auto {
        return Err(Problem::new(Code::BadValue, "a mesh has no width: remove `width` from the query"));
    }
    Ok(options)
}

fn form(name: &str) -> Result<Form, Problem> {
    const FORMS: &str = "`auto`, `png`, `jpeg`, `webp`, `tiff`, `mesh`";
    match name {
        "mesh" => Ok(Form::Mesh),
        "auto" => Ok(Form::Auto),
        _ => {
            let format = Format::ALL.into_iter().find(|format| format.media_type().strip_prefix("image/") == Some(name));
            format.map(|format| Form::Picture(Some(format))).ok_or_else(|| bad_query_value("frames", name, &format!("one of {FORMS}")))
        }
    }
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
    tracing::info!(target: "mlswarp::http", code, reason, seconds = format_args!("{seconds:.1}"), "drag ended");
    // Cancels the frame; the socket's slot is kept until the connection is closed.
    drag.stop();
    socket.close(ending).await;
}

async fn exchange(app: &App, credential: Credential, drag: &mut Drag, socket: &mut WebSocketConnection) -> Ending {
    let mut heard = Instant::now();
    let mut pinged = None;
    let mut bucket = Bucket::new(MESSAGES.0, MESSAGES.1, heard);
    let (mut stopping, mut revoked) = (pin!(app.stopping()), pin!(app.access().revoked(credential)));
    loop {
        let due = drag.act(Instant::now());
        while let Some(outgoing) = drag.next_outgoing() {
            match outgoing {
                Outgoing::Text(text) => socket.send_text(text),
                Outgoing::Frame(seq, pieces) => socket.send_binary(Bytes::copy_from_slice(&seq.to_le_bytes()), pieces),
            }
        }
        if drag.is_over() {
            return Ending::Close(CloseCode::Normal, "the session has ended");
        }
        let (deadline, _) = next_deadline(heard, pinged, drag, socket, app.config());
        let wake = due.map_or(deadline, |due| due.min(deadline));
        tokio::select! {
            event = socket.next() => {
                (heard, pinged) = (Instant::now(), None);
                if !matches!(event, Event::Ended(_)) && !bucket.take(heard) {
                    return Ending::Close(CloseCode::Policy, "too many messages a second");
                }
                match event {
                    Event::Text(text) => drag.on_text(text.as_bytes(), heard),
                    Event::Binary(bytes) => drag.on_binary(&bytes, heard),
                    Event::Ping => {}
                    Event::Ended(ending) => return ending,
                }
            }
            () = drag.work() => {}
            () = &mut stopping => return Ending::Close(CloseCode::Restart, "the service is stopping"),
            () = &mut revoked => {
                let detail = "the key of this socket was revoked";
                drag.send_problem(None, &Problem::new(Code::Forbidden, detail));
                while let Some(outgoing) = drag.next_outgoing() {
                    if let Outgoing::Text(text) = outgoing {
                        socket.send_before_close(text);
                    }
                }
                return Ending::Close(CloseCode::Policy, "the key was revoked");
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

/// What to do when a deadline has passed.
#[derive(Clone, Copy, Debug)]
enum Action {
    Ping,
    Close(&'static str),
}

/// The next deadline of a client: to read what it is sent, to acknowledge a frame, to send something or to answer a ping.
fn next_deadline(heard: Instant, pinged: Option<Instant>, drag: &Drag, socket: &WebSocketConnection, config: &Config) -> (Instant, Action) {
    if let Some(since) = socket.blocked_since() {
        return (since + config.timeouts.socket, Action::Close("the client reads nothing"));
    }
    let written = socket.last_written();
    let silence = match pinged {
        // A client that reads is connected, and receives a ping only after what is queued.
        None => (heard.max(written) + config.timeouts.socket_idle, Action::Ping),
        Some(pinged) => (pinged.max(written) + config.timeouts.socket_idle, Action::Close("no answer to a ping")),
    };
    match drag.owed_since().filter(|_| socket.is_idle()).map(|since| since.max(written) + config.timeouts.socket) {
        Some(owed) if owed < silence.0 => (owed, Action::Close("a frame was not acknowledged in time")),
        _ => silence,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_query_says_what_frames_are() {
        let read = |query: &str| options(Some(query), 16384);
        let usual = DragOptions { form: Form::Picture(None), width: PreviewWidth::Auto, report: false, window: Window::Auto };
        assert_eq!(options(None, 16384), Ok(usual));
        assert_eq!(read("width=auto&report=false&window=auto"), Ok(usual));
        assert_eq!(read("window=8"), Ok(DragOptions { window: Window::Fixed(8), ..usual }));
        assert_eq!(read("width=1024&report=true"), Ok(DragOptions { width: PreviewWidth::Fixed(1024), report: true, ..usual }));
        assert_eq!(read("frames=auto"), Ok(DragOptions { form: Form::Auto, ..usual }));
        for (query, form) in [
            ("frames=mesh", Form::Mesh),
            ("mesh=f32", Form::Mesh),
            ("frames=mesh&mesh=f32", Form::Mesh),
            ("mesh=compact", Form::CompactMesh(0.5)),
            ("frames=mesh&mesh=compact&tolerance=2", Form::CompactMesh(2.0)),
            ("tolerance=0.1&frames=mesh&mesh=compact", Form::CompactMesh(0.1)),
            ("mesh=compact&tolerance=1.6e1", Form::CompactMesh(16.0)),
        ] {
            assert_eq!(read(query), Ok(DragOptions { form, ..usual }), "{query}");
        }
        for (name, format) in [("png", Format::Png), ("jpeg", Format::Jpeg), ("webp", Format::WebP), ("tiff", Format::Tiff)] {
            assert_eq!(read(&format!("frames={name}")), Ok(DragOptions { form: Form::Picture(Some(format)), ..usual }));
        }
        for (query, code) in [
            ("frames=gif", Code::BadValue),
            ("frames", Code::BadValue),
            ("width=0", Code::BadValue),
            ("width=16385", Code::BadValue),
            ("width=-1", Code::BadValue),
            ("frames=mesh&width=100", Code::BadValue),
            ("mesh=compact&width=100", Code::BadValue),
            ("frames=png&mesh=compact", Code::BadValue),
            ("frames=auto&mesh=f32", Code::BadValue),
            ("mesh=f16", Code::BadValue),
            ("frames=mesh&mesh", Code::BadValue),
            ("tolerance=1", Code::BadValue),
            ("frames=mesh&tolerance=1", Code::BadValue),
            ("mesh=f32&tolerance=1", Code::BadValue),
            ("mesh=compact&tolerance=0.09", Code::BadValue),
            ("mesh=compact&tolerance=16.1", Code::BadValue),
            ("mesh=compact&tolerance=NaN", Code::BadValue),
            ("mesh=compact&tolerance=inf", Code::BadValue),
            ("mesh=compact&tolerance=-1", Code::BadValue),
            ("mesh=compact&tolerance=", Code::BadValue),
            ("report=yes", Code::BadValue),
            ("window=0", Code::BadValue),
            ("window=9", Code::BadValue),
            ("window=-1", Code::BadValue),
            ("window=1.5", Code::BadValue),
            ("window", Code::BadValue),
            ("window=1&window=1", Code::MalformedRequest),
            ("report=true&report=false", Code::MalformedRequest),
            ("q=1", Code::UnknownField),
            ("Frames=png", Code::UnknownField),
        ] {
            assert_eq!(read(query).unwrap_err().code, code, "{query}");
        }
    }
}
