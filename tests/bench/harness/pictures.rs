//! What is drawn: the photograph, the handles on it, and the mesh that they bend.

use std::sync::Arc;

use mlswarp::deform::Handle;
use mlswarp::geometry::{Grid, Mesh, Point, Vec2};
use mlswarp::pixmap::{Channels, Extent, Pixmap, Samples};
use mlswarp::render::{Filter, Outside, RenderOptions, Renderer, Source};

pub const SMALL: (u32, u32) = (500, 500);
pub const FULL_HD: (u32, u32) = (1920, 1080);
pub const UHD: (u32, u32) = (3840, 2160);

/// Vertices of the grid along each side.
pub const VERTICES: u32 = 100;

pub fn extent((width, height): (u32, u32)) -> Extent {
    Extent::new(width, height).expect("a side is not zero")
}

pub fn size(extent: Extent) -> String {
    format!("{} x {}", extent.width(), extent.height())
}

/// The astronaut cropped to 500 x 500, or to 512 px and the proportions of `extent`; enlarged where
/// that is larger. RGBA is opaque.
pub fn photograph(extent: Extent, channels: Channels) -> Pixmap {
    let side = if extent.width() == extent.height() {
        500
    } else {
        512
    };
    let photo = astronaut().crop_imm(0, 0, side, side * extent.height() / extent.width());
    let large = photo.resize_exact(
        extent.width(),
        extent.height(),
        image::imageops::FilterType::CatmullRom,
    );
    pixmap(
        if extent.width() > side {
            &large
        } else {
            &photo
        },
        channels,
    )
}

/// The 500 x 500 photograph side by side as often as it takes: larger pictures of the same kind, to
/// see how time grows.
pub fn tiles(extent: Extent) -> Pixmap {
    let photo = astronaut().crop_imm(0, 0, 500, 500).to_rgba8();
    let tiled = image::RgbaImage::from_fn(extent.width(), extent.height(), |x, y| {
        *photo.get_pixel(x % 500, y % 500)
    });
    pixmap(&tiled.into(), Channels::Rgba)
}

fn astronaut() -> image::DynamicImage {
    let file = std::fs::read(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../tests/images/astronaut.png"
    ))
    .expect("the photograph is there");
    image::load_from_memory(&file).expect("a PNG")
}

fn pixmap(picture: &image::DynamicImage, channels: Channels) -> Pixmap {
    let samples = match channels {
        Channels::Rgb => picture.to_rgb8().into_raw(),
        Channels::Rgba => picture.to_rgba8().into_raw(),
    };
    Pixmap::new(
        extent((picture.width(), picture.height())),
        channels,
        Samples::Eight(samples),
    )
}

/// The samples of an 8-bit picture.
pub fn bytes(picture: &Pixmap) -> &[u8] {
    match picture.samples() {
        Samples::Eight(samples) => samples,
        Samples::Sixteen(_) => panic!("the benchmarks draw 8-bit pictures"),
    }
}

/// A picture as the `png` crate writes it.
pub fn encode(
    extent: Extent,
    channels: Channels,
    samples: &[u8],
    how: (png::Compression, Option<png::Filter>),
    out: &mut Vec<u8>,
) {
    let mut encoder = png::Encoder::new(out, extent.width(), extent.height());
    encoder.set_color(if channels == Channels::Rgb {
        png::ColorType::Rgb
    } else {
        png::ColorType::Rgba
    });
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(how.0);
    if let Some(filter) = how.1 {
        encoder.set_filter(filter);
    }
    let mut writer = encoder
        .write_header()
        .expect("a buffer takes what is written");
    writer
        .write_image_data(samples)
        .expect("as many samples as pixels");
    writer.finish().expect("a buffer takes what is written");
}

/// Where handles lie and how far they move, in sides of the picture: 20 to 40 px of 500.
const HANDLES: [([f64; 2], [f64; 2]); 12] = [
    ([0.2, 0.2], [0.05, 0.04]),
    ([0.8, 0.25], [-0.06, 0.03]),
    ([0.5, 0.5], [0.04, -0.06]),
    ([0.25, 0.75], [-0.05, -0.04]),
    ([0.75, 0.8], [0.05, 0.06]),
    ([0.5, 0.1], [0.0, 0.05]),
    ([0.1, 0.5], [0.06, 0.0]),
    ([0.9, 0.55], [-0.04, -0.03]),
    ([0.5, 0.9], [0.03, -0.05]),
    ([0.35, 0.4], [-0.04, 0.05]),
    ([0.65, 0.6], [0.05, 0.03]),
    ([0.9, 0.1], [-0.04, 0.03]),
];
/// The number of them that bend the mesh.
const OF_MESH: usize = 11;

/// The first `n` of twelve handles, at rest and moved by `strength` times their way.
pub fn handles(n: usize, extent: Extent, strength: f64) -> (Vec<Handle>, Vec<Handle>) {
    let (width, height) = (f64::from(extent.width()), f64::from(extent.height()));
    let place = |x: f64, y: f64| Handle::Point(Point::new(x * width, y * height));
    let many: Vec<_> = (0..u32::try_from(n).expect("a few")).map(lattice).collect();
    let handles = HANDLES.get(..n).unwrap_or(&many);
    (
        handles.iter().map(|([x, y], _)| place(*x, *y)).collect(),
        handles
            .iter()
            .map(|([x, y], [dx, dy])| place(x + strength * dx, y + strength * dy))
            .collect(),
    )
}

/// One of a hundred handles: a lattice of ten by ten, its points shifted, moved by up to 14 px of
/// 500 along each axis.
fn lattice(k: u32) -> ([f64; 2], [f64; 2]) {
    let noise = |n: u32| {
        f64::from((k * 4 + n).wrapping_mul(2_654_435_761) >> 8) / f64::from(1_u32 << 23) - 1.0
    };
    let place = |k: u32, n: u32| 0.05 + 0.1 * f64::from(k % 10) + 0.03 * noise(n);
    (
        [place(k, 0), place(k / 10, 1)],
        [0.028 * noise(2), 0.028 * noise(3)],
    )
}

/// How many cells of a mesh fold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Folded {
    Nowhere,
    UnderOnePercent,
    TenPercent,
}

impl Folded {
    pub fn name(self) -> &'static str {
        match self {
            Self::Nowhere => "smooth",
            Self::UnderOnePercent => "under 1 % folded",
            Self::TenPercent => "10 % folded",
        }
    }
}

/// The rigid moving-least-squares mesh of eleven handles, 100 x 100 vertices; where cells shall
/// fold the handles move farther: as far as keeps the folded cells under 1 %, or just so far that
/// 10 % of them fold.
pub fn mesh(extent: Extent, folded: Folded) -> Mesh {
    let share = match folded {
        Folded::Nowhere => {
            let mesh = posed(extent, 1.0);
            assert_eq!(mesh.folded_cells().count(), 0, "the handles fold nothing");
            return mesh;
        }
        Folded::UnderOnePercent => 0.01,
        Folded::TenPercent => 0.1,
    };
    let wanted = share * f64::from((VERTICES - 1) * (VERTICES - 1));
    let folds = |strength| posed(extent, strength).folded_cells().count() as f64 >= wanted;
    let (mut under, mut over) = (1.0, 2.0);
    while !folds(over) {
        (under, over) = (over, 1.5 * over);
    }
    for _ in 0..10 {
        let middle = f64::midpoint(under, over);
        if folds(middle) {
            over = middle;
        } else {
            under = middle;
        }
    }
    posed(
        extent,
        if folded == Folded::TenPercent {
            over
        } else {
            under
        },
    )
}

/// Rigid moving least squares straight from the paper: no plan, so that the mesh does not hang on
/// the code that other benchmarks time.
fn posed(extent: Extent, strength: f64) -> Mesh {
    let (width, height) = (f64::from(extent.width()), f64::from(extent.height()));
    let grid = Grid::with_counts(width, height, VERTICES, VERTICES);
    let place = |[x, y]: [f64; 2]| Vec2::new(x * width, y * height);
    let vertices = (0..VERTICES).flat_map(|j| (0..VERTICES).map(move |i| grid.vertex(i, j)));
    let displacement = vertices.map(|v| {
        let v = Vec2::new(v.x, v.y);
        let handles = HANDLES[..OF_MESH]
            .iter()
            .map(|&(p, d)| (place(p), place(p) + place(d) * strength));
        let weighed = handles.map(|(p, q)| (1.0 / ((p - v).norm2() + 1e-9), p, q));
        let (sum, p_star, q_star) = weighed
            .clone()
            .fold((0.0, Vec2::ZERO, Vec2::ZERO), |(sum, a, b), (w, p, q)| {
                (sum + w, a + p * w, b + q * w)
            });
        let (p_star, q_star) = (p_star * (1.0 / sum), q_star * (1.0 / sum));
        let turn = weighed.fold(Vec2::ZERO, |turn, (w, p, q)| {
            turn + (p - p_star).conj().complex_mul(q - q_star) * w
        });
        let posed = (v - p_star).complex_mul(turn) * (1.0 / turn.norm()) + q_star;
        [(posed.x - v.x) as f32, (posed.y - v.y) as f32]
    });
    Mesh::new(grid, displacement.collect())
}

/// Bilinear, transparent outside, at the size of the source: what all benchmarks draw.
pub fn options(extent: Extent) -> RenderOptions {
    RenderOptions {
        target: extent,
        canvas: None,
        filter: Filter::Bilinear,
        outside: Outside::Transparent,
        force_alpha: false,
    }
}

/// A picture bent by the smooth mesh: alpha 0 or 255 when it is RGBA.
pub fn warped(picture: Pixmap) -> Pixmap {
    let extent = picture.extent();
    let mesh = mesh(extent, Folded::Nowhere);
    let renderer = Renderer::new(Arc::new(Source::new(picture)), &mesh, options(extent));
    let channels = renderer.channels();
    let mut samples =
        vec![0; extent.width() as usize * extent.height() as usize * channels.count()];
    renderer.band(0..extent.height(), &mut samples, &|| false);
    Pixmap::new(extent, channels, Samples::Eight(samples))
}
