//! The commands of the program, their arguments, and the options that have an effect on them.

use mlswarp::deform::METHODS;
use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};

/// The commands of the program.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Start the server (the default).
    Serve,
    /// Warp images without a server, into files with the same bytes as the responses of POST /warp.
    Warp(WarpArgs),
    /// Map points, polygons, boxes and GeoJSON without a server: the JSON of POST /points.
    Points(PointsArgs),
    /// Write the coordinate map without a server: the file of POST /map.
    Map(MapArgs),
    /// Draw many frames of one image without a server: an animation, or an archive as POST
    /// /sessions/{id}/batch sends it.
    Batch(BatchArgs),
    /// Average, morph or exaggerate several images without a server, into files with the same bytes
    /// as the responses of POST /blend.
    Blend(BlendArgs),
    /// Measure a pose without a server (residuals, folds, distortion, tolerance): the JSON of POST
    /// /report.
    Report(ReportArgs),
    /// Compare methods without a server: how well each predicts every landmark from the others, as
    /// POST /fit does.
    Fit(FitArgs),
    /// Check whether a running server can take work: exit code 0 if it can, otherwise 1.
    Health,
}

/// Landmark files with the handles.
#[derive(Args, Clone, Debug)]
pub struct LandmarkInput {
    /// Landmark file with the handles: p and q, or p alone with --landmarks-q. The format is
    /// recognised by content.
    #[arg(long, value_name = "FILE", display_order = 1)]
    pub landmarks: Option<PathBuf>,
    /// Landmark file with q.
    #[arg(long, value_name = "FILE", requires = "landmarks", display_order = 2)]
    pub landmarks_q: Option<PathBuf>,
    /// Size of the image on which p was placed, such as a thumbnail. Default for normalised files
    /// (0 to 1): that of the image.
    #[arg(long, value_name = "W,H", requires = "landmarks", display_order = 3)]
    pub extent_p: Option<String>,
    /// Size of the image on which q was placed. Default: that of p.
    #[arg(long, value_name = "W,H", requires = "landmarks", display_order = 3)]
    pub extent_q: Option<String>,
    /// How two landmark files are matched: name or order. Default: by name if the names explain
    /// them.
    #[arg(
        long = "match",
        value_name = "HOW",
        requires = "landmarks_q",
        display_order = 3
    )]
    pub matching: Option<String>,
    /// Which specimen, image, person or row of a landmark file is read: an index from 0, or a name.
    #[arg(long, value_name = "ITEM", requires = "landmarks", display_order = 3)]
    pub item: Option<String>,
}

/// The files that the handles come from: a warp object, landmark files, or both.
#[derive(Args, Clone, Debug)]
pub struct WarpInput {
    /// Warp object (JSON) with p and q; `-` reads standard input. With --landmarks it has no p and
    /// q, and may be left out.
    #[arg(required_unless_present = "landmarks")]
    pub warp: Option<PathBuf>,
    /// The landmark files.
    #[command(flatten)]
    pub landmarks: LandmarkInput,
}

/// How the handles move the image; fields of the same names in JSON. An option takes precedence
/// over JSON.
#[derive(Args, Clone, Debug)]
pub struct PoseOptions {
    /// The method.
    #[arg(long, value_name = "NAME", display_order = 5, help = methods())]
    pub method: Option<String>,
    /// How quickly the influence of a handle falls off with distance, up to 8.
    #[arg(long, value_name = "N", allow_hyphen_values = true, display_order = 5)]
    pub alpha: Option<String>,
    /// Share of the way from p to q: 0.5 is half, 1.5 exaggerates, -0.5 goes the other way.
    #[arg(long, value_name = "T", allow_hyphen_values = true, display_order = 5)]
    pub strength: Option<String>,
    /// Bring q to the frame of p first, by the best map of this class: rigid, similarity or affine.
    #[arg(long, value_name = "CLASS", display_order = 5)]
    pub align: Option<String>,
}

/// The names of all methods.
fn methods() -> String {
    let names: Vec<&str> = METHODS.iter().map(|info| info.name).collect();
    let names = names.join(", ").replacen(',', " (default),", 1);
    format!("{names}, or auto (the one that fits best)")
}

/// Those that do not depend on where handles go.
fn blend_methods() -> String {
    let names: Vec<&str> = METHODS.iter().map(|info| info.name).collect();
    names.join(", ").replacen(',', " (default),", 1)
}

/// What a picture shows; fields of the same names in `output`.
#[derive(Args, Clone, Debug)]
pub struct FrameOptions {
    /// Part of the result: `same` (that of the image), `fit` (all of it), or a box X,Y,WIDTH,HEIGHT
    /// in pixels.
    #[arg(
        long,
        value_name = "BOX",
        allow_hyphen_values = true,
        display_order = 6
    )]
    pub canvas: Option<String>,
    /// Width of the result, px; the height follows.
    #[arg(long, value_name = "PX", allow_hyphen_values = true, display_order = 6)]
    pub width: Option<String>,
}

fn format_help() -> String {
    let words: Vec<&str> = mlswarp::format::words().collect();
    let (last, others) = words.split_last().unwrap_or((&"", &[]));
    format!(
        "{} or {last}. Default: by the extension of the output file, otherwise png",
        others.join(", ")
    )
}

fn image_help() -> String {
    format!(
        "Image file ({}); `-` reads standard input",
        mlswarp::format::source_names()
    )
}

/// How pictures are written; fields of the same names in `output`.
#[derive(Args, Clone, Debug)]
pub struct FileOptions {
    /// The format.
    #[arg(long, value_name = "NAME", display_order = 7, help = format_help())]
    pub format: Option<String>,
    /// Quality of JPEG files, 1 to 100 (default 85).
    #[arg(long, value_name = "N", allow_hyphen_values = true, display_order = 7)]
    pub quality: Option<String>,
}

/// The frames of a batch; fields of the same names in JSON.
#[derive(Args, Clone, Debug)]
pub struct FramesOptions {
    /// Number of frames from the handles at rest to q, both included.
    #[arg(long, value_name = "N", allow_hyphen_values = true, display_order = 4)]
    pub steps: Option<String>,
    /// linear (default), or ease-in-out (slowly at both ends).
    #[arg(long, value_name = "NAME", display_order = 4)]
    pub easing: Option<String>,
    /// Return to the first frame.
    #[arg(long, display_order = 4)]
    pub and_back: bool,
    /// How often an animation is played; 0 (default) is without end.
    #[arg(
        long = "loop",
        value_name = "N",
        allow_hyphen_values = true,
        display_order = 4
    )]
    pub plays: Option<String>,
    /// How long an animation shows each frame, ms (default 40).
    #[arg(long, value_name = "MS", allow_hyphen_values = true, display_order = 4)]
    pub delay: Option<String>,
}

/// The size of the image, for commands that do not read its pixels.
#[derive(Args, Clone, Debug)]
#[group(multiple = false)]
pub struct ExtentInput {
    /// Size of the image that the warp belongs to, unless the warp object has it in `extent`.
    #[arg(long, value_name = "WIDTH,HEIGHT", display_order = 4)]
    pub extent: Option<String>,
    /// Image file that the warp belongs to, from which only the size is read; `-` reads standard
    /// input.
    #[arg(long, value_name = "FILE", display_order = 4)]
    pub image: Option<PathBuf>,
}

/// What `mlswarp warp` draws.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum WarpKind {
    /// The image.
    #[default]
    Image,
    /// The image as labels: values are copied, not interpolated; depth and palette are kept.
    Labels,
    /// How much of each pixel the posed image covers, 0 to 255. Only the size of the image is read.
    Coverage,
    /// Where content of the region moved away and nothing covers the place, 0 to 255. Only the size
    /// of the image is read.
    Holes,
}

/// The arguments of `mlswarp warp`.
#[derive(Args, Clone, Debug)]
pub struct WarpArgs {
    /// Images, folders of images, and the warp object with the handles: that is the file whose name
    /// ends in .json or whose content begins with `{`, all others are images. `-` reads standard
    /// input.
    #[arg(required = true, value_name = "IMAGE|WARP.json")]
    pub files: Vec<PathBuf>,
    /// The landmark files.
    #[command(flatten)]
    pub landmarks: LandmarkInput,
    /// The method.
    #[command(flatten)]
    pub pose: PoseOptions,
    /// The part of the result.
    #[command(flatten)]
    pub frame: FrameOptions,
    /// The file.
    #[command(flatten)]
    pub file: FileOptions,
    /// Mask of the same size: only what is white in it moves.
    #[arg(long, value_name = "FILE", display_order = 4)]
    pub region: Option<PathBuf>,
    /// image (default); labels (values are not interpolated); coverage or holes: where the result
    /// covers the picture, or the region left it.
    #[arg(
        long,
        value_enum,
        default_value_t,
        hide_possible_values = true,
        hide_default_value = true,
        display_order = 4
    )]
    pub kind: WarpKind,
    /// Output file (.png, .jpg, .webp, .tif), `-` for standard output; for several images a folder,
    /// which is created: the names stay, with the extension of the format.
    // All of these stand before the options of the server.
    #[arg(short, long, value_name = "PATH", display_order = 8)]
    pub out: PathBuf,
}

/// The arguments of `mlswarp points`.
#[derive(Args, Clone, Debug)]
pub struct PointsArgs {
    /// The handles.
    #[command(flatten)]
    pub input: WarpInput,
    /// Annotations: a JSON object with points, polygons, boxes, geojson, inverse, refine; or a
    /// GeoJSON file, whose result is GeoJSON; `-` reads standard input. Without this file they are
    /// read from the warp object, as in the body of POST /points.
    pub annotations: Option<PathBuf>,
    /// Map from the picture that is drawn back to the image, as `"inverse": true` does.
    #[arg(long, display_order = 4)]
    pub inverse: bool,
    /// The size of the image.
    #[command(flatten)]
    pub extent: ExtentInput,
    /// The method.
    #[command(flatten)]
    pub pose: PoseOptions,
    /// The image that the positions belong to.
    #[command(flatten)]
    pub frame: FrameOptions,
    /// Output file (JSON); `-` writes standard output.
    #[arg(
        short,
        long,
        value_name = "FILE",
        default_value = "-",
        display_order = 8
    )]
    pub out: PathBuf,
}

/// The arguments of `mlswarp map`.
#[derive(Args, Clone, Debug)]
pub struct MapArgs {
    /// The handles.
    #[command(flatten)]
    pub input: WarpInput,
    /// The size of the image.
    #[command(flatten)]
    pub extent: ExtentInput,
    /// `inverse` (default): for each pixel of the result, the source position that is drawn there;
    /// `forward`: for each pixel of the source, where it is drawn.
    #[arg(long, value_name = "WAY", display_order = 4)]
    pub direction: Option<String>,
    /// The method.
    #[command(flatten)]
    pub pose: PoseOptions,
    /// The part of the result.
    #[command(flatten)]
    pub frame: FrameOptions,
    /// Output file; `-` writes standard output. Its extension selects the format: .npy (NumPy,
    /// float32, [height, width, 2]), .tif or .tiff (two float bands). Otherwise the output is
    /// NumPy.
    #[arg(short, long, value_name = "FILE", display_order = 8)]
    pub out: PathBuf,
}

/// The arguments of `mlswarp report`.
#[derive(Args, Clone, Debug)]
pub struct ReportArgs {
    /// The handles.
    #[command(flatten)]
    pub input: WarpInput,
    /// The size of the image.
    #[command(flatten)]
    pub extent: ExtentInput,
    /// The method.
    #[command(flatten)]
    pub pose: PoseOptions,
    /// Part of the result whose coverage is measured: `same`, `fit`, or a box X,Y,WIDTH,HEIGHT in
    /// pixels.
    #[arg(
        long,
        value_name = "BOX",
        allow_hyphen_values = true,
        display_order = 6
    )]
    pub canvas: Option<String>,
    /// Output file (JSON); `-` writes standard output.
    #[arg(
        short,
        long,
        value_name = "FILE",
        default_value = "-",
        display_order = 8
    )]
    pub out: PathBuf,
}

/// The arguments of `mlswarp fit`.
#[derive(Args, Clone, Debug)]
pub struct FitArgs {
    /// The handles. `candidates` in the JSON names the methods that are compared.
    #[command(flatten)]
    pub input: WarpInput,
    /// The size of the image.
    #[command(flatten)]
    pub extent: ExtentInput,
    /// Bring q to the frame of p first, by the best map of this class: rigid, similarity or affine.
    #[arg(long, value_name = "CLASS", display_order = 5)]
    pub align: Option<String>,
    /// Write the JSON of POST /fit to this file, `-` for standard output. Default: a table on
    /// standard output, the best method first.
    #[arg(short, long, value_name = "FILE", display_order = 8)]
    pub out: Option<PathBuf>,
}

/// The arguments of `mlswarp batch`.
#[derive(Args, Clone, Debug)]
pub struct BatchArgs {
    /// The image file.
    #[arg(help = image_help())]
    pub image: PathBuf,
    /// The handles.
    #[command(flatten)]
    pub input: WarpInput,
    /// Batch (JSON), as the body of POST /sessions/{id}/batch: frames, steps or jitter; layers,
    /// output, points and others; `-` reads standard input. Without this file, these fields are
    /// read from the warp object.
    pub batch: Option<PathBuf>,
    /// The frames.
    #[command(flatten)]
    pub frames: FramesOptions,
    /// The method.
    #[command(flatten)]
    pub pose: PoseOptions,
    /// The part of the result.
    #[command(flatten)]
    pub frame: FrameOptions,
    /// The pictures in an archive or folder.
    #[command(flatten)]
    pub file: FileOptions,
    /// Mask of the same size: only what is white in it moves.
    #[arg(long, value_name = "FILE", display_order = 4)]
    pub region: Option<PathBuf>,
    /// Layer to draw in each frame, into a file of its own: NAME=FILE, NAME=FILE:labels, @coverage
    /// or @holes; may be repeated. `layers` in the JSON selects among them.
    #[arg(long = "layer", value_name = "LAYER", display_order = 4)]
    pub layers: Vec<String>,
    /// Show no progress on a terminal.
    #[arg(short = 'Q', long, display_order = 8)]
    pub quiet: bool,
    /// Animation (.gif, .png or .apng), or archive (.zip) of pictures, annotations and frames.json;
    /// or a folder for the files of the archive, which is created; `-` writes the archive to
    /// standard output.
    #[arg(short, long, value_name = "PATH", display_order = 8)]
    pub out: PathBuf,
}

/// The arguments of `mlswarp blend`.
#[derive(Args, Clone, Debug)]
pub struct BlendArgs {
    /// Images, folders of images, and the blend object, as POST /blend takes it: that is the file
    /// whose name ends in .json or whose content begins with `{`. Without `images` in it, all
    /// images are blended, in their order. `-` reads standard input.
    #[arg(required = true, value_name = "IMAGE|BLEND.json")]
    pub files: Vec<PathBuf>,
    /// Landmark files, one for each image: files of the same names, or in the same order; a folder
    /// of them; or one file with an item for each image. Default: the files beside the images.
    #[arg(long, value_name = "PATH", num_args = 1.., display_order = 1)]
    pub landmarks: Vec<PathBuf>,
    /// Share of each image in the shape, such as 1.5,-0.5; together 1. Of two images, one number is
    /// that of the second. Default: equal shares.
    #[arg(
        long,
        value_name = "N,N...",
        allow_hyphen_values = true,
        display_order = 4
    )]
    pub shape: Option<String>,
    /// Share of each image in the colours, likewise.
    #[arg(
        long,
        value_name = "N,N...",
        allow_hyphen_values = true,
        display_order = 4
    )]
    pub colour: Option<String>,
    /// Number of frames from the first of two images to the second, both included.
    #[arg(long, value_name = "N", allow_hyphen_values = true, display_order = 4)]
    pub steps: Option<String>,
    /// What is added: srgb (default; samples as files have them) or linear (light).
    #[arg(long, value_name = "NAME", display_order = 4)]
    pub space: Option<String>,
    /// The method.
    #[arg(long, value_name = "NAME", display_order = 5, help = blend_methods())]
    pub method: Option<String>,
    /// How quickly the influence of a handle falls off with distance, up to 8.
    #[arg(long, value_name = "N", allow_hyphen_values = true, display_order = 5)]
    pub alpha: Option<String>,
    /// The maps that bring each shape to the frame of the first: none, rigid, similarity (default)
    /// or affine.
    #[arg(long, value_name = "CLASS", display_order = 5)]
    pub align: Option<String>,
    /// The part of the result.
    #[command(flatten)]
    pub frame: FrameOptions,
    /// The pictures.
    #[command(flatten)]
    pub file: FileOptions,
    /// Show no progress on a terminal.
    #[arg(short = 'Q', long, display_order = 8)]
    pub quiet: bool,
    /// Output file (.png, .jpg, .webp, .tif); for several frames an animation (.gif, .png or
    /// .apng); archive (.zip) of pictures, landmarks and report.json, or a folder for the files of
    /// the archive, which is created; `-` for standard output.
    #[arg(short, long, value_name = "PATH", display_order = 8)]
    pub out: PathBuf,
}
