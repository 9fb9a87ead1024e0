//! `POST /sessions/{id}/batch`: the body, with the poses of the frames in one of three forms, and
//! the JSON files of the result. The objects in `frames` stay text, each of which is parsed when
//! its frame is checked and drawn: 10,000 sets of handles are never in memory together.

use std::collections::BTreeMap;
use std::ops::Range;

use bytes::Bytes;
use mlswarp::render::Canvas;
use mlswarp::warp::{CoordinateFrame, Easing, Jitter};
use serde::Serialize;

use super::annotations::Annotations;
use super::enum_name::enum_name;
use super::fields::BatchFields;
use super::handles::handles_bytes;
use super::json::{At, Kind, Node, optional};
use super::number::{count, number_in, whole};
use super::output::OutputPatch;
use super::{
    AsJson, PosePatch, Reserved, fields, json, layer, reading_bytes, require_length, text_bytes,
};
use crate::layer::{LayerRef, MAX_LAYERS};
use crate::problem::{Code, Problem};

/// The most frames of a batch.
const MOST_FRAMES: u32 = 10_000;
/// All stored layers of a session, and the built-in ones.
const MOST_LAYERS: usize = MAX_LAYERS + LayerRef::BUILT_IN.len();
/// What a number of frames is.
const COUNT: &str = "a whole number of frames, at least 1";
/// What the number of in-betweens is.
const STEPS_EXPECTED: &str =
    "a whole number of frames, at least 2: the first at rest, the last at `q`";
/// What the frames are.
const FRAMES: &str = "an array of frames, {\"q\": [...], \"strength\": t}";
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

/// Memory of the place of a frame, also while their list grows, bytes.
const PLACE_BYTES: u64 = 3 * size_of::<Range<usize>>() as u64;

/// The objects in `frames`, as the client has written them.
#[derive(Clone, Debug)]
pub struct FrameTexts {
    body: Bytes,
    places: Vec<Range<usize>>,
}

impl FrameTexts {
    /// Reads `q` and `strength` of a frame.
    fn read<H>(
        &self,
        frame: u32,
        reserve: impl FnOnce(u64) -> Result<H, Problem>,
    ) -> Result<Reserved<PosePatch, H>, Problem> {
        let place = self.places.get(frame as usize);
        let text = place
            .and_then(|place| self.body.get(place.clone()))
            .unwrap_or_default();
        Reserved::read(reading_bytes(text), reserve, || read_frame(frame, text))
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
            Self::Frames(texts) => u32::try_from(texts.places.len()).unwrap_or(u32::MAX),
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
        reserve: impl FnOnce(u64) -> Result<H, Problem>,
    ) -> Result<Self, Problem> {
        let root = json::root(body)?;
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
        Self::read(reading_bytes(body) + places, reserve, || {
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

/// Where each frame is; nothing is parsed.
fn frame_texts(
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

fn frame_count(node: &Node<'_, '_>, least: u32, expected: &str) -> Result<u32, Problem> {
    match count(node, least, expected)? {
        count if count > MOST_FRAMES => Err(too_many(node, count.into())),
        count => Ok(count),
    }
}

fn too_many(node: &Node<'_, '_>, actual: u64) -> Problem {
    let problem = node.problem(
        Code::TooLarge,
        format!("a batch has at most {MOST_FRAMES} frames; found {actual}"),
    );
    problem.limit("batch_frames", MOST_FRAMES, actual)
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

/// How far a frame is from the handles at rest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FramePosition {
    /// The share of the way from rest to `q`; with a jitter, before the handles are displaced.
    pub strength: f64,
    /// Of an in-between: its time, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub t: Option<f64>,
    /// What displaces the handles at random, if anything does.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub jitter: Option<FrameJitter>,
}

/// The seed, and the number of the frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FrameJitter {
    /// The seed of the batch.
    pub seed: u64,
    /// The number of the frame, from 0.
    pub frame: u32,
}

/// What the index of a batch says of a frame.
#[derive(Debug, Serialize)]
pub struct BatchFrame {
    /// The file names.
    pub picture: String,
    /// By the names of the layers.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub layers: BTreeMap<String, String>,
    /// The name of the file of annotations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub annotations: Option<String>,
    /// How far the frame is from the handles at rest.
    #[serde(flatten)]
    pub position: FramePosition,
    /// Width of the picture, px.
    pub width: u32,
    /// Height of the picture, px.
    pub height: u32,
    /// The part of the posed plane that the picture shows.
    pub canvas: AsJson<Canvas>,
    /// px of the picture in a px of the canvas, along each axis.
    pub scale: [f64; 2],
    /// Drawn cells that fold.
    pub folds: u64,
    /// Largest distance between a posed handle and where it is drawn, px of the source.
    pub residual: f64,
    /// Codes of warnings.
    pub warnings: Vec<&'static str>,
    /// Cells of the grid that are farther than its tolerance from the exact map; absent if there
    /// are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exceeded: Option<u64>,
}

/// `frames.json`.
#[derive(Debug, Serialize)]
pub struct BatchIndex<'a> {
    /// In the order of the archive.
    pub frames: &'a [BatchFrame],
}

#[cfg(test)]
mod tests {
    use mlswarp::pixmap::Extent;
    use mlswarp::warp::Units;

    use super::*;

    fn free(_: u64) -> Result<(), Problem> {
        Ok(())
    }

    fn parse(text: &str) -> Result<BatchObject, Problem> {
        let source = CoordinateFrame::of_source(Extent::new(100, 80).unwrap(), Units::Px);
        let body = Bytes::copy_from_slice(text.as_bytes());
        Reserved::<BatchObject, _>::parse(&body, 1000, 100, source, free)
            .map(|read| read.into_parts().0)
    }

    #[test]
    fn the_three_forms_are_read() {
        let frames = parse(
            r#"{"frames": [{"q": [[1, 2]]}, {"strength": 0.5, "q": [[3, 4]]}],
              "points": [[1, 1]], "output": {"width": 9}}"#,
        )
        .unwrap();
        let BatchPoses::Frames(texts) = &frames.poses else {
            panic!()
        };
        let strength = |frame| texts.read(frame, free).unwrap().strength;
        assert_eq!(
            (frames.count(), strength(0), strength(1)),
            (2, None, Some(0.5))
        );
        assert_eq!(
            (frames.annotations.kinds.len(), frames.output.width),
            (1, Some(9))
        );
        let steps = parse(
            r#"{"q": [[1, 2]], "steps": 24, "easing": "ease-in-out", "strength": 2, "delay": 20}"#,
        )
        .unwrap();
        let BatchPoses::Steps {
            steps: 24,
            easing: Easing::EaseInOut,
            pose: PosePatch {
                strength: Some(2.0),
                ..
            },
        } = steps.poses
        else {
            panic!()
        };
        assert_eq!(steps.delay, Some(20));
        let jitter =
            parse(r#"{"jitter": {"seed": 18446744073709551615, "count": 100, "sigma": 2.5}}"#)
                .unwrap();
        let BatchPoses::Jitter {
            jitter:
                Jitter {
                    seed: u64::MAX,
                    sigma: 2.5,
                },
            count: 100,
            pose: PosePatch { q: None, .. },
        } = jitter.poses
        else {
            panic!()
        };
    }

    #[test]
    fn the_way_back_repeats_neither_end_unless_the_animation_ends() {
        let count = |text: &str| parse(text).unwrap().count();
        assert_eq!(count(r#"{"steps": 24, "and_back": true}"#), 46);
        assert_eq!(count(r#"{"steps": 24, "and_back": true, "loop": 0}"#), 46);
        assert_eq!(
            count(r#"{"steps": 24, "and_back": true, "loop": 2}"#),
            47,
            "it ends at rest"
        );
        assert_eq!(count(r#"{"steps": 24, "and_back": false, "loop": 2}"#), 24);
        assert_eq!(
            (
                count(r#"{"steps": 2, "and_back": true}"#),
                count(r#"{"frames": [{}], "and_back": true}"#)
            ),
            (2, 1)
        );
        assert_eq!(count(r#"{"steps": 5001, "and_back": true}"#), 10_000);
        let problem = parse(r#"{"steps": 5001, "loop": 1, "and_back": true}"#).unwrap_err();
        assert_eq!(
            (problem.pointer.as_deref(), problem.actual),
            (Some("/and_back"), Some(10_001.into()))
        );
    }

    #[test]
    fn mistakes_name_their_place() {
        let long = format!(
            r#"{{"frames": [{{"q": []}}, {{"q": [{}]}}]}}"#,
            "[1, 2],".repeat(20) + "[1, 2]"
        );
        let many = format!(r#"{{"frames": [{}1]}}"#, "1,".repeat(10_000));
        let much = format!(r#"{{"q": [{}[1, 2]], "steps": 2}}"#, "[1, 2],".repeat(200));
        for (text, code, pointer) in [
            ("{}", Code::BadValue, Some("/steps")),
            (r#"{"q": []}"#, Code::BadValue, Some("/steps")),
            (r#"{"frames": 24}"#, Code::BadValue, Some("/frames")),
            (
                r#"{"q": [], "frames": 24, "easing": "linear"}"#,
                Code::BadValue,
                Some("/frames"),
            ),
            (r#"{"q": [], "steps": 1}"#, Code::BadValue, Some("/steps")),
            (
                r#"{"steps": 2, "loop": 65536}"#,
                Code::BadValue,
                Some("/loop"),
            ),
            (
                r#"{"steps": 2, "loop": true}"#,
                Code::BadValue,
                Some("/loop"),
            ),
            (
                r#"{"steps": 2, "and_back": 1}"#,
                Code::BadValue,
                Some("/and_back"),
            ),
            (
                r#"{"jitter": {"seed": 1, "count": 1, "sigma": 1}, "and_back": true}"#,
                Code::BadValue,
                Some("/and_back"),
            ),
            (r#"{"frames": []}"#, Code::BadValue, Some("/frames")),
            (r#"{"frames": {}}"#, Code::BadValue, Some("/frames")),
            (
                r#"{"frames": [{"q": []}], "q": []}"#,
                Code::BadValue,
                Some("/q"),
            ),
            (
                r#"{"frames": [{"q": []}], "steps": 2}"#,
                Code::BadValue,
                Some("/steps"),
            ),
            (
                r#"{"q": [], "steps": 2, "jitter": {}}"#,
                Code::BadValue,
                Some("/jitter"),
            ),
            (r#"{"q": [], "steps": 0}"#, Code::BadValue, Some("/steps")),
            (
                r#"{"q": [], "steps": 10001}"#,
                Code::TooLarge,
                Some("/steps"),
            ),
            (
                r#"{"q": [], "steps": 2, "easing": "bounce"}"#,
                Code::BadValue,
                Some("/easing"),
            ),
            (
                r#"{"q": [], "steps": 2, "delay": 0}"#,
                Code::BadValue,
                Some("/delay"),
            ),
            (
                r#"{"q": [], "steps": 2, "delay": 60001}"#,
                Code::BadValue,
                Some("/delay"),
            ),
            (
                r#"{"q": [], "jitter": {"count": 1, "sigma": 1}}"#,
                Code::BadValue,
                Some("/jitter/seed"),
            ),
            (
                r#"{"q": [], "jitter": {"seed": -1, "count": 1, "sigma": 1}}"#,
                Code::BadValue,
                Some("/jitter/seed"),
            ),
            (
                r#"{"q": [], "jitter": {"seed": 1, "sigma": 1}}"#,
                Code::BadValue,
                Some("/jitter/count"),
            ),
            (
                r#"{"q": [], "jitter": {"seed": 1, "count": 10001, "sigma": 1}}"#,
                Code::TooLarge,
                Some("/jitter/count"),
            ),
            (
                r#"{"q": [], "jitter": {"seed": 1, "count": 1}}"#,
                Code::BadValue,
                Some("/jitter/sigma"),
            ),
            (
                r#"{"q": [], "jitter": {"seed": 1, "count": 1, "sigma": -1}}"#,
                Code::BadValue,
                Some("/jitter/sigma"),
            ),
            (
                r#"{"q": [], "jitter": {"seed": 1, "count": 1, "sigma": 1, "scale": 1}}"#,
                Code::UnknownField,
                Some("/jitter/scale"),
            ),
            (
                r#"{"q": [], "jitter": {"seed": 1, "count": 1, "sigma": 1}, "easing": "linear"}"#,
                Code::BadValue,
                Some("/easing"),
            ),
            (
                r#"{"q": [], "steps": 2, "layers": ["a", "a"]}"#,
                Code::BadValue,
                Some("/layers/1"),
            ),
            (
                r#"{"q": [], "steps": 2, "layers": ["@depth"]}"#,
                Code::BadValue,
                Some("/layers/0"),
            ),
            (
                r#"{"q": [], "steps": 2, "layers": "a"}"#,
                Code::BadValue,
                Some("/layers"),
            ),
            (
                r#"{"q": [], "steps": 2, "inverse": true}"#,
                Code::UnknownField,
                Some("/inverse"),
            ),
            (&long, Code::TooLarge, Some("/frames/1")),
            (&many, Code::TooLarge, Some("/frames")),
            (&much, Code::TooLarge, None),
        ] {
            let problem = parse(text).unwrap_err();
            assert_eq!(
                (problem.code, problem.pointer.as_deref()),
                (code, pointer),
                "{}: {problem}",
                &text[..text.len().min(80)]
            );
        }
        let many = parse(&many).unwrap_err();
        assert_eq!(
            (many.what, many.limit, many.actual),
            (
                Some("batch_frames"),
                Some(10_000.into()),
                Some(10_001.into())
            )
        );
        let BatchPoses::Frames(texts) =
            parse(r#"{"frames": [{"q": []}, {"q": [[1]]}, 7, {"strength": 1}]}"#)
                .unwrap()
                .poses
        else {
            panic!()
        };
        for (frame, pointer) in [(1, "/frames/1/q/0"), (2, "/frames/2")] {
            assert_eq!(
                texts.read(frame, free).unwrap_err().pointer.as_deref(),
                Some(pointer)
            );
        }
        assert_eq!(
            *texts.read(3, free).unwrap(),
            PosePatch {
                q: None,
                strength: Some(1.0)
            }
        );
    }

    #[test]
    fn the_index_has_one_object_for_each_frame() {
        let frame = |position, annotations: Option<&str>| BatchFrame {
            picture: "0000.png".to_owned(),
            layers: BTreeMap::new(),
            annotations: annotations.map(str::to_owned),
            position,
            width: 4,
            height: 3,
            canvas: AsJson(Canvas {
                x: -1,
                y: 0,
                extent: Extent::new(8, 6).unwrap(),
            }),
            scale: [0.5, 0.5],
            folds: 1,
            residual: 0.5,
            warnings: vec!["translation_only"],
            exceeded: None,
        };
        let between = FramePosition {
            strength: 0.5,
            t: Some(0.25),
            jitter: None,
        };
        let jittered = FramePosition {
            strength: 1.0,
            t: None,
            jitter: Some(FrameJitter { seed: 7, frame: 1 }),
        };
        let frames = [frame(between, None), frame(jittered, Some("0001.json"))];
        let canvas = serde_json::json!({"x": -1, "y": 0, "width": 8, "height": 6});
        assert_eq!(
            serde_json::to_value(BatchIndex { frames: &frames }).unwrap(),
            serde_json::json!({"frames": [
                {"picture": "0000.png", "strength": 0.5, "t": 0.25, "width": 4, "height": 3,
                    "canvas": canvas, "scale": [0.5, 0.5],
                 "folds": 1, "residual": 0.5, "warnings": ["translation_only"]},
                {"picture": "0000.png", "annotations": "0001.json", "strength": 1.0,
                    "jitter": {"seed": 7, "frame": 1}, "width": 4,
                 "height": 3, "canvas": canvas, "scale": [0.5, 0.5], "folds": 1, "residual": 0.5,
                     "warnings": ["translation_only"]}
            ]})
        );
    }
}
