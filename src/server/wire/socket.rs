//! The messages of the drag socket: `{"seq", "q"}` and `{"ack"}` from the client; the report that precedes a frame.

use mlswarp::deform::{Contradiction, Handle};
use mlswarp::render::Canvas;
use mlswarp::warp::RestSpec;
use serde::Serialize;

use super::handles::handles;
use super::json;
use super::json::{At, Node, optional};
use super::number::whole;
use super::rest::strength;
use super::{AsJson, HANDLES};
use crate::problem::{Code, Problem};

const NUMBER: &str = "a whole number, at least 0";

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum DragMessage {
    Pose {
        seq: u64,
        q: UnreadHandles,
    },
    /// The client shows the frame of this number.
    Ack(u64),
}

/// Handles as well-formed JSON that is not parsed yet: most poses are superseded before they are drawn.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UnreadHandles {
    text: Box<str>,
    strength: f64,
}

impl UnreadHandles {
    /// Bytes of text.
    pub(crate) const fn len(&self) -> usize {
        self.text.len()
    }

    /// `rest`: what the handles are at rest, which a strength needs.
    pub(crate) fn read(&self, rest: &RestSpec) -> Result<Vec<Handle>, Problem> {
        let q = handles(&Node { text: &self.text, at: At::Field(&At::Root, "q") })?;
        Ok(rest.posed_at(self.strength, q))
    }
}

/// The problem of a message, and its `seq` where that could be read.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct BadMessage {
    pub(crate) seq: Option<u64>,
    pub(crate) problem: Box<Problem>,
}

impl DragMessage {
    pub(crate) fn parse(json: &[u8]) -> Result<Self, BadMessage> {
        let mut seq = None;
        Self::read(json, &mut seq).map_err(|problem| BadMessage { seq, problem: Box::new(problem) })
    }

    fn read(json: &[u8], number: &mut Option<u64>) -> Result<Self, Problem> {
        let root = json::root(json)?;
        let [seq, q, strength_, ack] = root.fields(&["seq", "q", "strength", "ack"])?;
        *number = optional(seq, |n| whole(n, NUMBER))?;
        let strength = optional(strength_, strength)?;
        match (optional(ack, |n| whole(n, NUMBER))?, *number, q) {
            (Some(ack), None, None) if strength.is_none() => Ok(Self::Ack(ack)),
            (Some(_), ..) => Err(Problem::new(Code::BadValue, "send `ack` in a message of its own, without a pose").pointer("/ack")),
            (None, Some(seq), Some(q)) => {
                Ok(Self::Pose { seq, q: UnreadHandles { text: q.text.into(), strength: strength.unwrap_or(1.0) } })
            }
            (None, None, _) => Err(root.missing("seq", NUMBER)),
            (None, _, None) => Err(root.missing("q", HANDLES)),
        }
    }
}

/// The message before a frame, for clients that ask for it.
#[derive(Debug, Serialize)]
pub(crate) struct FrameReport<'a> {
    /// Of the pose.
    pub(crate) seq: u64,
    /// Size of the frame, px; of the source if the frame is a mesh.
    pub(crate) width: u32,
    pub(crate) height: u32,
    /// The part of the posed plane that the picture shows; absent if it is that of the source.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) canvas: Option<AsJson<Canvas>>,
    /// Not a preview.
    pub(crate) full: bool,
    /// Drawn cells that fold.
    pub(crate) folds: u64,
    /// Largest distance between a posed handle and where it is drawn, px.
    pub(crate) residual: f64,
    /// Codes of warnings.
    pub(crate) warnings: Vec<&'a str>,
    /// Cells of the grid that are farther than its tolerance from the exact map; absent if there are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) exceeded: Option<u64>,
    /// The groups of handles that coincide at rest and move differently.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) coincident: Option<AsJson<&'a [Contradiction]>>,
    pub(crate) timing: FrameTiming,
}

/// Milliseconds; `render` and `encode` are sums over all threads.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct FrameTiming {
    pub(crate) queue: f64,
    pub(crate) deform: f64,
    pub(crate) render: f64,
    pub(crate) encode: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use mlswarp::geometry::Point;

    #[test]
    fn messages_are_poses_and_acknowledgements() {
        let read = |text: &str| DragMessage::parse(text.as_bytes());
        let Ok(DragMessage::Pose { seq: 7, q }) = read(r#"{"seq": 7, "q": [[1, 2]]}"#) else { panic!() };
        assert_eq!(q.read(&RestSpec::default()), Ok(vec![Handle::Point(Point::new(1.0, 2.0))]));
        let Ok(DragMessage::Pose { seq: 7, q }) = read(r#"{"seq": 7, "q": [[1, 2]], "strength": -0.5}"#) else { panic!() };
        let rest = RestSpec { p: vec![Handle::Point(Point::new(3.0, 8.0))], ..RestSpec::default() };
        assert_eq!(q.read(&rest), Ok(vec![Handle::Point(Point::new(4.0, 11.0))]));
        assert_eq!(read(r#"{"ack": 7}"#), Ok(DragMessage::Ack(7)));
        assert_eq!(read(r#"{"ack": 7, "seq": null, "q": null}"#), Ok(DragMessage::Ack(7)));
        assert_eq!(read(r#"{"seq": 7, "q": [], "ack": null}"#), read(r#"{"seq": 7, "q": []}"#));
        for (text, seq, code, pointer) in [
            ("{", None, Code::MalformedRequest, None),
            ("[]", None, Code::MalformedRequest, None),
            ("{}", None, Code::BadValue, Some("/seq")),
            (r#"{"q": []}"#, None, Code::BadValue, Some("/seq")),
            (r#"{"seq": 3}"#, Some(3), Code::BadValue, Some("/q")),
            (r#"{"seq": 3, "q": null, "ack": null}"#, Some(3), Code::BadValue, Some("/q")),
            (r#"{"seq": null, "q": []}"#, None, Code::BadValue, Some("/seq")),
            (r#"{"seq": -1, "q": []}"#, None, Code::BadValue, Some("/seq")),
            (r#"{"seq": 3, "q": [], "output": {}}"#, None, Code::UnknownField, Some("/output")),
            (r#"{"seq": 3, "ack": 3}"#, Some(3), Code::BadValue, Some("/ack")),
            (r#"{"ack": 3, "strength": 1}"#, None, Code::BadValue, Some("/ack")),
            (r#"{"seq": 3, "q": [], "strength": 11}"#, Some(3), Code::BadValue, Some("/strength")),
            (r#"{"ack": "3"}"#, None, Code::BadValue, Some("/ack")),
        ] {
            let bad = read(text).unwrap_err();
            assert_eq!((bad.seq, bad.problem.code, bad.problem.pointer.as_deref()), (seq, code, pointer), "{text}");
        }
        // Handles are read when something is made of them.
        for (q, code, pointer) in
            [("7", Code::BadValue, "/q"), ("[[1]]", Code::BadValue, "/q/0"), ("[[1, 1e999]]", Code::NotFinite, "/q/0/1")]
        {
            let Ok(DragMessage::Pose { seq: 3, q }) = read(&format!(r#"{{"seq": 3, "q": {q}}}"#)) else { panic!() };
            let bad = q.read(&RestSpec::default()).unwrap_err();
            assert_eq!((bad.code, bad.pointer.as_deref()), (code, Some(pointer)));
        }
    }
}
