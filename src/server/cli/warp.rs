//! `mlswarp warp IMAGE WARP.json -o OUT`, `mlswarp warp IMAGE --landmarks FILE -o OUT`: `POST /warp` without a server, with the same parser
//! and the same bytes.

use std::fs::{self, File};
use std::io::{self, BufWriter, Read, Write};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytes::Bytes;
use mlswarp::codec::Format;
use mlswarp::warp::{Image, Posed, Report, Setup, Subject, Warp, WarpError, choose};

use crate::config::Config;
use crate::problem::words::quote;
use crate::problem::{Code, Problem};
use crate::wire::landmarks::{LandmarkFiles, Landmarks, UNMATCHED, extent};
use crate::wire::{WarpObject, WarpPatch};
use crate::wire::{canvas_from_text, canvas_text, method_text};

/// The input files; `-` is standard input.
#[derive(Clone, Debug)]
pub struct Input {
    /// The image.
    pub image: PathBuf,
    /// The warp object.
    pub warp: Option<PathBuf>,
    /// Landmarks of both sides, or of `p`.
    pub landmarks: Option<PathBuf>,
    /// Landmarks of `q`.
    pub landmarks_q: Option<PathBuf>,
    /// The size of the image that normalised landmarks of `p` belong to.
    pub extent_p: Option<String>,
    /// The same of `q`.
    pub extent_q: Option<String>,
    /// The canvas, instead of that of the warp object.
    pub canvas: Option<String>,
}

impl Input {
    /// Errors: Standard input cannot be read twice.
    fn require_one_stdin(&self) -> Result<(), Failure> {
        let files = [Some(&self.image), self.warp.as_ref(), self.landmarks.as_ref(), self.landmarks_q.as_ref()];
        if files.into_iter().flatten().filter(|path| is_stdio(path)).count() < 2 {
            return Ok(());
        }
        Err(Failure::Local("standard input can be one of the input files only".to_owned()))
    }

    /// Errors: A file that cannot be read.
    fn landmarks(&self, config: &Config) -> Result<Option<Landmarks>, Failure> {
        let Some(path) = &self.landmarks else { return Ok(None) };
        let file = |path: &Path| read("landmark file", path, config.max_body_bytes).map(Bytes::from);
        let extent = |name: &str, text: &Option<String>| text.as_ref().map(|text| extent(name, text)).transpose();
        let extents = LandmarkFiles {
            extent_p: extent("--extent-p", &self.extent_p)?,
            extent_q: extent("--extent-q", &self.extent_q)?,
            ..LandmarkFiles::default()
        };
        let files = match &self.landmarks_q {
            Some(q) => LandmarkFiles { p: Some(file(path)?), q: Some(file(q)?), ..extents },
            None => LandmarkFiles { both: Some(file(path)?), ..extents },
        };
        Ok(Some(files.read(config.limits().columns)?))
    }
}

/// Warps one image and returns what a server sends in response headers; `-` is standard output.
/// Errors: The problem that a server would answer, as `code: detail (pointer)`; a file that cannot be read or written, as `error: ...`.
pub fn run(config: &Config, input: &Input, out: &Path) -> Result<String, String> {
    run_with_failure(config, input, out).map_err(|failure| match failure {
        Failure::Problem(Problem { code, detail, pointer, .. }) => {
            let place = pointer.map_or_else(String::new, |pointer| format!(" ({pointer})"));
            format!("{}: {detail}{place}", code.as_str())
        }
        Failure::Local(sentence) => format!("error: {sentence}"),
    })
}

/// Why there is no picture.
enum Failure {
    /// A server would answer this.
    Problem(Problem),
    /// Files and threads of this machine.
    Local(String),
}

impl From<Problem> for Failure {
    fn from(problem: Problem) -> Self {
        Self::Problem(problem)
    }
}

impl From<WarpError> for Failure {
    fn from(error: WarpError) -> Self {
        Self::Problem(error.into())
    }
}

fn run_with_failure(config: &Config, input: &Input, out: &Path) -> Result<String, Failure> {
    input.require_one_stdin()?;
    let canvas = input.canvas.as_deref().map(canvas_from_text).transpose();
    let canvas = canvas.map_err(|expected| Failure::Local(format!("--canvas: {expected}")))?;
    let json = input.warp.as_deref().map(|path| read("warp object", path, config.max_warp_json_bytes)).transpose()?;
    let patch = json.map(|json| WarpPatch::parse(&json)).transpose()?.unwrap_or_default();
    // The file name takes the place of `Accept`.
    let format = patch.output.format.map_or_else(|| format_of(out), Ok)?;
    if let Some(directory) = out.parent().filter(|directory| !directory.as_os_str().is_empty() && !directory.is_dir()) {
        return Err(Failure::Local(format!("cannot write {out:?}: there is no directory {directory:?}")));
    }
    let landmarks = input.landmarks(config)?;
    if let Some(landmarks) = &landmarks {
        patch.require_no_handles()?;
        landmarks.require_q()?;
    }
    let file = read("image", &input.image, config.max_body_bytes)?;
    let mut object = patch.into_object()?;
    object.output.format = format;
    object.output.canvas = canvas.unwrap_or(object.output.canvas);
    let threads = rayon::ThreadPoolBuilder::new().num_threads(config.work.workers).build();
    let threads = threads.map_err(|e| Failure::Local(format!("cannot start compute threads: {e}")))?;
    threads.install(|| render(config, &file, object, landmarks, out))
}

fn render(config: &Config, file: &[u8], mut object: WarpObject, landmarks: Option<Landmarks>, out: &Path) -> Result<String, Failure> {
    let image = Arc::new(Image::decode(file, &config.limits().image)?);
    let unmatched = landmarks.as_ref().is_some_and(Landmarks::has_unmatched).then_some(UNMATCHED);
    if let Some(landmarks) = landmarks {
        landmarks.place_in(&mut object, image.extent())?;
    }
    object.apply_strength();
    if object.is_auto {
        object.require_choice()?;
        let (q, most) = (object.posed()?, config.max_fit_handles as u64);
        let chosen = choose(&object.rest, q, image.extent(), most, &|| false)?;
        object.choose(chosen);
    }
    let setup = Setup::new(&object.rest, image.extent(), &config.limits())?;
    let pose = setup.pose(object.posed()?)?;
    object.output.check(image.extent(), &config.limits())?;
    let posed = Posed::new(&setup, &setup.plan(), &pose, object.folds, &|| false)?;
    let warp = Warp::new(Subject::Image(&image), &posed, &object.output, &config.limits())?;
    write_to(&warp, config.work.workers.saturating_sub(1), out).map_err(|e| Failure::Local(format!("cannot write {out:?}: {e}")))?;
    let target = warp.target();
    let Report { warnings, folds, residual, exceeded, .. } = posed.into_report_on(Subject::Image(&image), &target, &|| false)?;
    let (width, height) = (target.extent.width(), target.extent.height());
    let canvas = target.canvas.map_or_else(String::new, |canvas| format!(", canvas {}", canvas_text(canvas)));
    let method = if object.is_auto { format!(", method {}", method_text(&object.rest)) } else { String::new() };
    let summary = format!("{width} x {height} px{canvas}{method}, {folds} folded cells, residual {residual:.4} px");
    let summary = if exceeded > 0 { format!("{summary}, {exceeded} cells over the tolerance") } else { summary };
    let warnings = warnings.iter().map(|warning| warning.code()).chain(unmatched);
    Ok(warnings.fold(summary, |summary, warning| format!("{summary}, {warning}")))
}

fn format_of(out: &Path) -> Result<Format, Problem> {
    let Some(extension) = out.extension() else { return Ok(Format::default()) };
    match extension.to_string_lossy().to_ascii_lowercase().as_str() {
        "png" => Ok(Format::Png),
        "jpg" | "jpeg" => Ok(Format::Jpeg),
        "webp" => Ok(Format::WebP),
        "tif" | "tiff" => Ok(Format::Tiff),
        other => {
            let extension = quote(&format!(".{other}"));
            let detail = format!("cannot write {out:?}: {extension} is not supported; supported: .png, .jpg, .jpeg, .webp, .tif, .tiff");
            Err(Problem::new(Code::UnsupportedFormat, detail))
        }
    }
}

fn is_stdio(path: &Path) -> bool {
    path == Path::new("-")
}

fn write_to(warp: &Warp, helpers: usize, out: &Path) -> io::Result<()> {
    if is_stdio(out) {
        return write(warp, helpers, io::stdout());
    }
    if out.exists() && !out.is_file() || out.is_symlink() {
        // A device, a pipe or a link is not replaced.
        return write(warp, helpers, File::options().write(true).create(true).truncate(true).open(out)?);
    }
    // A file beside it is renamed when it is complete.
    let mut name = out.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.part", std::process::id()));
    let part = out.with_file_name(name);
    let written = File::create(&part).and_then(|file| write(warp, helpers, file)).and_then(|()| fs::rename(&part, out));
    // It may not exist.
    written.inspect_err(|_| drop(fs::remove_file(&part)))
}

fn write(warp: &Warp, helpers: usize, out: impl Write + Send) -> io::Result<()> {
    let mut out = BufWriter::new(out);
    let mut written = Ok(());
    let _ = warp.write(helpers, &(), &mut |bytes| {
        written = out.write_all(&bytes);
        if written.is_ok() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    });
    written.and_then(|()| out.flush())
}

fn read(what: &str, path: &Path, limit: u64) -> Result<Vec<u8>, Failure> {
    let cannot = |e: io::Error| Failure::Local(format!("cannot read the {what} {path:?}: {e}"));
    let source: Box<dyn Read> = if is_stdio(path) { Box::new(io::stdin().lock()) } else { Box::new(File::open(path).map_err(cannot)?) };
    let mut bytes = Vec::new();
    source.take(limit.saturating_add(1)).read_to_end(&mut bytes).map_err(cannot)?;
    if bytes.len() as u64 > limit {
        return Err(Problem::new(Code::TooLarge, format!("the {what} is larger than {limit} bytes")).into());
    }
    Ok(bytes)
}
