//! `mlswarp batch IMAGE WARP.json [BATCH.json] -o OUT`: a session and `POST /sessions/{id}/batch`
//! without a server.

use std::path::{Path, PathBuf};

use bytes::Bytes;
use serde_json::json;

use super::failure::{Failure, name_of};
use super::frames::{FramesOutput, ProgressBar, format_of, number_of, with_summary};
use super::input::{Limit, is_stdio};
use super::options::require_quality_of_jpeg;
use super::service::{Service, summary};
use super::{input, output};
use crate::app::batch::{self, Batch, BatchForm};
use crate::app::layers::{self, bad_name};
use crate::app::upload::Upload;
use crate::app::{landmarks, sessions};
use crate::config::{BatchArgs, Config};
use crate::layer::{LayerKind, LayerName};
use crate::problem::words::quote;
use crate::problem::{Code, Problem};
use crate::wire::{Merged, NamedObject, split_batch};

/// Draws a batch. The result: the number of frames, and what a server sends in response headers.
/// Errors: See [`Failure`].
pub fn run(config: &Config, args: &BatchArgs) -> Result<Option<String>, Failure> {
    let BatchArgs {
        image,
        input: handles,
        batch,
        region,
        out,
        quiet,
        ..
    } = args;
    let layers = args.layers.iter().map(|text| LayerOption::parse(text));
    let layers = layers.collect::<Result<Vec<_>, _>>()?;
    let of_layers = layers.iter().filter_map(|layer| layer.file.clone());
    let others = [Some(image), batch.as_ref(), region.as_ref()];
    let read: Vec<PathBuf> = handles
        .files()
        .into_iter()
        .chain(others)
        .flatten()
        .cloned()
        .chain(of_layers)
        .collect();
    input::require_one_stdin(read.iter().map(Some))?;
    let kind = kind_of(out)?;
    output::require_directory(out)?;
    output::require_other(out, &read)?;
    let merged = input::merge(&sources(config, args)?)?;
    require_poses(&merged)?;
    let located = |problem| input::located(&merged, problem);
    let (format, cure) = format_of(kind, &merged);
    require_quality_of_jpeg(&args.file, format, cure)?;
    let (layers, drawn) = selected(
        layers,
        &merged,
        region.is_some(),
        kind == FramesOutput::Directory,
    )?;
    let whole = Bytes::from(merged.with("layers", drawn));
    let files = handles.landmarks.read_files(config)?;
    let file = input::read("image", image, Limit::body(config))?;
    let mask = region
        .as_deref()
        .map(|path| input::read("region", path, Limit::body(config)).map(Bytes::from))
        .transpose()?;
    let layer_files = read_layers(config, layers)?;
    let service = Service::start(config)?;
    let (app, client) = (&service.app, service.client);
    let form = kind.form();
    let landmarks = match files {
        Some(files) => {
            let read = service.run(landmarks::read(app, client, files, whole.clone()));
            Some(read.map_err(|problem| handles.landmarks.blame(problem))?)
        }
        None => None,
    };
    // Those of one side are handles at rest: the pose of the JSON is the batch's.
    let has_rest_only = landmarks
        .as_ref()
        .is_some_and(|read| read.require_q().is_err());
    let [warp, batch] = split_batch(&whole, !has_rest_only)?;
    let upload = Upload {
        image: file.into(),
        warp: warp.into(),
        region: mask,
        landmarks,
    };
    let session = service.run(sessions::create(app, client, upload));
    let (shown, method) =
        session.map_err(|problem| blame(located(problem), image, region.as_deref()))?;
    let id = shown.session.record.id;
    let made = service.run(async {
        let put = async |name: &LayerName, kind, file| {
            let session = app.sessions.touch(id, None).await?;
            layers::put(app, client, session, name, kind, file)
                .await
                .map(drop)
        };
        put_layers(layer_files, put).await?;
        let record = app.sessions.touch(id, None).await?.record;
        batch::of_session(app, client, record, batch.into(), form, |_| u64::MAX).await
    });
    let made = made.map_err(|problem| {
        match has_rest_only && !merged.has("q") && problem.pointer.as_deref() == Some("/q") {
            true => handles.landmarks.without_q(problem),
            false => located(problem),
        }
    })?;
    let (frames, warnings) = (made.frames, [shown.warnings(), &made.warnings].concat());
    let progress = ProgressBar::new(frames, *quiet);
    let Batch {
        first, mut rest, ..
    } = made;
    let next = || service.next(rest.next());
    kind.write(out, (first, next), &progress, &read)?;
    let frames = number_of(frames as usize, "frame");
    Ok(Some(with_summary(frames, summary(method, &warnings))))
}

/// Errors: Neither a number of in-betweens, nor frames, nor a jitter.
fn require_poses(merged: &Merged) -> Result<(), Failure> {
    let kinds = ["steps", "frames", "jitter"];
    if kinds.iter().any(|poses| merged.has(poses)) {
        return Ok(());
    }
    let detail =
        "the poses are missing: give --steps N, or `steps`, `frames` or `jitter` in the JSON";
    Err(Problem::new(Code::BadValue, detail).into())
}

/// Layers that have a file, with its content.
type LayerFiles = Vec<(String, LayerKind, Vec<u8>)>;

fn read_layers(config: &Config, layers: Vec<LayerOption>) -> Result<LayerFiles, Failure> {
    layers
        .into_iter()
        .filter_map(|layer| Some((layer.name, layer.kind, layer.file?)))
        .map(|(name, kind, path)| {
            let file = input::read("layer", &path, Limit::body(config))?;
            Ok((name, kind, file))
        })
        .collect()
}

/// Adds layers to a session by `put`. Errors name the option.
async fn put_layers(
    layers: LayerFiles,
    put: impl AsyncFn(&LayerName, LayerKind, Bytes) -> Result<(), Problem>,
) -> Result<(), Problem> {
    for (name, kind, file) in layers {
        let name = LayerName::parse(&name).ok_or_else(|| bad_name(&name))?;
        put(&name, kind, file.into()).await.map_err(|mut problem| {
            problem
                .detail
                .insert_str(0, &format!("--layer {}: ", name.as_str()));
            problem
        })?;
    }
    Ok(())
}

/// The files and options with fields of the request.
/// Errors: A file that cannot be read; no poses.
fn sources(config: &Config, args: &BatchArgs) -> Result<Vec<NamedObject>, Failure> {
    let BatchArgs {
        input: handles,
        batch,
        frames,
        pose,
        frame,
        file,
        ..
    } = args;
    let batch = batch
        .as_deref()
        .map(|path| input::source("batch", path, Limit::body(config)))
        .transpose()?;
    let mut sources: Vec<NamedObject> = handles.source(config)?.into_iter().chain(batch).collect();
    sources.extend(frames.sources());
    sources.extend(pose.sources());
    sources.extend(frame.sources()?);
    sources.extend(file.sources());
    Ok(sources)
}

/// The layers that are drawn, and the field `layers` if the JSON does not have it: those of the
/// options, among which the JSON selects. Errors: A layer without a file; names that a folder does
/// not tell apart.
fn selected(
    layers: Vec<LayerOption>,
    merged: &Merged,
    has_region: bool,
    is_directory: bool,
) -> Result<(Vec<LayerOption>, Option<String>), Failure> {
    let has = |name: &str| layers.iter().any(|layer| layer.name == name);
    let named: Option<Vec<String>> = merged
        .value("layers")
        .and_then(|text| serde_json::from_str(text).ok());
    let drawn: Vec<&str> = named.as_ref().map_or_else(
        || layers.iter().map(|l| &*l.name).collect(),
        |names| names.iter().map(|n| &**n).collect(),
    );
    if let Some(name) = drawn
        .iter()
        .find(|name| !name.starts_with('@') && !has(name))
    {
        let detail = format!(
            "{} has no file: give it as --layer {name}=FILE",
            quote(name)
        );
        return Err(input::located(
            merged,
            Problem::new(Code::NoSuchLayer, detail).pointer("/layers"),
        ));
    }
    if drawn.contains(&"@holes") && !has_region && !has("region") {
        return Err(Failure::Local(
            "the layer @holes needs a --region".to_owned(),
        ));
    }
    let is_same = |a: &&str, b: &&str| a != b && a.to_lowercase() == b.to_lowercase();
    let pair = drawn
        .iter()
        .find_map(|name| Some((name, drawn.iter().find(|other| is_same(name, other))?)));
    if let Some((one, other)) = pair.filter(|_| is_directory) {
        let detail = format!(
            "the layers {one} and {other} would be one file where upper and lower case are not \
                told apart; rename one"
        );
        return Err(Failure::Local(detail));
    }
    let field = (named.is_none() && !drawn.is_empty()).then(|| json!(drawn).to_string());
    let is_used = |layer: &LayerOption| layer.name == "region" || drawn.contains(&&*layer.name);
    for layer in layers.iter().filter(|layer| !is_used(layer)) {
        eprintln!(
            "the layer {} is not drawn: `layers` in {} does not name it",
            layer.name,
            merged.place("/layers").unwrap_or_default()
        );
    }
    let used = layers.iter().map(is_used).collect::<Vec<_>>();
    Ok((
        layers
            .into_iter()
            .zip(used)
            .filter_map(|(layer, is_used)| is_used.then_some(layer))
            .collect(),
        field,
    ))
}

/// A problem with a file of the session, with its name.
fn blame(failure: Failure, image: &Path, region: Option<&Path>) -> Failure {
    let Failure::Problem(mut problem, None) = failure else {
        return failure;
    };
    if let (Some(rest), Some(region)) = (problem.detail.strip_prefix("the part `region`: "), region)
    {
        problem.detail = rest.to_owned();
        return Failure::Problem(problem, Some(name_of(region)));
    }
    let is_image = matches!(problem.code, Code::UnsupportedFormat | Code::BadImage)
        || problem.what.is_some_and(|what| what.starts_with("image_"));
    let name = is_image.then(|| name_of(image));
    Failure::Problem(problem, name)
}

/// `NAME=FILE`, `NAME=FILE:labels`, or the name of a built-in layer.
struct LayerOption {
    name: String,
    kind: LayerKind,
    file: Option<PathBuf>,
}

impl LayerOption {
    fn parse(text: &str) -> Result<Self, Failure> {
        let Some((name, file)) = text.split_once('=') else {
            let name = text.to_owned();
            let built_in = text.starts_with('@').then_some(Self {
                name,
                kind: LayerKind::Image,
                file: None,
            });
            return built_in.ok_or_else(|| {
                Failure::Local(format!(
                    "--layer {text:?}: expected NAME=FILE, NAME=FILE:labels, @coverage or @holes"
                ))
            });
        };
        let (file, kind) = file
            .strip_suffix(":labels")
            .map_or((file, LayerKind::Image), |file| (file, LayerKind::Labels));
        Ok(Self {
            name: name.to_owned(),
            kind,
            file: Some(file.into()),
        })
    }
}

fn kind_of(out: &Path) -> Result<FramesOutput, Problem> {
    let is_directory = output::is_directory(out);
    // A device or a pipe has no extension.
    if is_stdio(out) || out.exists() && !out.is_file() && !is_directory {
        return Ok(FramesOutput::File(BatchForm::Zip));
    }
    if is_directory {
        return Ok(FramesOutput::Directory);
    }
    let known = [
        ("zip", BatchForm::Zip),
        ("png", BatchForm::Apng),
        ("apng", BatchForm::Apng),
        ("gif", BatchForm::Gif),
    ];
    Ok(output::by_extension(out, &known, ", or a folder")?
        .map_or(FramesOutput::Directory, FramesOutput::File))
}
