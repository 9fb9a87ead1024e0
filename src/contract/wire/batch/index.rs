//! `frames.json`: what the index of a batch says of each frame.

use std::collections::BTreeMap;

use mlswarp::render::Canvas;
use serde::Serialize;

use crate::wire::AsJson;

/// How far a frame is from the handles at rest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FramePosition {
    /// The share of the way from rest to `q`; with a jitter, before the handles are displaced.
    pub strength: f64,
    /// The time of an in-between, 0 to 1; absent of other frames.
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
    /// The name of the image's file.
    pub picture: String,
    /// The names of the layers' files, by those of the layers.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub layers: BTreeMap<String, String>,
    /// The name of the file of annotations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub annotations: Option<String>,
    /// How far the frame is from the handles at rest.
    #[serde(flatten)]
    pub position: FramePosition,
    /// Width of the image, px.
    pub width: u32,
    /// Height of the image, px.
    pub height: u32,
    /// The part of the posed plane that the image shows.
    pub canvas: AsJson<Canvas>,
    /// px of the image in a px of the canvas, along each axis.
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
