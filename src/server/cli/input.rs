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
use crate::wire::landmarks::{LandmarkFiles, Landmarks, extent};
use crate::wire::{AsJson, Reserved, WarpObject, extent_in, merged, with_field};

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
        let flag = if ["warp object", "annotations"].contains(&what) { "--max-warp-json-bytes" } else { "--max-body-bytes" };
        let detail = format!("the {what} is larger than {limit} bytes; {flag} raises the limit");
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
        let warp = self.warp.as_deref().map_or_else(|| Ok(b"{}".to_vec()), |path| read("warp object", path, config.max_warp_json_bytes))?;
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
        let extents = LandmarkFiles {
            extent_p: extent("--extent-p", &self.extent_p)?,
            extent_q: extent("--extent-q", &self.extent_q)?,
            ..LandmarkFiles::default()
        };
        Ok(Some(match &self.landmarks_q {
            Some(q) => LandmarkFiles { p: Some(file(path)?), q: Some(file(q)?), ..extents },
            None => LandmarkFiles { both: Some(file(path)?), ..extents },
        }))
    }

    /// Landmarks of both sides, if there are landmark files.
    /// Errors: As [`Self::landmark_files`]; landmarks of one side.
    pub(super) fn landmarks(&self, config: &Config) -> Result<Option<Landmarks>, Failure> {
        let Some(files) = self.landmark_files(config)? else { return Ok(None) };
        // Nobody shares this machine's memory with other clients.
        let landmarks = Reserved::of_files(&files, config.limits().columns, &|| false, |_| Ok(()))?;
        let (landmarks, ()) = landmarks.into_parts();
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
    let steps = StepCounter::new(&|| false);
    Ok(codec::open(file, &config.limits().image, &steps)?.header().extent)
}

/// The body of a request with a whole warp object and the size of its image.
pub(super) struct Body {
    /// The JSON.
    pub(super) json: Bytes,
    /// A landmark was left out because the other side does not have its name.
    pub(super) has_unmatched: bool,
}

impl Body {
    /// Reads all of it; `more`: the text of another object with fields of the request.
    /// Errors: A file that cannot be read, or no size.
    pub(super) fn read(config: &Config, input: &WarpInput, size: &ExtentInput, more: Option<&[u8]>) -> Result<Self, Failure> {
        let json = input.json(config)?;
        let given = size.read(config)?;
        let missing = "the size of the image is missing; give --extent WIDTH,HEIGHT, --image FILE, or `extent` in the warp object";
        let extent = given.or(extent_in(&json)?).ok_or_else(|| Failure::Local(missing.to_owned()))?;
        let landmarks = input.landmarks(config)?;
        let has_unmatched = landmarks.as_ref().is_some_and(Landmarks::has_unmatched);
        let handles = landmarks.map(|landmarks| {
            let mut object = WarpObject::default();
            landmarks.place_in(&mut object, extent)?;
            let [p, q] = [&object.rest.p, object.posed()?].map(AsJson);
            Ok::<_, Failure>(json!({"p": p, "q": q, "units": "px"}).to_string())
        });
        let handles = handles.transpose()?.unwrap_or_else(|| "{}".to_owned());
        let size = given.map_or_else(|| "{}".to_owned(), |size| json!({"extent": [size.width(), size.height()]}).to_string());
        let json = merged(&[&json, handles.as_bytes(), size.as_bytes(), more.unwrap_or(b"{}")])?.into();
        Ok(Self { json, has_unmatched })
    }
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
