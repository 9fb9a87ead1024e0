//! `mlswarp batch IMAGE WARP.json [BATCH.json] -o OUT`: a session and `POST /sessions/{id}/batch` without a server.

use std::fs;
use std::io::{self, Cursor, IsTerminal as _, Read as _, Write as _};
use std::path::{Path, PathBuf, is_separator};

use bytes::Bytes;
use serde_json::json;
use zip::read::read_zipfile_from_stream;

use super::failure::Failure;
use super::input::is_stdio;
use super::service::{Service, summary};
use super::{input, output};
use crate::app::batch::{Batch, BatchForm};
use crate::app::layers::bad_name;
use crate::app::warp::Upload;
use crate::config::{BatchArgs, Config};
use crate::layer::{LayerKind, LayerName};
use crate::problem::Problem;
use crate::wire::{merged, split_batch};

/// Characters of the progress bar.
const BAR: usize = 40;

/// What is written.
#[derive(Clone, Copy, PartialEq)]
enum Out {
    File(BatchForm),
    /// The files of the archive.
    Directory,
}

/// Draws a batch. The result: the number of frames, and what a server sends in response headers.
/// Errors: See [`Failure`].
pub fn run(config: &Config, args: &BatchArgs) -> Result<Option<String>, Failure> {
    let BatchArgs { image, input: handles, batch, region, layers, out, quiet } = args;
    let layers = layers.iter().map(|text| Layer::parse(text)).collect::<Result<Vec<_>, _>>()?;
    let others = [Some(image), batch.as_ref(), region.as_ref()];
    handles.require_one_stdin(&others.into_iter().chain(layers.iter().map(|layer| layer.file.as_ref())).collect::<Vec<_>>())?;
    let has = |name: &str| layers.iter().any(|layer| layer.name == name);
    if has("@holes") && region.is_none() && !has("region") {
        return Err(Failure::Local("--layer @holes needs a --region".to_owned()));
    }
    let kind = kind_of(out)?;
    output::require_directory(out)?;
    let warp = handles.json(config)?;
    let batch = batch.as_deref().map_or_else(|| Ok(b"{}".to_vec()), |path| input::read("batch", path, config.max_body_bytes))?;
    let [warp, batch] = split_batch(&merged(&[&warp, &batch, &drawn(&layers)])?)?;
    let files = handles.landmark_files(config)?;
    let image = input::read("image", image, config.max_body_bytes)?;
    let region = region.as_deref().map(|path| input::read("region", path, config.max_body_bytes).map(Bytes::from)).transpose()?;
    let layers = layers.into_iter().filter_map(|layer| Some((layer.name, layer.kind, layer.file?)));
    let layers = layers.map(|(name, kind, path)| Ok((name, kind, input::read("layer", &path, config.max_body_bytes)?)));
    let layers = layers.collect::<Result<Vec<_>, Failure>>()?;
    let service = Service::start(config)?;
    let (app, client) = (&service.app, service.client);
    let form = if let Out::File(form) = kind { form } else { BatchForm::Zip };
    let (made, method, has_unmatched) = service.wait(async {
        let landmarks = match files {
            Some(files) => Some(app.read_landmarks(client, files).await?),
            None => None,
        };
        let has_unmatched = landmarks.as_ref().is_some_and(|landmarks| landmarks.has_unmatched());
        let upload = Upload { image: image.into(), warp: warp.into(), region, landmarks };
        let (shown, method) = app.create_session(client, upload).await?;
        let id = shown.session.record.id;
        for (name, kind, file) in layers {
            let name = LayerName::parse(&name).ok_or_else(|| bad_name(&name))?;
            app.put_layer(client, id, &name, kind, file.into()).await.map_err(|mut problem| {
                problem.detail.insert_str(0, &format!("--layer {}: ", name.as_str()));
                problem
            })?;
        }
        let made = app.batch(client, id, batch.into(), form, |_| u64::MAX).await?;
        Ok((made, method, has_unmatched))
    })?;
    let frames = made.frames;
    let progress = Progress { frames, is_shown: !quiet && io::stderr().is_terminal() };
    match kind {
        Out::File(_) => output::write(out, |sink| each(&service, made, &progress, |bytes| sink.put(&bytes)))?,
        Out::Directory => {
            fs::create_dir_all(out).map_err(|e| Failure::Local(format!("cannot write {out:?}: {e}")))?;
            each(&service, made, &progress, |bytes| extract(out, &bytes))?;
        }
    }
    let what = if frames == 1 { "frame" } else { "frames" };
    let more = summary(method, &[], has_unmatched).map_or_else(String::new, |more| format!(", {more}"));
    Ok(Some(format!("{frames} {what}{more}")))
}

/// `NAME=FILE`, `NAME=FILE:labels`, or the name of a built-in layer.
struct Layer {
    name: String,
    kind: LayerKind,
    file: Option<PathBuf>,
}

impl Layer {
    fn parse(text: &str) -> Result<Self, Failure> {
        let Some((name, file)) = text.split_once('=') else {
            let name = text.to_owned();
            let built_in = text.starts_with('@').then_some(Self { name, kind: LayerKind::Image, file: None });
            return built_in
                .ok_or_else(|| Failure::Local(format!("--layer {text:?}: expected NAME=FILE, NAME=FILE:labels, @coverage or @holes")));
        };
        let (file, kind) = file.strip_suffix(":labels").map_or((file, LayerKind::Image), |file| (file, LayerKind::Labels));
        Ok(Self { name: name.to_owned(), kind, file: Some(file.into()) })
    }
}

/// The field of a batch that draws them.
fn drawn(layers: &[Layer]) -> Vec<u8> {
    if layers.is_empty() {
        return b"{}".to_vec();
    }
    json!({"layers": layers.iter().map(|layer| &layer.name).collect::<Vec<_>>()}).to_string().into_bytes()
}

/// Hands over the bytes of the file, frame by frame.
fn each(service: &Service, made: Batch, progress: &Progress, mut take: impl FnMut(Bytes) -> Result<(), Failure>) -> Result<(), Failure> {
    let Batch { first, mut rest, .. } = made;
    let (mut done, mut next) = (0, Some(first));
    while let Some(bytes) = next {
        take(bytes)?;
        done += 1;
        progress.show(done);
        next = service.next(rest.next())?;
    }
    Ok(())
}

/// Writes the files in a part of an archive, which has whole entries.
fn extract(directory: &Path, part: &[u8]) -> Result<(), Failure> {
    let broken = |e: &dyn std::fmt::Display| Failure::Local(format!("cannot read the batch: {e}"));
    let mut part = Cursor::new(part);
    while part.position() < part.get_ref().len() as u64 {
        let Some(mut entry) = read_zipfile_from_stream(&mut part).map_err(|e| broken(&e))? else { return Ok(()) };
        let (name, mut bytes) = (entry.name().map_err(|e| broken(&e))?.into_owned(), Vec::new());
        entry.read_to_end(&mut bytes).map_err(|e| broken(&e))?;
        output::write(&directory.join(name), |sink| sink.put(&bytes))?;
    }
    Ok(())
}

fn kind_of(out: &Path) -> Result<Out, Problem> {
    let is_directory = out.is_dir() || out.to_string_lossy().ends_with(is_separator);
    // A device or a pipe has no extension.
    if is_stdio(out) || out.exists() && !out.is_file() && !is_directory {
        return Ok(Out::File(BatchForm::Zip));
    }
    if is_directory {
        return Ok(Out::Directory);
    }
    let known = [("zip", BatchForm::Zip), ("png", BatchForm::Apng), ("apng", BatchForm::Apng)];
    Ok(output::by_extension(out, &known, ", or a directory")?.map_or(Out::Directory, Out::File))
}

/// A bar on the terminal.
struct Progress {
    frames: u32,
    is_shown: bool,
}

impl Progress {
    /// The last part of the file is not a frame.
    fn show(&self, done: u32) {
        let done = done.min(self.frames);
        if self.is_shown {
            let full = BAR * done as usize / self.frames.max(1) as usize;
            let _ = write!(io::stderr(), "\r[{}{}] {done} of {} frames", "=".repeat(full), " ".repeat(BAR - full), self.frames);
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if self.is_shown {
            // Erases the line.
            let _ = write!(io::stderr(), "\r\x1b[K");
        }
    }
}
