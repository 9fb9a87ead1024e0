//! What the subcommands read: files or standard input, handles from a warp object or landmark files, the size of an image.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use bytes::Bytes;
use mlswarp::codec::{self, StepCounter};
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Setup, WarpError, choose};
use rayon::ThreadPool;
use serde_json::json;

use super::failure::Failure;
use crate::config::{Config, ExtentInput, WarpInput};
use crate::problem::{Code, Problem};
use crate::wire::landmarks::{Choice, LandmarkFiles, Landmarks, extent};
use crate::wire::{WarpObject, extent_in, merged, with_field, without};

/// What a file with a warp object is called; it has a limit of its own.
const WARP: &str = "warp object";

/// Whether a path stands for standard input or output.
pub(super) fn is_stdio(path: &Path) -> bool {
    path == Path::new("-")
}

/// Reads a file or standard input.
/// Errors: It cannot be read, or has more bytes than `limit`.
pub(super) fn read(what: &str, path: &Path, limit: u64) -> Result<Vec<u8>, Failure> {
    let cannot = |e: io::Error| Failure::Local(format!("cannot read the {what} {path:?}: {e}"));
    let source: Box<dyn Read> = if is_stdio(path) { Box::new(io::stdin().lock()) } else { Box::new(File::open(path).map_err(cannot)?) };
    let mut bytes = Vec::new();
    source.take(limit.saturating_add(1)).read_to_end(&mut bytes).map_err(cannot)?;
    if bytes.len() as u64 > limit {
        let flag = if what == WARP { "--max-warp-json-bytes" } else { "--max-body-bytes" };
        let is = if what.ends_with('s') { "are" } else { "is" };
        let detail = format!("the {what} {is} larger than {limit} bytes; {flag} raises the limit");
        return Err(Problem::new(Code::TooLarge, detail).into());
    }
    Ok(bytes)
}

impl WarpInput {
    /// Errors: Standard input is more than one of these files and `others`.
    pub(super) fn require_one_stdin(&self, others: &[Option<&PathBuf>]) -> Result<(), Failure> {
        let files = [self.warp.as_ref(), self.landmarks.as_ref(), self.landmarks_q.as_ref()];
        if files.iter().chain(others).flatten().filter(|path| is_stdio(path)).count() < 2 {
            return Ok(());
        }
        Err(Failure::Local("standard input can be one of the input files only".to_owned()))
    }

    /// The text of the warp object with what options replace; an empty object if there is none.
    /// Errors: As [`read`]; not a JSON object.
    pub(super) fn json(&self, config: &Config) -> Result<Vec<u8>, Failure> {
        let warp = self.warp.as_deref().map_or_else(|| Ok(b"{}".to_vec()), |path| read(WARP, path, config.max_warp_json_bytes))?;
        match &self.align {
            Some(class) => Ok(with_field(&warp, "align", &json!(class).to_string())?),
            None => Ok(warp),
        }
    }

    /// The landmark files, if there are any.
    /// Errors: A file that cannot be read.
    pub(super) fn landmark_files(&self, config: &Config) -> Result<Option<LandmarkFiles>, Failure> {
        let Some(path) = &self.landmarks else { return Ok(None) };
        let file = |path: &Path| read("landmark file", path, config.max_body_bytes).map(Bytes::from);
        let extent = |name: &str, text: &Option<String>| text.as_ref().map(|text| extent(name, text)).transpose();
        let mut choice = Choice::default();
        for (name, text) in [("match", &self.matching), ("item", &self.item)] {
            text.as_ref().map_or(Ok(()), |text| choice.add_text(name, text))?;
        }
        let extents = LandmarkFiles {
            extent_p: extent("--extent-p", &self.extent_p)?,
            extent_q: extent("--extent-q", &self.extent_q)?,
            choice,
            ..LandmarkFiles::default()
        };
        Ok(Some(match &self.landmarks_q {
            Some(q) => LandmarkFiles { p: Some(file(path)?), q: Some(file(q)?), ..extents },
            None => LandmarkFiles { both: Some(file(path)?), ..extents },
        }))
    }

    /// Landmarks of both sides, if there are landmark files. `warp`: the text of the warp object, which may choose what is read of them.
    /// Errors: As [`Self::landmark_files`]; landmarks of one side.
    pub(super) fn landmarks(&self, config: &Config, warp: &[u8]) -> Result<Option<Landmarks>, Failure> {
        let Some(mut files) = self.landmark_files(config)? else { return Ok(None) };
        files.choice.add(Choice::of_warp(warp)?)?;
        let landmarks = files.read(config.limits().columns, &|| false)?;
        landmarks.require_q()?;
        Ok(Some(landmarks))
    }
}

impl ExtentInput {
    /// The size that an option gives.
    /// Errors: The image cannot be read.
    fn read(&self, config: &Config) -> Result<Option<Extent>, Failure> {
        if let Some(text) = &self.extent {
            return Ok(Some(extent("--extent", text)?));
        }
        let Some(path) = &self.image else { return Ok(None) };
        Ok(Some(extent_of(config, &read("image", path, config.max_body_bytes)?)?))
    }
}

/// The size of an image file, from its header.
/// Errors: Not an image, or one over the limits.
pub(super) fn extent_of(config: &Config, file: &[u8]) -> Result<Extent, WarpError> {
    let extent = codec::probe(file, &StepCounter::new(&|| false))?.extent;
    config.limits().image.check(extent)?;
    Ok(extent)
}

/// The body of a request with a whole warp object and the size of its image; `more`: the text of another object with fields of the
/// request.
/// Errors: A file that cannot be read, or no size.
pub(super) fn body(config: &Config, input: &WarpInput, size: &ExtentInput, more: Option<&[u8]>) -> Result<Bytes, Failure> {
    let mut json = input.json(config)?;
    let given = size.read(config)?;
    let missing = "the size of the image is missing; give --extent WIDTH,HEIGHT, --image FILE, or `extent` in the warp object";
    let extent = given.or(extent_in(&json)?).ok_or_else(|| Failure::Local(missing.to_owned()))?;
    let handles = match input.landmarks(config, &json)? {
        Some(landmarks) => {
            json = without(&json, &["match", "item"])?;
            json!(landmarks.scale(Some(extent))?).to_string()
        }
        None => "{}".to_owned(),
    };
    let size = given.map_or_else(|| "{}".to_owned(), |size| json!({"extent": [size.width(), size.height()]}).to_string());
    Ok(merged(&[&json, handles.as_bytes(), size.as_bytes(), more.unwrap_or(b"{}")])?.into())
}

/// Resolves a warp object as the server does: places the handles of landmark files, applies the strength and chooses the method.
/// Errors: Wrong handles.
pub(super) fn resolve(config: &Config, object: &mut WarpObject, landmarks: Option<Landmarks>, extent: Extent) -> Result<Setup, Failure> {
    if let Some(landmarks) = landmarks {
        landmarks.place_in(object, extent)?;
    }
    object.settle_pose(extent)?;
    if object.is_auto {
        object.require_choice()?;
        let chosen = choose(&object.rest, object.posed()?, extent, config.max_fit_handles as u64, &|| false)?;
        object.choose(chosen);
    }
    Ok(Setup::new(&object.rest, extent, &config.limits())?)
}

/// The compute threads.
/// Errors: They cannot be started.
pub(super) fn threads(config: &Config) -> Result<ThreadPool, Failure> {
    let threads = rayon::ThreadPoolBuilder::new().num_threads(config.work.workers).build();
    threads.map_err(|e| Failure::Local(format!("cannot start compute threads: {e}")))
}
