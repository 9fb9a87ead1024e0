//! Panels side by side on white, with handles as dots and lines.

use std::error::Error;
use std::sync::Arc;

use mlswarp::deform::Handle;
use mlswarp::format::Format;
use mlswarp::geometry::{Mesh, Point};
use mlswarp::pixmap::Extent;
use mlswarp::render::{Canvas, Filter, Outside, RenderOptions, Renderer, Source};
use mlswarp::{Image, Warper};

/// Width of a panel, and between two of them, px.
const PANEL: u32 = 176;
const GAP: u32 = 6;
/// Radius of a dot, and of its rim, px.
const DOT: f64 = 2.2;
const RIM: f64 = 3.4;
const BLUE: [u8; 3] = [20, 70, 200];
const WHITE: [u8; 3] = [255; 3];
const QUALITY: u8 = 80;

/// A strip of panels: RGB, `[height][width]`.
pub(crate) struct PanelStrip {
    canvas: Canvas,
    /// Of a panel.
    size: Extent,
    width: u32,
    pub(crate) samples: Vec<u8>,
}

impl PanelStrip {
    /// `canvas`: x, y, width and height of the part of the plane that a panel shows, px.
    pub(crate) fn new([x, y, width, height]: [i32; 4], panels: usize) -> Self {
        let side = |side: i32| u32::try_from(side).unwrap_or(1);
        let extent = |width, height| Extent::new(width, height).expect("a panel has pixels");
        let canvas = Canvas {
            x,
            y,
            extent: extent(side(width), side(height)),
        };
        let size = extent(PANEL, (PANEL * side(height)).div_euclid(side(width)).max(1));
        let count = u32::try_from(panels).unwrap_or(1);
        let width = count * PANEL + count.saturating_sub(1) * GAP;
        Self {
            canvas,
            size,
            width,
            samples: vec![255; 3 * (width * size.height()) as usize],
        }
    }

    /// Draws a mesh into a panel.
    pub(crate) fn draw(&mut self, index: usize, source: &Arc<Source>, mesh: &Mesh) {
        let options = RenderOptions {
            target: self.size,
            canvas: Some(self.canvas),
            filter: Filter::Bilinear,
            outside: Outside::Transparent,
            force_alpha: true,
        };
        let renderer = Renderer::new(Arc::clone(source), mesh, options);
        let mut pixels = vec![0; 4 * (PANEL * self.size.height()) as usize];
        renderer.band(0..self.size.height(), &mut pixels, &|| false);
        let left = self.left(index);
        for (k, pixel) in pixels.as_chunks::<4>().0.iter().enumerate() {
            let (x, y) = (k % PANEL as usize, k / PANEL as usize);
            let alpha = f64::from(pixel[3]) / 255.0;
            let at = 3 * (y * self.width as usize + left + x);
            self.blend(at, [pixel[0], pixel[1], pixel[2]], alpha);
        }
    }

    /// Draws a handle over a panel.
    pub(crate) fn mark(&mut self, index: usize, handle: &Handle) {
        let scale = f64::from(PANEL) / f64::from(self.canvas.extent.width());
        let place = |p: &Point| {
            let (x, y) = (
                p.x - f64::from(self.canvas.x),
                p.y - f64::from(self.canvas.y),
            );
            Point::new(x * scale, y * scale)
        };
        let places: Vec<Point> = handle.places().iter().map(place).collect();
        for (radius, colour) in [(RIM, WHITE), (DOT, BLUE)] {
            for line in places.windows(2) {
                self.stroke(index, (line[0], line[1]), radius - 1.2, colour);
            }
            for place in &places {
                self.stroke(index, (*place, *place), radius, colour);
            }
        }
    }

    /// Everything within a distance of a segment.
    fn stroke(&mut self, index: usize, (a, b): (Point, Point), radius: f64, colour: [u8; 3]) {
        let left = self.left(index);
        for y in 0..self.size.height() {
            for x in 0..PANEL {
                let p = Point::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
                let length = (b - a).norm2();
                let t = if length > 0.0 {
                    ((p - a).dot(b - a) / length).clamp(0.0, 1.0)
                } else {
                    0.0
                };
                let cover = (radius + 0.5 - p.distance(a.lerp(b, t))).clamp(0.0, 1.0);
                if cover > 0.0 {
                    let at = 3 * (y as usize * self.width as usize + left + x as usize);
                    self.blend(at, colour, cover);
                }
            }
        }
    }

    fn blend(&mut self, at: usize, colour: [u8; 3], share: f64) {
        for (sample, colour) in self.samples[at..at + 3].iter_mut().zip(colour) {
            let mixed = f64::from(*sample) * (1.0 - share) + f64::from(colour) * share;
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a mean of 8-bit samples"
            )]
            let mixed = mixed.round() as u8;
            *sample = mixed;
        }
    }

    const fn left(&self, index: usize) -> usize {
        index * (PANEL + GAP) as usize
    }

    /// The strip as a file.
    ///
    /// Errors: the file cannot be written.
    pub(crate) fn jpeg(self) -> Result<Vec<u8>, Box<dyn Error>> {
        let size = [self.width, self.size.height()];
        let image = Image::from_rgb8(size[0], size[1], self.samples)?;
        let posed = Warper::new::<[f64; 2]>(size, &[])?.pose::<[f64; 2]>(&[])?;
        let rendering = posed.render(&image)?;
        let rendering = rendering.with(|output| output.quality = QUALITY);
        Ok(rendering.file(Format::Jpeg)?)
    }
}
