//! What the subcommands read: files or standard input, handles from a warp object or landmark
//! files, the size of an image.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use bytes::Bytes;
use mlswarp::codec::{self, SourceFormat, StepCounter};
use mlswarp::pixmap::Extent;
use mlswarp::warp::WarpError;
use rayon::ThreadPool;
use serde_json::json;

use super::failure::{Failure, name_of};
use crate::config::{Config, ExtentInput, LandmarkInput, WarpInput};
use crate::problem::{Code, Problem};
use crate::wire::landmarks::{BesideFiles, Choice, LandmarkFiles, Landmarks, Target, extent};
use crate::wire::{Merged, NamedObject, Reserved, extent_in};

/// Whether a path stands for standard input or output.
pub(super) fn is_stdio(path: &Path) -> bool {
    path == Path::new("-")
}

/// The most bytes of a file, and the option that sets them.
#[derive(Clone, Copy)]
pub(super) struct Limit(u64, &'static str);

impl Limit {
    pub(super) const fn body(config: &Config) -> Self {
        Self(config.max_body_bytes, "--max-body-bytes")
    }

    pub(super) const fn json(config: &Config) -> Self {
        Self(config.max_warp_json_bytes, "--max-warp-json-bytes")
    }
}

/// Reads a file or standard input.
/// Errors: the file cannot be read, or has more bytes than the limit.
pub(super) fn read(what: &str, path: &Path, Limit(limit, flag): Limit) -> Result<Vec<u8>, Failure> {
    let cannot = |e: io::Error| Failure::Local(format!("cannot read the {what} {path:?}: {e}"));
    if path.is_dir() {
        return Err(Failure::Local(format!(
            "{path:?} is a folder; the {what} {} one file",
            is(what)
        )));
    }
    let source: Box<dyn Read> = if is_stdio(path) {
        Box::new(io::stdin().lock())
    } else {
        Box::new(File::open(path).map_err(cannot)?)
    };
    let mut bytes = Vec::new();
    source
        .take(limit.saturating_add(1))
        .read_to_end(&mut bytes)
        .map_err(cannot)?;
    if bytes.len() as u64 > limit {
        let problem = Problem::new(
            Code::TooLarge,
            format!(
                "the {what} {} larger than {limit} bytes; {flag} raises the limit",
                is(what)
            ),
        );
        return Err(Failure::from(problem).about(name_of(path)));
    }
    Ok(bytes)
}

fn is(what: &str) -> &'static str {
    if what.ends_with('s') { "are" } else { "is" }
}

/// What the object with the handles is called.
const WARP: &str = "warp object";

/// A JSON file as a source of fields.
/// Errors: As [`read`]; a file of another kind.
pub(super) fn source(what: &str, path: &Path, limit: Limit) -> Result<NamedObject, Failure> {
    let (name, json) = (name_of(path), read(what, path, limit)?);
    if SourceFormat::of(&json).is_ok() {
        return Err(Failure::Local(format!(
            "{name} is an image; the {what} {} JSON, and there is one image",
            is(what)
        )));
    }
    let text = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&json);
    let begins = text.trim_ascii_start().first();
    if what == WARP && begins.is_some_and(|byte| !b"{[".contains(byte)) {
        return Err(Failure::Local(format!(
            "{name} is not JSON; the {what} is. A landmark file is given as --landmarks {name}"
        )));
    }
    Ok(NamedObject {
        name,
        json,
        is_option: false,
    })
}

/// The fields of all sources; says on standard error which of them do not count.
/// Errors: A text that is not a JSON object.
pub(super) fn merge(sources: &[NamedObject]) -> Result<Merged, Failure> {
    let merged = Merged::of(sources)
        .map_err(|(index, problem)| Failure::from(problem).about(&*sources[index].name))?;
    merged
        .replaced
        .iter()
        .for_each(|sentence| eprintln!("{sentence}"));
    Ok(merged)
}

/// A problem with a field, with the file or option that gives it.
pub(super) fn located(merged: &Merged, problem: Problem) -> Failure {
    let place = problem
        .pointer
        .as_deref()
        .and_then(|pointer| merged.place(pointer))
        .map(str::to_owned);
    Failure::Problem(problem, place)
}

/// Errors: Standard input is more than one of the files.
pub(super) fn require_one_stdin<'a>(
    files: impl IntoIterator<Item = Option<&'a PathBuf>>,
) -> Result<(), Failure> {
    if files
        .into_iter()
        .flatten()
        .filter(|path| is_stdio(path))
        .count()
        < 2
    {
        return Ok(());
    }
    Err(Failure::Local(
        "standard input can be one of the input files only".to_owned(),
    ))
}

impl LandmarkInput {
    /// Its files.
    pub(super) fn files(&self) -> [Option<&PathBuf>; 2] {
        [self.landmarks.as_ref(), self.landmarks_q.as_ref()]
    }

    /// The landmark files, if there are any.
    /// Errors: A file that cannot be read.
    pub(super) fn read_files(&self, config: &Config) -> Result<Option<LandmarkFiles>, Failure> {
        let Some(path) = &self.landmarks else {
            return Ok(None);
        };
        let file = |path: &Path| read("landmark file", path, Limit::body(config)).map(Bytes::from);
        let extent = |name: &str, text: &Option<String>| {
            text.as_ref().map(|text| extent(name, text)).transpose()
        };
        let mut choice = Choice::default();
        for (name, text) in [("match", &self.matching), ("item", &self.item)] {
            text.as_ref()
                .map_or(Ok(()), |text| choice.add_text(name, text))?;
        }
        let extents = LandmarkFiles {
            extent_p: extent("--extent-p", &self.extent_p)?,
            extent_q: extent("--extent-q", &self.extent_q)?,
            choice,
            ..LandmarkFiles::default()
        };
        Ok(Some(match &self.landmarks_q {
            Some(q) => LandmarkFiles {
                p: Some(file(path)?),
                q: Some(file(q)?),
                ..extents
            },
            None => LandmarkFiles {
                both: Some(file(path)?),
                ..extents
            },
        }))
    }

    /// Landmarks of both sides, if there are landmark files. `warp`: the text of the warp object,
    /// which may choose what is read of them. Errors: As [`Self::read_files`]; landmarks of one
    /// side.
    pub(super) fn read(&self, config: &Config, warp: &[u8]) -> Result<Option<Landmarks>, Failure> {
        let Some(mut files) = self.read_files(config)? else {
            return Ok(None);
        };
        let Choice { matching, item } = Choice::of_warp(warp)?;
        files.choice.matching = files.choice.matching.or(matching);
        files.choice.item = files.choice.item.or(item);
        // There are no other clients that share this machine's memory.
        let landmarks = Reserved::of_files(&files, config.limits().columns, &|| false, |_| Ok(()));
        let (landmarks, ()) = landmarks
            .map_err(|problem| self.blame(problem))?
            .into_parts();
        landmarks
            .require_q()
            .map_err(|problem| self.without_q(problem))?;
        Ok(Some(landmarks))
    }

    /// A problem with landmarks of one side, in the words of the command line.
    pub(super) fn without_q(&self, mut problem: Problem) -> Failure {
        "it has no posed positions: give a file with both sides, or --landmarks-q FILE"
            .clone_into(&mut problem.detail);
        problem.pointer = None;
        Failure::from(problem).about(self.landmarks.as_deref().map(name_of).unwrap_or_default())
    }

    /// A problem with a landmark file, with its name in place of that of the part.
    pub(super) fn blame(&self, mut problem: Problem) -> Failure {
        for (part, path) in [
            ("landmarks", &self.landmarks),
            ("landmarks_p", &self.landmarks),
            ("landmarks_q", &self.landmarks_q),
        ] {
            let Some(rest) = problem
                .detail
                .strip_prefix(part)
                .filter(|rest| rest.starts_with([',', ':']))
            else {
                continue;
            };
            problem.detail = rest[1..].trim_start().to_owned();
            return Failure::Problem(problem, path.as_deref().map(name_of));
        }
        problem.into()
    }
}

impl WarpInput {
    /// Its files.
    pub(super) fn files(&self) -> [Option<&PathBuf>; 3] {
        let [p, q] = self.landmarks.files();
        [self.warp.as_ref(), p, q]
    }

    /// The warp object, if there is one.
    /// Errors: As [`read`].
    pub(super) fn source(&self, config: &Config) -> Result<Option<NamedObject>, Failure> {
        self.warp
            .as_deref()
            .map(|path| source(WARP, path, Limit::json(config)))
            .transpose()
    }
}

impl ExtentInput {
    /// The size that an option gives.
    /// Errors: The image cannot be read.
    fn read(&self, config: &Config) -> Result<Option<Extent>, Failure> {
        if let Some(text) = &self.extent {
            return Ok(Some(extent("--extent", text)?));
        }
        let Some(path) = &self.image else {
            return Ok(None);
        };
        let size = extent_of(config, &read("image", path, Limit::body(config))?);
        Ok(Some(size.map_err(|error| {
            Failure::from(error).about(name_of(path))
        })?))
    }
}

/// The size of an image file, from its header.
/// Errors: Not an image, or one over the limits.
pub(super) fn extent_of(config: &Config, file: &[u8]) -> Result<Extent, WarpError> {
    let extent = codec::probe(file, &StepCounter::new(&|| false))?.extent;
    config.limits().image.check(extent)?;
    Ok(extent)
}

/// The body of a request with a whole warp object and the size of its image.
pub(super) struct Body {
    /// The JSON.
    pub(super) json: Bytes,
    /// Where its fields are from; without their text.
    pub(super) merged: Merged,
}

impl Body {
    /// Reads all of it; `more`: further objects with fields of the request.
    /// Errors: A file that cannot be read, or no size.
    pub(super) fn read(
        config: &Config,
        input: &WarpInput,
        size: &ExtentInput,
        more: Vec<NamedObject>,
    ) -> Result<Self, Failure> {
        let mut sources: Vec<NamedObject> = input.source(config)?.into_iter().chain(more).collect();
        let of = |name: &str, json: String| NamedObject {
            name: name.to_owned(),
            json: json.into_bytes(),
            is_option: true,
        };
        let given = size.read(config)?;
        sources.extend(given.map(|size| {
            of(
                "the size",
                json!({"extent": [size.width(), size.height()]}).to_string(),
            )
        }));
        let mut merged = merge(&sources)?;
        let missing = "the size of the image is missing; give --extent WIDTH,HEIGHT, --image \
            FILE, or `extent` in the warp object";
        let extent = extent_in(&merged.json).map_err(|problem| located(&merged, problem))?;
        extent.ok_or_else(|| Failure::Local(missing.to_owned()))?;
        let mut json = std::mem::take(&mut merged.json);
        if let Some(landmarks) = input.landmarks.read(config, &json)? {
            merged
                .require_no_handles()
                .map_err(|problem| located(&merged, problem))?;
            json = landmarks.into_fields(&BesideFiles::new(&json, &|| false)?, Target::Request)?;
        }
        Ok(Self {
            json: json.into(),
            merged,
        })
    }
}

/// The compute threads.
/// Errors: the threads cannot be started.
pub(super) fn threads(config: &Config) -> Result<ThreadPool, Failure> {
    let threads = rayon::ThreadPoolBuilder::new()
        .num_threads(config.work.workers)
        .build();
    threads.map_err(|e| Failure::Local(format!("cannot start compute threads: {e}")))
}
