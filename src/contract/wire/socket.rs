//! The messages of the drag socket: poses, as `{"seq", "q"}` or binary, and `{"ack"}` from the
//! client; the report that precedes a frame.

use bytes::Bytes;
use mlswarp::deform::{Conflict, Handle};
use mlswarp::geometry::Point;
use mlswarp::pixmap::Extent;
use mlswarp::render::Canvas;
use mlswarp::warp::RestSpec;
use serde::Serialize;

use super::handles::{handles_bytes, posed_handles};
use super::json;
use super::json::{At, Node, optional};
use super::number::whole;
use super::rest::strength;
use super::{AsJson, Pose, PosePatch, Reserved, reading_bytes};
use crate::problem::{Code, Problem};

const NUMBER: &str = "a whole number, at least 0";
/// Bytes of a number of a binary pose.
const NUMBER_BYTES: usize = 4;
/// Memory of a handle for each byte of its numbers: a line of two positions has a list of its own.
const HANDLE_BYTES: u64 = 8;

/// What a client sends on a drag socket.
#[derive(Clone, Debug, PartialEq)]
pub enum DragMessage {
    /// A pose to draw.
    Pose {
        /// Its number.
        seq: u64,
        /// Its handles.
        q: UnreadHandles,
    },
    /// The client shows the frame of this number.
    Ack(u64),
}

/// Handles that are not parsed yet: most poses are superseded before they are drawn.
#[derive(Clone, Debug, PartialEq)]
pub enum UnreadHandles {
    /// Well-formed JSON.
    Json {
        /// The array of handles.
        text: Box<str>,
        /// See [`RestSpec::posed`].
        strength: f64,
    },
    /// Those of the session.
    OfSession {
        /// In place of the session's.
        strength: Option<f64>,
    },
    /// The numbers of all handles, as little-endian f32.
    Binary(Bytes),
}

impl Default for UnreadHandles {
    fn default() -> Self {
        Self::Binary(Bytes::new())
    }
}

impl<H> Reserved<Vec<Handle>, H> {
    /// Reads the handles of a pose in memory that `reserve` takes before. `rest`: the handles at
    /// rest on a picture of this extent; `session`: the pose of the session, if it has one.
    pub fn of_pose(
        q: &UnreadHandles,
        rest: &RestSpec,
        session: Option<&Pose>,
        extent: Extent,
        reserve: impl FnOnce(u64) -> Result<H, Problem>,
    ) -> Result<Self, Problem> {
        let most = match q {
            UnreadHandles::Json { text, .. } => reading_bytes(text.as_bytes(), None),
            UnreadHandles::OfSession { .. } => session.map_or(0, |pose| handles_bytes(&pose.q)),
            UnreadHandles::Binary(bytes) => HANDLE_BYTES * bytes.len() as u64,
        };
        Self::read(most, reserve, || q.read(rest, session, extent))
    }
}

impl<H> Reserved<DragMessage, H> {
    /// Reads a text message. The text of its handles stays as it is.
    pub fn parse(
        text: &[u8],
        reserve: impl FnOnce(u64) -> Result<H, Problem>,
    ) -> Result<Self, BadMessage> {
        Self::read(text.len() as u64, reserve, || DragMessage::parse(text))
    }

    /// Reads a binary message, of which the value is a part.
    pub fn of_bytes(
        bytes: &Bytes,
        reserve: impl FnOnce(u64) -> Result<H, Problem>,
    ) -> Result<Self, BadMessage> {
        Self::read(bytes.len() as u64, reserve, || {
            DragMessage::parse_binary(bytes)
        })
    }
}

impl UnreadHandles {
    /// How many bytes of the message they are.
    pub const fn byte_count(&self) -> usize {
        match self {
            Self::Json { text, .. } => text.len(),
            Self::OfSession { .. } => 0,
            Self::Binary(bytes) => bytes.len(),
        }
    }

    /// Whether the message has them.
    pub const fn is_given(&self) -> bool {
        !matches!(self, Self::OfSession { .. })
    }

    /// How much of the way from p to q the handles are moved. `session`: the pose of the session,
    /// if it has one.
    pub fn strength(&self, session: Option<&Pose>) -> f64 {
        match self {
            Self::Json { strength, .. } => *strength,
            Self::OfSession { strength } => strength
                .or(session.map(|pose| pose.strength))
                .unwrap_or(1.0),
            Self::Binary(_) => 1.0,
        }
    }

    /// `rest`: the handles at rest on a picture of this extent, of a session with this pose.
    /// Alignment and strength need their positions, and numbers their shapes.
    fn read(
        &self,
        rest: &RestSpec,
        session: Option<&Pose>,
        extent: Extent,
    ) -> Result<Vec<Handle>, Problem> {
        let q = match self {
            Self::Json { text, .. } => {
                posed_handles(&Node::new(text, At::Field(&At::Root, "q")), rest.p.len())?
            }
            Self::OfSession { .. } => PosePatch::default().onto(session)?.q,
            Self::Binary(bytes) => read_binary(bytes, &rest.p)?,
        };
        Ok(rest.posed(q, self.strength(session), extent).0)
    }
}

/// The handles whose numbers these are, in the order and shape of those at rest.
fn read_binary(bytes: &[u8], rest: &[Handle]) -> Result<Vec<Handle>, Problem> {
    let (numbers, _) = bytes.as_chunks::<NUMBER_BYTES>();
    let expected = 2 * rest
        .iter()
        .map(|handle| handle.places().len())
        .sum::<usize>();
    if numbers.len() != expected {
        let detail = format!(
            "`q` must have {expected} numbers, x and y of each position of the handles at rest; \
                found {}",
            numbers.len()
        );
        return Err(Problem::new(Code::ShapeMismatch, detail)
            .pointer("/q")
            .actual(numbers.len()));
    }
    let mut numbers = numbers
        .iter()
        .map(|bytes| f64::from(f32::from_le_bytes(*bytes)));
    let mut place = |index| {
        let (x, y) = (
            numbers.next().unwrap_or(f64::NAN),
            numbers.next().unwrap_or(f64::NAN),
        );
        if x.is_finite() && y.is_finite() {
            return Ok(Point::new(x, y));
        }
        let problem = Problem::new(
            Code::NotFinite,
            "a coordinate must be finite; found NaN or an infinite number",
        );
        Err(problem.pointer(format!("/q/{index}")).handle(index))
    };
    let handle = |(index, handle): (usize, &Handle)| match handle {
        Handle::Point(_) => place(index).map(Handle::Point),
        Handle::Polyline(line) => line
            .iter()
            .map(|_| place(index))
            .collect::<Result<_, _>>()
            .map(Handle::Polyline),
        Handle::Missing => Ok(Handle::Missing),
    };
    rest.iter().enumerate().map(handle).collect()
}

/// The problem of a message, and its `seq` where that could be read.
#[derive(Clone, Debug, PartialEq)]
pub struct BadMessage {
    /// The number of the message, where it could be read.
    pub seq: Option<u64>,
    /// What is wrong.
    pub problem: Box<Problem>,
}

impl From<Problem> for BadMessage {
    fn from(problem: Problem) -> Self {
        Self {
            seq: None,
            problem: Box::new(problem),
        }
    }
}

impl DragMessage {
    /// Reads a binary pose: `seq` (u64), then the numbers of `q` (f32), little-endian.
    fn parse_binary(bytes: &Bytes) -> Result<Self, BadMessage> {
        let seq = bytes.first_chunk().map(|seq| u64::from_le_bytes(*seq));
        match seq {
            Some(seq) if bytes.len().is_multiple_of(NUMBER_BYTES) => Ok(Self::Pose {
                seq,
                q: UnreadHandles::Binary(bytes.slice(size_of_val(&seq)..)),
            }),
            _ => {
                let detail = "a binary message is a pose: `seq` (8 bytes), then the numbers of \
                    `q` (4 bytes each); found";
                let problem = Problem::new(
                    Code::MalformedRequest,
                    format!("{detail} {} bytes", bytes.len()),
                );
                Err(BadMessage {
                    seq,
                    problem: Box::new(problem),
                })
            }
        }
    }

    fn parse(json: &[u8]) -> Result<Self, BadMessage> {
        let mut seq = None;
        Self::read(json, &mut seq).map_err(|problem| BadMessage {
            seq,
            problem: Box::new(problem),
        })
    }

    fn read(json: &[u8], number: &mut Option<u64>) -> Result<Self, Problem> {
        let root = json::root(json)?;
        let [seq, q, strength_, ack] = root.fields(&["seq", "q", "strength", "ack"])?;
        *number = optional(seq, |n| whole(n, NUMBER))?;
        let strength = optional(strength_, strength)?;
        match (optional(ack, |n| whole(n, NUMBER))?, *number, q) {
            (Some(ack), None, None) if strength.is_none() => Ok(Self::Ack(ack)),
            (Some(_), ..) => Err(Problem::new(
                Code::BadValue,
                "send `ack` in a message of its own, without a pose",
            )
            .pointer("/ack")),
            (None, Some(seq), Some(q)) => Ok(Self::Pose {
                seq,
                q: UnreadHandles::Json {
                    text: q.text.into(),
                    strength: strength.unwrap_or(1.0),
                },
            }),
            (None, Some(seq), None) => Ok(Self::Pose {
                seq,
                q: UnreadHandles::OfSession { strength },
            }),
            (None, None, _) => Err(root.missing("seq", NUMBER)),
        }
    }
}

/// The message before a frame, for clients that ask for it.
#[derive(Debug, Serialize)]
pub struct FrameReport<'a> {
    /// Of the pose.
    pub seq: u64,
    /// Width of the frame, px; of the source if the frame is a mesh.
    pub width: u32,
    /// Height of the frame, px; of the source if the frame is a mesh.
    pub height: u32,
    /// The part of the posed plane that the picture shows; that of the source if the frame is a
    /// mesh.
    pub canvas: AsJson<Canvas>,
    /// px of the picture in a px of the canvas, along each axis.
    pub scale: [f64; 2],
    /// How much of the way from p to q the handles are moved.
    pub strength: f64,
    /// Not a preview.
    pub full: bool,
    /// Of the file, or `mesh`.
    pub format: &'a str,
    /// Of a JPEG.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quality: Option<u8>,
    /// Drawn cells that fold.
    pub folds: u64,
    /// Largest distance between a posed handle and where it is drawn, px of the source.
    pub residual: f64,
    /// Largest distance between a compact mesh and the full one, px.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<f64>,
    /// Codes of warnings.
    pub warnings: Vec<&'a str>,
    /// Cells of the grid that are farther than its tolerance from the exact map; absent if there
    /// are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exceeded: Option<u64>,
    /// The groups of handles that coincide at rest and move differently.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coincident: Option<AsJson<&'a [Conflict]>>,
    /// How long the frame took.
    pub timing: FrameTiming,
}

/// Milliseconds; `render` and `encode` are sums over all threads.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct FrameTiming {
    /// Waiting for a thread.
    pub queue: f64,
    /// Computing the mesh.
    pub deform: f64,
    /// Drawing.
    pub render: f64,
    /// Writing the file.
    pub encode: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn extent() -> Extent {
        Extent::new(8, 4).unwrap()
    }

    #[test]
    fn messages_are_poses_and_acknowledgements() {
        let read = |text: &str| DragMessage::parse(text.as_bytes());
        let Ok(DragMessage::Pose { seq: 7, q }) = read(r#"{"seq": 7, "q": [[1, 2]]}"#) else {
            panic!()
        };
        let rest = RestSpec {
            p: vec![Handle::Point(Point::new(3.0, 8.0))],
            ..RestSpec::default()
        };
        assert_eq!(
            q.read(&rest, None, extent()),
            Ok(vec![Handle::Point(Point::new(1.0, 2.0))])
        );
        let Ok(DragMessage::Pose { seq: 7, q }) =
            read(r#"{"seq": 7, "q": [[1, 2]], "strength": -0.5}"#)
        else {
            panic!()
        };
        assert_eq!(
            q.read(&rest, None, extent()),
            Ok(vec![Handle::Point(Point::new(4.0, 11.0))])
        );
        assert_eq!(read(r#"{"ack": 7}"#), Ok(DragMessage::Ack(7)));
        assert_eq!(
            read(r#"{"ack": 7, "seq": null, "q": null}"#),
            Ok(DragMessage::Ack(7))
        );
        assert_eq!(
            read(r#"{"seq": 7, "q": [], "ack": null}"#),
            read(r#"{"seq": 7, "q": []}"#)
        );
        for (text, seq, code, pointer) in [
            ("{", None, Code::MalformedRequest, None),
            ("[]", None, Code::MalformedRequest, None),
            ("{}", None, Code::BadValue, Some("/seq")),
            (r#"{"q": []}"#, None, Code::BadValue, Some("/seq")),
            (
                r#"{"seq": null, "q": []}"#,
                None,
                Code::BadValue,
                Some("/seq"),
            ),
            (
                r#"{"seq": -1, "q": []}"#,
                None,
                Code::BadValue,
                Some("/seq"),
            ),
            (
                r#"{"seq": 3, "q": [], "output": {}}"#,
                None,
                Code::UnknownField,
                Some("/output"),
            ),
            (
                r#"{"seq": 3, "ack": 3}"#,
                Some(3),
                Code::BadValue,
                Some("/ack"),
            ),
            (
                r#"{"ack": 3, "strength": 1}"#,
                None,
                Code::BadValue,
                Some("/ack"),
            ),
            (
                r#"{"seq": 3, "q": [], "strength": 11}"#,
                Some(3),
                Code::BadValue,
                Some("/strength"),
            ),
            (r#"{"ack": "3"}"#, None, Code::BadValue, Some("/ack")),
        ] {
            let bad = read(text).unwrap_err();
            assert_eq!(
                (bad.seq, bad.problem.code, bad.problem.pointer.as_deref()),
                (seq, code, pointer),
                "{text}"
            );
        }
        // Without `q` that of the session is meant.
        let pose = Pose {
            q: vec![Handle::Point(Point::new(5.0, 8.0))],
            strength: 2.0,
        };
        for (text, x) in [
            (r#"{"seq": 7, "q": null, "ack": null}"#, 7.0),
            (r#"{"seq": 7, "strength": 0.5}"#, 4.0),
        ] {
            let Ok(DragMessage::Pose { seq: 7, q }) = read(text) else {
                panic!()
            };
            assert_eq!(
                q.read(&rest, Some(&pose), extent()),
                Ok(vec![Handle::Point(Point::new(x, 8.0))])
            );
            assert_eq!(
                q.read(&rest, None, extent())
                    .unwrap_err()
                    .pointer
                    .as_deref(),
                Some("/q")
            );
        }
        // Handles are read when something is made of them.
        for (q, code, pointer) in [
            ("7", Code::BadValue, "/q"),
            ("[[1]]", Code::BadValue, "/q/0"),
            ("[[1, 1e999]]", Code::NotFinite, "/q/0/1"),
            // What follows is not read.
            ("[[1, 1], [1, 1], 7]", Code::ShapeMismatch, "/q"),
        ] {
            let Ok(DragMessage::Pose { seq: 3, q }) = read(&format!(r#"{{"seq": 3, "q": {q}}}"#))
            else {
                panic!()
            };
            let bad = q.read(&rest, None, extent()).unwrap_err();
            assert_eq!((bad.code, bad.pointer.as_deref()), (code, Some(pointer)));
        }
    }

    #[test]
    fn binary_poses_have_the_shape_of_the_handles_at_rest() {
        let place = |x: f32, y: f32| Point::new(x.into(), y.into());
        let p = vec![
            Handle::Point(Point::new(0.0, 0.0)),
            Handle::Polyline(vec![Point::new(1.0, 1.0); 3]),
        ];
        let rest = RestSpec {
            p,
            ..RestSpec::default()
        };
        let message = |seq: u64, numbers: &[f32]| {
            let numbers = numbers.iter().flat_map(|number| number.to_le_bytes());
            seq.to_le_bytes()
                .into_iter()
                .chain(numbers)
                .collect::<Vec<_>>()
        };
        let read = |numbers: &[f32]| match DragMessage::parse_binary(&message(9, numbers).into()) {
            Ok(DragMessage::Pose { seq: 9, q }) => q.read(&rest, None, extent()),
            other => panic!("{other:?}"),
        };
        let numbers = [0.1, -2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 1e6];
        let line = Handle::Polyline(vec![place(3.0, 4.0), place(5.0, 6.0), place(7.0, 1e6)]);
        assert_eq!(
            read(&numbers),
            Ok(vec![Handle::Point(place(0.1, -2.5)), line])
        );
        for (numbers, code, pointer, handle) in [
            (&[][..], Code::ShapeMismatch, "/q", None),
            (&numbers[..7], Code::ShapeMismatch, "/q", None),
            (&[0.0; 9], Code::ShapeMismatch, "/q", None),
            (
                &[f32::NAN, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
                Code::NotFinite,
                "/q/0",
                Some(0),
            ),
            (
                &[0.0, 0.0, 0.0, 0.0, 0.0, f32::NEG_INFINITY, 0.0, 0.0],
                Code::NotFinite,
                "/q/1",
                Some(1),
            ),
        ] {
            let problem = read(numbers).unwrap_err();
            assert_eq!(
                (problem.code, problem.pointer.as_deref(), problem.handle),
                (code, Some(pointer), handle),
                "{numbers:?}"
            );
        }
        for (bytes, seq) in [
            (vec![], None),
            (vec![7; 7], None),
            (message(9, &[1.0])[..11].to_vec(), Some(9)),
        ] {
            let bad = DragMessage::parse_binary(&bytes.into()).unwrap_err();
            assert_eq!((bad.seq, bad.problem.code), (seq, Code::MalformedRequest));
        }
    }
}
