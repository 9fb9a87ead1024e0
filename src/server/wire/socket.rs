//! The messages of the drag socket: `{"seq", "q"}` and `{"ack"}` from the client; what it is told beside the frames.

use mlswarp::deform::Handle;
use serde::Serialize;

use super::HANDLES;
use super::handles::handles;
use super::json;
use super::json::{At, Node};
use super::number::whole;
use crate::problem::{Code, Problem};

const NUMBER: &str = "a whole number, at least 0";

/// A message of the client's.
#[derive(Clone, Debug, PartialEq)]
pub enum DragMessage {
    /// Where the handles are.
    Pose {
        /// Its number.
        seq: u64,
        /// Posed handles, as they came.
        q: UnreadHandles,
    },
    /// The frame of this number is shown.
    Ack(u64),
}

/// Well-formed JSON of handles that nobody has read: most poses are overtaken before anything is made of them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct UnreadHandles(Box<str>);

impl UnreadHandles {
    /// Bytes of text.
    pub const fn len(&self) -> usize {
        self.0.len()
    }

    /// There is no text, not even that of no handles.
    pub const fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Reads them.
    /// Errors: A problem with the code and a JSON pointer into the message.
    pub fn read(&self) -> Result<Vec<Handle>, Problem> {
        handles(&json::kept(&self.0, At::Field(&At::Root, "q")))
    }
}

/// What is wrong with a message, and its `seq` where that could be read.
#[derive(Clone, Debug, PartialEq)]
pub struct BadMessage {
    /// The number.
    pub seq: Option<u64>,
    /// What is wrong.
    pub problem: Box<Problem>,
}

impl DragMessage {
    /// Reads a message.
    /// Errors: A problem with the code and a JSON pointer.
    pub fn parse(json: &[u8]) -> Result<Self, BadMessage> {
        let mut number = None;
        Self::read(json, &mut number).map_err(|problem| BadMessage { seq: number, problem: Box::new(problem) })
    }

    fn read(json: &[u8], number: &mut Option<u64>) -> Result<Self, Problem> {
        let root = json::root(json)?;
        let [seq, q, ack] = root.fields("an object", &["seq", "q", "ack"])?;
        let read = |node: Option<Node<'_, '_>>| node.map(|n| whole(&n, NUMBER)).transpose();
        *number = read(seq)?;
        match (read(ack)?, *number, q) {
            (Some(ack), None, None) => Ok(Self::Ack(ack)),
            (Some(_), ..) => Err(Problem::new(Code::BadValue, "`ack` stands alone: a pose is a message of its own").pointer("/ack")),
            (None, Some(seq), Some(q)) => Ok(Self::Pose { seq, q: UnreadHandles(q.text().into()) }),
            (None, None, _) => Err(root.missing("seq", NUMBER)),
            (None, _, None) => Err(root.missing("q", HANDLES)),
        }
    }
}

/// What goes before a frame where the client asked for it.
#[derive(Debug, Serialize)]
pub struct FrameReport<'a> {
    /// Of the pose.
    pub seq: u64,
    /// Width of the frame, px (of the source where the frame is a mesh).
    pub width: u32,
    /// Height of the same.
    pub height: u32,
    /// Nothing is missing: not a preview.
    pub full: bool,
    /// Drawn cells that fold.
    pub folds: u64,
    /// Largest distance between a posed handle and where it is drawn, px.
    pub residual: f64,
    /// Codes of warnings.
    pub warnings: Vec<&'a str>,
    /// What it cost.
    pub timing: FrameTiming,
}

/// Milliseconds.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct FrameTiming {
    /// Waiting for a worker.
    pub queue: f64,
    /// Posing the grid.
    pub deform: f64,
    /// Mesh to pixels, all threads together.
    pub render: f64,
    /// Pixels to the file, all threads together.
    pub encode: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use mlswarp::geometry::Point;

    #[test]
    fn messages_are_poses_and_acknowledgements() {
        let read = |text: &str| DragMessage::parse(text.as_bytes());
        let Ok(DragMessage::Pose { seq: 7, q }) = read(r#"{"seq": 7, "q": [[1, 2]]}"#) else { panic!() };
        assert_eq!(q.read(), Ok(vec![Handle::Point(Point::new(1.0, 2.0))]));
        assert_eq!(read(r#"{"ack": 7}"#), Ok(DragMessage::Ack(7)));
        for (text, seq, code, pointer) in [
            ("{", None, Code::MalformedRequest, None),
            ("[]", None, Code::MalformedRequest, None),
            ("{}", None, Code::BadValue, Some("/seq")),
            (r#"{"q": []}"#, None, Code::BadValue, Some("/seq")),
            (r#"{"seq": 3}"#, Some(3), Code::BadValue, Some("/q")),
            (r#"{"seq": -1, "q": []}"#, None, Code::BadValue, Some("/seq")),
            (r#"{"seq": 3, "q": [], "output": {}}"#, None, Code::UnknownField, Some("/output")),
            (r#"{"seq": 3, "ack": 3}"#, Some(3), Code::BadValue, Some("/ack")),
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
            let bad = q.read().unwrap_err();
            assert_eq!((bad.code, bad.pointer.as_deref()), (code, Some(pointer)));
        }
    }
}
