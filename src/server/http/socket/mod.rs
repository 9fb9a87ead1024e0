//! `GET /sessions/{id}/drag`: the drag socket. Everything that can be wrong with the request is answered before the upgrade; afterwards a task
//! of its own carries messages between the connection and the drag, under deadlines of its own.

pub(crate) mod handshake;
pub(crate) mod metered;
pub(crate) mod websocket;

use std::time::Instant;

use axum::Extension;
use axum::extract::{Path, Request, State};
use axum::response::{IntoResponse as _, Response};
use bytes::Bytes;
use hyper_util::rt::TokioIo;
use mlswarp::codec::Format;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio_tungstenite::tungstenite::protocol::frame::coding::CloseCode;

use super::connection::Transport;
use super::routes::sessions::session_id;
use super::routes::warp::drag_limit;
use crate::app::App;
use crate::app::live_drag::{Drag, DragOptions, Form, Outgoing, PreviewWidth};
use crate::app::warp::columns;
use crate::auth::keys::Credential;
use crate::client::Client;
use crate::config::Config;
use crate::limits::bucket::Bucket;
use crate::observe::Scope;
use crate::problem::{Code, Problem};
use websocket::{Ending, Heard, WebSocketConnection};

/// Messages that a client may send in a second, and at once: a hand at 1000 Hz loses nothing.
const MESSAGES: (f64, f64) = (1000.0, 2000.0);

/// Opens the socket.
pub(crate) async fn drag(
    State(app): State<App>,
    Extension(client): Extension<Client>,
    Path(id): Path<String>,
    mut request: Request,
) -> Response {
    let answer = match handshake::accept(&request, &app.config().auth.cors_origin) {
        Ok(answer) => answer,
        Err(refusal) => return refusal,
    };
    let wishes = match wishes(request.uri().query(), app.config().limits().image.max_side) {
        Ok(wishes) => wishes,
        Err(problem) => return problem.into_response(),
    };
    let drag = match open(&app, client, &id, wishes).await {
        Ok(drag) => drag,
        Err(problem) => return problem.into_response(),
    };
    let pass = request.extensions().get::<Credential>().copied().unwrap_or(Credential::ANYBODY);
    let most = usize::try_from(drag_limit(columns(drag.record()))).unwrap_or(usize::MAX);
    let upgrade = hyper::upgrade::on(&mut request);
    // What is told of the socket from now on has the handshake's id.
    let talked = Scope::current().answered().wrap(async move {
        // Whoever has left before the answer takes the drag with it.
        let Ok(upgraded) = upgrade.await else { return };
        match upgraded.downcast::<TokioIo<Transport>>() {
            Ok(parts) => {
                talk(&app, pass, drag, WebSocketConnection::new(parts.io.into_inner().without_deadline(), parts.read_buf, most).await).await
            }
            Err(upgraded) => talk(&app, pass, drag, WebSocketConnection::new(TokioIo::new(upgraded), Bytes::new(), most).await).await,
        }
    });
    tokio::spawn(talked);
    answer
}

async fn open(app: &App, client: Client, id: &str, wishes: DragOptions) -> Result<Drag, Problem> {
    app.open_drag(client, session_id(client, id)?, wishes).await
}

/// `?frames=png|jpeg|webp|mesh&width=auto|N&report=true|false`. What is not known is refused.
fn wishes(query: Option<&str>, max_side: u32) -> Result<DragOptions, Problem> {
    let bad = |name: &str, value: &str, expected: &str| {
        let value: String = value.chars().take(40).collect();
        Problem::new(Code::BadValue, format!("the query's `{name}` is {expected}: {value}"))
    };
    let mut wishes = DragOptions { form: Form::Picture(None), width: PreviewWidth::Auto, report: false };
    for pair in query.unwrap_or_default().split('&').filter(|pair| !pair.is_empty()) {
        match pair.split_once('=').unwrap_or((pair, "")) {
            ("frames", "mesh") => wishes.form = Form::Mesh,
            ("frames", value) => {
                let format = Format::ALL.into_iter().find(|format| format.media_type().strip_prefix("image/") == Some(value));
                wishes.form = Form::Picture(Some(format.ok_or_else(|| bad("frames", value, "one of png, jpeg, webp, mesh"))?));
            }
            ("width", "auto") => wishes.width = PreviewWidth::Auto,
            ("width", value) => {
                let width = value.parse().ok().filter(|width| (1..=max_side).contains(width));
                wishes.width = PreviewWidth::Fixed(width.ok_or_else(|| bad("width", value, &format!("auto or 1 to {max_side}")))?);
            }
            ("report", value @ ("true" | "false")) => wishes.report = value == "true",
            ("report", value) => return Err(bad("report", value, "true or false")),
            _ => {
                let detail = "the query has a field that is not known; supported: frames, width, report";
                return Err(Problem::new(Code::UnknownField, detail));
            }
        }
    }
    if wishes.form == Form::Mesh && wishes.width != PreviewWidth::Auto {
        return Err(Problem::new(Code::BadValue, "a mesh has no width: leave the query's `width` out"));
    }
    Ok(wishes)
}

/// Carries messages until either side ends it.
async fn talk<S: AsyncRead + AsyncWrite + Unpin>(app: &App, pass: Credential, mut drag: Drag, mut line: WebSocketConnection<S>) {
    let began = Instant::now();
    let ending = converse(app, pass, &mut drag, &mut line).await;
    let (code, reason) = match &ending {
        Ending::Gone => (0, "the client left"),
        Ending::Close(code, reason) => (u16::from(*code), *reason),
    };
    let seconds = began.elapsed().as_secs_f64();
    tracing::info!(target: "mlswarp::http", code, reason, seconds = format_args!("{seconds:.1}"), "drag ended");
    // What is being made ends here; the seat is kept until the connection is closed.
    drag.stop();
    line.close(ending).await;
}

async fn converse<S: AsyncRead + AsyncWrite + Unpin>(
    app: &App,
    pass: Credential,
    drag: &mut Drag,
    line: &mut WebSocketConnection<S>,
) -> Ending {
    let now = Instant::now();
    let mut bucket = Bucket::new(MESSAGES.0, MESSAGES.1, now);
    let mut life = Life { heard: now, pinged: None };
    let (stopping, revoked) = (app.stopping(), app.access().revoked(pass));
    tokio::pin!(stopping, revoked);
    loop {
        let due = drag.act(Instant::now());
        while let Some(said) = drag.next_outgoing() {
            match said {
                Outgoing::Text(text) => line.text(text),
                Outgoing::Frame(seq, pieces) => line.binary(Bytes::copy_from_slice(&seq.to_le_bytes()), pieces),
            }
        }
        if drag.is_over() {
            return Ending::Close(CloseCode::Normal, "the session has ended");
        }
        let (deadline, _) = life.deadline(drag, line, app.config());
        let wake = due.map_or(deadline, |due| due.min(deadline));
        tokio::select! {
            heard = line.hear() => {
                let now = Instant::now();
                life = Life { heard: now, pinged: None };
                if !matches!(heard, Heard::End(_)) && !bucket.take(now) {
                    return Ending::Close(CloseCode::Policy, "too many messages a second");
                }
                match heard {
                    Heard::Text(text) => drag.on_message(text.as_bytes(), now),
                    Heard::Binary => drag.send_problem(None, &Problem::new(Code::MalformedRequest, "messages are text")),
                    Heard::Life => {}
                    Heard::End(ending) => return ending,
                }
            }
            () = drag.work() => {}
            () = &mut stopping => return Ending::Close(CloseCode::Restart, "the service is stopping"),
            () = &mut revoked => {
                drag.send_problem(None, &Problem::new(Code::Forbidden, "the key that has opened this socket is none of this server's any more"));
                while let Some(said) = drag.next_outgoing() {
                    if let Outgoing::Text(text) = said {
                        line.last_words(text);
                    }
                }
                return Ending::Close(CloseCode::Policy, "the key was revoked");
            }
            () = tokio::time::sleep_until(wake.into()) => {
                let now = Instant::now();
                // What has left meanwhile is progress.
                let (deadline, then) = life.deadline(drag, line, app.config());
                match then {
                    _ if now < deadline => {}
                    Then::Ping => {
                        line.ping();
                        life.pinged = Some(now);
                        drag.check_session().await;
                    }
                    Then::End(reason) => return Ending::Close(CloseCode::Policy, reason),
                }
            }
        }
    }
}

/// When the client was last heard, and what it was asked since.
#[derive(Clone, Copy, Debug)]
struct Life {
    heard: Instant,
    pinged: Option<Instant>,
}

/// What happens when a deadline has passed.
#[derive(Clone, Copy, Debug)]
enum Then {
    Ping,
    End(&'static str),
}

impl Life {
    /// The next deadline: of a client that takes nothing, of one that acknowledges nothing, of one that says nothing.
    fn deadline<S: AsyncRead + AsyncWrite + Unpin>(&self, drag: &Drag, line: &WebSocketConnection<S>, config: &Config) -> (Instant, Then) {
        if let Some(since) = line.blocked() {
            return (since + config.timeouts.socket, Then::End("the client does not take what it is sent"));
        }
        let silence = match self.pinged {
            // A client that takes what it is sent is there, and hears a ping after that.
            None => (self.heard.max(line.wrote()) + config.timeouts.socket_idle, Then::Ping),
            Some(pinged) => (pinged.max(line.wrote()) + config.timeouts.socket_idle, Then::End("no answer to a ping")),
        };
        let owed = drag.owed_since().filter(|_| line.is_clear()).map(|since| since.max(line.wrote()) + config.timeouts.socket);
        match owed {
            Some(owed) if owed < silence.0 => (owed, Then::End("a frame was not acknowledged in time")),
            _ => silence,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_query_says_what_frames_are() {
        let read = |query: &str| wishes(Some(query), 16384);
        let usual = DragOptions { form: Form::Picture(None), width: PreviewWidth::Auto, report: false };
        assert_eq!(wishes(None, 16384), Ok(usual));
        assert_eq!(read("width=auto&report=false"), Ok(usual));
        assert_eq!(read("width=1024&report=true"), Ok(DragOptions { width: PreviewWidth::Fixed(1024), report: true, ..usual }));
        assert_eq!(read("frames=mesh"), Ok(DragOptions { form: Form::Mesh, ..usual }));
        for (name, format) in [("png", Format::Png), ("jpeg", Format::Jpeg), ("webp", Format::WebP)] {
            assert_eq!(read(&format!("frames={name}")), Ok(DragOptions { form: Form::Picture(Some(format)), ..usual }));
        }
        for (query, code) in [
            ("frames=gif", Code::BadValue),
            ("frames", Code::BadValue),
            ("width=0", Code::BadValue),
            ("width=16385", Code::BadValue),
            ("width=-1", Code::BadValue),
            ("frames=mesh&width=100", Code::BadValue),
            ("report=yes", Code::BadValue),
            ("q=1", Code::UnknownField),
            ("Frames=png", Code::UnknownField),
        ] {
            assert_eq!(read(query).unwrap_err().code, code, "{query}");
        }
    }
}
