//! Any bytes as the messages of a drag socket, one a line: what is heard never ends the drag, what
//! is said is a frame or a whole document.

use std::sync::LazyLock;
use std::time::{Duration, Instant};

use bytes::Bytes;
use mlswarp_server::app::drag_socket::{
    self, Drag, DragOptions, FrameContent, Outgoing, PreviewWidth, Window,
};
use mlswarp_server::app::upload::Upload;
use mlswarp_server::app::{App, sessions};
use mlswarp_server::client::{Client, Owner};
use mlswarp_server::session::SessionId;
use tokio::runtime::Runtime;

use super::{assert_is_problem, multipart};

static SESSION: LazyLock<(App, Runtime, SessionId)> = LazyLock::new(|| {
    let (app, runtime) = multipart::app();
    let id = SessionId::random(Owner::ANYBODY);
    let file = Bytes::from_static(include_bytes!("../seeds/image/png-6-8"));
    let warp = Bytes::from_static(br#"{"p": [[3, 3], [[10, 2], [20, 9]], [5, 14]]}"#);
    let upload = Upload::new(file, warp);
    runtime
        .block_on(sessions::put(&app, Client::default(), id, upload))
        .expect("a session");
    (app, runtime, id)
});

pub(super) fn talk(bytes: &[u8]) {
    let Some((wishes, messages)) = bytes.split_first() else {
        return;
    };
    let is_binary = wishes % 128 >= 64;
    let picture = if wishes % 32 < 16 {
        FrameContent::Auto
    } else {
        FrameContent::Picture(None)
    };
    let wishes = DragOptions {
        form: match wishes % 32 {
            n if n % 2 == 1 => picture,
            n if n < 16 => FrameContent::Mesh,
            n => FrameContent::CompactMesh(f64::from(n) / 8.0),
        },
        width: if wishes % 4 < 2 {
            PreviewWidth::Auto
        } else {
            PreviewWidth::Fixed(1 + u32::from(*wishes))
        },
        report: wishes % 8 < 4,
        window: if wishes % 64 < 32 {
            Window::Auto
        } else {
            Window::Fixed(8)
        },
    };
    let (app, runtime, id) = &*SESSION;
    runtime.block_on(async {
        let mut drag = drag_socket::open(app, Client::default(), *id, wishes)
            .await
            .expect("a seat");
        for message in messages.split(|&byte| byte == b'\n').take(64) {
            if is_binary {
                drag.on_binary(&Bytes::copy_from_slice(message), Instant::now());
            } else {
                drag.on_text(Bytes::copy_from_slice(message), Instant::now());
            }
            while drag.is_reading() {
                drag.work().await;
            }
            go_on(&mut drag).await;
            assert!(!drag.is_over(), "nothing that is said ends a session");
        }
    });
}

/// Makes what is due, says it, and acknowledges nothing by itself.
async fn go_on(drag: &mut Drag) {
    drag.act(Instant::now());
    // Either something is being made and gets ready, or nothing is.
    let _ = tokio::time::timeout(Duration::from_millis(2), drag.work()).await;
    drag.act(Instant::now());
    while let Some(said) = drag.next_outgoing() {
        match said {
            Outgoing::Text(text) => {
                let document: serde_json::Value = serde_json::from_str(&text).expect("a document");
                if document.get("status").is_some() {
                    assert_is_problem(&document);
                }
            }
            Outgoing::Frame(_, pieces) => assert!(
                pieces.iter().any(|piece| !piece.is_empty()),
                "an empty frame"
            ),
        }
    }
}
