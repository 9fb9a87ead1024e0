//! `mlswarp warp IMAGE WARP.json -o OUT`: the walk of `POST /warp` without a server. Same parser, same warp, same bytes.

use std::fmt;
use std::fs::File;
use std::io::{self, BufWriter, Read, Write};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mlswarp::codec::Format;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Image, Posed, Report, Setup, Warp};

use crate::config::Config;
use crate::problem::{Code, Problem};
use crate::wire::{WarpObject, WarpPatch};

/// Bends one picture; `-` is standard input or output.
///
/// # Errors
/// What a server would answer, or a file that cannot be read or written.
pub fn run(config: &Config, image: &Path, warp: &Path, out: &Path) -> Result<Summary, Problem> {
    if is_stdio(image) && is_stdio(warp) {
        return Err(Problem::new(Code::MalformedRequest, "standard input can be the image or the warp object, not both"));
    }
    let file = read("image", image, config.max_body_bytes)?;
    let patch = WarpPatch::parse(&read("warp object", warp, config.max_warp_json_bytes)?)?;
    // As `Accept` does for a request.
    let format = patch.output.format.or_else(|| format_of(out));
    let mut object = patch.merge_onto(WarpObject::default());
    object.output.format = format.unwrap_or(object.output.format);
    let threads = rayon::ThreadPoolBuilder::new().num_threads(config.work.workers).build();
    let threads = threads.map_err(|e| Problem::new(Code::Internal, format!("cannot start compute threads: {e}")))?;
    threads.install(|| bend(config, &file, &object, out))
}

fn bend(config: &Config, file: &[u8], object: &WarpObject, out: &Path) -> Result<Summary, Problem> {
    let image = Arc::new(Image::decode(file, &config.limits().image)?);
    let setup = Setup::new(&object.rest, image.extent(), &config.limits())?;
    let pose = setup.pose(object.posed()?)?;
    object.output.target(image.extent(), &config.limits())?;
    let posed = Posed::new(&setup, &setup.plan(), &pose, object.folds, &|| false)?;
    let warp = Warp::new(&image, &posed, &object.output, &config.limits())?;
    let helpers = config.work.workers.saturating_sub(1);
    let drawn = if is_stdio(out) {
        draw(&warp, helpers, io::stdout())
    } else if out.exists() && !out.is_file() || out.is_symlink() {
        // A device, a pipe or a link is written to, not replaced.
        File::options().write(true).create(true).truncate(true).open(out).and_then(|file| draw(&warp, helpers, file))
    } else {
        create(out).and_then(|(file, half)| draw(&warp, helpers, file).and_then(|()| half.keep()))
    };
    drawn.map_err(|e| Problem::new(Code::Internal, format!("{} cannot be written: {e}", out.display())))?;
    Ok(Summary { extent: warp.target(), report: posed.into_report_on(&image) })
}

/// The format that a file's name promises.
fn format_of(out: &Path) -> Option<Format> {
    match out.extension()?.to_str()?.to_ascii_lowercase().as_str() {
        "png" => Some(Format::Png),
        "jpg" | "jpeg" => Some(Format::Jpeg),
        "webp" => Some(Format::WebP),
        _ => None,
    }
}

fn is_stdio(path: &Path) -> bool {
    path == Path::new("-")
}

fn draw(warp: &Warp, helpers: usize, out: impl Write + Send) -> io::Result<()> {
    let mut out = BufWriter::new(out);
    let mut failed = None;
    let _ = warp.write(helpers, &(), &mut |bytes| match out.write_all(&bytes) {
        Ok(()) => ControlFlow::Continue(()),
        Err(e) => {
            failed = Some(e);
            ControlFlow::Break(())
        }
    });
    failed.map_or_else(|| out.flush(), Err)
}

/// A file beside `out` that takes its place when it is whole: nobody sees half a picture.
struct Half {
    part: PathBuf,
    whole: PathBuf,
}

fn create(out: &Path) -> io::Result<(File, Half)> {
    let mut name = out.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.part", std::process::id()));
    let half = Half { part: out.with_file_name(name), whole: out.to_owned() };
    Ok((File::create(&half.part)?, half))
}

impl Half {
    fn keep(self) -> io::Result<()> {
        std::fs::rename(&self.part, &self.whole)
    }
}

impl Drop for Half {
    fn drop(&mut self) {
        // Gone already when it was kept.
        let _ = std::fs::remove_file(&self.part);
    }
}

fn read(what: &str, path: &Path, limit: u64) -> Result<Vec<u8>, Problem> {
    let cannot = |e: io::Error| Problem::new(Code::MalformedRequest, format!("the {what} {} cannot be read: {e}", path.display()));
    let source: Box<dyn Read> = if is_stdio(path) { Box::new(io::stdin().lock()) } else { Box::new(File::open(path).map_err(cannot)?) };
    let mut bytes = Vec::new();
    source.take(limit.saturating_add(1)).read_to_end(&mut bytes).map_err(cannot)?;
    if bytes.len() as u64 > limit {
        return Err(Problem::new(Code::TooLarge, format!("the {what} is larger than {limit} bytes")).limit("bytes", limit, bytes.len()));
    }
    Ok(bytes)
}

/// `code: detail (pointer)`.
#[must_use]
pub fn complaint(problem: &Problem) -> String {
    let place = problem.pointer.as_ref().map_or_else(String::new, |pointer| format!(" ({pointer})"));
    format!("{}: {}{place}", problem.code.as_str(), problem.detail)
}

/// What a server would say in headers, on one line.
#[derive(Debug)]
pub struct Summary {
    /// Of the posed grid.
    pub report: Report,
    /// Of the picture.
    pub extent: Extent,
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { report: Report { warnings, folds, residual }, extent } = self;
        write!(f, "{} x {} px, {folds} folded cells, residual {residual:.4} px", extent.width(), extent.height())?;
        warnings.iter().try_for_each(|warning| write!(f, ", {}", warning.code()))
    }
}
