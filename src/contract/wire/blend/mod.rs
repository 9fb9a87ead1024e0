//! `POST /blend`: which images are added, with which weights, and how their shapes are aligned.

mod shapes;

use mlswarp::deform::Handle;
use mlswarp::pixmap::Extent;
use mlswarp::render::Canvas;
use mlswarp::warp::blend::{BlendSpace, ShapeReference};
use mlswarp::warp::{Align, CanvasSpec, Limits, OutputSpec, RestSpec, Target};
use serde::Serialize;

use super::enum_name::{Matching, enum_name};
use super::fields::{BlendFields, WarpFields};
use super::handles::handles;
use super::json::{Kind, Node, optional};
use super::landmarks::Item;
use super::number::{count, number_in};
use super::{AsJson, WarpPatch, fields, json};
use crate::problem::{Code, Problem};

pub use shapes::{AlignedShapes, NamedShape};

/// Most images of a blend.
pub const MOST_IMAGES: usize = 200;
/// Most frames of a blend.
const MOST_FRAMES: usize = 1000;
/// The largest weight, and the smallest one with its sign: with larger ones, colours would be made
/// of rounding errors.
const MOST_WEIGHT: f64 = 100.0;
/// How far the sum of weights may be from 1, for each of them.
const SUM_ROUNDING: f64 = 1e-6;

const IMAGES: &str = "an array of objects such as {\"image\": 0, \"shape\": 0.5, \"colour\": 0.5}";
const WEIGHT: &str = "a number between -100 and 100, or an array of them: one for each frame";
const REFERENCE: &str =
    "`mean`, the index of an entry of `images`, or an array of handles in pixels";
const PART: &str = "the number of a part `image`, from 0";
const PAIRS: &str = "an array of indices of handles: for each handle its mirror image";
/// Bytes of the text of an ordinary entry.
const ENTRY_TEXT: usize = 60;
const NUMBER_TEXT: usize = 6;
const NAMES: &str = "an array of names, one for each handle of `p`";
const NAME_TEXT: usize = 8;

/// The object of a blend.
#[derive(Clone, Debug, PartialEq)]
pub struct BlendObject {
    /// The images, in the order in which they are added.
    pub images: Vec<BlendEntry>,
    /// The class of maps that place a shape over the reference.
    pub align: Align,
    /// The frame of the result.
    pub reference: ShapeReference,
    /// The values that are added.
    pub space: BlendSpace,
    /// How the landmarks of the images are matched, if that was requested.
    pub matching: Option<Matching>,
    /// The method and its parameters, without handles.
    pub rest: RestSpec,
    /// How the result is drawn.
    pub output: OutputSpec,
    /// How many results there are.
    pub frames: usize,
}

/// One image of a blend.
#[derive(Clone, Debug, PartialEq)]
pub struct BlendEntry {
    /// Where the image is.
    pub source: BlendSource,
    /// Its share of the shape: one for all frames, or one for each.
    shape: Vec<f64>,
    /// Its share of the colours, likewise.
    colour: Vec<f64>,
    /// Whether its mirror image is meant.
    pub is_mirrored: bool,
    /// Which landmarks are each other's mirror images, if the client says so.
    pub pairs: Option<Vec<usize>>,
    /// Its landmarks, if they are not in a file or in the session.
    pub p: Option<Vec<Handle>>,
    /// One name for each handle of `p`.
    pub names: Option<Vec<String>>,
    /// Which item of the landmark file they are, where it has several.
    pub item: Option<Item>,
}

/// Where an image of a blend is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BlendSource {
    /// The part `image` of this number, from 0, with the part `landmarks` of the same number.
    Part(usize),
    /// The image and the handles at rest of the session of this id.
    Session(String),
}

impl BlendObject {
    /// Reads the object. Errors: a field that the contract does not have, or with another value;
    /// weights that do not add up to 1.
    pub(super) fn parse(json: &[u8]) -> Result<Self, Problem> {
        let root = json::root(json)?;
        let fields = BlendFields::from(root.fields(&fields::BLEND)?);
        let images = fields
            .images
            .ok_or_else(|| root.missing("images", IMAGES))?;
        let entries = images.list(IMAGES, ENTRY_TEXT, |index, item| {
            if index >= MOST_IMAGES {
                return Err(images
                    .problem(
                        Code::TooLarge,
                        format!("a blend has at most {MOST_IMAGES} images"),
                    )
                    .limit("blend_images", MOST_IMAGES, index + 1));
            }
            BlendEntry::read(&item)
        })?;
        if entries.is_empty() {
            return Err(images.unexpected("at least one image", "an empty array"));
        }
        let of_warp = WarpFields {
            method: fields.method,
            alpha: fields.alpha,
            point_mass: fields.point_mass,
            smoothing: fields.smoothing,
            coincident: fields.coincident,
            grid: fields.grid,
            output: fields.output,
            ..WarpFields::default()
        };
        let warp = WarpPatch::read(of_warp, &[])?.into_object()?;
        if warp.is_auto {
            let detail = "the method `auto` compares methods by where handles go; choose one";
            return Err(Problem::new(Code::BadValue, detail).pointer("/method"));
        }
        let mut blend = Self {
            images: entries,
            align: optional(fields.align, enum_name)?.unwrap_or(Align::Similarity),
            reference: optional(fields.reference, reference)?.unwrap_or(ShapeReference::Image(0)),
            space: optional(fields.space, enum_name)?.unwrap_or_default(),
            matching: optional(fields.matching, enum_name)?,
            rest: warp.rest,
            output: warp.output,
            frames: 1,
        };
        if let ShapeReference::Image(index) = blend.reference
            && index >= blend.images.len()
        {
            let found = format!("entry {index} of {}", blend.images.len());
            return Err(Problem::new(
                Code::BadValue,
                format!("`reference`: expected {REFERENCE}; found {found}"),
            )
            .pointer("/reference"));
        }
        blend.settle(fields.steps.as_ref())?;
        Ok(blend)
    }

    /// Fills in the weights that the client left out, and checks their sums.
    fn settle(&mut self, steps: Option<&Node<'_, '_>>) -> Result<(), Problem> {
        let lists = || {
            self.images
                .iter()
                .flat_map(|entry| [&entry.shape, &entry.colour])
        };
        let length = lists().map(Vec::len).filter(|length| *length > 1).max();
        self.frames = match (steps, length) {
            (Some(steps), None) => {
                let expected = "a whole number of frames, 2 to 1000";
                let frames = count(steps, 2, expected)? as usize;
                if frames > MOST_FRAMES {
                    return Err(steps
                        .problem(
                            Code::TooLarge,
                            format!("expected {expected}; found {frames}"),
                        )
                        .limit("blend_frames", MOST_FRAMES, frames));
                }
                if self.images.len() != 2 {
                    return Err(steps.problem(
                        Code::BadValue,
                        "`steps` leads from one image to another: give two images, or a list of \
                         weights for each image",
                    ));
                }
                frames
            }
            (Some(steps), Some(_)) => {
                return Err(steps.problem(
                    Code::BadValue,
                    "`steps` and lists of weights both say how many frames there are: give one",
                ));
            }
            (None, Some(length)) if length > MOST_FRAMES => {
                let detail = format!("a blend has at most {MOST_FRAMES} frames; found {length}");
                return Err(Problem::new(Code::TooLarge, detail)
                    .pointer("/images")
                    .limit("blend_frames", MOST_FRAMES, length));
            }
            (None, length) => length.unwrap_or(1),
        };
        for name in ["shape", "colour"] {
            self.settle_weights(name, steps.is_some())?;
        }
        Ok(())
    }

    /// `is_morph`: weights that are left out lead from the first image to the second.
    fn settle_weights(&mut self, name: &'static str, is_morph: bool) -> Result<(), Problem> {
        let (frames, images) = (self.frames, self.images.len());
        let given = self
            .images
            .iter()
            .filter(|entry| !entry.weights(name).is_empty());
        let given = given.count();
        #[expect(clippy::cast_precision_loss, reason = "at most 1000 frames")]
        let at = |frame: usize| frame as f64 / (frames - 1) as f64;
        for (index, entry) in self.images.iter_mut().enumerate() {
            let weights = entry.weights_mut(name);
            let pointer = format!("/images/{index}/{name}");
            match weights.len() {
                0 if given == 0 && is_morph => {
                    let share = |frame| {
                        if index == 0 {
                            1.0 - at(frame)
                        } else {
                            at(frame)
                        }
                    };
                    *weights = (0..frames).map(share).collect();
                }
                #[expect(clippy::cast_precision_loss, reason = "at most 200 images")]
                0 if given == 0 => *weights = vec![1.0 / images as f64; frames],
                0 => {
                    let detail = format!(
                        "`{name}` is missing here and given for another image: give it for all, \
                         or for none, which means equal shares"
                    );
                    return Err(Problem::new(Code::BadValue, detail).pointer(pointer));
                }
                1 => *weights = vec![weights[0]; frames],
                length if length == frames => {}
                length => {
                    let detail = format!(
                        "`{name}` has {length} weights here, but another list of weights has \
                         {frames}: one for each frame"
                    );
                    return Err(Problem::new(Code::ShapeMismatch, detail).pointer(pointer));
                }
            }
        }
        for frame in 0..frames {
            let sum: f64 = self
                .images
                .iter()
                .map(|entry| entry.weights(name)[frame])
                .sum();
            #[expect(clippy::cast_precision_loss, reason = "at most 200 images")]
            if (sum - 1.0).abs() > SUM_ROUNDING * images as f64 {
                let of = if frames > 1 {
                    format!(" of frame {frame}")
                } else {
                    String::new()
                };
                let detail = format!(
                    "the `{name}` weights{of} add up to {sum}; they must add up to 1, or the \
                     result would be larger or brighter than its images"
                );
                return Err(Problem::new(Code::BadValue, detail)
                    .pointer(format!("/images/0/{name}"))
                    .actual(sum));
            }
        }
        Ok(())
    }

    /// The part of the frame of the first image that is drawn, and its size in pixels.
    /// Errors: a canvas that depends on a pose; more pixels than the limits allow.
    pub fn target(&self, first: Extent, limits: &Limits) -> Result<(Canvas, Target), Problem> {
        let canvas = match self.output.canvas {
            CanvasSpec::Same => Canvas::of(first),
            CanvasSpec::Box(canvas) => canvas,
            CanvasSpec::Fit => {
                let detail = "the canvas `fit` depends on one posed image; a blend has several: \
                    send `same`, which is the box of the first image, or a box";
                return Err(Problem::new(Code::BadValue, detail).pointer("/output/canvas"));
            }
        };
        let output = OutputSpec {
            canvas: CanvasSpec::Box(canvas),
            ..self.output
        };
        let target = output.target_before_pose(first, limits)?;
        let target = target.ok_or_else(|| Problem::new(Code::Internal, "a canvas is known"))?;
        Ok((canvas, target))
    }

    /// The weights of the images' shapes in a frame.
    pub fn shape_weights(&self, frame: usize) -> Vec<f64> {
        self.images.iter().map(|entry| entry.shape[frame]).collect()
    }

    /// The weights of the images' colours in a frame.
    pub fn colour_weights(&self, frame: usize) -> Vec<f64> {
        self.images
            .iter()
            .map(|entry| entry.colour[frame])
            .collect()
    }
}

impl BlendEntry {
    fn read(node: &Node<'_, '_>) -> Result<Self, Problem> {
        let [image, session, shape, colour, mirror, pairs, p, names, item] =
            node.fields(&fields::BLEND_IMAGE)?;
        let source = match (image, session) {
            (Some(image), None) => BlendSource::Part(count(&image, 0, PART)? as usize),
            (None, Some(session)) => BlendSource::Session(session.string("the id of a session")?),
            _ => {
                return Err(node.problem(
                    Code::BadValue,
                    "give `image`, the number of a part, or `session`, an id",
                ));
            }
        };
        let index =
            |_, item: Node<'_, '_>| count(&item, 0, "the index of a handle").map(|n| n as usize);
        let is_mirrored = optional(mirror, Node::bool)?.unwrap_or(false);
        if let (Some(pairs), false) = (&pairs, is_mirrored) {
            let detail = "`pairs` belongs to an image with `\"mirror\": true`";
            return Err(pairs.problem(Code::BadValue, detail));
        }
        let p = optional(p, handles)?;
        // The handles of a session are not known here.
        let count = p.as_ref().map(Vec::len);
        let name = |_, item: Node<'_, '_>| item.string("a name");
        let of_names = |node: &Node<'_, '_>| {
            let names = node.list(NAMES, NAME_TEXT, name)?;
            let Some(count) = count.filter(|count| *count != names.len()) else {
                return Ok(names);
            };
            let detail = format!("`names` has {}, but `p` has {count}", names.len());
            Err(node.problem(Code::ShapeMismatch, detail))
        };
        Ok(Self {
            source,
            shape: optional(shape, weights)?.unwrap_or_default(),
            colour: optional(colour, weights)?.unwrap_or_default(),
            is_mirrored,
            pairs: optional(pairs, |node| node.list(PAIRS, NUMBER_TEXT, index))?,
            names: optional(names, of_names)?,
            p,
            item: optional(item, Item::read)?,
        })
    }

    fn weights(&self, name: &str) -> &Vec<f64> {
        if name == "shape" {
            &self.shape
        } else {
            &self.colour
        }
    }

    fn weights_mut(&mut self, name: &str) -> &mut Vec<f64> {
        if name == "shape" {
            &mut self.shape
        } else {
            &mut self.colour
        }
    }
}

fn weights(node: &Node<'_, '_>) -> Result<Vec<f64>, Problem> {
    let weight = |node: &Node<'_, '_>| number_in(node, -MOST_WEIGHT..=MOST_WEIGHT, WEIGHT);
    if node.kind() != Kind::Array {
        return Ok(vec![weight(node)?]);
    }
    let weights = node.list(WEIGHT, NUMBER_TEXT, |index, item| {
        // One more than the most is enough to refuse all of them.
        if index > MOST_FRAMES {
            Ok(0.0)
        } else {
            weight(&item)
        }
    })?;
    if weights.len() < 2 {
        return Err(node.unexpected(
            "at least two weights in a list",
            format_args!("{}", weights.len()),
        ));
    }
    Ok(weights)
}

fn reference(node: &Node<'_, '_>) -> Result<ShapeReference, Problem> {
    match node.kind() {
        Kind::String if node.string(REFERENCE)? == "mean" => Ok(ShapeReference::Mean),
        Kind::Number => Ok(ShapeReference::Image(count(node, 0, REFERENCE)? as usize)),
        Kind::Array => handles(node).map(ShapeReference::Shape),
        Kind::Null | Kind::Bool | Kind::String | Kind::Object => {
            Err(node.unexpected(REFERENCE, node.text))
        }
    }
}

/// What the report of a blend says of one frame.
#[derive(Debug, Serialize)]
pub struct BlendReport {
    /// The file of the frame.
    pub picture: String,
    /// Shares of the shape, in the order of the images.
    pub shape: Vec<f64>,
    /// Shares of the colours.
    pub colour: Vec<f64>,
    /// Samples that were cut off below 0 or above the largest value.
    pub clamped: u64,
    /// Drawn cells that fold, for each image.
    pub folds: Vec<u64>,
    /// Width of the picture, px.
    pub width: u32,
    /// Height of the picture, px.
    pub height: u32,
    /// The part of the reference frame that the picture shows.
    pub canvas: AsJson<Canvas>,
    /// Indices of the landmarks that all images have, of those of the first one.
    pub landmarks: Vec<usize>,
}
