//! `POST /sessions/{id}/batch`: the body, with the poses of the frames in one of three forms, and
//! the index of the result (`index.rs`). The objects in `frames` stay text, each of which is parsed
//! when its frame is checked and drawn: 10,000 sets of handles are never in memory together.

mod frames;
mod index;
#[cfg(test)]
mod tests;

use bytes::Bytes;
use mlswarp::deform::IsCancelled;
use mlswarp::warp::{CoordinateFrame, Easing, Jitter};

use super::annotations::Annotations;
use super::enum_name::enum_name;
use super::fields::BatchFields;
use super::handles::handles_bytes;
use super::json::{Kind, Node, optional};
use super::number::{count, number_in, whole};
use super::output::OutputPatch;
use super::work::Work;
use super::{PosePatch, Reserved, fields, json, layer, reading_bytes, require_length, text_bytes};
use crate::layer::{LayerRef, MAX_LAYERS};
use crate::problem::{Code, Problem};
use frames::{FRAMES, MOST_FRAMES, PLACE_BYTES, frame_texts, too_many};
pub use frames::{FrameTexts, in_frame};
pub use index::{BatchFrame, BatchIndex, FrameJitter, FramePosition};

/// All stored layers of a session, and the built-in ones.
const MOST_LAYERS: usize = MAX_LAYERS + LayerRef::BUILT_IN.len();
/// What a number of frames is.
const COUNT: &str = "a whole number of frames, at least 1";
/// What the number of in-betweens is.
const STEPS_EXPECTED: &str =
    "a whole number of frames, at least 2: the first at rest, the last at `q`";
/// The largest standard deviation of a jitter, px.
const MOST_SIGMA: f64 = 10_000.0;
/// The longest display of a frame, ms.
const MOST_DELAY: u16 = 60_000;

/// The body of the request.
#[derive(Clone, Debug)]
pub struct BatchObject {
    /// The poses of the frames.
    pub poses: BatchPoses,
    /// The layers that are drawn in every frame, each once.
    pub layers: Vec<LayerRef>,
    /// The annotations that are mapped in every frame.
    pub annotations: Annotations,
    /// Replaces fields of the session's output.
    pub output: OutputPatch,
    /// How long an animation shows each frame, ms.
    pub delay: Option<u16>,
    /// How often an animation is played; 0 is without end.
    pub plays: Option<u16>,
    /// Whether the frames follow once more, from the last to the first.
    pub and_back: bool,
}

/// The poses of a batch.
#[derive(Clone, Debug)]
pub enum BatchPoses {
    /// Each frame has its own.
    Frames(FrameTexts),
    /// From rest to `q`.
    Steps {
        /// The last pose.
        pose: PosePatch,
        /// The number of frames.
        steps: u32,
        /// How they follow one another.
        easing: Easing,
    },
    /// Around `q`.
    Jitter {
        /// The pose that is displaced.
        pose: PosePatch,
        /// The displacements.
        jitter: Jitter,
        /// The number of frames.
        count: u32,
    },
}

impl BatchPoses {
    /// What the request gives of the pose of a frame.
    /// Errors: A frame with another form.
    pub fn requested_frames<H>(
        &self,
        frame: u32,
        reserve: impl FnOnce(u64) -> Result<H, Problem>,
    ) -> Result<Reserved<PosePatch, H>, Problem> {
        match self {
            Self::Frames(texts) => texts.read(frame, reserve),
            Self::Steps { pose, .. } | Self::Jitter { pose, .. } => {
                Reserved::read(pose.q.as_deref().map_or(0, handles_bytes), reserve, || {
                    Ok(pose.clone())
                })
            }
        }
    }

    /// The number of frames.
    pub fn count(&self) -> u32 {
        match self {
            Self::Frames(texts) => texts.count(),
            Self::Steps { steps, .. } => *steps,
            Self::Jitter { count, .. } => *count,
        }
    }
}

impl<H> Reserved<BatchObject, H> {
    /// Reads the object in memory that `reserve` takes before. `most_bytes`: the most bytes of
    /// everything but frames and annotations; `most_frame_bytes`: the most of one frame; `source`:
    /// the image of annotations.
    pub fn parse(
        body: &Bytes,
        most_bytes: u64,
        most_frame_bytes: u64,
        source: CoordinateFrame,
        cancelled: IsCancelled<'_>,
        reserve: impl FnOnce(u64) -> Result<H, Problem>,
    ) -> Result<Self, Problem> {
        let work = Work::new(cancelled);
        let most = (most_bytes, most_frame_bytes);
        work.believe(Self::parse_counted(body, most, source, &work, reserve))
    }

    fn parse_counted(
        body: &Bytes,
        (most_bytes, most_frame_bytes): (u64, u64),
        source: CoordinateFrame,
        work: &Work<'_>,
        reserve: impl FnOnce(u64) -> Result<H, Problem>,
    ) -> Result<Self, Problem> {
        let root = json::long_root(body, work)?;
        let fields = BatchFields::from(root.fields(&fields::BATCH)?);
        let rest =
            body.len() - text_bytes([fields.frames]) - text_bytes(fields.mapped().annotations());
        require_length(rest, most_bytes, "its frames and annotations")?;
        // Frames are not read before they are drawn.
        let places = if fields.frames.is_some() {
            u64::from(MOST_FRAMES) * PLACE_BYTES
        } else {
            0
        };
        let most = reading_bytes(body, Some(work)) + places;
        Self::read(most, reserve, || {
            BatchObject::read(body, &root, fields, most_frame_bytes, source)
        })
    }
}

impl BatchObject {
    fn read(
        body: &Bytes,
        root: &Node<'_, '_>,
        fields: BatchFields<Node<'_, '_>>,
        most_frame_bytes: u64,
        source: CoordinateFrame,
    ) -> Result<Self, Problem> {
        let BatchFields {
            frames,
            q,
            strength,
            steps,
            easing,
            jitter,
            and_back,
            ..
        } = fields;
        let poses = match (frames, steps, jitter) {
            (Some(frames), ..) if frames.kind() == Kind::Number => {
                let meant = frames
                    .text
                    .parse::<u32>()
                    .map_or_else(|_| String::new(), |n| format!(": {n}"));
                return Err(frames.unexpected(
                    FRAMES,
                    format_args!("a number; did you mean `steps`{meant}?"),
                ));
            }
            (Some(frames), None, None) => {
                let others = [("q", q), ("strength", strength), ("easing", easing)];
                refuse_beside("frames", "each frame has its own", &others)?;
                BatchPoses::Frames(frame_texts(body, &frames, most_frame_bytes)?)
            }
            (None, Some(steps), None) => BatchPoses::Steps {
                pose: PosePatch::read([q, strength], usize::MAX)?,
                steps: frame_count(&steps, 2, STEPS_EXPECTED)?,
                easing: optional(easing, enum_name)?.unwrap_or_default(),
            },
            (None, None, Some(jitter)) => {
                refuse_beside("jitter", "it applies to `steps`", &[("easing", easing)])?;
                refuse_beside(
                    "jitter",
                    "it applies to `steps` and `frames`",
                    &[("and_back", and_back)],
                )?;
                let [seed, count, sigma] = jitter.fields(&fields::JITTER)?;
                let required = |node: Option<_>, name, expected| {
                    node.ok_or_else(|| jitter.missing(name, expected))
                };
                let (seed_of, sigma_of) = (
                    "a whole number between 0 and 18446744073709551615",
                    "a number of pixels between 0 and 10000",
                );
                BatchPoses::Jitter {
                    pose: PosePatch::read([q, strength], usize::MAX)?,
                    count: frame_count(&required(count, "count", COUNT)?, 1, COUNT)?,
                    jitter: Jitter {
                        seed: whole(&required(seed, "seed", seed_of)?, seed_of)?,
                        sigma: number_in(
                            &required(sigma, "sigma", sigma_of)?,
                            0.0..=MOST_SIGMA,
                            sigma_of,
                        )?,
                    },
                }
            }
            (None, None, None) => {
                let detail = "the poses are missing: give `steps`, `frames` or `jitter`";
                return Err(Problem::new(Code::BadValue, detail).pointer("/steps"));
            }
            _ => {
                let last = jitter.or(steps).unwrap_or(*root);
                return Err(
                    last.problem(Code::BadValue, "give one of `frames`, `steps` and `jitter`")
                );
            }
        };
        let layers = optional(fields.layers, layers)?.unwrap_or_default();
        let annotations = Annotations::read(body, fields.mapped(), |_| source)?;
        let output = optional(fields.output, OutputPatch::read)?.unwrap_or_default();
        let delay = optional(fields.delay, read_delay)?;
        let plays = optional(fields.plays, read_plays)?;
        let object = Self {
            poses,
            layers,
            annotations,
            output,
            delay,
            plays,
            and_back: optional(and_back, Node::bool)?.unwrap_or(false),
        };
        match (object.count(), and_back) {
            (count, Some(node)) if count > MOST_FRAMES => Err(too_many(&node, count.into())),
            _ => Ok(object),
        }
    }

    /// The number of frames.
    pub fn count(&self) -> u32 {
        let (there, is_endless) = (self.poses.count(), self.plays.unwrap_or(0) == 0);
        match self.and_back {
            false => there,
            // What is repeated without end follows its last frame with its first.
            true => (2 * there)
                .saturating_sub(if is_endless { 2 } else { 1 })
                .max(there),
        }
    }
}

/// Reads the names of layers; each may be given once.
fn layers(node: &Node<'_, '_>) -> Result<Vec<LayerRef>, Problem> {
    let mut layers: Vec<LayerRef> = Vec::new();
    node.items::<Problem>("an array of names of layers", |_, item| {
        let layer = layer(&item)?;
        if layers.contains(&layer) {
            return Err(item.problem(
                Code::BadValue,
                format!("the layer `{}` is given twice", layer.as_str()),
            ));
        }
        if layers.len() >= MOST_LAYERS {
            return Err(node
                .unexpected(&format!("at most {MOST_LAYERS} layers"), "more")
                .limit("layers", MOST_LAYERS, layers.len() + 1));
        }
        layers.push(layer);
        Ok(())
    })?;
    Ok(layers)
}

/// Errors: A field that does not apply.
fn refuse_beside(
    form: &str,
    why: &str,
    others: &[(&str, Option<Node<'_, '_>>)],
) -> Result<(), Problem> {
    match others
        .iter()
        .find_map(|(name, node)| Some((name, (*node)?)))
    {
        Some((name, node)) => Err(node.problem(
            Code::BadValue,
            format!("`{name}` does not apply beside `{form}`: {why}"),
        )),
        None => Ok(()),
    }
}

fn frame_count(node: &Node<'_, '_>, least: u32, expected: &str) -> Result<u32, Problem> {
    match count(node, least, expected)? {
        count if count > MOST_FRAMES => Err(too_many(node, count.into())),
        count => Ok(count),
    }
}

fn read_delay(node: &Node<'_, '_>) -> Result<u16, Problem> {
    const DELAY: &str = "a whole number of milliseconds, 1 to 60000";
    let value = count(node, 1, DELAY)?;
    u16::try_from(value)
        .ok()
        .filter(|delay| *delay <= MOST_DELAY)
        .ok_or_else(|| node.unexpected(DELAY, value).actual(value))
}

fn read_plays(node: &Node<'_, '_>) -> Result<u16, Problem> {
    const PLAYS: &str =
        "how often the animation is played: a whole number, 0 (without end) to 65535";
    let value = count(node, 0, PLAYS)?;
    u16::try_from(value).map_err(|_| node.unexpected(PLAYS, value).actual(value))
}
