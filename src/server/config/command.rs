//! The commands of the program, their arguments, and the options that have an effect on them.

use std::path::PathBuf;

use clap::{Arg, Args, Subcommand, ValueEnum};

/// The commands of the program.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Start the server (the default).
    Serve,
    /// Warp one image without a server, into a file with the same bytes as the response of POST /warp.
    #[command(after_help = WARP_EXAMPLE)]
    Warp(WarpArgs),
    /// Map points, polygons, boxes and GeoJSON without a server: the JSON of POST /points.
    #[command(after_help = POINTS_EXAMPLE)]
    Points(PointsArgs),
    /// Write the coordinate map without a server: the file of POST /map.
    #[command(after_help = MAP_EXAMPLE)]
    Map(MapArgs),
    /// Draw many frames of one image without a server: the zip archive or animated PNG of POST /sessions/{id}/batch.
    #[command(after_help = BATCH_EXAMPLE)]
    Batch(BatchArgs),
    /// Measure a pose without a server (residuals, folds, distortion, tolerance): the JSON of POST /report.
    #[command(after_help = REPORT_EXAMPLE)]
    Report(ReportArgs),
    /// Check whether a running server can take work: exit code 0 if it can, otherwise 1.
    Health,
}

/// The files that the handles come from: a warp object, landmark files, or both.
#[derive(Args, Clone, Debug)]
pub struct WarpInput {
    /// Warp object (JSON); `-` reads standard input. With --landmarks it has no p and q, and may be left out.
    #[arg(required_unless_present = "landmarks")]
    pub warp: Option<PathBuf>,
    /// Landmark file with the handles: both p and q, or p alone with --landmarks-q. The format is recognised: JSON, CSV, BigWarp CSV,
    /// ibug .pts, WebMorph .tem, tpsDig .tps, elastix, napari, OpenFace, DeepLabCut, MediaPipe, ARKit, labelme, QGIS .points.
    #[arg(long, value_name = "FILE", display_order = 1)]
    pub landmarks: Option<PathBuf>,
    /// Landmark file with q.
    #[arg(long, value_name = "FILE", requires = "landmarks", display_order = 2)]
    pub landmarks_q: Option<PathBuf>,
    /// Size of the image on which p was placed, such as a thumbnail: p is scaled to the image. Normalised files (0 to 1) are multiplied by
    /// it, by default by the size of the image.
    #[arg(long, value_name = "WIDTH,HEIGHT", requires = "landmarks", display_order = 3)]
    pub extent_p: Option<String>,
    /// Size of the image on which q was placed. By default that of p.
    #[arg(long, value_name = "WIDTH,HEIGHT", requires = "landmarks", display_order = 3)]
    pub extent_q: Option<String>,
    /// How two landmark files are matched: `name` or `order`. By default by name if the names explain them.
    #[arg(long = "match", value_name = "name|order", requires = "landmarks_q", display_order = 3)]
    pub matching: Option<String>,
    /// Which specimen, image, person or row of a landmark file is read, if it has several: an index from 0, or a name.
    #[arg(long, value_name = "INDEX|NAME", requires = "landmarks", display_order = 3)]
    pub item: Option<String>,
    /// Brings q to the frame of p by the best map of this class before anything else: none, rigid, similarity or affine. Takes precedence
    /// over the warp object.
    #[arg(long, value_name = "CLASS", display_order = 4)]
    pub align: Option<String>,
}

/// The size of the image, for commands that do not read its pixels.
#[derive(Args, Clone, Debug)]
#[group(multiple = false)]
pub struct ExtentInput {
    /// Size of the image that the warp belongs to, unless the warp object has it in `extent`.
    #[arg(long, value_name = "WIDTH,HEIGHT", display_order = 4)]
    pub extent: Option<String>,
    /// Image file that the warp belongs to, from which only the size is read; `-` reads standard input.
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
    /// Where content of the region moved away and nothing covers the place, 0 to 255. Only the size of the image is read.
    Holes,
}

/// The arguments of `mlswarp warp`.
#[derive(Args, Clone, Debug)]
pub struct WarpArgs {
    /// Image file (PNG, JPEG, WebP, TIFF, GIF, BMP); `-` reads standard input.
    pub image: PathBuf,
    /// The handles.
    #[command(flatten)]
    pub input: WarpInput,
    /// Mask of the region that moves, an image file of the same size: white moves, black stays the same, and grey is a transition. In a
    /// file with transparent pixels, the opaque ones move.
    #[arg(long, value_name = "FILE", display_order = 4)]
    pub region: Option<PathBuf>,
    /// What is drawn.
    #[arg(long, value_enum, default_value_t, display_order = 4)]
    pub kind: WarpKind,
    /// The part of the posed plane that the output shows: `same` (that of the image), `fit` (the whole result), or a box in pixels. Takes
    /// precedence over the warp object.
    #[arg(long, value_name = "same|fit|X,Y,WIDTH,HEIGHT", allow_hyphen_values = true, display_order = 4)]
    pub canvas: Option<String>,
    /// Output file; `-` writes standard output. Its extension selects the format: .png, .jpg, .jpeg, .webp, .tif or .tiff. A format in the
    /// warp object takes precedence and allows other extensions. Without an extension or a format, the output is PNG.
    // All of these stand before the options of the server.
    #[arg(short, long, display_order = 5)]
    pub out: PathBuf,
}

/// The arguments of `mlswarp points`.
#[derive(Args, Clone, Debug)]
pub struct PointsArgs {
    /// The handles.
    #[command(flatten)]
    pub input: WarpInput,
    /// Annotations: a JSON object with points, polygons, boxes, geojson, inverse, refine; or a GeoJSON file, whose result is GeoJSON; `-`
    /// reads standard input. Without this file they are read from the warp object, as in the body of POST /points.
    pub annotations: Option<PathBuf>,
    /// Map from the picture that is drawn back to the image, as `"inverse": true` does.
    #[arg(long, display_order = 4)]
    pub inverse: bool,
    /// The size of the image.
    #[command(flatten)]
    pub extent: ExtentInput,
    /// Output file (JSON); `-` writes standard output.
    #[arg(short, long, default_value = "-", display_order = 5)]
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
    /// `inverse`: for each output pixel, the source position that is drawn there; `forward`: for each source pixel, where it is drawn.
    /// By default `direction` in the warp object, or inverse.
    #[arg(long, value_name = "inverse|forward", display_order = 5)]
    pub direction: Option<String>,
    /// Output file; `-` writes standard output. Its extension selects the format: .npy (NumPy, float32, [height, width, 2]), .tif or .tiff
    /// (two float bands). Otherwise the output is NumPy.
    #[arg(short, long, display_order = 5)]
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
    /// Output file (JSON); `-` writes standard output.
    #[arg(short, long, default_value = "-", display_order = 5)]
    pub out: PathBuf,
}

/// The arguments of `mlswarp batch`.
#[derive(Args, Clone, Debug)]
pub struct BatchArgs {
    /// Image file (PNG, JPEG, WebP, TIFF, GIF, BMP); `-` reads standard input.
    pub image: PathBuf,
    /// The handles.
    #[command(flatten)]
    pub input: WarpInput,
    /// Batch (JSON), as the body of POST /sessions/{id}/batch: frames, or steps and easing, or jitter; delay, layers, output; points,
    /// polygons, boxes, geojson. `-` reads standard input. Without this file, these fields are read from the warp object.
    pub batch: Option<PathBuf>,
    /// Mask of the region that moves, an image file of the same size: white moves, black stays the same, and grey is a transition. In a
    /// file with transparent pixels, the opaque ones move.
    #[arg(long, value_name = "FILE", display_order = 4)]
    pub region: Option<PathBuf>,
    /// Layer to draw in each frame, into a separate file: NAME=FILE (an image of the same size), NAME=FILE:labels (a label image),
    /// @coverage or @holes. The option may be repeated.
    #[arg(long = "layer", value_name = "NAME=FILE[:labels]", display_order = 4)]
    pub layers: Vec<String>,
    /// Show no progress on a terminal.
    #[arg(short = 'Q', long, display_order = 5)]
    pub quiet: bool,
    /// Output file, .zip (pictures, annotations, frames.json), .png or .apng (an animation); or a directory, which is created, for
    /// the files of the archive; `-` writes the archive to standard output.
    #[arg(short, long, display_order = 6)]
    pub out: PathBuf,
}

const WARP_EXAMPLE: &str = r#"Examples:
  echo '{"p": [[168, 112], [316, 136]], "q": [[150, 104], [338, 126]]}' > warp.json
  mlswarp warp cat.png warp.json -o warped.png
  mlswarp warp cat-labels.png warp.json --kind labels -o warped-labels.png
  mlswarp warp face.jpg --landmarks face.pts --landmarks-q average.pts --align similarity -o average.jpg"#;

const POINTS_EXAMPLE: &str = r#"Examples:
  echo '{"p": [[168, 112], [316, 136]], "q": [[150, 104], [338, 126]]}' > warp.json
  echo '{"boxes": [[150, 90, 330, 150]]}' | mlswarp points warp.json - --image cat.png
  echo '{"points": [[9, 9]], "inverse": true}' | mlswarp points warp.json - --extent 451,300
  mlswarp points warp.json cells.geojson --extent 451,300 -o warped.geojson"#;

const MAP_EXAMPLE: &str = r#"Examples:
  echo '{"p": [[168, 112], [316, 136]], "q": [[150, 104], [338, 126]]}' > warp.json
  mlswarp map warp.json --image cat.png -o map.npy    # cv2.remap(cat, numpy.load("map.npy"), ...)
  mlswarp map warp.json --extent 451,300 --direction forward -o forward.tif"#;

const REPORT_EXAMPLE: &str = r#"Examples:
  echo '{"p": [[168, 112], [316, 136]], "q": [[150, 104], [338, 126]]}' > warp.json
  mlswarp report warp.json --image cat.png
  mlswarp report --landmarks face.pts --landmarks-q average.pts --image face.jpg -o report.json"#;

const BATCH_EXAMPLE: &str = r#"Examples:
  echo '{"p": [[168, 112], [316, 136]], "q": [[150, 104], [338, 126]]}' > warp.json
  echo '{"steps": 24, "easing": "ease-in-out"}' | mlswarp batch cat.png warp.json - -o cat.apng
  echo '{"jitter": {"seed": 7, "count": 100, "sigma": 3}, "points": [[240, 250]]}' > batch.json
  mlswarp batch cat.png warp.json batch.json --layer mask=cat-labels.png:labels -o cats.zip"#;

/// The options that limit the work of a subcommand. An empty help text stands for that of the server.
const LIMITS: [(&str, &str); 8] = [
    ("workers", "Number of compute threads. auto = number of cores"),
    ("max-body-bytes", "Maximum size of the image file, of a landmark file, and of the annotations"),
    ("max-warp-json-bytes", "Maximum size of the warp object"),
    ("max-image-pixels", ""),
    ("max-image-side", ""),
    ("max-columns", ""),
    ("max-fit-handles", "Maximum number of handles on which the method auto compares methods; the time grows with its cube"),
    ("max-plan-bytes", ""),
];

const MEMORY: (&str, &str) =
    ("memory-bytes", "Maximum memory for plans and results. auto = 6 tenths of the memory of the machine or of the control group");
/// [`LIMITS`] and [`MEMORY`]: the options of the subcommands that run the use cases of the server, which reserve memory.
const SERVICE: [(&str, &str); 9] = {
    let mut options = [MEMORY; 9];
    let (limits, _) = options.split_at_mut(LIMITS.len());
    limits.copy_from_slice(&LIMITS);
    options
};

/// The options that have an effect on each subcommand other than `serve`, with their help texts, as in [`LIMITS`].
pub(super) const EFFECTIVE: [(&str, &[(&str, &str)]); 6] = [
    ("warp", &LIMITS),
    ("points", &SERVICE),
    ("map", &SERVICE),
    ("batch", &SERVICE),
    ("report", &SERVICE),
    (
        "health",
        &[
            ("listen", "Address and port of the server"),
            ("metrics-listen", "Metrics address and port of the server; if this is set, it is the one that is asked"),
            ("tls-cert", "Certificate of the server, PEM: the only one that is trusted"),
            ("tls-key", "Private key of the certificate (not used, but required with --tls-cert)"),
        ],
    ),
];

/// The help text of an option, as in [`LIMITS`]; `None` if the option has no effect.
pub(super) fn help_of(effective: &[(&str, &'static str)], option: &Arg) -> Option<&'static str> {
    effective.iter().find(|(flag, _)| option.get_long() == Some(flag)).map(|(_, help)| *help)
}
