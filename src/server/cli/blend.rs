//! `mlswarp blend IMAGE... [BLEND.json] -o OUT`: `POST /blend` without a server, with the same
//! bytes.

use std::collections::HashMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use bytes::Bytes;
use mlswarp::codec::Format;
use serde_json::{Value, json};

use super::failure::{Failure, name_of};
use super::frames::{FramesOutput, ProgressBar, format_of, number_of, with_summary};
use super::images::{Inputs, companion};
use super::input::{Limit, is_stdio};
use super::options::require_quality_of_jpeg;
use super::service::{Service, summary};
use super::{input, output};
use crate::app::batch::BatchForm;
use crate::app::blend::{self, BlendAnswer, BlendUpload};
use crate::app::draw::Drawn;
use crate::config::{BlendArgs, Config};
use crate::problem::{Code, Problem};
use crate::wire::blend::BlendObject;
use crate::wire::formats::Formats;
use crate::wire::{EnumName as _, Merged, NamedObject, Reserved};

/// Blends images. The result: how many, and the warnings that a server sends. Errors: See
/// [`Failure`].
pub fn run(config: &Config, args: &BlendArgs) -> Result<Option<String>, Failure> {
    let BlendArgs {
        files,
        landmarks,
        out,
        quiet,
        ..
    } = args;
    input::require_one_stdin(files.iter().chain(landmarks).map(Some))?;
    let inputs = Inputs::of(files, Limit::body(config))?;
    let mut blend = BlendInputs::read(config, args, &inputs)?;
    let object = Reserved::<BlendObject, _>::parse(&blend.merged.json, |_| Ok(()));
    let frames = object.map_err(|problem| blend.blame(problem))?.frames;
    let kind = kind_of(out, frames, &blend.merged)?;
    output::require_directory(out)?;
    let (format, cure) = match kind {
        Kind::Picture(format) => (format, "give --format jpeg, or a file that ends in .jpg"),
        Kind::Frames(kind) => format_of(kind, &blend.merged),
    };
    require_quality_of_jpeg(&args.file, format, cure)?;
    let read: Vec<PathBuf> = files
        .iter()
        .chain(&blend.images)
        .chain(&blend.landmarks)
        .cloned()
        .collect();
    output::require_other(out, &read)?;
    let form = match kind {
        Kind::Picture(format) => {
            blend.set_format(format)?;
            None
        }
        Kind::Frames(kind) => Some(kind.form()),
    };
    let mut upload = BlendUpload {
        blend: blend.merged.json.clone().into(),
        landmarks: read_landmarks(config, &blend.landmarks)?,
        ..BlendUpload::default()
    };
    for file in &inputs.images {
        upload
            .images
            .push(file.read("image", Limit::body(config))?.into());
    }
    let service = Service::start(config)?;
    let blended = service.run(blend::once(
        &service.app,
        service.client,
        upload,
        Formats::ANY,
        (form, true),
    ));
    let images = number_of(blend.entries.len(), "image");
    match (blended.map_err(|problem| blend.blame(problem))?, kind) {
        (BlendAnswer::Package(_, first, mut rest), Kind::Frames(kind)) => {
            let progress = ProgressBar::new(u32::try_from(frames).unwrap_or(u32::MAX), *quiet);
            let next = || {
                let part = service.run(async { rest.next().await.transpose() });
                part.map_err(|problem| blend.blame(problem))
            };
            kind.write(out, (first, next), &progress, &read)?;
            let what = format!("{} of {images}", number_of(frames, "frame"));
            Ok(Some(with_summary(what, summary(None, rest.warnings()))))
        }
        (BlendAnswer::Picture(drawn), _) => {
            let summary = summary(None, &drawn.report.warnings);
            write_picture(&service, *drawn, out)?;
            Ok(Some(with_summary(images, summary)))
        }
        (BlendAnswer::Package(..), Kind::Picture(_)) => {
            Err(Failure::Local("a picture became an archive".to_owned()))
        }
    }
}

fn write_picture(service: &Service, drawn: Drawn, out: &Path) -> Result<(), Failure> {
    let Drawn {
        first, mut rest, ..
    } = drawn;
    output::write(out, |sink| {
        let mut piece = first;
        while let (None, Some(rest)) = (piece.end, &mut rest) {
            sink.put(&piece.bytes)?;
            let next = service.run(async { Ok(rest.recv().await) })?;
            piece = next.ok_or_else(|| Problem::new(Code::Internal, "drawing has failed"))?;
        }
        sink.put(&piece.bytes)
    })
}

/// What is written.
#[derive(Clone, Copy)]
enum Kind {
    Picture(Format),
    Frames(FramesOutput),
}

/// Errors: An end of a name that is not known, or of a format that has one image for several.
fn kind_of(out: &Path, frames: usize, merged: &Merged) -> Result<Kind, Failure> {
    let is_directory = output::is_directory(out);
    let is_stream = is_stdio(out) || out.exists() && !out.is_file() && !is_directory;
    let picture = |of_name: Option<Format>| {
        let named = merged.place("/output/format").is_some();
        let requested = named.then(|| format_of(FramesOutput::Directory, merged).0);
        Kind::Picture(requested.or(of_name).unwrap_or_default())
    };
    if is_stream {
        return Ok(match frames {
            1 => picture(None),
            _ => Kind::Frames(FramesOutput::File(BatchForm::Zip)),
        });
    }
    if is_directory {
        return Ok(Kind::Frames(FramesOutput::Directory));
    }
    let of_format = |format: Format| {
        let ends = format.info().extensions.iter();
        ends.map(move |end| (*end, Kind::Picture(format)))
    };
    let packages = [
        ("zip", BatchForm::Zip),
        ("apng", BatchForm::Apng),
        ("gif", BatchForm::Gif),
    ];
    let packages = packages.map(|(end, form)| (end, Kind::Frames(FramesOutput::File(form))));
    let known: Vec<_> = Format::ALL
        .into_iter()
        .flat_map(of_format)
        .chain(packages)
        .collect();
    match output::by_extension(out, &known, ", or a folder")? {
        None if frames > 1 => Ok(Kind::Frames(FramesOutput::Directory)),
        None => Ok(picture(None)),
        Some(Kind::Picture(Format::Png)) if frames > 1 => {
            Ok(Kind::Frames(FramesOutput::File(BatchForm::Apng)))
        }
        Some(Kind::Picture(_)) if frames > 1 => Err(Failure::Local(format!(
            "{frames} frames cannot be written to {}: give .zip, .gif, .png or .apng, or a folder, \
             such as -o frames/",
            name_of(out)
        ))),
        Some(Kind::Picture(format)) => Ok(picture(Some(format))),
        Some(kind) => Ok(kind),
    }
}

/// What is known of a blend before its files are read.
struct BlendInputs<'a> {
    args: &'a BlendArgs,
    images: Vec<PathBuf>,
    /// One for each image, or none.
    landmarks: Vec<PathBuf>,
    sources: Vec<NamedObject>,
    /// The whole object.
    merged: Merged,
    /// Its `images`.
    entries: Vec<Value>,
}

impl<'a> BlendInputs<'a> {
    /// Reads the blend object and the options. Without `images` in it, each image is an entry.
    /// Errors: Another number of weights or landmark files than of images.
    fn read(config: &Config, args: &'a BlendArgs, inputs: &Inputs) -> Result<Self, Failure> {
        let images: Vec<PathBuf> = inputs.images.iter().map(|file| file.path.clone()).collect();
        let sources = sources(config, args, inputs)?;
        let merged = input::merge(&sources)?;
        let entries: Vec<Value> = match merged.value("images").map(serde_json::from_str) {
            Some(entries) => entries.unwrap_or_default(),
            None => (0..images.len()).map(|k| json!({"image": k})).collect(),
        };
        let landmarks = landmark_files(&args.landmarks, &images, &entries)?;
        let mut blend = Self {
            args,
            images,
            landmarks,
            sources,
            merged,
            entries,
        };
        let is_changed = blend.name_items() | blend.weigh()?;
        if is_changed || !blend.merged.has("images") {
            blend.set(json!({"images": blend.entries}))?;
        }
        Ok(blend)
    }

    /// Replaces a field.
    fn set(&mut self, json: Value) -> Result<(), Failure> {
        self.sources.push(NamedObject {
            name: "the images".to_owned(),
            json: json.to_string().into_bytes(),
            is_option: true,
        });
        // The warnings about what one file replaces of another have been written before.
        let merged = Merged::of(&self.sources);
        self.merged = merged.map_err(|(_, problem)| Failure::from(problem))?;
        Ok(())
    }

    /// The end of the name of the output has chosen a format.
    fn set_format(&mut self, format: Format) -> Result<(), Failure> {
        self.set(json!({"output": {"format": format.as_str()}}))
    }

    /// The path of the image of an entry.
    fn path_of(&self, entry: &Value) -> Option<(usize, &Path)> {
        let index = usize::try_from(entry.get("image")?.as_u64()?).ok()?;
        Some((index, self.images.get(index)?))
    }

    /// Where one landmark file is that of several different images, it has an item for each, which
    /// has the name of the image file. Returns whether any was named.
    fn name_items(&mut self) -> bool {
        let [first, others @ ..] = &self.landmarks[..] else {
            return false;
        };
        let is_one_image = self.images.iter().all(|image| *image == self.images[0]);
        if is_one_image || others.iter().any(|file| file != first) {
            return false;
        }
        let name =
            |entry: &Value| Some(json!(self.path_of(entry)?.1.file_name()?.to_string_lossy()));
        let names: Vec<Option<Value>> = self.entries.iter().map(name).collect();
        for (entry, name) in self.entries.iter_mut().zip(names) {
            if let (Some(entry), Some(name)) = (entry.as_object_mut(), name) {
                entry.entry("item").or_insert(name);
            }
        }
        true
    }

    /// Gives the entries the weights of the options. Returns whether there are any.
    fn weigh(&mut self) -> Result<bool, Failure> {
        let options = [("shape", &self.args.shape), ("colour", &self.args.colour)];
        let given = options
            .into_iter()
            .filter_map(|(field, text)| Some((field, text.as_ref()?)));
        let mut is_changed = false;
        for (field, text) in given {
            is_changed = true;
            let weights = weights(field, text, self.entries.len())?;
            for (entry, weight) in self.entries.iter_mut().zip(weights) {
                if let Some(entry) = entry.as_object_mut() {
                    entry.insert(field.to_owned(), json!(weight));
                }
            }
        }
        Ok(is_changed)
    }

    /// A problem with an image, its landmarks or a field, with the file or option that it is about.
    fn blame(&self, mut problem: Problem) -> Failure {
        let pointer = problem.pointer.clone().unwrap_or_default();
        let mut path = pointer
            .strip_prefix("/images/")
            .unwrap_or_default()
            .split('/');
        let index: Option<usize> = path.next().and_then(|index| index.parse().ok());
        let field = path.next();
        let of_options = [("shape", &self.args.shape), ("colour", &self.args.colour)];
        if let Some((field, _)) = of_options
            .into_iter()
            .find(|(name, text)| Some(*name) == field && text.is_some())
        {
            return Failure::Problem(problem, Some(format!("--{field}")));
        }
        let entry = index.and_then(|index| Some((index, self.entries.get(index)?)));
        let image = entry.and_then(|(index, entry)| Some((index, self.path_of(entry)?)));
        let (Some((index, (number, image))), None) = (image, field) else {
            return input::located(&self.merged, problem);
        };
        if let Some(rest) = problem.detail.strip_prefix(&format!("image {index}: ")) {
            problem.detail = rest.to_owned();
        }
        problem.pointer = None;
        let of_landmarks = problem.detail.strip_prefix("landmarks");
        match (of_landmarks, self.landmarks.get(number)) {
            (Some(rest), Some(file)) if rest.starts_with([',', ':']) => {
                problem.detail = rest[1..].trim_start().to_owned();
                Failure::Problem(problem, Some(name_of(file)))
            }
            _ => Failure::Problem(problem, Some(name_of(image))),
        }
    }
}

/// The blend object and the options.
fn sources(
    config: &Config,
    args: &BlendArgs,
    inputs: &Inputs,
) -> Result<Vec<NamedObject>, Failure> {
    let blend = inputs.warp.as_ref().map(|file| {
        let json = file.read("blend object", Limit::json(config))?;
        Ok::<_, Failure>(NamedObject {
            name: name_of(&file.path),
            json,
            is_option: false,
        })
    });
    let mut sources: Vec<NamedObject> = blend.transpose()?.into_iter().collect();
    sources.extend(args.sources());
    sources.extend(args.frame.sources()?);
    sources.extend(args.file.sources());
    Ok(sources)
}

/// `--shape` and `--colour`: a number for each image; of two images also that of the second alone.
fn weights(field: &str, text: &str, images: usize) -> Result<Vec<f64>, Failure> {
    let number = |text: &str| {
        text.trim()
            .parse()
            .ok()
            .filter(|number: &f64| number.is_finite())
    };
    let numbers: Option<Vec<f64>> = text.split(',').map(number).collect();
    match numbers.as_deref() {
        Some([share]) if images == 2 => Ok(vec![1.0 - share, *share]),
        Some(numbers) if numbers.len() == images => Ok(numbers.to_vec()),
        _ => {
            let of_two = if images == 2 {
                ", or that of the second"
            } else {
                ""
            };
            let detail = format!(
                "expected {}, such as {}{of_two}; found {text:?}",
                number_of(images, "number"),
                vec!["1"; images.min(3)].join(",")
            );
            let problem = Problem::new(Code::BadValue, detail);
            Err(Failure::from(problem).about(format!("--{field}")))
        }
    }
}

/// The landmark file of each image: that of the same name in a folder or among the files, otherwise
/// that at the same place; without an option the one beside the image, unless the JSON has the
/// handles. One file may be that of all images. Errors: None, or several.
fn landmark_files(
    given: &[PathBuf],
    images: &[PathBuf],
    entries: &[Value],
) -> Result<Vec<PathBuf>, Failure> {
    const WHAT: &str = "landmark file";
    match given {
        [] if entries.iter().any(|entry| entry.get("p").is_some()) => Ok(Vec::new()),
        [] => {
            let beside = |image: &PathBuf| {
                let folder = image.parent().filter(|folder| *folder != OsStr::new(""));
                companion(WHAT, folder.unwrap_or(Path::new(".")), image, false)
            };
            images.iter().map(beside).collect()
        }
        [folder] if folder.is_dir() => {
            let inside = |image: &PathBuf| companion(WHAT, folder, image, false);
            images.iter().map(inside).collect()
        }
        [file] => Ok(vec![file.clone(); images.len()]),
        files if files.len() == images.len() => {
            let by_stem: HashMap<_, _> =
                files.iter().map(|file| (file.file_stem(), file)).collect();
            let named = images.iter().map(|image| by_stem.get(&image.file_stem()));
            let named: Option<Vec<_>> =
                named.map(|file| file.map(|file| (*file).clone())).collect();
            Ok(named.unwrap_or_else(|| files.to_vec()))
        }
        files => Err(Failure::Local(format!(
            "{} for {}: give one for each image, a folder, or one file with an item for each image",
            number_of(files.len(), WHAT),
            number_of(images.len(), "image"),
        ))),
    }
}

/// The contents; a file of several images is read once.
fn read_landmarks(config: &Config, files: &[PathBuf]) -> Result<Vec<Bytes>, Failure> {
    let mut contents: HashMap<&Path, Bytes> = HashMap::new();
    let mut content = |path| {
        if let Some(bytes) = contents.get(path) {
            return Ok(Bytes::clone(bytes));
        }
        let bytes = Bytes::from(input::read("landmark file", path, Limit::body(config))?);
        contents.insert(path, bytes.clone());
        Ok(bytes)
    };
    files.iter().map(|path| content(&**path)).collect()
}
