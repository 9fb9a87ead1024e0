//! The objects in `frames`: where each stands in the body, and its reading when it is drawn.

use std::ops::Range;

use bytes::Bytes;

use crate::problem::{Code, Problem};
use crate::wire::json::{At, Node};
use crate::wire::{PosePatch, Reserved, fields, reading_bytes};

/// The most frames of a batch.
pub(super) const MOST_FRAMES: u32 = 10_000;
/// What the frames are.
pub(super) const FRAMES: &str = "an array of frames, {\"q\": [...], \"strength\": t}";
/// Memory of the place of a frame, also while their list grows, bytes.
pub(super) const PLACE_BYTES: u64 = 3 * size_of::<Range<usize>>() as u64;

/// The objects in `frames`, as the client has written them.
#[derive(Clone, Debug)]
pub struct FrameTexts {
    body: Bytes,
    places: Vec<Range<usize>>,
}

impl FrameTexts {
    /// Reads `q` and `strength` of a frame.
    pub(super) fn read<H>(
        &self,
        frame: u32,
        reserve: impl FnOnce(u64) -> Result<H, Problem>,
    ) -> Result<Reserved<PosePatch, H>, Problem> {
        let place = self.places.get(frame as usize);
        let text = place
            .and_then(|place| self.body.get(place.clone()))
            .unwrap_or_default();
        Reserved::read(reading_bytes(text, None), reserve, || {
            read_frame(frame, text)
        })
    }

    /// The number of frames.
    pub(super) fn count(&self) -> u32 {
        u32::try_from(self.places.len()).unwrap_or(u32::MAX)
    }
}

fn read_frame(frame: u32, text: &[u8]) -> Result<PosePatch, Problem> {
    let frames = At::Field(&At::Root, "frames");
    let text = std::str::from_utf8(text).unwrap_or_default();
    let node = Node::new(text, At::Item(&frames, frame as usize));
    PosePatch::read(node.fields(&fields::BATCH_FRAME)?, usize::MAX)
}

/// The problem of a frame's pose: its pointer begins at the frame.
pub fn in_frame(frame: u32, mut problem: Problem) -> Problem {
    problem.pointer = problem
        .pointer
        .map(|pointer| format!("/frames/{frame}{pointer}"));
    problem
}

/// Where each frame is; nothing is parsed.
pub(super) fn frame_texts(
    body: &Bytes,
    frames: &Node<'_, '_>,
    most_bytes: u64,
) -> Result<FrameTexts, Problem> {
    let (mut places, mut count) = (Vec::new(), 0_u64);
    frames.items::<Problem>(FRAMES, |_, item| {
        let length = item.text.len();
        if length as u64 > most_bytes {
            let detail = format!("the frame has {length} bytes; the limit is {most_bytes}");
            return Err(item.problem(Code::TooLarge, detail).limit(
                "drag_json_bytes",
                most_bytes,
                length,
            ));
        }
        if count < MOST_FRAMES.into() {
            let start = item.text.as_ptr() as usize - body.as_ptr() as usize;
            places.push(start..start + length);
        }
        count += 1;
        Ok(())
    })?;
    match count {
        0 => Err(frames.unexpected("at least one frame", "an empty array")),
        _ if count > MOST_FRAMES.into() => Err(too_many(frames, count)),
        _ => Ok(FrameTexts {
            body: body.clone(),
            places,
        }),
    }
}

/// The problem of a batch with more frames than there may be.
pub(super) fn too_many(node: &Node<'_, '_>, actual: u64) -> Problem {
    let problem = node.problem(
        Code::TooLarge,
        format!("a batch has at most {MOST_FRAMES} frames; found {actual}"),
    );
    problem.limit("batch_frames", MOST_FRAMES, actual)
}
